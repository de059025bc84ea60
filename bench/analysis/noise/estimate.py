"""The noise of a gyro as part of every fit: white + flicker + rate random walk, by maximum likelihood.

Estimates of noise use the restricted likelihood (D. A. Harville, JASA 72 (1977) 320): trends that were fitted away do
not make the noise look smaller. Models are compared by the full likelihood, as the restricted one must not be.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from bench.analysis.noise.allan import FLICKER_FLOOR
from bench.analysis.noise.components import COMPONENTS, Squares, Stretch, Times, floor_unit, squares_of, white_unit
from bench.analysis.noise.likelihood import Gls, NoiseLattice, Point, Record, Surface, gls
from bench.analysis.noise.probability import CHI2_95
from bench.analysis.noise.variances import interval, may_vanish, most_likely, standard_errors
from bench.analysis.noise.whitening import Ratios, Whitener
from bench.base import BoolArray, FloatArray, InputError

_MOST_RAMP_ROWS = 600
_NAMES = COMPONENTS[:3]
_FLICKER, _WALK, _STEPS = range(1, 4)  # places in COMPONENTS
_CONTRADICTED = 10.83  # of the likelihood ratio with one degree of freedom, passed by chance once in a thousand runs
_CORRELATED = 20.0  # the same for a variance and the correlation time that is looked for among many
_RATIO, _CLOSE = 1.6, 13  # correlation times that are tried, and how many about the best
_SLOWEST = 1.0 / 12.0  # of the longest stretch: slower correlated noise is not told from flicker and walk


@dataclass(frozen=True)
class Noise:
    """Coefficients of IEEE 952: angle random walk N, bias instability B, rate random walk K.

    Each comes with its 95 % interval. `undetermined` names those that the data cannot tell from zero: their
    value is zero, their interval's upper end is what they could be.
    """

    white: float
    """N [deg/sqrt(h)]; with correlated noise, that of averages over much more than its correlation time"""
    flicker: float
    """B [deg/h]"""
    walk: float
    """K [deg/h/sqrt(h)]"""
    quantisation: float = 0.0
    """Q [deg]; zero unless the rows cannot be explained without"""
    correlated: float = 0.0
    """Standard deviation [deg/h] of noise whose correlation falls as exp(-t / correlation_s), such as a filter leaves
    (IEEE 952, Markov noise); zero unless the rows cannot be explained without"""
    correlation_s: float = 0.0
    intervals: dict[str, tuple[float, float]] = field(default_factory=dict)
    undetermined: tuple[str, ...] = ()

    @staticmethod
    def of(ratios: Ratios, sigma2: float, interval_s: float) -> Noise:
        """From ratios to the white variance sigma2 [(deg/h)^2] of means over `interval_s`."""
        square = sigma2 * np.array([interval_s / 3600.0, ratios.flicker, ratios.walk])
        return Noise(*np.sqrt(square).tolist())

    def ratios(self, interval_s: float) -> Ratios:
        """Flicker and walk relative to the white variance of means over `interval_s`."""
        variance = self.white_variance(interval_s)
        return Ratios(self.flicker**2 / variance, self.walk**2 / variance)

    def white_variance(self, interval_s: float) -> float:
        """Variance of the fast part of one mean [(deg/h)^2]: of white noise, and of correlated noise if any."""
        return float(self.variances() @ white_unit(interval_s, self.times_s))

    @property
    def times_s(self) -> Times:
        """Correlation time [s] of the correlated noise, if there is any."""
        return (self.correlation_s,) if self.correlated > 0.0 else ()

    def variances(self) -> FloatArray:
        """N^2 without the correlated noise, B^2, K^2, Q^2 (4,), and the variance of correlated noise if any (5,)."""
        white = max(self.white**2 - _slow(self.times_s) * self.correlated**2, 0.0)
        others = [self.flicker, self.walk, self.quantisation, *(self.correlated for _ in self.times_s)]
        return np.array([white, *(value**2 for value in others)])

    def allan_deviation(self, tau_s: FloatArray) -> FloatArray:
        """Allan deviation (m,) [deg/h] of this noise over averaging times (m,) [s], by IEEE 952."""
        tau_h = tau_s / 3600.0
        white, flicker, walk, steps = self.variances()[:4]
        square = white / tau_h + (FLICKER_FLOOR**2) * flicker + walk * tau_h / 3.0 + 3.0 * steps / tau_h**2
        for correlation_s in self.times_s:
            span = tau_s / correlation_s
            rest = 1.0 - (3.0 - 4.0 * np.exp(-span) + np.exp(-2.0 * span)) / (2.0 * span)
            square = square + 2.0 * self.correlated**2 * rest / span
        return np.asarray(np.sqrt(square))

    def std_of_means(self, interval_s: float, duration_s: float) -> float:
        """The floor [deg/h]: expected RMS of the means over `interval_s` of a run of `duration_s` about their own mean.

        That is what remains when a constant is fitted to a gyro with this noise and no other error.
        """
        unit = floor_unit(rows_of(interval_s, duration_s), interval_s, self.times_s)
        return float(np.sqrt(unit @ self.variances()))


def _one(order: int, times_s: Times) -> FloatArray:
    """Weights (4 or 5,) of N^2 in slow averages, or of another coefficient's square."""
    weights = np.zeros(4 + len(times_s))
    weights[order] = 1.0
    if order == 0:
        weights[4:] = _slow(times_s)
    return weights


