"""Does anything that must not pass get a certificate, or into a unit?

    python -m benchmarks.false_pass --out false_pass.jsonl --seed 1

Each attempt changes one thing in a copy of an archive whose calibration passes, and then asks for a certificate and for
a flash, or for a verification. Results are appended to the file as they come; what stands there already is not run
again. Prints one JSON object; exit code 1 where one attempt passed.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import shutil
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from bench.analysis.judging.verification import verify
from bench.base import BenchError
from bench.record import CHAIN, RunFolder
from benchmarks import campaigns
from benchmarks.damaged_archive import CHECK, OTHER, RUN, UNIT, Archive
from benchmarks.damaged_files import invoke
from tests.support.run_folders import CYCLE, make_run, ramp_run

Change = Callable[[Archive], None]


@dataclass(frozen=True)
class Outcome:
    """What came of an attempt: the commands that let it pass."""

    name: str
    passed: tuple[str, ...]
    said: str


def edited(name: str, where: str, value: Any) -> Change:
    """A value of a JSON file in the archive; a number is a factor, None removes the key."""

    def change(archive: Archive) -> None:
        path = archive.root / UNIT / name
        content = json.loads(path.read_text(encoding="utf-8"))
        *steps, last = [int(step) if step.isdigit() else step for step in where.split(".")]
        inner = content
        for step in steps:
            inner = inner[step]
        if value is None:
            del inner[last]
        else:
            made = inner[last] * value if isinstance(value, float) else value
            assert made != inner.get(last) if isinstance(inner, dict) else made != inner[last], f"{where} stays"
            inner[last] = made
        path.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")

    return change


def copied(source: str, target: str) -> Change:
    """A file of the archive over another one."""

    def change(archive: Archive) -> None:
        shutil.copy(archive.root / UNIT / source, archive.root / UNIT / target)

    return change


def removed(*names: str) -> Change:
    """Files that are there no more."""

    def change(archive: Archive) -> None:
        for name in names:
            (archive.root / UNIT / name).unlink()

    return change


def replaced(name: str, old: str, new: str) -> Change:
    """Text in a file."""

    def change(archive: Archive) -> None:
        path = archive.root / UNIT / name
        text = path.read_text(encoding="utf-8")
        assert old in text, (name, old)
        path.write_text(text.replace(old, new), encoding="utf-8")

    return change


def all_of(*changes: Change) -> Change:
    """Several changes."""

    def change(archive: Archive) -> None:
        for one in changes:
            one(archive)

    return change


def forged(archive: Archive) -> None:
    """The coefficients doubled, and the list signed anew with a key of the forger's own."""
    own = os.environ["BENCH_KEYS"]
    edited(f"{RUN}/calibration.json", "calibration.coefficients.0.value", 2.0)(archive)
    os.environ["BENCH_KEYS"] = f"{archive.root}/../forger"
    try:
        data = (archive.run_folder / "calibration.json").read_bytes()
        (archive.run_folder / CHAIN).unlink()
        from bench.record import put

        put(archive.run_folder, {"calibration.json": data}, ["manifest.json"])
    finally:
        os.environ["BENCH_KEYS"] = own


def noted(archive: Archive) -> None:
    """A line of the ledger that makes a foreign manifest the known one."""
    with (archive.root / "ledger.jsonl").open("a", encoding="utf-8") as file:
        file.write(json.dumps({"kind": "run", "run": f"{UNIT}/{RUN}", "manifest": "0" * 64}) + "\n")


