"""Ends what a test run started when the run is over, however it ended: interrupted, killed or done.

A process of its own waits on a pipe that the test run holds. All processes of the run carry a mark in their
environment, detached ones too; when the pipe closes, those that still live are killed, and the folder of their
temporary files is removed.
"""

import os
import secrets
import shutil
import subprocess
import sys
import tempfile

import psutil

MARK = "BENCH_TEST_RUN"


def guard():
    """Mark this run and start its guard; the pipe to hold, or None inside a marked run (a worker of pytest-xdist).

    All temporary files of the run go into one folder, except those of pytest, which keeps them to be looked at.
    """
    if MARK in os.environ:
        return None
    environment = dict(os.environ)
    os.environ.setdefault("PYTEST_DEBUG_TEMPROOT", tempfile.gettempdir())
    os.environ[MARK] = secrets.token_hex(8)
    os.environ["TMPDIR"] = tempfile.tempdir = tempfile.mkdtemp(prefix="bench-tests-")
    command = [sys.executable, __file__, os.environ[MARK], tempfile.tempdir]
    return subprocess.Popen(command, stdin=subprocess.PIPE, env=environment, start_new_session=True)


def marked(token):
    """Processes with the mark of this run."""
    for process in psutil.process_iter():
        try:
            if process.environ().get(MARK) == token:
                yield process
        except (psutil.Error, OSError):
            continue  # it ended meanwhile, or belongs to somebody else


def main(token, folder):
    """Wait for the end of the run; then kill until nothing of it is left, and remove its folder."""
    sys.stdin.buffer.read()
    while left := list(marked(token)):
        for process in left:
            process.kill()
        psutil.wait_procs(left, timeout=5)
    shutil.rmtree(folder, ignore_errors=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
