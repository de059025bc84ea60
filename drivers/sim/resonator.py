"""Physics of one simulated gyro: converts its environment to signals; no I/O, no clock.

The case's temperature reaches the thermometer and the resonator through a linear network that is solved exactly for
an input linear over the step. The truth is a list of mechanisms (`drivers.sim.truth`); each adds its bias on nodes at
the slow channels' rate (50 Hz); the sum is interpolated linearly to the rate samples.
"""

from __future__ import annotations

import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from functools import lru_cache
from importlib import resources
from typing import Any

import numpy as np
import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from drivers.errors import ConfigError
from drivers.sim.truth import MECHANISMS, AnyMechanism, ThermalMechanism
from drivers.sim.truth.base import Contribution, FloatArray, Scene
from drivers.sim.truth.channels import Channels, ChannelSettings
from drivers.sim.truth.noise import NoiseSettings, RateNoise

DIVIDER = 10
"""Rate samples for one sample of the slow channels."""


class UnitSettings(BaseModel):
    """A simulated unit: its mechanisms, its noise and its channels, as in a station's YAML."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    truth: tuple[AnyMechanism, ...] = Field((), description="mechanisms that make the zero-rate output")
    noise: NoiseSettings = NoiseSettings()
    channels: ChannelSettings = ChannelSettings()
    clock_ppm: float = Field(0.0, gt=-1000.0, lt=1000.0, description="how much slower than nominal its clock is [ppm]")

    @classmethod
    def parse(cls, entry: Mapping[str, Any]) -> UnitSettings:
        """Settings from a mapping that was read from YAML.

        Raises ConfigError with one line that names every wrong entry and, for an unknown mechanism, the nearest one.
        """
        try:
            settings = cls.model_validate(entry)
        except ValidationError as error:
            raise ConfigError("; ".join(_explain(dict(item)) for item in error.errors())) from None
        thermal = [m.mechanism for m in settings.truth if m.kind == "thermal"]
        if len(thermal) > 1:
            raise ConfigError(f"truth: {' and '.join(thermal)} both set the resonator's temperature; keep one")
        return settings


def default_unit() -> UnitSettings:
    """The unit of the embedded station, from `default_unit.yaml` beside this module."""
    text = resources.files("drivers.sim").joinpath("default_unit.yaml").read_text(encoding="utf-8")
    return UnitSettings.parse(yaml.safe_load(text))


def _explain(item: dict[str, Any]) -> str:
    where = ".".join(str(part) for part in item["loc"])
    if item["type"] == "extra_forbidden":
        return f"{where}: unknown key"
    if item["type"] == "union_tag_not_found":
        return f"{where}: missing key mechanism; known: {', '.join(sorted(MECHANISMS))}"
    if item["type"] == "union_tag_invalid":
        tag = item["ctx"]["tag"]
        near = get_close_matches(tag, MECHANISMS, 1)
        hint = f"did you mean '{near[0]}'?" if near else f"known: {', '.join(sorted(MECHANISMS))}"
        return f"{where}: unknown mechanism '{tag}'; {hint}"
    return f"{where}: {item['msg']}, not {item['input']!r}"


@dataclass(frozen=True, slots=True)
class Environment:
    """Environment of the unit during one step; pairs are (start, end) and linear between.

    The applied rate may have more values, equally spaced from start to end.
    """

    t0_s: float
    samples: int
    fixture_temperature: tuple[float, float]
    """Temperature of the unit's case [degC]: the `case` of a plant's state."""
    air_temperature: tuple[float, float] = (25.0, 25.0)
    supply_v: float = 5.0
    compressor: float = 0.0
    heater: float = 0.0
    applied_rate_dps: Sequence[float] | FloatArray = (0.0, 0.0)
    humidity: float = 0.4
    powered: bool = True
    attitude: FloatArray | None = None
    """How the unit stands, (3, 3) from the table's frame; None: as always."""
    visit: int = 0
    """How often it was turned before."""
    rate_hz: float = 500.0


@dataclass(frozen=True, slots=True)
class Signals:
    """Output of the unit's electronics for one step, sampled from its start."""

    rate_dph: FloatArray
    """(n,) at 500 Hz."""
    temperature: FloatArray
    """(m,) degC, m = n / 10."""
    frequency: FloatArray
    """(m,) Hz."""
    drive: FloatArray
    """(m,) V."""
    quadrature: FloatArray
    """(m,) V."""
    supply: float
    """V, at the start of the step."""


