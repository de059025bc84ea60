"""Operators with memory that effects are made of: pure functions of a whole record, never of selected rows.

All take rows at any spacing. A gap (NaN) stays a gap and is bridged by a straight line over the real time between its
neighbours.
"""

from __future__ import annotations

from collections.abc import Callable
from math import exp, expm1, log1p

import numpy as np
import scipy

from bench.base import FloatArray

_LEAST_WINDOW_S = 60.0


def ramp_invariant_lag(time_s: FloatArray, value: FloatArray, tau_s: float | FloatArray) -> FloatArray:
    """First-order lag x' = (u - x) / tau of a record (n,) that is straight between its samples; starts settled.

    Exact for ramps at any sampling (first-order hold), where holding each sample would add half a sample to tau.
    With tau = 0 the record itself is returned. A `tau_s` (n,) may change; between two rows their mean holds.
    """
    if np.ndim(tau_s) == 0:
        return _bridged(lambda time, u: _lag(time, u, np.full(len(time), tau_s)), time_s, value)
    tau = np.asarray(tau_s)
    known = np.isfinite(tau)
    return _bridged(lambda time, u: _lag(time, u, np.interp(time, time_s[known], tau[known])), time_s, value)


def play(value: FloatArray, half_width: float | FloatArray) -> FloatArray:
    """Play (backlash) of a record (n,): follows what moves further than `half_width` from it; starts on it.

    z_k = min(max(z_{k-1}, u_k - r), u_k + r). M. A. Krasnosel'skii, A. V. Pokrovskii, Systems with Hysteresis (1989).
    `half_width` is one number, or one for each row (n,).
    """
    return _bridged(lambda r, u: _play(u, r), np.broadcast_to(half_width, value.shape), value)


def slew(time_s: FloatArray, value: FloatArray, per_min: float) -> FloatArray:
    """What follows a record (n,) no faster than `per_min` [its unit per minute]; starts on it."""
    return _bridged(lambda time, u: _slew(time, u, abs(per_min) / 60.0), time_s, value)


def uneven_lag(time_s: FloatArray, value: FloatArray, rise_s: float, fall_s: float) -> FloatArray:
    """First-order lag of a record (n,) with the time constant `rise_s` while the record is above it, else `fall_s`.

    The record is straight between its rows, for which this is exact; starts settled.
    """
    return _bridged(lambda time, u: _uneven_lag(time, u, max(rise_s, 1e-6), max(fall_s, 1e-6)), time_s, value)


def latch(value: FloatArray, high: float, low: float) -> FloatArray:
    """Relay with hysteresis of a record (n,): 1 from where it rises above `high` until it falls below `low`, else 0.

    Between the two it keeps its state; a record that starts there starts on the side that is nearer. `low` above `high`
    is taken as the other way round. I. D. Mayergoyz, Mathematical Models of Hysteresis (1991).
    """
    high, low = max(high, low), min(high, low)

    def relay(_: FloatArray, u: FloatArray) -> FloatArray:
        settled = (u > high) | (u < low)
        settled[:1] = True
        last = np.maximum.accumulate(np.where(settled, np.arange(len(u)), 0))
        return np.asarray(u[last] > 0.5 * (high + low), dtype=np.float64)

    return _bridged(relay, value, value)


def bouc_wen(value: FloatArray, length: float) -> FloatArray:
    """Smooth loop z (n,) within [-1, 1] of a record: L dz/du = 1 - |z| while |z| grows, 1 while it falls; starts at 0.

    Y.-K. Wen, J. Eng. Mech. Div. ASCE 102 (1976) 249, with exponent 1 and beta = gamma, where each monotonic piece has
    a closed form: a straight line back to zero, then 1 - |z| falls by exp(-|du| / L).
    """
    return _bridged(lambda _, u: _bouc_wen(u, length), value, value)


def slope(time_s: FloatArray, value: FloatArray, window_s: float) -> FloatArray:
    """Central slope (n,) [per s] over `window_s`, shorter at the two ends of the record."""

    def central(time: FloatArray, u: FloatArray) -> FloatArray:
        if len(u) < 2:
            return np.zeros(len(u))
        half = max(window_s / 2.0, float(np.median(np.diff(time))))
        before, after = np.maximum(time - half, time[0]), np.minimum(time + half, time[-1])
        steep: FloatArray = (np.interp(after, time, u) - np.interp(before, time, u)) / (after - before)
        return steep

    return _bridged(central, time_s, value)


def lead(time_s: FloatArray, value: FloatArray, tau_s: float) -> FloatArray:
    """What a first-order lag of `tau_s` must have followed to give this record (n,): u = x + tau dx/dt.

    The slope is central over a minute, or half of tau: what came through such a lag has no finer detail, only noise.
    """
    return np.asarray(value + tau_s * slope(time_s, value, max(_LEAST_WINDOW_S, 0.5 * tau_s)))


