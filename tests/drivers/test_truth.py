"""Each mechanism of the truth has the described effect, and no other."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from drivers.errors import ConfigError
from drivers.sim.resonator import Environment, PowerOn, Resonator, UnitSettings
from drivers.sim.truth import MECHANISMS
from drivers.sim.truth.base import Lag, OrnsteinUhlenbeck

SILENT = {
    "noise": {"angle_random_walk": 0.0, "bias_instability": 0.0, "rate_random_walk": 0.0},
    "channels": {
        "thermometer": {"tau_s": 0.05, "noise_degc": 0.0, "step_degc": 0.0},
        "frequency": {"wander_ppm": 0.0, "noise_hz": 0.0},
        "drive": {"wander_ppm": 0.0, "noise_v": 0.0},
        "quadrature": {"wander_dps": 0.0, "noise_v": 0.0},
        "supply": {"wander_v": 0.0},
    },
}
THERMAL = [name for name, mechanism in MECHANISMS.items() if mechanism.kind == "thermal"]
OUTSIDE = {"periodic", "rate_squared", "etalon", "unlogged_drift", "two_pole_lag", "emi"}


class Bench:
    """A unit with the given mechanisms, noise-free by default, driven in steps of `step_s` at 10 Hz."""

    def __init__(self, *truth, settings=SILENT, seed=1, start_degc=25.0, step_s=10.0):
        self.unit = Resonator(UnitSettings.parse({**settings, "truth": list(truth)}), seed, rate_hz=10.0)
        self.t, self.case, self.step_s = 0.0, start_degc, step_s

    def go(self, target_degc, degc_per_min=None, seconds=None, **others):
        """Rate [deg/h] at the end of each step on the way; at once to the target's soak without a rate."""
        seconds = seconds or abs(target_degc - self.case) / degc_per_min * 60.0
        path = np.linspace(self.case, target_degc, round(seconds / self.step_s) + 1)
        out = []
        for a, b in pairwise(path):
            signals = self.unit.advance(Environment(self.t, round(10 * self.step_s), (a, b), rate_hz=10.0, **others))
            out.append(signals.rate_dph[-1])
            self.t += self.step_s
        self.case, self.signals = target_degc, signals
        return np.array(out)

    def hold(self, seconds, **others):
        return self.go(self.case, seconds=seconds, **others)


def mechanism(name, **parameters):
    return {"mechanism": name, **parameters}


def test_the_catalogue_names_what_the_analysis_does_not_know():
    assert {name for name, m in MECHANISMS.items() if m.effect is None} == OUTSIDE
    assert {"thermal_lag", "temperature_rate", "creep", "warm_up", "aging", "quadrature_leakage"} <= set(MECHANISMS)


@pytest.mark.parametrize("name", MECHANISMS)
def test_every_parameter_is_described_with_its_unit(name):
    fields = MECHANISMS[name].model_fields
    assert [parameter for parameter, info in fields.items() if parameter != "mechanism" and not info.description] == []


@pytest.mark.parametrize("name", MECHANISMS)
def test_an_unknown_parameter_is_refused(name):
    with pytest.raises(ConfigError, match="nonsense: unknown key"):
        Bench(mechanism(name, nonsense=1.0))


@pytest.mark.parametrize("name", [name for name in MECHANISMS if name not in THERMAL])
def test_a_mechanism_adds_its_own_contribution_to_the_rate_and_nothing_else(name):
    settings = {"noise": {}, "channels": {}}
    base = mechanism("static_bias")
    excited = {"bias_jump": {"at_s": [5.0], "step_dph": [0.1]}, "bias_kink": {"at_degc": 0.0}}
    added = mechanism(name, **excited.get(name, {}))
    without, with_it = (Resonator(UnitSettings.parse({**settings, "truth": t}), 1) for t in ([base], [base, added]))
    label = f"{name}#2" if name == "static_bias" else name
    for t in range(40):
        environment = Environment(
            float(t),
            500,
            (-2.0 + t / 8.0, -2.0 + (t + 1) / 8.0),
            compressor=1.0,
            heater=0.5,
            applied_rate_dps=(3.0, 3.0),
        )
        a, b = without.advance(environment), with_it.advance(environment)
        for channel in ("temperature", "frequency", "drive", "quadrature", "supply"):
            assert np.array_equal(getattr(a, channel), getattr(b, channel))
        assert np.mean(b.rate_dph - a.rate_dph) == pytest.approx(with_it.contributions[label], abs=1e-8)
    assert np.any(a.rate_dph != b.rate_dph)


