"""Models side by side, beside the noise floor."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from bench import analysis, commands, deliver
from bench.analysis import Comparison as Scores
from bench.api.fits import Fit
from bench.api.models import ModelLike, fitted_model
from bench.api.runs import Run, Runs, floor_of, several
from bench.api.words import figure, floor_text, html, text_table
from bench.base import InputError, finite, nearest, number

if TYPE_CHECKING:
    import pandas as pd
    import plotly.graph_objects as go

    from bench.analysis import Floor

_HEAD = ("model", "in-sample", "held-out", "over floor")


@dataclass(frozen=True, eq=False, repr=False)
class Comparison:
    """Scores of several models on the same runs; `comparison["spline"]` is the fit of one of them."""

    scores: Scores
    """Everything that was found: intervals, errors by block and by segment, reasons."""
    runs: tuple[Run, ...]
    check: tuple[Run, ...]
    static: Run | None
    floor: Floor
    """Noise floor of the means that were fitted."""

    def __getitem__(self, name: str) -> Fit:
        """The fit of a model by its name; InputError where it was not compared."""
        for score in self.scores.scores:
            if score.model.name == name:
                return Fit(score.fit, self.runs, self.check, self.static, score)
        names = list(self)
        raise InputError(f"no model '{name}' was compared{nearest(name, names)}; there are {', '.join(names)}")

    def __iter__(self) -> Iterator[str]:
        return (score.model.name for score in self.scores.scores)

    def __len__(self) -> int:
        return len(self.scores.scores)

    def to_dataframe(self) -> pd.DataFrame:
        """One row a model: `rms_dph`, `held_out_rms_dph` with its 95 % interval, `floor_dph` [deg/h], `held_out_by`."""
        import pandas as pd

        rows = [
            {
                "model": score.model.name,
                "rms_dph": score.rms_dph,
                "held_out_rms_dph": score.held_out.rms_dph,
                "held_out_low_dph": score.held_out.interval_dph[0],
                "held_out_high_dph": score.held_out.interval_dph[1],
                "held_out_by": score.held_out.by,
                "floor_dph": self.floor.floor_dph,
            }
            for score in self.scores.scores
        ]
        return pd.DataFrame(rows).set_index("model")

    def plot(self) -> go.Figure:
        """In-sample and held-out error of each model and the noise floor [deg/h]."""
        scores = self.scores.scores
        inside, outside = (np.array(v) for v in zip(*((s.rms_dph, s.held_out.rms_dph) for s in scores), strict=True))
        band = np.array([s.held_out.interval_dph for s in scores])
        return figure(deliver.model_ladder(list(self), inside, outside, band, finite(self.floor.floor_dph)))

    def summary(self) -> str:
        """Errors of each model and the noise floor, as text."""
        by = self.scores.scores[0].held_out.by
        unit = f"RMS in deg/h of means over {self.scores.interval_s:g} s, held out by {by}"
        return "\n".join([*text_table(_HEAD, self._rows()), "", unit, floor_text(self.floor), *self._notes()])

    def __repr__(self) -> str:
        return f"<{type(self).__name__} of {', '.join(self)}>"

    def _repr_html_(self) -> str:
        title = f"RMS in deg/h of means over {self.scores.interval_s:g} s"
        return html(title, "Error of each model", _HEAD, self._rows(), floor_text(self.floor), *self._notes())

    def _rows(self) -> list[tuple[str, str, str, str]]:
        rows = []
        for score in self.scores.scores:
            ratio = number(score.held_out.rms_dph / self.floor.floor_dph)
            errors = number(score.rms_dph), number(score.held_out.rms_dph)
            rows.append((score.model.name, *errors, ratio if ratio == "–" else f"{ratio} x"))
        return rows

    def _notes(self) -> list[str]:
        refused = [f"not fitted: {name}: {reason}" for name, reason in self.scores.refused]
        return [*refused, *(f"warning: {text}" for text in self.scores.warnings)]


def compare(
    runs: Runs,
    models: Sequence[ModelLike] = (),
    *,
    check: Runs = (),
    static: Run | None = None,
    lot: bool = False,
) -> Comparison:
    """Models side by side on one run or several of one unit: in-sample and held-out, beside the noise floor.

    Without `models` polynomial, regression and spline are compared, and one that lacks a channel is left out. With
    `check` runs the held-out error is that on them, without that on blocks left out in turn. `static` is a run at
    constant temperature that tells the noise floor. `lot` allows runs of several units, for one fit to all of them.

    Raises InputError: no run, runs of several units, an unknown model, or a model that these runs do not determine.
    """
    chosen, checks = several(runs), several(check)
    if not chosen:
        raise InputError("no run to compare models on")
    floor = floor_of(chosen, static)
    wanted = [fitted_model(model) for model in (models or commands.DEFAULT_MODELS)]
    datasets, unseen = [run.dataset for run in chosen], [run.dataset for run in checks]
    scores = analysis.compare(datasets, wanted, floor.floor_dph, unseen or None, strict=bool(models), lot=lot)
    if not scores.scores:
        raise InputError(scores.refused[0][1])
    return Comparison(scores, chosen, checks, static, floor)
