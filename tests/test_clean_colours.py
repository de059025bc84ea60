"""A seeded sample of the campaign over noise of seven colours, and its counting."""

import re

import numpy as np
import pytest

from bench.analysis.diagnosis.diagnose import diagnose
from benchmarks import clean_colours as campaign


@pytest.mark.parametrize("colour", campaign.COLOURS)
def test_noise_of_every_colour_is_about_as_large_as_the_white_one(colour):
    temperature = np.linspace(-40.0, 85.0, 1000)
    sizes = [np.std(campaign.noise(colour, 1000, temperature, np.random.default_rng(seed))) for seed in range(8)]
    assert 0.5 * campaign.WHITE_DPH < np.median(sizes) < 3.0 * campaign.WHITE_DPH


def test_counts_have_intervals_and_the_section_is_empty_without_results(tmp_path):
    clean = {"verdict": "adequate", "found": [], "named": [], "formulas": 0, "sentence": "is noise"}
    results = [(campaign.Case("one_rate", n, "white"), clean) for n in range(20)]
    results += [(campaign.Case("one_rate", 1, hidden="supply_voltage", strength=2.0), clean)]
    rows = {row["what"]: row for row in campaign.counts(results)}
    assert rows["clean, one_rate"]["named"] == [0, 0.0, 0.1611]
    assert rows["cause in no channel, with isothermal run"]["adequate without the words"][0] == 1
    assert campaign.section(tmp_path / "none.jsonl") == ""


@pytest.mark.slow
def test_a_sample_of_the_campaign_is_resumed_and_written(tmp_path):
    out = tmp_path / "colours.jsonl"
    cases = [campaign.Case("one_rate", 1, "white"), campaign.Case("one_rate", 2, "telegraph")]
    results = campaign.campaigns.found(cases, lambda case: campaign.run_case(case, 1), out, campaign.Case)
    assert not any(found["named"] for _, found in results)
    assert campaign.campaigns.found(cases, pytest.fail, out, campaign.Case) == results
    assert "clean, one_rate | 2 |" in campaign.section(out)


@pytest.mark.slow
def test_slow_noise_that_run_and_isothermal_run_share_is_no_alarm_and_a_slow_cause_is_said_to_look_the_same():
    """Noise of 1/f^1.5, of which the three hours of the isothermal run show less than the five of the run."""
    case = campaign.Case("one_rate", 3, "1/f^1.5", checked=True)
    run, still, check = campaign.runs_of(case, 403)
    answer = diagnose([run], campaign.MODEL, check=check, static=still, seed=403)
    assert answer.verdict == "adequate"
    alone, stated = re.search(
        r"alone is ([\d.]+) deg/h, with the slow noise of this run ([\d.]+),", answer.sentence
    ).groups()
    assert answer.held_out_rms_dph > 1.5 * float(alone)  # no noise of the isothermal run alone
    assert answer.floor_dph == pytest.approx(float(stated), rel=1e-2)
    assert answer.sentence.endswith("a slow cause that no channel records looks the same.")