@pytest.mark.parametrize("name", THERMAL)
def test_a_thermal_mechanism_moves_what_follows_the_resonator_but_not_the_thermometer(name):
    static = mechanism("static_bias", coefficients_dph=[0.0, 5.0])
    without, with_it = Bench(static), Bench(static, mechanism(name))
    a, b = without.go(35.0, 1.0), with_it.go(35.0, 1.0)
    assert np.array_equal(without.signals.temperature, with_it.signals.temperature)
    assert np.all(without.signals.frequency < with_it.signals.frequency)
    assert b[-1] < a[-1]
    settled = with_it.hold(14_400.0)[-1]
    assert settled == pytest.approx(without.hold(14_400.0)[-1], abs=1e-6)


def test_static_bias_is_its_polynomial():
    bench = Bench(mechanism("static_bias", coefficients_dph=[1.0, 2.0, -3.0], reference_degc=25.0))
    assert bench.hold(100.0)[-1] == pytest.approx(1.0)
    bench.go(75.0, 2.0)
    assert bench.hold(100.0)[-1] == pytest.approx(1.0 + 2.0 - 3.0)


def test_a_knee_is_local_and_an_etalon_periodic_over_temperature():
    knee = mechanism("knee", height_dph=2.0, at_degc=50.0, width_degc=4.0)
    assert Bench(knee, start_degc=50.0).hold(100.0)[-1] == pytest.approx(2.0)
    assert Bench(knee, start_degc=10.0).hold(100.0)[-1] == pytest.approx(0.0, abs=1e-6)
    etalon = mechanism("etalon", amplitude_dph=0.5, period_degc=8.0)
    assert Bench(etalon, start_degc=2.0).hold(100.0)[-1] == pytest.approx(0.5)
    assert Bench(etalon, start_degc=10.0).hold(100.0)[-1] == pytest.approx(0.5)


def test_a_kink_changes_the_slope_and_not_the_value():
    kink = mechanism("bias_kink", slope_dph_per_degc=0.1, at_degc=40.0, rounding_degc=0.5)
    assert Bench(kink, start_degc=30.0).hold(100.0)[-1] == pytest.approx(0.0, abs=1e-6)
    assert Bench(kink, start_degc=50.0).hold(100.0)[-1] == pytest.approx(1.0, abs=1e-6)


def test_leakage_of_one_degree_a_second_through_one_milliradian_is_3_6_degrees_an_hour():
    bench = Bench(mechanism("quadrature_leakage", phase_mrad=1.0, phase_slope_mrad_per_degc=0.02), start_degc=35.0)
    rate = bench.hold(100.0)[-1]
    quadrature_dps = bench.signals.quadrature[-1] / 0.05
    assert rate == pytest.approx(quadrature_dps * 3.6 * 1.2, rel=1e-5)


def test_temperature_rate_is_k_times_the_rate_and_its_square_has_no_sign():
    rate, square = mechanism("temperature_rate", k_dph_per_degc_per_min=0.4), mechanism("rate_squared")
    assert Bench(rate).go(45.0, 2.0)[-1] == pytest.approx(0.8, rel=1e-6)
    assert Bench(rate).go(5.0, 2.0)[-1] == pytest.approx(-0.8, rel=1e-6)
    assert Bench(square).go(45.0, 2.0)[-1] == pytest.approx(0.4, rel=1e-6)
    assert Bench(square).go(5.0, 2.0)[-1] == pytest.approx(0.4, rel=1e-6)


LOOPS = [mechanism("bouc_wen"), mechanism("bouc_wen", exponent=2.0, symmetry=0.8), mechanism("preisach")]


@pytest.mark.parametrize("loop", LOOPS, ids=["bouc_wen", "bouc_wen sharp", "preisach"])
def test_a_loop_does_not_depend_on_the_rate_nor_on_standing_still(loop):
    slow, fast = Bench(loop), Bench(loop)
    for target in (60.0, 0.0, 40.0, 20.0):
        end_slow = slow.go(target, 0.5)[-1]
        fast.go(target, 4.0)
        end_fast = fast.hold(3600.0)[-1]
        assert end_fast == pytest.approx(end_slow, abs=3e-3)


@pytest.mark.parametrize("loop", LOOPS, ids=["bouc_wen", "bouc_wen sharp", "preisach"])
def test_a_loop_is_higher_on_the_way_down_after_having_been_hot(loop):
    bench = Bench(loop, start_degc=-40.0)
    up = bench.go(25.0, 2.0)[-1]
    bench.go(85.0, 2.0)
    down = bench.go(25.0, 2.0)[-1]
    sign = -1.0 if loop["mechanism"] == "bouc_wen" else 1.0
    assert sign * (down - up) > 0.05


