"""Where a model fails, which physical effect is missing, and which experiment would tell."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

from bench import analysis, deliver
from bench.analysis import Diagnosis as Answer
from bench.analysis import Model, Place, Proposal, SuspectedEffect
from bench.api.fits import Fit, fit
from bench.api.models import ModelLike, fitted_model
from bench.api.runs import Run, Runs, floor_of, several
from bench.api.words import errors_text, figure, html, text_table
from bench.base import InputError, finite, number

if TYPE_CHECKING:
    import pandas as pd
    import plotly.graph_objects as go

    from bench.analysis import Floor

_HEAD = ("suspect", "evidence", "held-out", "removes", "look-alikes")


@dataclass(frozen=True, eq=False, repr=False)
class Diagnosis:
    """What a diagnosis found; `bench.diagnose` makes it."""

    answer: Answer
    """Everything that was found: residuals, limits of detection, what the runs could not excite."""
    runs: tuple[Run, ...]
    check: tuple[Run, ...]
    static: Run | None
    floor: Floor
    """Noise floor of the means that were diagnosed."""

    @property
    def verdict(self) -> str:
        """`adequate`, `missing_effect`, `unknown_effect`, or `undecided`."""
        return self.answer.verdict

    @property
    def proved(self) -> bool | None:
        """Whether unseen data bear the verdict out: the error there falls with what is named, by enough for chance.

        False: suspected only, or not decided; None: no unseen data could judge it.
        """
        return self.answer.proved

    @property
    def sentence(self) -> str:
        """The verdict in words."""
        return self.answer.sentence

    @property
    def suspects(self) -> tuple[SuspectedEffect, ...]:
        """Effects that may be missing, best first."""
        return self.answer.suspects

    @property
    def found(self) -> tuple[SuspectedEffect, ...]:
        """Effects that are missing by the evidence, strongest first."""
        return self.answer.found

    @property
    def where(self) -> tuple[Place, ...]:
        """Ranges of temperature, its slope, time and other channels in which the model fails."""
        return self.answer.where

    @property
    def improved(self) -> Model:
        """The model with what was found."""
        return self.answer.improved

    @cached_property
    def next_experiment(self) -> Proposal | None:
        """The run that would tell apart what these runs cannot; `profile_yaml` is its profile. None: not needed."""
        static = None if self.static is None else self.static.dataset
        runs, check = ([run.dataset for run in each] for each in (self.runs, self.check))
        return analysis.next_experiment(self.answer, runs, check=check, static=static)

    def fit(self) -> Fit:
        """The model with what was found, fitted to the same runs."""
        return fit(self.runs, self.improved, check=self.check, static=self.static)

    def to_dataframe(self) -> pd.DataFrame:
        """One row a suspect, best first: evidence, errors on unseen data before and after [deg/h], look-alikes."""
        import pandas as pd

        columns = ("found", "evidence", "held_out_before_dph", "held_out_rms_dph", "removes", "look_alikes")
        rows = [{"effect": s.effect, **{name: getattr(s, name) for name in columns}} for s in self.suspects]
        return pd.DataFrame(rows, columns=["effect", *columns]).set_index("effect")

    def plot(self, run: Run | None = None) -> go.Figure:
        """What the model leaves in each cell of temperature and its slope, before and after adding what was found."""
        shown = self.runs[0] if run is None else run
        if shown not in self.runs:
            raise InputError(f"{shown.name} was not diagnosed; take one of {', '.join(r.name for r in self.runs)}")
        at = self.runs.index(shown)
        before, after = self.answer.residuals[at], self.answer.unexplained_residuals
        left = after[at] if self.found and after else None
        return figure(deliver.residual_map(shown.dataset, before, left, finite(self.floor.floor_dph)))

    def summary(self) -> str:
        """Verdict, errors beside the noise floor, where it fails, and the suspects, as text."""
        lines = [self.sentence, "", self._errors()]
        if self.where:
            lines += ["", *text_table(("where it fails", "from", "to", "RMS [deg/h]", "over floor"), self._places())]
        if self.suspects:
            lines += ["", *text_table(_HEAD, self._rows()), self.answer.mark]
        return "\n".join([*lines, *self._notes()])

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {self.verdict}: {self.sentence}>"

    def _repr_html_(self) -> str:
        return html(self.sentence, f"Suspects; {self.answer.mark}", _HEAD, self._rows(), self._errors(), *self._notes())

    def _errors(self) -> str:
        a = self.answer
        return errors_text(a.rms_dph, a.held_out_rms_dph, a.held_out_by, self.floor)

    def _places(self) -> list[tuple[str, str, str, str, str]]:
        return [
            (p.channel, number(p.low, 5), f"{number(p.high, 5)} {p.unit}", number(p.rms_dph), number(p.floor_ratio))
            for p in self.where
        ]

    def _rows(self) -> list[tuple[str, str, str, str, str]]:
        rows = []
        for s in self.suspects:
            removes = "–" if finite(s.removes) is None else f"{100 * s.removes:.0f} %"
            name, alike = f"{s.effect}{' *' if s.found else ''}", ", ".join(s.look_alikes)
            rows.append((name, f"{s.evidence:.1f}", number(s.held_out_rms_dph), removes, alike))
        return rows

    def _notes(self) -> list[str]:
        return [f"note: {note}" for note in (self.answer.noise_finding, *self.answer.notes) if note]


def diagnose(
    runs: Runs, model: ModelLike, *, check: Runs = (), static: Run | None = None, sisters: Runs = ()
) -> Diagnosis:
    """Where a model fails on runs of one unit, which physical effect is missing, and which experiment would tell.

    `check` are runs that no fit sees and that prove what was found; `static` is a run at constant temperature that
    tells the noise, `sisters` are such runs of units like this one. It takes some seconds.

    Raises InputError: no run, an unknown model, or a model that cannot be fitted.
    """
    chosen, checks = several(runs), several(check)
    if not chosen:
        raise InputError("no run to diagnose")
    floor = floor_of(chosen, static)
    answer = analysis.diagnose(
        [run.dataset for run in chosen],
        fitted_model(model),
        check=[run.dataset for run in checks],
        static=None if static is None else static.dataset,
        sisters=[run.dataset for run in several(sisters)],
        floor_dph=floor.floor_dph,
    )
    return Diagnosis(answer, chosen, checks, static, floor)
