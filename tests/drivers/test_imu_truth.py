"""The simulated inertial unit does what it says and nothing else: against rigid-body integrals and closed forms."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from drivers.sim.truth.imu.drawn import drawn
from drivers.sim.truth.imu.elements import AccelerometerSettings, GyroSettings
from drivers.sim.truth.imu.mounting import Mounting, MountingSettings, Stand
from drivers.sim.truth.imu.unit import ImuSettings, SimulatedImu, respond
from drivers.sim.truth.noise import NoiseSettings

RIGID = {"visit_arcsec": 0.0, "wobble_arcsec": 0.0}
QUIET = {
    "gyro_noise": NoiseSettings(angle_random_walk=0.0, bias_instability=0.0, rate_random_walk=0.0),
    "velocity_random_walk": 0.0, "acceleration_instability": 0.0,
}  # fmt: skip
EARTH = 15.041067
LEVEL = np.eye(3)


def stay(stand, **settings):
    return Mounting(MountingSettings(**{**RIGID, **settings}), 1).stay(stand)


def at(settings, rate=(0.0, 0.0, 0.0), force=(0.0, 0.0, 0.0), degc=25.0):
    rows = np.array([rate], dtype=float), np.array([force], dtype=float)
    return respond(settings, *rows, [np.array([degc])] * 6)[0]


def with_gyro_x(**parameters):
    return ImuSettings(gyros=(GyroSettings(**parameters), GyroSettings(), GyroSettings()))


def with_accelerometer_x(**parameters):
    ideal = AccelerometerSettings()
    return ImuSettings(accelerometers=(AccelerometerSettings(**parameters), ideal, ideal))


def test_a_unit_at_rest_sees_the_earth_turn_and_gravity_upwards():
    rate, force = stay(Stand(2, LEVEL), latitude_deg=60.0)
    assert rate[0] == pytest.approx([0.0, EARTH * 0.5, EARTH * np.sin(np.radians(60.0))], abs=1e-5)
    assert force[1] == pytest.approx([0.0, 0.0, 9.80620])


def test_a_turning_table_turns_the_unit_about_its_axis_and_the_earth_the_other_way_in_the_unit():
    rate, _ = stay(Stand(1, LEVEL, turn_dps=90.0), latitude_deg=0.0)
    assert rate[0, 2] == pytest.approx(90.0 * 3600.0, rel=1e-9)
    # The mean of a vector that turns by 90 degrees clockwise, from north to east.
    assert rate[0, :2] == pytest.approx([EARTH * 2 / np.pi, EARTH * 2 / np.pi], rel=1e-3)


def test_the_rate_of_a_wobbling_table_integrates_to_its_orientation():
    """Attitude from integrating the stated rates, by scipy, against the orientation in the next stand."""
    mounting = Mounting(MountingSettings(visit_arcsec=0.0, wobble_arcsec=3600.0, latitude_deg=90.0), 3)
    turning, still = Stand(1, LEVEL, turn_dps=10.0), Stand(1, LEVEL)
    before = mounting.stay(still)[1][0]
    pieces = [mounting.stay(turning) for _ in range(9)]
    after = mounting.stay(still)[1][0]
    rates = np.radians(np.concatenate([rate - [0.0, 0.0, EARTH] for rate, _ in pieces]) / 3600.0)

    def turned(time_s, vector):
        return -np.cross(rates[min(int(time_s), 8)], vector)

    path = solve_ivp(turned, (0.0, 9.0), before, max_step=0.05, rtol=1e-9).y[:, -1]
    assert path == pytest.approx(after, abs=2e-3)
    assert np.linalg.norm(after - before) > 0.05  # it did wobble


@pytest.mark.parametrize(
    ("where", "seen"),
    [("unit_in_fixture_deg", [0, -1, 0]), ("fixture_on_table_deg", [0, -1, 0]), ("table_tilt_deg", [0, -1, 0])],
)
def test_each_error_of_the_mounting_tilts_gravity_by_its_angle(where, seen):
    value = (0.5, 0.0) if where == "table_tilt_deg" else (0.5, 0.0, 0.0)
    force = stay(Stand(1, LEVEL), **{where: value})[1][0]
    assert force[:2] == pytest.approx(9.80620 * np.sin(np.radians(0.5)) * np.array(seen)[:2], abs=1e-9)


def test_only_a_tilted_fixture_turns_the_axis_of_the_table_in_the_unit():
    stand = Stand(1, LEVEL, turn_dps=90.0)
    tilted = stay(stand, fixture_on_table_deg=(0.5, 0.0, 0.0))[0][0] / 3600.0
    leaning = stay(stand, table_tilt_deg=(0.5, 0.0))[0][0] / 3600.0
    assert tilted[1] == pytest.approx(-90.0 * np.sin(np.radians(0.5)), abs=0.01)
    assert leaning[1] == pytest.approx(0.0, abs=0.01)


def test_an_attitude_errs_alike_within_a_visit_and_anew_in_the_next():
    mounting = Mounting(MountingSettings(visit_arcsec=100.0), 1)
    first, same, other = (mounting.stay(Stand(1, LEVEL, visit=visit))[1][0] for visit in (1, 1, 2))
    assert np.array_equal(first, same)
    assert 10.0 < 3600.0 * np.degrees(np.arccos(np.clip(first @ other / 9.8062**2, -1, 1))) < 1000.0


def test_axes_that_are_not_orthogonal():
    unit = with_gyro_x(tilt_mrad=(2.0, -3.0), tilt_urad_per_degc=(10.0, 0.0))
    expected = Rotation.from_euler("yz", [3e-3, 2e-3]).apply([1.0, 0.0, 0.0])  # about y first, then about z
    assert [at(unit, rate=np.eye(3)[k])[0] for k in range(3)] == pytest.approx(expected, abs=1e-8)
    assert at(unit, rate=(0.0, 1.0, 0.0), degc=125.0)[0] == pytest.approx(3e-3, abs=2e-8)


def test_scale_factors_bias_and_g_sensitivity_over_temperature():
    unit = with_gyro_x(scale_ppm=1000.0, scale_ppm_per_degc=50.0, scale_ppb_per_degc2=200.0)
    assert at(unit, rate=(1e6, 0, 0), degc=75.0)[0] == pytest.approx(1e6 + 1000.0 + 2500.0 + 500.0)
    assert at(with_gyro_x(bias=(5.0, 3.0, 1.0)), degc=75.0)[0] == pytest.approx(9.0)
    pulled = with_gyro_x(g_sensitivity=(0.0, 20.0, 0.0), g_sensitivity_per_degc=(0.0, 0.5, 0.0))
    assert at(pulled, force=(9.0, 9.80665, 9.0), degc=35.0) == pytest.approx([25.0, 0, 0, 9.0, 9.80665, 9.0])


def test_the_second_order_of_an_accelerometer_has_one_sign_both_ways():
    unit = with_accelerometer_x(second_order_ug_per_g2=1000.0)
    for g in (9.80665, -9.80665):
        assert at(unit, force=(g, 0, 0))[3] - g == pytest.approx(1e-3 * 9.80665)


def test_crosstalk_takes_a_part_of_the_other_output():
    unit = ImuSettings(gyro_crosstalk_ppm=((0, 500, 0), (0, 0, 0), (0, 0, 0)))
    assert at(unit, rate=(0, 1e6, 0))[:3] == pytest.approx([500.0, 1e6, 0.0])


def test_dies_differ_while_the_case_warms_and_agree_afterwards_but_for_their_own_heat():
    settings = ImuSettings(**QUIET)
    imu = SimulatedImu(settings, MountingSettings(**RIGID), 1)
    warming = imu.stay(Stand(1200, LEVEL), np.linspace(20.0, 40.0, 1200)).temperatures[-1]
    taus = np.array([die.tau_s for die in settings.dies])
    rises = np.array([die.rise_degc for die in settings.dies])
    assert warming == pytest.approx(40.0 + rises - taus * 20.0 / 1199, abs=0.03)
    resting = imu.stay(Stand(1200, LEVEL), np.full(1200, 40.0)).temperatures[-1]
    assert resting == pytest.approx(40.0 + rises, abs=0.03)


def test_lag_and_loop_stay_in_the_element_that_has_them():
    case = np.concatenate([np.linspace(20, 60, 1200), np.linspace(60, 20, 1200)])
    plain, lagging, looping = (
        SimulatedImu(ImuSettings(**QUIET, gyros=gyros), MountingSettings(**RIGID), 1).stay(Stand(2400, LEVEL), case)
        for gyros in (
            [GyroSettings(bias=(0.0, 50.0))] * 3,
            [GyroSettings(bias=(0.0, 50.0), lag_s=60.0), *[GyroSettings(bias=(0.0, 50.0))] * 2],
            [GyroSettings(bias=(0.0, 50.0), loop=5.0), *[GyroSettings(bias=(0.0, 50.0))] * 2],
        )
    )
    behind, opened = lagging.rate - plain.rate, looping.rate - plain.rate
    assert behind[1100, 0] == pytest.approx(-60.0 * 40.0 / 1200, abs=0.1)  # tau times slope: 1 deg/h/degC here
    assert opened[1100, 0] == pytest.approx(5.0 * (1.0 - np.exp(-1100.0 / 30.0 / 12.0)), abs=0.1)
    assert opened[-1, 0] == pytest.approx(-5.0 * (1.0 - np.exp(-(40.0 - 12.0 * 0.96) / 12.0)), abs=0.1)
    assert not behind[:, 1:].any()
    assert not opened[:, 1:].any()


def test_how_a_record_is_divided_does_not_change_it():
    imu = [SimulatedImu(drawn(4), MountingSettings(), 4) for _ in range(2)]
    case = np.linspace(20.0, 30.0, 600)
    whole = imu[0].stay(Stand(600, LEVEL, turn_dps=12.0), case)
    parts = [imu[1].stay(Stand(200, LEVEL, turn_dps=12.0), piece) for piece in np.split(case, 3)]
    assert np.concatenate([p.acceleration for p in parts]) == pytest.approx(whole.acceleration, abs=1e-9)
    assert np.concatenate([p.rate for p in parts]) == pytest.approx(whole.rate, abs=1e-6)


def test_units_are_drawn_apart_and_again_the_same():
    assert drawn(1) == drawn(1)
    assert drawn(1) != drawn(2)
