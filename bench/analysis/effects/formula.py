"""One-line formulas of a user: parsed by Python's grammar, checked node by node, computed by numpy; never executed.

Allowed: channel names, time [s], dT_dt [degC/min], direction (+1 heating, -1 cooling, 0), pi, numbers, + - * / **, and
the functions of `FUNCTIONS`. Every other name is a parameter: an amplitude, if it is a factor of a term, or a nonlinear
parameter, if bounds are given for it.
"""

from __future__ import annotations

import ast
import math
import re
import threading
import warnings
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import Any, cast

import numpy as np

from bench.analysis.effects.operators import (
    extreme,
    integral,
    latch,
    play,
    ramp_invariant_lag,
    shifted,
    slew,
    slope,
    uneven_lag,
)
from bench.base import CHANNELS, RATES, FloatArray, InputError, closest
from bench.record import STILL_DEGC_PER_MIN, Dataset

FUNCTIONS: dict[str, int] = {
    "lag": 2, "uneven_lag": 3, "delay": 2, "play": 2, "slew": 2, "dead_zone": 2, "latch": 3, "total": 1, "highest": 1,
    "lowest": 1, "above": 1, "sawtooth": 1, "abs": 1, "exp": 1, "log": 1, "sqrt": 1, "sin": 1, "cos": 1, "tanh": 1,
    "sign": 1,
}  # fmt: skip
"""Functions and their numbers of arguments: lag(x, tau_s), uneven_lag(x, rise_s, fall_s), whose time constant is
`rise_s` while x is above it and else `fall_s`, delay(x, late_s), play(x, width) in the unit of x, slew(x, per_min) that
follows x no faster than this, dead_zone(x, width), what of x is further than this from 0, latch(x, high, low), 1 from
where x rises above `high` until it falls below `low` and else 0, total(x), the integral over hours since the run began,
highest(x) and lowest(x) of the run so far, above(x), x where it is above 0 and else 0, sawtooth(x), from -0.5 to 0.5
between whole numbers. The time constant of a lag, and the width of a play, may change with a channel."""

_PLAIN: dict[str, Callable[[Any], Any]] = {
    "above": lambda x: np.maximum(x, 0.0), "sawtooth": lambda x: x - np.floor(x) - 0.5,
    "abs": np.abs, "exp": np.exp, "log": np.log, "sqrt": np.sqrt,
    "sin": np.sin, "cos": np.cos, "tanh": np.tanh, "sign": np.sign,
}  # fmt: skip
_MEMORY: dict[str, Callable[..., FloatArray]] = {
    "lag": ramp_invariant_lag,
    "uneven_lag": lambda time_s, x, rise_s, fall_s: uneven_lag(time_s, x, float(rise_s), float(fall_s)),
    "delay": lambda time_s, x, late_s: shifted(time_s, x, float(late_s)),
    "play": lambda _, x, width: play(x, width),
    "slew": lambda time_s, x, per_min: slew(time_s, x, float(per_min)),
    "dead_zone": lambda _, x, width: x - np.clip(x, -abs(float(width)), abs(float(width))),
    "latch": lambda _, x, high, low: latch(x, float(high), float(low)),
    "total": lambda time_s, x: integral(time_s, x) / 3600.0,
    "highest": lambda time_s, x: extreme(time_s, x, highest=True),
    "lowest": lambda time_s, x: extreme(time_s, x, highest=False),
}
_BINARY: dict[type[ast.operator], Callable[[Any, Any], Any]] = {
    ast.Add: np.add, ast.Sub: np.subtract, ast.Mult: np.multiply, ast.Div: np.divide, ast.Pow: np.power,
}  # fmt: skip
_DERIVED = ("dT_dt", "direction", "time")
_MAX_LENGTH, _MAX_NODES = 1000, 400
_WORD = re.compile(r"[A-Za-z_]\w*")
_PARSING = threading.Lock()
"""Python up to 3.12 counts the depth of all trees that are parsed at a time as one, and the filters of warnings are one
for all threads: the page parses in several."""

_OF_TIME = {"lag", "uneven_lag", "delay"}
"""Functions whose arguments after the first are times [s]."""

