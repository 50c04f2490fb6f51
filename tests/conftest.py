"""Random examples have no deadline: compiling, or a busy machine, is no failure."""

from hypothesis import settings

settings.register_profile("any machine", deadline=None)
settings.load_profile("any machine")
