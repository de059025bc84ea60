import numpy as np
import pytest
from numpy.polynomial.chebyshev import chebvander

from bench.analysis.diagnosis.candidates import Problem
from bench.analysis.diagnosis.probes import examine, noise_test, usual
from bench.analysis.noise.estimate import Noise
from bench.analysis.noise.likelihood import NoiseLattice, Record, Surface
from bench.analysis.noise.spikes import stretches
from bench.analysis.noise.whitening import covariance
from bench.base.spikes import despike
from bench.record.dataset import Dataset

NOISE = Noise(0.01, 0.03, 0.03)
ROWS = 600
TIME = (np.arange(ROWS) + 0.5) * 30.0
TEMPERATURE = 22.5 + 62.5 * (2.0 / np.pi) * np.arcsin(np.sin(2.0 * np.pi * TIME / 8000.0) * 0.98)
RATE = 60.0 * np.gradient(TEMPERATURE, TIME)
BASE = chebvander((TEMPERATURE - 22.5) / 62.5, 6)
QUADRATURE = np.sin(TIME / 900.0) + 0.2 * np.cos(TIME / 333.0)
LATTICES = {}


def coloured(seed, rows=ROWS, noise=NOISE):
    dense = covariance(TIME[:rows], 30.0, noise.ratios(30.0)) * noise.white_variance(30.0)
    return np.linalg.cholesky(dense) @ np.random.default_rng(seed).normal(size=rows)


def examined(misfit, seed=3, run_noise=NOISE):
    still = Record(TIME[:360], coloured(seed + 1000, 360), np.ones((360, 1)))
    data = Problem(TIME, BASE.sum(axis=1) + misfit + coloured(seed, noise=run_noise), BASE, 30.0, (still,))
    lattice = LATTICES.setdefault(0, NoiseLattice(data.records(), 30.0))  # whiteners depend on the times alone
    point = Surface.of(data.records(), lattice, restricted=False).search()
    return examine(data, usual(TIME, TEMPERATURE, RATE, {"quadrature": QUADRATURE}), lattice, point)


@pytest.mark.parametrize(
    ("name", "misfit"),
    [
        ("dT/dt", 0.05 * RATE**3),
        ("quadrature", 0.15 * QUADRATURE),
        ("fine temperature", 0.2 * np.sin(2.0 * np.pi * TEMPERATURE / 20.0)),
        ("periodic", 0.12 * np.sin(2.0 * np.pi * TIME / 410.0)),
    ],
)
def test_the_strongest_probe_points_at_the_cause(name, misfit):
    found = examined(misfit)
    assert found.alarms[0].name == name


def test_clean_runs_raise_an_alarm_at_the_rate_that_was_asked_for():
    alarms = [examined(0.0, seed).alarms for seed in range(8)]
    assert sum(map(bool, alarms)) <= 2


def test_a_loop_shows_in_the_cells_of_either_direction():
    found = {f.name: f for f in examined(0.12 * np.sign(RATE)).findings}["temperature x direction"]
    z = found.estimates / found.deviations
    signs = {
        word: np.nanmean([v for v, cell in zip(z, found.cells, strict=True) if cell.direction == word])
        for word in ("heating", "cooling")
    }
    assert signs["heating"] > 0.5
    assert signs["cooling"] < -0.5
    assert found.p < 1e-3


@pytest.mark.parametrize(("period_s", "within_s"), [(410.0, 3.0), (1530.0, 30.0)])
def test_a_periodic_disturbance_gets_its_period_between_the_lines_of_the_grid_and_its_size(period_s, within_s):
    wave = 0.15 * np.sin(2.0 * np.pi * TIME / period_s + 0.7)
    found = {f.name: f for f in examined(wave).findings}["periodic"]
    assert abs(float(found.note.split()[1]) - period_s) < within_s
    assert np.std(found.shape) == pytest.approx(np.std(wave), rel=0.25)
    assert np.corrcoef(found.shape, wave)[0, 1] > 0.9


def test_a_run_noisier_than_standing_still_is_said():
    found = {f.name: f for f in examined(0.0, run_noise=Noise(0.02, 0.03, 0.03)).findings}["noise"]
    assert found.p < 1e-6


