"""A killed bench goes on: nothing is rewound, the gap stays a gap and is told, and two benches never meet."""

import json
import os
import shutil
import subprocess
import sys
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest

from bench.acquisition.profile.profile import profile_from_text
from bench.acquisition.recording import parts
from bench.acquisition.recording.assemble import assemble
from bench.acquisition.recording.parts import Counted
from bench.acquisition.run import remote
from bench.acquisition.run.continuation import RESUMED, SIMULATED_GAP_S, plan, remaining
from bench.acquisition.run.runner import Job, run_job
from bench.acquisition.station.safety import HOME
from bench.base.errors import InputError
from bench.record import ExecutedSegment, RunFolder, open_run
from bench.record.samples import read_samples
from drivers.samples import SampleClock
from tests.support import acquisition
from tests.support.commands import bench, undiagnosed

PROFILE = """\
name: there and back
settle: {band_degc: 0.5, unit_band_degc: 5, slope_degc_per_min: 1, dwell_min: 0.5, timeout_min: 60}
segments:
  - {kind: ramp, name: up, to_degc: 30, rate_degc_per_min: 2, arrival_band_degc: 1}
  - {kind: soak, name: warm, duration_min: 2}
  - {kind: ramp, name: down, to_degc: 26, rate_degc_per_min: 2, arrival_band_degc: 1}
"""
KILLED = """
import os, shutil, sys
from pathlib import Path
from tests.support import acquisition
from bench.acquisition.run.runner import run_job
from tests.acquisition.test_continuation import PROFILE
out, ends = Path(sys.argv[1]), eval(sys.argv[2])
def look(station, status):
    name, until_s = ends[0]
    if status.leg.name.startswith(name) and status.t_s - status.leg_from_s >= until_s:
        if len(ends) == 1:
            os._exit(9)
        shutil.copytree(out, out.with_name(f"{out.name}-{name}-{until_s}"))
        del ends[0]
run_job(acquisition.job(out, PROFILE, acquisition.station(**eval(sys.argv[3]))), look)
"""
"""A bench that is killed at the last of its ends; what a kill at the others would leave is copied."""
ENDS = [("up", 20), ("up", 60), ("up", 100), ("warm", 50), ("down", 10)]
TWO = {
    "units": [
        {"serial": "SIM-0001", "bus": "can0", "number": 0, "identity": 1},
        {"serial": "SIM-0002", "bus": "can0", "number": 1, "identity": 2},
    ]
}


def kill_in(out, leg, after_s, **station):
    """Run folders of a bench that was killed `after_s` [s] into a leg."""
    _kill(out, [(leg, after_s)], station)
    return sorted(out.glob("*/*"))


def _kill(out, ends, station):
    here = Path(__file__).parents[2]
    environment = {**os.environ, "PYTHONPATH": str(here)}
    command = [sys.executable, "-c", KILLED, str(out), repr(ends), repr(station)]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 9, done.stderr


@pytest.fixture(scope="module")
def kills(tmp_path_factory):
    """What a bench that is killed at one of `ENDS` leaves, by this end; one process for all, not to be changed."""
    out = tmp_path_factory.mktemp("kills") / "out"
    _kill(out, ENDS, {})
    return {end: out.with_name(f"out-{end[0]}-{end[1]}") for end in ENDS[:-1]} | {ENDS[-1]: out}


@pytest.fixture
def killed(kills, tmp_path):
    """The run folder of a bench that was killed at one of `ENDS`."""

    def copied(leg, after_s):
        (path,) = shutil.copytree(kills[leg, after_s], tmp_path / "killed").glob("*/*")
        return path

    return copied


def go_on(path, settings=None, onlooker=lambda station, status: None):
    profile, station = profile_from_text(PROFILE), settings or acquisition.station()
    continuation = plan(RunFolder(path), profile, station)
    job = Job(profile, PROFILE, station, json.dumps(acquisition.station_content()), {}, continuation.serials,
              continuation=continuation)  # fmt: skip
    return run_job(job, onlooker)


@pytest.fixture(scope="module")
def cut_ramp(kills, tmp_path_factory):
    """A run that was killed in mid-ramp and resumed: its manifest before, and the run."""
    (path,) = shutil.copytree(kills["up", 100], tmp_path_factory.mktemp("ramp") / "out").glob("*/*")
    before = assemble(RunFolder(path))
    result = go_on(path)
    assert result.error is None
    return before, result.run


