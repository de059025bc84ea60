"""`bench doctor`: the station file beside the equipment."""

from __future__ import annotations

from collections import Counter
from dataclasses import asdict
from pathlib import Path

from bench.commands.acquisition import load_station
from bench.commands.answer import Answer

_MARKS = {"agrees": "ok", "disagrees": "!!", "no link": "!!", "unknown": "??", "told": "  "}


def doctor(station_path: Path | None, listen_s: float) -> Answer:
    """Everything that the equipment of a station says, compared where there is something to compare with."""
    from bench.acquisition import examine

    found = examine(load_station(station_path), listen_s)
    width = max(len(finding.what) for finding in found.findings)
    lines = [f"station {found.station}", ""]
    for finding in found.findings:
        doubt = "  [weak source: compare with the panel]" if finding.uncertain else ""
        lines.append(f"{_MARKS[finding.verdict]} {finding.what:<{width}}  {finding.detail}{doubt}")
    counts = Counter(finding.verdict for finding in found.findings)
    doubts = sum(finding.uncertain for finding in found.findings)
    summary = f"{counts['agrees']} agree, {counts['disagrees']} disagree, {counts['no link']} without a link"
    silent = f"{counts['unknown']} not told by the equipment; {doubts} from weak sources"
    lines += ["", f"{summary}, {silent}. Nothing was written."]
    content = {
        "station": found.station,
        "agrees": found.exit_code == 0,
        "findings": [asdict(finding) for finding in found.findings],
        "latency_s": found.latency_s,
    }
    return Answer(content, "\n".join(lines), found.exit_code)


def contract(station_path: Path | None) -> Answer:
    """The contract of register maps for the map of a station; touches no equipment."""
    from drivers.contract import try_map
    from drivers.registers import load_map

    name = load_station(station_path).chamber.map
    outcomes = try_map(load_map(name))
    marks = {"ok": "ok", "failed": "!!", "not applicable": "--"}
    lines = [f"map {name}, on a simulated controller made of it", ""]
    for outcome in outcomes:
        lines.append(
            f"{marks[outcome.verdict]} {outcome.behaviour}" + (f": {outcome.detail}" if outcome.detail else "")
        )
    failed = sum(outcome.verdict == "failed" for outcome in outcomes)
    content = {"map": name, "agrees": not failed, "behaviours": [asdict(outcome) for outcome in outcomes]}
    return Answer(content, "\n".join(lines), 1 if failed else 0)
