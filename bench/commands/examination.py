"""`bench doctor`: the station file beside the equipment."""

from __future__ import annotations

from pathlib import Path

from bench import acquisition
from bench.base import InputError
from bench.commands.acquisition import load_station, refuse_wrong
from bench.commands.files import write
from bench.commands.results.measure import ContractTried, Examined, NoticesTried, Proposed


def doctor(station_path: Path | None, listen_s: float) -> Examined:
    """Everything that the equipment of a station says, compared where there is something to compare with."""
    station = load_station(station_path)
    refuse_wrong(station)
    return Examined(acquisition.examine(station, listen_s))


def propose(station_path: Path | None, listen_s: float, target: Path) -> Proposed:
    """A mapping for units that nobody described, from what their buses carry; written to `target`."""
    found = acquisition.propose(load_station(station_path), listen_s)
    write(target, found.yaml())
    return Proposed(found, target)


def try_notices(station_path: Path | None) -> NoticesTried:
    """Send a trial to everybody whom a station tells of its runs; InputError where it tells nobody."""
    station = load_station(station_path)
    if station.notify is None:
        text = (
            "this station tells nobody: fill in 'Notices' on the page 'Laboratory and equipment', or name a "
            "notification file in it by `notify: FILE` (docs/howto/production.md)"
        )
        raise InputError(text, station_path)
    return NoticesTried(station.notify, dict(acquisition.try_out(station.notify)))


def contract(station_path: Path | None) -> ContractTried:
    """The contract of register maps for the map of a station; touches no equipment."""
    from drivers.contract import try_map
    from drivers.registers import load_map

    name = load_station(station_path).chamber.map
    return ContractTried(name, try_map(load_map(name)))
