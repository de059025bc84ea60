"""Simulated stations for tests of other projects: with their gyro, their chamber, faults and hidden effects by name."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bench import acquisition, commands
from bench.base import Document, InputError, dump, nearest_or_all, parse_yaml, read_yaml
from bench.testing.outcome import Outcome

if TYPE_CHECKING:
    from drivers.sim.sender import Frames

UNIT, BUS = "UNIT-1", "can0"
CURVE = {"mechanism": "static_bias", "coefficients_dph": [1.0, 20.0, 5.0], "reference_degc": 25}
QUIET = {"angle_random_walk": 0.005, "bias_instability": 0.01, "rate_random_walk": 0.01}
FAST: Mapping[str, Any] = {
    "air_j_per_k": 300, "heater_w": 2000, "net_cooling_w": [[-60, 600], [130, 2000]], "cooling_lag_s": 1,
    "sensor_lag_s": 3, "compressor_delay_s": [1, 2], "compressor_minimum_s": [1, 2], "disturbance_k": 0.02,
    "fixture_j_per_k": 60, "fixture_w_per_k": 10, "case_j_per_k": 12, "case_w_per_k": 2, "case_heat_w": 0.1,
    "heating": {"band_k": 20, "integral_s": 60, "derivative_s": 1},
    "cooling": {"band_k": 20, "integral_s": 60, "derivative_s": 1},
}  # fmt: skip
"""A chamber and a gyro of little mass: minutes of simulated time take the place of hours."""
PROFILE: Mapping[str, Any] = {
    "name": "minutes",
    "segments": [
        {"kind": "ramp", "to_degc": 45, "rate_degc_per_min": 12},
        {"kind": "soak", "duration_min": 0.5},
        {"kind": "ramp", "to_degc": 5, "rate_degc_per_min": 12},
        {"kind": "ramp", "to_degc": 25, "rate_degc_per_min": 12},
    ],
}
"""What `run` executes unless it is given a profile: eight minutes of simulated time, 5 to 45 degC."""


@dataclass(frozen=True)
class BenchStation:
    """A simulated station with one unit."""

    folder: Path
    """Its file and its runs are here."""
    file: Document
    settings: acquisition.StationSettings
    senders: Mapping[str, Frames] = field(default_factory=dict)

    @classmethod
    def make(cls, folder: Path, options: Mapping[str, Any]) -> BenchStation:
        """Write the station file of these options (see `content`) to a folder, or take the file `station`.

        `frames` makes what the unit sends. InputError for options that are wrong.
        """
        given = dict(options)
        frames, own = given.pop("frames", None), given.pop("station", None)
        if own is None:
            path = folder / "station.yaml"
            path.write_text(dump(content(**given)), encoding="utf-8")
            file = read_yaml(path)
        elif given:
            raise InputError(f"a station file says it all: leave out {', '.join(given)}", own)
        else:
            file = read_yaml(own)
        settings = commands.load_station(file)
        return cls(folder, file, settings, {} if frames is None else {settings.units[0].serial: frames})

    def run(self, profile: str | Path | Mapping[str, Any] = PROFILE) -> Outcome:
        """Execute a profile: that of a file, or its content. How the run ended is in the outcome, and is not raised.

        InputError where profile or station are wrong, before anything moves.
        """
        own = parse_yaml(json.dumps(profile), "profile") if isinstance(profile, Mapping) else read_yaml(profile)
        ended = acquisition.run_job(
            commands.job_of(own, self.file, commands.Task((), {}, self.folder / "reports", senders=self.senders))
        )
        return Outcome.of(ended.run, ended.error)


def content(  # noqa: PLR0913 - one argument for each thing that a test may change
    *,
    chamber: str | Path = "watlow_f4t",
    gyro: str | Path | None = None,
    signals: Mapping[str, Any] | None = None,
    interface: str = "virtual",
    fd: bool = False,
    effects: Sequence[str] | Mapping[str, Mapping[str, Any]] = (),
    faults: Sequence[str | Mapping[str, Any]] = (),
    rate_table: bool = False,
    start_degc: float = 25.0,
    seed: int = 1,
) -> dict[str, Any]:
    """A station file.

    `chamber` is a register map, by name or file. `gyro` is a DBC, by name or file, `signals` a mapping as in a station
    file. `effects` are hidden in the unit: names, or names with their parameters (`drivers.sim.truth`). `faults` are
    names, for faults from the start to the end, or entries of a station file. `start_degc` is what the room has.
    """
    unit: dict[str, Any] = {"serial": UNIT, "bus": BUS}
    if gyro is not None:
        unit["gyro"] = _placed(gyro, ".dbc")
    if signals is not None:
        unit["signals"] = dict(signals)
    named = effects if isinstance(effects, Mapping) else {name: {} for name in effects}
    hidden = [{"mechanism": name, **given} for name, given in named.items()]
    if signals is None:
        unit["simulation"] = {"truth": [CURVE, *hidden], "noise": QUIET}
    found: dict[str, Any] = {
        "name": "test",
        "simulated": True,
        "seed": seed,
        "ambient_degc": start_degc,
        "chamber": {
            "map": _placed(chamber, ".yaml", ".yml"),
            "lowest_degc": -40,
            "highest_degc": 90,
            "heating_degc_per_min": 30,
            "cooling_degc_per_min": 30,
            "simulation": dict(FAST),
        },
        "buses": {BUS: {"interface": interface, "channel": "bench", **({"fd": True} if fd else {})}},
        "units": [unit],
    }
    if rate_table:
        found["buses"]["table"] = {"interface": "virtual", "channel": "table"}
        found["rate_table"] = {"driver": "cia402", "bus": "table", "node": 5, "counts_per_degree": 11650.8444}
        found["rate_table"] |= {"highest_dps": 200, "accel_dps2": 50}
    found["faults"] = [_fault(one) for one in faults]
    return found


def _fault(given: str | Mapping[str, Any]) -> dict[str, Any]:
    """An entry of a station file; a name alone is a fault of the chamber, or of the unit where chambers have none."""
    from bench.acquisition import OF_CHAMBER, OF_UNIT

    entry = {"fault": given} if isinstance(given, str) else dict(given)
    name = str(entry.get("fault"))
    if name not in OF_CHAMBER and name not in OF_UNIT and "on" not in entry:
        raise InputError(f"fault {name!r} is not known{nearest_or_all(name, [*OF_CHAMBER, *OF_UNIT])}")
    return {"at_s": 0.0, "on": "chamber" if name in OF_CHAMBER else UNIT} | entry


def _placed(name: str | Path, *suffixes: str) -> str:
    """A file as a full path, so that it is not looked for beside the station file; other names as they are."""
    path = Path(name)
    return str(path.absolute()) if path.suffix.lower() in suffixes else str(name)