Terms = dict[str, ast.expr]
"""Factor of each amplitude; '' holds what no amplitude multiplies."""


def variables() -> tuple[str, ...]:
    """Names that a formula may use as data; the rate is what is modelled."""
    return (*(name for name in CHANNELS if name not in {*RATES, "time"}), *_DERIVED)


class NoFactorError(InputError):
    """Parameters `names` of a formula are no amplitudes: they need bounds."""

    def __init__(self, text: str, names: Collection[str]) -> None:
        super().__init__(text)
        self.names = names


@dataclass(frozen=True)
class Formula:
    """A checked formula: amplitude and factor of each term, nonlinear parameters, channels."""

    text: str
    amplitudes: tuple[str, ...]
    factors: tuple[ast.expr, ...]
    nonlinear: tuple[str, ...]
    needs: tuple[str, ...]

    @cached_property
    def _read(self) -> tuple[str, ...]:
        """Names of data in the factors, and the time, which functions with a memory follow."""
        names = set[str]().union(*map(names_of, self.factors))
        return "time", *names.intersection((*variables(), "pi"))

    def read_by(self, factor: ast.expr) -> tuple[str, ...]:
        """What a factor reads: channels, and what is of no one moment (time, slopes, what has a memory)."""
        names = names_of(factor)
        known = (*variables(), *(name for name in _MEMORY if name != "dead_zone"))
        return tuple(name for name in known if name in names)

    def columns(self, data: Data, theta: Mapping[str, float]) -> FloatArray:
        """Factors (n, k) of the whole record, NaN in gaps; InputError where one has no value in a row without a gap."""
        named = {name: data[name] for name in self._read} | dict(theta)
        columns = np.empty((len(named["time"]), len(self.factors)))
        with np.errstate(all="ignore"):
            for column, factor in enumerate(self.factors):
                columns[:, column] = value_of(factor, named)
        known = np.isfinite(columns).all(axis=1)
        for name in () if known.all() else self.needs:
            known |= ~np.isfinite(data[name])
        if not known.all():
            raise InputError(
                f"expression: '{self.text}' has no finite value in some rows (a root or logarithm below 0?)"
            )
        return columns


class Data(dict[str, Any]):
    """Values (n,) of the names that formulas read in one record, each computed once. InputError: no such channel."""

    def __init__(self, record: Dataset) -> None:
        super().__init__(time=record.time, pi=math.pi)
        self._record = record

    def __missing__(self, name: str) -> FloatArray:
        if name == "dT_dt":
            found: FloatArray = 60.0 * slope(self["time"], self["temperature"], 60.0)
        elif name == "direction":
            found = np.where(np.abs(self["dT_dt"]) < STILL_DEGC_PER_MIN, 0.0, np.sign(self["dT_dt"]))
        else:
            found = self._record.channel(name)
        self[name] = found
        return found


def parse(text: str, bounded: Collection[str] = ()) -> Formula:
    """Formula of this text, with `bounded` names nonlinear. InputError that says what is not understood, and why."""
    tree = checked(text)
    names = {node.id for node in ast.walk(tree) if isinstance(node, ast.Name)} - set(FUNCTIONS)
    for name in bounded:
        if name in variables() or name in FUNCTIONS or name not in names:
            raise InputError(f"expression: bounds for '{name}', which is not a parameter of '{text}'")
    free = names - set(variables()) - set(bounded) - {"pi"}
    for name in free:
        if name.startswith("_") or not name.isascii() or name in CHANNELS:
            why = "the rate is what is modelled" if name in RATES else "names are letters, digits and _ inside"
            raise InputError(f"expression: '{name}' is not allowed: {why}")
    terms = _terms(tree, free)
    if "" in terms:
        raise InputError(
            f"expression: '{ast.unparse(terms[''])}' has no amplitude; write k * ({ast.unparse(terms[''])})"
        )
    for name, factor in terms.items():
        if names_of(factor) & set(variables()):
            continue
        if others := sorted(names_of(factor) - {*FUNCTIONS, "pi"}):
            raise InputError(
                f"expression: '{ast.unparse(factor)}' follows no channel: '{others[0]}' is none "
                "(temperature, dT_dt and time are)"
            )
        raise InputError(f"expression: '{name}' multiplies no channel: that is the model's constant; leave it out")
    used = names & set(variables())
    needs = tuple(n for n in CHANNELS if n in used - {"time"} or (n == "temperature" and used & {"dT_dt", "direction"}))
    ordered = tuple(dict.fromkeys(name for name in _WORD.findall(text) if name in bounded))
    return Formula(text, tuple(terms), tuple(terms.values()), ordered, needs)


