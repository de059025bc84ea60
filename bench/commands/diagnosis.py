"""Commands that look for a missing effect: effects, diagnose, add."""

from __future__ import annotations

import json
import secrets
from collections.abc import Sequence
from dataclasses import replace
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bench.base import InputError
from bench.commands.analysis import floor_of, recover
from bench.commands.answer import Answer, number
from bench.record import write_atomically

if TYPE_CHECKING:
    from bench.analysis import Diagnosis
    from bench.record import Dataset


def effects() -> Answer:
    """`bench effects`: the catalogue."""
    from bench.analysis import catalogue

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
    from bench.analysis import doc, entry, signature
    from bench.commands.drawing import plot

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
    plan: Path | None,
) -> Answer:
    """`bench diagnose`: where the model fails, which effect is missing, which experiment would tell."""
    from bench.analysis import diagnose as find
    from bench.analysis import load_model

    datasets, checks = _load(runs), _load(check)
    isothermal = _load([static])[0] if static else None
    floor_dph = floor_of(runs, datasets[0].interval_s, static)
    found = find(datasets, load_model(model), check=checks, static=isothermal, floor_dph=floor_dph)
    content = found.to_json()
    content["next_experiment"] = _next_experiment(found, datasets, isothermal, plan or runs[0] / "next.yaml")
    _write(runs[0] / "diagnosis.json", json.dumps(content, indent=1, allow_nan=False))
    return Answer(content, _text(found, content))


def add(effect: str, model: str, out: Path) -> Answer:
    """`bench add`: a model with one more effect, as a new file."""
    from bench.analysis import add_effect, load_model

    longer = replace(add_effect(load_model(model), effect), name=out.stem)
    if out.exists():
        raise InputError("already exists; nothing was written: choose another name with --out", out)
    _write(out, longer.to_yaml())
    names = [item.name for item in longer.effects]
    return Answer({"model": str(out), "effects": names}, f"wrote {out}: {' + '.join(names)}")


def improve(
    runs: Sequence[Path],
    check: Sequence[Path],
    static: Path | None,
    model: str,
    out: Path | None,
) -> Answer:
    """`bench improve`: diagnose, add, prove on unseen data, until nothing more pays."""
    from bench.analysis import improve as walk
    from bench.analysis import load_model

    datasets, isothermal = _load(runs), _load([static])[0] if static else None
    floor_dph = floor_of(runs, datasets[0].interval_s, static)
    found = walk(datasets, _load(check), load_model(model), static=isothermal, floor_dph=floor_dph)
    lines = [f"{step.action:<8} {step.effect:<22} {step.sentence}" for step in found.steps]
    lines += ["", f"{found.model.name}: {' + '.join(effect.name for effect in found.model.effects)}"]
    if out is not None:
        _write(out, found.model.to_yaml())
        lines += [f"wrote {out}"]
    return Answer(found.to_json(), "\n".join(lines))


def mystery(seed: int | None, count: int, out: Path) -> Answer:
    """`bench mystery`: record a unit with something hidden, and tell nothing."""
    from bench.base import library
    from bench.mystery import make_mystery

    seed = secrets.randbelow(1_000_000) if seed is None else seed
    profiles = library()
    made = make_mystery(seed, count, out, profiles / "ramp_-40_85.yaml", profiles / "check_minor_loops.yaml")
    content = {"seed": seed, "run": str(made.run), "check": str(made.check), "static": str(made.static)}
    steps = f"""Unit MYSTERY-{seed} hides something. Find it:

  bench diagnose {made.run} --check {made.check} --static {made.static} --model spline
  bench add EFFECT --model spline --out mine.yaml
  bench compare {made.run} --check {made.check} --model spline --model mine.yaml
  bench reveal {out} --model mine.yaml"""
    return Answer(content, steps)


