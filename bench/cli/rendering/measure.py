"""Results of `bench check`, `doctor`, `sim` and `init`."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from bench.cli.rendering.printing import content, lines, table
from bench.commands import Checked, ContractTried, Copied, Examined, StationServed

if TYPE_CHECKING:
    from rich.table import Table

_MARKS = {"agrees": "ok", "disagrees": "!!", "no link": "!!", "unknown": "??", "told": ""}
_TRIED = {"ok": "ok", "failed": "!!", "not applicable": "--"}


@lines.register(Checked)
def _(result: Checked) -> Iterator[str | Table]:
    from bench.acquisition import profile_picture

    profile, station, segments = result.profile, result.station, result.segments
    yield f"{profile.name} on station {station.name}: {len(segments)} segments, {result.duration_s / 3600:.2f} h"
    yield ""
    yield profile_picture(profile)
    yield ""
    took = [(f"{s.from_s / 60:.1f} min", s.name, f"{(s.to_s - s.from_s) / 60:.1f} min") for s in segments]
    yield table((">begins", "segment", ">takes"), took)
    yield ""
    yield f"units: {', '.join(unit.serial for unit in station.units)}"
    yield from map(str, result.findings)
    yield from (f"warning: {segment.name} would fail: {segment.reason}" for segment in result.late)


@lines.register(Examined)
def _(result: Examined) -> Iterator[str | Table]:
    examination = result.examination
    yield f"station {examination.station}"
    yield ""
    weak = "  [weak source: compare with the panel]"
    rows = [(_MARKS[f.verdict], f.what, f"{f.detail}{weak if f.uncertain else ''}") for f in examination.findings]
    yield table(("", "", ""), rows)
    count = Counter(finding.verdict for finding in examination.findings)
    yield ""
    yield (
        f"{count['agrees']} agree, {count['disagrees']} disagree, {count['no link']} without a link, "
        f"{count['unknown']} not reported by the equipment; "
        f"{sum(f.uncertain for f in examination.findings)} from weak sources. "
        "Nothing was written."
    )


@content.register(Examined)
def _(result: Examined) -> dict[str, Any]:
    examination = result.examination
    findings = [asdict(finding) for finding in examination.findings]
    return {"station": examination.station, "agrees": not result.exit_code, "findings": findings,
            "latency_s": examination.latency_s}  # fmt: skip


@lines.register(ContractTried)
def _(result: ContractTried) -> Iterator[str]:
    yield f"map {result.map}, on a simulated controller"
    yield ""
    for outcome in result.behaviours:
        yield f"{_TRIED[outcome.verdict]} {outcome.behaviour}" + (f": {outcome.detail}" if outcome.detail else "")


@content.register(ContractTried)
def _(result: ContractTried) -> dict[str, Any]:
    behaviours = [asdict(outcome) for outcome in result.behaviours]
    return {"map": result.map, "agrees": result.agrees, "behaviours": behaviours}


@lines.register(StationServed)
def _(result: StationServed) -> Iterator[str]:
    yield "ended"


@lines.register(Copied)
def _(result: Copied) -> Iterator[str]:
    yield f"wrote {len(result.files)} files below {result.folder}:"
    yield from result.files
    yield ""
    yield f"next: cd {result.folder.parent} && bench check ..."
