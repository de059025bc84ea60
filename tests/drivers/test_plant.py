"""The chamber's physics against the printed figures of a real chamber and against closed forms.

Outside check: TestEquity 107 operation manual, p. 7-1 (performance) and p. 8-4 (acceptance test).
"""

import math

import numpy as np
import pytest
from pydantic import ValidationError

from drivers.sim.plant import Plant, PlantParameters, net_cooling_w

EMPTY = PlantParameters(fixture_w_per_k=0.0, case_heat_w=0.0)
QUIET = PlantParameters(disturbance_k=0.0, sensor_noise_k=0.0, sensor_step_k=0.0)
PULL_DOWN_MIN = {
    23.0: {0: 7, -10: 11, -20: 15, -30: 19, -35: 23, -40: 30},
    85.0: {23: 13, 0: 20, -10: 24, -20: 28, -30: 32, -35: 36, -40: 45},
}
"""Minutes of full cooling from a start to a temperature [degC], manual p. 7-1."""


def record(parameters, start, setpoint, minutes, ramp=None, seed=1):
    """States over time, each second."""
    plant = Plant(parameters, seed, start_degc=start)
    return [plant.step(1.0, setpoint, True, ramp) for _ in range(int(60 * minutes))]


def values(states, name="process_value"):
    return np.array([getattr(state, name) for state in states])


def test_pull_down_times_of_the_empty_chamber_are_those_printed_in_the_manual():
    errors = []
    for start, printed in PULL_DOWN_MIN.items():
        pv = values(record(EMPTY, start, -70.0, 60))
        errors += [np.argmax(pv <= mark) / 60.0 - minutes for mark, minutes in printed.items()]
    assert len(errors) == 13
    assert np.sqrt(np.mean(np.square(errors))) < 1.2  # minutes; 1.13 at the time of writing
    assert np.max(np.abs(errors)) < 3.0


def test_live_load_at_the_printed_temperatures():
    assert [net_cooling_w(t) for t in (23.0, 0.0, -30.0, -40.0)] == [200.0, 155.0, 100.0, 35.0]
    assert net_cooling_w(-60.0) == 0.0
    assert net_cooling_w(150.0) == net_cooling_w(130.0)


def test_another_chamber_goes_as_low_as_its_cooling_lets_it():
    two_stage = PlantParameters(net_cooling_w=((-72.0, 0.0), (-40.0, 210.0), (23.0, 380.0)))
    assert values(record(two_stage, 0.0, -55.0, 60))[-600:].mean() == pytest.approx(-55.0, abs=0.1)
    assert values(record(PlantParameters(), 0.0, -55.0, 60)).min() > -46.0
    assert (two_stage.reach, PlantParameters().reach) == ((-72.0, 23.0), (-45.0, 130.0))
    with pytest.raises(ValidationError, match=r"must rise from pair to pair; -40 follows 23 degC"):
        PlantParameters(net_cooling_w=((23.0, 380.0), (-40.0, 210.0)))
    with pytest.raises(ValidationError, match="cooling cannot be negative"):
        PlantParameters(net_cooling_w=((-40.0, -1.0),))


def test_full_heating_near_ambient_is_8_5_degrees_a_minute():
    pv = values(record(EMPTY, 23.0, 130.0, 5))
    seconds = np.argmax(pv >= 45.0) - np.argmax(pv >= 30.0)
    assert 15.0 / (seconds / 60.0) == pytest.approx(8.5, rel=0.1)


@pytest.mark.parametrize("parameters", [EMPTY, PlantParameters()], ids=["empty", "loaded"])
@pytest.mark.parametrize(
    ("start", "target", "beyond", "steady"), [(23.0, 85.0, 0.5, 0.3), (85.0, 23.0, 1.0, 0.5), (23.0, -40.0, 1.0, 0.3)]
)
def test_acceptance_test_of_the_manual_is_passed(parameters, start, target, beyond, steady):
    pv = values(record(parameters, start, target, 90))
    assert np.max((pv - target) * math.copysign(1.0, target - start)) <= beyond
    assert np.max(np.abs(pv[-1800:] - target)) <= steady + 1e-9
    assert np.std(pv[-1800:] - target) < 0.2


