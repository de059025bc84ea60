"""The certificate: its content, its refusals, and that the same facts give the same bytes."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from bench.analysis.effects.model import load_model
from bench.analysis.judging.judge import analyse
from bench.base.digits import measured
from bench.base.errors import InputError
from bench.deliver.certificate.budget import budget
from bench.deliver.certificate.certificate import number_of
from bench.deliver.certificate.evidence import gather
from bench.deliver.certificate.laboratory import Instrument, load_instruments, refuse_overdue
from bench.record.chain import drop
from tests.support.commands import bench
from tests.support.run_folders import CYCLE, keep, make_run, ramp_run

typst = pytest.importorskip("typst")
LIMITS = """\
name: test limits
limits:
  - {quantity: residual_rms_dph, unit: deg/h, upper: UPPER, reason: error budget}
  - {quantity: scale_factor_error_ppm, unit: ppm, upper: 100, required: false, reason: data sheet}
"""
EQUIPMENT = """\
equipment:
  - {name: chamber sensor, serial: PT-1, calibrated: 2026-03-01, due: DUE}
  - {name: time base, serial: TB-2, calibrated: 2026-03-02, due: 2028-03-01}
"""
LABORATORY = """\
laboratory: {name: "Lab #1 *bold* $x$ <b>", address: Somewhere 1}
customer: {name: Customer}
authorised_by: {name: A. Person, function: head}
item: {model: VG-1, received: 2026-11-18}
"""


def over(low, high, seed):
    """A run of a profile of its own between these temperatures [degC]."""
    legs = [(name, kind, {85.0: high, -40.0: low}.get(target, target), n) for name, kind, target, n in CYCLE]
    return ramp_run(legs, seed=seed, loop_dph=0.0)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A calibration run with its report, and a verification run of another profile; not to be changed."""
    folder = tmp_path_factory.mktemp("certificate")
    run = make_run(folder / "run", **ramp_run(loop_dph=0.0))
    analyse(run, [load_model("spline")], diagnose=False)
    other = over(-30.0, 70.0, 2)
    make_run(folder / "check", **other, profile="check")
    corrected = {**other["columns"], "rate": other["columns"]["rate"] * 0.0 + 0.05}
    make_run(folder / "corrected", corrected, other["segments"], unit_identity={"serial": 1, "coefficient_set": 7})
    (folder / "limits.yaml").write_text(LIMITS.replace("UPPER", "5"))
    (folder / "tight.yaml").write_text(LIMITS.replace("UPPER", "0.01"))
    (folder / "equipment.yaml").write_text(EQUIPMENT.replace("DUE", "2027-03-01"))
    (folder / "overdue.yaml").write_text(EQUIPMENT.replace("DUE", "2026-11-20"))
    (folder / "laboratory.yaml").write_text(LABORATORY)
    return folder


def certificate(folder, *options, run="run"):
    """With laboratory and equipment, unless the options or the run folder have others."""
    given = [*options]
    for name in ("laboratory", "equipment"):
        if f"--{name}" not in given and (path := folder / f"{name}.yaml").is_file():
            given += [f"--{name}", path]
    return bare(folder / run, *given)


def bare(run, *options):
    return bench("certificate", run, "--issued", "2026-11-21", *options)


def whole(folder, out, *options):
    return certificate(
        folder, "--limits", folder / "limits.yaml", "--equipment", folder / "equipment.yaml",
        "--laboratory", folder / "laboratory.yaml", "--out", out, *options,
    )  # fmt: skip


@pytest.fixture(scope="module")
def issued(made, tmp_path_factory):
    """The certificate with everything: its path and its facts."""
    path = tmp_path_factory.mktemp("issued") / "cert.pdf"
    done = whole(made, path, "--verification", made / "check")
    assert done.exit_code == 0, done.stderr
    return path, json.loads(path.with_suffix(".json").read_text())


def test_same_facts_give_the_same_bytes(made, issued, tmp_path):
    whole(made, tmp_path / "again.pdf", "--verification", made / "check")
    assert (tmp_path / "again.pdf").read_bytes() == issued[0].read_bytes()


