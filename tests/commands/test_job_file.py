"""The job file of a calibration: a damaged one never begins a calibration anew, one never begun stops none."""

import json

import pytest

from bench.base import InputError
from bench.commands.calibration.job import JOB, Done, JobFile
from bench.commands.files import write
from bench.record import CHAIN, chain, faults
from bench.record.files import write_atomically

PLAN = "0" * 64


@pytest.fixture
def unit(tmp_path):
    """The folder of a unit with a job of which one step is done."""
    job = JobFile.create(tmp_path, "SIM-0001", "quick", PLAN)
    job.begin("check")
    job.finish("check", Done("fine"))
    return tmp_path


def file_of(unit):
    return next(unit.glob(f"*/{JOB}"))


def altered(file, digest):
    content = json.loads(file.read_text())
    file.write_text(json.dumps({**content, "digest": digest}, indent=1) + "\n")


def test_a_job_is_found_again_by_its_plan_and_another_plan_finds_none(unit):
    assert JobFile.newest(unit, PLAN).is_done("check")
    assert JobFile.newest(unit, "1" * 64) is None


DAMAGES = {
    "the plan's digest is another": lambda file: altered(file, "1" * 64),
    "an entry that does nothing is another": lambda file: file.write_text(file.read_text().replace("fine", "fin")),
    "halved": lambda file: file.write_bytes(file.read_bytes()[: file.stat().st_size // 2]),
    "emptied": lambda file: file.write_bytes(b""),
    "removed": lambda file: file.unlink(),
    "the list is removed": lambda file: (file.parent / CHAIN).unlink(),
    "altered, and the list removed": lambda file: (altered(file, "1" * 64), (file.parent / CHAIN).unlink()),
    "another job's": lambda file: file.write_bytes(another(file).read_bytes()),
}


def another(file):
    """The job file of the same unit by another plan, elsewhere."""
    other = file.parents[2] / "other"
    JobFile.create(other, "SIM-0001", "quick", "1" * 64)
    return file_of(other)


@pytest.mark.parametrize("plan", [PLAN, "1" * 64], ids=["its plan", "another plan"])
@pytest.mark.parametrize("damage", DAMAGES.values(), ids=DAMAGES)
def test_a_damaged_job_file_never_begins_a_calibration_anew(unit, damage, plan):
    file = file_of(unit)
    damage(file)
    with pytest.raises(InputError, match=rf"{file.parent.name}.*(restore|move)"):
        JobFile.newest(unit, plan)


def test_the_certificate_of_a_job_is_listed_with_its_job(unit):
    folder = file_of(unit).parent
    write(folder / "certificate.pdf", b"paper")
    assert list(faults(folder)) == []
    (folder / "certificate.pdf").write_bytes(b"other paper")
    assert [fault.split(": ")[0] for fault in faults(folder)] == [f"{folder}/certificate.pdf"]


class Killed(BaseException):
    """The bench is gone, at once."""


@pytest.mark.parametrize("writes", [0, 1, 2])
def test_a_kill_while_the_job_is_made_leaves_a_job_or_none(tmp_path, monkeypatch, writes):
    done = []

    def write(path, data, **options):
        if len(done) == writes:
            raise Killed
        done.append(path)
        write_atomically(path, data, **options)

    with monkeypatch.context() as patched:
        patched.setattr(chain, "write_atomically", write)
        with pytest.raises(Killed):
            JobFile.create(tmp_path, "SIM-0001", "quick", PLAN)
    found = JobFile.newest(tmp_path, PLAN)
    assert (found is not None) == (writes == 2)