def _slow(times_s: Times) -> float:
    """N^2 [deg^2/h] of correlated noise of one in averages over much more than its correlation time."""
    return sum(2.0 * tau_s / 3600.0 for tau_s in times_s)


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
    sigma2, way = surface.known[best][1], surface.lattice.way(best)
    noise = Noise.of(way.ratios, sigma2, surface.lattice.interval_s)
    return NoiseFit(way.ratios, sigma2, noise, gls(first.X, first.y, way, sigma2))


@dataclass(frozen=True)
class Explained:
    """Squares, their most likely variances (4 or 5,) and -2 ln L; correlation time [s] of the correlated noise if any.

    `tied` says whether samples within a row scatter as the rows do: the squares have both then.
    """

    squares: Squares
    best: FloatArray
    """`Estimate.noise` has none that the data do not tell from zero."""
    lowest: float
    tied: bool
    times_s: Times


@dataclass(frozen=True)
class Estimate:
    """The noise of isothermal stretches, and the sums of squares that it was found from."""

    noise: Noise
    """Without intervals, which take longer."""
    ways: tuple[Explained, ...]
    """What explains the squares best, and the same with other correlation times that the data do not reject."""
    stretches: tuple[Stretch, ...]
    interval_s: float

    @property
    def white_samples(self) -> bool:
        """Whether samples within a row scatter as white noise that was seen between rows; N is then known from them."""
        return self.ways[0].tied

    def with_intervals(self) -> Noise:
        """The noise with its 95 % intervals."""
        ends = {
            name: self._around(getattr(self.noise, name), partial(_one, order), simulated=name != "white")
            for order, (name, best) in enumerate(zip(COMPONENTS, self.ways[0].best, strict=False))
            if best > 0.0
        }
        return replace(self.noise, intervals=ends)

    def floor_interval(self, interval_s: float, duration_s: float) -> tuple[float, float]:
        """95 % interval of `Noise.std_of_means`: N, B and K as far as the data leave them open."""
        value = self.noise.std_of_means(interval_s, duration_s)
        return self._around(value, partial(floor_unit, rows_of(interval_s, duration_s), interval_s))

    def quantisation(self) -> tuple[float, float, float]:
        """Q [deg] and its 95 % interval; zero where the data do not tell it from zero."""
        squares = self.ways[0].squares
        best = _fitted(squares, np.ones(squares.unit.shape[1], dtype=bool))[0]
        best = np.maximum(best, 1e-6 * standard_errors(squares, best))
        low, high = interval(squares, best, np.eye(len(best))[3])
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

    def _around(
        self, value: float, weights: Callable[[Times], FloatArray], simulated: bool = True
    ) -> tuple[float, float]:
        """Interval of the root of `weights` @ variances, over all correlation times that are not rejected."""
        lowest, alone = self.ways[0].lowest, not self.ways[0].times_s
        ends = [
            interval(way.squares, way.best, weights(way.times_s), simulated and alone, way.lowest - lowest)
            for way in self.ways
        ]
        return min(value, *(low for low, _ in ends)), max(value, *(high for _, high in ends))


