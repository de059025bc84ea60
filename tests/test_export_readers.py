"""Two readers of one document: the simulated unit, written from docs/eeprom.md alone, gives the exporter's bits."""

from __future__ import annotations

import numpy as np
import pytest
from test_export import MODELS, delivered

from bench.export.evaluate import evaluate
from bench.export.forms import FORMS
from bench.export.image import read, words_of
from bench.export.measure import wander
from bench.export.words import to_bytes
from drivers.sim.correction import Correction


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("name", MODELS)
def test_the_simulated_unit_and_the_exporter_agree_to_the_last_bit(name, form):
    made = delivered(name)
    words = words_of(made, form, 1042, 7)
    counts = wander(made, 3000)
    wanted = evaluate(read(words), counts)
    unit = Correction.read(to_bytes(words), 1042, 4096)
    got, flags = [], 0
    for begin in range(0, 3000, 1000):  # a unit sees its samples block by block
        part, own = unit.apply({id_: column[begin : begin + 1000] for id_, column in counts.items()})
        got.append(part)
        flags |= own
    np.testing.assert_array_equal(np.concatenate(got), wanted.value)
    assert flags == int(np.bitwise_or.reduce(wanted.flags))
