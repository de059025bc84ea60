"""A mystery reveals nothing, is the same for the same seed, and scores the named effects."""

import json
import re

import numpy as np
import pytest

from bench.analysis.effects import registry as effects
from bench.analysis.effects.model import Model, load_model
from bench.analysis.judging.judge import analyse
from bench.base.errors import InputError
from bench.mystery.hidden import HIDDEN
from bench.mystery.mystery import make_mystery, reveal
from bench.record.reading import load

PROFILE = """name: short
start: {temperature_degc: 25}
settle: {dwell_min: 1, slope_degc_per_min: 0.5, timeout_min: 240}
segments:
  - {kind: ramp, to_degc: 50, rate_degc_per_min: 2}
  - {kind: soak, duration_min: 6}
  - {kind: ramp, to_degc: 10, rate_degc_per_min: 2}
  - {kind: ramp, to_degc: 35, rate_degc_per_min: 1}
  - {kind: soak, duration_min: 6}
"""
SEED = 4


@pytest.fixture(scope="module")
def profile(tmp_path_factory):
    path = tmp_path_factory.mktemp("profiles") / "short.yaml"
    path.write_text(PROFILE)
    return path


@pytest.fixture(scope="module")
def mystery(tmp_path_factory, profile):
    return make_mystery(SEED, 2, tmp_path_factory.mktemp("mystery"), profile, profile)


@pytest.fixture(scope="module")
def revealed(mystery):
    return reveal(mystery.folder, Model("curve", (effects.make("polynomial"),)))


def test_three_runs_are_recorded_that_the_analysis_reads_like_any_other(mystery):
    for run in (mystery.run, mystery.check, mystery.static):
        data = load(run)
        assert len(data) > 100
        assert np.isfinite(data.bias).all()
        assert {"frequency", "drive", "quadrature", "supply", "chamber_setpoint", "compressor"} <= set(data.channels)
    assert np.ptp(load(mystery.static).channel("temperature")[-300:]) < 1.0


def test_the_report_of_a_mystery_finds_nothing_to_complain_about(mystery):
    analysis = analyse(mystery.run, [load_model("polynomial")])
    assert analysis.manifest.state == "done"


def test_nothing_that_is_written_names_a_mechanism(mystery):
    written = [f for f in mystery.folder.rglob("*") if f.name in {"manifest.json", "events.jsonl", "envelope.txt"}]
    texts = [file.read_text() for file in written]
    assert len(texts) == 7
    assert not [name for name in HIDDEN for text in texts if re.search(rf"\b{name}\b", text)]


def test_the_same_seed_gives_the_same_unit(mystery, profile, tmp_path):
    again = make_mystery(SEED, 2, tmp_path, profile, profile)
    assert np.array_equal(load(again.run).bias, load(mystery.run).bias)


def test_the_truth_comes_out_of_the_envelope_with_the_strength_that_it_was_given(revealed):
    assert len(revealed.hidden) == 2
    assert all(1.0 <= entry["strength"] <= 4.0 for entry in revealed.hidden)
    json.dumps(revealed.to_json(), allow_nan=False)


def test_who_names_what_is_hidden_is_right_and_who_does_not_has_missed_it(mystery, revealed):
    covered = {entry["effect"] for entry in revealed.hidden} - {None}
    assert set(revealed.missed) == covered
    assert revealed.right == revealed.wrong == ()
    data = load(mystery.run)
    model = Model("named", (effects.make("polynomial"), *(effects.make(n).suited([data]) for n in covered)))
    score = reveal(mystery.folder, model)
    assert set(score.right) == covered
    assert score.missed == score.wrong == ()
    assert score.held_out_rms_dph == pytest.approx(score.true_model_rms_dph)


def test_what_is_named_without_being_there_is_wrong(mystery, revealed):
    absent = next(n for n in ("compressor", "supply_voltage") if n not in {e["effect"] for e in revealed.hidden})
    score = reveal(mystery.folder, Model("guess", (effects.make("polynomial"), effects.make(absent))))
    assert score.wrong == (absent,)


def test_no_model_does_better_than_perfect_knowledge(revealed):
    assert 0.9 * revealed.floor_dph < revealed.true_model_rms_dph <= revealed.held_out_rms_dph
    assert revealed.floor_dph == pytest.approx(0.11, abs=0.03)


def test_a_second_mystery_does_not_overwrite_the_first(mystery, profile):
    with pytest.raises(InputError, match="already contains a mystery"):
        make_mystery(SEED, 1, mystery.folder, profile, profile)


def test_impossible_counts_and_missing_or_damaged_envelopes_are_refused(mystery, profile, tmp_path):
    model = load_model("polynomial")
    with pytest.raises(InputError, match="allowed are 1 to"):
        make_mystery(1, 40, tmp_path, profile, profile)
    with pytest.raises(InputError, match="no envelope"):
        reveal(tmp_path, model)
    (tmp_path / "envelope.txt").write_text("head\nnonsense\n")
    with pytest.raises(InputError, match="damaged"):
        reveal(tmp_path, model)