def estimate_noise(stretches: Sequence[Stretch], interval_s: float, trend: int = 2) -> Estimate:
    """The noise of isothermal stretches of rows of `interval_s`.

    Every stretch has a polynomial in time of order `trend` of its own (thermal tails). The scatter of the samples
    within a row tells N, unless it contradicts what rows show. Quantisation and correlated noise are parts of the noise
    where they are needed to explain the rows. A coefficient that the data do not tell from zero at the 5 % level is
    zero and named. Raises InputError when no stretch is long enough, or nothing scatters.
    """
    slowest_s = _SLOWEST * interval_s * max(len(stretch.rate) for stretch in stretches)
    times_s = interval_s * _RATIO ** np.arange(1.0, np.log(max(slowest_s / interval_s, 1.0)) / np.log(_RATIO))
    ways: tuple[Explained, ...] = ()
    for _ in range(2):  # the second time close to the best of the first
        fast, slow = squares_of(stretches, interval_s, trend, tuple(times_s.tolist()))
        if not np.any(slow.total > 0.0):
            raise InputError("the output of the isothermal stretches is constant: there is no noise to read")
        ways = ways or (_explained(fast, slow),)
        others = sorted((_explained(fast, slow, time) for time in enumerate(times_s)), key=lambda way: way.lowest)
        if not others or others[0].lowest > ways[0].lowest - (0.0 if ways[0].times_s else _CORRELATED):
            break
        ways = tuple(way for way in others if way.lowest < others[0].lowest + CHI2_95)
        times_s = others[0].times_s[0] * np.geomspace(1.0 / _RATIO, _RATIO, _CLOSE)
    variances, tau = _told(ways)
    values = np.sqrt(variances)
    undetermined = tuple(name for name, value in zip(_NAMES, values[:3], strict=True) if value == 0.0)
    values[0] = np.sqrt(_one(0, tau) @ variances)
    white, flicker, walk, steps, *correlated = values.tolist()
    noise = Noise(white, flicker, walk, steps, undetermined=undetermined)
    for value, tau_s in zip(correlated, tau, strict=True):
        noise = replace(noise, correlated=value, correlation_s=tau_s)
    return Estimate(noise, ways, tuple(stretches), interval_s)


def _explained(fast: Squares | None, slow: Squares, time: tuple[int, float] | None = None) -> Explained:
    """With correlated noise of the time of this order [s], or without any."""
    order, times_s = (None, ()) if time is None else (time[0], (float(time[1]),))
    fast, slow = None if fast is None else fast.with_time(order), slow.with_time(order)
    squares = slow if fast is None else slow.and_(fast)
    every = np.ones(squares.unit.shape[1], dtype=bool)
    active = every & (np.arange(every.size) != _STEPS)
    best, lowest = _fitted(squares, active)
    with_steps = _fitted(squares, every)
    if with_steps[1] < lowest - _CONTRADICTED:
        active, (best, lowest) = every, with_steps
    if fast is not None:
        alone = _fitted(slow, active)
        apart = alone[1] + _fitted(fast, np.arange(every.size) == 0)[1]
        if lowest - apart > _CONTRADICTED:
            return Explained(slow, alone[0], apart, False, times_s)
    return Explained(squares, best, lowest, fast is not None, times_s)


def _told(ways: tuple[Explained, ...]) -> tuple[FloatArray, Times]:
    """Variances (4 or 5,) without flicker and walk where the data do not tell them from zero, and correlation time."""

    def may_go(*orders: int) -> bool:
        return any(may_vanish(way.squares, way.best, _ones(way, orders), way.lowest - ways[0].lowest) for way in ways)

    def without(*orders: int) -> tuple[float, FloatArray, Times]:
        found = [(*_fitted(way.squares, (way.best > 0.0) & (_ones(way, orders) == 0.0)), way.times_s) for way in ways]
        return min(((lowest, best, times_s) for best, lowest, times_s in found), key=lambda one: one[0])

    needed = [order for order in (_FLICKER, _WALK) if not may_go(order)]
    if len(needed) == 2:
        return ways[0].best, ways[0].times_s
    if not needed and may_go(_FLICKER, _WALK):
        return without(_FLICKER, _WALK)[1:]
    left_out = [order for order in (_FLICKER, _WALK) if order not in needed]
    return min((without(order) for order in left_out), key=lambda one: one[0])[1:]


def _ones(way: Explained, orders: tuple[int, ...]) -> FloatArray:
    weights = np.zeros(len(way.best))
    weights[list(orders)] = 1.0
    return weights


def _fitted(squares: Squares, active: BoolArray) -> tuple[FloatArray, float]:
    """Most likely variances (4 or 5,), those that are not `active` zero, and -2 ln L."""
    unit = squares.unit[:, active]
    part = Squares(squares.total, squares.freedom, unit)
    start = squares.total.sum() / (squares.freedom @ unit) / unit.shape[1]
    found, at = most_likely(part, start)
    variances = np.zeros(len(active))
    variances[active] = found[0]
    return variances, float(at[0])
