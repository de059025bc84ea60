"""Certificates that are amended, replaced and withdrawn: one of a run is in force, and the registry knows which."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from pathlib import Path

import pytest

from bench.analysis.effects.model import load_model
from bench.analysis.judging.judge import analyse
from bench.archive import archive
from tests.support.commands import bench
from tests.support.dcc import faults
from tests.support.run_folders import make_run, ramp_run

pytest.importorskip("typst")
PROFILES = Path(__file__).parents[2] / "profiles"


@pytest.fixture(scope="module")
def measured(tmp_path_factory):
    folder = tmp_path_factory.mktemp("issuing")
    analyse(make_run(folder / "SIM-0001" / "run", **ramp_run(loop_dph=0.0)), [load_model("spline")], diagnose=False)
    return folder


@pytest.fixture
def root(measured, tmp_path):
    """An archive with one run, that has no certificate yet."""
    shutil.copytree(measured, tmp_path / "reports")
    archive(tmp_path / "reports")
    return tmp_path / "reports"


def issue(root, *options, place="Here"):
    laboratory = root.parent / f"{place}.yaml"
    text = f"laboratory: {{name: Laboratory, address: {place}}}\nauthorised_by: {{name: A. Person}}\n"
    laboratory.write_text(text)
    papers = ("--laboratory", laboratory, "--equipment", PROFILES / "equipment/simulated.yaml")
    return bench("certificate", root / "SIM-0001" / "run", *papers, "--issued", "2026-11-21", *options)


def number_of(root):
    return json.loads((root / "SIM-0001" / "run" / "certificate.json").read_text())["number"]


def states(root):
    done = bench("registry", "certificates", "--out", root, "--json")
    return {row["number"]: row["state"] for row in json.loads(done.stdout)["certificates"]}


def test_an_amended_certificate_is_replaced_and_its_files_are_kept(root):
    assert issue(root).exit_code == 0
    first = number_of(root)
    folder = root / "SIM-0001" / "run"
    kept = {suffix: (folder / f"certificate.{suffix}").read_bytes() for suffix in ("json", "xml", "pdf")}
    done = issue(root, "--amends", first, "--reason", "the address was wrong", place="There")
    assert done.exit_code == 0, done.output
    second = number_of(root)
    assert states(root) == {first: f"replaced by {second}", second: "in force"}
    for name, said in ((f"certificate-{first}.xml", f"was replaced by {second}"), ("certificate.xml", "is in force")):
        done = bench("certificate", "--verify", folder / name, "--archive", root, "--json")
        assert said in json.loads(done.stdout)["state"]
    for suffix, data in kept.items():
        assert (folder / f"certificate-{first}.{suffix}").read_bytes() == data
    facts = json.loads((folder / "certificate.json").read_text())
    assert facts["amends"]["number"] == first
    assert (
        f"Amendment to certificate {first} of 2026-11-21, which it replaces: the address was wrong."
        in facts["statements"]
    )
    xml = (folder / "certificate.xml").read_bytes()
    assert re.search(rf"<dcc:referralID>{first}<", xml.decode())
    if shutil.which("pdftotext"):
        page = subprocess.run(
            ["pdftotext", folder / "certificate.pdf", "-"], capture_output=True, text=True, check=True
        )
        assert f"Amendment to certificate {first}" in " ".join(page.stdout.split())
    rebuilt = bench("registry", "rebuild", "--check", "--out", root)
    assert rebuilt.exit_code == 0, rebuilt.output
    assert faults(xml) == []


def test_the_same_facts_are_the_same_certificate_and_others_replace_it(root):
    issue(root)
    first = number_of(root)
    issue(root)
    assert states(root) == {first: "in force"}
    issue(root, place="There")
    second = number_of(root)
    issue(root, place="There")
    assert number_of(root) == second
    assert states(root) == {first: f"replaced by {second}", second: "in force"}
    assert "no reason was given" in bench("registry", "certificates", "--out", root).stdout


def test_a_withdrawn_certificate_is_not_in_force_and_the_next_one_replaces_nothing(root):
    issue(root)
    first = number_of(root)
    done = bench("certificate", "--withdraw", first, "--reason", "sensor off", "--archive", root)
    assert (done.exit_code, done.stdout.strip()) == (0, f"certificate {first} is withdrawn: sensor off")
    assert states(root) == {first: "withdrawn: sensor off"}
    issue(root, place="There")
    assert states(root) == {first: "withdrawn: sensor off", number_of(root): "in force"}
    assert (root / "SIM-0001" / "run" / f"certificate-{first}.json").is_file()
    (root / "registry.sqlite").unlink()
    assert bench("registry", "rebuild", "--out", root).exit_code == 0
    assert states(root) == {first: "withdrawn: sensor off", number_of(root): "in force"}


@pytest.mark.parametrize("what", ["withdraw", "amends"])
def test_only_what_is_in_force_is_amended_or_withdrawn(root, what):
    issue(root)
    first = number_of(root)
    issue(root, "--amends", first, "--reason", "once", place="There")

    def tried(number, *reason):
        if what == "amends":
            return issue(root, "--amends", number, *reason)
        return bench("certificate", "--withdraw", number, *reason, "--archive", root)

    for number, said in (
        (first, f"certificate {first} was replaced by {number_of(root)}"),
        ("X-1", "no certificate X-1"),
    ):
        done = tried(number, "--reason", "again")
        assert (done.exit_code, done.stderr.count("\n")) == (2, 1), done.output
        assert said in done.stderr
    done = tried(number_of(root))
    assert done.exit_code == 2
    assert "--reason" in done.stderr