@pytest.mark.parametrize(("exponent", "symmetry"), [(1.0, 0.5), (1.5, 0.7), (3.0, 1.0)])
def test_bouc_wen_agrees_with_an_integrator(exponent, symmetry):
    bench = Bench(mechanism("bouc_wen", amplitude_dph=1.0, length_degc=10.0, exponent=exponent, symmetry=symmetry))
    bench.go(55.0, 2.0)
    end = bench.go(20.0, 2.0)
    bench.hold(10.0)

    def slope(sign):
        return lambda _, z: (
            sign / 10.0 * (1.0 - (symmetry * np.sign(z * sign) + 1.0 - symmetry) * np.abs(z) ** exponent)
        )

    top = solve_ivp(slope(1.0), (0.0, 30.0), [0.0], rtol=1e-10, atol=1e-12).y[0, -1]
    # The sign of z changes on the way, so the integrator needs small steps.
    bottom = solve_ivp(slope(-1.0), (0.0, 35.0), [top], rtol=1e-10, atol=1e-12, max_step=0.05).y[0, -1]
    assert end[-1] == pytest.approx(bottom, abs=2e-3)


def test_preisach_wipes_out_what_a_larger_excursion_passed():
    plain, looped = Bench(mechanism("preisach")), Bench(mechanism("preisach"))
    for target in (70.0, -20.0, 60.0):
        plain.go(target, 2.0)
    for target in (70.0, -20.0, 30.0, 10.0, 40.0, 0.0, 60.0):
        looped.go(target, 2.0)
    assert looped.hold(10.0)[-1] == plain.hold(10.0)[-1]


def test_preisach_relays_belong_to_the_unit_and_not_to_the_run():
    same = [Bench(mechanism("preisach"), seed=seed).go(60.0, 2.0)[-1] for seed in (1, 2)]
    assert same[0] == same[1]
    assert Bench(mechanism("preisach", relay_seed=2)).go(60.0, 2.0)[-1] != same[0]


def test_creep_relaxes_with_its_spectrum():
    creep = mechanism("creep", k_dph_per_degc=0.02, shortest_h=0.5, longest_h=2.0, elements=3)
    bench = Bench(creep)
    bench.go(75.0, seconds=10.0)
    relaxed = bench.hold(3600.0)[-1]
    hours = 1.0 + 5.0 / 3600.0
    expected = 0.02 * 50.0 * np.mean([1.0 - np.exp(-hours / tau) for tau in (0.5, 1.0, 2.0)])
    assert relaxed == pytest.approx(expected, rel=1e-3)
    bench.step_s = 600.0
    assert bench.hold(48 * 3600.0)[-1] == pytest.approx(1.0, rel=1e-6)


def test_warm_up_dies_out_and_comes_back_after_a_long_time_without_power():
    bench = Bench(mechanism("warm_up", amplitude_dph=2.0, tau_s=600.0, fast_share=0.0))
    assert bench.hold(600.0)[-1] == pytest.approx(2.0 * np.exp(-1.0), rel=1e-3)
    assert bench.hold(7200.0)[-1] == pytest.approx(0.0, abs=1e-4)
    bench.hold(7200.0, powered=False)
    assert bench.hold(10.0)[0] == pytest.approx(2.0, rel=0.02)


def test_turn_on_is_constant_until_the_next_power_on():
    bench = Bench(mechanism("turn_on", sigma_dph=0.3))
    first = bench.hold(100.0)
    assert np.ptp(first) == 0.0
    bench.hold(10.0, powered=False)
    assert bench.hold(10.0)[0] != first[0]
    draws = [Bench(mechanism("turn_on", sigma_dph=0.3), seed=seed).hold(10.0)[0] for seed in range(200)]
    assert np.std(draws) == pytest.approx(0.3, rel=0.2)


def test_a_later_power_on_has_a_later_draw_however_it_came_about():
    turn_on = mechanism("turn_on", sigma_dph=0.3)
    bench = Bench(turn_on)
    draws = [bench.hold(10.0)[0]]
    for _ in range(3):
        bench.hold(10.0, powered=False)
        draws.append(bench.hold(10.0)[0])
    for number, draw in enumerate(draws, 1):
        unit = Resonator(UnitSettings.parse({**SILENT, "truth": [turn_on]}), 1, 10.0, PowerOn(number))
        rate = unit.advance(Environment(0.0, 100, (25.0, 25.0), rate_hz=10.0)).rate_dph
        assert rate[0] == draw
    assert len(set(draws)) == 4


