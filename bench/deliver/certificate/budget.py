"""The uncertainty budget of the corrected output (JCGM 100); docs/uncertainty.md explains the contributions."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from bench.analysis import COVERAGE, PROBABILITY
from bench.deliver.certificate.evidence import Evidence
from bench.record import Manifest


@dataclass(frozen=True)
class Contribution:
    """One source: a standard uncertainty [deg/h], how it was found (type A or B) and its distribution."""

    source: str
    kind: str
    distribution: str
    standard_dph: float


@dataclass(frozen=True)
class Budget:
    """Contributions, combined as the root of the sum of squares, and expanded."""

    contributions: tuple[Contribution, ...]

    @property
    def combined_dph(self) -> float:
        """Combined standard uncertainty [deg/h]."""
        return float(np.sqrt(sum(part.standard_dph**2 for part in self.contributions)))

    @property
    def expanded_dph(self) -> float:
        """Expanded uncertainty [deg/h], k = 2."""
        return COVERAGE * self.combined_dph

    def to_json(self) -> dict[str, Any]:
        """All rows and sums."""
        return {
            "measurand": "bias left in the corrected output, a mean at one temperature",
            "contributions": [asdict(part) for part in self.contributions],
            "combined_dph": self.combined_dph,
            "expanded_dph": self.expanded_dph,
            "coverage_factor": COVERAGE,
            "coverage_probability": PROBABILITY,
        }


def budget(evidence: Evidence) -> Budget:
    """Model error beyond the noise, the noise, steps of the temperature sensor, resolution of the output."""
    known = {quantity.name: quantity.value for quantity in evidence.quantities()}
    error, floor = known["residual_rms_dph"], known.get("noise_floor_dph", np.nan)
    noise = min(error, floor) if np.isfinite(floor) else 0.0
    how = "verification run" if evidence.verification else "data held out of the fit"
    known_floor = "noise floor of the means" if np.isfinite(floor) else "noise floor: not known, part of model error"
    return Budget(
        (
            Contribution(f"model error on {how}", "A", "normal", float(np.sqrt(error**2 - noise**2))),
            Contribution(known_floor, "A", "normal", noise),
            Contribution(
                "steps of the unit's temperature sensor",
                "B",
                "rectangular",
                known.get("temperature_step_error_dph", 0.0),
            ),
            Contribution("resolution of the output", "B", "rectangular", _resolution(evidence.manifest)),
        )
    )


def _resolution(manifest: Manifest) -> float:
    """Standard uncertainty of one sample [deg/h]: an upper bound, since a mean of many samples resolves more."""
    return float(manifest.rate_step_dph or 0.0) / float(np.sqrt(12.0))
