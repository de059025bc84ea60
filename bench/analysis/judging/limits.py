"""Limits of a kind of unit, and the rule by which a number with its uncertainty passes them.

A number comes with the interval that holds its true value with 95 % probability. The rule is guarded acceptance with a
guard band of the expanded uncertainty (k = 2):

    PASS      the whole interval is within the limits, and the number keeps the marginal band away from them;
    MARGINAL  the number is within the limits, its interval or the marginal band is not;
    FAIL      the number itself is outside;
    INVALID   there is no number, the run must not be judged by it, or the data are outside a limit of their quality.

A unit that passes is outside with a probability of at most 2.5 % (normal distribution, one limit).
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import BaseModel, Field, model_validator

from bench.analysis.judging.expressed import Expressed, Measurements, expressed
from bench.analysis.judging.quantity import COVERAGE, MEANING, OF_DATA, SIGNED, Quantity, QuantityName
from bench.base import STRICT, Document, InputError, PlacedError, load_config
from bench.record import Verdict

PROBABILITY = 0.95
DECISION_RULE = (
    "Guarded acceptance, guard band = expanded uncertainty (k = 2, 95 %): PASS when the whole coverage interval is "
    "within the limits and the marginal band is kept; MARGINAL when only the value is; FAIL when the value is outside; "
    "INVALID when no admissible value exists or the data are outside a limit of their quality. Risk that a PASS is "
    "outside a limit: at most 2.5 %."
)


class Limit(BaseModel):
    """One limit of one quantity, or of an expression."""

    model_config = STRICT

    quantity: QuantityName | None = None
    """What is limited; its unit is the end of its name. Left out: an expression, with a name of your own."""
    name: Annotated[str, Field(pattern="^[a-z][a-z0-9_]{0,59}$")] | None = None
    """With an expression: what it is called in verdict, certificate and fleet."""
    expression: str | None = None
    """A formula of quantities (`residual_rms_dph / bias_span_dph`), of coefficients of the model (`polynomial.a1`), and
    of `min`, `max`, `mean` and `rms` of channels (`max(abs(dT_dt))`)."""
    meaning: str = ""
    """With an expression: what it is, in words; left out: the expression."""
    unit: str
    """Unit of the numbers below, to be read by people and checked against the quantity's own."""
    lower: float | None = None
    """Least allowed value."""
    upper: float | None = None
    """Greatest allowed value."""
    marginal: float = Field(default=0.0, ge=0)
    """Band inside the limits in which a unit is MARGINAL."""
    required: bool = True
    """Without the number the run is INVALID; false: only where the run measures it."""
    reason: str
    """Why this limit: a requirement, a data sheet, experience."""

    @model_validator(mode="after")
    def _one_thing(self) -> Limit:
        given = self.name is not None and self.expression is not None
        if (self.quantity is None) != given or (self.name is None) != (self.expression is None):
            raise ValueError("give either `quantity`, or `name` and `expression`")
        if self.quantity is not None:
            if self.unit != (own := MEANING[self.quantity][0]):
                raise PlacedError(f"unit is '{self.unit}', {self.quantity} is in '{own}'", ("unit",))
            if self.meaning:
                raise PlacedError(f"{self.quantity} has a meaning already; only an expression needs one", ("meaning",))
            return self
        if self.name in MEANING:
            raise PlacedError(f"'{self.name}' is a quantity; give the expression another name", ("name",))
        try:
            expressed(self.expression or "")
        except InputError as error:
            raise PlacedError(str(error).removeprefix("expression: "), ("expression",)) from None
        return self

    @model_validator(mode="after")
    def _some_room(self) -> Limit:
        if self.lower is None and self.upper is None:
            raise ValueError(f"limit of {self.subject} has neither lower nor upper: give at least one")
        room = self.room
        if self.quantity not in {None, *SIGNED} and self.upper is not None and self.upper < 0.0:
            raise PlacedError(f"upper is {self.upper:g}: {self.subject} is never below 0", ("upper",))
        if not room > 0.0:
            raise ValueError(f"limit of {self.subject}: lower {self.lower:g} is not below upper {self.upper:g}")
        bands = (self.lower is not None) + (self.upper is not None)
        if not bands * self.marginal < room:
            raise ValueError(f"limit of {self.subject}: marginal bands of {self.marginal:g} leave nothing to pass")
        return self

    @property
    def subject(self) -> str:
        """Name of what is limited."""
        return str(self.quantity or self.name)

    @property
    def parsed(self) -> Expressed | None:
        """The expression; None where a quantity is limited."""
        return None if self.expression is None else expressed(self.expression)

    def within(self, names: Collection[str]) -> bool:
        """Whether it needs these quantities only, and no coefficient of a model."""
        formula = self.parsed
        return (
            self.quantity in names if formula is None else not formula.coefficients and formula.quantities <= {*names}
        )

    @property
    def room(self) -> float:
        """Upper less lower, or less zero where nothing is below it."""
        least = -np.inf if self.quantity is None or self.quantity in SIGNED else 0.0
        # One that is to be zero, such as a count of what is lost, needs no room.
        if self.upper is None or (self.lower is None and self.upper == least):
            return np.inf
        return self.upper - (least if self.lower is None else self.lower)