def test_heavy_tails_are_no_drift():
    alarms = 0
    for seed in range(12):
        rng = np.random.default_rng(seed)
        still = Record(TIME[:360], 0.1 * rng.standard_t(3.0, size=360), np.ones((360, 1)))
        data = Problem(TIME, BASE.sum(axis=1) + 0.1 * rng.standard_t(3.0, size=ROWS), BASE, 30.0, (still,))
        lattice = LATTICES.setdefault(0, NoiseLattice(data.records(), 30.0))
        alarms += noise_test(data, lattice, (-16, -48)).p < 0.005
    assert alarms == 0


def test_despiking_finds_spikes_and_keeps_jumps():
    residual = 0.1 * np.random.default_rng(0).normal(size=500)
    residual[250:] += 2.0
    residual[[40, 300, 499]] += 1.5
    assert np.flatnonzero(~despike(residual)).tolist() == [40, 300, 499]
    assert despike(np.zeros(10)).all()


def disturbed(rows=slice(200, 212), height=1.5):
    """A run of a unit with noise alone, and one disturbance; a channel that may move with it."""
    residual = 0.1 * np.random.default_rng(1).normal(size=ROWS)
    residual[rows] += height
    channels = {"rate": residual, "temperature": TEMPERATURE, "supply": 5.0 + 0.001 * QUADRATURE}
    return Dataset("disturbed", TIME, channels, np.zeros(ROWS, dtype=np.int64), (), 30.0), residual


def test_a_stretch_that_jumps_away_and_back_is_found_and_no_effect_over_temperature():
    run, residual = disturbed()
    (found,) = stretches(run, residual)
    assert found.height == pytest.approx(1.5, abs=0.1)
    assert 199 <= found.first <= 200
    assert 212 <= found.end <= 213
    quiet = residual - 1.5 * (np.abs(np.arange(ROWS) - 205.5) < 6.0)
    alike = (np.abs(TEMPERATURE - TEMPERATURE[206]) < 8.0) & (np.arange(ROWS) >= 150)
    assert stretches(run, quiet + 1.5 * alike) == []  # it comes back with the temperature
    assert stretches(run, quiet + 1.5 * np.exp(-(((TIME - TIME[205]) / 90.0) ** 2))) == []  # it has flanks


def test_a_stretch_with_which_a_channel_moves_is_none_that_stands_out():
    run, residual = disturbed()
    moved = run.channel("supply") + 0.1 * (np.arange(ROWS) // 12 == 200 // 12)
    moved[200:212] = run.channel("supply")[200:212] + 0.1
    assert stretches(run.with_channel("supply", moved), residual) == []


@pytest.mark.parametrize("rows", [slice(200, 260), slice(200, ROWS), slice(0, ROWS, 2)])
def test_what_lasts_longer_stays_or_comes_again_and_again_does_not_stand_out(rows):
    run, residual = disturbed(rows)
    assert stretches(run, residual) == []


def test_at_rest_a_shock_that_fades_stands_out_and_one_that_leaves_a_jump_does_not():
    run, residual = disturbed(height=0.0)
    since = np.arange(ROWS) - 200.0
    shock = np.where(since >= 0.0, np.exp(-np.clip(since, 0.0, None) / 12.0), 0.0)
    (found,) = stretches(run, residual - 4.0 * shock)
    assert found.first in {199, 200}
    assert found.height == pytest.approx(-4.0, abs=0.4)
    assert 225 < found.end < 270
    assert stretches(run, residual + 2.0 * shock + 2.0 * (since >= 0.0)) == []
    assert stretches(run, residual + 4.0 * shock, lambda out: residual + 4.0 * shock) == []  # a crack, where it heats


def test_an_error_that_changes_faster_than_its_noise_is_no_spike():
    residual = 0.05 * np.random.default_rng(0).normal(size=500) + 3.0 * np.cos(np.arange(500) / 20.0)
    residual[[40, 300]] += 1.5
    assert np.flatnonzero(~despike(residual)).tolist() == [40, 300]
