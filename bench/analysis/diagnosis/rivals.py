"""What a next experiment has to tell apart: effects as found, and the noise they were found in."""

from __future__ import annotations

from dataclasses import dataclass

from bench.analysis.diagnosis.candidates import Theta
from bench.analysis.effects.base import Effect
from bench.analysis.noise.likelihood import Point


@dataclass(frozen=True)
class Rival:
    """One of the effects that the runs cannot tell apart, with the parameters and the evidence found for it."""

    name: str
    effect: Effect
    theta: Theta
    evidence: float


@dataclass(frozen=True)
class NoiseLevel:
    """Noise that the runs showed: lattice point, and the white variance of one mean [(deg/h)^2]."""

    point: Point
    sigma2: float
