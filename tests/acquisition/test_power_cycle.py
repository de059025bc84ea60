"""A profile switches its units off and on: planned gaps, a new turn-on each, and no silence is taken for a fault."""

import json
import re

import numpy as np
import pytest

from bench.acquisition.profile import preflight
from bench.acquisition.profile.profile import profile_from_text
from bench.acquisition.recording.assemble import assemble
from bench.acquisition.run.runner import run_job
from bench.acquisition.station.powering import UnitPower
from bench.acquisition.station.settings.station import StationSettings
from bench.analysis.judging.completeness import completeness
from bench.analysis.judging.quantities import of_data
from bench.base import load_config, parse_yaml
from bench.record import RunFolder, averaged, load, open_run, seconds_of
from bench.record.samples import read_samples
from drivers.clock import SimClock
from tests.support import acquisition
from tests.support.commands import bench

CYCLES = """\
name: cycles
settle: {band_degc: 1, unit_band_degc: 5, slope_degc_per_min: 20, dwell_min: 0.3, timeout_min: 5}
segments:
  - {kind: soak, duration_min: 0.5, name: first}
  - kind: repeat
    times: 2
    segments:
      - {kind: power_cycle, off_min: 1, on_min: 0.5}
"""
REAL = """\
name: real
settle: {band_degc: 2, unit_band_degc: 8, slope_degc_per_min: 20, dwell_min: 0.02, timeout_min: 5}
segments:
  - {kind: soak, duration_min: 0.05}
  - {kind: power_cycle, off_min: 0.08}
"""
QUIET = {
    "truth": [{"mechanism": "turn_on", "sigma_dph": 100.0}],
    "noise": {"angle_random_walk": 0.0, "bias_instability": 0.0, "rate_random_walk": 0.0},
}
UNIT = {"serial": "SIM-0001", "bus": "can0", "number": 0, "identity": 1, "simulation": QUIET}


def test_no_sample_is_missing_for_want_of_power(run):
    done = completeness(run, run.manifest(), averaged(seconds_of(run.path), 1.0, whole=True))
    known = {quantity.name: quantity.value for quantity in of_data(done)}
    assert done.counts()["missing"] <= 4  # at the edges of two cycles
    assert known["samples_missing_ppm"] < 200
    assert re.search(r", [0-4] missing,", done.counted)


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    out = tmp_path_factory.mktemp("cycles")
    settings = acquisition.station(units=[UNIT]).remembering(out)
    result = run_job(acquisition.job(out, CYCLES, settings))
    assert result.error is None
    return open_run(result.run.path)


def test_each_power_on_is_a_turn_on_of_its_own_that_the_data_carry(run):
    manifest = run.manifest()
    names = [(segment.name, segment.kind, segment.turn_on) for segment in manifest.segments]
    assert names == [
        ("first", "soak", 1),
        ("power cycle at 23", "power_cycle", 2),
        ("power cycle at 23: settle", "soak", 2),
        ("power cycle at 23 (2)", "power_cycle", 3),
        ("power cycle at 23: settle (2)", "soak", 3),
    ]
    data = load(run.path, 5.0)
    means = [np.nanmean(data.bias[data.turn_on == number]) for number in (1, 2, 3)]
    assert np.ptp([np.nanstd(data.bias[data.turn_on == number]) for number in (1, 2, 3)]) < 0.1
    assert np.min(np.abs(np.diff(np.sort(means)))) > 1.0
    assert (run.path.parents[1] / ".units.SIM-0001.power_ons").read_text() == "3\n"


def test_what_is_missing_while_the_power_is_off_is_planned_and_not_lost(run):
    manifest = run.manifest()
    assert {
        name: manifest.losses[name] for name in ("lost", "slow_lost", "resets", "corrupt", "late")
    } == dict.fromkeys(("lost", "slow_lost", "resets", "corrupt", "late"), 0)
    assert manifest.left_out == ()
    data = read_samples(run.data, "time", "rate")
    time = data["time"][np.isfinite(data["rate"])]
    steps = np.diff(time)
    assert np.sort(steps)[-2:] == pytest.approx([60.0, 60.0], abs=1.5)
    assert np.count_nonzero(steps > 0.003) == 2
    kinds = [(event["kind"], event.get("on")) for event in run.events() if event["kind"] == "power"]
    assert kinds == [("power", False), ("power", True)] * 2
    assert not [event for event in run.events() if event["kind"] in {"dropped", "guard", "unit"}]


def test_the_journals_make_the_same_tables_again(run):
    before = run.manifest()
    again = assemble(RunFolder(run.path))
    assert again.files == before.files
    assert again.losses == before.losses


def test_seconds_in_which_the_power_is_switched_are_in_no_fit(run):
    data, seconds = load(run.path, 1.0), seconds_of(run.path)
    cycled = [segment.index for segment in seconds.segments if segment.kind == "power_cycle"]
    assert np.any(np.isin(seconds.segment, cycled) & np.isfinite(seconds.channel("rate")))
    assert not np.any(np.isin(data.segment, cycled))


