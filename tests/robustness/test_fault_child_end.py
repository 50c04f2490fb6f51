"""A child process that ends by itself while a thread of it waits for messages ends in peace."""

from __future__ import annotations

import subprocess
import sys

CHILD = """
import threading, time
from slamsim.process.module_process import requests
from slamsim.process.pipe import read_message

incoming = requests()
thread = threading.Thread(target=read_message, args=(incoming,), daemon=True)
thread.start()
while not thread.is_alive():
    time.sleep(0.01)
time.sleep(0.2)  # until it reads
"""


def test_interpreter_ends_while_a_thread_reads() -> None:
    with subprocess.Popen(
        [sys.executable, "-c", CHILD], stdin=subprocess.PIPE, stderr=subprocess.PIPE
    ) as child:
        assert child.wait(60.0) == 0, child.stderr and child.stderr.read().decode()