class Limits(BaseModel):
    """Limits of a kind of unit."""

    model_config = STRICT

    name: str
    """Name of the specification, as it stands on the certificate."""
    description: str = ""
    """What it is for."""
    limits: tuple[Limit, ...] = Field(min_length=1)
    """The limits."""

    @property
    def expressions(self) -> bool:
        """Whether one is of an expression."""
        return any(limit.expression is not None for limit in self.limits)

    @property
    def quantities(self) -> frozenset[str]:
        """What is limited."""
        return frozenset(limit.subject for limit in self.limits)

    @model_validator(mode="after")
    def _once_each(self) -> Limits:
        names = [limit.subject for limit in self.limits]
        for i, name in enumerate(names):
            if name in names[:i]:
                raise PlacedError(f"{name} is limited twice; give lower and upper in one entry", ("limits", i))
        return self


@dataclass(frozen=True)
class Result:
    """A quantity against its limit; `verdict` is None where it was neither measured nor required."""

    limit: Limit
    quantity: Quantity
    verdict: Verdict | None

    def to_json(self) -> dict[str, Any]:
        """Quantity, limit and word."""
        limit = {key: getattr(self.limit, key) for key in ("lower", "upper", "marginal", "required")}
        word = None if self.verdict is None else self.verdict.value
        known = {**self.quantity.to_json(), **limit, "why": self.limit.reason, "verdict": word}
        return known | ({"expression": self.limit.expression} if self.limit.expression else {})


@dataclass(frozen=True)
class Judgement:
    """All results of a run; `refusals` say why it must not be judged at all."""

    limits: Limits
    results: tuple[Result, ...]
    refusals: tuple[str, ...] = ()

    @property
    def verdict(self) -> Verdict:
        """The worst word; INVALID where the run must not be judged."""
        if self.refusals:
            return Verdict.INVALID
        words = [result.verdict for result in self.results if result.verdict is not None]
        return max(words, key=list(Verdict).index, default=Verdict.INVALID)

    def to_json(self) -> dict[str, Any]:
        """What stands under `limits` in the JSON of `bench run` and in limits.json."""
        return {
            "name": self.limits.name,
            "verdict": self.verdict.value,
            "decision_rule": DECISION_RULE,
            "coverage_factor": COVERAGE,
            "coverage_probability": PROBABILITY,
            "refusals": list(self.refusals),
            "results": [result.to_json() for result in self.results],
        }


def load_limits(source: Path | str | Document) -> Limits:
    """Limits from a file, or from one that was read; InputError with file and line where something is wrong."""
    return load_config(source, Limits)


def judge_limits(
    limits: Limits, quantities: Iterable[Quantity], refusals: Sequence[str] = (), measured: Measurements | None = None
) -> Judgement:
    """Every limit applied to its quantity; expressions also use what was `measured`, where that is at hand."""
    known = {quantity.name: quantity for quantity in quantities}
    results = []
    for limit in limits.limits:
        quantity = _computed(limit, known, measured)
        results.append(Result(limit, quantity, _word(limit, quantity)))
    return Judgement(limits, tuple(results), tuple(refusals))


def _computed(limit: Limit, known: Mapping[str, Quantity], measured: Measurements | None) -> Quantity:
    formula = limit.parsed
    if formula is None:
        return known.get(limit.subject, Quantity(limit.subject, reason="not measured by this run"))
    found = formula.computed(known, measured)
    if not np.isfinite(found.value) and limit.subject in known:  # computed when the run was judged
        found = known[limit.subject]
    return replace(found, name=limit.subject, about=(limit.unit, limit.meaning or formula.text))


def _word(limit: Limit, quantity: Quantity) -> Verdict | None:
    if not np.isfinite(quantity.value):
        return Verdict.INVALID if limit.required else None
    lower = -np.inf if limit.lower is None else limit.lower
    upper = np.inf if limit.upper is None else limit.upper
    if not lower <= quantity.value <= upper:
        return Verdict.INVALID if limit.quantity in OF_DATA else Verdict.FAIL
    # An unknown end proves nothing. The number must keep the marginal band, and its interval the limits.
    low, high = (np.nan_to_num(end, nan=sign * np.inf) for end, sign in ((quantity.low, -1), (quantity.high, 1)))
    sure = lower <= low and high <= upper
    clear = lower + limit.marginal <= quantity.value <= upper - limit.marginal
    return Verdict.PASS if sure and clear else Verdict.MARGINAL
