"""Differences in the settings of two runs: files, versions, segments, losses."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from difflib import SequenceMatcher
from typing import Any

from bench.base import read_yaml
from bench.record import ExecutedSegment, Manifest, RunFolder, use

LEAST_S = 2.0
"""Durations that differ by less [s], or by less than `LEAST_SHARE`, count as equal."""
LEAST_SHARE = 0.01
_FREE_TEXT = {"description"}
_FACTS = ("unit", "simulated", "purpose", "state", "cause", "sample_rate_hz", "rate_step_dph", "seeds")
_TRAFFIC = {"received"}
"""Counters that grow with the length of a run, whatever its quality."""

Entry = dict[str, Any]


def files(a: RunFolder, b: RunFolder, name: str) -> list[Entry]:
    """Settings that differ between two YAML files of the runs: place and both values; comments are ignored."""
    return list(trees(_yaml(a, name), _yaml(b, name)))


def facts(a: Manifest, b: Manifest) -> list[Entry]:
    """Differences of the manifests in unit, purpose and outcome."""
    one, other = ({key: getattr(side, key) for key in _FACTS} for side in (a, b))
    return list(trees(one, other))


def trees(a: Any, b: Any, where: str = "") -> Iterator[Entry]:
    """Leaves of two parsed files that differ; None stands for a missing key."""
    if isinstance(a, Mapping) and isinstance(b, Mapping):
        for key in [*a, *(key for key in b if key not in a)]:
            if key not in _FREE_TEXT:
                yield from trees(a.get(key), b.get(key), f"{where}.{key}" if where else str(key))
    elif isinstance(a, list) and isinstance(b, list):
        for i in range(max(len(a), len(b))):
            one, other = (side[i] if i < len(side) else None for side in (a, b))
            yield from trees(one, other, f"{where}[{i}]")
    elif a != b:
        yield {"where": where, "a": a, "b": b}


def segments(a: Manifest, b: Manifest) -> list[Entry]:
    """Executed segments of only one run, or with another outcome or duration; the most important first."""
    found = []
    one, other = a.segments, b.segments
    names = [[segment.name for segment in side] for side in (one, other)]
    matched = SequenceMatcher(None, names[0], names[1], autojunk=False)
    for tag, a_from, a_to, b_from, b_to in matched.get_opcodes():
        if tag == "equal":
            found += [_segment(x, y) for x, y in zip(one[a_from:a_to], other[b_from:b_to], strict=True)]
        else:
            found += [_segment(segment, None) for segment in one[a_from:a_to]]
            found += [_segment(None, segment) for segment in other[b_from:b_to]]
    return sorted(filter(None, found), key=lambda entry: -float(entry["weight"]))


def _segment(a: ExecutedSegment | None, b: ExecutedSegment | None) -> Entry:
    """The difference of one segment; empty where both are equal."""
    sides: list[Entry | None] = [
        None if s is None else {"outcome": s.outcome, "duration_s": s.to_s - s.from_s} for s in (a, b)
    ]
    entry = {"segment": next(s.name for s in (a, b) if s is not None), "a": sides[0], "b": sides[1]}
    if sides[0] is None or sides[1] is None:
        return {**entry, "weight": 1e12}
    off_s = abs(sides[0]["duration_s"] - sides[1]["duration_s"])
    if sides[0]["outcome"] != sides[1]["outcome"]:
        return {**entry, "weight": 1e9 + off_s}
    same = off_s <= max(LEAST_S, LEAST_SHARE * max(sides[0]["duration_s"], sides[1]["duration_s"]))
    return {} if same else {**entry, "weight": off_s}


def losses(a: Manifest, b: Manifest) -> list[Entry]:
    """Loss counters that differ, the largest difference first."""
    sides: Sequence[Mapping[str, int]] = [manifest.losses for manifest in (a, b)]
    names = [name for name in dict.fromkeys([*sides[0], *sides[1]]) if name not in _TRAFFIC]
    found = [{"counter": name, "a": sides[0].get(name), "b": sides[1].get(name)} for name in names]
    unlike = [entry for entry in found if entry["a"] != entry["b"]]
    return sorted(unlike, key=lambda entry: -abs(int(entry["a"] or 0) - int(entry["b"] or 0)))


def _yaml(run: RunFolder, name: str) -> Any:
    path = run.path / name
    use(run.path, name)
    return read_yaml(path).content if path.is_file() else None
