"""What counts as a model where one is asked for; the catalogues of effects and channels."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias, Union

from bench import analysis
from bench.analysis import CatalogueEntry, Effect, Model
from bench.base import CHANNELS, Channel, InputError

if TYPE_CHECKING:
    from bench.api.fits import Fit

ModelLike: TypeAlias = Union[str, Path, Model, Effect, "Fit"]
"""Name of a shipped model or of an effect, a YAML file, a model, one effect, or a fit (its model)."""


def fitted_model(model: ModelLike, options: Mapping[str, object] | None = None) -> Model:
    """The model that is meant, `options` being those of the effect that it names.

    Raises InputError: an unknown model, effect or option, or options for something that is not the name of an effect.
    """
    from bench.analysis import effect_names, load_model, make
    from bench.api.fits import Fit

    if options:
        if isinstance(model, str) and model in effect_names():
            return Model(model, (make(model, options),))
        text = "options are those of one effect, named by its name"
        raise InputError(f"{text}: known are {', '.join(effect_names())}; got {model!r} with {', '.join(options)}")
    if isinstance(model, str | Path):
        return load_model(model)
    if isinstance(model, Fit):
        return model.model
    if isinstance(model, Model):
        return model
    if isinstance(model, Effect):
        return Model(model.name, (model,))
    raise InputError(f"{model!r} is no model: give a name, a YAML file, a model, an effect or a fit")


def add(effect: str | Effect, model: ModelLike, **options: object) -> Model:
    """The model with one more effect: its name in the catalogue with its options, or an effect of your own.

    Raises InputError: an unknown effect or option, or an effect that the model has already.

    >>> import bench
    >>> bench.add("thermal_lag", "polynomial").name
    'polynomial + thermal_lag'
    """
    base = fitted_model(model)
    if isinstance(effect, str):
        return analysis.add_effect(base, effect, options)
    return base.adding(effect)


def effects() -> tuple[CatalogueEntry, ...]:
    """The catalogue of effects: name, family, summary, channels that it needs, parameters, options, documentation.

    >>> import bench
    >>> [effect.name for effect in bench.effects()][:3]
    ['polynomial', 'regression', 'spline']
    """
    return analysis.catalogue()


def channels() -> tuple[Channel, ...]:
    """The channels of a record: name, unit, meaning, and whether a table needs it; every table is converted into these.

    >>> import bench
    >>> [(channel.name, channel.unit) for channel in bench.channels() if channel.required]
    [('time', 's'), ('rate', 'deg/h'), ('temperature', 'degC')]
    """
    return tuple(CHANNELS.values())
