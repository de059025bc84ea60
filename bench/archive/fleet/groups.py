"""Values by group, for a million of them: names as numbers, and medians."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from bench.base import FloatArray, IntArray

ObjectArray = npt.NDArray[np.object_]


class Coded(NamedTuple):
    """The different names, sorted, and for each of n names its place among them (n,)."""

    names: tuple[str, ...]
    code: IntArray

    def at(self, rows: IntArray) -> Coded:
        """The same of some rows."""
        code = self.code[rows]
        used = np.bincount(code, minlength=len(self.names)) > 0
        return Coded(tuple(np.array(self.names, dtype=object)[used].tolist()), (np.cumsum(used) - 1)[code])


def coded(names: Sequence[str] | ObjectArray | Coded) -> Coded:
    """Names (n,) as numbers."""
    if isinstance(names, Coded):
        return names
    found = pa.array(names, pa.string()).dictionary_encode()
    known = found.dictionary.to_pylist()
    order = sorted(range(len(known)), key=known.__getitem__)
    place = np.empty(len(known), dtype=np.int64)
    place[order] = np.arange(len(known))
    return Coded(tuple(known[i] for i in order), place[found.indices.to_numpy()])


def medians(values: FloatArray, group: IntArray) -> FloatArray:
    """Median of the finite values (n,) of each group, 0 to the highest number in `group` (n,); each has a value."""
    order = np.argsort(values)
    order = order[np.argsort(group[order].astype(np.min_scalar_type(group.max())), kind="stable")]
    ends = np.cumsum(np.bincount(group))
    starts = np.append(0, ends[:-1])
    ordered = values[order]
    middle: FloatArray = 0.5 * (ordered[(starts + ends - 1) // 2] + ordered[(starts + ends) // 2])
    return middle


def median(values: FloatArray) -> float:
    """Median of finite values (n,), in half the time of numpy's, which looks for NaN."""
    half = values.size // 2
    parted = np.partition(values, half)
    upper = float(parted[half])
    return upper if values.size % 2 else 0.5 * (float(parted[:half].max()) + upper)
