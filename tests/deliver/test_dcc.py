"""The digital calibration certificate: valid by PTB's schema, and read back to the digits of certificate.json."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import pytest

from bench.analysis.effects.model import load_model
from bench.analysis.judging.judge import analyse
from bench.deliver.certificate.dsi import dsi, unit_of
from tests.support.commands import bench
from tests.support.dcc import faults, read_back
from tests.support.run_folders import CYCLE, make_run, ramp_run

pytest.importorskip("typst")
PROFILES = Path(__file__).parents[2] / "profiles"
PAPERS = ("--laboratory", PROFILES / "laboratory/simulated.yaml", "--equipment", PROFILES / "equipment/simulated.yaml")


def certificate(*words):
    return bench("certificate", *words, "--issued", "2026-11-21")


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A run with its report, and another to verify it."""
    folder = tmp_path_factory.mktemp("dcc")
    analyse(make_run(folder / "run", **ramp_run(loop_dph=0.0)), [load_model("spline")], diagnose=False)
    narrower = [(name, kind, {85.0: 70.0, -40.0: -30.0}.get(target, target), n) for name, kind, target, n in CYCLE]
    make_run(folder / "check", **ramp_run(narrower, seed=2, loop_dph=0.0), profile="check")
    return folder


@pytest.fixture(scope="module", params=["whole", "without verification", "without limits", "draft"])
def issued(request, made):
    """Facts and XML of a certificate."""
    options = {
        "whole": ["--verification", made / "check", "--limits", PROFILES / "limits/vibratory.yaml", *PAPERS],
        "without verification": ["--limits", PROFILES / "limits/vibratory.yaml", *PAPERS],
        "without limits": ["--verification", made / "check", *PAPERS],
        "draft": ["--draft"],
    }[request.param]
    pdf = made / f"{request.param.replace(' ', '_')}.pdf"
    done = certificate(made / "run", "--out", pdf, *options)
    assert done.exit_code in {0, 1}, done.output
    return json.loads(pdf.with_suffix(".json").read_text()), pdf.with_suffix(".xml").read_bytes()


def numbers(content, path=""):
    """Every number of a JSON value by its path."""
    if isinstance(content, dict | list):
        for key, value in content.items() if isinstance(content, dict) else enumerate(content):
            yield from numbers(value, f"{path}.{key}".lstrip("."))
    elif isinstance(content, int | float) and not isinstance(content, bool):
        yield path, content


def test_the_certificate_is_valid_by_the_schema(issued):
    assert faults(issued[1]) == []


def test_a_second_reader_reads_every_number_of_the_results_to_the_same_digits(issued):
    facts, xml = issued
    read, wanted = read_back(xml), dict(numbers(facts))
    assert {name: float(entry["value"]) for name, entry in read.items()} == {name: wanted[name] for name in read}
    assert {entry["value"] for entry in read.values()} <= {json.dumps(value) for value in wanted.values()}
    results = ("as_found", "as_left", "over_temperature", "results", "uncertainty", "conformity", "verification")
    lacking = {path for path in wanted if path.partition(".")[0] in results} - set(read)
    assert lacking == set()
    for i, one in enumerate(facts["calibration"]["coefficients"]):
        entry = read[f"calibration.coefficients.{i}.value"]
        if one["std"]:
            uncertainty = {key.rpartition("}")[2]: value for key, value in entry["expandedUnc"].items()}
            assert uncertainty["uncertainty"] == json.dumps(one["std"])


def test_the_result_carries_the_expanded_uncertainty_of_the_budget(issued):
    facts, xml = issued
    if facts["as_left"]["mean_dph"] is None:
        return
    entry = read_back(xml)["as_left.mean_dph"]
    assert entry["unit"] == r"\degree\hour\tothe{-1}"
    found = {key.rpartition("}")[2]: value for key, value in entry["expandedUnc"].items()}
    assert found["uncertainty"] == json.dumps(facts["uncertainty"]["expanded_dph"])
    assert found["coverageFactor"] == json.dumps(facts["uncertainty"]["coverage_factor"])


@pytest.mark.skipif(shutil.which("pdfdetach") is None, reason="poppler is not installed")
def test_the_xml_is_inside_the_pdf_byte_by_byte(made, issued, tmp_path):
    import subprocess

    (pdf,) = (path for path in made.glob("*.pdf") if path.with_suffix(".xml").read_bytes() == issued[1])
    subprocess.run(["pdfdetach", "-saveall", "-o", tmp_path, pdf], check=True, capture_output=True)
    assert (tmp_path / "certificate.xml").read_bytes() == issued[1]
    assert json.loads((tmp_path / "certificate.json").read_text()) == issued[0]


def test_the_page_that_reads_a_certificate_names_keys_that_it_has(issued):
    page = (PROFILES.parent / "docs" / "certificate_audit.md").read_text()
    rows = [line.split("|") for line in page.splitlines() if line.startswith("| 7.8")]
    keys = {key for row in rows for key in re.findall(r"`([a-z_.]+)`", row[4])}
    assert len(keys) > 30
    for key in keys:
        content = issued[0]
        for step in key.split("."):
            assert content is None or step in content, key
            content = None if content is None else content[step]


@pytest.mark.parametrize(
    ("unit", "written"),
    [
        ("deg/h", r"\degree\hour\tothe{-1}"),
        ("deg/sqrt(h)", r"\degree\hour\tothe{-0.5}"),
        ("deg/h/degC^2", r"\degree\hour\tothe{-1}\kelvin\tothe{-2}"),
        ("deg/h per degC/min", r"\degree\hour\tothe{-1}\kelvin\tothe{-1}\minute"),
        ("degC", r"\degreecelsius"),
        ("1", r"\one"),
        ("deg/h per (T * x)", None),
    ],
)
def test_units_are_those_of_the_d_si_or_none(unit, written):
    assert dsi(unit) == written
    assert unit_of("angle_random_walk_dprh") == "deg/sqrt(h)"
