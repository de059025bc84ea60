"""Which signals of which messages make up a unit: by the names that the bench knows, or by a mapping.

A unit has outputs (`rate`, or `rate_x` … `acceleration_z`), and may have thermometers, further channels, a counter or a
time stamp, status signals and a heartbeat. The message of the first output gives the samples; every other source of
channels is placed beside them: by a counter, which repeats the low bits of the first one, or by its time of arrival.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from drivers.errors import ConfigError
from drivers.states import RAW, VALID, States
from drivers.units import USUAL, conversion
from drivers.wire import Message, Signal, described, load_dbc

RATES = ("rate", "rate_x", "rate_y", "rate_z")
ACCELERATIONS = ("acceleration_x", "acceleration_y", "acceleration_z")
OUTPUTS = (*RATES, *ACCELERATIONS)
THERMOMETERS = re.compile(r"temperature(_[1-9]\d?)?")

_KEPT = {
    **dict.fromkeys(RATES, "deg/h"), **dict.fromkeys(ACCELERATIONS, "m/s^2"),
    "temperature": "degC", "frequency": "Hz", "drive": "V", "quadrature": "V", "supply": "V",
}  # fmt: skip
"""Unit of each channel."""
_USUAL = {
    "rate": "Rate",
    "temperature": "Temperature",
    "frequency": "ResonanceFrequency",
    "drive": "DriveAmplitude",
    "quadrature": "QuadratureAmplitude",
    "supply": "SupplyVoltage",
}
_USUAL_BEAT = {"serial": "Serial", "state": "State", "firmware": "Firmware", "coefficient_set": "CoefficientSet"}
COUNTER, SLOW_COUNTER, CRC = "SampleCounter", "SlowCounter", "Crc8"

Described = Mapping[str, Any]
"""A signal without a DBC: `id`, `start`, `length`, and what else `drivers.wire.described` takes."""


@dataclass(frozen=True)
class SignalMap:
    """What the station file says of the signals of a unit: names in its DBC (`Signal` or `Message.Signal`), or bits."""

    channels: Mapping[str, str | Described]
    counters: Sequence[str | Described] = ()
    """Of the samples: that of the first output's message, and the low bits of it in others."""
    time_stamp: str | Described | None = None
    """The unit's own time of a sample, instead of a counter."""
    status: Sequence[Described] = ()
    """`signal` or bits, with `valid` or `raw`: values with which samples are valid, or not corrected by the unit."""
    beat: Mapping[str, str | Described] = field(default_factory=dict)
    """`serial`, `state`, `firmware`, `coefficient_set` of a heartbeat."""
    cycle_ms: float | None = None
    """Time between two samples of the first output, where the DBC does not say."""

    @classmethod
    def of(cls, content: Mapping[str, Any]) -> SignalMap:
        """As the station file has it: channels beside `counter`, `time_stamp`, `status`, `cycle_ms` and the beat's."""
        known = dict(content)
        counters = known.pop("counter", ())
        counters = counters if isinstance(counters, list | tuple) else (counters,)
        stamp, status, cycle_ms = known.pop("time_stamp", None), known.pop("status", ()), known.pop("cycle_ms", None)
        beat = {name: known.pop(name) for name in _USUAL_BEAT if name in known}
        return cls(known, tuple(counters), stamp, tuple(status), beat, cycle_ms)


@dataclass(frozen=True)
class Source:
    """One message of a unit, or those frames of a multiplexed one that carry certain signals."""

    message: Message
    channels: Mapping[str, tuple[Signal, float]]
    """Signal and factor to the unit of the channel, by channel."""
    counter: Signal | None
    states: States
    choice: Signal | None = None
    """A signal that only the frames of this source carry; None: all of the message do."""


@dataclass(frozen=True)
class Beat:
    """The heartbeat: signals by `serial`, `state`, `firmware`, `coefficient_set`."""

    message: Message
    signals: Mapping[str, Signal]
    states: States


