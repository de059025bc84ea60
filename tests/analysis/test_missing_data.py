"""What is missing in a run that a verdict rests on is judged and told, with limits and without."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest

from bench.analysis.diagnosis.scores import HeldOut
from bench.analysis.effects.model import load_model
from bench.analysis.judging.judge import analyse
from bench.analysis.judging.limits import load_limits
from bench.analysis.judging.quantities import over_floor
from bench.analysis.judging.quantity import Quantity
from bench.analysis.judging.validity import refusals
from bench.analysis.judging.verification import by_floor, verify
from bench.analysis.noise.floor import Floor
from bench.base.errors import InputError
from bench.base.yaml12 import parse_yaml
from bench.deliver.certificate.combined import verified
from bench.record import RunFolder
from tests.support.commands import bench
from tests.support.run_folders import CYCLE, make_run, ramp_run

DOOR = {"why": "door", "channel": "chamber_temperature", "from_s": 0.0, "to_s": 4e3, "samples": 1, "duration_s": 4e3}
IN_UNIT = {"purpose": "verification", "unit_identity": {"serial": 1, "coefficient_set": 7}}
WIDE = "name: wide\nlimits:\n  - {quantity: residual_rms_dph, unit: deg/h, upper: 5, reason: test}\n"


def corrected(folder, spoil=lambda columns: None, **manifest):
    """A verification run of a unit whose output is noise, with something spoilt."""
    made = ramp_run([(name, kind, min(target, 70.0), n) for name, kind, target, n in CYCLE], seed=2, loop_dph=0.0)
    columns = dict(made["columns"])
    columns["rate"] = np.random.default_rng(3).normal(0.0, 0.4, columns["rate"].size)
    spoil(columns)
    return make_run(folder, columns, made["segments"], profile="check", **IN_UNIT, **manifest)


def thinned(columns):
    """45 % of the samples, spread over the whole run."""
    columns["rate"] = np.where(np.random.default_rng(1).random(columns["rate"].size) < 0.45, np.nan, columns["rate"])


def holed(columns):
    """Two minutes in the middle."""
    columns["rate"] = np.where(np.abs(columns["time"] - 4000.0) < 60.0, np.nan, columns["rate"])


def ended_early(columns):
    """The last quarter of an hour."""
    columns["rate"] = np.where(columns["time"] > columns["time"][-1] - 900.0, np.nan, columns["rate"])


@pytest.mark.parametrize("limits", [None, WIDE])
@pytest.mark.parametrize(
    ("spoil", "manifest", "said"),
    [
        (thinned, {}, r"45\.\d % of the samples are missing, at most 1 % may be"),
        (lambda columns: None, {"losses": {"received": 10000, "lost": 8000}}, "of the samples are missing"),
        (lambda columns: None, {"losses": {"received": 20000, "invalid": 8000}}, "of the samples are missing"),
        (lambda columns: None, {"left_out": [DOOR]}, "of its data are no measurements"),
        (holed, {}, "no sample for 0:0[12]:"),
        (ended_early, {}, "no sample for 0:15:00"),
    ],
)
def test_a_verification_that_lacks_much_is_invalid_and_says_what_it_lacks(tmp_path, limits, spoil, manifest, said):
    run = RunFolder(corrected(tmp_path / "check", spoil, **manifest))
    found = verify(run, None, None if limits is None else load_limits(parse_yaml(limits, "limits.yaml")), {})
    content = json.loads((run.path / "verification.json").read_text())
    reasons = content.get("refusals") or content["limits"]["refusals"]
    assert found.verdict == content["verdict"] == "INVALID"
    assert any(re.search(said, reason) for reason in reasons), reasons
    assert content["data"] == found.done.counts()


def test_a_whole_verification_passes_and_its_numbers_are_told(tmp_path):
    found = verify(RunFolder(corrected(tmp_path / "check")), None, load_limits(parse_yaml(WIDE, "limits.yaml")), {})
    assert found.verdict == "PASS"
    counts = found.done.counts()
    assert (counts["lost"], counts["missing"], counts["left_out"], counts["longest_gap_s"]) == (0, 0, 0, 0.0)


def test_the_pause_between_two_parts_is_no_gap_of_a_verification(tmp_path):
    """The record and its limits say the same: the joint of the parts is judged for itself."""
    own = WIDE + "  - {quantity: longest_gap_s, unit: s, upper: 5, reason: test}\n"
    pause = {"text": "aborted", "from_s": 3940.0, "to_s": 4060.0, "duration_s": 120.0}
    parts = [{"part": 0, "state": "aborted"}, {"part": 1, "state": "done", "gap": pause}]
    run = RunFolder(corrected(tmp_path / "check", holed, parts=parts))
    found = verify(run, None, load_limits(parse_yaml(own, "limits.yaml")), {})
    gap = next(one for one in found.judged["limits"]["results"] if one["name"] == "longest_gap_s")
    assert gap["value"] == found.done.counts()["longest_gap_s"] == 0.0


def test_a_noise_floor_that_is_an_upper_bound_only_passes_no_unit():
    """A soak that is still moving reads as noise: five times the error proves nothing."""
    error = HeldOut(rms_dph=0.2, peak_dph=0.6, interval_dph=(0.18, 0.22), by="verification")
    (known, _), (bound, judged) = (by_floor(error, Floor(floor), ()) for floor in (0.19, 1.0))
    assert (known, bound) == ("PASS", "INVALID")
    assert "an upper bound here" in judged["refusals"][0]
    floor = Quantity("noise_floor_dph", 1.0, 0.1, 1.4)
    ratio = over_floor(error, floor)
    assert (round(ratio.low, 2), ratio.value, round(ratio.high, 2)) == (0.13, 0.2, 2.2)
    assert ratio in verified(error, {floor.name: floor})  # what a certificate states


def test_the_calibration_run_of_a_verification_is_judged_too(tmp_path):
    calibration = make_run(tmp_path / "run", **ramp_run(loop_dph=0.0), losses={"received": 9000, "lost": 9000})
    analyse(calibration, [load_model("polynomial")], diagnose=False)
    found = verify(RunFolder(corrected(tmp_path / "check")), calibration, None, {})
    assert found.verdict == "INVALID"
    assert "calibration run" in found.judged["refusals"][0]


def test_limits_of_its_own_take_the_place_of_the_usual_ones(tmp_path):
    text = WIDE + "  - {quantity: samples_missing_ppm, unit: ppm, upper: 5.0e+5, reason: test}\n"
    run = RunFolder(corrected(tmp_path / "check", thinned))
    own = load_limits(parse_yaml(text, "limits.yaml"))
    assert not any(
        "samples are missing" in reason for reason in verify(run, None, own, {}).judged["limits"]["refusals"]
    )


def test_a_check_run_that_lacks_much_proves_nothing(tmp_path):
    run = make_run(tmp_path / "run", **ramp_run(loop_dph=0.0))
    made = ramp_run(seed=5, loop_dph=0.0)
    thinned(made["columns"])
    check = make_run(tmp_path / "check", **made)
    analysis = analyse(run, [load_model("spline")], [check], diagnose=False)
    assert any("run check, on which this verdict rests" in text for text in refusals(analysis))
    assert any("run check" in text for text in analysis.warnings)
    assert not analysis.within_limits


def test_the_certificate_counts_the_samples_of_both_runs_and_refuses_a_verification_with_holes(tmp_path):
    pytest.importorskip("typst")
    run = make_run(tmp_path / "run", **ramp_run(loop_dph=0.0))
    analyse(run, [load_model("spline")], diagnose=False)
    limits = tmp_path / "limits.yaml"
    limits.write_text(WIDE + '  - {quantity: samples_lost, unit: "1", upper: 100, reason: test}\n')
    narrow = ramp_run([(n, k, {85.0: 70.0}.get(t, t), a) for n, k, t, a in CYCLE], seed=2, loop_dph=0.0)

    def certificate(losses):
        check = make_run(
            tmp_path / f"check-{losses}", **narrow, profile="check", losses={"received": 9, "lost": losses}
        )
        files = ["--verification", check, "--limits", limits, "--out", tmp_path / "c.pdf"]
        return bench("certificate", run, "--draft", *files)

    assert certificate(3).exit_code == 0
    facts = json.loads((tmp_path / "c.json").read_text())
    lost = next(one for one in facts["conformity"]["results"] if one["name"] == "samples_lost")
    assert lost["value"] == 3
    assert (facts["data"]["verification"]["lost"], facts["data"]["calibration"]["lost"]) == (3, 0)
    assert any("3 lost" in row["value"] for row in facts["conditions"])
    refused = certificate(9000)
    assert refused.exit_code == 2
    assert "of the samples are missing" in refused.stderr


def test_a_run_without_a_sample_is_no_verification(tmp_path):
    with pytest.raises(InputError):
        verify(RunFolder(corrected(tmp_path / "check", lambda c: c.update(rate=c["rate"] * np.nan))), None, None, {})