def test_facts_name_all_that_a_certificate_must_name(issued):
    facts = issued[1]
    assert facts["laboratory"]["name"].startswith("Lab #1")
    assert facts["item"]["serial"] == "SIM-0001"
    assert facts["method"]["profile"] == "ramp_-40_85"
    assert facts["method"]["verification_profile"] == "check"
    assert [tool["due"] for tool in facts["equipment"]] == ["2027-03-01", "2028-03-01"]
    assert "as far as 1 turn-on can tell" in facts["uncertainty"]["scope"]
    assert facts["conformity"]["verdict"] == facts["verdict"] == "PASS"
    assert "guard band" in facts["conformity"]["decision_rule"]
    assert facts["calibration"]["id"].startswith("0x")
    assert facts["software"]["certificate"]["bench"]
    assert any("not claimed" in text for text in facts["statements"])


def test_number_is_made_of_the_facts(issued):
    facts = issued[1]
    assert facts["number"] == number_of(facts)
    assert number_of({**facts, "issued": "2026-11-22"}) != facts["number"]


def test_hashes_are_those_of_the_run_folders(made, issued):
    for entry, name in zip(issued[1]["chain"]["runs"], ("run", "check"), strict=True):
        assert entry["files"] == json.loads((made / name / "manifest.json").read_text())["files"]
        assert "data.parquet" in entry["files"]


def test_every_row_of_the_budget_has_a_source_a_distribution_and_degrees_of_freedom(issued):
    budget = issued[1]["uncertainty"]
    for row in budget["contributions"]:
        assert row["origin"]
        assert row["distribution"] in {"normal", "rectangular"}
        assert row["degrees_of_freedom"] is None or row["degrees_of_freedom"] >= 1.0


def test_the_budget_combines_as_welch_and_satterthwaite_do(issued):
    budget = issued[1]["uncertainty"]
    parts = np.array([row["standard_dph"] for row in budget["contributions"]])
    freedom = np.array([row["degrees_of_freedom"] or np.inf for row in budget["contributions"]])
    combined = np.sqrt(np.sum(parts**2))
    effective = combined**4 / np.sum(parts**4 / freedom)
    assert budget["combined_dph"] == pytest.approx(combined)
    assert budget["effective_degrees_of_freedom"] == pytest.approx(effective)
    assert budget["by_formula_dph"] == pytest.approx(stats.t.ppf(0.97725, effective) * combined, rel=1e-3)


def test_one_turn_on_widens_u_and_further_ones_add_degrees_of_freedom(made, tmp_path):
    others = (make_run(tmp_path / f"check{n}", **over(-30.0, 70.0, n + 1), profile=f"check{n}") for n in (2, 3))
    runs = [made / "check", *others]
    one, three = (budget(gather(made / "run", some, None, ())) for some in (runs[:1], runs))
    assert len(three.turn_ons) == 3
    assert three.at_rest.coverage_factor < one.at_rest.coverage_factor
    row = next(part for part in three.at_rest.contributions if part.source.startswith("turn-on"))
    assert row.standard_dph == pytest.approx(np.sqrt(np.mean(np.square(three.turn_ons))))
    with pytest.raises(InputError, match="is given twice as a verification"):
        gather(made / "run", [runs[0], runs[0]], None, ())


def test_as_found_and_as_left_are_the_figures_of_the_records(made, issued):
    facts = issued[1]
    assert facts["as_found"]["rms_dph"] > 5 * facts["as_left"]["rms_dph"]
    assert "independent run" in facts["as_left"]["what"]
    assert not facts["as_left"]["verified"]


def papers(made, tmp_path):
    for name in ("laboratory.yaml", "equipment.yaml"):
        shutil.copy(made / name, tmp_path)


def flashed(made, tmp_path, **changes):
    """A copy of the run whose calibration was written to the unit."""
    shutil.copytree(made / "run", tmp_path / "run")
    papers(made, tmp_path)
    own = json.loads(certificate(made, "--out", tmp_path / "first.pdf", "--json").stdout)["json"]
    calibration = json.loads(Path(own).read_text(encoding="utf-8"))["calibration"]["id"]
    record = {"state": "done", "calibration_id": calibration, "coefficient_set": 7, "crc": "0x12345678", "bank": 1}
    keep(tmp_path / "run", "flash.json", {**record, **changes})
    return tmp_path


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"state": "failed"}, "no flash.json says with which calibration"),
        ({"calibration_id": "0x00000001"}, "the unit was given calibration 0x00000001"),
        ({"coefficient_set": 8}, "ran with coefficient set 7, this calibration is 8"),
    ],
)
def test_a_unit_that_corrected_itself_by_something_else_is_not_certified(made, tmp_path, change, said):
    done = certificate(flashed(made, tmp_path, **change), "--verification", made / "corrected")
    assert done.exit_code == 2
    assert said in done.stderr


