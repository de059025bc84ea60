"""Two readers of one document: the simulated unit, written from docs/eeprom.md alone, gives the exporter's bits."""

from __future__ import annotations

import numpy as np
import pytest

from bench.deliver.export.delivery import NO_VALUE
from bench.deliver.export.evaluate import FLAG_NO_VALUE, evaluate
from bench.deliver.export.forms import FORMS
from bench.deliver.export.image import read, words_of
from bench.deliver.export.measure import wander
from bench.deliver.export.words import to_bytes
from drivers.sim.correction import Correction
from tests.deliver.test_export import MODELS, delivered


def agree(words, counts, block=1000):
    """Both readers' answers to the same samples; returns the reference's."""
    wanted = evaluate(read(words), counts)
    unit = Correction.read(to_bytes(words), 1042, 4096)
    got, flags = [], 0
    for begin in range(0, len(counts[0]), block):  # a unit sees its samples block by block
        part, own = unit.apply({id_: column[begin : begin + block] for id_, column in counts.items()})
        got.append(part)
        flags |= own
    np.testing.assert_array_equal(np.concatenate(got), wanted.value)
    assert flags == int(np.bitwise_or.reduce(wanted.flags))
    return wanted


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("name", MODELS)
def test_the_simulated_unit_and_the_exporter_agree_to_the_last_bit(name, form):
    made = delivered(name)
    agree(words_of(made, form, 1042, 7), wander(made, 3000))


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("name", MODELS)
def test_they_agree_where_samples_have_no_value(name, form):
    made = delivered(name)
    counts = {id_: column.copy() for id_, column in wander(made, 3000).items()}
    random = np.random.default_rng(5)
    for column in counts.values():
        column[random.random(3000) < 0.1] = NO_VALUE
        column[:3] = NO_VALUE  # nothing starts a state
        column[1000:1300] = NO_VALUE  # more than a whole block
    answer = agree(words_of(made, form, 1042, 7), counts, block=250)
    gone = counts[0] == NO_VALUE
    assert np.all(answer.value[gone] == 0.0)
    assert np.all(answer.flags[gone] & FLAG_NO_VALUE)
