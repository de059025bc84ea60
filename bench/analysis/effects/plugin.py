"""Effects that a user writes: found in a file or a package, and held to the same contract as the built-in ones."""

from __future__ import annotations

import importlib
import keyword
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import MISSING, fields, is_dataclass
from importlib.machinery import ModuleSpec, SourceFileLoader
from importlib.util import spec_from_file_location
from pathlib import Path
from types import CodeType, ModuleType
from typing import Any, cast

import numpy as np

from bench.analysis.effects.base import Effect, Parameter, Physical
from bench.analysis.effects.example import example
from bench.base import CHANNELS, InputError

_PREFIX = "bench_effect_"
_SOURCE = "__source__"


def load_class(spec: str) -> object:
    """Class of `mine.py:Class` or `package.module:Class`; InputError where there is none, or its file fails."""
    place, _, name = spec.rpartition(":")
    if not place or not name.isidentifier():
        raise InputError(f"'{spec}' is not an effect; write mine.py:Class or package.module:Class")
    module = _module(place)
    content = vars(module)
    if name not in content:
        offered = [key for key, value in content.items() if getattr(value, "__module__", "") == module.__name__]
        raise InputError(f"{place} has no class '{name}'; it has {', '.join(offered) or 'none'}")
    return content[name]


def _module(place: str) -> ModuleType:
    path = Path(place)
    with _one_line(f"{place} cannot be loaded"):
        if path.suffix != ".py":
            return importlib.import_module(place)
        if not path.is_file():
            raise InputError("no such file with an effect", path)
        key = f"{_PREFIX}{path.resolve().as_posix().encode().hex()}"
        known = sys.modules.get(key)
        if known is not None and vars(known)[_SOURCE] == path.read_bytes():
            return known
        sys.modules.pop(key, None)
        return importlib.import_module(key)


class _UserFile(SourceFileLoader):
    """Loads a file with effects; its module's name is its path, so that another process finds it, too."""

    def get_code(self, fullname: str) -> CodeType:
        # Compiled each time: kept bytecode is taken for that of a file of the same size, saved in the same second.
        return self.source_to_code(self.get_data(self.path), self.path)

    def exec_module(self, module: ModuleType) -> None:
        vars(module)[_SOURCE] = self.get_data(self.path)
        super().exec_module(module)

    @classmethod
    def find_spec(cls, name: str, _path: object = None, _target: object = None) -> ModuleSpec | None:
        """Where the module of such a name comes from."""
        if not name.startswith(_PREFIX):
            return None
        path = bytes.fromhex(name.removeprefix(_PREFIX)).decode()
        return spec_from_file_location(name, path, loader=cls(name, path))


sys.meta_path.append(_UserFile)


@contextmanager
def _one_line(what: str) -> Iterator[None]:
    """Whatever a user's code may raise as an InputError of one line."""
    try:
        yield
    except InputError:
        raise
    except Exception as error:
        raise InputError(f"{what}: {type(error).__name__}: {' '.join(str(error).split())}") from error


def check(kind: object, source: str) -> type[Effect]:
    """The class, if it is an `Effect` that works on an example run; InputError that says what is wrong with it."""
    if not isinstance(kind, type) or not issubclass(kind, Effect):
        raise InputError(f"{source}: an effect derives from bench.Effect; docs/howto/effects.md has an example")
    if not is_dataclass(kind) or not cast(Any, kind).__dataclass_params__.frozen:
        raise InputError(f"{source}: an effect is a class decorated with @dataclass(frozen=True)")
    required = [item.name for item in fields(kind) if not _has_default(item)]
    if required:
        raise InputError(f"{source}: option '{required[0]}' needs a default value")
    with _one_line(f"{source}: fails on an example run"):
        _try(kind(), source)
    return kind


def _has_default(item: Any) -> bool:
    return item.default is not MISSING or item.default_factory is not MISSING or not item.init


def _try(effect: Effect, source: str) -> None:
    _check_words(effect, source)
    _check_parameters(effect, source)
    record = example()
    ready = effect.prepare([record])
    columns = ready.columns(record, {parameter.name: parameter.start for parameter in effect.parameters})
    if not isinstance(columns, np.ndarray) or columns.ndim != 2 or len(columns) != len(record):
        raise InputError(f"{source}: columns() must give an array ({len(record)}, k), one row for each of the record")
    if not np.all(np.isfinite(columns)):
        raise InputError(f"{source}: columns() gives values that are not finite in an example run without gaps")
    if columns.shape[1] == 0 and not ready.moves_abscissa:
        raise InputError(f"{source}: the effect would do nothing: it has neither columns() nor abscissa()")
    form, wide = ready.physical(), 1 + columns.shape[1]
    sizes = {len(form.labels), len(form.units), len(form.matrix)} if isinstance(form, Physical) else set()
    if len(sizes) != 1 or form.matrix.shape[1] != wide:
        raise InputError(
            f"{source}: `amplitudes` must hold a name and a unit for each of the {wide - 1} columns, or physical() "
            f"labels, units and a matrix (p, {wide})"
        )


def _check_words(effect: Effect, source: str) -> None:
    name = getattr(effect, "name", None)
    if not isinstance(name, str) or not name.isidentifier() or keyword.iskeyword(name):
        raise InputError(f"{source}: name is {name!r}, it must be a word such as 'my_effect'")
    if not isinstance(effect.family, str) or not effect.family:
        raise InputError(f"{source}: family is {effect.family!r}, it must be a word")
    unknown = [channel for channel in effect.needs if channel not in CHANNELS]
    if unknown:
        raise InputError(f"{source}: needs '{unknown[0]}', which is not a channel; known are {', '.join(CHANNELS)}")


def _check_parameters(effect: Effect, source: str) -> None:
    for parameter in effect.parameters:
        if not isinstance(parameter, Parameter) or not parameter.low <= parameter.start <= parameter.high:
            raise InputError(f"{source}: parameters are bench.Parameter with low <= start <= high")
        if parameter.log and parameter.low <= 0:
            raise InputError(f"{source}: parameter '{parameter.name}' is logarithmic, its low must be above 0")
