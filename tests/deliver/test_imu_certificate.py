"""The certificate of an inertial unit: valid by PTB's schema, every number with its U, refused without evidence."""

import json
from pathlib import Path

import pytest

from bench.record import CertificateRecord, ImuAxisError, ImuFinding, ImuVerificationRecord
from tests.support.commands import bench
from tests.support.dcc import faults, read_back
from tests.support.imu_units import imu_record

pytest.importorskip("typst")
PROFILES = Path(__file__).parents[2] / "profiles"
PAPERS = ("--laboratory", PROFILES / "laboratory/simulated.yaml", "--equipment",
          PROFILES / "equipment/simulated_rate_table.yaml")  # fmt: skip


def certificate(*words):
    return bench("certificate", *words)


def verification(verdict="PASS"):
    axes = tuple(
        ImuAxisError(name=f"{kind} {axis}", unit=unit, raw_rms=40.0, rms=2.5, interval=(2.0, 3.0), mean=0.5,
                     scatter=2.4, peak=8.0, floor=2.0, over_floor=1.25, stated=2.6)
        for kind, unit in (("gyro", "deg/h"), ("accelerometer", "m/s^2")) for axis in "xyz"
    )  # fmt: skip
    return ImuVerificationRecord(
        created="2026-01-02T00:00:00+00:00", verdict=verdict, rows=100, stays=60, fitted_rows=3, rows_beyond=4,
        range_degc=(-20.0, 60.0), axes=axes, rule="as stated",
    )  # fmt: skip


@pytest.fixture(scope="module")
def issued(tmp_path_factory):
    """Folder and answer of a certificate of a verified unit."""
    folder = tmp_path_factory.mktemp("certificate")
    imu_record().write(folder)
    verification().write(folder)
    return folder, certificate(folder, *PAPERS, "--issued", "2030-01-01", "--json")


def test_a_certificate_that_is_amended_is_kept_and_named(tmp_path):
    imu_record().write(tmp_path)
    verification().write(tmp_path)
    assert certificate(tmp_path, *PAPERS, "--issued", "2030-01-01").exit_code == 0
    first = CertificateRecord.read(tmp_path).number
    page = (tmp_path / "certificate.pdf").read_bytes()
    again = certificate(tmp_path, *PAPERS, "--issued", "2030-01-02", "--amends", first, "--reason", "a wrong name")
    assert again.exit_code == 0, again.output
    facts = json.loads((tmp_path / "certificate.json").read_text())
    assert facts["amends"]["number"] == first
    assert f"Amendment to certificate {first} of 2030-01-01, which it replaces: a wrong name." in facts["statements"]
    assert (tmp_path / f"certificate-{first}.pdf").read_bytes() == page
    assert faults((tmp_path / "certificate.xml").read_bytes()) == []
    unknown = certificate(tmp_path, *PAPERS, "--amends", "X-1", "--reason", "a wrong name")
    assert (unknown.exit_code, unknown.output.count("no certificate X-1 here")) == (2, 1)


def test_the_certificate_states_every_parameter_with_its_u(issued):
    folder, answer = issued
    assert answer.exit_code == 0, answer.output
    assert set(json.loads(answer.stdout)) == {
        "run", "pdf", "json", "xml", "number", "verdict", "issued", "simulated", "draft",
    }  # fmt: skip
    facts = json.loads((folder / "certificate.json").read_text())
    assert CertificateRecord.read(folder).number == facts["number"]
    stated = [(one["name"], one["value"], one["expanded"]) for one in facts["parameters"]]
    assert stated == [(one.name, one.value, one.U) for one in imu_record().parameters]
    assert facts["validity"]["certified_degc"] == [-20.0, 60.0]
    told = {one["name"]: one["value"] for one in facts["conditions"]}
    assert told["Its scale"] == "its uncertainty was not stated and is not in U"
    assert (folder / "certificate.pdf").read_bytes().startswith(b"%PDF-")


def test_the_xml_is_valid_by_the_schema(issued):
    assert faults((issued[0] / "certificate.xml").read_bytes()) == []