def test_a_station_without_a_supply_refuses_the_profile_in_one_line(tmp_path):
    content = acquisition.station_content()
    del content["instruments"]
    (tmp_path / "station.yaml").write_text(json.dumps(content))
    (tmp_path / "cycles.yaml").write_text(CYCLES)
    arguments = [str(tmp_path / "cycles.yaml"), "--station", str(tmp_path / "station.yaml")]
    for command in ("check", "run"):
        answer = bench(command, *arguments)
        assert answer.exit_code == 2
        assert answer.stderr.splitlines() == [
            f"bench: {tmp_path / 'cycles.yaml'}:8: power cycle at 23: switches the units' power, but the station has "
            "no supply that the bench can switch; name a station with an instrument that has `powers_units`, or leave "
            "the segment out"
        ]


def test_check_shows_and_times_power_cycles(tmp_path):
    (tmp_path / "cycles.yaml").write_text(CYCLES)
    answer = bench("check", tmp_path / "cycles.yaml")
    assert answer.exit_code == 0, answer.output
    assert "2 power cycle(s), 0 h 02 min without power: 3 turn-ons in one run" in answer.output
    assert "power " in preflight.profile_picture(profile_from_text(CYCLES))
    content = json.loads(bench("check", tmp_path / "cycles.yaml", "--json").stdout)
    cycle = next(segment for segment in content["segments"] if segment["name"] == "power cycle at 23")
    assert cycle["to_s"] - cycle["from_s"] == pytest.approx(60, abs=8)


@pytest.mark.parametrize(
    ("entry", "said"),
    [
        ("{kind: power_cycle}", "off_min"),
        ("{kind: power_cycle, off_min: 0}", "off_min"),
        ("{kind: power_cycle, off_min: 1, turn_dps: 3}", "turn_dps"),
    ],
)
def test_a_wrong_power_cycle_is_refused_with_its_line(tmp_path, entry, said):
    (tmp_path / "wrong.yaml").write_text(f"name: wrong\nsegments:\n  - {entry}\n")
    answer = bench("check", tmp_path / "wrong.yaml")
    assert answer.exit_code == 2
    assert f"{tmp_path / 'wrong.yaml'}:3" in answer.stderr
    assert said in answer.stderr


def test_a_unit_that_has_its_power_from_elsewhere_ends_the_run(world, tmp_path):
    def look(station, status):
        for unit in world[0].units:
            unit.advance = lambda environment, unit=unit: unit.wire.send(
                environment.t0_s, unit.physics.advance(environment)
            )

    result = run_job(acquisition.job(tmp_path, CYCLES), look)
    assert "unit SIM-0001 still sends 2 s after the supply was switched off" in str(result.error)
    assert world[0].instruments["supply"].on


def test_a_unit_that_does_not_come_back_ends_the_run(world, tmp_path):
    def look(station, status):
        if status.leg.kind == "power_cycle":
            for unit in world[0].units:
                unit.advance = lambda environment: None

    result = run_job(acquisition.job(tmp_path, CYCLES), look)
    assert "unit SIM-0001 is not heard 30 s after its power came on" in str(result.error)


def test_a_run_that_is_stopped_without_power_leaves_it_on(world, tmp_path):
    def look(station, status):
        if status.leg.kind == "power_cycle" and not world[0].instruments["supply"].on:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_job(acquisition.job(tmp_path, CYCLES), look)
    assert world[0].instruments["supply"].server.told[-2:] == ["OUTP ON", "OUTP?"]


def test_a_profile_without_power_cycles_leaves_the_supply_alone(world, tmp_path):
    assert run_job(acquisition.job(tmp_path)).error is None
    assert world[0].instruments == {}


def test_the_event_comes_before_the_power(run):
    """A unit may send before its supply has confirmed: tables made from the journals must know by then."""
    said = []

    class Supply:
        def switch(self, on):
            said.append(("switched", on))

    class Told:
        def event(self, kind, text, **facts):
            said.append((kind, facts["on"]))

    UnitPower(Supply(), SimClock(), Told()).switch_on()
    assert said == [("power", True), ("switched", True)]


@pytest.mark.slow
def test_power_cycles_of_another_process_lose_nothing(tmp_path):
    """`bench sim` on one side, a real station on the other, in real time: only planned gaps."""
    with acquisition.elsewhere(acquisition.station()) as served:
        text = served.station_yaml()
        settings = load_config(parse_yaml(text, "remote.yaml"), StationSettings)
        result = run_job(acquisition.job(tmp_path, REAL, settings))
    assert result.error is None
    manifest = open_run(result.run.path).manifest()
    assert [segment.turn_on for segment in manifest.segments] == [1, 2, 2]
    assert (manifest.losses["resets"], manifest.losses["invalid"]) == (0, 0)
    assert manifest.losses["lost"] < 500  # of a machine that is busy; a gap that is not planned would be 2000