@dataclass(frozen=True)
class Layout:
    """The messages of a unit."""

    output: str
    """Channel of the first output."""
    first: Source
    others: tuple[Source, ...]
    beat: Beat | None
    stamp: tuple[Signal, float] | None
    """The time stamp in the message of the first output, and its step [s]."""
    interval_ms: float

    @property
    def messages(self) -> tuple[Message, ...]:
        """Each once."""
        found = [source.message for source in (self.first, *self.others)] + ([self.beat.message] if self.beat else [])
        return tuple({message.name: message for message in found}.values())

    @property
    def channels(self) -> dict[str, tuple[Signal, float]]:
        """Signal and factor of every channel, the first output first."""
        own = {self.output: self.first.channels[self.output]}
        return own | {name: place for source in (self.first, *self.others) for name, place in source.channels.items()}

    def lacks(self) -> Iterator[str]:
        """What the unit does not say, and what is lost by it."""
        if self.first.counter is None and self.stamp is None:
            yield (
                "no counter and no time stamp: samples are counted by their cycle time, and a frame that is lost while "
                "the computer is late may be taken for one that came late"
            )
        if CRC not in self.first.message.signals:
            yield "no CRC: a frame that is altered behind the CAN controller is not noticed"
        if self.beat is None or "serial" not in self.beat.signals:
            yield "no serial number: another unit in the place of this one is not noticed"
        if self.beat is None or "state" not in self.beat.signals:
            yield "no state in a heartbeat: a unit that starts anew within 50 ms is not noticed"
        if not any(THERMOMETERS.fullmatch(name) for name in self.channels):
            yield "no thermometer: the air of the chamber takes its place, which the unit follows minutes later"
        if not (self.first.states.watched or any(source.states.watched for source in self.others)):
            yield "no status: samples that the unit itself holds for wrong are not left out"


def layout_of(dbc: str | Path | None, signals: Mapping[str, Any] | None = None) -> Layout:
    """The messages of a unit; ConfigError where something that it needs is missing or not clear.

    `signals` is a mapping as in the station file; without one the DBC has the names that the bench knows.
    """
    if signals is None:
        if dbc is None:
            raise ConfigError("a unit needs a DBC or a mapping of its signals")
        return _usual(load_dbc(dbc), dbc)
    return _Mapped(SignalMap.of(signals), dbc).layout()


def converted(channel: str, message: Message, signal: Signal) -> tuple[Signal, float]:
    """The signal, and the factor from its unit to that of the channel; ConfigError for a unit of something else.

    An offset between the units, of temperatures, becomes part of the signal's own.
    """
    try:
        if not signal.unit:
            raise ConfigError("no unit: the DBC must state it")
        found = conversion(signal.unit, _KEPT["temperature" if THERMOMETERS.fullmatch(channel) else channel], channel)
    except ConfigError as error:
        raise ConfigError(f"{message.name}.{signal.name} has the unit '{signal.unit}': {error}") from None
    if not found.offset:
        return signal, found.factor
    shift = found.offset / found.factor
    bounds = None if signal.bounds is None else (signal.bounds[0] + shift, signal.bounds[1] + shift)
    return replace(signal, offset=signal.offset + shift, bounds=bounds), found.factor


def _usual(messages: Mapping[str, Message], dbc: str | Path) -> Layout:
    rate = _one_with(messages, dbc, "Rate", COUNTER)
    beat = _one_with(messages, dbc, "Serial", "State")
    if rate.cycle_ms is None:
        raise ConfigError(f"DBC {dbc}: {rate.name} has no cycle time (GenMsgCycleTime [ms])")
    others = [m for m in messages.values() if SLOW_COUNTER in m.signals and m is not rate]
    sources = [_source(rate, {"rate": "Rate"}, rate.signals[COUNTER])]
    for message in others:
        names = {channel: name for channel, name in _USUAL.items() if name in message.signals}
        if names:
            sources.append(_source(message, names, message.signals[SLOW_COUNTER]))
    found = {what: beat.signals[name] for what, name in _USUAL_BEAT.items() if name in beat.signals}
    return Layout("rate", sources[0], tuple(sources[1:]), Beat(beat, found, States(beat)), None, rate.cycle_ms)


def _source(message: Message, names: Mapping[str, str], counter: Signal | None) -> Source:
    channels = {channel: converted(channel, message, message.signals[name]) for channel, name in names.items()}
    choices = [signal for signal, _ in channels.values() if signal.choice is not None]
    return Source(message, channels, counter, States(message), choices[0] if choices else None)


def _one_with(messages: Mapping[str, Message], dbc: str | Path, *signals: str) -> Message:
    found = [message for message in messages.values() if set(signals) <= set(message.signals)]
    if len(found) != 1:
        raise ConfigError(f"DBC {dbc}: {len(found)} messages with {' and '.join(signals)}, must be exactly one")
    return found[0]


