"""Results of `bench check`, `doctor`, `sim` and `init`."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from bench import acquisition
from bench.base import in_own
from bench.cli.rendering.printing import content, lines, table
from bench.commands import Checked, ContractTried, Copied, Examined, NoticesTried, Proposed, StationServed

if TYPE_CHECKING:
    from rich.table import Table

    from drivers.unknown_frames import Field, Heard

_MARKS = {"agrees": "ok", "disagrees": "!!", "no link": "!!", "unknown": "??", "told": ""}
_TRIED = {"ok": "ok", "failed": "!!", "not applicable": "--"}


@lines.register(Checked)
def _(result: Checked) -> Iterator[str | Table]:
    profile, station, segments = result.profile, result.station, result.segments
    yield f"{profile.name} on station {station.name}: {len(segments)} segments, {result.duration_s / 3600:.2f} h"
    yield ""
    yield acquisition.profile_picture(profile)
    yield ""
    took = [(f"{s.from_s / 60:.1f} min", s.name, f"{(s.to_s - s.from_s) / 60:.1f} min") for s in segments]
    yield table((">begins", "segment", ">takes"), took)
    yield ""
    yield f"units: {', '.join(unit.serial for unit in station.units)}"
    yield from (f"{one.where}{one.level}: {in_own(one.text)}" for one in result.findings)
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


@lines.register(Proposed)
def _(result: Proposed) -> Iterator[str | Table]:
    found = result.proposal
    for bus, messages in found.heard.items():
        yield f"bus {bus}"
        rows = [
            (f"0x{m.id:X}", f"{m.rate_hz:.4g}", str(m.length), "; ".join(map(_field, m.fields)) or "too few frames")
            for m in messages
        ]
        yield table(("identifier", ">a second", ">bytes", "what is in it"), rows)
        yield from (f"not found: {text}" for text in found.missing.get(bus, ()))
        yield ""
    yield f"written to {result.file}: replace each CONFIRM, put the units into the station file, then `bench check`"


def _field(field: Field) -> str:
    order = "" if field.size == 1 else " big endian" if field.big else " little endian"
    return f"byte {field.first}: {field.kind} of {8 * field.size} bits{order}"


def _message(message: Heard) -> dict[str, Any]:
    return {key: value for key, value in asdict(message).items() if key != "data"}


@content.register(Proposed)
def _(result: Proposed) -> dict[str, Any]:
    found = result.proposal
    units = {bus: {key: bits for key, (bits, _) in signals.items()} for bus, signals in found.units.items()}
    heard = {bus: [_message(message) for message in messages] for bus, messages in found.heard.items()}
    return {"file": str(result.file), "air_degc": found.air_degc, "heard": heard, "units": units,
            "missing": {bus: list(texts) for bus, texts in found.missing.items()}}  # fmt: skip


@lines.register(NoticesTried)
def _(result: NoticesTried) -> Iterator[str | Table]:
    rows = [("!!" if said else "ok", name, said or "taken") for name, said in result.recipients.items()]
    yield table(("", "", ""), rows)
    yield "whether it arrived, only the recipient can see"


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