@dataclass(frozen=True, slots=True)
class PowerOn:
    """A power-on of a simulated unit, as its record begins."""

    number: int = 1
    """Counted over the life of the unit."""
    on_s: float = 0.0
    """How long it has lasted already [s]."""
    seed: int | None = None
    """Of what is drawn once for each power-on; None: the seed of the record."""


class _Thermometry:
    """x' = A x + b T_case with the states: thermometer, those of the truth's thermal mechanism, resonator last."""

    def __init__(self, settings: UnitSettings) -> None:
        inner = next((m.network() for m in settings.truth if isinstance(m, ThermalMechanism)), None)
        a, b = inner or (np.empty((0, 0)), np.empty(0))
        rate = 1.0 / settings.channels.thermometer.tau_s
        self._a = np.block([[np.array([[-rate]]), np.zeros((1, len(b)))], [b[:, None], a]])
        self._delay = np.linalg.solve(self._a, np.ones(len(self._a)))
        self._state: FloatArray | None = None
        self._tables: dict[tuple[int, float], FloatArray] = {}

    def __call__(self, case: FloatArray, node_s: float) -> FloatArray:
        """Temperatures [degC] of all states at the nodes, shape `(m + 1, states)`."""
        n = len(case) - 1
        delay = self._delay * ((case[-1] - case[0]) / (n * node_s))
        start = np.full(len(delay), case[0]) if self._state is None else self._state
        transient = self._table(n, node_s) @ (start - case[0] - delay)
        paths: FloatArray = case[:, None] + delay + transient
        self._state = paths[-1]
        return paths

    def _table(self, n: int, node_s: float) -> FloatArray:
        if (n, node_s) not in self._tables:
            from scipy.linalg import expm  # 0.1 s of imports, which `bench check` does without

            step = expm(self._a * node_s)
            self._tables[n, node_s] = np.stack([np.linalg.matrix_power(step, j) for j in range(n + 1)])
        return self._tables[n, node_s]


