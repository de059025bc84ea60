"""Several units in one job: what is run is run once for all, and each unit has its own steps and verdict."""

from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace

import pytest

from bench.base import library
from bench.base.errors import EquipmentError, InputError, RunAborted
from bench.commands.calibration import recording
from bench.commands.calibration.calibrate import calibrate_all
from bench.commands.calibration.job import Done
from bench.commands.calibration.order import Order
from bench.commands.calibration.recording import AgainError, recorded
from bench.commands.calibration.steps import refuse_pieces
from bench.record import Manifest, RunFolder
from tests.commands.test_calibrate import Fake
from tests.support import bench_project
from tests.support.run_folders import make_run, ramp_run

PLAN = library() / "plans" / "quick.yaml"
FOUR = library() / "stations" / "four_units.yaml"
UNITS = ("SIM-0001", "GX-0815@SIM-0002", "SIM-0003")
SERIALS = ("SIM-0001", "GX-0815", "SIM-0003")
SOAK = """
name: brief
start: {temperature_degc: 23}
settle: {dwell_min: 0.1, slope_degc_per_min: 20, band_degc: 2, unit_band_degc: 5}
segments:
  - {kind: soak, duration_min: 4}
"""


class Chamber:
    """Records every unit of a task in a folder of its own, as `conduct` does; `ends` are how the next runs end."""

    def __init__(self, monkeypatch):
        self.tasks, self.ends = [], []
        monkeypatch.setattr(recording, "conduct", self.conduct)
        monkeypatch.setattr(recording, "_whole", lambda order, result: result)

    def conduct(self, profile, station, task, quiet):
        self.tasks.append(tuple(task.serials))
        end = self.ends.pop(0) if self.ends else None
        for serial in task.serials:
            folder = task.out / serial / f"2026_{len(self.tasks)}"
            make_run(folder, **ramp_run(rate_hz=1.0), unit=serial)
            for name, text in task.texts.items():
                (folder / name).write_text(text, encoding="utf-8")
        if end is not None:
            raise end


class Recorded:
    """A step that makes a run."""

    name = "run"

    def do(self, order, job):
        run = recorded(order, job, self.name, order.plan.profile, "off", {})
        return Done(str(run.path))


@pytest.fixture
def orders(tmp_path):
    return Order.load_all(PLAN, FOUR, UNITS, tmp_path, quiet=True)


def test_a_run_is_made_once_for_all_units_and_each_unit_has_its_own(orders, monkeypatch):
    chamber = Chamber(monkeypatch)
    jobs = calibrate_all(orders, steps=[Fake("check"), Recorded(), Fake("fit")])
    assert chamber.tasks == [SERIALS]
    assert [job.content["verdict"] for job in jobs] == ["PASS"] * 3
    assert [Path(job.step("run")["sentence"]).parent.name for job in jobs] == list(SERIALS)
    units = [entry["serial"] for entry in orders[0].station_file().content["units"]]
    assert units == ["SIM-0001", "GX-0815", "SIM-0003", "SIM-0004"]


def test_what_ends_the_run_fails_every_unit_and_is_not_tried_again_for_the_next(orders, monkeypatch):
    chamber = Chamber(monkeypatch)
    chamber.ends = [RunAborted("aborted by Olena")]
    jobs = calibrate_all(orders, steps=[Recorded()])
    assert (chamber.tasks, [job.content["sentence"] for job in jobs]) == ([SERIALS], ["aborted by Olena"] * 3)
    assert {job.content["exit_code"] for job in jobs} == {3}


def test_a_unit_that_leaves_the_run_leaves_it_alone_and_has_a_run_of_its_own_when_it_goes_on(tmp_path):
    plan = bench_project.made(tmp_path) / "profiles" / "plans" / "brief.yaml"
    (tmp_path / "profiles" / "brief.yaml").write_text(SOAK)
    station = tmp_path / "four.yaml"
    station.write_text(f"{FOUR.read_text()}faults:\n  - {{at_s: 100, on: SIM-0001, fault: silence, for_s: 1e6}}\n")
    first, second = orders = Order.load_all(plan, station, ("SIM-0001", "SIM-0002"), tmp_path / "out", quiet=True)
    jobs = calibrate_all(orders, steps=[Recorded()])
    assert [job.state for job in jobs] == ["failed", "ended"]
    assert "no sound rate frame" in jobs[0].content["sentence"]
    (again,) = calibrate_all([first], steps=[Recorded()])
    made = [len(list((tmp_path / "out" / order.serial).glob("*/manifest.json"))) for order in (first, second)]
    assert (made, again.content["exit_code"]) == ([2, 1], 3), "alone, it is not left behind: the guard ends its run"


