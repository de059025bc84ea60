"""Values by group, for a million of them: names as numbers, and medians."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pyarrow as pa

from bench.base import FloatArray, IntArray


def coded(names: Sequence[str]) -> tuple[tuple[str, ...], IntArray]:
    """The different names, sorted, and for each of `names` (n,) its place among them."""
    found = pa.array(names, pa.string()).dictionary_encode()
    known = found.dictionary.to_pylist()
    order = sorted(range(len(known)), key=known.__getitem__)
    place = np.empty(len(known), dtype=np.int64)
    place[order] = np.arange(len(known))
    return tuple(known[i] for i in order), place[found.indices.to_numpy()]


def medians(values: FloatArray, group: IntArray) -> FloatArray:
    """Median of the finite values (n,) of each group, 0 to the highest number in `group` (n,); each has a value."""
    order = np.argsort(values)
    order = order[np.argsort(group[order].astype(np.min_scalar_type(group.max())), kind="stable")]
    ends = np.cumsum(np.bincount(group))
    starts = np.append(0, ends[:-1])
    ordered = values[order]
    middle: FloatArray = 0.5 * (ordered[(starts + ends - 1) // 2] + ordered[(starts + ends) // 2])
    return middle
