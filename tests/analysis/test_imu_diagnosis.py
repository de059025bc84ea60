"""What is wrong with an inertial unit, its fixture or its place is named; `benchmarks/imu.py` counts how often."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from bench.analysis.imu import mounting
from bench.analysis.imu.diagnosis import diagnose_imu
from bench.analysis.imu.fitting import fit_imu
from bench.analysis.imu.triad import TriadModel
from benchmarks import imu, imu_data
from drivers.sim.truth.imu.drawn import drawn

LATITUDE = imu_data.LATITUDE_DEG
MODEL = TriadModel()


@lru_cache(maxsize=8)
def measured(seed=3, **errors):
    plan = imu_data.calibration(seed, (-20.0, 20.0, 60.0), 4.0)
    return imu_data.record(drawn(seed), imu_data.at_home(**errors), seed, plan)


def named(gyro, accelerometer):
    wires, orders = mounting.wiring(gyro, accelerometer)
    straight = [mounting.straightened(d, order) for d, order in zip((gyro, accelerometer), orders, strict=True)]
    around = mounting.place(mounting.world(*straight, MODEL), LATITUDE)
    return [(finding.cause, finding.where) for finding in [*wires, *around]]


def test_nothing_is_named_where_nothing_is_wrong():
    gyro, accelerometer = measured()
    assert named(gyro, accelerometer) == []
    assert mounting.turned(fit_imu(gyro, accelerometer)) == []


def test_swapped_outputs_and_wrong_signs_are_named_by_axis_and_undone():
    gyro, accelerometer = measured()
    swapped = replace(gyro, output=gyro.output[:, [0, 2, 1]])
    assert named(swapped, accelerometer) == [("swapped_axes", "gyro y and z")]
    turned_over = replace(accelerometer, output=accelerometer.output * [1.0, -1.0, 1.0])
    assert named(gyro, turned_over) == [("wrong_sign", "accelerometer y")]
    assert np.array_equal(mounting.straightened(swapped, mounting.outputs_of(swapped)).output, gyro.output)
    both = replace(gyro, output=gyro.output[:, [1, 2, 0]] * [1.0, 1.0, -1.0])
    assert [where for cause, where in named(both, accelerometer) if cause == "wrong_sign"] == ["gyro z"]


def test_a_unit_that_stands_in_another_attitude_than_stated_is_no_swapped_output():
    """Both triads are turned by 90 degrees: a rotation, which no wrong wire of one of them makes."""
    gyro, accelerometer = measured()
    turn = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    both = [replace(data, output=data.output @ turn) for data in (gyro, accelerometer)]
    assert named(*both) == [("attitude", "fixture")]


@pytest.mark.parametrize(
    ("error", "cause", "where", "value"),
    [
        ({"fixture_on_table_deg": (0.3, -0.4, 0.0)}, "fixture_rotation", "fixture", "tilted on the table by 0.49"),
        ({"table_tilt_deg": (0.3, -0.4)}, "table_tilt", "table", "leans by 0.49"),
        ({"latitude_deg": LATITUDE - 12.0}, "latitude", "place", "not 47"),
    ],
)
def test_fixture_table_and_place_are_told_apart(error, cause, where, value):
    found = mounting.place(mounting.world(*measured(**error), MODEL), LATITUDE)
    assert [(one.cause, one.where) for one in found] == [(cause, where)]
    assert value in found[0].text


def test_a_unit_turned_in_its_fixture_turns_both_triads_and_one_die_only_one():
    gyro, accelerometer = measured(unit_in_fixture_deg=(0.0, 0.5, 0.0))
    found = mounting.turned(fit_imu(gyro, accelerometer))
    assert [(one.cause, one.look_alikes) for one in found] == [("fixture_rotation", ("misalignment",))]
    _, level = measured()
    assert [one.where for one in mounting.turned(fit_imu(gyro, level))] == ["gyro die"]


def test_gravity_and_table_are_corrected_before_anything_else_is_asked():
    rows = measured(fixture_on_table_deg=(0.3, -0.4, 0.0))
    found = mounting.world(*rows, MODEL)
    gyro, accelerometer = (mounting.believed(data, found, mounting.place(found, LATITUDE)) for data in rows)
    level_gyro, level_accelerometer = fit_imu(gyro, accelerometer).triads
    true = dict(imu_data.truth(drawn(3), "accelerometer", 20.0)) | dict(imu_data.truth(drawn(3), "gyro", 20.0))
    for one in (*level_gyro.estimates([20.0]), *level_accelerometer.estimates([20.0])):
        if one.kind == "misalignment":
            assert abs(one.value - true[one.name]) < 2.5 * one.U + 0.03, one


def test_a_hidden_effect_is_named_with_its_axis_and_one_of_several_axes_with_their_die():
    settings = drawn(2)
    hidden = ({"lag_s": 60.0}, {"loop": 25.0}, {"lag_s": 60.0})
    gyros = tuple(gyro.model_copy(update=own) for gyro, own in zip(settings.gyros, hidden, strict=True))
    plan = imu_data.calibration(2, (-20.0, 20.0, 60.0), 4.0)
    data = imu_data.record(settings.model_copy(update={"gyros": gyros}), imu_data.at_home(), 2, plan)
    found = diagnose_imu(*data, LATITUDE)
    assert set(found.causes) == {("thermal_lag", "gyro die"), ("hysteresis", "gyro y")}
    assert "axes x, z lack the same thermal_lag" in " ".join(one.text for one in found.findings)


def test_a_campaign_counts_what_is_named_against_its_bar():
    found = {"fault": "latitude", "wanted": "latitude", "named": [["latitude", "place"]], "told": []}
    results = [(imu.Case("around", 4), found), (imu.Case("around", 9), {**found, "named": []})]
    row = next(row for row in imu.table(results) if row["what"] == "latitude")
    assert (row["n"], row["right"], row["missed"]) == (2, 1, True)