def segments(run):
    return [(s.name, s.outcome) for s in run.manifest().segments]


@pytest.mark.slow
def test_the_rest_of_the_profile_is_appended_and_marked(cut_ramp):
    _, run = cut_ramp
    (first, ended), (back, settled), *rest = segments(run)
    assert (first, ended, settled) == ("up", "interrupted", "done")
    assert back.startswith("back to ")
    assert rest == [(f"up {RESUMED}", "done"), ("warm", "done"), ("down", "done")]
    assert [s.index for s in run.manifest().segments] == [0, 1, 2, 3, 4]
    assert run.manifest().state == "done"


def test_a_ramp_goes_on_from_where_the_air_was_and_is_not_rewound(cut_ramp):
    before, run = cut_ramp
    data = pd.DataFrame(read_samples(run.data))
    air = data[["time", "chamber_temperature", "segment"]].dropna()
    left_degc = air["chamber_temperature"][air["time"] <= before.duration_s].iloc[-1]
    up_again = air[air["segment"] == 2]
    assert abs(up_again["chamber_temperature"].iloc[0] - left_degc) < 0.6
    assert up_again["chamber_temperature"].iloc[-1] > 28.8
    segment = run.manifest().segments[2]
    assert (segment.target_degc, segment.rate_degc_per_min, segment.direction) == (30.0, 2.0, "heating")


def test_both_parts_stand_on_one_time_base_with_the_gap_left_open(cut_ramp):
    before, run = cut_ramp
    data = read_samples(run.data, "time", "rate")
    time = data["time"][np.isfinite(data["rate"])]
    steps = np.diff(time)
    assert np.all(steps > 0)
    (gap,) = steps[steps > 0.003]
    assert gap == pytest.approx(SIMULATED_GAP_S, abs=1.5)
    assert np.allclose(steps[steps <= 0.003], 0.002)
    assert np.count_nonzero(time <= before.duration_s + 1.0) == pytest.approx(before.rows, abs=1)
    means = pq.read_table(run.means).to_pandas()
    assert np.all(np.diff(means["time"]) > 0)
    assert run.manifest().losses["lost"] == 0
    assert run.manifest().rows == len(data["time"])


def test_what_the_gap_did_is_told(cut_ramp):
    _, run = cut_ramp
    (event,) = [event for event in run.events() if event["kind"] == "gap"]
    assert event["duration_s"] == pytest.approx(SIMULATED_GAP_S, abs=1.5)
    assert event["before"]["on"]
    assert event["before"]["chamber_degc"] == pytest.approx(25.5, abs=2)
    assert not event["after"]["on"]
    assert event["after"]["chamber_degc"] == pytest.approx(23, abs=0.5)
    assert set(event["after"]["units_degc"]) == {"SIM-0001"}
    first, second = run.manifest().parts
    assert first.cause.startswith("the bench was killed")
    assert (second.state, second.gap.unit_power) == ("done", "kept")
    assert {*run.manifest().files} >= {"journal/can0.gtbj", "journal-2/can0.gtbj", "journal-2/bench.gtbj"}


def test_a_run_in_parts_can_be_assembled_again_and_stays_the_same(cut_ramp):
    _, run = cut_ramp
    manifest = run.manifest()
    again = assemble(RunFolder(run.path))
    assert again.files == manifest.files


def test_a_finished_run_is_refused(cut_ramp):
    _, run = cut_ramp
    answer = bench("resume", run.path)
    assert answer.exit_code == 2
    assert answer.stderr.splitlines() == [
        f"bench: {run.path}: this run went to its end: nothing to resume; `bench report` analyses it again"
    ]


@pytest.mark.slow
def test_a_soak_goes_on_for_what_is_left_of_it(killed):
    path = killed("warm", 50)
    run = go_on(path).run
    assert [name for name, _ in segments(run)] == ["up", "warm", f"back to 30 {RESUMED}", f"warm {RESUMED}", "down"]
    cut, rest = run.manifest().segments[1], run.manifest().segments[3]
    assert cut.to_s - cut.from_s + rest.to_s - rest.from_s == pytest.approx(120, abs=2)


