"""Is every damaged, swapped or stale file noticed by every command that reads it?

    python -m benchmarks.damaged_files --out damaged.jsonl --seed 1

Each file of a run folder, of its verification, of the registry and of a flash, damaged in ten ways, before every
command that reads it (found by watching which files it opens). Commands run in this process. Results are appended to
the file as they come; what stands there already is not run again. Prints one JSON object; exit code 1 where a command
used a damaged file without a word, or ended with a traceback.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from click.testing import CliRunner

from bench.archive import FILE
from bench.commands import files
from bench.record import CHAIN, faults
from benchmarks.damaged_archive import KINDS, UNIT, Archive, damage

COMMANDS = {
    "report": "report RUN --model polynomial",
    "compare": "compare RUN --model polynomial",
    "every sample": "compare RUN --model polynomial --every-sample",
    "diagnose": "diagnose RUN --model polynomial",
    "noise": "noise RUN",
    "improve": "improve RUN --model polynomial --out OUT/m.yaml",
    "export": "export RUN --format csv --out OUT",
    "certificate": "certificate RUN --draft --verification CHECK --issued 2026-11-21 --out OUT/c.pdf",
    "compare with": "compare RUN --check CHECK --model polynomial",
    "export C": "export RUN --format c --out OUT",
    "diff": "diff RUN CHECK",
    "diff back": "diff CHECK RUN",
    "flash that": "flash UNIT --run RUN --out ROOT --quiet",
    "lot": "registry lot L1 UNIT --out ROOT",
    "operator": "registry operator Ada --out ROOT",
    "show run": "registry show RUN --out ROOT",
    "replay": "replay RUN",
    "flash": "flash UNIT --out ROOT --quiet",
    "resume": "resume RUN",
    "list": "registry list --out ROOT",
    "show": "registry show UNIT --out ROOT",
    "rebuild": "registry rebuild --out ROOT",
    "compare registry": "registry rebuild --check --out ROOT",
    "equipment": "registry equipment list --out ROOT --on 2026-11-21",
    "certificates": "registry certificates --out ROOT",
    "fleet": "fleet --out ROOT --csv OUT/f.csv",
    "archive": "verify-archive --out ROOT",
}
NOT_READ = ("report.html", "export")
"""Made for people; only `verify-archive` reads them."""
MADE_BY = {"report": ("compare.json", "calibration.json", "limits.json", "diagnosis.json", "report.html")}
"""Files that a command makes anew, so that it does not use the damaged ones."""
TABLES = {
    "means.parquet": {"report", "compare", "every sample", "diagnose", "export", "certificate", "diff", "flash"}
    | {"compare with", "export C", "diff back", "flash that", "noise", "improve"},
    "data.parquet": {"report", "every sample", "export", "certificate", "flash", "replay", "export C", "flash that"},
    "registry.sqlite": {"list", "show", "rebuild", "compare registry", "equipment", "fleet", "lot", "operator"}
    | {"show run", "certificates"},
}
"""Commands that read these; pyarrow and SQLite open their files unseen."""


@dataclass(frozen=True)
class Case:
    """One file, damaged in one way, before one command."""

    file: str
    kind: str
    command: str


@dataclass(frozen=True)
class Outcome:
    """What the command did."""

    case: Case
    exit_code: int
    named: bool
    """Whether its output names the file, or what is wrong with its folder."""
    traceback: str = ""

    @property
    def silent(self) -> bool:
        """Nothing was said of a file that was used."""
        return not self.traceback and not self.named

    @property
    def wrong(self) -> str:
        """What is not as it should be; empty: nothing."""
        return self.traceback or ("silent" if self.silent else "")


class Watched:
    """Which files below a folder are opened for reading, as the interpreter tells it."""

    def __init__(self) -> None:
        """Hooks stay until the process ends: one for all commands."""
        self.root, self.seen = "", set[str]()
        sys.addaudithook(self._hear)

    def _hear(self, event: str, arguments: tuple[Any, ...]) -> None:
        if self.root and event == "open" and isinstance(arguments[0], str | os.PathLike):
            writes = (arguments[2] or 0) & (os.O_WRONLY | os.O_RDWR)
            path = os.fspath(arguments[0])
            if not writes and isinstance(path, str) and path.startswith(self.root):
                self.seen.add(os.path.relpath(path, self.root))


def readers(archive: Archive, watched: Watched, scratch: Path) -> dict[str, set[str]]:
    """Commands by the file that they read."""
    found: dict[str, set[str]] = {name: set() for name in archive.files()}
    for command in COMMANDS:
        root = archive.copy(scratch)
        watched.root, watched.seen = f"{root}{os.sep}", set()
        done = invoke(command, root)
        watched.root = ""
        if done.exception is not None and not isinstance(done.exception, SystemExit):
            raise RuntimeError(f"{command} fails on an undamaged archive") from done.exception
        for name, commands in found.items():
            table = TABLES.get(Path(name).name)
            other = archive.check in name and command in {"certificate", "diff", "diff back", "compare with"}
            here = archive.run in name or other or "/" not in name
            reads = command in table and here if table and command != "archive" else name in watched.seen
            if reads or command == "archive":
                commands.add(command)
    return found


def cases(archive: Archive, watched: Watched, seed: int, scratch: Path) -> list[Case]:
    """All of them, in an order that the seed gives."""
    found = [
        Case(name, kind, command)
        for name, commands in readers(archive, watched, scratch).items()
        for kind in KINDS
        for command in sorted(commands)
        if command == "archive" or not name.endswith(NOT_READ)
    ]
    random.Random(seed).shuffle(found)
    return found


def invoke(command: str, root: Path) -> Any:
    """A command on the archive in `root`."""
    archive = Archive(root)
    out = root.parent / "out"
    out.mkdir(exist_ok=True)
    words = {"RUN": archive.run_folder, "CHECK": archive.check_folder, "ROOT": root, "UNIT": UNIT}
    from bench.cli import main

    line = [
        str(words.get(word, word)).replace("OUT", str(out)) if word != "--out" else word
        for word in COMMANDS[command].split()
    ]
    files._say.cache_clear()  # said once a process, which here is many commands
    return CliRunner().invoke(main, line)


def run_case(case: Case, archive: Archive, seed: int, scratch: Path) -> Outcome:
    """One file damaged in a copy of the archive, and one command on it."""
    root = archive.copy(scratch)
    damage(root / case.file, case.kind, archive.other(case.file), random.Random(f"{seed} {case}"))
    harmless = _same(root / case.file, archive.root / case.file)
    done = invoke(case.command, root)
    path = root / case.file
    made_anew = path.name in MADE_BY.get(case.command, ()) and not any(faults(path.parent))
    said = done.output + (done.stderr if done.stderr_bytes is not None else "")
    bug = done.exception if not isinstance(done.exception, SystemExit) else None
    named = (
        done.exit_code == 2
        or Path(case.file).name in said
        or any(text in said for text in ("cannot be read", "not on disk", "no chain.seal"))
    )
    if case.file == FILE:  # SQLite has no checksums, and pages that nothing uses
        made_anew = done.output == invoke(case.command, archive.copy(scratch)).output
    named = named or made_anew or harmless
    return Outcome(case, done.exit_code, named, "" if bug is None else f"{type(bug).__name__}: {bug}"[:200])


def _same(path: Path, original: Path) -> bool:
    """Whether a signed list still says the same, as without its last line feed: its content is signed, not its form."""
    try:
        return path.name == CHAIN and json.loads(path.read_bytes()) == json.loads(original.read_bytes())
    except (OSError, ValueError):
        return False


def campaign(todo: Sequence[Case], archive: Archive, seed: int, out: Path) -> Iterator[Outcome]:
    """Run what is not in the file yet, and append it; all outcomes that the file then holds."""
    known = list(read(out))
    yield from known
    done = {outcome.case for outcome in known}
    if known:
        out.write_text("".join(f"{json.dumps(asdict(outcome))}\n" for outcome in known), encoding="utf-8")
    with closing(out.open("a", encoding="utf-8")) as file, tempfile.TemporaryDirectory() as scratch:
        for case in todo:
            if case not in done:
                outcome = run_case(case, archive, seed, Path(scratch))
                file.write(f"{json.dumps(asdict(outcome))}\n")
                file.flush()
                yield outcome


def read(path: Path) -> Iterator[Outcome]:
    """Outcomes of an earlier, perhaps interrupted, campaign; its last line may be torn."""
    for line in path.read_text(encoding="utf-8").splitlines() if path.exists() else ():
        try:
            content = json.loads(line)
        except ValueError:
            continue
        yield Outcome(**{**content, "case": Case(**content["case"])})


def main() -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("damaged_files.jsonl"))
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--sample", type=int, help="only so many, drawn by the seed")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as made, tempfile.TemporaryDirectory() as scratch:
        os.environ.setdefault("BENCH_KEYS", f"{made}/keys")
        archive = Archive.made(Path(made) / "reports")
        todo = cases(archive, Watched(), arguments.seed, Path(scratch))
        outcomes = list(campaign(todo[: arguments.sample], archive, arguments.seed, arguments.out))
    wrong = [outcome for outcome in outcomes if outcome.wrong]
    figures = {
        "n": len(outcomes),
        "of": len(todo),
        "seed": arguments.seed,
        "refused": sum(outcome.exit_code == 2 for outcome in outcomes),
        "silent": sum(outcome.silent for outcome in outcomes),
        "tracebacks": sum(bool(outcome.traceback) for outcome in outcomes),
        "wrong": [{**asdict(outcome.case), "wrong": outcome.wrong} for outcome in wrong],
    }
    print(json.dumps(figures, indent=1))
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
