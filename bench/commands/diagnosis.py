"""Commands that look for a missing effect: effects, diagnose, add, improve, mystery, reveal."""

from __future__ import annotations

import secrets
from collections.abc import Sequence
from dataclasses import replace
from functools import reduce
from itertools import count
from pathlib import Path

from bench import analysis, base, record
from bench.base import InputError
from bench.commands.analysis import floor_of, recovered, usual_means
from bench.commands.files import write
from bench.commands.results.analyse import (
    Diagnosed,
    EffectAdded,
    Effects,
    EffectShown,
    Improved,
    MysteryMade,
    Revealed,
)
from bench.record import DiagnosisRecord


def effects() -> Effects:
    """`bench effects`: the catalogue."""
    return Effects(analysis.catalogue())


def show_effect(name: str) -> EffectShown:
    """`bench effects show`: one effect explained and drawn."""
    return EffectShown(analysis.entry(name), analysis.doc(name).strip(), analysis.signature(name))


def diagnose(  # noqa: PLR0913, PLR0917 - options of one command
    runs: Sequence[Path],
    check: Sequence[Path],
    static: Path | None,
    model: str,
    plan: Path | None,
    surface: str | None = None,
    output: str | None = None,
    sisters: Sequence[Path] = (),
) -> Diagnosed:
    """`bench diagnose`: where the model fails, which effect is missing, which experiment would tell."""
    channels = tuple(surface.replace(" ", "").split(",")) if surface else ()
    datasets, checks, isothermal, floor_dph = _data(runs, check, static, output)
    found = analysis.diagnose(
        datasets, analysis.load_model(model), check=checks, static=isothermal,
        sisters=usual_means(recovered(sisters, output)) if sisters else (), floor_dph=floor_dph, surface=channels,
    )  # fmt: skip
    proposal = analysis.next_experiment(found, datasets, check=checks, static=isothermal)
    if proposal is not None:
        profile = plan or runs[0] / "next.yaml"
        write(profile, proposal.profile_yaml)
        found = replace(found, next_experiment=proposal.to_json(str(profile)))
    write(runs[0] / DiagnosisRecord.FILE, DiagnosisRecord.model_validate(found.to_json()).text())
    following = found.following([*map(str, runs)], [*map(str, check)], model, _free("better"))
    return Diagnosed(found, runs[0], following, record.RunFolder(runs[0]).manifest().imported)


def _free(name: str) -> str:
    """The first of name.yaml, name2.yaml and so on that is no file yet."""
    return next(text for n in count(1) if not Path(text := f"{name}{n if n > 1 else ''}.yaml").exists())


def _data(
    runs: Sequence[Path], check: Sequence[Path], static: Path | None, output: str | None = None
) -> tuple[list[record.Dataset], list[record.Dataset], record.Dataset | None, float]:
    """Means of runs, check runs and isothermal run, and the noise floor [deg/h]; each run is read once."""
    seconds, still = recovered(runs, output), recovered([static] if static else [], output)
    datasets = usual_means(seconds)
    floor_dph = floor_of(seconds, datasets[0].interval_s, still)
    return datasets, usual_means(recovered(check, output)), next(iter(usual_means(still)), None), floor_dph


def add(effects: Sequence[str], model: str, out: Path) -> EffectAdded:
    """`bench add`: a model with further effects, as a new file."""
    longer = replace(reduce(analysis.add_effect, effects, analysis.load_model(model)), name=out.stem)
    if out.exists():
        raise InputError("already exists; nothing was written: choose another name with --out", out)
    write(out, longer.to_yaml())
    return EffectAdded(out, tuple(item.name for item in longer.effects))


def improve(
    runs: Sequence[Path],
    check: Sequence[Path],
    static: Path | None,
    model: str,
    out: Path | None,
) -> Improved:
    """`bench improve`: diagnose, add, prove on unseen data, until nothing more pays."""
    datasets, checks, isothermal, floor_dph = _data(runs, check, static)
    found = analysis.improve(datasets, checks, analysis.load_model(model), static=isothermal, floor_dph=floor_dph)
    if out is not None:
        write(out, found.model.to_yaml())
    return Improved(found, out)


def mystery(seed: int | None, count: int, out: Path) -> MysteryMade:
    """`bench mystery`: record a unit with something hidden, and tell nothing."""
    from bench.mystery import make_mystery

    seed = secrets.randbelow(1_000_000) if seed is None else seed
    profiles = base.library()
    made = make_mystery(seed, count, out, profiles / "ramp_-40_85.yaml", profiles / "check_minor_loops.yaml")
    return MysteryMade(seed, made.run, made.check, made.static, out)


def reveal(folder: Path, model: str) -> Revealed:
    """`bench reveal`: open the envelope and score a model."""
    from bench.mystery import reveal as opened

    return Revealed(opened(folder, analysis.load_model(model)))
