"""SIGKILL at every place where a command changes a file: is a record lost, half, twice or unregistered afterwards?

    python -m benchmarks.kill_commands --out kills.jsonl --kills 400 --seed 1

Each command that writes is run once whole, and its changes of files are counted (opening for writing, renaming,
removing, making a folder). It is then killed, with its whole process group, just before one of them, drawn at random,
and given again as a user would give it. Results are appended to the file as they come; what stands there already is
not run again. Prints one JSON object; exit code 1 when anything was lost, half, twice or unregistered.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import shutil
import signal
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from bench.base import InputError
from bench.record import RECORDS, LimitsRecord
from bench.record import Record as Stored
from benchmarks import campaigns

PROFILES = Path(__file__).parent.parent / "profiles"
UNIT = "SIM-0001"
LINKED = {".parquet", ".gtbj"}
"""Files that no command changes in place; they are linked, not copied."""
_CHANGES = {"os.rename", "os.remove", "os.mkdir", "os.rmdir", "os.link", "os.truncate"}
_SAID = 300

BRIEF = """\
name: brief
settle: {band_degc: 1, unit_band_degc: 5, slope_degc_per_min: 20, dwell_min: 0.05, timeout_min: 5}
segments:
  - {kind: soak, name: warm, duration_min: 0.5}
