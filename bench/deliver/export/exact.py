"""The delivered model in double precision: the reference for the errors of every embedded form."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from bench.base import FloatArray, IntArray
from bench.deliver.export.chebyshev import evaluate_surface
from bench.deliver.export.delivery import INPUTS, ONE, Block, Delivery, Kind, Shape, Signal

Counts = Mapping[int, IntArray]
"""Counts (n,) by channel id."""


def correction(delivery: Delivery, counts: Counts, *, settled: bool = False) -> FloatArray:
    """Correction (n,) [output unit] of samples in time, or of points each taken as a first sample (`settled`)."""
    return corrections(delivery, signals(delivery, counts, settled=settled))


def corrected(delivery: Delivery, counts: Counts, *, settled: bool = False) -> FloatArray:
    """Corrected output (n,) [output unit]."""
    raw = counts[INPUTS["rate" if delivery.output == 0 else "acceleration"].id]
    return delivery.gain * raw - correction(delivery, counts, settled=settled)


def signals(delivery: Delivery, counts: Counts, *, settled: bool = False) -> FloatArray:
    """Place of each sample within its box, z (S, n) from -1 to 1."""
    z: list[FloatArray] = []
    for signal in delivery.signals:
        raw = counts[signal.source].astype(np.float64) if signal.kind is Kind.CHANNEL else _derived(signal, z, settled)
        half = 0.5 * (signal.high - signal.low)
        z.append((np.clip(raw, signal.low, signal.high) - 0.5 * (signal.high + signal.low)) / half)
    return np.array(z)


def _derived(signal: Signal, z: list[FloatArray], settled: bool) -> FloatArray:
    source = z[signal.source]
    if signal.kind is Kind.PARABOLA:
        p0, p1, p2 = signal.p
        return p0 + p1 * source + p2 * (2.0 * source**2 - 1.0)
    if signal.kind is Kind.PLAY:
        return np.zeros(source.size) if settled else ONE * _play(source, signal.p[0] / ONE)
    behind = np.zeros(source.size) if settled else _behind(source, signal)
    return ONE * (behind if signal.kind is Kind.BEHIND else source + behind)


def _play(source: FloatArray, width: float) -> FloatArray:
    out, at = np.empty(source.size), float(source[0])
    for row, now in enumerate(source.tolist()):
        at = min(max(at, now - width), now + width)
        out[row] = now - at
    return out


def _behind(source: FloatArray, signal: Signal) -> FloatArray:
    fade, push = signal.p[0] * 2.0 ** -signal.p[1], signal.p[2] / ONE
    out, behind, last = np.empty(source.size), 0.0, float(source[0])
    for row, now in enumerate(source.tolist()):
        behind, last = behind - behind * fade + (now - last) * push, now
        out[row] = behind
    return out


def corrections(delivery: Delivery, z: FloatArray) -> FloatArray:
    """Sum of the blocks (n,) [output unit] at signals (S, n)."""
    total = np.zeros(z.shape[1])
    for block in delivery.blocks:
        total += value_of(block, z)
    return total


def value_of(block: Block, z: FloatArray) -> FloatArray:
    """One block (n,) [output unit] at signals (S, n)."""
    if block.shape is Shape.SURFACE:
        return evaluate_surface(block.coefficients, z[block.a], z[block.b])
    if block.shape is Shape.SERIES:
        value: FloatArray = np.polynomial.chebyshev.chebval(z[block.a], block.coefficients)
        return value
    w = 0.5 * (z[block.a] + 1.0) * block.n
    piece = np.minimum(w.astype(np.int64), block.n - 1)
    table = np.polynomial.chebyshev.chebvander(2.0 * (w - piece) - 1.0, 3)
    pieces: FloatArray = np.sum(block.coefficients.reshape(-1, 4)[piece] * table, axis=1)
    return pieces