@pytest.mark.parametrize("rate", [1.0, 2.0])
@pytest.mark.parametrize(("start", "target"), [(-30.0, 80.0), (80.0, -30.0)])
def test_native_ramp_is_tracked_within_a_kelvin_on_average(start, target, rate):
    states = record(PlantParameters(), start, target, 110.0 / rate, rate)
    working = values(states, "working_setpoint")
    assert working[59] == pytest.approx(start + math.copysign(rate, target - start))
    assert working[-1] == pytest.approx(target)
    assert np.mean(np.abs(working - values(states))) < 1.2


def test_five_degrees_a_minute_cannot_be_followed_while_cooling():
    states = record(PlantParameters(), 85.0, -40.0, 25, 5.0)
    assert np.max(values(states) - values(states, "working_setpoint")) > 20.0


def test_the_case_lags_a_ramp_by_the_heat_that_passes_each_conductance():
    p = QUIET.model_copy(update={"case_heat_w": 0.0})
    state = record(p, 20.0, 80.0, 50, 1.0)[-1]
    fixture_lag = (p.fixture_j_per_k + p.case_j_per_k) / p.fixture_w_per_k / 60.0
    case_lag = fixture_lag + p.case_j_per_k / p.case_w_per_k / 60.0
    assert state.air - state.fixture == pytest.approx(fixture_lag, rel=0.01)
    assert state.air - state.case == pytest.approx(case_lag, rel=0.01)


def test_the_gyro_sits_above_the_air_by_its_own_heat():
    state = record(QUIET, 23.0, 23.0, 120)[-1]
    assert state.case - state.air == pytest.approx(0.6 / 1.0 + 0.6 / 2.0, rel=0.05)


def test_the_compressor_keeps_its_minimum_times_and_counts_its_starts():
    states = record(PlantParameters(), 23.0, 26.0, 240)
    running = values(states, "compressor").astype(int)
    edges = np.flatnonzero(np.diff(running))
    assert states[-1].compressor_starts == np.count_nonzero(np.diff(running) == 1)
    assert all(
        length >= (60 if running[first + 1] else 180) for first, length in zip(edges[:-1], np.diff(edges), strict=True)
    )


def test_switched_off_it_coasts_to_ambient_with_heater_and_compressor_off():
    plant = Plant(QUIET, start_degc=-30.0)
    plant.step(600.0, -30.0)
    states = [plant.step(60.0, -30.0, on=False) for _ in range(240)]
    assert not any(s.compressor or s.heater for s in states)
    assert states[-1].air == pytest.approx(QUIET.ambient_degc, abs=0.5)


def test_switched_on_again_the_ramp_starts_from_the_present_temperature():
    plant = Plant(QUIET, start_degc=23.0)
    plant.step(60.0, 85.0, on=False)
    assert plant.step(60.0, 85.0, ramp_degc_per_min=1.0).working_setpoint == pytest.approx(24.0, abs=0.01)


def test_an_open_door_warms_a_cold_chamber():
    closed, opened = (Plant(QUIET, start_degc=-40.0) for _ in range(2))
    opened.door_open = True
    assert opened.step(300.0, -40.0).air > closed.step(300.0, -40.0).air + 5.0


def test_equal_seeds_give_equal_records_and_others_do_not():
    first, again, other = (values(record(None, 23.0, 40.0, 10, seed=s), "air") for s in (3, 3, 4))
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)


def test_a_long_step_is_made_of_seconds():
    long, short = Plant(seed=5), Plant(seed=5)
    for _ in range(10):
        short.step(1.0, 60.0, ramp_degc_per_min=2.0)
    assert long.step(10.0, 60.0, ramp_degc_per_min=2.0) == short.state


def test_half_the_step_gives_the_same_temperatures():
    coarse, fine = Plant(QUIET), Plant(QUIET)
    for _ in range(1200):
        coarse.step(1.0, 60.0, ramp_degc_per_min=2.0)
        fine.step(0.5, 60.0, ramp_degc_per_min=2.0)
        fine.step(0.5, 60.0, ramp_degc_per_min=2.0)
    assert coarse.state.air == pytest.approx(fine.state.air, abs=0.05)
    assert coarse.state.case == pytest.approx(fine.state.case, abs=0.05)


def test_the_process_value_has_the_controllers_resolution():
    pv = values(record(PlantParameters(), 23.0, 40.0, 5))
    assert np.allclose(pv * 10.0, np.round(pv * 10.0))


def test_unknown_and_impossible_parameters_are_refused():
    with pytest.raises(ValidationError, match="heater_kw"):
        PlantParameters.model_validate({"heater_kw": 1.0})
    with pytest.raises(ValidationError, match="air_j_per_k"):
        PlantParameters(air_j_per_k=0.0)