CALIBRATION, MANIFEST, THEIRS = f"{RUN}/calibration.json", f"{RUN}/manifest.json", f"{CHECK}/manifest.json"
FILES: dict[str, Change] = {
    "residual a tenth": edited(CALIBRATION, "calibration.rms_dph", 0.1),
    "residual of the report a tenth": edited(CALIBRATION, "residual.rms_dph", 0.1),
    "first coefficient doubled": edited(CALIBRATION, "calibration.coefficients.0.value", 2.0),
    "amplitude doubled": edited(CALIBRATION, "calibration.scaled.values.0", 2.0),
    "uncertainty a tenth": edited(CALIBRATION, "calibration.coefficients.0.std", 0.1),
    "validity widened": edited(CALIBRATION, "calibration.validity.temperature.to", 120.0),
    "condition of the fit": edited(CALIBRATION, "calibration.condition", 0.01),
    "verdict of the analysis": edited(CALIBRATION, "verdict.verdict", "adequate "),
    "noise floor a tenth": edited(CALIBRATION, "noise.floor_dph", 0.1),
    "a quantity": edited(CALIBRATION, "quantities.0.value", 0.1),
    "interval of a quantity": edited(CALIBRATION, "quantities.0.high", 0.1),
    "averaging time": edited(CALIBRATION, "averaging_s", 2.0),
    "unit of the calibration": edited(CALIBRATION, "unit", "SIM-0002"),
    "warnings of the report": edited(CALIBRATION, "verdict.warnings", ["none"]),
    "calibration of another run": copied(f"{OTHER}/calibration.json", CALIBRATION),
    "calibration removed": removed(CALIBRATION),
    "manifest of another run": copied(f"{OTHER}/manifest.json", MANIFEST),
    "manifest and list of another run": all_of(
        copied(f"{OTHER}/manifest.json", MANIFEST), copied(f"{OTHER}/{CHAIN}", f"{RUN}/{CHAIN}")
    ),
    "manifest, list and calibration of another run": all_of(
        *(copied(f"{OTHER}/{name}", f"{RUN}/{name}") for name in ("manifest.json", CHAIN, "calibration.json"))
    ),
    "simulated removed": edited(MANIFEST, "simulated", None),
    "unit of the manifest": edited(MANIFEST, "unit", "SIM-0002"),
    "run of the manifest": edited(MANIFEST, "run", "another"),
    "day of the run": edited(MANIFEST, "created", "2026-11-22T06:00:00+00:00"),
    "losses removed": edited(MANIFEST, "losses", {}),
    "outcome of a segment": edited(MANIFEST, "segments.2.outcome", "held"),
    "sampling rate": edited(MANIFEST, "sample_rate_hz", 4),
    "hashes removed": edited(MANIFEST, "files", {}),
    "hash of the means": edited(MANIFEST, "files", {"means.parquet": "0" * 64}),
    "manifest altered and list removed": all_of(edited(MANIFEST, "losses", {}), removed(f"{RUN}/{CHAIN}")),
    "list removed": removed(f"{RUN}/{CHAIN}"),
    "list emptied": edited(f"{RUN}/{CHAIN}", "files", {}),
    "list unsigned": edited(f"{RUN}/{CHAIN}", "signature", ""),
    "list of no key": all_of(edited(f"{RUN}/{CHAIN}", "signature", ""), edited(f"{RUN}/{CHAIN}", "keys", [])),
    "forged with another key": forged,
    "means of another run": copied(f"{OTHER}/means.parquet", f"{RUN}/means.parquet"),
    "data of another run": copied(f"{OTHER}/data.parquet", f"{RUN}/data.parquet"),
    "data removed": removed(f"{RUN}/data.parquet"),
    "limits widened": replaced(f"{RUN}/limits.yaml", "upper: 5", "upper: 50"),
    "limits removed": removed(f"{RUN}/limits.yaml"),
    "verdict against limits": replaced(f"{RUN}/limits.json", '"PASS"', '"MARGINAL"'),
    "verdict against limits removed": removed(f"{RUN}/limits.json"),
    "model exchanged": replaced(f"{RUN}/model.yaml", "polynomial", "spline"),
    "events removed": removed(f"{RUN}/events.jsonl"),
    "due date of the equipment": replaced(f"{RUN}/equipment.yaml", "2027-03-01", "2028-03-01"),
    "a line in the ledger": noted,
}
"""What is done to the calibration or its archive; certificate and flash must both refuse."""
CHECKS: dict[str, Change] = {
    "verdict of the verification": replaced(f"{CHECK}/verification.json", '"PASS"', '"MARGINAL"'),
    "verification removed": removed(f"{CHECK}/verification.json"),
    "manifest of the verification": edited(THEIRS, "losses", {}),
    "purpose of the verification": edited(THEIRS, "purpose", None),
    "coefficients of the verification": edited(THEIRS, "unit_identity.coefficient_set", 9),
    "means of the verification": copied(f"{RUN}/means.parquet", f"{CHECK}/means.parquet"),
    "list of the verification": removed(f"{CHECK}/{CHAIN}"),
    "what was flashed": edited(f"{RUN}/flash.json", "calibration_id", "0x00000000"),
    "flash removed": removed(f"{RUN}/flash.json"),
    "the calibration as its own verification": lambda archive: (
        shutil.rmtree(archive.check_folder),
        shutil.copytree(archive.run_folder, archive.check_folder),
    )[0],
}
"""What is done to the verification; the certificate must refuse."""


