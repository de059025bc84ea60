"""A calibration from a run into a simulated station's unit, and what runs make of a unit that corrects itself."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner

from bench.acquisition.run.runner import run_job
from bench.acquisition.station.memory import open_alone
from bench.analysis.effects.model import Model
from bench.analysis.effects.registry import make
from bench.analysis.fit.fitting import fit_model
from bench.analysis.judging.change import Figures
from bench.analysis.judging.verification import refuse_same_profile, verify
from bench.base import EquipmentError, InputError, read_yaml
from bench.cli import main
from bench.commands.flash_record import newest_record, records
from bench.commands.flash_source import Calibration, from_file, from_run, newest_run
from bench.commands.flash_unit import AlreadyThereError, flash, flash_previous, objection
from bench.deliver.export.image import read
from bench.deliver.export.words import to_words
from bench.record import FlashRecord, Verdict
from bench.record.reading import load
from drivers.errors import IdentityError, LinkError, RefusedError
from drivers.flash_objects import Memory
from tests.support import acquisition, flash_bench
from tests.support.run_folders import keep

NOW_S = 1_800_000_000


def calibration(shift_dps: float = 0.01, created: int = 1_700_000_000, **wishes) -> Calibration:
    content = flash_bench.image(**{"serial": 1, "shift_dps": shift_dps, "created": created} | wishes)
    return Calibration(content, read(to_words(content)))


def station(**unit):
    described = {"serial": "SIM-0001", "bus": "can0", "number": 0, "identity": 1, **unit}
    return acquisition.station(units=[described])


@pytest.fixture(scope="module")
def flashed(tmp_path_factory):
    """Folder of runs of a unit that was flashed once; the image takes 36 deg/h off."""
    out = tmp_path_factory.mktemp("flashed")
    settings = station()
    flash(settings, settings.units[0], calibration(), out)
    return out


def recorded(out, compensation="off", **unit):
    settings = station(**unit).remembering(out)
    return run_job(replace(acquisition.job(out, settings=settings), compensation=compensation))


@pytest.mark.parametrize("way", [{}, {"transfer": "expedited", "node": 5}, {"protocol": "uds", "request": 0x6FE}])
def test_a_flash_leaves_a_record_and_a_unit_that_a_later_process_finds(tmp_path, way):
    settings = station(flash=way)
    unit = settings.units[0]
    steps = []
    first = flash(settings, unit, calibration(), tmp_path, onlooker=steps.append)
    assert steps[-1] == "read again"
    assert (first.bank, first.coefficient_set, first.old, first.state) == (1, 1, None, "done")
    second = flash(settings, unit, calibration(0.02, id_=2), tmp_path)
    assert second.old.sha256 == first.new.sha256
    assert (tmp_path / "SIM-0001" / "flash" / second.old.file).read_bytes() == calibration().content
    assert newest_record(tmp_path, "SIM-0001").content() == second.content()
    assert json.loads((tmp_path / "SIM-0001" / "flash").joinpath(second.record.rpartition("/")[2]).read_text())
    with open_alone(settings.remembering(tmp_path), unit) as store:
        assert store.active() == 2
        assert store.number(Memory.SET) == 2


def test_a_flash_that_was_killed_before_its_record_is_recorded_when_it_is_given_again(tmp_path, monkeypatch):
    class Killed(BaseException):
        """SIGKILL: nothing after it runs."""

    settings = station()

    def killed(*_):
        raise Killed

    with monkeypatch.context() as patched:
        patched.setattr("bench.commands.flash_record.Attempt.end", killed)  # the unit is written, its record is not
        with pytest.raises(Killed):
            flash(settings, settings.units[0], calibration(), tmp_path)
    assert newest_record(tmp_path, "SIM-0001") is None
    with pytest.raises(AlreadyThereError):
        flash(settings, settings.units[0], calibration(), tmp_path)
    record = newest_record(tmp_path, "SIM-0001")
    assert (record.state, record.bank, record.coefficient_set) == ("done", 1, 1)
    assert record.calibration_id == calibration().image.label
    assert len(list((tmp_path / "SIM-0001" / "flash").glob("*.json"))) == 1


def test_the_calibration_in_force_is_not_written_again(flashed):
    settings = station()
    with pytest.raises(AlreadyThereError):
        flash(settings, settings.units[0], calibration(), flashed)


def test_a_stale_calibration_is_refused_unless_it_is_meant(tmp_path):
    settings = station()
    flash(settings, settings.units[0], calibration(created=1_700_000_000), tmp_path)
    stale = calibration(0.03, created=1_600_000_000)
    with pytest.raises(
        InputError, match=r"^not flashed: stale: the calibration is of 2020-09-13.*holds a newer one.*--older"
    ):
        flash(settings, settings.units[0], stale, tmp_path)
    assert flash(settings, settings.units[0], stale, tmp_path, older=True).bank == 2


def test_the_calibration_of_another_unit_is_refused_and_the_attempt_recorded(tmp_path):
    settings = station()
    with pytest.raises(IdentityError, match="serial number in its memory is 1, the image is for 2"):
        flash(settings, settings.units[0], calibration(serial=2), tmp_path)
    records = [json.loads(path.read_text()) for path in (tmp_path / "SIM-0001" / "flash").glob("*.json")]
    assert [record["state"] for record in records] == ["failed"]
    assert newest_record(tmp_path, "SIM-0001") is None


def test_an_expired_calibration_is_refused():
    image = replace(calibration().image, valid_until=NOW_S - 1)
    assert "was valid until 2027-01-15" in objection(image, b"", NOW_S, older=True)
    assert objection(replace(image, valid_until=NOW_S + 1), b"", NOW_S, older=False) is None
    assert objection(image, b"no image", NOW_S - 9, older=False) is None


def test_runs_that_must_not_be_flashed(tmp_path, short_run):
    unit = station().units[0]
    with pytest.raises(InputError, match="no such run folder"):
        from_run(tmp_path / "none", unit)
    with pytest.raises(InputError, match="make it again with `bench report`"):
        from_run(short_run.path, unit)
    with pytest.raises(InputError, match="is a run of unit SIM-0001, this is unit OTHER"):
        from_run(short_run.path, unit.model_copy(update={"serial": "OTHER"}))
    with pytest.raises(InputError, match="no run of unit SIM-0001 with a calibration"):
        newest_run(tmp_path, "SIM-0001")
    folder = tmp_path / "SIM-0001" / "run"
    folder.mkdir(parents=True)
    manifest = {"format": 1, "unit": "SIM-0001", "created": "2026-01-01"}
    for facts, stored, judged, why in (
        ({"purpose": "verification"}, {}, {}, "is a verification"),
        ({}, {"refusals": ["the run is partial"]}, {}, "not flashed: the run is partial"),
        ({}, {}, {"name": "ours", "verdict": "FAIL"}, "verdict against limits ours is FAIL"),
        ({}, {"calibration": None}, {}, "holds no calibration"),
    ):
        for name, content in (("manifest", manifest | facts), ("calibration", stored), ("limits", judged)):
            keep(folder, f"{name}.json", content)
        with pytest.raises(InputError, match=why):
            from_run(folder, unit)


def test_images_in_files(tmp_path):
    path = tmp_path / "x.bin"
    path.write_bytes(calibration().content)
    assert from_file(path).image.label == calibration().image.label
    path.write_bytes(b"nothing")
    with pytest.raises(InputError, match="not a calibration image"):
        from_file(path)
    with pytest.raises(InputError, match="cannot be read"):
        from_file(tmp_path / "none")


def test_a_calibration_run_of_a_flashed_unit_records_its_raw_rate(flashed, short_run):
    """It is told to stop for the run and corrects itself again after it; the numbers are those of a blank unit."""
    result = recorded(flashed)
    assert result.error is None
    manifest = result.run.manifest()
    assert manifest.purpose == "calibration"
    told = [event["text"] for event in result.run.events() if event["kind"] == "compensation"]
    assert told == [
        "unit SIM-0001 sends its raw rate for this run (coefficient set 1 is off)",
        "unit SIM-0001 corrects its rate again",
    ]
    assert manifest.unit_identity.coefficient_set == 0
    raw, blank = load(result.run.path, 1.0), load(short_run.path, 1.0)
    inside = raw.segment >= 0
    assert np.abs(np.nanmean(raw.bias[inside]) - np.nanmean(blank.bias[blank.segment >= 0])) < 1.0


def test_a_verification_run_records_the_corrected_rate_and_nothing_is_fitted_to_it(flashed, short_run):
    result = recorded(flashed, "on")
    assert result.error is None
    manifest = result.run.manifest()
    assert manifest.purpose == "verification"
    assert manifest.unit_identity.coefficient_set == 1
    corrected, blank = load(result.run.path, 10.0), load(short_run.path, 10.0)
    shift = np.nanmean(blank.bias) - np.nanmean(corrected.bias)
    assert shift == pytest.approx(3600 * 0.011, abs=1.0)  # what the image takes off near 25 degC
    with pytest.raises(InputError, match=r"the unit corrected its rate itself during this run: it is a verification"):
        fit_model(Model("line", (make("polynomial", {"order": 1}),)), corrected)
    found = verify(result.run, None, None, {"bank": 1})
    assert found.verdict is Verdict.INVALID  # no soak of five minutes to read the noise from
    stored = json.loads((result.run.path / "verification.json").read_text())
    assert stored["after"]["rms_dph"] == pytest.approx(found.change.after.rest.rms_dph)
    assert stored["in_unit"] == {"bank": 1}
    with pytest.raises(InputError, match="is not a verification"):
        verify(short_run, None, None, {})


def test_a_blank_unit_cannot_be_verified(tmp_path):
    result = recorded(tmp_path, "on")
    assert isinstance(result.error, InputError)
    assert "sends its raw rate; write a calibration with `bench flash SIM-0001`" in str(result.error)


def test_a_unit_that_cannot_be_told_to_stop_is_not_calibrated_again(flashed, monkeypatch):
    def deaf(self, on):
        raise RefusedError("no such object", 1)

    monkeypatch.setattr("drivers.coefficients.CoefficientStore.compensate", deaf)
    result = recorded(flashed)
    assert isinstance(result.error, EquipmentError)
    assert "unit SIM-0001 corrects its rate (coefficient set 1) and cannot be told to stop: no such" in str(
        result.error
    )


def test_a_unit_that_starts_anew_and_corrects_again_ends_the_run(flashed, monkeypatch):
    """It forgets with its power that it was told to send its raw rate."""
    from drivers.sim.flash_port import FlashPort

    ports = []
    made = FlashPort.__init__

    def remembering(self, *args):
        made(self, *args)
        ports.append(self)

    monkeypatch.setattr(FlashPort, "__init__", remembering)
    settings = station().remembering(flashed)

    def cut(station, status):
        if status.t_s > 60 and ports[0].memory.coefficient_set == 0:
            ports[0].power_up()

    result = run_job(acquisition.job(flashed, settings=settings), cut)
    assert isinstance(result.error, EquipmentError)
    assert "started anew and corrects its rate again" in str(result.error)


def test_the_profile_of_the_calibration_does_not_verify_it(short_run):
    with pytest.raises(InputError, match="is the profile of the calibration run"):
        refuse_same_profile(read_yaml(short_run.path / "profile.yaml"), short_run.path)
    refuse_same_profile(read_yaml(short_run.path / "station.yaml"), short_run.path)
    refuse_same_profile(read_yaml(short_run.path / "profile.yaml"), None)


def test_figures_say_what_they_are(short_run):
    data = load(short_run.path, 10.0)
    figures = Figures.of(data)
    assert figures.rms_dph**2 == pytest.approx(figures.mean_dph**2 + figures.scatter_dph**2)
    assert figures.span_dph <= 2 * figures.peak_dph
    assert figures.interval_s == 10.0


def banks(settings, out):
    """The bank in force, and what both hold."""
    with open_alone(settings.remembering(out), settings.units[0]) as store:
        return store.active(), store.read(1), store.read(2)


@pytest.mark.parametrize("way", [{}, {"transfer": "expedited"}, {"protocol": "uds"}])
def test_a_unit_goes_back_to_the_calibration_before_and_on_again(tmp_path, way):
    settings = station(flash=way)
    unit = settings.units[0]
    old, new = calibration(), calibration(0.02, id_=2)
    first = flash(settings, unit, old, tmp_path)
    flash(settings, unit, new, tmp_path)
    steps = []
    back = flash_previous(settings, unit, tmp_path, steps.append)
    assert steps == ["serial number", "archive", "CRC", "switch", "reset", "heartbeat", "read again"]
    assert banks(settings, tmp_path) == (1, old.content, new.content)
    assert (back.action, back.state, back.bank, back.old_bank, back.coefficient_set) == ("previous", "done", 1, 2, 3)
    assert (back.calibration_id, back.new.sha256, back.crc) == (old.image.label, first.new.sha256, first.crc)
    assert back.read_back == "all words equal, after the reset"
    folder = tmp_path / "SIM-0001" / "flash"
    assert (folder / back.old.file).read_bytes() == new.content
    assert (folder / back.new.file).read_bytes() == old.content
    assert newest_record(tmp_path, "SIM-0001").content() == back.content()
    assert flash_previous(settings, unit, tmp_path).calibration_id == new.image.label
    assert banks(settings, tmp_path) == (2, old.content, new.content)


def test_the_run_of_the_calibration_before_says_that_it_is_in_force_again(tmp_path, short_run):
    settings = station()
    run = tmp_path / "SIM-0001" / short_run.path.name
    shutil.copytree(short_run.path, run)
    flash(settings, settings.units[0], replace(calibration(), run=run, model="spline"), tmp_path)
    flash(settings, settings.units[0], calibration(0.02, id_=2), tmp_path)
    back = flash_previous(settings, settings.units[0], tmp_path)
    assert (back.run, back.model) == (str(run), "spline")
    assert FlashRecord.read(run).coefficient_set == 3


def test_a_unit_without_a_calibration_before_is_left_as_it_is(flashed, tmp_path):
    settings = station()
    with pytest.raises(InputError, match=r"^unit SIM-0001 has no calibration in force, so it has no previous one$"):
        flash_previous(settings, settings.units[0], tmp_path)
    empty = r"^unit SIM-0001 has no previous calibration: bank 2 is empty; the calibration in bank 1 stays in force$"
    with pytest.raises(InputError, match=empty):
        flash_previous(settings, settings.units[0], flashed)
    assert banks(settings, flashed)[0] == 1


@pytest.mark.parametrize(
    ("left", "why"),
    [
        (calibration(0.03, id_=3).content[:-4] + b"torn", "bank 2 holds no whole calibration"),
        (calibration(serial=2).content, "in bank 2 is of serial number 2, this unit is 1"),
    ],
)
def test_what_is_no_calibration_of_the_unit_is_not_put_in_force(tmp_path, left, why):
    settings = station()
    flash(settings, settings.units[0], calibration(), tmp_path)
    with open_alone(settings.remembering(tmp_path), settings.units[0]) as store:
        store.put_image(2, left)
    with pytest.raises(InputError, match=f"{why}.*; the calibration in bank 1 stays in force$"):
        flash_previous(settings, settings.units[0], tmp_path)
    assert banks(settings, tmp_path)[:2] == (1, calibration().content)
    assert [record.state for record in records(tmp_path / "SIM-0001" / "flash")] == ["done"]


def test_a_calibration_that_was_written_and_never_in_force_is_no_previous_one(tmp_path, monkeypatch):
    settings = station()
    flash(settings, settings.units[0], calibration(), tmp_path)

    def deaf(self):
        raise RefusedError("not now", 1)

    with monkeypatch.context() as patched:
        patched.setattr("drivers.coefficients.CoefficientStore.switch", deaf)
        with pytest.raises(RefusedError, match="step 'switch' failed"):
            flash(settings, settings.units[0], calibration(0.02, id_=2), tmp_path)
    with pytest.raises(InputError, match=r"in bank 2 was written at .* and never put in force; the calibration in"):
        flash_previous(settings, settings.units[0], tmp_path)


def test_a_calibration_that_has_expired_is_not_put_back(tmp_path):
    settings = station()
    expired = flash_bench.image(serial=1, valid_until=1_750_000_000)
    with open_alone(settings.remembering(tmp_path), settings.units[0]) as store:
        store.program(expired)
    flash(settings, settings.units[0], calibration(0.02, id_=2), tmp_path)
    with pytest.raises(
        InputError, match=r"^not put back: the calibration was valid until 2025-06-15.*calibrate again$"
    ):
        flash_previous(settings, settings.units[0], tmp_path)
    assert banks(settings, tmp_path)[:2] == (2, expired)


@pytest.mark.parametrize("end", [KeyboardInterrupt, LinkError("cable")])
def test_a_unit_that_went_back_before_the_end_was_recorded_is_not_turned_once_more(tmp_path, monkeypatch, end):
    """The switch is a toggle: the same command again must complete the record, not undo what it did."""
    settings = station()
    old = calibration()
    flash(settings, settings.units[0], old, tmp_path)
    flash(settings, settings.units[0], calibration(0.02, id_=2), tmp_path)

    def ended(*_):
        raise end

    with monkeypatch.context() as patched:
        patched.setattr("drivers.coefficients._started", ended)
        with pytest.raises((KeyboardInterrupt, LinkError)):
            flash_previous(settings, settings.units[0], tmp_path)
    with pytest.raises(AlreadyThereError):
        flash_previous(settings, settings.units[0], tmp_path)
    record = newest_record(tmp_path, "SIM-0001")
    assert (record.action, record.state, record.error, record.bank) == ("previous", "done", None, 1)
    assert banks(settings, tmp_path)[:2] == (1, old.content)


def test_the_command_that_goes_back(tmp_path):
    def bench(*words):
        return CliRunner().invoke(main, ["flash", "SIM-0001", "--quiet", "--out", str(tmp_path), *words])

    for number in (1, 2):
        path = tmp_path / f"{number}.bin"
        path.write_bytes(calibration(0.01 * number, id_=number).content)
        assert bench("--image", str(path)).exit_code == 0
    mixed = bench("--previous", "--older")
    assert (mixed.exit_code, mixed.stderr.count("\n")) == (2, 1)
    assert "leave out --run, --image, --form, --model, --check and --older" in mixed.stderr
    done = bench("--previous")
    assert done.exit_code == 0, done.output
    assert "back in force in bank 1, before: " in done.stdout
    assert "coefficient set 3" in done.stdout