def shifted(time_s: FloatArray, value: FloatArray, delay_s: float) -> FloatArray:
    """The record (n,) `delay_s` later, u(t - d), or earlier where that is negative; beyond its ends their value."""
    return _bridged(lambda time, u: np.asarray(np.interp(time - delay_s, time, u)), time_s, value)


def integral(time_s: FloatArray, value: FloatArray) -> FloatArray:
    """Integral (n,) of a record over time [its unit times s] since its first row, by the trapezoidal rule."""
    return _bridged(
        lambda time, u: np.concatenate([[0.0], np.cumsum(0.5 * (u[1:] + u[:-1]) * np.diff(time))]), time_s, value
    )


def extreme(time_s: FloatArray, value: FloatArray, *, highest: bool) -> FloatArray:
    """The highest, or else the lowest, value (n,) of a record (n,) up to each row."""
    running = np.maximum.accumulate if highest else np.minimum.accumulate
    return _bridged(lambda _, u: np.asarray(running(u)), time_s, value)


def _bridged(
    operator: Callable[[FloatArray, FloatArray], FloatArray], time_s: FloatArray, value: FloatArray
) -> FloatArray:
    """The operator over the rows that have a value."""
    present = np.isfinite(value)
    if present.all():
        return operator(time_s, value)
    out = np.full(len(value), np.nan)
    if present.any():
        out[present] = operator(time_s[present], value[present])
    return out


def _lag(time_s: FloatArray, value: FloatArray, tau_s: FloatArray) -> FloatArray:
    """The lag (n,) with a time constant (n,) [s]."""
    if len(value) < 2 or not np.any(tau_s > 0.0):
        return np.asarray(value + 0.0 * tau_s)  # no number, where the time constant is none
    step_s, step = np.diff(time_s), np.diff(value)
    tau = np.maximum(0.5 * (tau_s[1:] + tau_s[:-1]), 1e-6 * step_s)
    decay = np.exp(-step_s / tau)
    # behind = x - u obeys behind' = decay * behind - slope * tau * (1 - decay)
    drive = step / step_s * tau * np.expm1(-step_s / tau)
    band = np.ones((2, len(drive)))  # the recursion is a triangular system of two diagonals
    band[1, :-1] = -decay[1:]
    behind = scipy.linalg.lapack.dtbtrs(band, drive[:, None], uplo="L", diag="U")[0][:, 0]
    lagged: FloatArray = value + np.concatenate([[0.0], behind])
    return lagged


def _play(value: FloatArray, half_width: FloatArray) -> FloatArray:
    # A row clips the state to its own band, and two clips are one: bands of the last 1, 2, 4 … rows by doubling.
    low, high, reach = value - half_width, value + half_width, 1
    low[:1] = high[:1] = value[:1]
    while reach < len(value):
        within = [np.minimum(np.maximum(end[:-reach], low[reach:]), high[reach:]) for end in (low, high)]
        low[reach:], high[reach:] = within
        reach *= 2
    return low


def _slew(time_s: FloatArray, value: FloatArray, per_s: float) -> FloatArray:
    followed = value.copy()
    at = float(value[0])
    for row, (wanted, step) in enumerate(zip(value[1:].tolist(), (np.diff(time_s) * per_s).tolist(), strict=True), 1):
        followed[row] = at = min(max(wanted, at - step), at + step)
    return followed


def _uneven_lag(time_s: FloatArray, value: FloatArray, rise_s: float, fall_s: float) -> FloatArray:
    lagged, ahead = value.copy(), 0.0  # ahead = x - u obeys ahead' = -ahead / tau - slope
    steps = np.diff(time_s)
    for row, (step, steep) in enumerate(zip(steps.tolist(), (np.diff(value) / steps).tolist(), strict=True), 1):
        above = ahead > 0.0 or (ahead == 0.0 and steep < 0.0)
        tau = fall_s if above else rise_s
        end = (ahead + steep * tau) * exp(-step / tau) - steep * tau
        if ahead * end < 0.0:  # it meets the record on the way, and goes on with the other time constant
            rest = step - tau * log1p(ahead / (steep * tau))
            tau = rise_s if above else fall_s
            end = steep * tau * expm1(-rest / tau)
        ahead = end
        lagged[row] += ahead
    return lagged


def _bouc_wen(value: FloatArray, length: float) -> FloatArray:
    loop = np.zeros(len(value))
    state = 0.0
    moves = np.diff(value) / length
    fades = np.exp(-np.abs(moves))
    for row, (move, fade) in enumerate(zip(moves.tolist(), fades.tolist(), strict=True), start=1):
        sign = 1.0 if move > 0.0 else -1.0
        back = -sign * state  # how far it has to fall before it grows again
        if back <= 0.0:
            state = sign * (1.0 - (1.0 + back) * fade)
        elif abs(move) <= back:
            state += move
        else:
            state = sign * (1.0 - float(np.exp(back - abs(move))))
        loop[row] = state
    return loop