@pytest.mark.slow
def test_a_bench_that_was_killed_while_it_opened_a_part_has_left_nothing_there(killed):
    path = killed("warm", 50)
    (path / "journal-2").mkdir()
    (path / "journal-2" / "bench.gtbj").touch()
    run = go_on(path).run
    assert run.part == 3
    assert (run.manifest().state, len(run.manifest().parts)) == ("done", 2)


@pytest.mark.slow
def test_a_run_that_is_killed_again_goes_on_again(killed):
    path = killed("up", 60)

    def look(station, status):
        if status.leg.name.startswith("warm"):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        go_on(path, onlooker=look)
    run = go_on(path).run
    manifest = run.manifest()
    assert (manifest.state, len(manifest.parts)) == ("done", 3)
    names = [name for name, _ in segments(run)]
    assert names[2:4] == [f"up {RESUMED}", "warm"]
    assert names[5:] == [f"warm {RESUMED}", "down"]


@pytest.mark.slow
def test_units_in_one_chamber_go_on_together(tmp_path):
    folders = kill_in(tmp_path, "up", 60, **TWO)
    result = go_on(folders[1], acquisition.station(**TWO))
    assert {unit.serial for unit in result.units} == {"SIM-0001", "SIM-0002"}
    for unit in result.units:
        assert unit.error is None
        assert open_run(unit.run.path).manifest().state == "done"
        assert len(open_run(unit.run.path).manifest().parts) == 2


@pytest.mark.slow
def test_another_unit_than_before_is_refused_before_anything_moves(tmp_path):
    (path,) = kill_in(tmp_path, "up", 60, units=[{"serial": "SIM-0001", "bus": "can0"}])
    settings = acquisition.station(units=[{"serial": "SIM-0001", "bus": "can0"}])
    continuation = plan(RunFolder(path), profile_from_text(PROFILE), settings)
    assert continuation.units(settings).units[0].identity == 1


@pytest.mark.slow
def test_the_command_recovers_goes_on_and_reports(killed):
    path = killed("down", 10)
    (path / remote.LIVE).write_text(json.dumps(
        {"pid": 1, "port": 1, "start": "", "journals": [], "token": "t"}  # what a killed bench leaves behind
    ))  # fmt: skip
    with undiagnosed():
        answer = bench("resume", path, "--json", "--quiet")
    assert answer.exit_code in {0, 1}, answer.stderr
    content = json.loads(answer.stdout)
    assert content["state"] == "done"
    assert not (path / remote.LIVE).exists()
    assert (path / "report.html").is_file()
    assert any("without a record" in text for text in content["warnings"])


def test_an_imported_run_has_nothing_to_resume(tmp_path):
    from tests.support.run_folders import make_run, ramp_run

    folder = make_run(tmp_path / "r", **ramp_run(), state="imported")
    answer = bench("resume", folder)
    assert answer.exit_code == 2
    assert "nothing to resume" in answer.stderr


@pytest.mark.slow
def test_a_watchdog_at_work_is_not_disturbed(killed):
    path = killed("up", 20)
    said = {"t_s": 21.0, "utc": datetime.now(UTC).isoformat(), "kind": "watchdog", "text": "making the equipment safe"}
    (path / "watchdog.jsonl").write_text(json.dumps(said) + "\n")
    with pytest.raises(InputError, match="the watchdog is still making the equipment safe"):
        go_on(path)
    (path / "watchdog.jsonl").write_text(f"{json.dumps(said)}\n{json.dumps({**said, 'took_s': 1.0, 'ok': True})}\n")
    assert plan(RunFolder(path), profile_from_text(PROFILE), acquisition.station()).legs


def executed(name, outcome="done", from_s=0.0, to_s=60.0):
    return ExecutedSegment(name=name, outcome=outcome, from_s=from_s, to_s=to_s)


def names(profile, *done, here=25.0):
    return [leg.name for leg in remaining(profile_from_text(profile), done, here)]


STEPS = "name: s\nsegments:\n  - {kind: step, temperatures_degc: [0, 50]}\n"


