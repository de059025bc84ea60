"""The second paper's surface as a delivery, for any axis of a gyro or an accelerometer.

Rate(NR, T) is delivered as the nominal gain times NR, which a split form keeps in full precision, minus the correction
NR - Rate(NR, T) in the unit of the output.
"""

from __future__ import annotations

from bench.analysis import RateSurface
from bench.base import DPH_PER_DPS, FloatArray, InputError
from bench.deliver.export import chebyshev
from bench.deliver.export.delivery import INPUTS, Block, Delivery, Shape
from bench.deliver.export.signals import box_of, channel_signal

_OUTPUTS = {"deg/s": ("rate", DPH_PER_DPS), "m/s^2": ("acceleration", 1.0)}


def deliver_surface(surface: RateSurface, axis: int = 0) -> Delivery:
    """Delivery of a surface whose raw output and reference are in deg/s or in m/s^2; `axis` is 0 to 2."""
    if surface.unit not in _OUTPUTS or axis not in range(3):
        raise InputError(
            f"surface of axis {axis} in {surface.unit!r}: allowed are axes 0 to 2 in {', '.join(map(repr, _OUTPUTS))}"
        )
    name, scale = _OUTPUTS[surface.unit]
    raw = channel_signal(name, surface.raw.low * scale, surface.raw.high * scale)
    temperature = channel_signal("temperature", surface.temperature.low, surface.temperature.high)

    def error(output: FloatArray, degc: FloatArray) -> FloatArray:
        return output / scale - surface.predict(output / scale, degc)[0]

    boxes = (*box_of(raw, name), *box_of(temperature, "temperature"))
    block = Block(Shape.SURFACE, 0, 1, surface.order, chebyshev.surface(error, *boxes, surface.order))
    full_scale = max(abs(surface.raw.low), abs(surface.raw.high))
    output = 0 if name == "rate" else 1
    return Delivery("surface", (raw, temperature), (block,), INPUTS[name].count, full_scale, output=output, axis=axis)
