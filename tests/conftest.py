"""Random examples have no deadline: compiling, or a busy machine, is no failure. Ctrl-C is heard in
child processes also where the tests run in the background, which has it ignored."""

import signal

from hypothesis import settings

settings.register_profile("any machine", deadline=None)
settings.load_profile("any machine")

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)
