"""A quantity of a limits file's own: a formula of quantities, of coefficients, and of statistics of channels.

Outside of a statistic the formula has one value: names are quantities (`residual_rms_dph`), or coefficients and
parameters of the model by their keys (`polynomial.a1`, `thermal_lag.tau_s`; signs that no name has are written `_`).
Inside of `min`, `max`, `mean` and `rms` names are channels, time, dT_dt and direction, as in the effect `expression`,
row by row of the averaged record; no rate is among them: its noise depends on the averaging, and quantities state it.

The interval adds what each quantity and each coefficient changes when it alone goes to an end of its 95 % interval.
That holds whatever their correlation, and is too wide where they vary on their own. Statistics are without uncertainty.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np

from bench.analysis.effects.formula import FUNCTIONS, Data, checked, hint, names_of, value_of, variables
from bench.analysis.fit.fitting import Fit
from bench.analysis.judging.quantity import COVERAGE, MEANING, Quantity
from bench.base import CHANNELS, FloatArray, InputError, nearest_or_all
from bench.record import Dataset

STATISTICS: Mapping[str, Callable[[FloatArray], Any]] = {
    "min": np.min,
    "max": np.max,
    "mean": np.mean,
    "rms": lambda values: np.sqrt(np.mean(np.square(values))),
}
_OVER_TIME = ("lag", "uneven_lag", "delay", "play", "slew", "total")

Interval = tuple[float, float, float]
"""Value, low, high."""


@dataclass(frozen=True, eq=False)
class Measurements:
    """What a formula may use beside quantities: the averaged record, and the fit of the model that is delivered."""

    dataset: Dataset
    fit: Fit | None = None

    @cached_property
    def coefficients(self) -> Mapping[str, Interval]:
        """Coefficients and parameters of the model by their keys, as names."""
        if self.fit is None:
            return {}
        found = [(one.key, one.value, one.std) for one in self.fit.coefficients]
        found += [(key, value, self.fit.theta_std[key]) for key, value in self.fit.theta.items()]
        return {_as_name(key): (value, value - COVERAGE * std, value + COVERAGE * std) for key, value, std in found}


@dataclass(frozen=True, eq=False)
class Expressed:
    """A checked formula; `statistics` are the functions of channels in it, by the names that `tree` has for them."""

    text: str
    tree: ast.expr
    quantities: frozenset[str]
    coefficients: frozenset[str]
    statistics: Mapping[str, tuple[str, ast.expr]]

    def computed(self, known: Mapping[str, Quantity], measured: Measurements | None) -> Quantity:
        """Its value and interval; a reason where something that it needs is not there."""
        try:
            with np.errstate(all="ignore"):
                numbers = {name: _of_quantity(name, known) for name in self.quantities}
                numbers |= {name: _of_coefficient(name, measured) for name in self.coefficients}
                numbers |= {name: _statistic(*given, measured) for name, given in self.statistics.items()}
                return self._propagated(numbers)
        except InputError as error:
            return Quantity("", reason=str(error))

    def _propagated(self, numbers: Mapping[str, Interval]) -> Quantity:
        values = {name: np.float64(number[0]) for name, number in numbers.items()} | {"time": np.zeros(1), "pi": np.pi}

        def at(**changed: float) -> float:
            return float(value_of(self.tree, {**values, **changed}))

        value = at()
        if not np.isfinite(value):
            raise InputError(f"'{self.text}' has no finite value here")
        changes = [[at(**{name: np.float64(end)}) - value for end in number[1:]] for name, number in numbers.items()]
        low, high = (value + sum(extreme(0.0, *change) for change in changes) for extreme in (_least, _most))
        return Quantity("", value, low, high)


def _least(*values: float) -> float:
    return float(np.min(values))  # NaN where an end is not known


def _most(*values: float) -> float:
    return float(np.max(values))


def _of_quantity(name: str, known: Mapping[str, Quantity]) -> Interval:
    found = known.get(name)
    if found is None or not np.isfinite(found.value):
        raise InputError(f"{name}: {(found and found.reason) or 'not measured by this run'}")
    return found.value, found.low, found.high


def _of_coefficient(name: str, measured: Measurements | None) -> Interval:
    known = {} if measured is None else measured.coefficients
    if name not in known:
        model = "" if measured is None or measured.fit is None else f" '{measured.fit.model.name}'"
        raise InputError(f"the model{model} has no coefficient '{name}'{nearest_or_all(name, sorted(known))}")
    return known[name]


def _statistic(function: str, argument: ast.expr, measured: Measurements | None) -> Interval:
    if measured is None:
        raise InputError(f"{function}({ast.unparse(argument)}) needs the run's data")
    values = np.broadcast_to(value_of(argument, Data(measured.dataset)), (len(measured.dataset),))
    present = values[np.isfinite(values)]
    if not present.size:
        raise InputError(f"{function}({ast.unparse(argument)}) has no finite value in any row")
    value = float(STATISTICS[function](present))
    return value, value, value


@lru_cache(maxsize=256)
def expressed(text: str) -> Expressed:
    """The formula of a limit. InputError that says what is not understood, and why."""
    split = _Split()
    tree = split.visit(checked(text, dict.fromkeys(STATISTICS, 1), dotted=True))
    found = Expressed(text, tree, frozenset(split.quantities), frozenset(split.coefficients), split.statistics)
    if not (found.quantities or found.coefficients or found.statistics):
        raise InputError(
            f"expression: '{text}' is a number; use a quantity, a coefficient, or a statistic of a channel"
        )
    return found


class _Split(ast.NodeTransformer):
    """Gives statistics and coefficients names of their own; what is left is computed with one value for each name."""

    def __init__(self) -> None:
        self.quantities: set[str] = set()
        self.coefficients: set[str] = set()
        self.statistics: dict[str, tuple[str, ast.expr]] = {}

    def visit_Call(self, node: ast.Call) -> ast.expr:
        function = ast.unparse(node.func)
        if function in _OVER_TIME:
            raise InputError(f"expression: {function} is over time: write it inside {', '.join(STATISTICS)}")
        if function not in STATISTICS:
            node.args = [self.visit(argument) for argument in node.args]
            return node
        _allow_inside(function, node.args[0])
        name = ast.unparse(node)
        self.statistics[name] = (function, node.args[0])
        return ast.Name(name)

    def visit_Attribute(self, node: ast.Attribute) -> ast.expr:
        name = ast.unparse(node)
        if not re.fullmatch(r"\w+(\.\w+)+", name):
            raise InputError(f"expression: '{name}' is not a coefficient, such as polynomial.a1")
        self.coefficients.add(name)
        return ast.Name(name)

    def visit_Name(self, node: ast.Name) -> ast.expr:
        if node.id in variables() or node.id in CHANNELS:
            ways = ", ".join(f"{statistic}({node.id})" for statistic in STATISTICS)
            raise InputError(f"expression: '{node.id}' is a channel: write {ways}")
        if node.id not in MEANING and node.id != "pi":
            raise InputError(f"expression: no quantity '{node.id}'{nearest_or_all(node.id, list(MEANING))}")
        self.quantities |= {node.id} - {"pi"}
        return node


def _allow_inside(function: str, argument: ast.expr) -> None:
    """InputError where an argument of a statistic is not of channels."""
    inside = names_of(argument)
    if inside & set(STATISTICS) or any(isinstance(node, ast.Attribute) for node in ast.walk(argument)):
        raise InputError(f"expression: inside {function} are channels only, not '{ast.unparse(argument)}'")
    for name in sorted(inside - set(variables()) - set(FUNCTIONS) - {"pi"}):
        rates = "; a rate is limited by its quantities, such as bias_span_dph" if name in CHANNELS else hint({name})
        raise InputError(f"expression: '{name}' is not a channel that {function} can take{rates}")
    if not inside & set(variables()):
        raise InputError(f"expression: {function}({ast.unparse(argument)}) has no channel in it")


def _as_name(key: str) -> str:
    return ".".join(re.sub(r"\W", "_", part) for part in key.split("."))
