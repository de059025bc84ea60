"""The Earth rate along the axis is removed where latitude, axis and azimuth are stated, and nothing where they are not.

The truth is the scalar product of two vectors in the simulator; the bench has the formulas of the facts.
"""

import json

import numpy as np
import pytest
from scipy.integrate import quad

from bench.acquisition.profile.orientation import OrientationSettings, stated
from bench.acquisition.run.runner import run_job
from bench.analysis.fit.samples import Samples
from bench.record import EARTH_DPH, Orientation, earth_rate, load, open_run, seconds_of
from bench.web.workbench.zoom import view
from tests.support import acquisition
from tests.support.commands import bench

SILENT = {"angle_random_walk": 0.0, "bias_instability": 0.0, "rate_random_walk": 0.0}
STILL = "name: still\nsegments:\n  - {kind: soak, duration_min: 1}\n"
PLACES = [
    ({"latitude_deg": 48.0, "axis": "level", "azimuth_deg": 0.0}, {"latitude_deg": 48.0}),
    ({"latitude_deg": -33.0, "axis": "level", "azimuth_deg": 250.0}, {"latitude_deg": -33.0, "azimuth_deg": 250.0}),
    ({"latitude_deg": 48.0, "axis": "vertical"}, {"latitude_deg": 48.0, "elevation_deg": 90.0}),
    ({"latitude_deg": 60.0, "axis": "vertical_down"}, {"latitude_deg": 60.0, "elevation_deg": -90.0}),
]


def unit(**truth):
    simulation = {"truth": [{"mechanism": "earth_rate", **truth}], "noise": SILENT}
    return [{"serial": "SIM-0001", "bus": "can0", "number": 0, "identity": 1, "simulation": simulation}]


@pytest.mark.parametrize(("orientation", "truth"), PLACES)
def test_a_stated_orientation_takes_the_earth_rate_out_of_the_bias(tmp_path, orientation, truth):
    settings = acquisition.station(units=unit(**truth), orientation=orientation)
    run = open_run(run_job(acquisition.job(tmp_path, STILL, settings)).run.path)
    data = load(run.path, 10.0)
    assert np.nanmax(np.abs(data.bias)) < 0.5 * run.manifest().rate_step_dph
    assert np.nanmean(data.channel("rate")) == pytest.approx(np.nanmean(data.channels["earth_rate"]), abs=0.2)
    assert run.manifest().orientation.content() == orientation
    every = np.concatenate([batch.y for batch in Samples(run.data).read([])])  # what a fit to every sample sees
    assert np.nanmax(np.abs(every)) < run.manifest().rate_step_dph
    shown = view(seconds_of(run.path), run.data, (None, None), 10, None)
    assert np.nanmax(np.abs(shown.bias)) < run.manifest().rate_step_dph


def test_without_an_orientation_nothing_is_removed(tmp_path):
    settings = acquisition.station(units=unit(latitude_deg=48.0))
    run = open_run(run_job(acquisition.job(tmp_path, STILL, settings)).run.path)
    expected = EARTH_DPH * np.cos(np.radians(48.0))
    assert np.nanmean(load(run.path, 10.0).bias) == pytest.approx(expected, abs=0.2)
    assert run.manifest().orientation is None


def test_what_a_profile_states_takes_the_place_of_the_station(tmp_path):
    settings = acquisition.station(
        units=unit(latitude_deg=30.0, elevation_deg=90.0),
        orientation={"latitude_deg": 30.0, "axis": "level", "azimuth_deg": 0.0},
    )
    text = STILL + "orientation: {axis: vertical}\n"
    run = open_run(run_job(acquisition.job(tmp_path, text, settings)).run.path)
    assert np.nanmax(np.abs(load(run.path, 10.0).bias)) < 0.5 * run.manifest().rate_step_dph


def test_a_level_axis_on_a_turning_table_sees_the_mean_over_its_arc():
    """Against the integral of the cosine, by scipy."""
    orientation = Orientation(latitude_deg=50.0, axis="level", azimuth_deg=20.0)
    time, rate = np.arange(0.5, 60.0, 1.0), np.where(np.arange(60) >= 10, 37.0, 0.0)
    seen = earth_rate(orientation, time, rate)
    size = EARTH_DPH * np.cos(np.radians(50.0))
    for row in (5, 30, 59):
        turned = np.trapezoid(rate[: row + 1], time[: row + 1])
        arc = quad(lambda t, t0=turned, r=rate[row]: np.cos(np.radians(20.0 - t0 - r * t)), -0.5, 0.5)[0]
        assert seen[row] == pytest.approx(size * arc, abs=1e-9)
    vertical = Orientation(latitude_deg=50.0, axis="vertical")
    assert earth_rate(vertical, time, rate) == pytest.approx(EARTH_DPH * np.sin(np.radians(50.0)))


def test_an_orientation_is_complete_or_says_what_is_missing():
    station = OrientationSettings(latitude_deg=48.0)
    assert stated(None, None) == (None, ("latitude_deg", "axis", "azimuth_deg"))
    assert stated(station, None) == (None, ("axis", "azimuth_deg"))
    assert stated(station, OrientationSettings(axis="level")) == (None, ("azimuth_deg",))
    found, missing = stated(station, OrientationSettings(axis="vertical"))
    assert (found.axis, missing) == ("vertical", ())


@pytest.mark.parametrize(
    ("orientation", "said"),
    [
        (None, "info: Earth rate: part of the bias, not removed"),
        ({"latitude_deg": 48}, "warning: Earth rate: part of the bias, not removed; `orientation` of station"),
        (
            {"latitude_deg": 48, "axis": "level", "azimuth_deg": 0},
            "info: Earth rate: 10.0644 deg/h along the axis (latitude 48 deg, axis level, azimuth 0 deg) is removed",
        ),
    ],
)  # fmt: skip
def test_check_states_what_is_removed(tmp_path, orientation, said):
    content = acquisition.station_content(**({} if orientation is None else {"orientation": orientation}))
    (tmp_path / "station.yaml").write_text(json.dumps(content))
    (tmp_path / "still.yaml").write_text(STILL)
    answer = bench("check", f"{tmp_path}/still.yaml", "--station", f"{tmp_path}/station.yaml")
    assert answer.exit_code == 0
    assert said in answer.output


@pytest.mark.parametrize(
    ("orientation", "said"),
    [
        ({"latitude_deg": 91, "axis": "vertical"}, "latitude_deg"),
        ({"latitude_deg": 48, "axis": "vertical", "azimuth_deg": 10}, "a vertical axis has no azimuth"),
        ({"latitude_deg": 48, "axis": "sideways"}, "axis"),
    ],
)
def test_a_wrong_orientation_is_refused_in_one_line(tmp_path, orientation, said):
    (tmp_path / "station.yaml").write_text(json.dumps(acquisition.station_content(orientation=orientation)))
    (tmp_path / "still.yaml").write_text(STILL)
    answer = bench("check", f"{tmp_path}/still.yaml", "--station", f"{tmp_path}/station.yaml")
    assert answer.exit_code == 2
    assert said in answer.stderr
    assert len(answer.stderr.splitlines()) == 1
