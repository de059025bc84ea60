"""A small archive with everything that commands read, and the ways in which its files are damaged."""

from __future__ import annotations

import random
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args

from bench.analysis.effects.model import load_model
from bench.analysis.judging.judge import analyse, judged_by
from bench.analysis.judging.limits import load_limits
from bench.analysis.judging.verification import verify
from bench.base.yaml12 import parse_yaml
from bench.commands.acquisition import load_station
from bench.commands.flash_source import from_run
from bench.commands.flash_unit import flash
from bench.commands.registering import add_equipment, register
from bench.deliver.report.html import write_report
from bench.record import RunFolder, put
from tests.support.run_folders import CYCLE, make_run, ramp_run

Kind = Literal[
    "empty",
    "halved",
    "one byte less",
    "one bit",
    "one digit",
    "zeros",
    "garbage",
    "swapped",
    "deleted",
    "a folder",
]
KINDS = get_args(Kind)
UNIT = "SIM-0001"
RUN, CHECK, OTHER = "20261121T060000Z_ramp", "20261121T180000Z_check", "20261120T060000Z_ramp"
LIMITS = "name: test\nlimits:\n  - {quantity: residual_rms_dph, unit: deg/h, upper: 5, reason: budget}\n"
EQUIPMENT = "equipment:\n  - {name: sensor, serial: PT-1, calibrated: 2026-03-01, due: 2027-03-01}\n"
LEGS = tuple((name, kind, target, 700.0 if kind == "soak" else n) for name, kind, target, n in CYCLE)


@dataclass(frozen=True)
class Archive:
    """An archive in a folder."""

    root: Path
    run: str = f"{UNIT}/{RUN}"
    check: str = f"{UNIT}/{CHECK}"

    @classmethod
    def made(cls, root: Path, *, diagnosed: bool = True) -> Archive:
        """Calibration, another one, flash and verification of one unit, registered."""
        made = cls(root)
        for name, seed in ((OTHER, 7), (RUN, 1)):
            _calibrated(root / UNIT / name, seed, diagnosed and name == RUN)
        station = load_station(None)
        unit = station.chosen([UNIT])[0]
        done = flash(station, unit, from_run(made.run_folder, unit), root)
        narrow = ramp_run(
            [(n, k, min(max(t, -35.0), 80.0), a) for n, k, t, a in LEGS], rate_hz=1.0, seed=2, loop_dph=0.0
        )
        columns = {**narrow["columns"], "rate": narrow["columns"]["rate"] * 0.0 + 0.01}
        make_run(
            made.check_folder, columns, narrow["segments"], profile="check", purpose="verification", sample_rate_hz=1,
            created="2026-11-21T18:00:00+00:00", unit_identity={"serial": 1, "coefficient_set": done.coefficient_set},
        )  # fmt: skip
        verify(RunFolder(made.check_folder), made.run_folder, load_limits(parse_yaml(LIMITS, "limits.yaml")), {})
        register([root / UNIT / name for name in (OTHER, RUN, CHECK)])
        add_equipment(root, None, "sensor", "PT-1", "sensor")
        return made

    @property
    def run_folder(self) -> Path:
        """The calibration."""
        return self.root / self.run

    @property
    def check_folder(self) -> Path:
        """The verification."""
        return self.root / self.check

    def files(self) -> list[str]:
        """Every file that is damaged, by path; the other calibration is what they are swapped with."""
        found = (path.relative_to(self.root).as_posix() for path in sorted(self.root.rglob("*")) if path.is_file())
        return [name for name in found if OTHER not in name and not name.startswith(".") and "-shm" not in name]

    def other(self, name: str) -> Path | None:
        """The file of the same name of another run."""
        path = self.root / UNIT / OTHER / Path(name).name
        return path if path.is_file() else None

    def copy(self, scratch: Path) -> Path:
        """The whole archive in a folder of its own."""
        target = scratch / "reports"
        shutil.rmtree(target, ignore_errors=True)
        shutil.copytree(self.root, target)
        return target


def _calibrated(folder: Path, seed: int, diagnosed: bool) -> None:
    folder.mkdir(parents=True)
    texts = {"limits.yaml": LIMITS, "equipment.yaml": EQUIPMENT, "model.yaml": load_model("polynomial").to_yaml(),
             "profile.yaml": "name: p\nsegments:\n  - {kind: soak, duration_min: 3}\n"}  # fmt: skip
    put(folder, {name: text.encode() for name, text in texts.items()}, unit=UNIT, run=folder.name)
    created = f"{folder.name[:4]}-{folder.name[4:6]}-{folder.name[6:8]}T06:00:00+00:00"
    make_run(
        folder,
        **ramp_run(LEGS, rate_hz=1.0, seed=seed, loop_dph=0.0),
        created=created,
        simulated=True,
        sample_rate_hz=1,
    )
    analysis = analyse(folder, [load_model("polynomial")], diagnose=diagnosed)
    write_report(judged_by(analysis, load_limits(parse_yaml(LIMITS, "limits.yaml"))))


def damage(path: Path, kind: Kind, other: Path | None, chance: random.Random) -> None:
    """Damage a file in one way; what cannot be done to it is done as a flipped bit."""
    data = path.read_bytes()
    path.unlink()
    if kind == "a folder":
        path.mkdir()
    elif kind != "deleted":
        foreign = data if other is None else other.read_bytes()
        made = _damaged(data, kind, foreign, chance, binary=path.suffix in {".parquet", ".sqlite", ".bin"})
        path.write_bytes(made if made != data else _flipped(data, chance))


def _damaged(data: bytes, kind: Kind, foreign: bytes, chance: random.Random, *, binary: bool) -> bytes:
    digits = [] if binary else [i for i, byte in enumerate(data) if byte in b"123456789"]
    start = chance.randrange(max(1, len(data) - 8))
    whole = {"empty": b"", "halved": data[: len(data) // 2], "one byte less": data[:-1], "swapped": foreign,
             "garbage": data + b"\0garbage\n", "zeros": data[:start] + bytes(8) + data[start + 8 :]}  # fmt: skip
    if kind == "one digit" and digits:
        at = chance.choice(digits)
        return data[:at] + str(data[at] % 9 + 1).encode() + data[at + 1 :]
    return whole.get(kind, data)


def _flipped(data: bytes, chance: random.Random) -> bytes:
    at = chance.randrange(max(1, len(data)))
    return data[:at] + bytes([data[at] ^ 1 << chance.randrange(8)]) + data[at + 1 :] if data else b"\0"
