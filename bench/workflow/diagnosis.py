"""Commands that look for a missing effect: effects, diagnose, add."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bench.errors import InputError
from bench.store import write_atomically
from bench.workflow.analysis import recover
from bench.workflow.answer import Answer

if TYPE_CHECKING:
    from bench.dataset import Dataset
    from bench.diagnosis.answer import Diagnosis


def effects() -> Answer:
    """`bench effects`: the catalogue."""
    from bench.effects.catalogue import catalogue

    entries = catalogue()
    width = max(len(entry.name) for entry in entries)
    lines = [f"{entry.name:<{width}}  {entry.summary}" for entry in entries]
    content = [
        {"effect": e.name, "family": e.family, "summary": e.summary, "needs": list(e.needs), "options": e.options}
        for e in entries
    ]
    return Answer({"effects": content}, "\n".join([*lines, "", "bench effects show NAME explains one"]))


def show_effect(name: str) -> Answer:
    """`bench effects show`: one effect explained and drawn."""
    from bench.effects.catalogue import entry
    from bench.effects.registry import doc
    from bench.effects.signature import signature
    from bench.workflow.drawing import plot

    found, drawn = entry(name), signature(name)
    hours = drawn.time_s / 3600.0
    lines = [
        doc(name).strip(),
        "",
        "On an example run, peak scaled to 1 deg/h:",
        plot(hours, drawn.contribution, "h", "deg/h"),
        plot(drawn.temperature, drawn.contribution, "degC", "deg/h"),
    ]
    content = {"effect": name, "family": found.family, **found.sections, "look_alikes": list(found.look_alikes)}
    content |= {key: getattr(drawn, key).tolist() for key in ("time_s", "temperature", "contribution")}
    return Answer(content, "\n".join(lines))


def diagnose(
    runs: Sequence[Path],
    check: Sequence[Path],
    static: Path | None,
    model: str,
    own_effects: Sequence[str],
    plan: Path | None,
) -> Answer:
    """`bench diagnose`: where the model fails, which effect is missing, which experiment would tell."""
    from bench.diagnosis.diagnose import diagnose as find
    from bench.model import load_model

    _register(own_effects)
    datasets, checks = _load(runs), _load(check)
    found = find(datasets, load_model(model), check=checks, static=_load([static])[0] if static else None)
    content = found.to_json()
    content["next_experiment"] = _next_experiment(found, datasets, plan)
    (runs[0] / "diagnosis.json").write_text(json.dumps(content, indent=1, allow_nan=False))
    return Answer(content, _text(found, content))


def add(effect: str, model: str, out: Path, own_effects: Sequence[str]) -> Answer:
    """`bench add`: a model with one more effect, as a new file."""
    from bench.effects.registry import make
    from bench.model import load_model

    _register(own_effects)
    base = load_model(model)
    longer = base.adding(make(effect), name=out.stem)
    if out.exists():
        raise InputError("already exists; nothing was written: choose another name with --out", out)
    try:
        write_atomically(out, longer.to_yaml().encode())
    except OSError as error:
        raise InputError(f"cannot be written: {error.strerror}", out) from None
    names = [item.name for item in longer.effects]
    return Answer({"model": str(out), "effects": names}, f"wrote {out}: {' + '.join(names)}")


def _register(own_effects: Sequence[str]) -> None:
    from bench.effects.registry import load_effect

    for spec in own_effects:
        load_effect(spec)


def _load(paths: Sequence[Path]) -> list[Dataset]:
    from bench.dataset import load

    return [load(recover(path).path) for path in paths]


def _next_experiment(found: Diagnosis, datasets: Sequence[Dataset], plan: Path | None) -> dict[str, Any] | None:
    return None


def _text(found: Diagnosis, content: dict[str, Any]) -> str:
    lines = [found.sentence, ""]
    lines += [f"in-sample {found.rms_dph:.4f}, held-out {found.held_out_rms_dph:.4f} ({found.held_out_by}), "
              f"floor {found.floor_dph:.4f} deg/h RMS", ""]  # fmt: skip
    if found.where:
        lines += ["Where it fails"]
        for p in found.where:
            place = f"{p.low:>10.4g} to {p.high:<10.4g}"
            lines.append(f"  {p.channel:<22} {place} {p.floor_ratio:5.2f} x floor, p = {p.p:.1e}  {p.note}")
        lines += [""]
    if found.suspects:
        lines += [f"{'Suspects':<26} {'evidence':>9} {'held-out':>9} {'removes':>8}  look-alikes"]
        for suspect in found.suspects:
            mark = "*" if suspect.found else " "
            removes = f"{100 * suspect.removes:.0f} %" if suspect.removes == suspect.removes else "-"
            lines.append(
                f"{mark} {suspect.effect:<24} {suspect.evidence:>9.1f} {suspect.held_out_rms_dph:>9.4f} {removes:>8}  "
                f"{', '.join(suspect.look_alikes)}"
            )
        lines += [f"  evidence above {found.threshold:.1f} is beyond chance; * belongs to the explanation", ""]
    if found.smallest_detectable:
        small = ", ".join(f"{item.effect} {item.rms_dph:.3f}" for item in found.smallest_detectable)
        lines += [f"This run would have shown [deg/h RMS]: {small}"]
    lines += [f"Not testable here: {name} ({why})" for name, why in found.not_excited.items()]
    lines += [f"note: {note}" for note in (found.noise_finding, *found.notes) if note]
    if content["next_experiment"]:
        lines += ["", f"next: bench run {content['next_experiment']['profile']}", content["next_experiment"]["why"]]
    return "\n".join(lines)