"""
LOG = "time [s],rate [deg/h],temperature [degC]\n"


@dataclass(frozen=True)
class Command:
    """A command that writes: its words, what it needs, and how its work is given again after a kill."""

    name: str
    words: Callable[[Path], Sequence[object]]
    """Arguments of `bench` in the folder of the trial."""
    again: Callable[[Path], Sequence[Sequence[object]]] | None = None
    """Arguments after a kill, where a user would not give the same command: one after the other, until one is taken."""


def _run(folder: Path) -> Path:
    return next((folder / "reports" / UNIT).glob("*_quick_calibration"))


def _unfinished(folder: Path) -> Sequence[Sequence[object]]:
    """What a user gives after `bench run` was killed: what each refusal advises."""
    begun = [*(folder / "reports").glob("*/*_brief")]
    known = [words for run in begun for words in (("resume", run, "--quiet"), ("report", run, "--model", "polynomial"))]
    return [*known, _brief(folder)]


def _brief(folder: Path) -> Sequence[object]:
    return ("run", folder / "brief.yaml", "--quiet", "--model", "polynomial", "--out", folder / "reports")


COMMANDS = {
    command.name: command
    for command in (
        Command("run", _brief, _unfinished),
        Command("report", lambda at: ("report", _run(at), "--model", "polynomial")),
        Command("diagnose", lambda at: ("diagnose", _run(at), "--model", "polynomial")),
        Command("export", lambda at: ("export", _run(at), "--format", "json", "--out", at / "exported")),
        Command("flash", lambda at: ("flash", UNIT, "--out", at / "reports", "--quiet")),
        Command("import", lambda at: ("import", at / "log.csv", "--unit", "IMP-1", "--out", at / "reports")),
        Command("registry rebuild", lambda at: ("registry", "rebuild", "--out", at / "reports")),
        Command("registry lot", lambda at: ("registry", "lot", "L1", UNIT, "--out", at / "reports")),
    )
}


def in_a_copy(words: Sequence[object], root: Path, kill_at: int | None = None) -> tuple[int | None, int, str]:
    """Run a command in a copy of this process: exit code (None: killed), changes of files, last words.

    `kill_at`: it is killed just before its change of that number below `root`.
    """
    counter, said = root / ".changes", root / ".said"
    pid = os.fork()
    if pid == 0:
        os.setsid()
        _child(words, root, kill_at, counter, said)
    _, status = os.waitpid(pid, 0)
    code = None if os.WIFSIGNALED(status) else os.waitstatus_to_exitcode(status)
    changes = counter.stat().st_size if counter.exists() else 0
    words_of = said.read_text(encoding="utf-8", errors="replace") if said.exists() else ""
    counter.unlink(missing_ok=True)
    said.unlink(missing_ok=True)
    return code, changes, words_of[-_SAID:]


def _child(words: Sequence[object], root: Path, kill_at: int | None, counter: Path, said: Path) -> None:
    out = os.open(said, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    for stream in (1, 2):
        os.dup2(out, stream)
    marks = os.open(counter, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    inside = f"{root}{os.sep}"
    done = 0

    def watch(event: str, facts: tuple[object, ...]) -> None:
        nonlocal done
        if event == "open":
            path, mode, flags = facts[0], facts[1], facts[2]
            changes = isinstance(flags, int) and bool(flags & (os.O_WRONLY | os.O_RDWR | os.O_CREAT))
            changes = changes or (isinstance(mode, str) and any(letter in mode for letter in "wax+"))
        else:
            path, changes = facts[0] if facts else None, event in _CHANGES or event == "sqlite3.connect"
        if not changes or not isinstance(path, str | os.PathLike) or not os.fspath(path).startswith(inside):
            return
        done += 1
        os.write(marks, b".")
        if done == kill_at:
            os.killpg(0, signal.SIGKILL)

    os.chdir(root)
    sys.addaudithook(watch)
    code = 70
    try:
        from bench.cli import main

        main([str(word) for word in words], standalone_mode=True)
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else 1
    except BaseException as error:
        print(f"Traceback: {type(error).__name__}: {error}", file=sys.stderr)
    finally:
        sys.stderr.flush()
        os._exit(code)


def copied(source: Path, target: Path) -> None:
    """A copy of a state; large files that no command changes in place are linked."""

    def take(name: str, where: str) -> object:
        return os.link(name, where) if Path(name).suffix in LINKED else shutil.copy2(name, where)

    shutil.copytree(source, target, copy_function=take)


def made(folder: Path, place: Path) -> Path:
    """The state that commands begin with, made in `place`, where every trial will stand: records name their folder."""
    place.mkdir()
    (place / "brief.yaml").write_text(BRIEF, encoding="utf-8")
    rows = (f"{t},{3.0 + 0.01 * t % 7:.4f},{20.0 + 0.002 * t:.4f}\n" for t in range(3600))
    (place / "log.csv").write_text(LOG + "".join(rows), encoding="utf-8")
    limits = PROFILES / "limits" / "quick.yaml"
    words = ("run", PROFILES / "quick_calibration.yaml", "--limits", limits, "--model", "polynomial", "--quiet")
    code, _, said = in_a_copy((*words, "--out", place / "reports"), place)
    if code not in {0, 1}:
        raise RuntimeError(f"the run to begin with failed: {said}")
    return place.rename(folder)


def wrong(root: Path, reference: dict[str, int]) -> Iterator[str]:
    """What is half, lost, twice or unregistered in a folder where everything was said to be done."""
    for kind in RECORDS:
        for path in root.rglob(kind.FILE):
            if fault := _unreadable(kind, path):
                yield f"half: {path.relative_to(root)}: {fault}"
    code, _, said = in_a_copy(("registry", "rebuild", "--check", "--out", root / "reports"), root)
    if code != 0:
        yield f"unregistered: {said}"
    code, _, said = in_a_copy(("verify-archive", "--out", root / "reports"), root)
    if code != 0:
        yield f"not proved: {said}"
    counted = counts(root)
    for what, number in reference.items():
        if counted.get(what, 0) < number:
            yield f"lost: {counted.get(what, 0)} of {number} {what}"
        if counted.get(what, 0) > number:
            yield f"twice: {counted.get(what, 0)} instead of {number} {what}"


def _unreadable(kind: type[Stored], path: Path) -> str:
    if kind is LimitsRecord and path.name != kind.FILE:
        return ""
    try:
        kind.find(path.parent, path.name)
    except InputError as error:
        return str(error)
    return ""


def counts(root: Path) -> dict[str, int]:
    """How many there are of everything that a command leaves; attempts that are recorded as failed are not counted."""
    patterns = {kind.FILE: kind.FILE for kind in RECORDS if "*" not in kind.FILE and kind.FILE != "chain.seal"}
    patterns |= {"reports": "report.html", "data": "data.parquet", "means": "means.parquet", "events": "events.jsonl"}
    found = {what: sum(1 for _ in root.rglob(pattern)) for what, pattern in patterns.items()}
    flashes = root.glob("reports/*/flash/*.json")
    found["flashes"] = sum(json.loads(path.read_bytes()).get("state") == "done" for path in flashes)
    return found


@dataclass(frozen=True)
class Trial:
    """One kill, and what came of it."""

    command: str
    at: int
    of: int
    wrong: tuple[str, ...]


def trial(command: Command, state: Path, folder: Path, at: int, whole: tuple[int, dict[str, int]]) -> Trial:
    """Kill the command before its change number `at`, give it again, and look."""
    changes, reference = whole
    copied(state, folder)
    try:
        in_a_copy(command.words(folder), folder, at)
        for words in command.again(folder) if command.again else [command.words(folder)]:
            code, _, said = in_a_copy(words, folder)
            if code in {0, 1}:
                break
        faults = list(wrong(folder, reference))
        if code not in {0, 1}:
            faults.append(f"given again, it ends with exit code {code}: {said}")
        return Trial(command.name, at, changes, tuple(faults))
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def campaign(kills: int, seed: int, out: Path | None = None, only: Sequence[str] = ()) -> list[Trial]:
    """Kills spread evenly over the commands, at places drawn at random; `out` holds those of earlier."""
    done = [] if out is None else campaigns.read(out, lambda one: Trial(**{**one, "wrong": tuple(one["wrong"])}))
    known = {(one.command, one.at): one for one in done}
    chosen = [COMMANDS[name] for name in only or COMMANDS]
    draw = random.Random(seed)
    results = []
    with tempfile.TemporaryDirectory(prefix="bench-kills-") as base:
        os.environ.setdefault("BENCH_KEYS", f"{base}/keys")  # not the keys of whoever runs this
        place = Path(base) / "trial"
        state = made(Path(base) / "state", place)
        for command in chosen:
            copied(state, place)
            code, changes, said = in_a_copy(command.words(place), place)
            if code not in {0, 1}:
                raise RuntimeError(f"{command.name} failed without a kill: {said}")
            reference = counts(place)
            shutil.rmtree(place)
            share = min(-(-kills // len(chosen)), changes)
            for at in sorted(draw.sample(range(1, changes + 1), share)):
                found = known.get((command.name, at))
                if found is None:
                    found = trial(command, state, place, at, (changes, reference))
                    if out is not None:
                        with out.open("a", encoding="utf-8") as file:
                            file.write(json.dumps(asdict(found)) + "\n")
                results.append(found)
    return results


def main() -> None:
    """The command of this module."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=400)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, default=None)
    parser.add_argument("--only", action="append", default=[], choices=list(COMMANDS))
    given = parser.parse_args()
    trials = campaign(given.kills, given.seed, given.out, given.only)
    bad = [one for one in trials if one.wrong]
    by = {name: sum(one.command == name for one in trials) for name in COMMANDS}
    print(
        json.dumps(
            {"kills": len(trials), "seed": given.seed, "by_command": by, "wrong": [asdict(b) for b in bad]}, indent=1
        )
    )
    raise SystemExit(bool(bad))


if __name__ == "__main__":
    main()