def reveal(folder: Path, model: str) -> Answer:
    """`bench reveal`: open the envelope and score a model."""
    from bench.analysis import load_model
    from bench.mystery import reveal as opened

    score = opened(folder, load_model(model))
    lines = [
        f"hidden   {item['mechanism']} (strength {item['strength']} x noise; library: {item['effect'] or 'not in it'})"
        for item in score.hidden
    ]
    for word in ("right", "wrong", "missed"):
        lines.append(f"{word:<8} {', '.join(getattr(score, word)) or '-'}")
    lines.append(
        f"held-out {score.held_out_rms_dph:.4f} deg/h RMS; the true model {score.true_model_rms_dph:.4f}, "
        f"perfect knowledge {score.floor_dph:.4f}"
    )
    return Answer(score.to_json(), "\n".join(lines))


def _write(path: Path, text: str) -> None:
    try:
        write_atomically(path, text.encode())
    except OSError as error:
        raise InputError(f"cannot be written: {error.strerror}; choose another place", path) from None


def _load(paths: Sequence[Path]) -> list[Dataset]:
    from bench.record import load

    return [load(recover(path).path) for path in paths]


def _next_experiment(
    found: Diagnosis, datasets: Sequence[Dataset], static: Dataset | None, plan: Path
) -> dict[str, Any] | None:
    """The run that would separate what the data cannot tell apart, its profile written to `plan`."""
    from bench.analysis import next_experiment

    proposal = next_experiment(found, datasets, static=static)
    if proposal is None:
        return None
    _write(plan, proposal.profile_yaml)
    return proposal.to_json(str(plan))


def _by_reason(found: Diagnosis) -> dict[str, list[str]]:
    """Effects that the runs cannot show, by the reason; the name of the run only where there are several."""
    reasons: dict[str, list[str]] = {}
    for name, why in found.not_excited.items():
        short = why if len(found.runs) > 1 else why.removeprefix(f"{found.runs[0]} has ").removeprefix(found.runs[0])
        reasons.setdefault(short.removeprefix(": "), []).append(name)
    return reasons


def _text(found: Diagnosis, content: dict[str, Any]) -> str:
    from bench.analysis import made_from
    from bench.base import finite

    lines = [found.sentence, ""]
    errors = (content[key] for key in ("rms_dph", "held_out_rms_dph", "floor_dph"))
    inside, outside, floor = map(number, errors)
    lines += [f"in-sample {inside}, held-out {outside} ({found.held_out_by}), noise floor {floor} deg/h RMS", ""]
    if found.where:
        lines += ["Where it fails"]
        for p in found.where:
            place = f"{p.low:>10.4g} to {f'{p.high:.4g} {p.unit}':<18}"
            ratio = f"{p.floor_ratio:5.2f} x floor" if isfinite(p.floor_ratio) else f"{p.rms_dph:.4g} deg/h RMS"
            lines.append(f"  {p.channel:<22} {place} {ratio}, p = {p.p:.1e}  {p.note}".rstrip())
        lines += [""]
    if found.suspects:
        lines += [f"{'Suspects':<26} {'evidence':>9} {'held-out':>9} {'removes':>8}  look-alikes"]
        for suspect in found.suspects:
            mark = "*" if suspect.found else " "
            removes = f"{100 * suspect.removes:.0f} %" if suspect.removes == suspect.removes else "-"
            lines.append(
                f"{mark} {suspect.effect:<24} {suspect.evidence:>9.1f} {number(finite(suspect.held_out_rms_dph)):>9} "
                f"{removes:>8}  {', '.join(suspect.look_alikes)}".rstrip()
            )
        lines += [f"  evidence above {found.threshold:.1f} is beyond chance; * belongs to the explanation", ""]
    if found.smallest_detectable:
        small = ", ".join(f"{item.effect} {item.rms_dph:.3f}" for item in found.smallest_detectable)
        lines += [f"This run would have shown [deg/h RMS]: {small}"]
    lines += [f"Not testable here: {', '.join(names)}: {why}" for why, names in _by_reason(found).items()]
    lines += [f"note: {note}" for note in (found.noise_finding, made_from(found), *found.notes) if note]
    if content["next_experiment"]:
        lines += ["", f"next: bench run {content['next_experiment']['profile']}", content["next_experiment"]["why"]]
    return "\n".join(lines)
