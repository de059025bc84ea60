"""`bench diff`: two runs, of one unit or of two."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from bench.archive.difference import results, setting
from bench.record import CalibrationRecord, Manifest, RunFolder, listed, open_run, use


def difference_of(a: Path, b: Path) -> dict[str, Any]:
    """All differences; InputError where a path is not a run folder."""
    runs = open_run(a), open_run(b)
    for run in runs:
        use(run.path, *(path.name for path in (run.means, run.data) if path.name in listed(run.path)))
    manifests = [run.manifest() for run in runs]
    known = [CalibrationRecord.find(run.path) or CalibrationRecord() for run in runs]
    floors = [side.noise.floor_dph for side in known]
    floor_dph = max((floor for floor in floors if floor is not None), default=float("nan"))
    pairs = zip(known, manifests, strict=True)
    versions = [side.software or manifest.versions for side, manifest in pairs]
    return {
        "a": _named(runs[0], manifests[0]),
        "b": _named(runs[1], manifests[1]),
        "facts": setting.facts(*manifests),
        "profile": setting.files(*runs, "profile.yaml"),
        "station": setting.files(*runs, "station.yaml"),
        "versions": list(setting.trees(versions[0], versions[1])),
        "segments": [{k: v for k, v in entry.items() if k != "weight"} for entry in setting.segments(*manifests)],
        "losses": setting.losses(*manifests),
        "quantities": results.quantities(*known),
        "coefficients": results.coefficients(*known),
        "curves": results.curves(a, b, floor_dph),
    }


def _named(run: RunFolder, manifest: Manifest) -> dict[str, Any]:
    return {"run": str(run.path), "unit": manifest.unit, "profile": manifest.profile, "created": manifest.created}