def test_a_run_of_the_corrected_unit_is_measured_and_not_calculated(made, tmp_path):
    done = certificate(flashed(made, tmp_path), "--verification", made / "corrected", "--json")
    assert done.exit_code == 0, done.stderr
    as_left = json.loads(done.stdout)["as_left"]
    assert as_left["verified"]
    assert as_left["rms_dph"] == pytest.approx(0.05)
    assert as_left["span_dph"] == pytest.approx(0.0, abs=1e-9)
    facts = json.loads((tmp_path / "run" / "certificate.json").read_text())
    assert facts["calibration"]["flashed"]["crc"] == "0x12345678"


@pytest.mark.parametrize("held", ["its own", "0x00000001", None])
def test_a_unit_flashed_by_a_command_is_proven_by_what_was_read_from_it(made, tmp_path, held):
    """Its heartbeat tells no coefficient set; `bench verify` keeps which calibration it read from the unit."""
    flashed(made, tmp_path)
    record = json.loads((tmp_path / "run" / "flash.json").read_text())
    kept = {"state": "done", "calibration_id": record["calibration_id"], "protocol": "command"}
    keep(tmp_path / "run", "flash.json", kept)
    shutil.copytree(made / "corrected", tmp_path / "corrected")
    if held is not None:
        inside = {"calibration_id": kept["calibration_id"] if held == "its own" else held, "bank": None}
        keep(tmp_path / "corrected", "verification.json", {"verdict": "PASS", "in_unit": inside})
    done = certificate(tmp_path, "--verification", tmp_path / "corrected")
    if held == "its own":
        assert done.exit_code == 0, done.stderr
        facts = json.loads((tmp_path / "run" / "certificate.json").read_text())
        assert facts["calibration"]["flashed"]["protocol"] == "command"
    else:
        assert done.exit_code == 2
        assert f"the unit held calibration {held} when it was verified, not this one" in done.stderr


def test_without_a_verification_it_says_that_the_figures_are_calculated(made, tmp_path):
    done = certificate(made, "--out", tmp_path / "c.pdf")
    assert done.exit_code == 0
    assert "not yet verified in the unit" in done.stdout


def test_outside_the_limits_is_a_certificate_that_says_so(made, tmp_path):
    done = certificate(made, "--limits", made / "tight.yaml", "--out", tmp_path / "c.pdf", "--json")
    assert done.exit_code == 1
    assert json.loads(done.stdout)["verdict"] == "FAIL"
    assert (tmp_path / "c.pdf").read_bytes().startswith(b"%PDF")


def changed(made, tmp_path, file="manifest.json", **changes):
    """A copy of the run with some keys of one of its files changed."""
    run = tmp_path / "run"
    shutil.copytree(made / "run", run)
    content = json.loads((run / file).read_text())
    keep(run, file, {**content, **changes})
    papers(made, tmp_path)
    return tmp_path


@pytest.mark.parametrize(
    ("file", "change", "said"),
    [
        ("manifest.json", {"state": "aborted", "cause": "operator"}, "the run is 'aborted'"),
        ("manifest.json", {"state": "imported"}, "the run is 'imported'"),
        ("manifest.json", {"created": "yesterday"}, "has no date"),
        ("calibration.json", {"verdict": {"verdict": "unproven"}}, "no unseen data proves the model"),
        ("calibration.json", {"verdict": {"verdict": "adequate", "admissible": False}}, "do not fit together"),
        ("calibration.json", {"refusals": ["only 0:01:00 of cooling"]}, "only 0:01:00 of cooling"),
        ("calibration.json", {"calibration": None}, "no model could be fitted"),
    ],
)
def test_nothing_unproven_is_certified(made, tmp_path, file, change, said):
    done = certificate(changed(made, tmp_path, file, **change), "--equipment", made / "equipment.yaml")
    assert done.exit_code == 2
    assert said in done.stderr
    assert done.stderr.count("\n") == 1
    assert not (tmp_path / "run" / "certificate.pdf").exists()


