"""Driven axes of a fixture: which attitudes they reach, how they get there, and what the run says of it."""

import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bench.acquisition.run.runner import run_job
from bench.acquisition.station.settings.axes import AxisSettings, positions
from bench.acquisition.station.settings.station import StationSettings
from bench.analysis.imu.plan import RunOptions
from bench.analysis.imu.runs import _plan
from bench.base import InputError, load_config, parse_yaml, read_yaml
from bench.record import ATTITUDES, seconds_of
from drivers.canopen_axis import CanopenAxis
from drivers.errors import RefusedError
from tests.acquisition.test_attitudes import SHIPPED, attitude_events
from tests.support import acquisition

EAST, NORTH, UP = (1, 0, 0), (0, 1, 0), (0, 0, 1)


def axis(about, node=6, **others):
    content = {"bus": "can1", "node": node, "counts_per_degree": 10_000, "about": about, "speed_dps": 30}
    return content | {"accel_dps2": 20} | others


def settings(*abouts, **others):
    return [AxisSettings(**axis(about, **others)) for about in abouts]


def held(axes, zero, degrees):
    """The matrix from the frame to the units, by a library that the solver does not use."""
    turned = Rotation.identity()
    for one, angle in zip(axes, degrees, strict=True):
        turned = turned * Rotation.from_rotvec(np.radians(angle) * np.asarray(one.direction))
    return zero.matrix @ turned.inv().as_matrix()


@pytest.mark.parametrize("zero", ["z_up", "x_down", "+x-y_up"])
@pytest.mark.parametrize("abouts", [(EAST, NORTH, UP), (UP, EAST, UP), (NORTH, (1, 0, 1), EAST)])
def test_three_axes_hold_every_attitude_with_its_heading(abouts, zero):
    axes = settings(*abouts)
    reached = {}
    for name, attitude in ATTITUDES.items():
        if found := positions(axes, ATTITUDES[zero], attitude):
            reached[name] = held(axes, ATTITUDES[zero], found.degrees)
            assert found.heading_deg == 0.0
            assert reached[name] == pytest.approx(attitude.matrix, abs=1e-7), name
    if (1, 0, 1) not in abouts:  # axes that are not perpendicular do not reach everything
        assert reached.keys() == ATTITUDES.keys()


@pytest.mark.parametrize("abouts", [(EAST, NORTH), (NORTH, (1, 0, 2)), (EAST, UP)])
def test_two_axes_hold_the_direction_upwards_and_say_the_heading(abouts):
    axes, zero = settings(*abouts), ATTITUDES["z_up"]
    for name, attitude in ATTITUDES.items():
        if found := positions(axes, zero, attitude):
            matrix = held(axes, zero, found.degrees)
            turned = Rotation.from_euler("z", -found.heading_deg, degrees=True).as_matrix()
            assert matrix == pytest.approx(attitude.matrix @ turned, abs=1e-7), name
    if abouts[1] != (1, 0, 2):
        assert all(positions(axes, zero, attitude) for attitude in ATTITUDES.values())


def test_positions_stay_within_the_range_of_an_axis():
    axes = settings(EAST, NORTH, from_deg=-100, to_deg=100)
    for attitude in ATTITUDES.values():
        if found := positions(axes, ATTITUDES["z_up"], attitude):
            assert all(-100 <= angle <= 100 for angle in found.degrees)
    assert positions(settings(EAST, NORTH, from_deg=-80, to_deg=80), ATTITUDES["z_up"], ATTITUDES["z_down"]) is None


AXES = [axis(EAST, 6), axis(NORTH, 7)]
OVER = """\
name: over
settle: {unit_band_degc: 15, slope_degc_per_min: 2, dwell_min: 0.2}
segments:
  - {kind: soak, duration_min: 0.2, attitude: x_up}
  - {kind: tumble, attitudes: [x_up, -x-y_up], dwell_min: 0.2}
  - {kind: rate, rates_dps: [30], dwell_s: 10}
"""


def station(fixture, **others):
    content = dict(read_yaml(SHIPPED).content) | others
    content["fixture"] = {"attitudes": 24, "axes": AXES} | fixture
    return load_config(parse_yaml(json.dumps(content), "station.yaml"), StationSettings)