class Once(Fake):
    """Fails for one unit."""

    def do(self, order, job):
        if order.serial == "GX-0815" and not self.count:
            self.count += 1
            raise self.errors[0]
        return Done("fine")


@pytest.mark.parametrize(("error", "tasks"), [
    (EquipmentError("the unit does not answer"), [("SIM-0001", "SIM-0003")]),
    (AgainError("check", "the unit holds another"), [("SIM-0001", "GX-0815", "SIM-0003")]),
])  # fmt: skip
def test_a_unit_that_fails_is_left_behind_and_one_that_repeats_a_step_is_waited_for(orders, monkeypatch, error, tasks):
    chamber = Chamber(monkeypatch)
    jobs = calibrate_all(orders, steps=[Fake("check"), Once("flash", errors=[error]), Recorded()])
    assert chamber.tasks == tasks
    assert [job.state for job in jobs] == ["ended", "ended" if isinstance(error, AgainError) else "failed", "ended"]


def test_a_unit_goes_on_alone_with_what_began_together(orders, monkeypatch, tmp_path):
    Chamber(monkeypatch)
    error = EquipmentError("the unit does not answer")
    before = calibrate_all(orders, steps=[Recorded(), Once("flash", errors=[error])])
    (alone,) = Order.load_all(PLAN, FOUR, [UNITS[1]], tmp_path, quiet=True)
    (after,) = calibrate_all([alone], steps=[Recorded(), Fake("flash")])
    assert (after.folder, after.state, after.step("run")["attempts"]) == (before[1].folder, "ended", 1)


def test_a_unit_goes_on_with_the_run_of_several_new_units_by_that_runs_own_station(orders, monkeypatch, tmp_path):
    """Its mates stand in their slots there; the order of one unit has that unit alone."""
    new = ("GX-1@SIM-0001", "GX-2@SIM-0002")
    both, (alone,) = (Order.load_all(PLAN, FOUR, units, tmp_path, quiet=True) for units in (new, new[:1]))
    chamber, stations = Chamber(monkeypatch), []
    chamber.ends = [RunAborted("aborted by Olena")]
    jobs = calibrate_all(both, steps=[Recorded()])
    (folder,) = (tmp_path / "GX-1").glob("2026_*")
    (folder / "journal").mkdir()
    (folder / "journal" / "0.gtbj").touch()
    (folder / "station.yaml").write_text(both[0].station_file().text)
    manifest = Manifest.read(folder)
    manifest.model_copy(update={"state": "aborted"}).write(folder)
    monkeypatch.setattr(recording, "recover", RunFolder)

    def go_on(run, station, quiet):
        stations.append(station)
        return run

    monkeypatch.setattr(recording, "continued", go_on)
    (after,) = calibrate_all([alone], steps=[Recorded()])
    (station,) = stations
    assert (after.folder, after.state) == (jobs[0].folder, "ended")
    assert [entry["serial"] for entry in station.content["units"]][:2] == ["GX-1", "GX-2"]
    assert station.file == alone.station_file().file


@pytest.mark.parametrize(("word", "parts", "again"), [
    ("FAIL", 2, True), ("INVALID", 2, True), ("PASS", 2, False), ("FAIL", 1, False),
])  # fmt: skip
def test_a_run_that_was_interrupted_rejects_no_unit(word, parts, again):
    run = SimpleNamespace(parts=lambda: list(range(parts)))
    with pytest.raises(AgainError, match=word) if again else nullcontext():
        refuse_pieces(run, word, "verify")


def test_a_release_names_one_unit_and_a_unit_is_named_once(orders, tmp_path):
    with pytest.raises(InputError, match="released alone"):
        calibrate_all(orders, release="Olha: known", steps=[])
    with pytest.raises(InputError, match="named twice"):
        Order.load_all(PLAN, FOUR, ["SIM-0001", "SIM-0001"], tmp_path)
