"""The noise of a gyro: Allan deviation, whitening, likelihood, and the estimate of white, flicker and random walk."""

from bench.analysis.noise.allan import AllanCurve, allan_deviation, allan_pyramid
from bench.analysis.noise.estimate import Noise, NoiseFit, estimate_noise, expected_rms, profile_noise
from bench.analysis.noise.likelihood import Gls, Record, gls
from bench.analysis.noise.whitening import Ratios, Whitener

__all__ = [
    "AllanCurve",
    "Gls",
    "Noise",
    "NoiseFit",
    "Ratios",
    "Record",
    "Whitener",
    "allan_deviation",
    "allan_pyramid",
    "estimate_noise",
    "expected_rms",
    "gls",
    "profile_noise",
]
