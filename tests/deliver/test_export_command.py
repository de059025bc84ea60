"""`bench export`: every format contains the same words, other tools read them; untrusted calibrations are refused."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from pathlib import Path

import bincopy
import numpy as np
import pytest
from click.testing import CliRunner

from bench.cli import main
from bench.deliver.export.formats import FORMATS
from bench.deliver.export.image import read
from bench.deliver.export.words import float_of, to_words
from tests.support.report_runs import quick
from tests.support.run_folders import keep, make_run, ramp_run


@pytest.fixture(scope="module")
def run_folder(tmp_path_factory) -> Path:
    made = make_run(tmp_path_factory.mktemp("export") / "run", **ramp_run())
    quick(made, "spline_lag_loop")
    return made


@pytest.fixture
def altered(run_folder, tmp_path):
    """A copy of the run with something changed in manifest.json or calibration.json."""

    def change(name: str, edit) -> Path:
        copy = tmp_path / "copy"
        shutil.copytree(run_folder, copy)
        content = json.loads((copy / name).read_text())
        edit(content)
        keep(copy, name, content)
        return copy

    return change


def bench(*arguments: object):
    return CliRunner().invoke(main, ["export", *map(str, arguments)], catch_exceptions=False)


@pytest.fixture(scope="module")
def files(run_folder, tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("files")
    for name in FORMATS:
        done = bench(run_folder, "--format", name, "--out", out, "--address", 0x8000)
        assert done.exit_code == 0, done.output
    return out


@pytest.mark.slow
def test_all_formats_carry_the_same_words(files):
    words = to_words((files / "calibration.bin").read_bytes())
    assert read(words).serial == 1
    assert json.loads((files / "calibration.json").read_text())["words"] == words
    for name in ("hex", "srec"):
        placed = bincopy.BinFile(str(files / f"calibration.{name}"))
        assert placed.minimum_address == 0x8000
        assert to_words(bytes(placed.as_binary())) == words
    assert f"0x{words[-1]:08X}" in (files / "calibration.h").read_text()


@pytest.mark.skipif(shutil.which("objcopy") is None, reason="needs binutils")
@pytest.mark.parametrize(("name", "kind"), [("hex", "ihex"), ("srec", "srec")])
def test_binutils_reads_the_same_bytes(files, tmp_path, name, kind):
    out = tmp_path / "out.bin"
    source = files / f"calibration.{name}"
    subprocess.run(["objcopy", "-I", kind, "-O", "binary", str(source), str(out)], check=True, capture_output=True)
    assert out.read_bytes() == (files / "calibration.bin").read_bytes()


def test_the_json_answer_names_files_identity_and_errors(run_folder, tmp_path):
    done = bench(run_folder, "--format", "c", "--out", tmp_path, "--json")
    answer = json.loads(done.stdout)
    assert done.exit_code == 0
    assert [Path(file).name for file in answer["files"]] == ["calibration.h", "calibration.c"]
    assert answer["form"] == "split_fixed"
    assert {row["form"] for row in answer["forms"]} == {"float32", "fixed", "split", "split_fixed"}
    assert answer["worst_error_dph"] == min(max(row["everywhere"], row["moving"]) for row in answer["forms"])
    assert answer["model_apart_dph"] < 1e-4
    assert answer["objections"] == []


def test_the_same_run_makes_the_same_image(run_folder, tmp_path):
    one, two = tmp_path / "one", tmp_path / "two"
    for out in (one, two):
        bench(run_folder, "--format", "eeprom", "--out", out, "--serial", 77)
    assert (one / "calibration.bin").read_bytes() == (two / "calibration.bin").read_bytes()
    assert read(to_words((one / "calibration.bin").read_bytes())).serial == 77


def test_without_out_the_files_stand_in_the_run_folder(altered):
    folder = altered("manifest.json", lambda content: None)
    assert bench(folder, "--format", "csv").exit_code == 0
    rows = (folder / "export" / "calibration.csv").read_text().splitlines()
    assert rows[0] == "what,block,i,j,value,stored,unit"
    assert any(row.startswith("spline,0,") for row in rows)


def test_a_form_of_ones_own_choice_and_another_model(run_folder, tmp_path):
    done = bench(run_folder, "--format", "eeprom", "--form", "float32", "--model", "polynomial", "--out", tmp_path)
    assert done.exit_code == 0, done.output
    image = read(to_words((tmp_path / "calibration.bin").read_bytes()))
    assert (image.form, image.model_kind, len(image.coefficients)) == ("float32", 1, 4)
    assert np.isfinite([float_of(word) for word in image.coefficients]).all()


def test_the_a2l_opens_what_it_closes_and_points_at_the_words(files):
    text = (files / "calibration.a2l").read_text()
    words = to_words((files / "calibration.bin").read_bytes())
    assert text.count("/begin ") == text.count("/end ")
    assert f"VALUE 0x{0x8000 + 4 * (len(words) - 1):X} word" in text
    assert f"NUMBER {len(read(words).coefficients)}" in text


def edit_state(content):
    content.update(state="aborted", cause="guard: door")


def edit_condition(content):
    content["calibration"]["condition"] = 1e11


def edit_amplitude(content):
    content["calibration"]["scaled"]["values"][0] += 1.0


@pytest.mark.parametrize(
    ("name", "edit", "why"),
    [
        ("manifest.json", edit_state, "the run is 'aborted' \\(guard: door"),
        ("calibration.json", lambda c: c["verdict"].update(verdict="unproven"), "no unseen data proves the model"),
        ("calibration.json", lambda c: c["verdict"].update(admissible=False), "do not fit together"),
        ("calibration.json", edit_condition, "condition is 1e\\+11, limit 1e\\+09"),
    ],
)  # fmt: skip
def test_a_calibration_not_to_trust_is_refused_in_one_line_unless_forced(altered, tmp_path, name, edit, why):
    folder = altered(name, edit)
    done = bench(folder, "--format", "hex")
    assert done.exit_code == 2
    assert done.stderr.count("\n") == 1
    assert "not delivered" in done.stderr
    assert "--force" in done.stderr
    assert re.search(why, done.stderr)
    assert not (folder / "export").exists()
    forced = bench(folder, "--format", "hex", "--force", "--json")
    assert forced.exit_code == 0
    assert re.search(why, json.loads(forced.stdout)["objections"][0])


def test_a_run_with_a_hole_in_its_temperatures_is_refused(tmp_path):
    """Data at -40 and at 85 degC only: a cubic between them is not determined."""
    made = ramp_run(loop_dph=0.0)
    columns = made["columns"]
    celsius = columns["temperature"]
    columns["temperature"] = np.where((celsius < -30) | (celsius > 75), celsius, np.nan)
    folder = make_run(tmp_path / "hole", **made)
    quick(folder, "polynomial")
    done = bench(folder, "--format", "json")
    assert done.exit_code == 2
    assert "is not covered" in done.stderr


@pytest.mark.parametrize(
    ("name", "edit", "why"),
    [
        ("calibration.json", edit_amplitude, "it belongs to other data"),
        ("calibration.json", lambda c: c.update(calibration=None), "holds no calibration"),
        ("calibration.json", lambda c: c["calibration"].pop("scaled"), "lacks the numbers of its fit"),
        ("manifest.json", lambda c: c.update(unit="unit"), "give one with --serial"),
    ],
)
def test_what_cannot_be_read_as_a_calibration_is_refused_even_if_forced(altered, name, edit, why):
    done = bench(altered(name, edit), "--format", "hex", "--force")
    assert done.exit_code == 2
    assert why in done.stderr
    assert done.stderr.count("\n") == 1


@pytest.mark.parametrize(
    ("arguments", "why"),
    [
        (("--format", "xls"), "allowed are json, csv, c, hex, srec, eeprom, a2l"),
        (("--format", "hex", "--form", "float16"), "allowed are float32"),
        (("--format", "c", "--name", "My Unit"), "not a valid C name"),
        (("--format", "c", "--model", "nonesuch"), "unknown model"),
    ],
)
def test_a_wrong_wish_is_refused_with_what_is_allowed(run_folder, tmp_path, arguments, why):
    done = bench(run_folder, *arguments, "--out", tmp_path / "none")
    assert done.exit_code == 2
    assert why in done.stderr
    assert not list((tmp_path / "none").glob("*"))


def test_no_run_is_refused(tmp_path):
    done = bench(tmp_path / "nothing", "--format", "c")
    assert (done.exit_code, "no such run folder" in done.stderr) == (2, True)
