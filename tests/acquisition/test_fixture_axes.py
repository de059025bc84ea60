"""Driven axes of a fixture: which attitudes they reach, how they get there, and what the run says of it."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bench.acquisition.station.settings.axes import AxisSettings, positions
from bench.acquisition.station.settings.station import StationSettings
from bench.base import InputError, load_config, parse_yaml, read_yaml
from bench.record import ATTITUDES

SHIPPED = Path(__file__).parents[2] / "profiles" / "stations" / "imu.yaml"
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
