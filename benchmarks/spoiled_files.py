"""What do files say that are not what they should be? Mutated YAML, DBC, CSV, MF4 and Parquet, through the commands.

    python -m benchmarks.spoiled_files --count 3000 --seed 1 --out spoiled_files.jsonl

Each case is a shipped or made file with mutations by bytes or by grammar (`benchmarks.mutations`), drawn by seed and
number, and read by the command that reads such files, in a process of its own. A case is wrong when there is a
traceback, more than one line of refusal, more than 10 s of processor time or more than 1 GB of memory. Results are
appended to the file as they come; what stands there already is not run again. Prints one JSON object; exit code 1 when
a case was wrong.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import resource
import signal
import sys
import tempfile
import traceback
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import psutil
from click.testing import CliRunner

from bench.base import BenchError, library
from bench.cli import main as bench
from benchmarks import campaigns
from benchmarks.killing import also_import
from benchmarks.mutations import BINARY, TEXT, mutated
from drivers.errors import DriverError
from drivers.wire import read_layouts

MOST_CPU_S, MOST_BYTES = 10.0, 10**9
PATIENCE_S = 300
"""Of the clock: other programs run, too, so that the processor time is what is judged [s]."""
ROWS = 2000
DBC = Path(__file__).parent.parent / "drivers" / "gyros" / "vibratory.dbc"


@dataclass(frozen=True)
class Case:
    """A mutated file of one kind."""

    kind: str
    number: int


@dataclass(frozen=True)
class Outcome:
    """What became of it."""

    case: Case
    code: int
    """Exit code of the command; -1: a traceback, -2: it did not end."""
    said: str
    """What it printed to stderr, or the end of the traceback."""
    cpu_s: float
    peak_bytes: int
    """Memory that it took, beside what every process begins with."""

    @property
    def wrong(self) -> str:
        """What is not as it should be; empty: nothing."""
        if self.code == -1 or "Traceback" in self.said:
            return "traceback"
        if self.code == -2 or self.cpu_s > MOST_CPU_S:
            return "over 10 s"
        if self.peak_bytes > MOST_BYTES:
            return "over 1 GB"
        if self.code not in {0, 1, 2}:
            return f"exit code {self.code}"
        return "more than one line" if self.code == 2 and self.said.strip().count("\n") > MOST_LINES else ""


MOST_LINES = 20
"""Of a refusal: a YAML file is told all that is wrong with it, a line each."""


def _table() -> dict[str, np.ndarray[Any, Any]]:
    source = np.random.default_rng(1)
    time = np.arange(ROWS) * 0.5
    return {"time": time, "rate": source.normal(5, 1, ROWS), "temperature": 25 + 20 * np.sin(time / 300)}


def _csv(path: Path) -> None:
    rows = zip(*_table().values(), strict=True)
    path.write_text(
        "time,rate,temperature\n" + "".join(f"{t:.3f},{r:.4f},{d:.3f}\n" for t, r, d in rows), encoding="utf-8"
    )


def _parquet(path: Path) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    pq.write_table(pa.table(_table()), path, row_group_size=ROWS // 4, compression="zstd")


def _mf4(path: Path) -> None:
    from asammdf import MDF, Signal

    table = _table()
    with MDF() as file:
        file.append([Signal(table[name], table["time"], name=name) for name in ("rate", "temperature")])
        file.save(path, compression=2)


def _log(path: Path) -> None:
    import can

    source, heads = random.Random(1), [message.id for message in read_layouts(DBC).values()]
    with can.Logger(str(path)) as log:
        for i in range(ROWS):
            data = source.randbytes(8)
            log.on_message_received(can.Message(i / 500, heads[i % len(heads)], is_extended_id=False, data=data))


def _copied(source: Path) -> Callable[[Path], None]:
    def copy(path: Path) -> None:
        path.write_bytes(source.read_bytes())

    return copy


def _columns(path: Path) -> None:
    path.write_text(COLUMNS, encoding="utf-8")


PROFILES = library()
GOOD: dict[str, tuple[str, Sequence[Callable[[Path], None]]]] = {
    "profile": (".yaml", [_copied(PROFILES / name) for name in ("quick.yaml", "ramp_-40_85.yaml", "rates_quick.yaml")]),
    "station": (".yaml", [_copied(path) for path in sorted((PROFILES / "stations").glob("*.yaml"))]),
    "model": (".yaml", [_copied(path) for path in sorted((PROFILES / "models").glob("*.yaml"))]),
    "limits": (".yaml", [_copied(path) for path in sorted((PROFILES / "limits").glob("*.yaml"))]),
    "columns": (".yaml", [_columns]),
    "dbc": (".dbc", [_copied(DBC)]),
    "csv": (".csv", [_csv]),
    "mf4": (".mf4", [_mf4]),
    "parquet": (".parquet", [_parquet]),
}
"""Ending and good files of each kind."""
COLUMNS = """\
time: {column: time, unit: s}
rate: {column: rate, unit: deg/h}
temperature: {column: temperature, unit: degC}
"""


@cache
def _good(kind: str) -> list[bytes]:
    """Contents of the good files of a kind."""
    ending, makers = GOOD[kind]
    found = []
    with tempfile.TemporaryDirectory() as scratch:
        for maker in makers:
            path = Path(scratch) / f"good{ending}"
            maker(path)
            found.append(path.read_bytes())
    return found


def content(case: Case, seed: int) -> bytes:
    """The mutated file."""
    source = random.Random(f"{seed} {case.kind} {case.number}")
    mutations = BINARY if case.kind in {"mf4", "parquet"} else TEXT
    return mutated(source.choice(_good(case.kind)), source, mutations)


def command(kind: str, file: Path, scratch: Path) -> list[str]:
    """The command that reads a file of this kind; empty for limits, which no short command reads."""
    if kind == "profile":
        return ["check", str(file)]
    if kind == "station":
        return ["check", str(PROFILES / "quick.yaml"), "--station", str(file)]
    if kind == "model":
        return ["add", "aging", "--model", str(file), "--out", str(scratch / "out.yaml")]
    if kind in {"columns", "dbc"}:
        (maker, name) = (_csv, "good.csv") if kind == "columns" else (_log, "good.log")
        maker(scratch / name)
        return ["import", str(scratch / name), f"--{kind}", str(file), "--preview"]
    return [] if kind == "limits" else ["import", str(file), "--preview"]


def _act(case: Case, file: Path, scratch: Path) -> tuple[int, str]:
    """Exit code and what was said."""
    arguments = command(case.kind, file, scratch)
    if not arguments:
        from bench.analysis import load_limits

        try:
            load_limits(file)
        except (BenchError, DriverError) as error:
            return 2, str(error)
        return 0, ""
    done = CliRunner().invoke(bench, arguments)
    if done.exception is not None and not isinstance(done.exception, SystemExit):
        return -1, "".join(traceback.format_exception(done.exception))[-1500:]
    return done.exit_code, done.stderr[-1500:]


@cache
def warm() -> None:
    """Import here what the commands import, so that it is not imported again in the process of each case."""
    with tempfile.TemporaryDirectory() as found:
        for kind, (ending, _) in GOOD.items():
            file, ours = Path(found) / f"good{ending}", Path(found) / "modules"
            file.write_bytes(_good(kind)[0])
            child = os.fork()
            if child == 0:
                _act(Case(kind, 0), file, Path(found))
                ours.write_text("\n".join(sorted(sys.modules)))
                os._exit(0)
            os.waitpid(child, 0)
            also_import(ours.read_text().split())


def run_case(case: Case, seed: int) -> Outcome:
    """Read one file in a process of its own."""
    warm()
    data = content(case, seed)
    with tempfile.TemporaryDirectory() as found:
        scratch = Path(found)
        file, answer = scratch / f"spoiled{GOOD[case.kind][0]}", scratch / "answer.json"
        file.write_bytes(data)
        begun = psutil.Process().memory_info().rss  # the child has this already
        child = os.fork()
        if child == 0:
            _child(case, file, scratch, answer)
        _, status, used = os.wait4(child, 0)
        code, said = json.loads(answer.read_text()) if answer.exists() else (-2, f"ended by {status}")
    return Outcome(case, code, said, round(used.ru_utime + used.ru_stime, 2), max(0, used.ru_maxrss * 1024 - begun))


def _child(case: Case, file: Path, scratch: Path, answer: Path) -> None:
    signal.alarm(PATIENCE_S)
    resource.setrlimit(resource.RLIMIT_CPU, (3 * int(MOST_CPU_S), 3 * int(MOST_CPU_S)))
    try:
        os.chdir(scratch)
        answer.write_text(json.dumps(_act(case, file, scratch)), encoding="utf-8")
    except BaseException:
        answer.write_text(json.dumps((-1, traceback.format_exc()[-1500:])), encoding="utf-8")
    finally:
        os._exit(0)


def cases(count: int) -> list[Case]:
    """So many, of every kind in turn."""
    kinds = list(GOOD)
    return [Case(kinds[i % len(kinds)], i // len(kinds)) for i in range(count)]


def campaign(todo: Sequence[Case], seed: int, out: Path) -> list[Outcome]:
    """Run what is not in the file yet; all outcomes that the file then holds."""
    return campaigns.resumed(
        todo, lambda case: run_case(case, seed), out, lambda outcome: outcome.case, asdict,
        lambda content: Outcome(**{**content, "case": Case(**content["case"])}),
    )  # fmt: skip


def main() -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("spoiled_files.jsonl"))
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--count", type=int, default=3000)
    arguments = parser.parse_args()
    outcomes = campaign(cases(arguments.count), arguments.seed, arguments.out)
    wrong = [outcome for outcome in outcomes if outcome.wrong]
    figures = {
        "n": len(outcomes),
        "seed": arguments.seed,
        "by_kind": Counter(outcome.case.kind for outcome in outcomes),
        "refused": sum(outcome.code == 2 for outcome in outcomes),
        "most_cpu_s": max(outcome.cpu_s for outcome in outcomes),
        "most_mb": max(outcome.peak_bytes for outcome in outcomes) // 10**6,
        "wrong": [{**asdict(outcome), "wrong": outcome.wrong} for outcome in wrong],
    }
    print(json.dumps(figures, indent=1))
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
