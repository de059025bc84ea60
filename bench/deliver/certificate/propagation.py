"""Propagation of uncertainty: the GUM's formula by GTC, and distributions by Monte Carlo beside it.

Sources: JCGM 100:2008 clause 5 and annex G (effective degrees of freedom), JCGM 101:2008 clauses 6.4 and 7.9 (adaptive
number of trials).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

import numpy as np

from bench.base import FloatArray, finite
from bench.deliver.certificate.stated import DIVISORS

PERCENT = 95.45
"""Coverage probability for which k = 2 at infinite degrees of freedom."""
_TRIALS = 10_000
_MOST_TRIALS = 200


@dataclass(frozen=True)
class Contribution:
    """One source of uncertainty: `sensitivity` times the `power`-th power of an error [own unit] is in deg/h."""

    source: str
    kind: str
    """A: from repeated observations; B: from other knowledge."""
    distribution: str
    standard: float
    """Standard uncertainty [own unit]; NaN where it is not known."""
    unit: str
    sensitivity: float
    degrees_of_freedom: float
    origin: str
    """Where the figure comes from."""
    power: int = 1
    label: str = ""
    """Names the error where others are correlated with it."""

    @property
    def standard_dph(self) -> float:
        """Standard uncertainty of the output [deg/h]; of a second-order error its RMS about zero, sqrt(3) c u^2."""
        factor = 1.0 if self.power == 1 else float(np.sqrt(3.0))
        return abs(self.sensitivity) * factor * self.standard**self.power if self.sensitivity else 0.0

    def draw(self, rng: np.random.Generator, trials: int) -> FloatArray:
        """Errors of the output (trials,) [deg/h]; t for a few degrees of freedom (JCGM 101, 6.4.9)."""
        half = self.standard * DIVISORS.get(self.distribution, 1.0)
        if self.distribution == "rectangular":
            error = rng.uniform(-half, half, trials)
        elif self.distribution == "triangular":
            error = rng.triangular(-half, 0.0, half, trials) if half else np.zeros(trials)
        elif self.distribution == "arcsine":
            error = half * np.sin(rng.uniform(0.0, 2.0 * np.pi, trials))
        elif np.isfinite(self.degrees_of_freedom):
            error = self.standard * rng.standard_t(self.degrees_of_freedom, trials)
        else:
            error = self.standard * rng.standard_normal(trials)
        return np.asarray(self.sensitivity * error**self.power)

    def to_json(self) -> dict[str, Any]:
        """All of it; null for infinite degrees of freedom and for what is not known."""
        known = {**asdict(self), "standard_dph": self.standard_dph}
        known = {key: finite(value) if isinstance(value, float) else value for key, value in known.items()}
        return {key: value for key, value in known.items() if key != "label"}


@dataclass(frozen=True)
class Budget:
    """Contributions at one condition, propagated; `correlations` are by pairs of labels."""

    contributions: tuple[Contribution, ...]
    correlations: Mapping[tuple[str, str], float]

    @property
    def unknown(self) -> tuple[str, ...]:
        """Sources that act here and whose uncertainty nobody stated: without them there is no U."""
        return tuple(part.source for part in self.contributions if part.sensitivity and np.isnan(part.standard))

    @cached_property
    def _combined(self) -> tuple[float, float]:
        """Combined standard uncertainty [deg/h], effective degrees of freedom (Welch-Satterthwaite)."""
        import GTC  # takes a second

        parts, matrix = self._acting
        if self.unknown or not parts:
            return (np.nan if self.unknown else 0.0), np.inf
        paired = np.asarray((matrix != np.eye(len(parts))).any(axis=0))
        inputs = [
            GTC.ureal(0.0, part.standard_dph, part.degrees_of_freedom, independent=not together)
            for part, together in zip(parts, paired.tolist(), strict=True)
        ]
        for i, j in np.argwhere(np.triu(matrix, 1)).tolist():
            GTC.set_correlation(float(matrix[i, j]), inputs[i], inputs[j])
        total = sum(inputs[1:], start=inputs[0])
        return float(total.u), float(total.df)

    @cached_property
    def _acting(self) -> tuple[tuple[Contribution, ...], FloatArray]:
        """Contributions that are not zero (n,), and the correlation of their effects on the output (n, n)."""
        parts = tuple(part for part in self.contributions if part.standard_dph)
        matrix = np.eye(len(parts))
        for (one, other), coefficient in self.correlations.items():
            for i, j in np.ndindex(matrix.shape):
                if parts[i].label == one and parts[j].label == other:
                    sign = np.sign(parts[i].sensitivity * parts[j].sensitivity)
                    matrix[i, j] = matrix[j, i] = sign * coefficient
        return parts, matrix

    @property
    def combined_dph(self) -> float:
        """Combined standard uncertainty [deg/h]."""
        return self._combined[0]

    @property
    def effective_degrees_of_freedom(self) -> float:
        """Of the combined standard uncertainty."""
        return self._combined[1]

    @cached_property
    def by_formula_dph(self) -> float:
        """U = k u [deg/h] with the quantile of t at the effective degrees of freedom; k = 2 where they are infinite."""
        import GTC

        dof = self.effective_degrees_of_freedom
        return float(GTC.reporting.k_factor(dof, PERCENT)) * self.combined_dph if dof >= 1.0 else np.nan

    @cached_property
    def expanded_dph(self) -> float:
        """Expanded uncertainty U [deg/h]: by the formula where Monte Carlo confirms it, else by Monte Carlo.

        It is confirmed within half of the second digit of u (JCGM 101, 8.1). Few degrees of freedom that dominate are
        the usual reason why it is not: the formula is then too small.
        """
        if not self.by_formula_dph > 0.0:
            return self.by_formula_dph
        drawn, _ = self.monte_carlo
        most = 0.5 * 10.0 ** (np.floor(np.log10(self.combined_dph)) - 1.0)
        return self.by_formula_dph if abs(drawn - self.by_formula_dph) <= most else drawn

    @property
    def coverage_factor(self) -> float:
        """U over u."""
        return self.expanded_dph / self.combined_dph if self.combined_dph else np.nan

    @cached_property
    def monte_carlo(self) -> tuple[float, int]:
        """Half-width [deg/h] that holds the error with the coverage probability, and the number of trials.

        Trials are added until twice the standard error of the half-width is below half of its second digit.
        """
        rng = np.random.default_rng(0)
        widths: list[float] = []
        while len(widths) < _MOST_TRIALS:
            error = np.abs(self._errors(rng))
            widths.append(float(np.quantile(error, PERCENT / 100.0)))
            if len(widths) > 5 and 2.0 * np.std(widths, ddof=1) / np.sqrt(len(widths)) < _tolerance(widths):
                break
        return float(np.mean(widths)), _TRIALS * len(widths)

    def _errors(self, rng: np.random.Generator) -> FloatArray:
        parts, matrix = self._acting
        paired = np.asarray((matrix != np.eye(len(parts))).any(axis=0))
        total = np.zeros(_TRIALS)
        for part, together in zip(parts, paired.tolist(), strict=True):
            total += 0.0 if together else part.draw(rng, _TRIALS)
        if paired.any():
            size = np.array([part.standard_dph for part in parts])[paired]
            covariance = matrix[np.ix_(paired, paired)] * np.outer(size, size)
            total += rng.multivariate_normal(np.zeros(size.size), covariance, _TRIALS).sum(axis=1)
        return total

    def figures(self) -> dict[str, float | None]:
        """Results, null where a source is not known."""
        return {
            "combined_dph": finite(self.combined_dph),
            "effective_degrees_of_freedom": finite(self.effective_degrees_of_freedom),
            "coverage_factor": finite(self.coverage_factor),
            "expanded_dph": finite(self.expanded_dph),
            "by_formula_dph": finite(self.by_formula_dph),
        }


def _tolerance(widths: Sequence[float]) -> float:
    """Half a unit of the second significant digit of their mean (JCGM 101, 7.9.2)."""
    mean = float(np.mean(widths))
    return 0.5 * 10.0 ** (np.floor(np.log10(mean)) - 1.0) if mean > 0 else np.inf
