"""Fixtures of several test files."""

import gc
import os
import signal
import sys
import tempfile
from collections import Counter

import hypothesis
import pytest

import bench.acquisition.station.stage
from bench.acquisition.run.runner import run_job
from tests.support import acquisition, leftovers, needs

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)  # tests in the background: benches would ignore it, too


CALM = {"deadline": None, "suppress_health_check": [hypothesis.HealthCheck.too_slow]}
hypothesis.settings.register_profile("bench", **CALM)
hypothesis.settings.load_profile("bench")  # no example fails because the machine is busy
GUARD = leftovers.guard()
"""Ends the processes of this test run and removes its folder, even when the run is killed."""
os.environ["BENCH_KEYS"] = tempfile.mkdtemp(prefix="bench-keys-")
"""The key of these tests: no test touches that of the user."""
os.environ["BENCH_WORKERS"] = "1"
"""The tests share the processors already: a copy of each diagnosing process would cost a sixth more."""
os.environ["BENCH_LANG"] = "en"  # whatever the machine speaks
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False
"""Hundreds of processes would each compile the bench anew, and each worker would rewrite the asserts of every file."""

gc.disable()
"""Until all tests are collected: nothing of what is imported meanwhile is garbage."""


def pytest_unconfigure():
    """The end of the run: nothing that it started stays."""
    if GUARD is not None:
        GUARD.communicate()


def pytest_xdist_auto_num_workers(config):
    """One worker more than processors (`-n auto`): many tests wait for another process or a browser."""
    return (os.cpu_count() or 1) + 1


def pytest_collection_modifyitems(items):
    """Tests of the page in a browser carry the mark `browser`; they and slow ones have more time, on busy computers."""
    for item in items:
        if "tests/browser/" in item.path.as_posix():
            item.add_marker("browser")
        slow = {"browser", "slow"} & {mark.name for mark in item.iter_markers()}
        if slow and item.get_closest_marker("timeout") is None:
            item.add_marker(pytest.mark.timeout(900))
    items.sort(key=_late)


def pytest_collection_finish():
    """What was imported and collected stays to the end: no search for garbage goes through it again (0.7 s each)."""
    gc.collect()
    gc.freeze()
    gc.enable()


def _late(item):
    """Tests of half a minute begin first: at the end, they would keep one worker busy while the others wait."""
    slow = item.get_closest_marker("slow")
    return slow is None or not slow.kwargs.get("first", False)


def pytest_terminal_summary(terminalreporter):
    """Say what was skipped, why, and the one command that brings what is missing."""
    skipped = terminalreporter.stats.get("skipped", [])
    reasons = Counter(report.longrepr[2].removeprefix("Skipped: ") for report in skipped)
    for reason, count in reasons.most_common():
        terminalreporter.write_line(f"{count} skipped: {reason}")
    if reasons and (command := needs.hint()):
        terminalreporter.write_line(f"to run them: {command}")


@pytest.fixture(scope="session")
def short_run(tmp_path_factory):
    """The folder of a finished simulated run of two minutes; not to be changed."""
    result = run_job(acquisition.job(tmp_path_factory.mktemp("short")))
    assert result.error is None
    return result.run


@pytest.fixture
def world(monkeypatch):
    """The simulated station of the run, to be spoilt and to be asked what it was told."""
    opened = []

    def simulate(*args):
        opened.append(original(*args))
        return opened[-1]

    original = bench.acquisition.station.stage.simulate
    monkeypatch.setattr(bench.acquisition.station.stage, "simulate", simulate)
    return opened
