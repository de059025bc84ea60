"""Commands that need only a run folder or a table: report, compare, import."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bench.base import BenchError, InputError
from bench.commands.answer import Answer, ladder, limits_table
from bench.record import MANIFEST, RunFolder, open_run

if TYPE_CHECKING:
    from bench.analysis import Analysis, Limits, Model

DEFAULT_MODELS = ("polynomial", "regression", "spline")


def report(
    path: Path,
    models: Sequence[str],
    check: Sequence[Path] = (),
    static: Path | None = None,
    limits_path: Path | None = None,
) -> Answer:
    """`bench report`: analyse a run again; a killed run is recovered from its journals first."""
    from bench.analysis import load_limits, load_model

    given = None if limits_path is None else load_limits(limits_path)
    folder = recover(path)
    files = sorted(folder.path.glob("model*.yaml"), key=lambda file: (len(file.name), file.name))
    chosen = [load_model(model) for model in models or files or DEFAULT_MODELS]
    return report_on(folder, chosen, None, check, static, given)


def resume(path: Path) -> Answer:
    """`bench resume`: make a run folder of what a killed run left; moves no equipment."""
    folder = recover(path)
    manifest = folder.manifest()
    done = sum(segment["outcome"] == "done" for segment in manifest["segments"])
    lost = manifest.get("losses", {}).get("lost", 0)
    content = {key: manifest.get(key) for key in ("state", "cause", "rows", "duration_s", "losses", "segments")}
    text = (
        f"{manifest['state']}: {manifest['cause']}; {manifest['rows']} rows, {done} of {len(manifest['segments'])} "
        f"segments whole, {lost} samples lost\nrun     {folder.path}"
    )
    return Answer({"run": str(folder.path), **content}, text, 0 if manifest["state"] == "done" else 1)


def recover(path: Path) -> RunFolder:
    """The run folder at `path`, its tables made from the journals when the bench was killed before it could."""
    folder = RunFolder(path)
    if path.is_dir() and not (path / MANIFEST).exists() and any(folder.journal.glob("*.gtbj")):
        from bench.acquisition import assemble

        assemble(folder)
    return open_run(path)


def report_on(
    folder: RunFolder,
    models: Sequence[Model],
    error: BenchError | None,
    check: Sequence[Path] = (),
    static: Path | None = None,
    limits: Limits | None = None,
) -> Answer:
    """Analyse a run, write its report, and say how it ended; its limits are those given, or those it was made with."""
    from bench.analysis import LIMITS_YAML, analyse, judged_by, load_limits
    from bench.deliver import write_report

    own = folder.path / LIMITS_YAML
    if limits is None and own.is_file():
        limits = load_limits(own)
    analysis = analyse(folder.path, models, check, static=static)
    if limits is not None:
        analysis = judged_by(analysis, limits)
    write_report(analysis)
    content = {**analysis.to_json(), "report": str(folder.report), "state": analysis.manifest["state"]}
    if error is not None:
        content |= {"error": str(error)}
        return Answer(content, f"{_summary(analysis)}\nbench: {error}", error.exit_code)
    return Answer(content, _summary(analysis), 0 if analysis.within_limits else 1)


def _summary(analysis: Analysis) -> str:
    lines = [analysis.verdict.sentence]
    if analysis.comparison is not None:
        lines += ["", ladder(analysis.comparison.to_json())]
    answer = analysis.diagnosed.answer
    if answer is not None:
        lines += ["", answer.sentence]
        if answer.next_experiment:
            lines += [f"next: bench run {answer.next_experiment['profile']}", str(answer.next_experiment["why"])]
    if analysis.judgement is not None:
        lines += ["", *limits_table(analysis.judgement.to_json()), ""]
    lines += [f"warning: {text}" for text in analysis.warnings]
    lines += ["", f"run     {analysis.run.path}", f"report  {analysis.run.report}"]
    return "\n".join(lines)


def compare(runs: Sequence[Path], models: Sequence[str], check: Sequence[Path], static: Path | None = None) -> Answer:
    """`bench compare`: models side by side, in-sample and held-out, beside the noise floor."""
    from bench.analysis import compare as compare_models
    from bench.analysis import load_model
    from bench.record import load

    chosen = [load_model(model) for model in models or DEFAULT_MODELS]
    datasets = [load(recover(path).path) for path in runs]
    checks = [load(recover(path).path) for path in check]
    floor_dph = floor_of(runs, datasets[0].interval_s, static)
    # A model that nobody asked for may lack its channels; one that was asked for is an error without them.
    content = compare_models(datasets, chosen, floor_dph, checks or None, strict=bool(models)).to_json()
    return _compared(content, runs)


def _compared(content: dict[str, Any], runs: Sequence[Path]) -> Answer:
    """Scores as a table, with what could not be fitted and what is to be known."""
    if not content["models"]:
        raise InputError(content["refused"][0]["reason"], runs[0])
    warned = [f"warning: {model['name']}: {text}" for model in content["models"] for text in model["warnings"]]
    refused = [f"not fitted: {entry['name']}: {entry['reason']}" for entry in content["refused"]]
    return Answer(content, "\n".join([ladder(content), *([""] if warned or refused else []), *refused, *warned]))


def compare_every_sample(
    runs: Sequence[Path], models: Sequence[str], check: Sequence[Path], static: Path | None = None
) -> Answer:
    """`bench compare --every-sample`: the same fitted to all samples of the runs in one pass over each."""
    from bench.analysis import SampledRun, Samples, load_model, of_seconds
    from bench.analysis import compare_every_sample as compare_models
    from bench.base import finite
    from bench.record import load

    if check:
        raise InputError("--every-sample scores blocks and segments left out; a check run is scored on means", check[0])
    chosen = [load_model(model) for model in models or DEFAULT_MODELS]
    folders = [recover(path) for path in runs]
    records = [SampledRun(Samples(folder.data), load(folder.path, 1.0), load(folder.path)) for folder in folders]
    floor_dph = floor_of(runs, 1.0, static)
    comparison = compare_models(records, chosen, floor_dph, strict=bool(models))
    seconds = [record.seconds for record in records]
    means = {
        score.model.name: {
            "rms_dph": finite(of_seconds(score.rms_dph, seconds)),
            "held_out_rms_dph": finite(of_seconds(score.held_out.rms_dph, seconds)),
        }
        for score in comparison.scores
    }
    rows = sum(record.samples.rows for record in records)
    content = {**comparison.to_json(), "samples": rows, "seconds": {"floor_dph": finite(floor_dph), "models": means}}
    answer = _compared(content, runs)
    # White noise of single samples drowns what the models differ in: their 1 s means show it.
    table = {**content, "interval_s": 1.0, "floor_dph": finite(floor_dph)}
    table["models"] = [{"name": name, **own} for name, own in means.items()]
    return replace(answer, text=f"{answer.text}\n\n{ladder(table)}")


def floor_of(runs: Sequence[Path], interval_s: float, static: Path | None) -> float:
    """Noise floor [deg/h] of means over `interval_s` of these runs, NaN where nothing stands still: one number for all
    commands.
    """
    from bench.analysis import noise_floor
    from bench.record import load

    fine = [load(recover(path).path, 1.0) for path in runs]
    return noise_floor(fine, interval_s, load(recover(static).path, 1.0) if static else None).floor_dph


def import_table(file: Path, columns: Path | None, serial: str, dbc: Path | None, out: Path | None) -> Answer:
    """`bench import`: a foreign table becomes a run folder below `out`; None only tells what was understood."""
    from bench.acquisition import load_columns, plan_import, write_import

    plan = plan_import(file, None if columns is None else load_columns(columns), serial, dbc)
    if out is None:
        return Answer({"run": None, **plan.to_json()}, plan.preview())
    folder = write_import(plan, out)
    return Answer({"run": str(folder.path), **plan.to_json()}, f"{plan.preview()}\n\nrun     {folder.path}")
