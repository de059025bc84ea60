"""A `bench ui` of its own for a test, as a process."""

import os
import re
import signal
import subprocess
import sys
import threading
from contextlib import contextmanager

import pytest


class Site:
    """A `bench ui` of its own over the runs in `out`; it can be ended and started again at the same address."""

    def __init__(self, out, *options, project=None):
        self.out, self._options, self._project = out, options, project
        self.address, self._child = "", None

    def start(self):
        port = self.address.rpartition(":")[2] or "0"
        command = [sys.executable, "-P", "-c", "from bench.cli import main; main()", "ui", "--no-browser"]
        command += ["--port", port, "--out", str(self.out), *self._options]
        environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
        self._child = subprocess.Popen(
            command, stderr=subprocess.PIPE, stdin=subprocess.DEVNULL, text=True, env=environment, cwd=self._project
        )
        said = []
        for line in self._child.stderr:
            said.append(line)
            if found := re.search(r"https?://\S+", line):
                break
        else:
            pytest.fail(f"the server did not start: {''.join(said)}")
        # Whatever it says later is read, too: a full pipe would stop it.
        threading.Thread(target=self._child.stderr.read, daemon=True).start()
        self.address = found.group(0).rstrip("/")

    @contextmanager
    def silent(self):
        """It takes requests and answers none, and does what was asked when it goes on."""
        self._child.send_signal(signal.SIGSTOP)
        try:
            yield
        finally:
            self._child.send_signal(signal.SIGCONT)

    def end(self):
        self._child.send_signal(signal.SIGTERM)
        self._child.wait(60)
        self._child.stderr.close()


@contextmanager
def site_over(out, *options, project=None):
    """A running `Site`, ended by SIGTERM; `project`: the folder it is started in."""
    site = Site(out, *options, project=project)
    try:
        site.start()
        yield site
    finally:
        site.end()


@contextmanager
def serving(out, *options):
    """The address of a `bench ui` of its own that shows the runs in `out`."""
    with site_over(out, *options) as site:
        yield site.address