def test_of_a_tumble_what_the_axes_reach_is_offered():
    assert len(station({}).limits().fixture.attitudes) == 24
    few = station({"axes": [axis(EAST, 6, from_deg=-95, to_deg=95), axis(NORTH, 7, from_deg=-30, to_deg=30)]})
    assert set(few.limits().fixture.attitudes) == {"z_up", "y_up", "y_down", "-y+z_up", "+y+z_up"}


@pytest.mark.parametrize(
    ("fixture", "said"),
    [
        ({"axes": AXES[:1]}, "one axis is not enough"),
        ({"axes": [axis(EAST, 6), axis(EAST, 7)]}, "the axes reach none of the attitudes from x_up"),
        ({"axes": [axis(EAST, 6), axis((0, 0, 0), 7)]}, "allowed are three numbers that are not all 0"),
        ({"operator": "simulated"}, "driven axes turn by themselves"),
        ({"axes": [axis(EAST, 6), axis(NORTH, 6)]}, "node 6 stands twice on can1"),
        ({"axes": [axis(EAST, 5), axis(NORTH, 6)]}, "node 5 stands twice on can1"),
        ({"axes": [axis(EAST, 6, bus="can0"), axis(NORTH, 7)]}, "units are on can0, too"),
        ({"axes": [axis(EAST, 6, bus="can7"), axis(NORTH, 7)]}, "bus 'can7' is not in this station"),
        (
            {
                "attitudes": ["z_up", "z_down"],
                "axes": [axis(EAST, 6, from_deg=-90, to_deg=90), axis(NORTH, 7, from_deg=-9, to_deg=9)],
            },
            "the axes do not reach z_down",
        ),
    ],
)
def test_axes_that_cannot_be_are_refused(fixture, said):
    with pytest.raises(InputError, match=said):
        station({"zero": "x_up" if "none" in said else "z_up"} | fixture)


def test_the_drives_bring_the_units_there_and_the_run_says_with_which_heading(tmp_path):
    result = run_job(acquisition.job(tmp_path, OVER, station({})))
    assert result.error is None
    run = result.run
    assert [event["who"] for event in attitude_events(run)] == ["the fixture's drives"] * 2
    assert all(event["off_deg"]["IMU-0001"] < 2 for event in attitude_events(run))
    segments = run.manifest().segments
    data, gravity = seconds_of(run.path), 9.80620
    for segment in segments:
        inside = (data.time > segment.from_s + 1) & (data.time < segment.to_s - 1)
        seen = [np.nanmean(data.channels[f"acceleration_{axis}"][inside]) for axis in "xyz"]
        assert seen == pytest.approx(gravity * ATTITUDES[segment.attitude].matrix[:, 2], abs=0.3)
    # The heading is what the axes give: the rows of a fit stand in this attitude.
    plan = _plan(run.path, data, run.manifest(), RunOptions())
    fixture = station({}).fixture
    for stay in plan.stays:
        held_in = held(fixture.axes, ATTITUDES["z_up"], fixture.position(stay.attitude).degrees)
        assert stay.placed.matrix == pytest.approx(held_in, abs=1e-6)
    assert any(stay.heading_deg != 0 for stay in plan.stays)
    steps = [e["text"] for e in map(json.loads, (run.path / "events.jsonl").read_text().splitlines())
             if e["kind"] == "safe_state"]  # fmt: skip
    assert sum(step.startswith("fixture axis") for step in steps) == 6


def test_a_drive_that_fails_on_the_way_ends_the_run_in_the_safe_state(tmp_path, monkeypatch):
    go = CanopenAxis.go

    def jammed(self, position_deg):
        go(self, position_deg)
        raise RefusedError(f"{self}: drive fault 0x8611; find the cause and reset it at the drive", 0x8611)

    monkeypatch.setattr(CanopenAxis, "go", jammed)
    result = run_job(acquisition.job(tmp_path, OVER, station({})))
    assert "fixture axis node 6: drive fault 0x8611" in str(result.error)
    events = [json.loads(line) for line in (result.run.path / "events.jsonl").read_text().splitlines()]
    safe = [event for event in events if event["kind"] == "safe_state"]
    assert [event["text"].split(":")[0] for event in safe if "axis" in event["text"]][:1] == ["fixture axis quick stop"]
    assert all(event["ok"] for event in safe)