def needing_bounds(text: str) -> dict[str, bool]:
    """Parameters that are inside a function, a power or a divisor, so no amplitudes; True: a time [s]."""
    found = _no_amplitudes(text, frozenset())
    calls = (node for node in ast.walk(checked(text)) if isinstance(node, ast.Call)) if found else ()
    times = {
        name for call in calls if names_of(call.func) & _OF_TIME for part in call.args[1:] for name in names_of(part)
    }
    return {name: name in times for name in sorted(found)}


def _no_amplitudes(text: str, known: frozenset[str]) -> frozenset[str]:
    """`known` parameters that are no amplitudes, and those that the parser meets beside them."""
    try:
        parse(text, known)
    except NoFactorError as error:
        return _no_amplitudes(text, known.union(error.names))
    except InputError:  # what else is wrong is told elsewhere
        pass
    return known


def checked(text: str, more: Mapping[str, int] = MappingProxyType({}), *, dotted: bool = False) -> ast.expr:
    """Expression tree with allowed nodes only: also functions of `more`, and `dotted` names. InputError otherwise."""
    functions = {**FUNCTIONS, **more}
    if not isinstance(text, str) or not 0 < len(text) <= _MAX_LENGTH:
        raise InputError(f"expression: a formula is a text of 1 to {_MAX_LENGTH} characters, such as 'k * dT_dt'")
    try:
        with _PARSING, warnings.catch_warnings():
            warnings.simplefilter("ignore")
            tree = ast.parse(text.strip(), mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError, SystemError) as error:
        line = " ".join(text.split())
        raise InputError(f"expression: '{line}' is not a formula ({getattr(error, 'msg', error)})") from None
    nodes = list(ast.walk(tree))
    if len(nodes) > _MAX_NODES:
        raise InputError(f"expression: '{text[:40]}...' is too long; write an effect in a file instead")
    called = {id(node.func) for node in nodes if isinstance(node, ast.Call)}
    for node in nodes:
        if not (dotted and isinstance(node, ast.Attribute)):
            _allow(node, called, functions)
    return tree


def _allow(node: ast.AST, called: set[int], functions: Mapping[str, int]) -> None:
    if isinstance(node, ast.Call):
        _allow_call(node, functions)
    elif isinstance(node, ast.Name):
        if node.id in functions and id(node) not in called:
            raise InputError(f"expression: '{node.id}' is a function: write {node.id}(...)")
    elif isinstance(node, ast.Constant):
        if type(node.value) not in {int, float} or not abs(cast(float, node.value)) < 1e300:
            raise InputError(f"expression: {str(node.value)[:20]!r} is not a number that a formula can use")
    elif isinstance(node, ast.BinOp | ast.UnaryOp):
        if type(node.op) not in {*_BINARY, ast.USub, ast.UAdd}:
            raise InputError(f"expression: '{ast.unparse(node)}': allowed are + - * / and ** for powers")
    elif not isinstance(node, ast.operator | ast.unaryop | ast.expr_context):
        kind = type(node).__name__
        raise InputError(f"expression: {kind} is not allowed; use channels, parameters, + - * / ** and functions")


def _allow_call(node: ast.Call, functions: Mapping[str, int]) -> None:
    known = ", ".join(functions)
    if not isinstance(node.func, ast.Name) or node.func.id not in functions:
        raise InputError(f"expression: no function '{ast.unparse(node.func)[:40]}'; known are {known}")
    wanted = functions[node.func.id]
    if node.keywords or len(node.args) != wanted:
        raise InputError(f"expression: {node.func.id} takes {wanted} argument{'s' * (wanted > 1)}, in order")
    if wanted == 1:
        return
    inside, data = names_of(node.args[1]) - set(FUNCTIONS), set(variables())
    scaled = not inside <= data or any(isinstance(part, ast.Constant) for part in ast.walk(node.args[1]))
    if inside & data and not (scaled and node.func.id in {"lag", "play"}):
        raise InputError(f"expression: the second argument of {node.func.id} is a number or a parameter, not a channel")