def test_a_unit_that_was_powered_before_is_already_warm():
    warm = UnitSettings.parse({**SILENT, "truth": [mechanism("warm_up", amplitude_dph=2.0, fast_share=0.0)]})
    unit = Resonator(warm, 1, 10.0, PowerOn(1, on_s=600.0))
    rate = unit.advance(Environment(0.0, 100, (25.0, 25.0), rate_hz=10.0)).rate_dph
    assert rate[0] == pytest.approx(2.0 * np.exp(-1.0), rel=1e-6)


def test_earth_rate_has_the_size_that_latitude_and_axis_give():
    """Facts: 15.041067 deg/h sidereal; level axis x cos L cos A, vertical x sin L."""
    for latitude, azimuth, elevation, expected in (
        (48.0, 0.0, 0.0, 15.041067 * np.cos(np.radians(48.0))),
        (48.0, 60.0, 0.0, 15.041067 * np.cos(np.radians(48.0)) * 0.5),
        (48.0, 90.0, 0.0, 0.0),
        (-33.0, 200.0, 0.0, 15.041067 * np.cos(np.radians(33.0)) * np.cos(np.radians(200.0))),
        (48.0, 17.0, 90.0, 15.041067 * np.sin(np.radians(48.0))),
        (48.0, 17.0, -90.0, -15.041067 * np.sin(np.radians(48.0))),
    ):
        place = {"latitude_deg": latitude, "azimuth_deg": azimuth, "elevation_deg": elevation}
        assert Bench(mechanism("earth_rate", **place)).hold(10.0)[0] == pytest.approx(expected, abs=2e-6)


def test_a_level_axis_goes_round_with_the_table_and_a_vertical_one_does_not():
    north = Bench(mechanism("earth_rate", latitude_deg=60.0))
    turned = np.concatenate([north.hold(10.0, applied_rate_dps=(9.0, 9.0)) - 9.0 * 3600.0 for _ in range(4)])
    assert turned == pytest.approx(15.041067 * 0.5 * np.cos(np.radians(9.0 * (np.arange(1, 5) * 10.0 - 0.1))), abs=0.01)
    up = Bench(mechanism("earth_rate", latitude_deg=30.0, elevation_deg=90.0))
    assert up.hold(10.0, applied_rate_dps=(9.0, 9.0))[0] - 9.0 * 3600.0 == pytest.approx(7.5205, abs=1e-3)


def test_an_even_scale_factor_error_is_the_same_in_both_directions_and_zero_at_rest():
    even = mechanism("scale_factor_even", asymmetry_ppm=10.0, square_ppm=5.0)
    bench = Bench(even)
    errors = [bench.hold(10.0, applied_rate_dps=(rate, rate))[0] - 3600.0 * rate for rate in (-50.0, 0.0, 50.0)]
    assert errors == pytest.approx([0.036 * 50.0 + 0.009 * 50.0, 0.0, 0.036 * 50.0 + 0.009 * 50.0], abs=1e-6)


def test_aging_is_a_line_and_a_logarithm_of_powered_time():
    aging = mechanism("aging", linear_dph_per_h=0.1, logarithmic_dph=0.2, settled_h=0.5)
    bench = Bench(aging)
    bench.hold(3600.0, powered=False)
    assert bench.hold(7200.0)[-1] == pytest.approx(0.2 + 0.2 * np.log(1.0 + 2.0 / 0.5), rel=1e-4)


def test_drive_frequency_and_supply_couple_what_their_channels_show():
    drive = Bench(mechanism("drive_amplitude", k_dph_per_percent=0.5), start_degc=65.0)
    assert drive.hold(10.0)[-1] == pytest.approx(50.0 * (drive.signals.drive[-1] / 2.5 - 1.0), rel=1e-9)
    frequency = Bench(mechanism("resonance_frequency", k_dph_per_hz=0.1), start_degc=65.0)
    assert frequency.hold(10.0)[-1] == pytest.approx(0.1 * (frequency.signals.frequency[-1] - 14000.0), rel=1e-9)
    supply = Bench(mechanism("supply_voltage", k_dph_per_v=2.0))
    assert supply.hold(10.0, supply_v=5.1)[-1] == pytest.approx(0.2)
    assert supply.hold(60.0, supply_v=5.1, compressor=1.0)[-1] == pytest.approx(2.0 * (0.1 - 0.02), rel=1e-6)


def test_the_compressor_rectifies_its_vibration():
    bench = Bench(mechanism("compressor", k_dph_per_g2=2.0, level_g=0.5))
    assert np.all(bench.hold(60.0) == 0.0)
    assert bench.hold(120.0, compressor=1.0)[-1] == pytest.approx(0.5, rel=1e-6)


