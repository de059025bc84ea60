"""Facts about a live run from its folder: profile, station, units, user."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import Any

from bench.acquisition import LiveRun, StationSettings, load_profile
from bench.base import BenchError, library, read_yaml
from bench.commands import JOB_MARK
from bench.web.live.finding import ids
from bench.web.plans import catalog
from drivers.errors import DriverError

_ANSWERS = ("plan", "station", "units", "limits", "models")
"""What was chosen for a run on the page."""


def describe(live: LiveRun, start: dict[str, Any] | None) -> dict[str, Any]:
    """The constant part of the answer of `/live`; `start`: the start, if the page started the run."""
    runs = ids(live.folders)
    station = station_of(live.path)
    about: dict[str, Any] = {
        "run": runs[0],
        "runs": runs,
        "unit": live.path.parent.name,
        "profile": "",
        "shipped": True,
        "station": station.name if station else "",
        "simulated": station.simulated if station else False,
        "started": live.file.start,
        "start": start["start"] if start else None,
        "who": start["who"] if start else None,
        "job": job_of(live.path),
        "again": {key: start[key] for key in _ANSWERS if key in start} if start and not start["digest"] else None,
        "nominal_s": 0.0,
        "segments_s": [],
        "curve": [],
    }
    with contextlib.suppress(BenchError, OSError):
        profile = load_profile(live.path / "profile.yaml")
        legs_s = [round(leg.nominal_s, 1) for leg in profile.legs()]
        about |= {"profile": profile.name, "nominal_s": profile.duration_s, "segments_s": legs_s}
        about["curve"] = catalog.curve(profile)
        about["shipped"] = catalog.is_shipped(live.path / "profile.yaml", library() / f"{profile.name}.yaml")
    return about


def job_of(folder: Path) -> str | None:
    """Id of the calibration that a run was made for."""
    mark = folder / JOB_MARK
    if not mark.is_file():
        return None
    with contextlib.suppress(BenchError, AttributeError):
        job = read_yaml(mark).content.get("job")
        return f"{folder.parent.name}/{job}" if isinstance(job, str) else None
    return None


def station_of(folder: Path) -> StationSettings | None:
    """The station of a run; None where its copy cannot be read."""
    with contextlib.suppress(BenchError, DriverError, OSError):
        return catalog.station(folder / "station.yaml")
    return None


def in_use(live: LiveRun) -> dict[str, str]:
    """The equipment of a live run, each with a text that names the run."""
    station = station_of(live.path)
    if station is None:
        return {}
    text = f"the run {ids(live.folders)[0]} uses it"
    return dict.fromkeys(catalog.equipment(station, (folder.parent.name for folder in live.folders)), text)