class Resonator:
    """One unit; deterministic by seed, independent of the lengths of its steps."""

    def __init__(self, settings: UnitSettings, seed: int, rate_hz: float = 500.0, power: PowerOn | None = None) -> None:
        """`power`: the power-on that lasts when the record begins; left out: the unit's first, at that moment."""
        self.settings = settings
        self._seed, self._first = seed, power or PowerOn()
        self.power_on = self._first.number
        """Number of the newest power-on."""
        self._lost_power = False
        self._rate_hz = rate_hz
        self._node_s = DIVIDER / rate_hz
        self._thermometry = _Thermometry(settings)
        self._channels = Channels(settings.channels, self._node_s, [self._rng(f"channel {i}") for i in range(5)])
        self._noise = RateNoise(settings.noise, self._node_s, [self._rng(f"noise {i}") for i in range(3)])
        self._labels = _labels([m.mechanism for m in settings.truth])
        self._static = [(k, m.bias) for k, m in self._named("static")]
        self._thermal = [k for k, _ in self._named("thermal")]
        self._dynamic: list[tuple[str, Contribution]] = [
            (k, m.start(self._node_s, self._rng(k, lifelong=m.lifelong))) for k, m in self._named("bias")
        ]
        self._on_s = self._first.on_s
        self._last_step: tuple[Scene, list[FloatArray], list[FloatArray]] | None = None

    def advance(self, environment: Environment) -> Signals:
        """Advance by one step and return its signals; `samples` must be a multiple of 10."""
        if environment.samples % DIVIDER or environment.samples <= 0 or environment.rate_hz != self._rate_hz:
            raise ValueError(f"a step needs a multiple of {DIVIDER} samples at {self._rate_hz:g} Hz: {environment}")
        scene = self._scene(environment)
        self._channels.fill(scene)
        static = [bias(scene.resonator) for _, bias in self._static]
        dynamic = [contribute(scene) for _, contribute in self._dynamic]
        self._last_step = scene, static, dynamic
        slow = self._noise.slow(len(scene.time))
        for part in (*static, *dynamic):
            slow = slow + part
        slow += 3600.0 * scene.applied_rate
        rate = np.interp(*_straight(environment.samples), slow)
        rate += self._noise.white(environment.samples, self._rate_hz)
        return Signals(rate, *self._channels.read(scene), supply=float(scene.supply[0]))

    @property
    def contributions(self) -> dict[str, float]:
        """Contribution of each mechanism to the rate, mean over the last step [deg/h].

        The contribution of a thermal mechanism is the difference of the static ones between the resonator's and the
        thermometer's temperature.
        """
        # Mean over the samples of the straight lines between nodes.
        late = 0.5 - 0.5 / DIVIDER
        return {k: float(p[:-1].mean() * (1.0 - late) + p[1:].mean() * late) for k, p in self._parts().items()}

    def _scene(self, environment: Environment) -> Scene:
        n = environment.samples // DIVIDER
        share, elapsed = _grid(n, self._node_s)
        case, air = (
            first + (last - first) * share
            for first, last in (environment.fixture_temperature, environment.air_temperature)
        )
        turned = np.asarray(environment.applied_rate_dps, dtype=np.float64)
        applied = np.interp(share, np.linspace(0.0, 1.0, len(turned)), turned) if turned.any() else np.zeros(n + 1)
        paths = self._thermometry(case, self._node_s)
        on = self._on_s + elapsed if environment.powered else np.zeros(n + 1)
        if environment.powered and self._lost_power:
            self.power_on += 1
        self._lost_power = not environment.powered and (self._lost_power or self._on_s > 0.0)
        self._on_s = float(on[-1])
        return Scene(
            time=environment.t0_s + elapsed,
            on=on,
            node_s=self._node_s,
            case=case,
            sensor=paths[:, 0],
            resonator=paths[:, -1],
            air=air,
            applied_rate=applied,
            supply=self._channels.supply(environment.supply_v, environment.compressor, n + 1, self._node_s),
            compressor=environment.compressor,
            heater=environment.heater,
            humidity=environment.humidity,
            powered=environment.powered,
            power_on=self.power_on,
        )

    def _parts(self) -> dict[str, FloatArray]:
        """Contribution of each mechanism at the nodes of the last step [deg/h]."""
        if self._last_step is None:
            return {}
        scene, static, dynamic = self._last_step
        parts = {k: part for (k, _), part in zip(self._dynamic, dynamic, strict=True)}
        lagging = np.zeros(len(scene.time))
        for (k, bias), part in zip(self._static, static, strict=True):
            parts[k] = bias(scene.sensor) if self._thermal else part
            lagging = lagging + (part - parts[k])
        for k in self._thermal:
            parts[k] = lagging
        return parts

    def _named(self, kind: str) -> list[tuple[str, Any]]:
        return [(k, m) for k, m in zip(self._labels, self.settings.truth, strict=True) if m.kind == kind]

    def _rng(self, purpose: str, *, lifelong: bool = False) -> np.random.Generator:
        """A separate random stream for each purpose, so that adding a mechanism does not change the others.

        A run that begins with a later power-on than the first draws from streams of its own, so that no two runs of a
        unit share their noise.
        """
        name = zlib.crc32(purpose.encode())
        if lifelong:
            return np.random.default_rng([self._seed if self._first.seed is None else self._first.seed, name])
        return np.random.default_rng([self._seed, name, *([self._first.number] * (self._first.number > 1))])


@lru_cache(maxsize=16)
def _grid(n: int, node_s: float) -> tuple[FloatArray, FloatArray]:
    """Elapsed share of a step of `n` nodes at each node, and the time [s], (n + 1,); cached, so read only."""
    return _read_only(np.arange(n + 1) / n), _read_only(node_s * np.arange(n + 1, dtype=np.float64))


@lru_cache(maxsize=16)
def _straight(samples: int) -> tuple[FloatArray, FloatArray]:
    """Positions of the samples (n,) and of the nodes (m + 1,) of a step, in nodes; cached, so read only."""
    nodes = np.arange(samples // DIVIDER + 1, dtype=np.float64)
    return _read_only(np.arange(samples, dtype=np.float64) * (1.0 / DIVIDER)), _read_only(nodes)


def _read_only(table: FloatArray) -> FloatArray:
    table.setflags(write=False)
    return table


def _labels(names: list[str]) -> list[str]:
    """Unique names: the second mechanism of a kind gets #2."""
    return [n if names[:i].count(n) == 0 else f"{n}#{names[:i].count(n) + 1}" for i, n in enumerate(names)]
