"""How often the hidden effect is named: `python -m benchmarks.hidden_effects` writes docs/hidden_effects.md.

Every case is a unit of the simulated truth with zero, one or two hidden mechanisms. Results are kept as JSON
lines in the cache, one case per line: an interrupted campaign continues, and the table can be written at
any time (`--table-only`).
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from importlib import import_module
from itertools import product
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
PAIRS = (
    ("thermal_lag", "supply_voltage"),
    ("temperature_rate", "compressor"),
    ("preisach", "quadrature_leakage"),
    ("warm_up", "drive_amplitude"),
    ("thermal_lag", "bias_kink"),
    ("temperature_rate", "preisach"),
)
THERMAL = ("thermal_lag", "temperature_rate", "preisach", "bouc_wen")
WEAK = 0.7
"""Strength of effects for a second run: found after one ramp at one rate, and often tied."""
KINDS = ("single", "clean", "pair", "second")
PARTS = ("outside", "clean_colours", "traps", "pairs", "weak_ties", "sister_noise")
"""Campaigns with commands of their own, whose results in the cache become parts of the page."""


@dataclass(frozen=True)
class Job:
    """One case; `second` adds the run that the bench proposes, and a repetition of the first run."""

    kind: str
    hidden: tuple[str, ...]
    strength: float
    seed: int
    profile: str

    @property
    def key(self) -> str:
        """Key of its line in the cache."""
        return f"{self.kind}|{'+'.join(self.hidden)}|{self.strength:g}|{self.seed}|{self.profile}"


def jobs(options: argparse.Namespace) -> Iterator[Job]:
    """All cases, the most informative first and seed by seed, so that an interrupted campaign is a smaller campaign.

    Neighbouring cases share a unit, whose physics are then computed once.
    """
    everything = list(_everything(options))
    first = [job for job in everything if _telling(job)]
    yield from first
    yield from sorted((job for job in everything if not _telling(job)), key=lambda job: -KINDS.index(job.kind))


def _everything(options: argparse.Namespace) -> Iterator[Job]:
    """Every mechanism alone, clean runs, pairs and second runs, seed by seed."""
    from bench.mystery.hidden import HIDDEN

    for seed in range(1, options.seeds + 1):
        for profile in options.profiles:
            for name, strength in product(options.effects or HIDDEN, options.strengths):
                yield Job("single", (name,), strength, seed, profile)
            for clean in (seed, 500 + seed, 1000 + seed):
                yield Job("clean", (), 0.0, clean, profile)
        for pair in PAIRS:
            yield Job("pair", pair, 1.0, seed, options.profiles[0])
        for name in THERMAL:
            yield Job("second", (name,), WEAK, seed, "one_rate")


def _telling(job: Job) -> bool:
    """Cases for the bars, and a part of the others."""
    from bench.mystery.hidden import HIDDEN

    if job.kind == "single":
        known = all(HIDDEN[name].effect for name in job.hidden)
        usual = job.strength in (0.5, 1.0) if known else job.strength == 1.0 and job.seed % 2 == 0
        return (usual and job.seed % 10 == 1) if job.profile == "one_rate" else usual or (known and job.seed % 8 == 2)
    if job.kind == "clean":
        return job.seed < 1000 or job.profile != "one_rate"
    if job.kind == "pair":
        return (job.seed + PAIRS.index(job.hidden)) % 3 == 0
    return (job.seed + THERMAL.index(job.hidden[0])) % 2 == 0


def work(job: Job) -> dict[str, Any]:
    """The result of one case, or its error."""
    from benchmarks import trials

    began = time.perf_counter()
    try:
        result = trials.run(job.kind, job.hidden, job.strength, job.seed, job.profile)
    except Exception as error:  # a campaign of a day is not lost to one case; the table counts the failures
        result = {"error": f"{type(error).__name__}: {error}"}
    return {"key": job.key, **asdict(job), "seconds": round(time.perf_counter() - began, 1), **result}


def campaign(options: argparse.Namespace) -> None:
    """Run the cases that are not in the cache yet, and append each result at once."""
    options.cache.mkdir(parents=True, exist_ok=True)
    file = options.cache / "results.jsonl"
    known = {line["key"] for line in lines(file)}
    wanted = [job for job in jobs(options) if job.kind in options.kinds and job.key not in known]
    print(f"{len(wanted)} cases to do, {len(known)} known", flush=True)
    with multiprocessing.get_context("spawn").Pool(options.jobs) as pool, file.open("a", encoding="utf-8") as out:
        for number, result in enumerate(pool.imap_unordered(work, wanted, chunksize=2), 1):
            out.write(json.dumps(result) + "\n")
            out.flush()
            answer = result.get("error") or f"{result.get('verdict')} {result.get('found', '')}"
            print(f"{number}/{len(wanted)} {result['key']} {result['seconds']} s: {answer}", flush=True)


def lines(file: Path) -> list[dict[str, Any]]:
    """Results of the cache, the last of each key, without errors, so that these are tried again."""
    if not file.is_file():
        return []
    read = [json.loads(line) for line in file.read_text(encoding="utf-8").splitlines() if line.endswith("}")]
    return list({line["key"]: line for line in read if "error" not in line}.values())


def options_from(arguments: list[str] | None = None) -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.hidden_effects", description=__doc__)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--strengths", type=_numbers, default=(0.25, 0.5, 1.0, 2.0, 6.0))
    parser.add_argument("--profiles", type=_words, default=("ramp_-40_85", "one_rate"))
    parser.add_argument("--effects", type=_words, default=(), help="only these mechanisms")
    parser.add_argument("--kinds", type=_words, default=KINDS, help="of single, clean, pair, second")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--quick", action="store_true", help="two seeds, strengths 0.5 and 1")
    parser.add_argument("--cache", type=Path, default=ROOT / "reports" / "hidden_effects")
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "hidden_effects.md")
    parser.add_argument("--table-only", action="store_true", help="write the table from the cache")
    options = parser.parse_args(arguments)
    if options.quick:
        options.seeds, options.strengths = 2, (0.5, 1.0)
    return options


def _numbers(text: str) -> tuple[float, ...]:
    return tuple(float(part) for part in text.split(","))


def _words(text: str) -> tuple[str, ...]:
    return tuple(part for part in text.split(",") if part)


def main() -> None:
    """Run the campaign, then write the table."""
    from benchmarks import tabulate

    options = options_from()
    if not options.table_only:
        for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
            os.environ[variable] = "1"  # before a worker imports numpy
        campaign(options)
    parts = [tabulate.document(lines(options.cache / "results.jsonl")).rstrip()]
    parts += [import_module(f"benchmarks.{name}").section(options.cache / f"{name}.jsonl").strip() for name in PARTS]
    options.out.write_text("\n\n".join(filter(None, parts)) + "\n", encoding="utf-8")
    print(f"wrote {options.out}")


if __name__ == "__main__":
    main()
