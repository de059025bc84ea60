"""Operators with memory that effects are made of: pure functions of a whole record, never of selected rows."""

from __future__ import annotations

import numpy as np
from scipy.signal import lfilter

from bench.channels import FloatArray


def ramp_invariant_lag(time_s: FloatArray, value: FloatArray, tau_s: float) -> FloatArray:
    """First-order lag x' = (u - x) / tau of a record (n,) that is straight between its samples; starts settled.

    Exact for ramps at any sampling (first-order hold), where holding each sample would add half a sample to tau.
    The rows may be unevenly spaced. With tau = 0 the record itself is returned.
    """
    if tau_s <= 0.0 or len(value) < 2:
        return value.copy()
    step_s, step = np.diff(time_s), np.diff(value)
    decay = np.exp(-step_s / tau_s)
    # behind = x - u obeys behind' = decay * behind - slope * tau * (1 - decay)
    drive = step / step_s * tau_s * np.expm1(-step_s / tau_s)
    if np.ptp(step_s) <= 1e-9 * step_s[0]:
        behind = lfilter([1.0], [1.0, -decay[0]], drive)
    else:
        behind = np.empty_like(drive)
        last = 0.0
        for row, (fade, push) in enumerate(zip(decay.tolist(), drive.tolist(), strict=True)):
            last = fade * last + push
            behind[row] = last
    lagged: FloatArray = value + np.concatenate([[0.0], behind])
    return lagged


def play(value: FloatArray, half_width: float) -> FloatArray:
    """Play (backlash) of a record (n,): follows what moves further than `half_width` from it; starts on it.

    z_k = min(max(z_{k-1}, u_k - r), u_k + r). M. A. Krasnosel'skii, A. V. Pokrovskii, Systems with Hysteresis (1989).
    """
    followed = np.empty(len(value))
    state = float(value[0]) if len(value) else 0.0
    for row, now in enumerate(value.tolist()):
        if state < now - half_width:
            state = now - half_width
        elif state > now + half_width:
            state = now + half_width
        followed[row] = state
    return followed
