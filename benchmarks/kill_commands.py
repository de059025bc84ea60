"""SIGKILL to every command that writes: is a record lost, half, twice or unregistered afterwards?

    python -m benchmarks.kill_commands --out kills.jsonl --kills 400 --seed 1

Each command (`benchmarks.killed_commands`) is run once whole, and its changes of files are counted. It is then killed
with its whole process group, two times out of three just before one of these changes, otherwise at a moment, both drawn
at random, and given again as a user would give it. Results are appended to the file as they come; what stands there
already is not run again. Prints one JSON object; exit code 1 when anything was lost, half, twice or unregistered.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import resource
import shutil
import tempfile
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from bench.base import InputError
from bench.record import RECORDS, LimitsRecord
from bench.record import Record as Stored
from benchmarks import campaigns
from benchmarks.killed_commands import COMMANDS, STATES, Command, copied
from benchmarks.killing import Done, Words, in_a_copy


def wrong(root: Path, reference: Counter[str], *, repeats: bool) -> Iterator[str]:
    """What is half, lost, twice or unregistered in a folder where everything was said to be done."""
    for kind in RECORDS:
        for path in root.rglob(kind.FILE):
            if fault := _unreadable(kind, path):
                yield f"half: {path.relative_to(root)}: {fault}"
    for what, words in (("unregistered", ("registry", "rebuild", "--check")), ("not proved", ("verify-archive",))):
        done = in_a_copy((*words, "--out", root / "reports"), root)
        if done.code != 0:
            yield f"{what}: {done.said}"
    counted = counts(root)
    for what in sorted({*reference, *counted}):
        if counted[what] < reference[what]:
            yield f"lost: {counted[what]} of {reference[what]} {what}"
        if counted[what] > reference[what] and not repeats:
            yield f"twice: {counted[what]} instead of {reference[what]} {what}"


def _unreadable(kind: type[Stored], path: Path) -> str:
    if kind is LimitsRecord and path.name != kind.FILE:
        return ""
    try:
        kind.find(path.parent, path.name)
    except InputError as error:
        return str(error)
    return ""


def counts(root: Path) -> Counter[str]:
    """How many there are of everything that a command leaves.

    Attempts that are recorded as failed are not counted: flashes, and runs that were killed before their first sample.
    """
    others = {"chain.seal", "start.json"}  # lists; attempts to start a run, which the page tells
    patterns = {kind.FILE: kind.FILE for kind in RECORDS if "*" not in kind.FILE and kind.FILE not in others}
    patterns |= {"reports": "report.html", "data": "data.parquet", "means": "means.parquet", "events": "events.jsonl"}
    patterns |= {"certificates": "certificate.pdf"}
    empty = {path.parent for path in root.rglob("manifest.json") if not json.loads(path.read_bytes())["rows"]}
    found = Counter(
        {what: sum(path.parent not in empty for path in root.rglob(pattern)) for what, pattern in patterns.items()}
    )
    flashes = root.glob("reports/*/flash/*.json")
    found["flashes"] = sum(json.loads(path.read_bytes()).get("state") == "done" for path in flashes)
    return found


@dataclass(frozen=True)
class Trial:
    """One kill, and what came of it."""

    command: str
    at: float
    """Just before the change of this number; below 1: after this share of its time."""
    of: int
    """Changes of the whole command."""
    wrong: tuple[str, ...]


@dataclass(frozen=True)
class Whole:
    """A command that nobody killed."""

    done: Done
    counts: Counter[str]


def trial(command: Command, state: Path, folder: Path, at: float, whole: Whole) -> Trial:
    """Kill the command, give it again, and look."""
    copied(state, folder)
    done = whole.done
    try:
        if at < 1:
            in_a_copy(command.words(folder), folder, when=lambda after_s: after_s >= at * whole.done.took_s)
        else:
            in_a_copy(command.words(folder), folder, round(at))

        def give(words: Words) -> int:
            nonlocal done
            done = in_a_copy(words, folder)
            return -1 if done.code is None else done.code

        code = command.again(folder, give) if command.again else give(command.words(folder))
        faults = list(wrong(folder, whole.counts, repeats=command.repeats))
        if code not in {0, 1}:
            faults.append(f"given again, it ends with exit code {code}: {done.said}")
        return Trial(command.name, at, whole.done.changes, tuple(faults))
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def places(changes: int, count: int, draw: random.Random) -> list[float]:
    """So many changes and moments: a third are moments, and more where there are not as many changes."""
    at_changes = min(changes, count - count // 3)
    moments = [round(draw.uniform(0.02, 1.0), 3) for _ in range(count - at_changes)]
    found = [*draw.sample(range(1, changes + 1), at_changes), *moments]
    draw.shuffle(found)
    return found


def campaign(kills: int, seed: int, out: Path | None = None, only: Sequence[str] = ()) -> list[Trial]:
    """Kills spread evenly over the commands; `out` holds those of earlier."""
    known = [] if out is None else campaigns.read(out, lambda one: Trial(**{**one, "wrong": tuple(one["wrong"])}))
    done = {(one.command, one.at): one for one in known}
    chosen = [COMMANDS[name] for name in only or COMMANDS]
    share = -(-kills // len(chosen))
    results = []
    with tempfile.TemporaryDirectory(prefix="bench-kills-") as base:
        os.environ.setdefault("BENCH_KEYS", f"{base}/keys")  # not the keys of whoever runs this
        place = Path(base) / "trial"
        wholes = {command.name: _whole(command, Path(base) / command.state, place) for command in chosen}
        drawn = {
            name: places(whole.done.changes, share, random.Random(f"{seed} {name}")) for name, whole in wholes.items()
        }
        for command, at in ((command, drawn[command.name][i]) for i in range(share) for command in chosen):
            found = done.get((command.name, at))
            if found is None:
                found = trial(command, Path(base) / command.state, place, at, wholes[command.name])
                if out is not None:
                    with out.open("a", encoding="utf-8") as file:
                        file.write(json.dumps(asdict(found)) + "\n")
            results.append(found)
    return results


def _whole(command: Command, state: Path, place: Path) -> Whole:
    """A command run whole, from a state that is made where it is missing."""
    if not state.exists():
        STATES[command.state](place)
        place.rename(state)
    for _ in range(2):  # the first one imports
        copied(state, place)
        whole = Whole(in_a_copy(command.words(place), place), counts(place))
        shutil.rmtree(place)
    if whole.done.code not in {0, 1}:
        raise RuntimeError(f"{command.name} failed without a kill: {whole.done.said}")
    return whole


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
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    figures = {
        "kills": len(trials),
        "seed": given.seed,
        "by_command": Counter(one.command for one in trials),
        "at_moments": sum(one.at < 1 for one in trials),
        "cpu_s": round(sum(one.ru_utime + one.ru_stime for one in used)),
        "wrong": [asdict(one) for one in bad],
    }
    print(json.dumps(figures, indent=1))
    raise SystemExit(bool(bad))


if __name__ == "__main__":
    main()
