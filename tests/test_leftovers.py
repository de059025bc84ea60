"""A test run that is killed leaves no process and no temporary file behind."""

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
import subprocess, sys, tempfile
from tests.support import leftovers
GUARD = leftovers.guard()
detached = subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE, start_new_session=True)
print(detached.pid, tempfile.mkdtemp(), flush=True)
input()
"""


@pytest.mark.skipif(sys.platform == "win32", reason="kills a process by a signal")
def test_what_a_killed_run_started_ends_with_it():
    environment = {name: value for name, value in os.environ.items() if name != leftovers.MARK}
    environment["PYTHONPATH"] = str(ROOT)
    pipe = subprocess.PIPE
    with subprocess.Popen([sys.executable, "-c", STARTS], env=environment, stdin=pipe, stdout=pipe, text=True) as run:
        pid, folder = run.stdout.readline().split()
        detached = psutil.Process(int(pid))
        watching = [child for child in psutil.Process(run.pid).children() if child != detached]
        assert Path(folder).parent.name.startswith("bench-tests-")
        run.send_signal(signal.SIGKILL)
    assert not psutil.wait_procs([detached, *watching], timeout=120)[1]
    assert not Path(folder).parent.exists()
