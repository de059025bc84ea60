"""Fixtures of several test files."""

import signal

import pytest

import bench.acquisition.station.station
from bench.acquisition.run.runner import run_job
from tests.support import acquisition

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)  # tests in the background: benches would ignore it, too


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

    original = bench.acquisition.station.station.simulate
    monkeypatch.setattr(bench.acquisition.station.station, "simulate", simulate)
    return opened
