"""What `bench calibrate` leaves of a unit that went from the shelf to verified."""

import json
from pathlib import Path
from xml.etree.ElementTree import fromstring

from bench.commands.calibration.job import JobFile
from bench.record import JobRecord
from tests.support.commands import bench
from tests.support.dcc import read_back


def check_calibrated(folder: Path, said: str) -> None:
    """Every step was done once, its verdict is told twice, and its certificate is sound and says what was measured."""
    assert said.count("PASS: unit SIM-0001") == 2
    report = fromstring((folder / "calibrate.xml").read_bytes())
    assert (report.get("failures"), report.get("errors")) == ("0", "0")
    (file,) = folder.glob("reports/SIM-0001/*/job.json")
    job = JobFile(file.parent, JobRecord.read(file.parent).content())
    assert {step["attempts"] for step in job.content["steps"].values()} == {1}
    assert job.facts("verify")["factor"] > 10
    compared = json.loads((file.parent.parent / job.facts("run")["run"] / "compare.json").read_text())
    assert compared["static"] == job.facts("static")["run"]
    assert list(folder.glob("reports/*.sqlite*"))
    pdf = job.folder / str(job.facts("certificate")["pdf"])
    checked = json.loads(bench("certificate", "--verify", pdf, "--json").stdout)
    assert checked["sound"], checked
    assert checked["number"] == job.facts("certificate")["number"]
    xml = pdf.with_suffix(".xml").read_bytes()
    facts = json.loads(pdf.with_suffix(".json").read_text())
    read = read_back(xml)
    assert read["as_left.rms_dph"]["value"] == json.dumps(facts["as_left"]["rms_dph"])
    assert read["uncertainty.expanded_dph"]["value"] == json.dumps(facts["uncertainty"]["expanded_dph"])
    digit = read["as_left.rms_dph"]["value"].encode()
    (folder / "changed.xml").write_bytes(xml.replace(digit, digit[:-1] + (b"1" if digit[-1:] != b"1" else b"2")))
    assert bench("certificate", "--verify", folder / "changed.xml").exit_code == 1
