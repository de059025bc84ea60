"""Each power-on of a simulated unit is a new draw: never the same twice, and the same for the same history."""

import json

import numpy as np
import pytest

from bench.acquisition.profile.profile import profile_from_text
from bench.acquisition.run.continuation import plan
from bench.acquisition.run.runner import Job, run_job
from bench.acquisition.station.settings.station import StationSettings
from bench.base import load_config, read_yaml
from bench.record import RunFolder, open_run, seconds_of
from drivers.errors import ConfigError
from drivers.sim.resonator import UnitSettings as GyroPhysics
from drivers.sim.resonator import default_unit
from tests.support import acquisition

BRIEF = """\
name: brief
segments:
  - {kind: soak, duration_min: 0.1}
  - {kind: soak, duration_min: 0.1, name: second}
"""
QUIET = {
    "truth": [{"mechanism": "turn_on", "sigma_dph": 100.0}],
    "noise": {"angle_random_walk": 0.0, "bias_instability": 0.0, "rate_random_walk": 0.0},
}
UNITS = [
    {"serial": serial, "bus": "can0", "number": number, "identity": number + 1, "simulation": QUIET}
    for number, serial in enumerate(("SIM-0001", "SIM-0002"))
]
ONE = {"units": UNITS[:1]}


def settings(out, **changes):
    return acquisition.station(**{**ONE, **changes}).remembering(out)


def turn_on(folder, out, text=BRIEF, **changes):
    """Mean rate of a run [deg/h] below `folder`, of a unit that remembers below `out`."""
    result = run_job(acquisition.job(folder, text, settings(out, **changes)))
    assert result.error is None
    return mean_of(result.run.path)


def mean_of(path):
    rate = seconds_of(path).channel("rate")
    rate = rate[np.isfinite(rate)]
    assert np.ptp(rate) < 1.0  # the resolution of the frame
    return float(rate.mean())


def test_a_run_that_is_repeated_draws_anew_and_another_archive_repeats_the_history(tmp_path):
    history = [turn_on(tmp_path / "a" / str(n), tmp_path / "a") for n in range(4)]
    assert np.min(np.abs(np.diff(np.sort(history)))) > 2.0
    again = [turn_on(tmp_path / "b" / str(n), tmp_path / "b") for n in range(3)]
    assert again == history[:3]


def test_all_profiles_count_and_each_unit_counts_for_itself(tmp_path):
    other = BRIEF.replace("brief", "other")
    firsts = turn_on(tmp_path / "1", tmp_path), turn_on(tmp_path / "2", tmp_path, other)
    alone = turn_on(tmp_path / "3", tmp_path / "fresh", other)
    assert firsts[1] != alone
    result = run_job(acquisition.job(tmp_path / "4", BRIEF, settings(tmp_path, units=UNITS)))
    assert [open_run(unit.run.path).manifest().power_on for unit in result.units] == [3, 1]


def test_a_run_that_goes_on_continues_its_power_on(tmp_path):
    """Another run has powered the unit since; the record that goes on is still that of its own power-on."""
    stations = settings(tmp_path)

    def look(station, status):
        if status.leg.name == "second":
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_job(acquisition.job(tmp_path / "cut", BRIEF, stations), look)
    (path,) = (tmp_path / "cut").glob("*/*")
    before = mean_of(path)
    assert turn_on(tmp_path / "between", tmp_path) != pytest.approx(before, abs=2.0)
    continuation = plan(RunFolder(path), profile_from_text(BRIEF), stations)
    text = json.dumps(acquisition.station_content(**ONE))
    job = Job(profile_from_text(BRIEF), BRIEF, stations, text, {}, continuation.serials, continuation=continuation)
    run = run_job(job).run
    assert mean_of(run.path) == pytest.approx(before, abs=0.2)
    manifest = open_run(run.path).manifest()
    assert (manifest.power_on, manifest.parts[1].gap.unit_power) == (1, "kept")
    assert turn_on(tmp_path / "after", tmp_path) != pytest.approx(before, abs=2.0)


def test_the_noise_of_a_repeated_run_is_its_own(tmp_path):
    noisy = [{**UNITS[0], "simulation": {"truth": []}}]
    runs = [run_job(acquisition.job(tmp_path / str(n), BRIEF, settings(tmp_path, units=noisy))).run for n in range(2)]
    first, second = (seconds_of(run.path).channel("rate") for run in runs)
    size = min(len(first), len(second))
    assert np.nanmin(np.abs(first[:size] - second[:size])) > 0.0


def test_a_count_that_is_none_is_refused_in_one_line(tmp_path):
    (tmp_path / ".units.SIM-0001.power_ons").write_text("many")
    with pytest.raises(ConfigError, match=r"SIM-0001\.power_ons: must hold how often .* not b'many'; delete it"):
        turn_on(tmp_path / "1", tmp_path)
    assert not (tmp_path / "1").exists()


def test_the_four_units_of_the_shipped_station_have_truths_of_their_own():
    four = load_config(read_yaml(acquisition.STATION.with_name("four_units.yaml")), StationSettings).units
    assert four[0].simulation is None  # the unit of the embedded station
    others = [GyroPhysics.parse(unit.simulation) for unit in four[1:]]
    biases = [next(m.coefficients_dph for m in physics.truth if m.mechanism == "static_bias") for physics in others]
    assert len({*biases}) == 3
    assert len({physics.noise for physics in others} | {default_unit().noise}) == 4
    lags = [m.tau_s for physics in others for m in physics.truth if m.mechanism == "thermal_lag"]
    assert any(60 < lag <= 600 for lag in lags)
