"""Which signals of which messages make up a unit: by the names that the bench knows, or by a mapping.

A unit has outputs (`rate`, or `rate_x` … `acceleration_z`), and may have thermometers, further channels, a counter or a
time stamp, status signals and a heartbeat. The message of the first output gives the samples; every other source of
channels is placed beside them: by a counter, which repeats the low bits of the first one, or by its time of arrival.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeVar

from drivers.errors import ConfigError
from drivers.framing import Framing
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

_UNKNOWN = "is not in the DBC"
_Made = TypeVar("_Made")
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

    def lacks(self, framing: Framing | None = None) -> Iterator[str]:
        """What the unit does not say, and what is lost by it; `framing` is that of its line, None on CAN."""
        if self.first.counter is None and self.stamp is None:
            yield (
                "no counter and no time stamp: samples are counted by their cycle time, and a frame that is lost while "
                "the computer is late may be taken for one that came late"
            )
            if framing is not None and framing.kind == "datagram":
                yield "no counter and no time stamp: a datagram that the network repeats or delays counts as a sample"
        if framing is None and CRC not in self.first.message.signals:
            yield "no CRC: a frame that is altered behind the CAN controller is not noticed"
        if framing is not None and framing.crc is None:
            yield "no CRC and no sum: a packet that is altered on its way is not noticed"
        if self.beat is None or "serial" not in self.beat.signals:
            yield "no serial number: another unit in the place of this one is not noticed"
        if self.beat is None or "state" not in self.beat.signals:
            yield "no state in a heartbeat: a unit that starts anew within 50 ms is not noticed"
        thermometers = {name: one.scale for name, (one, _) in self.channels.items() if THERMOMETERS.fullmatch(name)}
        for name in [name for name, scale in thermometers.items() if scale < 0]:
            yield f"scale of {name} is {thermometers[name]:g}: it falls as its number rises; compare with the chamber"
        if not thermometers:
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
        return _Mapped(SignalMap.of(_usual(load_dbc(dbc), dbc)), dbc, f"DBC {dbc}").layout()
    return _Mapped(SignalMap.of(signals), dbc, "signals").layout()


def converted(channel: str, message: Message, signal: Signal) -> tuple[Signal, float]:
    """The signal, and the factor from its unit to that of the channel; ConfigError for a unit of something else.

    An offset between the units, of temperatures, becomes part of the signal's own.
    """
    try:
        if not signal.unit:
            raise ConfigError("state it in the DBC, or as `unit` in `signals`")
        found = conversion(signal.unit, _KEPT["temperature" if THERMOMETERS.fullmatch(channel) else channel], channel)
    except ConfigError as error:
        raise ConfigError(f"{channel}: {message.name}.{signal.name} has the unit '{signal.unit}': {error}") from None
    if signal.scale == 0:
        raise ConfigError(f"{channel}: {message.name}.{signal.name} has the scale 0: every value would be the offset")
    if not found.offset:
        return signal, found.factor
    shift = found.offset / found.factor
    bounds = None if signal.bounds is None else (signal.bounds[0] + shift, signal.bounds[1] + shift)
    return replace(signal, offset=signal.offset + shift, bounds=bounds), found.factor


def _usual(messages: Mapping[str, Message], dbc: str | Path) -> dict[str, Any]:
    """The mapping of a DBC with the names that the bench knows; ConfigError where it has no rate, or not just one."""
    rates = [message for message in messages.values() if _USUAL["rate"] in message.signals]
    rates = [message for message in rates if COUNTER in message.signals] or rates
    if len(rates) != 1:
        text = f"{len(rates)} messages with {_USUAL['rate']}, must be exactly one"
        raise ConfigError(f"DBC {dbc}: {text}; or `signals` of the unit in the station file say what is what")
    rate = rates[0]
    others = [message for message in messages.values() if message is not rate]
    found: dict[str, Any] = {"rate": f"{rate.name}.{_USUAL['rate']}"}
    counters = {rate.name: f"{rate.name}.{COUNTER}"} if COUNTER in rate.signals else {}
    for message in sorted(others, key=lambda message: SLOW_COUNTER not in message.signals):
        own = {channel: name for channel, name in _USUAL.items() if name in message.signals and channel not in found}
        found |= {channel: f"{message.name}.{name}" for channel, name in own.items()}
        if own and counters and SLOW_COUNTER in message.signals:
            counters[message.name] = f"{message.name}.{SLOW_COUNTER}"
    beats = [message for message in others if {"Serial", "State"} & set(message.signals)]
    for beat in sorted(beats, key=lambda message: "Serial" not in message.signals)[:1]:
        found |= {what: f"{beat.name}.{name}" for what, name in _USUAL_BEAT.items() if name in beat.signals}
    return {**found, "counter": [*counters.values()]}


class _Mapped:
    """Finds the signals of a mapping, which is written in `place`."""

    def __init__(self, signals: SignalMap, dbc: str | Path | None, place: str) -> None:
        self._map, self._place = signals, place
        self._wrong: list[str] = []
        given = [*signals.channels.values(), *signals.counters, *signals.beat.values(), *signals.status]
        given += [signals.time_stamp] if signals.time_stamp is not None else []
        bits = [one for one in given if not isinstance(one, str) and "id" in one]
        self._messages = {} if dbc is None or len(bits) == len(given) else load_dbc(dbc)
        self._messages = {**self._messages, **described(bits)}

    def layout(self) -> Layout:
        """All of it; ConfigError with everything that is wrong."""
        outputs = [name for name in OUTPUTS if name in self._map.channels]
        if not outputs:
            raise ConfigError(f"{self._place}: no output; map at least one of {', '.join(OUTPUTS)}")
        self._watch()
        places = {name: found for name, where in self._map.channels.items() if (found := self._find(where, name))}
        counters = [found for where in self._map.counters if (found := self._find(where, "counter"))]
        self._each_once([*places.items(), *(("counter", found) for found in counters)])
        for message, signal in counters:
            if signal.is_float or signal.signed:
                self._wrong.append(f"counter: {message.name}.{signal.name} must be an unsigned integer")
        groups: dict[tuple[str, object], dict[str, tuple[Signal, float]]] = {}
        for name, (message, signal) in places.items():
            if got := self._tried(lambda name=name, m=message, s=signal: converted(name, m, s)):  # type: ignore[misc]
                groups.setdefault((message.name, signal.choice), {})[name] = got
        for key in [key for key, group in groups.items() if outputs[0] in group and key[1] is not None]:
            # What every frame of its message carries is taken from those of the first output: once a sample.
            groups[key] |= groups.pop((key[0], None), {})
        sources = [self._source(name, group, counters) for (name, _), group in groups.items()]
        used = {source.message.name for source in sources}
        unused = [signal.name for message, signal in counters if message.name not in used]
        if unused and len(places) == len(self._map.channels):
            self._wrong.append(f"counter {unused[0]} is in a message without a mapped channel; leave it out")
        first = next((source for source in sources if outputs[0] in source.channels), None)
        cycle_ms = self._map.cycle_ms or (first.message.cycle_ms if first else None)
        if first is not None and cycle_ms is None:
            self._wrong.append(f"{first.message.name} has no cycle time; state `cycle_ms` [ms] in `signals`")
        beat = self._tried(self._beat)
        stamp = self._tried(lambda: self._stamp(first, cycle_ms)) if first is not None and cycle_ms else None
        if self._wrong or first is None or cycle_ms is None:
            raise ConfigError(self._all_wrong())
        counted = first.counter is not None and stamp is None
        placed = [source if counted else replace(source, counter=None) for source in sources]
        at = sources.index(first)
        return Layout(outputs[0], placed.pop(at), tuple(placed), beat, stamp, cycle_ms)

    def _tried(self, make: Callable[[], _Made]) -> _Made | None:
        """What it makes; None, and what is wrong with it kept, where it cannot."""
        try:
            return make()
        except ConfigError as error:
            self._wrong.append(str(error))
            return None

    def _each_once(self, places: Sequence[tuple[str, tuple[Message, Signal]]]) -> None:
        """No two things that a unit sends are the same signal."""
        seen: dict[tuple[str, str], str] = {}
        for what, (message, signal) in places:
            if (other := seen.setdefault((message.name, signal.name), what)) != what:
                self._wrong.append(f"{other} and {what} are the same signal, {message.name}.{signal.name}")

    def _source(
        self, name: str, channels: Mapping[str, tuple[Signal, float]], counters: Sequence[tuple[Message, Signal]]
    ) -> Source:
        message = self._messages[name]
        choice = next((signal for signal, _ in channels.values() if signal.choice is not None), None)
        counter = next((signal for where, signal in counters if where.name == name), None)
        return Source(message, channels, counter, States(message), choice)

    def _beat(self) -> Beat | None:
        found = {what: place for what, where in self._map.beat.items() if (place := self._find(where, what))}
        messages = {message.name for message, _ in found.values()}
        if not found:
            return None
        if len(messages) > 1:
            raise ConfigError(f"{', '.join(found)} must be in one message, they are in {', '.join(messages)}")
        message = self._messages[messages.pop()]
        return Beat(message, {what: signal for what, (_, signal) in found.items()}, States(message))

    def _stamp(self, first: Source, cycle_ms: float) -> tuple[Signal, float] | None:
        found = None if self._map.time_stamp is None else self._find(self._map.time_stamp, "time_stamp")
        if found is None:
            return None if first.counter is None or first.counter.scale == 1 else _stepping(first.counter, cycle_ms)
        message, signal = found
        if first.counter is not None or message.name != first.message.name:
            raise ConfigError(f"a time stamp stands in for the counter of {first.message.name}, and in it")
        if not signal.unit or signal.is_float or signal.signed:
            text = f"is '{signal.unit}'; it must be an unsigned integer in one of {', '.join(USUAL['s'])}"
            raise ConfigError(f"the unit of the time stamp {signal.name} {text}")
        step_s = signal.scale * conversion(signal.unit, "s", f"the time stamp {signal.name}").factor
        if step_s > 0.5e-3 * cycle_ms:
            text = f"steps by {step_s:g} s, too coarse for samples every {cycle_ms:g} ms; leave it out"
            raise ConfigError(f"the time stamp {signal.name} {text}")
        return signal, step_s

    def _watch(self) -> None:
        """Give status signals the values with which samples are valid, or raw."""
        for said in self._map.status:
            found = self._find(said.get("signal", said), "status")
            if found is None:
                continue
            message, signal = found
            words = {key: str(said[name]) for key, name in ((VALID, "valid"), (RAW, "raw")) if name in said}
            if not words:
                self._wrong.append(f"status {signal.name} needs `valid` or `raw`: the values that it may have")
            changed = replace(signal, attributes={**signal.attributes, **words})
            self._messages[message.name] = replace(message, signals={**message.signals, signal.name: changed})

    def _find(self, where: str | Described, what: str) -> tuple[Message, Signal] | None:
        """Message and signal; None, and what is wrong kept, where there is none or more than one."""
        if not isinstance(where, str):
            message = next(m for m in self._messages.values() if _is_described(m, where))
            return message, message.signals[f"bit{where['start']}"]
        *before, name = where.split(".")
        found = [
            message
            for message in self._messages.values()
            if name in message.signals and (not before or message.name == ".".join(before))
        ]
        if len(found) == 1:
            return found[0], found[0].signals[name]
        text = f"is in {len(found)} messages; write Message.Signal" if found else _UNKNOWN
        self._wrong.append(f"{what}: '{where}' {text}")
        return None

    def _all_wrong(self) -> str:
        text = "; ".join(dict.fromkeys(self._wrong))
        if _UNKNOWN in text:
            known = ", ".join(
                f"{message.name}.{name}" for message in self._messages.values() for name in message.signals
            )
            text += f"; it has {known or 'nothing'}"
        return f"{self._place}: {text}"


def _stepping(counter: Signal, cycle_ms: float) -> tuple[Signal, float]:
    """A counter that grows by more than 1 from one sample to the next, as a time stamp."""
    if not 0 < counter.scale < 1 or counter.offset:
        text = f"{counter.name} has the scale {counter.scale:g} and the offset {counter.offset:g}; "
        text += "one that grows by 2 a sample has the scale 0.5, one that grows by 1 has 1, and none has an offset"
        raise ConfigError(f"counter: {text}")
    return counter, 1e-3 * cycle_ms * counter.scale


def _is_described(message: Message, where: Described) -> bool:
    extended = bool(where.get("extended", where["id"] > 0x7FF))
    return (message.id, message.extended) == (where["id"], extended) and f"bit{where['start']}" in message.signals