def thinned(share: float, columns: dict[str, Any]) -> None:
    """Samples at random."""
    gone = np.random.default_rng(1).random(columns["rate"].size) < share
    columns["rate"] = np.where(gone, np.nan, columns["rate"])


def holed(from_s: float, to_s: float, columns: dict[str, Any]) -> None:
    """A stretch, counted from the end where it is negative."""
    time = columns["time"]
    first, last = (bound + time[-1] if bound < 0 else bound for bound in (from_s, to_s))
    columns["rate"] = np.where((time >= first) & (time <= last), np.nan, columns["rate"])


DOOR = {"why": "door", "channel": "chamber_temperature", "from_s": 0.0, "to_s": 4e3, "samples": 1, "duration_s": 4e3}
LACKING: dict[str, tuple[Callable[[dict[str, Any]], None], dict[str, Any]]] = {
    "45 % missing": (partial(thinned, 0.45), {}),
    "2 % missing": (partial(thinned, 0.02), {}),
    "two minutes missing": (partial(holed, 4000.0, 4120.0), {}),
    "the end missing": (partial(holed, -900.0, -0.1), {}),
    "the beginning missing": (partial(holed, 0.0, 900.0), {}),
    "half of the frames lost": (lambda columns: None, {"losses": {"received": 9000, "lost": 9000}}),
    "half of the frames invalid": (lambda columns: None, {"losses": {"received": 18000, "invalid": 9000}}),
    "rows left out": (lambda columns: None, {"left_out": [DOOR]}),
    "aborted": (lambda columns: None, {"state": "aborted", "cause": "operator"}),
}
"""What a verification run lacks; `bench verify` must not say PASS."""


def attempt(name: str, archive: Archive, scratch: Path) -> Outcome:
    """One attempt on a copy of the archive."""
    if name in LACKING:
        return _verified(name, scratch)
    copy = Archive(archive.copy(scratch))
    (FILES | CHECKS)[name](copy)
    done = {
        command: invoke(command, copy.root) for command in ("certificate", "flash that")[: 2 if name in FILES else 1]
    }
    passed = tuple(command for command, result in done.items() if result.exit_code == 0)
    return Outcome(name, passed, " | ".join(result.output.strip()[-300:] for result in done.values()))


def _verified(name: str, scratch: Path) -> Outcome:
    spoil, manifest = LACKING[name]
    made = ramp_run(CYCLE, seed=2, loop_dph=0.0)
    columns = {**made["columns"], "rate": np.random.default_rng(3).normal(0.0, 0.4, made["columns"]["time"].size)}
    spoil(columns)
    shutil.rmtree(scratch / "check", ignore_errors=True)
    run = make_run(scratch / "check", columns, made["segments"], purpose="verification", **manifest)
    try:
        found = verify(RunFolder(run), None, None, {})
    except BenchError as error:
        return Outcome(name, (), str(error))
    return Outcome(name, ("verify",) if found.verdict.within else (), str(found.judged.get("refusals")))


def names(seed: int) -> list[str]:
    """All attempts, in an order that the seed gives."""
    found = [*FILES, *CHECKS, *LACKING]
    random.Random(seed).shuffle(found)
    return found


def campaign(todo: Sequence[str], archive: Archive, out: Path) -> list[Outcome]:
    """Try what is not in the file yet, and append it; all outcomes that the file then holds."""
    with tempfile.TemporaryDirectory() as scratch:
        return campaigns.resumed(
            todo, lambda name: attempt(name, archive, Path(scratch)), out, lambda outcome: outcome.name, asdict, _made
        )


def _made(content: dict[str, Any]) -> Outcome:
    return Outcome(**{**content, "passed": tuple(content["passed"])})


def main() -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("false_pass.jsonl"))
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--sample", type=int, help="only so many, drawn by the seed")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as made:
        os.environ["BENCH_KEYS"] = f"{made}/keys"
        archive = Archive.made(Path(made) / "reports", diagnosed=False)
        outcomes = campaign(names(arguments.seed)[: arguments.sample], archive, arguments.out)
    passed = [outcome for outcome in outcomes if outcome.passed]
    figures = {"n": len(outcomes), "seed": arguments.seed, "passed": [asdict(outcome) for outcome in passed]}
    print(json.dumps(figures, indent=1))
    return 1 if passed else 0


if __name__ == "__main__":
    sys.exit(main())
