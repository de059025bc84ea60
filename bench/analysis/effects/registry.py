"""The registry of effects: built in, from a user's file, or from entry points. A new one: its file and a line here."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import fields
from functools import lru_cache
from importlib.metadata import entry_points
from typing import Any, cast

from bench.analysis.effects.aging import Aging
from bench.analysis.effects.base import Effect
from bench.analysis.effects.bias_jump import BiasJump
from bench.analysis.effects.bias_kink import BiasKink
from bench.analysis.effects.clock_delay import ClockDelay
from bench.analysis.effects.compressor import Compressor
from bench.analysis.effects.creep import Creep
from bench.analysis.effects.drive_amplitude import DriveAmplitude
from bench.analysis.effects.expression import Expression
from bench.analysis.effects.frost import Frost
from bench.analysis.effects.hysteresis import Hysteresis
from bench.analysis.effects.lagged_product import LaggedProduct
from bench.analysis.effects.lock_in import LockIn
from bench.analysis.effects.partial_range import PartialRange
from bench.analysis.effects.pattern_angle import PatternAngle
from bench.analysis.effects.plugin import check, load_class
from bench.analysis.effects.polynomial import Polynomial
from bench.analysis.effects.quadrature_leakage import QuadratureLeakage
from bench.analysis.effects.regression import Regression
from bench.analysis.effects.resonance_frequency import ResonanceFrequency
from bench.analysis.effects.scale_factor import ScaleFactor
from bench.analysis.effects.scale_factor_nonlinearity import ScaleFactorNonlinearity
from bench.analysis.effects.scale_factor_temperature import ScaleFactorTemperature
from bench.analysis.effects.shupe import Shupe
from bench.analysis.effects.spline import Spline
from bench.analysis.effects.supply_voltage import SupplyVoltage
from bench.analysis.effects.surface import Surface
from bench.analysis.effects.temperature_rate import TemperatureRate
from bench.analysis.effects.thermal_lag import ThermalLag
from bench.analysis.effects.thermometer_hysteresis import ThermometerHysteresis
from bench.analysis.effects.thermometer_lag import ThermometerLag
from bench.analysis.effects.thermometer_offset import ThermometerOffset
from bench.analysis.effects.warm_up import WarmUp
from bench.base import InputError, nearest_or_all

_BUILT_IN = (
    Polynomial,
    Regression,
    Spline,
    Surface,
    ThermalLag,
    TemperatureRate,
    Hysteresis,
    Creep,
    WarmUp,
    Aging,
    QuadratureLeakage,
    DriveAmplitude,
    ResonanceFrequency,
    SupplyVoltage,
    Compressor,
    BiasJump,
    BiasKink,
    Frost,
    ScaleFactor,
    ScaleFactorTemperature,
    ScaleFactorNonlinearity,
    ThermometerLag,
    ThermometerHysteresis,
    ThermometerOffset,
    ClockDelay,
    LaggedProduct,
    PartialRange,
    Expression,
)
PACKS: Mapping[str, tuple[type[Effect], ...]] = {
    "fog": (Shupe,),
    "rlg": (LockIn,),
    "whole_angle": (PatternAngle,),
}
"""Effects of one kind of gyro. Every model may contain them; suspects they are where their pack was loaded."""
PACKED: Mapping[str, type[Effect]] = {kind.name: kind for pack in PACKS.values() for kind in pack}
_REGISTRY: dict[str, type[Effect]] = {kind.name: kind for kind in _BUILT_IN}
_BROKEN: dict[str, str] = {}
"""Why an entry point gave no effect; said when somebody asks for it."""


def effect_names() -> tuple[str, ...]:
    """Names of all effects, as models write them."""
    _discover()
    return tuple(_REGISTRY)


def get(name: str) -> type[Effect]:
    """Class of an effect; InputError with the nearest known name, or why a plug-in gave no effect."""
    if name in PACKED:
        return PACKED[name]
    if name not in _REGISTRY:
        _discover()
    if name in _BROKEN:
        raise InputError(_BROKEN[name])
    if name not in _REGISTRY:
        raise InputError(f"unknown effect '{name}'{nearest_or_all(name, (*effect_names(), *PACKED))}")
    return _REGISTRY[name]


def register(kind: object, source: str) -> str:
    """Take a class into the registry, where it is like the built-in ones; its name. InputError as `plugin.check`."""
    effect = check(kind, source)
    name = effect.name
    if _REGISTRY.get(name, effect) in _BUILT_IN or PACKED.get(name, effect) is not effect:
        raise InputError(f"{source}: the name '{name}' is a built-in effect's; choose another")
    _REGISTRY[name] = effect
    return name


def load_effect(spec: str) -> str:
    """Name of the effect in `mine.py:Class` or `package.module:Class`, registered from now on; or of a pack's effects.

    Raises InputError: no such file or class, an error in the file, or a class that is not an effect (what is missing).
    """
    if spec in PACKS:
        _REGISTRY.update({kind.name: kind for kind in PACKS[spec]})
        return ", ".join(kind.name for kind in PACKS[spec])
    return register(load_class(spec), spec)


def own_effects() -> tuple[type[Effect], ...]:
    """The effects beside the built-in ones, for another process to `register`."""
    return tuple(kind for kind in _REGISTRY.values() if kind not in _BUILT_IN)


@lru_cache(maxsize=1)
def _discover() -> None:
    """Register what installed packages offer in the entry-point group `bench.effects`; a broken one breaks itself."""
    for entry in entry_points(group="bench.effects"):
        try:
            register(entry.load(), f"entry point {entry.name} = {entry.value}")
        except Exception as error:  # whatever a foreign module may raise
            _BROKEN[entry.name] = f"effect '{entry.name}' of {entry.value} cannot be used: {error}"


def make(name: str, options: Mapping[str, Any] | None = None) -> Effect:
    """Effect with options; InputError for an unknown name, an unknown option or a value that is not allowed."""
    kind = get(name)
    options = options or {}
    known = tuple(item.name for item in fields(cast(Any, kind)) if not item.metadata.get("fitted"))
    for option in options:
        if option not in known:
            raise InputError(f"effect '{name}' has no option '{option}'{nearest_or_all(str(option), known)}")
    return kind(**options)


def doc(name: str) -> str:
    """Documentation page of an effect: its module's docstring (equation, units, source, symptoms)."""
    return sys.modules[get(name).__module__].__doc__ or ""
