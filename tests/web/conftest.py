"""A live run on this computer for the tests of the server: its folder, its desk, and who watches it."""

import pytest

from bench.acquisition.recording.recorder import Recorder
from bench.acquisition.run.control import Desk
from bench.record import Begun, RunFolder
from bench.web.live.starts import Starts
from bench.web.live.watching import Watcher
from drivers.clock import SimClock
from tests.acquisition.test_control import STATION, Sequencer, status

PROFILE = "name: p\nsegments:\n  - {kind: ramp, to_degc: 33, rate_degc_per_min: 2}\n"


@pytest.fixture
def folder(tmp_path):
    path = tmp_path / "reports" / "G-1" / "run"
    (path / "journal").mkdir(parents=True)
    (path / "profile.yaml").write_text(PROFILE)
    return path


@pytest.fixture
def out(folder):
    return folder.parent.parent


@pytest.fixture
def recorder(folder):
    recorder = Recorder(RunFolder(folder), SimClock(), Begun(run="run"))
    yield recorder
    recorder.close()


@pytest.fixture
def desk():
    desk = Desk()
    desk.attach(Sequencer(), 300.0)
    desk.look(STATION, status(100.0))
    return desk


class Heard:
    """A listener that remembers."""

    def __init__(self):
        self.runs, self.ends = [], []

    def __call__(self, runs, ends):
        self.runs = runs
        self.ends += ends


@pytest.fixture
def heard():
    return Heard()


@pytest.fixture
def watcher(out, tmp_path, heard):
    return Watcher(out, Starts(tmp_path / "own", out, tmp_path), heard)
