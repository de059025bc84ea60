"""A test run that is killed leaves no process behind."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import psutil
import pytest

from tests.support import leftovers

ROOT = Path(__file__).parents[1]
STARTS = """
import subprocess, sys, time
from tests.support import leftovers
GUARD = leftovers.guard()
detached = subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE, start_new_session=True)
print(detached.pid, flush=True)
input()
"""


@pytest.mark.skipif(sys.platform == "win32", reason="kills a process by a signal")
def test_what_a_killed_run_started_ends_with_it():
    environment = {name: value for name, value in os.environ.items() if name != leftovers.MARK}
    environment["PYTHONPATH"] = str(ROOT)
    pipe = subprocess.PIPE
    with subprocess.Popen([sys.executable, "-c", STARTS], env=environment, stdin=pipe, stdout=pipe, text=True) as run:
        detached = psutil.Process(int(run.stdout.readline()))
        run.send_signal(signal.SIGKILL)
    assert not psutil.wait_procs([detached], timeout=120)[1]