def test_data_that_are_not_those_recorded_are_not_certified(made, tmp_path):
    shutil.copytree(made / "run", tmp_path / "run")
    with (tmp_path / "run" / "events.jsonl").open("a") as file:
        file.write("\n")
    done = certificate(tmp_path)
    assert done.exit_code == 2
    assert "events.jsonl: is not the file that was recorded: its SHA-256 is" in done.stderr


def test_overdue_equipment_makes_no_certificate(made):
    done = certificate(made, "--equipment", made / "overdue.yaml")
    assert done.exit_code == 2
    assert "not calibrated on 2026-11-21: chamber sensor PT-1, due 2026-11-20" in done.stderr


def test_a_verification_that_shares_data_with_the_fit_proves_nothing(made, tmp_path):
    shutil.copytree(made / "run", tmp_path / "copy")
    for run in (made / "run", tmp_path / "copy"):
        done = certificate(made, "--verification", run)
        assert done.exit_code == 2
        assert "shares data with the fit" in done.stderr


@pytest.mark.parametrize(
    ("change", "said"), [({"unit": "SIM-0002"}, "of unit SIM-0002"), ({"state": "aborted"}, "the run is 'aborted'")]
)
def test_a_verification_of_another_unit_or_in_part_is_refused(made, tmp_path, change, said):
    shutil.copytree(made / "check", tmp_path / "check")
    path = tmp_path / "check" / "manifest.json"
    keep(path.parent, path.name, {**json.loads(path.read_text()), **change})
    done = certificate(made, "--verification", tmp_path / "check")
    assert done.exit_code == 2
    assert said in done.stderr


def judged(made, tmp_path, content, run="check"):
    """A copy of a verification run with the verdict of `bench verify`."""
    shutil.copytree(made / run, tmp_path / "judged")
    keep(tmp_path / "judged", "verification.json", content)
    return tmp_path / "judged"


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ({"verdict": "INVALID", "refusals": ["the run is 'aborted'"]}, "is INVALID: the run is 'aborted'; verify"),
        ({"verdict": "INVALID", "limits": {"refusals": ["no floor"]}}, "is INVALID: no floor; verify"),
        ({"verdict": "INVALID"}, "is INVALID: a required value does not exist"),
        ({"verdict": "GOOD"}, "verdict is \"GOOD\": input should be 'PASS'"),
        ("{", "is not valid JSON"),
    ],
)
def test_an_invalid_verification_makes_no_certificate(made, tmp_path, content, said):
    done = certificate(made, "--verification", judged(made, tmp_path, content), "--out", tmp_path / "c.pdf")
    assert done.exit_code == 2
    assert said in done.stderr
    assert done.stderr.count("\n") == 1
    assert not (tmp_path / "c.pdf").exists()


@pytest.mark.parametrize(
    ("word", "limits", "whole"),
    [("FAIL", True, "FAIL"), ("FAIL", False, "FAIL"), ("MARGINAL", True, "MARGINAL"), ("PASS", False, None)],
)
def test_the_certificate_is_as_good_as_the_worse_of_limits_and_verification(made, tmp_path, word, limits, whole):
    check = judged(made, tmp_path, {"verdict": word})
    options = ["--limits", made / "limits.yaml"] if limits else []
    done = certificate(made, "--verification", check, *options, "--out", tmp_path / "c.pdf", "--json")
    assert done.exit_code == (word == "FAIL")
    assert json.loads(done.stdout)["verdict"] == whole
    facts = json.loads((tmp_path / "c.json").read_text())
    assert (facts["verdict"], facts["verification"]["verdict"]) == (whole, word)
    assert not limits or facts["conformity"]["verdict"] == whole


def test_it_says_how_much_of_the_range_was_verified(issued):
    verification = issued[1]["verification"]
    assert verification["verdict"] is None
    assert verification["covered_percent"] == pytest.approx(80.0, abs=2.0)  # -30 to 70 of -40 to 85 degC
    assert verification["covered_degc"] == pytest.approx([-30.0, 70.0], abs=1.0)
    assert verification["validity_degc"] == pytest.approx([-40.0, 85.0], abs=1.0)


def test_what_was_verified_is_certified_and_named_as_such(issued):
    facts = issued[1]
    assert facts["validity"]["certified_degc"] == facts["verification"]["covered_degc"]
    fitted = facts["validity"]["fitted"]["temperature"]
    assert [fitted["from"], fitted["to"]] == facts["verification"]["validity_degc"]
    meanings = {one["name"]: one["meaning"] for one in (*facts["results"], *facts["conformity"]["results"])}
    assert meanings["residual_rms_dph"] == "error in the verification run, RMS"
    assert not [words for words in meanings.values() if "held-out" in words]


