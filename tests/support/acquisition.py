"""Short simulated runs, for every test of the acquisition half."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from bench.acquisition.profile.profile import Profile, profile_from_text
from bench.acquisition.run.runner import Job
from bench.acquisition.run.status import Status
from bench.acquisition.station.serve import Served, keep_running, serve_station
from bench.acquisition.station.settings.station import StationSettings
from bench.acquisition.station.station import Station
from bench.base import config

STATION = Path(__file__).parents[2] / "profiles" / "stations" / "simulated.yaml"
SHORT = """\
name: short
segments:
  - {kind: ramp, to_degc: 24.5, rate_degc_per_min: 2, arrival_band_degc: 0.5}
  - {kind: soak, duration_min: 0.5}
"""
LONG = """\
name: long
segments:
  - {kind: ramp, to_degc: 85, rate_degc_per_min: 2}
  - {kind: soak, duration_min: 600}
"""


def station(**changes: Any) -> StationSettings:
    """The embedded simulator, with some top-level keys changed."""
    return config.load_config(
        config.parse_yaml(json.dumps(station_content(**changes)), "station.yaml"), StationSettings
    )


def station_content(interface: str | None = None, **changes: Any) -> dict[str, Any]:
    """The content of its file; `interface` of its CAN bus."""
    content = dict(config.read_yaml(STATION).content) | changes
    if interface is not None:
        content["buses"] = {"can0": {"interface": interface, "channel": "bench"}}
    return content


MODEL = """\
name: line
effects:
  - polynomial: {order: 1}
"""


def job(out: Path, text: str = SHORT, settings: StationSettings | None = None) -> Job:
    """A job whose run folder goes below `out`."""
    profile: Profile = profile_from_text(text)
    return Job(profile, text, settings or station(), json.dumps(station_content()), {"model.yaml": MODEL}, out=out)


def at(t_s: float, action: Callable[[Station], Any]) -> Callable[[Station, Status], None]:
    """An onlooker that does something once, when bench time has come."""
    done: list[Any] = []

    def look(station: Station, status: Status) -> None:
        if status.t_s >= t_s and not done:
            done.append(action(station))

    return look


@contextmanager
def elsewhere(settings: StationSettings) -> Iterator[Served]:
    """The servers of `bench sim`, running in real time."""
    over = threading.Event()
    with serve_station(settings) as served:
        thread = threading.Thread(target=keep_running, args=(served.station.advance, 1.0, over.is_set))
        thread.start()
        try:
            yield served
        finally:
            over.set()
            thread.join()
