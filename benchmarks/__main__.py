"""All benchmarks, one command: tables side by side, and docs/performance.md.

    python -m benchmarks                 # everything, about an hour on two cores; writes docs/performance.md
    python -m benchmarks fit allan       # only these sections; the others of the page are not changed
    python -m benchmarks --quick         # small sizes, some minutes: checks that everything runs, writes nothing

Rows of missing peers name them: `pip install -e '.[dev,peers]'` installs all.
"""

from __future__ import annotations

import argparse
import os
import platform
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from benchmarks.rounds import ONE_THREAD, Table

PAGE = Path(__file__).parent.parent / "docs" / "performance.md"


@dataclass(frozen=True)
class Section:
    """Modules with `tables(quick)`, and the packages whose versions matter."""

    modules: tuple[str, ...]
    packages: tuple[str, ...] = ()


SECTIONS = {
    "limits": Section(("limits",), ("pyarrow",)),
    "fit": Section(("one_pass",), ("scipy", "statsmodels", "scikit-learn", "pygam", "csaps")),
    "capture": Section(("capture",), ("cantools", "asammdf", "python-can")),
    "allan": Section(("allan",), ("AllanTools",)),
    "diagnosis": Section(("diagnosis_speed", "naming"), ("scipy", "sysidentpy", "pysindy")),
    "job": Section(("main_job",), ("pymodbus",)),
}


def machine() -> str:
    """Processor, number of cores, memory, kernel, load of the last minute."""
    cpu = next(
        (row.split(":")[1].strip() for row in _lines("/proc/cpuinfo") if row.startswith("model name")),
        platform.processor(),
    )
    kib = next((float(row.split()[1]) for row in _lines("/proc/meminfo") if row.startswith("MemTotal")), 0.0)
    cores, load = os.cpu_count(), os.getloadavg()[0]
    return f"{cpu}, {cores} cores, {kib * 1024 / 1e9:.0f} GB, Linux {platform.release()}, load {load:.1f} at the start"


def _lines(path: str) -> list[str]:
    file = Path(path)
    return file.read_text(encoding="utf-8").splitlines() if file.exists() else []


def versions(packages: Sequence[str]) -> str:
    """Versions of Python, numpy and these, one line."""
    found = [f"Python {platform.python_version()}"]
    for name in ("numpy", *packages):
        try:
            found.append(f"{name} {version(name)}")
        except PackageNotFoundError:
            found.append(f"{name} not installed")
    return ", ".join(found)


def run(name: str, quick: bool) -> str:
    """Tables of a section as Markdown, with machine, date and versions; an error becomes its text."""
    section = SECTIONS[name]
    begun, here = time.perf_counter(), machine()
    body = "\n\n".join(_made(module, quick) for module in section.modules)
    took = (time.perf_counter() - begun) / 60.0
    size = "small sizes, " if quick else ""
    stamp = f"{datetime.now(UTC):%Y-%m-%d}, {size}{here}; {versions(section.packages)}; took {took:.0f} min."
    return f"{body}\n\n*{stamp}*"


def _made(module: str, quick: bool) -> str:
    """The tables of a module, or the reason why they are missing."""
    try:
        make: Callable[[bool], list[Table]] = import_module(f"benchmarks.{module}").tables
        return "\n\n".join(table.markdown() for table in make(quick))
    except ImportError as error:
        return f"benchmarks/{module}.py was not run: {error}"


def write(page: Path, name: str, text: str) -> None:
    """Put text between the markers of a section; ValueError for a page without them."""
    old = page.read_text(encoding="utf-8")
    begin, end = f"<!-- benchmark: {name} -->\n", f"<!-- end: {name} -->"
    head, found, rest = old.partition(begin)
    _, closed, tail = rest.partition(end)
    if not found or not closed:
        raise ValueError(f"{page.name} has no markers '{begin.strip()}' and '{end}'")
    page.write_text(f"{head}{begin}{text}\n{end}{tail}", encoding="utf-8")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(SECTIONS)}; all if none")
    parser.add_argument("--quick", action="store_true", help="small sizes; the page is not written")
    options = parser.parse_args()
    if unknown := set(options.names) - set(SECTIONS):
        parser.error(f"unknown: {', '.join(sorted(unknown))}; there are {', '.join(SECTIONS)}")
    os.environ.update(ONE_THREAD)
    for name in options.names or SECTIONS:
        text = run(name, options.quick)
        print(f"## {name}\n\n{text}\n", flush=True)
        if not options.quick:
            write(PAGE, name, text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
