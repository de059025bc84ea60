"""Operators with memory that effects are made of: pure functions of a whole record, never of selected rows.

All take rows at any spacing. A gap (NaN) stays a gap and is bridged by a straight line over the real time between its
neighbours.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy

from bench.base import FloatArray

_LEAST_WINDOW_S = 60.0


def ramp_invariant_lag(time_s: FloatArray, value: FloatArray, tau_s: float) -> FloatArray:
    """First-order lag x' = (u - x) / tau of a record (n,) that is straight between its samples; starts settled.

    Exact for ramps at any sampling (first-order hold), where holding each sample would add half a sample to tau.
    With tau = 0 the record itself is returned.
    """
    return _bridged(lambda time, u: _lag(time, u, tau_s), time_s, value)


def play(value: FloatArray, half_width: float) -> FloatArray:
    """Play (backlash) of a record (n,): follows what moves further than `half_width` from it; starts on it.

    z_k = min(max(z_{k-1}, u_k - r), u_k + r). M. A. Krasnosel'skii, A. V. Pokrovskii, Systems with Hysteresis (1989).
    """
    return _bridged(lambda _, u: _play(u, half_width), value, value)


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


def _lag(time_s: FloatArray, value: FloatArray, tau_s: float) -> FloatArray:
    if tau_s <= 0.0 or len(value) < 2:
        return value.copy()
    step_s, step = np.diff(time_s), np.diff(value)
    decay = np.exp(-step_s / tau_s)
    # behind = x - u obeys behind' = decay * behind - slope * tau * (1 - decay)
    drive = step / step_s * tau_s * np.expm1(-step_s / tau_s)
    if np.ptp(step_s) <= 1e-9 * step_s[0]:
        behind = scipy.signal.lfilter([1.0], [1.0, -decay[0]], drive)
    else:
        behind = np.empty_like(drive)
        last = 0.0
        for row, (fade, push) in enumerate(zip(decay.tolist(), drive.tolist(), strict=True)):
            last = fade * last + push
            behind[row] = last
    lagged: FloatArray = value + np.concatenate([[0.0], behind])
    return lagged


def _play(value: FloatArray, half_width: float) -> FloatArray:
    followed = np.empty(len(value))
    state = float(value[0]) if len(value) else 0.0
    for row, now in enumerate(value.tolist()):
        if state < now - half_width:
            state = now - half_width
        elif state > now + half_width:
            state = now + half_width
        followed[row] = state
    return followed


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