class _Mapped:
    """Finds the signals of a mapping."""

    def __init__(self, signals: SignalMap, dbc: str | Path | None) -> None:
        self._map = signals
        given = [*signals.channels.values(), *signals.counters, *signals.beat.values(), *signals.status]
        given += [signals.time_stamp] if signals.time_stamp is not None else []
        bits = [one for one in given if not isinstance(one, str) and "id" in one]
        self._messages = {} if dbc is None or len(bits) == len(given) else load_dbc(dbc)
        self._messages = {**self._messages, **described(bits)}

    def layout(self) -> Layout:
        """All of it."""
        outputs = [name for name in OUTPUTS if name in self._map.channels]
        if not outputs:
            raise ConfigError(f"signals: no output; map at least one of {', '.join(OUTPUTS)}")
        self._watch()
        places = {name: self._find(where, name) for name, where in self._map.channels.items()}
        counters = [self._find(where, "counter") for where in self._map.counters]
        groups: dict[tuple[str, object], dict[str, tuple[Message, Signal]]] = {}
        for name, (message, signal) in places.items():
            groups.setdefault((message.name, signal.choice), {})[name] = (message, signal)
        sources = [self._group(group, counters) for group in groups.values()]
        first = next(source for source in sources if outputs[0] in source.channels)
        cycle_ms = self._map.cycle_ms or first.message.cycle_ms
        if cycle_ms is None:
            raise ConfigError(f"signals: {first.message.name} has no cycle time; state `cycle_ms` [ms]")
        counted = first.counter is not None
        others = tuple(
            source if counted else replace(source, counter=None) for source in sources if source is not first
        )
        unused = [signal.name for message, signal in counters if message.name not in {s.message.name for s in sources}]
        if unused:
            raise ConfigError(f"signals: counter {unused[0]} is in a message without a mapped channel; leave it out")
        return Layout(outputs[0], first, others, self._beat(), self._stamp(first, cycle_ms), cycle_ms)

    def _group(self, group: Mapping[str, tuple[Message, Signal]], counters: Sequence[tuple[Message, Signal]]) -> Source:
        name = next(iter(group.values()))[0].name
        message = self._messages[name]
        channels = {channel: converted(channel, message, signal) for channel, (_, signal) in group.items()}
        choice = next((signal for signal, _ in channels.values() if signal.choice is not None), None)
        counter = next((signal for where, signal in counters if where.name == name), None)
        return Source(message, channels, counter, States(message), choice)

    def _beat(self) -> Beat | None:
        found = {what: self._find(where, what) for what, where in self._map.beat.items()}
        messages = {message.name for message, _ in found.values()}
        if not found:
            return None
        if len(messages) > 1:
            raise ConfigError(f"signals: {', '.join(found)} must be in one message, they are in {', '.join(messages)}")
        message = self._messages[messages.pop()]
        return Beat(message, {what: signal for what, (_, signal) in found.items()}, States(message))

    def _stamp(self, first: Source, cycle_ms: float) -> tuple[Signal, float] | None:
        if self._map.time_stamp is None:
            return None
        message, signal = self._find(self._map.time_stamp, "time_stamp")
        if first.counter is not None or message.name != first.message.name:
            raise ConfigError(f"signals: a time stamp stands in for the counter of {first.message.name}, and in it")
        if not signal.unit or signal.is_float or signal.signed:
            text = f"is '{signal.unit}'; it must be an unsigned integer in one of {', '.join(USUAL['s'])}"
            raise ConfigError(f"signals: the unit of the time stamp {signal.name} {text}")
        step_s = signal.scale * conversion(signal.unit, "s", f"the time stamp {signal.name}").factor
        if step_s > 0.5e-3 * cycle_ms:
            text = f"steps by {step_s:g} s, too coarse for samples every {cycle_ms:g} ms; leave it out"
            raise ConfigError(f"signals: the time stamp {signal.name} {text}")
        return signal, step_s

    def _watch(self) -> None:
        """Give status signals the values with which samples are valid, or raw."""
        for said in self._map.status:
            where = said.get("signal", said)
            message, signal = self._find(where, "status")
            words = {key: str(said[name]) for key, name in ((VALID, "valid"), (RAW, "raw")) if name in said}
            if not words:
                raise ConfigError(f"signals: status {signal.name} needs `valid` or `raw`: the values that it may have")
            changed = replace(signal, attributes={**signal.attributes, **words})
            self._messages[message.name] = replace(message, signals={**message.signals, signal.name: changed})

    def _find(self, where: str | Described, what: str) -> tuple[Message, Signal]:
        if not isinstance(where, str):
            message = next(m for m in self._messages.values() if _is_described(m, where))
            return message, message.signals[f"bit{where['start']}"]
        *before, name = where.split(".")
        found = [
            message
            for message in self._messages.values()
            if name in message.signals and (not before or message.name == ".".join(before))
        ]
        if len(found) != 1:
            known = ", ".join(f"{m.name}.{s}" for m in self._messages.values() for s in m.signals) or "nothing"
            wrong = f"is in {len(found)} messages; write Message.Signal"
            wrong = wrong if found else f"is not in the DBC; it has {known}"
            raise ConfigError(f"signals: {what}: '{where}' {wrong}")
        return found[0], found[0].signals[name]


def _is_described(message: Message, where: Described) -> bool:
    extended = bool(where.get("extended", where["id"] > 0x7FF))
    return (message.id, message.extended) == (where["id"], extended) and f"bit{where['start']}" in message.signals
