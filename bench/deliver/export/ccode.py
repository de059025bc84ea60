"""C99 source and header of an image: the arithmetic of docs/eeprom.md with all numbers as constants."""

from __future__ import annotations

import re
from collections.abc import Mapping
from importlib.resources import files
from typing import Any

import numpy as np
from jinja2 import Environment, StrictUndefined

from bench.base import InputError, __version__
from bench.deliver.export.delivery import INPUTS, Kind, Shape, Signal
from bench.deliver.export.image import KINDS, VERSION, Image
from bench.deliver.export.words import float_of, i32

_TEMPLATES = files("bench.deliver.export") / "templates"
_TYPES = {"float32": "float", "fixed": "int32_t", "split": "int64_t", "split_fixed": "int64_t"}


def c_files(image: Image, words: list[int], name: str = "calibration") -> dict[str, str]:
    """Header and source by file name; `name` begins every public identifier."""
    refuse_name(name)
    content = _content(image, words, name)
    return {f"{name}.{kind}": rendered(f"calibration.{kind}.j2", content) for kind in ("h", "c")}


def refuse_name(name: str) -> None:
    """InputError for what C does not take as the beginning of a name."""
    if not re.fullmatch(r"[a-z][a-z0-9_]{0,30}", name):
        raise InputError(f"'{name}' is not a valid C name: allowed are up to 31 of a-z, 0-9 and _, a letter first")


def rendered(template: str, content: Mapping[str, Any]) -> str:
    """The text of one of the templates."""
    environment = Environment(
        undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True, autoescape=False
    )
    return environment.from_string((_TEMPLATES / template).read_text(encoding="utf-8")).render(content)


def inputs_of(image: Image) -> list[str]:
    """Names of the inputs that the code reads, the raw output first."""
    raw = "rate" if image.output == 0 else "acceleration"
    own = {signal.source for signal in image.signals if signal.kind is Kind.CHANNEL}
    return [raw, *(name for name, entry in INPUTS.items() if entry.id in own and name != raw)]


def _content(image: Image, words: list[int], name: str) -> dict[str, Any]:
    kinds = {number: kind for kind, number in KINDS.items()}
    return {
        "name": name,
        "version": __version__,
        "image_version": VERSION,
        "serial": image.serial,
        "calibration_id": image.calibration_id,
        "crc": words[-1],
        "model": kinds.get(image.model_kind, "composed"),
        "form": image.form,
        "floats": image.floats,
        "period_ns": image.period_ns,
        "order": image.order,
        "inputs": [_input(image, entry) for entry in inputs_of(image)],
        "raw": inputs_of(image)[0],
        "output_type": _TYPES[image.form],
        "output_text": _output_text(image),
        "number_type": "float" if image.floats else "int32_t",
        "coefficients": [single(float_of(w)) if image.floats else _integer(i32(w)) for w in image.coefficients],
        "gain": image.gain,
        "gain_f32": single(image.gain_f32),
        "correction": image.correction,
        "signals": [_signal(i, signal, name) for i, signal in enumerate(image.signals)],
        "stateful": any(signal.kind in {Kind.LAG, Kind.PLAY, Kind.BEHIND} for signal in image.signals),
        "blocks": [
            {"shape": shape, "a": a, "b": b, "n": n, "first": first, "text": _block_text(shape, a, b, n)}
            for shape, a, b, n, first in image.blocks
        ],
    }


def _input(image: Image, name: str) -> dict[str, Any]:
    entry = INPUTS[name]
    own = [s for s in image.signals if s.kind is Kind.CHANNEL and s.source == entry.id]
    low, high = (own[0].low, own[0].high) if own else (None, None)
    return {"name": name, "count": f"{entry.count:g}", "unit": entry.unit, "low": low, "high": high}


def _output_text(image: Image) -> str:
    unit = "deg/s" if image.output == 0 else "m/s^2"
    step = {"float32": "in", "fixed": f"in 2^-{image.fraction_bits}"}.get(image.form, "in 1e-12")
    return f"Corrected output {step} {unit}."


def _signal(number: int, signal: Signal, name: str) -> dict[str, Any]:
    names = {entry.id: entry.name for entry in INPUTS.values()}
    channel = names.get(signal.source, "") if signal.kind is Kind.CHANNEL else ""
    bit = f"0x{1 << number:X}U"
    present = (
        f"input->{channel} != {name.upper()}_NO_VALUE" if channel else f"(known & 0x{1 << signal.source:X}U) != 0U"
    )
    numbers = {key: _integer(getattr(signal, key)) for key in ("low", "high", "centre", "recip")}
    text = channel or f"{signal.kind.name.lower()} of signal {signal.source}"
    return {
        "number": number,
        "kind": int(signal.kind),
        "source": signal.source,
        "input": channel,
        "present": present,
        "bit": bit,
        "shift": signal.shift,
        "p": [_integer(value) for value in signal.p],
        "text": text,
        **numbers,
    }


def _block_text(shape: int, a: int, b: int, n: int) -> str:
    if shape == Shape.SURFACE:
        return f"surface of order {n} over signals {a} and {b}"
    return f"{n} cubic pieces over signal {a}" if shape == Shape.SPLINE else f"series of order {n} over signal {a}"


def _integer(value: int) -> str:
    """An i32 as a C constant."""
    return "(-2147483647 - 1)" if value == -(1 << 31) else str(value)


def single(value: float) -> str:
    """A constant of C: the shortest decimal that reads back as the same float."""
    text = str(np.float32(value))
    return f"{text}F" if "." in text or "e" in text else f"{text}.0F"