poppler = pytest.mark.skipif(shutil.which("pdftotext") is None, reason="poppler is not installed")


def shown_by(program, *words):
    """What a program of poppler prints of a PDF."""
    return subprocess.run([program, *words], capture_output=True, text=True, check=True).stdout


@poppler
def test_a_value_is_printed_as_the_report_prints_it(issued):
    shown = shown_by("pdftotext", "-layout", issued[0], "-")
    facts = issued[1]
    undetermined = [one for one in facts["results"] if one["value"] == 0 and (one["high"] or 0) > 0]
    assert undetermined
    for one in undetermined:
        most = re.sub(r"e-0?(\d+)", r" · 10−\1", measured(0, one["high"]).split()[1])
        assert re.search(rf"{one['meaning']} +below {most}", shown)
    assert shown.count("(by constraint)") == sum(
        c["value"] == 0 == c["std"] for c in facts["calibration"]["coefficients"]
    )
    assert "Certified for" in shown


@pytest.mark.parametrize(("low", "high", "share"), [(10.0, 40.0, "24%"), (20.0, 28.0, "6%")])
def test_a_verification_of_a_small_part_of_the_range_proves_too_little(made, tmp_path, low, high, share):
    make_run(tmp_path / "narrow", **over(low, high, 3), profile="narrow")
    done = certificate(made, "--verification", tmp_path / "narrow", "--out", tmp_path / "c.pdf")
    assert done.exit_code == 2
    assert f"{share} of the calibration's range of temperature, {low:.1f} to {high:.1f} of -40.0 to 85.0" in done.stderr
    assert "at least 50% are needed" in done.stderr
    assert done.stderr.count("\n") == 1


def test_a_required_number_that_is_missing_makes_no_certificate(made, tmp_path):
    (tmp_path / "limits.yaml").write_text(LIMITS.replace("UPPER", "5").replace("required: false, ", ""))
    done = certificate(made, "--limits", tmp_path / "limits.yaml")
    assert done.exit_code == 2
    assert "scale_factor_error_ppm is required by the limits" in done.stderr


FILES = {"laboratory": LABORATORY, "equipment": EQUIPMENT.replace("DUE", "2027-03-01")}


@pytest.mark.parametrize(
    ("change", "line", "said", "sealed"),
    [
        (("laboratory", None, None), None, "no laboratory and no signatory; give a file with `laboratory: {", False),
        (("laboratory", '"Lab #1 *bold* $x$ <b>"', '" "'), 1, "no laboratory; fill in its name", True),
        (("laboratory", LABORATORY.splitlines()[2], ""), 5, "no signatory; add `authorised_by: {name: ", False),
        (("laboratory", "A. Person", '""'), 3, "no signatory; fill in the name", True),
        (("equipment", None, None), None, "no equipment; give a file with every instrument", True),
        (("equipment", ", due: 2028-03-01", ""), 3, "no due date of time base TB-2; add `due: YYYY-MM-DD`", False),
        (("equipment", ", due: 2028-03-01", ""), 3, "no due date of time base TB-2; add `due: YYYY-MM-DD`", True),
    ],
)
def test_what_is_missing_is_named_with_the_line_to_fill_in_or_stands_on_a_draft(
    made, tmp_path, change, line, said, sealed
):  # fmt: skip
    file, old, new = change
    run = tmp_path / "run"
    shutil.copytree(made / "run", run)
    drop(run, "certificate.json")
    options = []
    for name, text in FILES.items():
        if name == file and old is None:
            continue
        path = (run if sealed else tmp_path) / f"{name}.yaml"
        path.write_text(text.replace(old, new) if name == file else text)
        options += [] if sealed else [f"--{name}", path]
    done = bare(run, *options)
    where = str(run) if old is None else f"{run if sealed else tmp_path}/{file}.yaml:{line}"
    assert (done.exit_code, done.stderr.count("\n")) == (2, 1)
    assert done.stderr.startswith(f"bench: {where}: no certificate: {said}"), done.stderr
    assert "--draft" in done.stderr
    assert not (run / "certificate.json").exists()
    done = bare(run, *options, "--draft", "--json")
    assert done.exit_code == 0, done.stderr
    facts = json.loads(done.stdout)
    assert facts["draft"] == [said.partition(";")[0]]
    assert facts["number"].startswith("DRAFT-SIM-0001-")
    assert not (run / "certificate.json").exists()
    if shutil.which("pdftotext"):
        pages = shown_by("pdftotext", facts["pdf"], "-").rstrip("\f").split("\f")
        assert all(" ".join(f"DRAFT: {facts['draft'][0]}".split()) in " ".join(page.split()) for page in pages)
    done = bare(run, *options, "--draft", "--out", run / "certificate.pdf")
    assert done.exit_code == 2
    assert "must not take the place" in done.stderr


