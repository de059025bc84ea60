"""The noise of a gyro as part of every fit: white + flicker + rate random walk, by maximum likelihood.

Estimates of noise use the restricted likelihood (D. A. Harville, JASA 72 (1977) 320): trends that were fitted away do
not make the noise look smaller. Models are compared by the full likelihood, as the restricted one must not be.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from bench.analysis.noise.allan import FLICKER_FLOOR
from bench.analysis.noise.components import COMPONENTS, Squares, Stretch, floor_unit, squares_of
from bench.analysis.noise.likelihood import Gls, NoiseLattice, Point, Record, Surface, gls
from bench.analysis.noise.variances import interval, may_vanish, most_likely, standard_errors
from bench.analysis.noise.whitening import Ratios, Whitener
from bench.base import BoolArray, FloatArray, InputError

_MOST_RAMP_ROWS = 600
_NAMES = COMPONENTS[:3]
_ASKED = np.array([True, True, True, False])
_CONTRADICTED = 10.83  # of the likelihood ratio with one degree of freedom, passed by chance once in a thousand runs


@dataclass(frozen=True)
class Noise:
    """Coefficients of IEEE 952: angle random walk N, bias instability B, rate random walk K.

    Each comes with its 95 % interval. `undetermined` names those that the data cannot tell from zero: their
    value is zero, their interval's upper end is what they could be.
    """

    white: float
    """N [deg/sqrt(h)]"""
    flicker: float
    """B [deg/h]"""
    walk: float
    """K [deg/h/sqrt(h)]"""
    quantisation: float = 0.0
    """Q [deg]; zero unless the rows cannot be explained without"""
    intervals: dict[str, tuple[float, float]] = field(default_factory=dict)
    undetermined: tuple[str, ...] = ()

    def ratios(self, interval_s: float) -> Ratios:
        """Flicker and walk relative to the white variance of means over `interval_s`."""
        variance = self.white_variance(interval_s)
        return Ratios(self.flicker**2 / variance, self.walk**2 / variance)

    def white_variance(self, interval_s: float) -> float:
        """Variance of the white part of one mean [(deg/h)^2]."""
        return self.white**2 / (interval_s / 3600.0)

    def variances(self) -> FloatArray:
        """N^2, B^2, K^2 and Q^2 (4,)."""
        return np.array([self.white, self.flicker, self.walk, self.quantisation]) ** 2

    def allan_deviation(self, tau_s: FloatArray) -> FloatArray:
        """Allan deviation (m,) [deg/h] of this noise over averaging times (m,) [s], by IEEE 952."""
        tau_h = tau_s / 3600.0
        white, flicker, walk, steps = self.variances()
        square = white / tau_h + (FLICKER_FLOOR**2) * flicker + walk * tau_h / 3.0 + 3.0 * steps / tau_h**2
        return np.asarray(np.sqrt(square))

    def std_of_means(self, interval_s: float, duration_s: float) -> float:
        """The floor [deg/h]: expected RMS of the means over `interval_s` of a run of `duration_s` about their own mean.

        That is what remains when a constant is fitted to a gyro with this noise and no other error.
        """
        return float(np.sqrt(floor_unit(rows_of(interval_s, duration_s), interval_s) @ self.variances()))


def rows_of(interval_s: float, duration_s: float) -> int:
    """Means over `interval_s` in a run of `duration_s`, at least two."""
    return max(2, round(duration_s / interval_s))


@dataclass(frozen=True)
class NoiseFit:
    """Most likely noise of a set of records, and the generalised least squares of the first record.

    `sigma2` is the white variance of one mean [(deg/h)^2].
    """

    ratios: Ratios
    sigma2: float
    noise: Noise
    fit: Gls


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


@dataclass(frozen=True)
class Estimate:
    """The noise of isothermal stretches, and the sums of squares that it was found from."""

    noise: Noise
    """Without intervals, which take longer."""
    squares: Squares
    best: FloatArray
    """Most likely variances (4,); `noise` has none that the data do not tell from zero."""
    white_samples: bool
    """Whether samples within a row scatter as white noise that was seen between rows; N is then known from them."""
    stretches: tuple[Stretch, ...]
    interval_s: float

    def with_intervals(self) -> Noise:
        """The noise with its 95 % intervals."""
        ends = {
            name: self._around(getattr(self.noise, name), np.eye(4)[order], simulated=name != "white")
            for order, name in enumerate(COMPONENTS)
            if self.best[order] > 0.0
        }
        return replace(self.noise, intervals=ends)

    def floor_interval(self, interval_s: float, duration_s: float) -> tuple[float, float]:
        """95 % interval of `Noise.std_of_means`: N, B and K as far as the data leave them open."""
        value = self.noise.std_of_means(interval_s, duration_s)
        return self._around(value, floor_unit(rows_of(interval_s, duration_s), interval_s))

    def quantisation(self) -> tuple[float, float, float]:
        """Q [deg] and its 95 % interval; zero where the data do not tell it from zero."""
        best = _fitted(self.squares, np.ones(4, dtype=bool))[0]
        best = np.maximum(best, 1e-6 * standard_errors(self.squares, best))
        weights = np.eye(4)[3]
        low, high = interval(self.squares, best, weights)
        return (float(np.sqrt(best[3])) if low > 0.0 else 0.0), low, high

    def ramp(self) -> tuple[float, float, float]:
        """R [deg/h/h], the slope over the longest stretch, and its 95 % interval.

        Flicker and walk move the output as well: the interval counts both as large as the data allow.
        """
        rate = max((stretch.rate for stretch in self.stretches), key=len)
        group = max(1, -(-len(rate) // _MOST_RAMP_ROWS))
        grouped = rate[: len(rate) // group * group].reshape(-1, group)
        whole = np.isfinite(grouped).all(axis=1)
        interval_s, noise = group * self.interval_s, self.noise
        time_s: FloatArray = (np.flatnonzero(whole).astype(np.float64) + 0.5) * interval_s
        highest = noise.intervals or self.with_intervals().intervals
        ratios = replace(noise, flicker=highest["flicker"][1], walk=highest["walk"][1]).ratios(interval_s)
        columns = np.column_stack([np.ones(len(time_s)), time_s / 3600.0])
        way = Whitener.of(ratios, time_s, interval_s)
        found = gls(columns, grouped[whole].mean(axis=1), way, noise.white_variance(interval_s))
        half = 1.96 * float(np.sqrt(found.covariance[1, 1]))
        return float(found.beta[1]), float(found.beta[1]) - half, float(found.beta[1]) + half

    def _around(self, value: float, weights: FloatArray, simulated: bool = True) -> tuple[float, float]:
        low, high = interval(self.squares, self.best, weights, simulated)
        return min(low, value), max(high, value)


def estimate_noise(stretches: Sequence[Stretch], interval_s: float, trend: int = 2) -> Estimate:
    """The noise of isothermal stretches of rows of `interval_s`.

    Every stretch has a polynomial in time of order `trend` of its own (thermal tails). The scatter of the samples
    within a row tells N, unless it contradicts what rows show. Quantisation is part of the noise where it is needed to
    explain the rows. A coefficient that the data do not tell from zero at the 5 % level is zero and named. Raises
    InputError when no stretch is long enough, or nothing scatters.
    """
    fast, slow = squares_of(stretches, interval_s, trend)
    if not np.any(slow.total > 0.0):
        raise InputError("the output of the isothermal stretches is constant: there is no noise to read")
    active, squares = _ASKED, slow if fast is None else slow.and_(fast)
    best, lowest = _fitted(squares, active)
    with_steps = _fitted(squares, np.ones(4, dtype=bool))
    if with_steps[1] < lowest - _CONTRADICTED:
        active, (best, lowest) = np.ones(4, dtype=bool), with_steps
    tied = fast is not None
    if fast is not None:
        alone = _fitted(slow, active)
        apart = alone[1] + _fitted(fast, np.array([True, False, False, False]))[1]
        if lowest - apart > _CONTRADICTED:
            tied, squares, (best, lowest) = False, slow, alone
    found = np.sqrt(_told(squares, best))
    undetermined = tuple(name for name, value in zip(_NAMES, found[:3], strict=True) if value == 0.0)
    white, flicker, walk, steps = found.tolist()
    noise = Noise(white, flicker, walk, steps, undetermined=undetermined)
    return Estimate(noise, squares, best, tied, tuple(stretches), interval_s)


def _told(squares: Squares, best: FloatArray) -> FloatArray:
    """Variances (4,) without flicker and walk where the data do not tell them from zero."""
    flicker, walk = np.eye(4)[1], np.eye(4)[2]
    needed = [name for name in (flicker, walk) if not may_vanish(squares, best, name)]
    if len(needed) == 2:
        return best
    if not needed and may_vanish(squares, best, flicker + walk):
        return _fitted(squares, (best > 0.0) & (flicker + walk == 0.0))[0]
    kept = [name for name in (flicker, walk) if not needed or np.array_equal(name, needed[0])]
    simple = [_fitted(squares, (best > 0.0) & (flicker + walk - name == 0.0)) for name in kept]
    return min(simple, key=lambda found: found[1])[0]


def _fitted(squares: Squares, active: BoolArray) -> tuple[FloatArray, float]:
    """Most likely variances (4,), those that are not `active` zero, and -2 ln L."""
    unit = squares.unit[:, active]
    part = Squares(squares.total, squares.freedom, unit)
    start = squares.total.sum() / (squares.freedom @ unit) / unit.shape[1]
    found, at = most_likely(part, start)
    variances = np.zeros(len(active))
    variances[active] = found[0]
    return variances, float(at[0])
