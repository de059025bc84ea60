"""Several units in one chamber: a run folder and a verdict each; one that fails alone leaves, the others go on."""

import json
import shutil
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import bench.acquisition.station.stage
import bench.acquisition.station.station
import bench.commands.several
from bench.acquisition.recording.assemble import assemble
from bench.acquisition.recording.recorder import Recorder
from bench.acquisition.run.runner import UnitResult, run_job
from bench.base.errors import EquipmentError, InputError, RunAborted
from bench.cli import main, rendering
from bench.commands.several import report_on_all
from bench.record import Begun, GyroKind, RunFolder, create_run, open_run, sha256
from bench.record.samples import read_samples
from drivers.clock import SimClock
from tests.support import acquisition
from tests.support.acquisition import at

FOUR = acquisition.STATION.parent / "four_units.yaml"
SERIALS = ["SIM-0001", "SIM-0002", "SIM-0003", "SIM-0004"]


def job(out, **changes):
    content = json.loads(json.dumps(acquisition.config.read_yaml(FOUR).content)) | changes
    return acquisition.job(out, settings=acquisition.station(**content))


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A run of four units to its end; not to be changed."""
    result = run_job(job(tmp_path_factory.mktemp("whole")))
    assert result.error is None
    return result


@pytest.fixture(scope="module")
def dying(tmp_path_factory):
    """A run of four units, the second of which falls silent in mid-ramp, at 20 s; not to be changed."""
    with pytest.MonkeyPatch.context() as patch:
        opened = []
        original = bench.acquisition.station.stage.simulate
        patch.setattr(
            bench.acquisition.station.stage, "simulate", lambda *args: opened.append(original(*args)) or opened[-1]
        )
        return run_job(job(tmp_path_factory.mktemp("dying")), at(20, lambda station: opened[0].units.pop(1)))


def events(run, kind):
    return [event for event in run.events() if event["kind"] == kind]


def test_every_unit_gets_a_run_folder_of_its_own_that_names_its_companions(whole):
    assert [unit.serial for unit in whole.units] == SERIALS
    for n, unit in enumerate(whole.units):
        manifest = open_run(unit.run.path).manifest()
        assert (manifest.unit, manifest.state) == (unit.serial, "done")
        assert manifest.unit_identity.serial == n + 1
        assert manifest.losses["lost"] == manifest.losses["corrupt"] == 0
        assert [companion.unit for companion in manifest.companions] == [s for s in SERIALS if s != unit.serial]
        assert all(open_run(unit.run.path / companion.run) for companion in manifest.companions)
        assert {name: sha256(unit.run.path / name) for name in manifest.files} == manifest.files
        assert len(events(unit.run, "segment")) == 4


def test_units_have_noise_of_their_own(whole):
    rates = [read_samples(unit.run.data)["rate"][:1000] for unit in whole.units]
    for n, rate in enumerate(rates):
        assert not any(np.array_equal(rate, other) for other in rates[:n])


def test_a_unit_among_others_gives_what_it_gives_alone(whole, tmp_path):
    alone = run_job(job(tmp_path, units=acquisition.config.read_yaml(FOUR).content["units"][:1]))
    assert sha256(alone.run.data) == sha256(whole.units[0].run.data)


def test_units_on_one_bus_share_one_journal(whole):
    first, second, third, fourth = (unit.run for unit in whole.units)
    assert (first.journal / "can0.gtbj").samefile(second.journal / "can0.gtbj")
    assert (third.journal / "can1.gtbj").samefile(fourth.journal / "can1.gtbj")
    assert not (first.journal / "can1.gtbj").exists()


def test_each_folder_can_be_recovered_by_itself(whole, tmp_path):
    shutil.copytree(whole.units[1].run.path, tmp_path / "elsewhere")
    run = RunFolder(tmp_path / "elsewhere")
    before = run.manifest()
    for made in ("manifest.json", "data.parquet", "means.parquet", "events.jsonl"):
        (run.path / made).unlink()
    assert assemble(run).files == before.files


def test_a_bench_that_is_killed_leaves_folders_that_can_all_be_recovered(tmp_path):
    snapshot = at(20, lambda station: shutil.copytree(tmp_path / "out", tmp_path / "killed"))
    run_job(job(tmp_path / "out"), snapshot)
    folders = sorted((tmp_path / "killed").glob("*/*"))
    assert len(folders) == 4
    for n, folder in enumerate(folders):
        manifest = assemble(RunFolder(folder))
        assert (manifest.unit, manifest.state) == (SERIALS[n], "aborted")
        assert manifest.losses["lost"] == 0
        assert np.count_nonzero(np.isfinite(read_samples(folder / "data.parquet")["rate"])) == 20 * 500


def test_a_file_system_without_links_gets_copies(whole, tmp_path, monkeypatch):
    monkeypatch.setattr(bench.acquisition.station.station, "share", lambda source, target: False)
    copied = run_job(job(tmp_path))
    assert copied.error is None
    for linked, unit in zip(whole.units, copied.units, strict=True):
        assert unit.run.manifest().files["data.parquet"] == linked.run.manifest().files["data.parquet"]
        assert len(list(unit.run.journal.iterdir())) == 2
    first, second = (unit.run.journal / "can0.gtbj" for unit in copied.units[:2])
    assert not first.samefile(second)


def test_a_unit_that_falls_silent_in_mid_ramp_leaves_alone_with_its_reason(dying):
    reasons = [unit.error for unit in dying.units if unit.error is not None]
    assert [unit.serial for unit in dying.units if unit.error is None] == ["SIM-0001", "SIM-0003", "SIM-0004"]
    assert [str(reason) for reason in reasons] == ["dropped: no sound rate frame for 5.0 s, 5 s allowed"]
    assert [reason.exit_code for reason in reasons] == [4]
    gone = dying.units[1].run
    manifest = gone.manifest()
    assert (manifest.state, manifest.cause) == ("failed", "no sound rate frame for 5.0 s, 5 s allowed")
    assert [segment.outcome for segment in manifest.segments] == ["interrupted"]
    assert manifest.segments[0].reason == manifest.cause
    rates = read_samples(gone.data)["rate"]
    assert np.count_nonzero(np.isfinite(rates)) == 20 * 500
    for unit in dying.units[:1] + dying.units[2:]:
        assert unit.run.manifest().state == "done"
        (dropped,) = events(unit.run, "dropped")
        assert dropped["unit"] == "SIM-0002"
        assert "no sound rate frame" in dropped["text"]


def test_those_that_stay_do_not_notice(whole, dying):
    for before, after in zip(whole.units, dying.units, strict=True):
        if after.error is None:
            assert sha256(after.run.data) == sha256(before.run.data)


def test_another_unit_in_the_place_of_one_drops_that_one_and_what_is_not_its_own(world, tmp_path):
    def swap(station):
        world[0].units[2].wire.serial = 77
        world[0].units[2].wire.reboot()

    result = run_job(job(tmp_path), at(20, swap))
    assert [unit.error is None for unit in result.units] == [True, True, False, True]
    assert "unit SIM-0003: 77 answers as number 0, the station file says identity 3" in str(result.error)
    data = read_samples(result.units[2].run.data)
    times = data["time"][np.isfinite(data["rate"])]
    assert 17 < times[-1] <= 20
    assert result.units[2].run.manifest().unit_identity.serial == 3


def test_two_units_under_one_number_are_told_even_where_no_identity_is_expected(world, tmp_path):
    units = [
        {k: v for k, v in unit.items() if k != "identity"}
        for unit in acquisition.config.read_yaml(FOUR).content["units"]
    ]

    def look(station, status):
        if status.t_s >= 20:
            world[0].units[0].wire.serial = 70 + int(status.t_s) % 2

    result = run_job(job(tmp_path, units=units), look)
    assert [unit.error is None for unit in result.units] == [False, True, True, True]
    assert "unit SIM-0001: serial number 70 answers as number 0; before, 1 did" in str(result.error)


def test_a_unit_that_starts_anew_once_stays_and_is_told(world, tmp_path):
    result = run_job(job(tmp_path), at(20, lambda station: world[0].units[1].wire.reboot()))
    assert result.error is None
    assert [event["text"] for event in events(result.run, "unit")] == ["unit SIM-0002 started anew, 1 in all"]
    assert [unit.run.manifest().losses["resets"] for unit in result.units] == [0, 1, 0, 0]


def test_a_unit_that_starts_anew_all_the_time_leaves(world, tmp_path):
    def look(station, status):
        if status.t_s >= 20:
            world[0].units[0].wire.reboot()

    result = run_job(job(tmp_path), look)
    assert [unit.error is None for unit in result.units] == [False, True, True, True]
    assert "sample counter gone wild: started anew 5 times within a minute" in str(result.error)


def test_a_lost_bus_takes_its_units_with_it_and_no_others(tmp_path):
    result = run_job(job(tmp_path), at(20, lambda station: station.local_buses["can1"].shutdown()))
    assert [unit.error is None for unit in result.units] == [True, True, False, False]
    for unit in result.units[2:]:
        assert str(unit.error).startswith("dropped: bus can1 link lost for 4 s: ")
    states = [event["state"] for event in events(result.units[0].run, "link")]
    assert states == ["ok", "degraded", "lost"]


def test_when_all_fall_silent_together_nobody_leaves_and_the_guards_decide(world, tmp_path):
    result = run_job(job(tmp_path), at(20, lambda station: world[0].units.clear()))
    assert all(isinstance(unit.error, RunAborted) for unit in result.units)
    assert "unit silent: age of the newest frame" in str(result.error)
    assert {unit.run.manifest().state for unit in result.units} == {"aborted"}


def test_the_last_one_is_left_to_the_guards(world, tmp_path):
    left = []

    def look(station, status):
        left[:] = [unit.serial for unit in station.units]
        if status.t_s >= 20 and world[0].units:
            world[0].units.pop(0)

    result = run_job(job(tmp_path), look)
    assert left == ["SIM-0004"]
    assert [type(unit.error) for unit in result.units] == [EquipmentError] * 3 + [RunAborted]


def test_before_the_start_all_have_to_be_heard(world, monkeypatch, tmp_path):
    class Silent(bench.acquisition.station.simulation.SimulatedStation):
        def advance(self, t0_s, t1_s):
            self.units[3:] = []
            super().advance(t0_s, t1_s)

    monkeypatch.setattr(bench.acquisition.station.simulation, "SimulatedStation", Silent)
    result = run_job(job(tmp_path))
    assert str(result.error).startswith("not started: unit SIM-0004: no sound rate frame as number 1 on bus can1")
    assert not any(events(unit.run, "write") for unit in result.units)
    assert len({str(unit.error) for unit in result.units}) == 1


def killed(tmp_path, *lines):
    """A run folder whose bench was killed, with what its watchdog wrote."""
    run = create_run(tmp_path, "G1", "p", SimClock().utc())
    begun = Begun(unit="G1", gyro=GyroKind(layout="vibratory", number=0, bus="can0"))
    recorder = Recorder(run, SimClock(), begun)
    recorder.event("run", "start")
    recorder.close()
    (run.path / "watchdog.jsonl").write_text("".join(line + "\n" for line in lines))
    return run


@pytest.mark.parametrize(("ok", "state", "said"), [
    (True, "aborted", "made safe by the watchdog"),
    (False, "failed", "SAFE STATE NOT VERIFIED by the watchdog: set point to 23 degC: no answer"),
])  # fmt: skip
def test_what_the_watchdog_did_is_part_of_the_run(tmp_path, ok, state, said):
    event = {"t_s": 7.5, "kind": "safe_state", "text": "set point to 23 degC: no answer", "ok": ok}
    run = killed(tmp_path, json.dumps(event), '{"t_s": 8.')
    manifest = assemble(run)
    assert manifest.state == state
    assert manifest.cause == f"the bench was killed; recovered from its journals; {said}"
    assert list(run.events())[-1] == event
    assert "watchdog.jsonl" in manifest.files


@dataclass(frozen=True)
class Analysed:
    run: str
    verdict: str
    exit_code: int
    sentence: str = "so be it."


def unit(serial, error=None):
    return UnitResult(serial, RunFolder(Path("reports") / serial), error)


def test_the_answer_for_several_is_the_worst_and_one_that_cannot_be_analysed_loses_nothing(monkeypatch):
    def report_on(run, models, error, *further):
        if run.path.name == "G2":
            raise InputError("too little data")
        word, code = ("adequate", 0) if error is None else ("partial", error.exit_code)
        return Analysed(str(run.path), word, code)

    monkeypatch.setattr(bench.commands.several, "report_on", report_on)
    answer = report_on_all([unit("G1"), unit("G2"), unit("G3", EquipmentError("dropped: silent"))], [])
    content, text = rendering.content(answer), rendering.plain(answer)
    assert content["verdict"] == "partial"
    assert [unit["verdict"] for unit in content["units"]] == ["adequate", "unproven", "partial"]
    assert content["units"][1]["error"] == "too little data"
    assert answer.exit_code == 4
    assert "G2  unproven: not analysed: too little data" in text
    assert "bench: dropped: silent" in text


def test_several_units_are_run_with_one_command_and_one_unit_answers_as_ever(tmp_path):
    profile = tmp_path / "short.yaml"
    profile.write_text(acquisition.SHORT)

    def run(*units):
        names = [argument for serial in units for argument in ("--unit", serial)]
        command = ["run", profile, "--station", FOUR, "--out", tmp_path, "--model", "polynomial", "--json", *names]
        return CliRunner().invoke(main, [str(argument) for argument in command], catch_exceptions=False)

    two = run("SIM-0002", "SIM-0004")
    content = json.loads(two.stdout)
    assert content.keys() == {"verdict", "units", "registry"}
    assert [unit["unit"] for unit in content["units"]] == ["SIM-0002", "SIM-0004"]
    one = json.loads(run("SIM-0003").stdout)
    assert {"run", "verdict", "rms_dph", "floor_dph"} <= one.keys()
    for unit in content["units"]:
        assert unit.keys() - {"unit"} == one.keys() - {"registry"}
        assert (Path(unit["run"]) / "report.html").is_file()