def _terms(node: ast.expr, free: set[str]) -> Terms:
    """The expression as a sum over amplitudes; InputError where a free name is not simply a factor."""
    inside = names_of(node) & free
    if not inside:
        return {"": node}
    if isinstance(node, ast.Name):
        return {node.id: ast.Constant(1.0)}
    if isinstance(node, ast.UnaryOp):
        return {name: ast.UnaryOp(node.op, factor) for name, factor in _terms(node.operand, free).items()}
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add | ast.Sub):
        return _sum(node, free)
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Mult | ast.Div):
        return _product(node, free)
    raise _no_factor(node, inside)


def _sum(node: ast.BinOp, free: set[str]) -> Terms:
    total = _terms(node.left, free)
    for name, factor in _terms(node.right, free).items():
        signed = factor if isinstance(node.op, ast.Add) else ast.UnaryOp(ast.USub(), factor)
        total[name] = ast.BinOp(total[name], ast.Add(), signed) if name in total else signed
    return total


def _product(node: ast.BinOp, free: set[str]) -> Terms:
    left, right = names_of(node.left) & free, names_of(node.right) & free
    if not right:
        return {name: _times(factor, node.op, node.right) for name, factor in _terms(node.left, free).items()}
    if isinstance(node.op, ast.Div):
        raise _no_factor(node, right)
    others = _terms(node.right, free)
    if not left:
        return {name: _times(factor, node.op, node.left) for name, factor in others.items()}
    _terms(node.left, free)
    both = " and ".join(f"'{name}'" for name in sorted(left | right))
    raise InputError(f"expression: {both} multiply each other: one amplitude is enough{hint(left | right)}")


def _no_factor(node: ast.expr, names: Collection[str]) -> NoFactorError:
    one = min(names)
    return NoFactorError(
        f"expression: '{one}' is not simply a factor in '{ast.unparse(node)}': give it bounds, such as "
        f"bounds: {{{one}: [10, 1000]}}{hint(names)}",
        names,
    )


def _times(factor: ast.expr, op: ast.operator, other: ast.expr) -> ast.expr:
    if isinstance(factor, ast.Constant) and factor.value == 1.0 and isinstance(op, ast.Mult):
        return other
    return ast.BinOp(factor, op, other)


def hint(names: Collection[str]) -> str:
    """A likely slip of the pen: a parameter that nearly is a channel."""
    known = (*variables(), *FUNCTIONS)
    close = {name: closest(name, known, 0.8) for name in sorted(names)}
    return "".join(f"; did you mean '{near}' by '{name}'?" for name, near in close.items() if near)


def names_of(node: ast.AST) -> set[str]:
    """All names in a tree, also those of functions."""
    return {item.id for item in ast.walk(node) if isinstance(item, ast.Name)}


def value_of(node: ast.expr, data: Mapping[str, Any]) -> Any:
    """Value of a checked node: an array (n,) or a number."""
    if isinstance(node, ast.Name):
        return data[node.id]
    if isinstance(node, ast.BinOp):
        return _BINARY[type(node.op)](value_of(node.left, data), value_of(node.right, data))
    if isinstance(node, ast.UnaryOp):
        return value_of(node.operand, data) * (-1.0 if isinstance(node.op, ast.USub) else 1.0)
    if isinstance(node, ast.Call):
        return _called(cast(ast.Name, node.func).id, [value_of(argument, data) for argument in node.args], data["time"])
    return np.float64(cast(float, cast(ast.Constant, node).value))


def _called(name: str, arguments: list[Any], time_s: FloatArray) -> Any:
    if name in _PLAIN:
        return _PLAIN[name](arguments[0])
    record = np.broadcast_to(np.asarray(arguments[0], dtype=np.float64), time_s.shape)
    return _MEMORY[name](time_s, record, *arguments[1:])