def test_without_typst_it_says_what_to_install(made, monkeypatch):
    monkeypatch.setattr("bench.deliver.certificate.typeset.find_spec", lambda name: None)
    done = certificate(made)
    assert done.exit_code == 2
    assert "pip install 'gyro-thermal-bench[certificate]'" in done.stderr


def test_equipment_that_was_calibrated_later_was_not_calibrated_then(made):
    sensor, *_ = load_instruments(made / "equipment.yaml")
    refuse_overdue([sensor], sensor.due)
    early = Instrument(name="clock", serial="1", calibrated=sensor.due)
    with pytest.raises(Exception, match="calibrated later"):
        refuse_overdue([early], sensor.calibrated)


@poppler
def test_pages_are_numbered_named_and_ended_and_the_facts_are_attached(issued, tmp_path):
    path, facts = issued
    pages = shown_by("pdftotext", "-layout", path, "-")
    shown = pages.rstrip("\f").split("\f")
    for number, page in enumerate(shown, start=1):
        assert f"Page {number} of {len(shown)}" in page
        assert facts["number"] in page
    assert f"End of certificate {facts['number']}" in shown[-1]
    assert "Lab #1 *bold* $x$ <b>" in pages
    shown_by("pdfdetach", "-saveall", "-o", tmp_path, path)
    assert (tmp_path / "certificate.json").read_text() == path.with_suffix(".json").read_text()
    info = shown_by("pdfinfo", path)
    assert "595.276 x 841.89 pts (A4)" in info
    assert "Tagged:          yes" in info


@poppler
def test_all_fonts_are_inside(issued):
    fonts = shown_by("pdffonts", issued[0]).splitlines()[2:]
    assert fonts
    assert all(line.split()[-5] == "yes" for line in fonts)


@poppler
def test_the_closing_text_of_page_1_keeps_its_distance_to_the_figure(made, tmp_path):
    path = tmp_path / "cert.pdf"
    (tmp_path / "long.yaml").write_text(LABORATORY.replace("Somewhere 1", f"'{'Somewhere 1, ' * 12}'"))
    done = whole(made, path, "--verification", made / "check", "--laboratory", tmp_path / "long.yaml")
    assert done.exit_code == 0, done.stderr
    box = re.findall(r'yMin="([\d.]+)" xMax="[\d.]+" yMax="([\d.]+)">(\S+)</word>',
                     shown_by("pdftotext", "-f", "1", "-l", "1", "-bbox", path, "-"))  # fmt: skip
    words = [word for _, _, word in box]
    caption = words.index("means", words.index("Zero-rate", words.index("Calibrated")))
    closing = next(i for i in range(caption, len(words)) if words[i : i + 3] == ["The", "results", "relate"])
    assert float(box[closing][0]) - float(box[caption][1]) > 10.0  # pt
    assert float(box[words.index("Page")][0]) - float(box[words.index("standard", closing)][1]) > 10.0


@poppler
def test_a_chinese_laboratory_is_printed(made, tmp_path):
    chinese = LABORATORY.replace("Lab #1 *bold* $x$ <b>", "校准实验室").replace("A. Person", "王小明")
    (tmp_path / "zh.yaml").write_text(chinese, encoding="utf-8")
    path = tmp_path / "cert.pdf"
    done = certificate(made, "--verification", made / "check", "--laboratory", tmp_path / "zh.yaml", "--out", path)
    if "install a font" in done.stderr and not os.environ.get("BENCH_CI"):
        pytest.skip("no font here has Chinese")
    assert done.exit_code == 0, done.stderr
    page = shown_by("pdftotext", "-f", "1", "-l", "1", path, "-")
    assert "校准实验室" in page
    assert "王小明" in page