def test_a_second_reader_finds_value_and_u_in_units_of_the_d_si(issued):
    read = read_back((issued[0] / "certificate.xml").read_bytes())
    for i, value in enumerate(imu_record().parameters):
        size = {"deg/h/g": 1.0 / 9.80665, "ug/g^2": 1e-6 / 9.80665}.get(value.unit, 1.0)
        found = read[f"parameters.{i}.{'si.' if size != 1.0 else ''}value"]
        spread = {key.rpartition("}")[2]: text for key, text in found["expandedUnc"].items()}
        assert float(found["value"]) == pytest.approx(size * value.value, rel=1e-12)
        assert float(spread["uncertainty"]) == pytest.approx(size * value.U, rel=1e-12)
        assert float(spread["coverageFactor"]) == 2.0
    units = {value.unit: read[f"parameters.{i}.{'si.' if value.unit in {'deg/h/g', 'ug/g^2'} else ''}value"]["unit"]
             for i, value in enumerate(imu_record().parameters)}  # fmt: skip
    assert units == {
        "deg/h": r"\degree\hour\tothe{-1}", "ppm": r"\ppm", "mrad": r"\milli\radian",
        "deg/h/g": r"\degree\hour\tothe{-1}\metre\tothe{-1}\second\tothe{2}", "m/s^2": r"\metre\second\tothe{-2}",
        "ug/g^2": r"\metre\tothe{-1}\second\tothe{2}",
    }  # fmt: skip
    assert read["verification.axes.3.stated"] == {"value": "2.6", "unit": r"\metre\second\tothe{-2}"}


def test_a_failed_verification_ends_with_exit_code_1_and_none_certifies_no_range(tmp_path):
    imu_record().write(tmp_path)
    done = certificate(tmp_path, *PAPERS)
    assert done.exit_code == 0
    assert "verification: none: it certifies no range" in done.stdout
    verification("FAIL").write(tmp_path)
    done = certificate(tmp_path, *PAPERS)
    assert done.exit_code == 1
    assert "verification: FAIL" in done.stdout


LAG = ImuFinding(cause="thermal_lag", where="gyro x", text="gyro x lacks thermal_lag")


@pytest.mark.parametrize(
    ("update", "words", "why"),
    [
        ({"findings": (LAG,)}, PAPERS, "no certificate: gyro x: gyro x lacks thermal_lag"),
        ({"undetermined": ("gyro x: bias: why",)}, PAPERS, "no certificate: not determined: gyro x: bias"),
        ({"unit": ""}, PAPERS, "the unit has no serial number; calibrate with --unit"),
        ({}, (), "no certificate: no laboratory and no signatory"),
        ({}, (*PAPERS, "--limits", PROFILES / "limits/mems.yaml"), "with `bench imu TABLE --verify`"),
    ],
)
def test_what_cannot_be_certified_is_one_line(tmp_path, update, words, why):
    imu_record().model_copy(update=update).write(tmp_path)
    done = certificate(tmp_path, *words)
    assert done.exit_code == 2
    assert why in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1


def test_a_draft_says_what_is_missing(tmp_path):
    imu_record().write(tmp_path)
    done = certificate(tmp_path, "--draft")
    assert done.exit_code == 0, done.output
    assert "DRAFT: no laboratory and no signatory; no equipment" in done.stdout
    assert (tmp_path / "draft.pdf").is_file()
    assert not (tmp_path / "certificate.json").exists()


def test_the_certificate_of_a_simulated_unit_says_so_and_is_signed_as_such(tmp_path):
    imu_record().model_copy(update={"simulated": True}).write(tmp_path)
    done = certificate(tmp_path, *PAPERS)
    assert "(simulated: not valid as a certificate)" in done.stdout
    assert "signed by" in done.stdout
    checked = certificate("--verify", tmp_path / "certificate.pdf")
    assert checked.exit_code == 0, checked.output
    assert checked.stdout.startswith("sound")