@pytest.mark.parametrize(
    ("profile", "done", "left"),
    [
        (PROFILE, [], ["up", "warm", "down"]),
        (PROFILE, [executed("up")], [f"back to 30 {RESUMED}", "warm", "down"]),
        (PROFILE, [executed("up", "held"), executed(f"up {RESUMED}", "interrupted")],
         [f"back to 25 {RESUMED}", f"up {RESUMED}", "warm", "down"]),
        (PROFILE, [executed("up", "timeout"), executed("warm"), executed("down")], []),
        (PROFILE, [executed("up"), executed("warm"), executed("down"), executed(HOME, "interrupted")], []),
        (PROFILE, [executed("up", "interrupted"), executed(HOME), executed(f"up {RESUMED}")],
         [f"back to 30 {RESUMED}", "warm", "down"]),
        (STEPS, [executed("step to 0", "interrupted")],
         [f"step to 0 {RESUMED}", "step at 0", "step to 50", "step at 50"]),
        (STEPS, [executed("step to 0"), executed("step at 0", "interrupted")],
         [f"back to 0 {RESUMED}", f"step at 0 {RESUMED}", "step to 50", "step at 50"]),
        (STEPS, [executed("step to 0"), executed("step at 0")], ["step to 50", "step at 50"]),
    ],
)  # fmt: skip
def test_what_is_left_of_a_profile(profile, done, left):
    assert names(profile, *done) == left


def test_the_time_of_two_interruptions_of_a_soak_adds_up_and_a_hold_starts_it_anew():
    legs = remaining(profile_from_text(PROFILE), [executed("up"), executed("warm", "interrupted", 0, 30),
                                          executed(f"warm {RESUMED}", "interrupted", 100, 140)], 30.0)  # fmt: skip
    assert legs[1].duration_s == pytest.approx(50)
    legs = remaining(profile_from_text(PROFILE), [executed("up"), executed("warm", "held", 0, 30),
                                          executed(f"warm {RESUMED}", "interrupted", 100, 140)], 30.0)  # fmt: skip
    assert legs[1].duration_s == pytest.approx(80)


@pytest.mark.slow
def test_real_time_goes_on_and_a_calendar_clock_that_runs_behind_is_told(killed):
    path = killed("up", 20)
    continuation = plan(RunFolder(path), profile_from_text(PROFILE), acquisition.station())
    later = continuation.zero + timedelta(hours=2)
    assert continuation.start_s(False, later) == pytest.approx(7200)
    behind = continuation.start_s(False, continuation.zero)
    assert behind == continuation.ended_s + 1.0
    from drivers.chamber import ChamberReading

    reading = ChamberReading(behind, 25.0, 25.0, None, None, False, (), None)
    gap = continuation.gap(behind, reading, {"SIM-0001": None})
    assert not gap["duration_known"]
    assert "the calendar clock runs behind" in gap["text"]


def counted(first_index, from_s, drift_ppm=0.0, samples=60_000, resets=0):
    """A part whose unit counts `first_index` at bench time `from_s`."""
    clock = SampleClock(0.002)
    index = first_index + np.arange(0, samples, 500)
    clock.add(index, np.rint((from_s + (index - first_index) * 0.002 * (1 + drift_ppm * 1e-6)) * 1e9).astype(np.int64))
    for i in range(0, len(index), 10):
        t_ns = np.rint((from_s + (index[i] - first_index) * 0.002 * (1 + drift_ppm * 1e-6)) * 1e9).astype(np.int64)
        clock.add(index[i : i + 1], np.array([t_ns]))
    return Counted(samples, resets, clock, 16)


@pytest.mark.parametrize(
    ("first", "at_s", "expected"),
    [
        (round(1000.0 / 0.002) % 65536, 1000.0, "kept"),
        (round(1000.3 / 0.002) % 65536, 1000.0, "kept"),
        (round(1010.0 / 0.002) % 65536, 1000.0, "lost"),
        (0, 1000.0, "lost"),
        (0, 500_000.0, "unknown"),
    ],
)
def test_a_counter_that_went_on_shows_that_the_unit_kept_its_power(first, at_s, expected):
    assert parts.power(counted(0, 0.0), counted(first, at_s), at_s)[0] == expected


def test_a_counter_that_started_anew_before_the_gap_shows_nothing():
    assert parts.power(counted(0, 0.0, resets=1), counted(0, 1000.0), 900.0) == ("unknown", None)
