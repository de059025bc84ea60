"""A real browser and a real server for the tests of the page."""

import os
import re
import signal
import subprocess
import sys
import threading
from contextlib import contextmanager
from pathlib import Path

import pytest

CHROMIUM = Path("/usr/bin/chromium")
QUIET = (
    "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking",
    "--disable-component-update", "--disable-sync",
)  # fmt: skip


@pytest.fixture(scope="session")
def chromium():
    """Debian's chromium, driven by Playwright."""
    if not os.environ.get("BENCH_CI"):
        if not CHROMIUM.exists():
            pytest.skip("no chromium here")
        pytest.importorskip("playwright.sync_api")
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=str(CHROMIUM), args=list(QUIET))
        yield browser
        browser.close()


@contextmanager
def serving(out, *options):
    """The address of a `bench ui` of its own that shows the runs in `out`; ended by SIGTERM."""
    command = [sys.executable, "-c", "from bench.cli import main; main()", "ui", "--port", "0", "--no-browser"]
    command += ["--out", str(out), *options]
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
    child = subprocess.Popen(command, stderr=subprocess.PIPE, stdin=subprocess.DEVNULL, text=True, env=environment)
    try:
        said = []
        for line in child.stderr:
            said.append(line)
            if found := re.search(r"https?://\S+", line):
                break
        else:
            pytest.fail(f"the server did not start: {''.join(said)}")
        # Whatever it says later is read, too: a full pipe would stop it.
        threading.Thread(target=child.stderr.read, daemon=True).start()
        yield found.group(0).rstrip("/")
    finally:
        child.send_signal(signal.SIGTERM)
        child.wait(60)
        child.stderr.close()


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """A server over a folder without runs: `(address, folder)`."""
    out = tmp_path_factory.mktemp("out")
    with serving(out) as address:
        yield address, out