def test_jumps_come_at_their_times_or_at_random_ones():
    fixed = Bench(mechanism("bias_jump", at_s=[100.0, 200.0], step_dph=[0.3, -0.5])).hold(300.0)
    assert fixed[[8, 10, 25]] == pytest.approx([0.0, 0.3, -0.2])
    random = Bench(mechanism("bias_jump", per_hour=10.0)).hold(20 * 3600.0)
    assert np.count_nonzero(np.diff(random)) == pytest.approx(200, rel=0.3)
    with pytest.raises(ConfigError, match="1 times in at_s but 0 sizes"):
        Bench(mechanism("bias_jump", at_s=[1.0]))


def test_frost_shows_on_the_way_up_through_zero_and_only_there():
    frost = mechanism("frost", amplitude_dph=0.3, width_degc=3.0)
    bench = Bench(frost)
    assert np.all(bench.go(-30.0, 1.0) == 0.0)
    bench.hold(1800.0)
    up = bench.go(40.0, 1.0)
    temperature = np.linspace(-30.0, 40.0, len(up) + 1)[1:]
    assert 1.0 < temperature[np.argmax(up)] < 5.0
    assert np.max(up) == pytest.approx(0.3, rel=0.1)
    assert np.max(up[temperature < -0.5]) == 0.0
    assert up[-1] < 0.001
    dry = Bench(frost)
    dry.go(-30.0, 1.0, humidity=0.0)
    assert np.all(dry.go(40.0, 1.0, humidity=0.0) == 0.0)


def test_scale_factor_errors_are_odd_in_the_rate_and_vanish_without_one():
    sf = mechanism("scale_factor_temperature", ppm_per_degc=50.0, ppb_per_degc2=0.0)
    for rate in (100.0, -100.0):
        error = Bench(sf, start_degc=45.0).hold(10.0, applied_rate_dps=(rate, rate))[-1] - 3600.0 * rate
        assert error == pytest.approx(3600.0 * rate * 50e-6 * 20.0, rel=1e-6)
        cubic = Bench(mechanism("scale_factor_nonlinearity", square_ppm=100.0))
        error = cubic.hold(10.0, applied_rate_dps=(2.0 * rate, 2.0 * rate))[-1] - 7200.0 * rate
        assert error == pytest.approx(7200.0 * rate * 100e-6 * 4.0, rel=1e-6)
    assert Bench(sf, start_degc=45.0).hold(10.0)[-1] == 0.0


def test_a_periodic_disturbance_knows_only_time():
    rate = Bench(mechanism("periodic", amplitude_dph=0.2, period_s=1200.0)).go(60.0, 1.0)
    t = 10.0 * np.arange(1, len(rate) + 1) - 0.1
    assert rate == pytest.approx(0.2 * np.sin(2.0 * np.pi * t / 1200.0), abs=1e-6)


def test_interference_needs_the_heater():
    bench = Bench(mechanism("emi"))
    assert np.all(bench.hold(600.0) == 0.0)
    heated = bench.hold(6000.0, heater=1.0)
    assert np.mean(heated) == pytest.approx(0.1, abs=0.02)
    assert np.ptp(heated) == pytest.approx(0.6, rel=0.1)


def test_unlogged_drift_has_its_spread_and_its_correlation_time():
    record = Bench(mechanism("unlogged_drift", sigma_dph=0.2, tau_s=600.0), step_s=100.0).hold(400 * 600.0)
    assert np.std(record) == pytest.approx(0.2, rel=0.15)
    lagged = np.corrcoef(record[:-6], record[6:])[0, 1]
    assert lagged == pytest.approx(np.exp(-1.0), abs=0.12)


def test_the_process_does_not_depend_on_how_it_is_cut():
    whole, parts = (
        OrnsteinUhlenbeck(np.array([5.0, 500.0]), np.array([1.0, 2.0]), 1.0, np.random.default_rng(1)) for _ in range(2)
    )
    expected = whole(8001)
    pieces = [parts(n + 1)[:-1] for n in (10, 990, 3000, 4000)]
    assert np.array_equal(np.concatenate(pieces), expected[:-1])


def test_a_lag_answers_a_ramp_exactly():
    lag, t = Lag(7.0), np.arange(41) * 0.5
    response = lag(0.5, 3.0 + 0.2 * t)
    assert response == pytest.approx(3.0 + 0.2 * (t - 7.0 * (1.0 - np.exp(-t / 7.0))), abs=1e-12)
