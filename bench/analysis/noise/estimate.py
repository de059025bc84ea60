"""The noise of a gyro as part of every fit: white + flicker + rate random walk, by maximum likelihood.

Estimates of noise use the restricted likelihood (D. A. Harville, JASA 72 (1977) 320): trends that were fitted away do
not make the noise look smaller. Models are compared by the full likelihood, as the restricted one must not be.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from bench.analysis.noise.likelihood import Gls, NoiseLattice, Point, Record, Surface, gls, zeros
from bench.analysis.noise.probability import chi2_quantile
from bench.analysis.noise.whitening import Ratios, covariance
from bench.base import FloatArray, InputError

_NAMES = ("white", "flicker", "walk")
_MOST_ROWS = 1200  # of an estimate from isothermal stretches
_MOST_DENSE = 2000


@dataclass(frozen=True)
class Noise:
    """Coefficients of IEEE 952: angle random walk N, bias instability B, rate random walk K.

    Each comes with its 95 % likelihood interval. `undetermined` names those that the data cannot tell from zero: their
    value is zero, their interval's upper end is what they could be.
    """

    white: float
    """N [deg/sqrt(h)]"""
    flicker: float
    """B [deg/h]"""
    walk: float
    """K [deg/h/sqrt(h)]"""
    intervals: dict[str, tuple[float, float]] = field(default_factory=dict)
    undetermined: tuple[str, ...] = ()

    def ratios(self, interval_s: float) -> Ratios:
        """Flicker and walk relative to the white variance of means over `interval_s`."""
        variance = self.white_variance(interval_s)
        return Ratios(self.flicker**2 / variance, self.walk**2 / variance)

    def white_variance(self, interval_s: float) -> float:
        """Variance of the white part of one mean [(deg/h)^2]."""
        return self.white**2 / (interval_s / 3600.0)

    def std_of_means(self, interval_s: float, duration_s: float) -> float:
        """The floor [deg/h]: expected RMS of the means over `interval_s` of a run of `duration_s` about their own mean.

        That is what remains when a constant is fitted to a gyro with this noise and no other error. A static curve with
        p coefficients takes a little more, about the share p / n of the white part; `expected_rms` gives it exactly.
        """
        rows = max(2, round(duration_s / interval_s))
        thinning = -(-rows // _MOST_DENSE)
        time_s = (np.arange(rows // thinning, dtype=np.float64) + 0.5) * interval_s * thinning
        coarse = expected_rms(self, np.ones((len(time_s), 1)), time_s, interval_s * thinning)
        # Analysis of variance: the scatter within the groups of neighbours is added to the scatter of their means.
        fast = self._inner_variance(interval_s, thinning)
        return float(np.sqrt(coarse**2 + fast))

    def _inner_variance(self, interval_s: float, thinning: int) -> float:
        """Mean square of means over `interval_s` about the mean of `thinning` neighbours [(deg/h)^2]."""
        if thinning == 1:
            return 0.0
        time_s = (np.arange(thinning, dtype=np.float64) + 0.5) * interval_s
        return expected_rms(self, np.ones((thinning, 1)), time_s, interval_s) ** 2


@dataclass(frozen=True)
class NoiseFit:
    """Most likely noise of a set of records, and the generalised least squares of the first record.

    `sigma2` is the white variance of one mean [(deg/h)^2].
    """

    ratios: Ratios
    sigma2: float
    noise: Noise
    fit: Gls


def expected_rms(noise: Noise, X: FloatArray, time_s: FloatArray, interval_s: float) -> float:
    """RMS [deg/h] that least squares of means on X (n, p) leaves of this noise: sqrt(tr((I - H) sigma^2 C) / n)."""
    dense = _physical_covariance(noise, time_s, interval_s)
    basis = np.linalg.qr(X / np.maximum(np.linalg.norm(X, axis=0), 1e-300))[0]
    left = np.trace(dense) - np.sum(basis * (dense @ basis))
    return float(np.sqrt(max(0.0, left) / len(time_s)))


def _physical_covariance(noise: Noise, time_s: FloatArray, interval_s: float) -> FloatArray:
    """Covariance (n, n) of means [(deg/h)^2]; a gyro without white noise is allowed."""
    slow = covariance(time_s, interval_s, Ratios(noise.flicker**2, noise.walk**2), np.zeros(len(time_s)))
    slow[np.diag_indices_from(slow)] += noise.white_variance(interval_s)
    return slow


def profile_noise(
    X: FloatArray,
    y: FloatArray,
    time_s: FloatArray,
    extra_static: Sequence[Record] = (),
    interval_s: float | None = None,
) -> NoiseFit:
    """The most likely noise of y (n,) beside the columns X (n, p), and the coefficients under it.

    `extra_static` are isothermal records of the same gyro (their own X: a constant or a slow trend). `interval_s` is
    the length of the means, by default the usual distance of `time_s`.
    """
    interval = float(np.median(np.diff(time_s))) if interval_s is None else interval_s
    records = (Record(time_s, y, X), *extra_static)
    surface = Surface.of(records, NoiseLattice(records, interval), restricted=True)
    return _noise_fit(records[0], surface, surface.search())


def _noise_fit(first: Record, surface: Surface, best: Point) -> NoiseFit:
    sigma2, way = surface.known[best][1], surface.lattice.at([best])[0][0]
    noise = Noise(*_coefficients(surface, best))
    return NoiseFit(way.ratios, sigma2, noise, gls(first.X, first.y, way, sigma2))


def _coefficients(surface: Surface, point: Point) -> tuple[float, float, float]:
    ratios, sigma2 = surface.lattice.ratios(point), surface.known[point][1]
    hours = surface.lattice.interval_s / 3600.0
    white, flicker, walk = np.sqrt([sigma2 * hours, sigma2 * ratios.flicker, sigma2 * ratios.walk])
    return float(white), float(flicker), float(walk)


def estimate_noise(blocks: Sequence[FloatArray], interval_s: float, trend: int = 2) -> Noise:
    """The noise of isothermal stretches, each a 1-D array [deg/h] of means over `interval_s` (NaN = missing).

    Every stretch has a polynomial in time of order `trend` of its own (thermal tails), removed inside the restricted
    likelihood. Long records are averaged first to about 1200 rows. A coefficient that the data do not tell from zero at
    the 5 % level is zero and named. Raises InputError when no stretch is long enough.
    """
    records, interval = _isothermal_records(blocks, interval_s, trend)
    surface = Surface.of(records, NoiseLattice(records, interval), restricted=True)
    best = surface.search()
    chosen = best
    # 5 % points with one or both ratios on the boundary: S. G. Self, K.-Y. Liang, JASA 82 (1987) 605.
    for held, price in (((True, True), 4.23), ((True, False), 2.71), ((False, True), 2.71)):
        start = min((p for p in surface.known if zeros(p) == held), key=surface.height)
        simple = surface.descend(start, zeros_held=True)
        if surface.height(simple) <= surface.height(best) + price:
            chosen = simple
            break
    inside = [*surface.region(best, float(chi2_quantile(0.95, 1))), chosen]
    values = np.array([_coefficients(surface, p) for p in inside])
    ends = zip(values.min(axis=0).tolist(), values.max(axis=0).tolist(), strict=True)
    value = _coefficients(surface, chosen)
    undetermined = tuple(name for name, v in zip(_NAMES, value, strict=True) if v == 0.0)
    return Noise(*value, intervals=dict(zip(_NAMES, ends, strict=True)), undetermined=undetermined)


def _isothermal_records(blocks: Sequence[FloatArray], interval_s: float, trend: int) -> tuple[list[Record], float]:
    longest = sum(len(block) for block in blocks)
    group = max(1, -(-longest // _MOST_ROWS))
    interval = interval_s * group
    records = []
    for block in blocks:
        rows = len(block) // group * group
        grouped = np.asarray(block[:rows], dtype=np.float64).reshape(-1, group)
        present = np.isfinite(grouped)
        count = present.sum(axis=1)
        full = count * 2 >= group
        if full.sum() < trend + 4:
            continue
        mean = np.where(present, grouped, 0.0).sum(axis=1)[full] / count[full]
        time_s = (np.flatnonzero(full).astype(np.float64) + 0.5) * interval
        at = (time_s - time_s.mean()) / np.ptp(time_s)
        records.append(Record(time_s, mean, np.vander(at, trend + 1), group / count[full]))
    if not records:
        raise InputError(f"no isothermal stretch has the {trend + 4} means over {interval:g} s that the noise needs")
    return records, interval
