"""`bench export` of a whole inertial unit: one image, code that compensates as the fit does, files for others."""

import csv
import ctypes
import json
import re
import shutil
import subprocess
from dataclasses import replace

import bincopy
import numpy as np
import pytest
import yaml
from click.testing import CliRunner
from scipy.interpolate import BSpline

from bench.analysis.imu.stored import curves_of
from bench.analysis.imu.triad import Curve, TriadModel
from bench.base import InputError
from bench.cli import main
from bench.deliver.export.autopilots import ardupilot, px4
from bench.deliver.export.imu_formats import AXIS_NAMES, IMU_FORMATS
from bench.deliver.export.imu_image import FLAG_NO_VALUE, compensate, image_of, read_imu, words_of
from bench.deliver.export.words import crc, to_bytes, to_words
from bench.record import ImuFinding, ImuRecord
from tests.support.c_unit import FLAGS
from tests.support.imu_units import fitted, imu_record

HARNESS = """
#include "calibration.h"
void run(int32_t rows, const float *in, float *out, uint32_t *flags);
void run(int32_t rows, const float *in, float *out, uint32_t *flags)
{
    int32_t row;
    uint32_t i;
    for (row = 0; row < rows; row++)
    {
        calibration_input_t input;
        calibration_output_t output;
        for (i = 0U; i < 3U; i++)
        {
            input.rate[i] = in[(row * 10) + (int32_t)i];
            input.acceleration[i] = in[(row * 10) + 3 + (int32_t)i];
        }
        for (i = 0U; i < 4U; i++) { input.temperature[i] = in[(row * 10) + 6 + (int32_t)i]; }
        flags[row] = calibration_step(&input, &output);
        for (i = 0U; i < 3U; i++)
        {
            out[(row * 12) + (int32_t)i] = output.rate[i];
            out[(row * 12) + 3 + (int32_t)i] = output.acceleration[i];
            out[(row * 12) + 6 + (int32_t)i] = output.rate_correction[i];
            out[(row * 12) + 9 + (int32_t)i] = output.acceleration_correction[i];
        }
    }
}
"""


@pytest.fixture
def folder(tmp_path):
    imu_record().write(tmp_path)
    return tmp_path


def bench(*arguments):
    return CliRunner().invoke(main, ["export", *map(str, arguments)], catch_exceptions=False)


def samples(rows=2000):
    """Raw rates [deg/s], forces [m/s^2] and temperatures [degC]: over the whole range and beyond its ends."""
    random = np.random.default_rng(3)
    rate, force = random.uniform(-300.0, 300.0, (rows, 3)), random.uniform(-60.0, 60.0, (rows, 3))
    return rate, force, random.uniform(-40.0, 85.0, (rows, 4))


def test_the_image_compensates_as_the_fit_does():
    rows, fit = fitted()
    image = image_of(imu_record(), 42, 7, 0)
    temperatures = np.column_stack([rows.gyro.temperature, rows.accelerometer.temperature[:, 0]])
    found = compensate(image, rows.gyro.output / 3600.0, rows.accelerometer.output, temperatures)
    rate, force = fit.corrected(rows.gyro, rows.accelerometer)
    assert 3600.0 * found.rate == pytest.approx(rate, abs=1e-6)
    assert found.force == pytest.approx(force, abs=1e-9)
    assert not found.flags.any()


def test_the_curves_of_a_record_are_those_of_the_fit():
    rows, fit = fitted()
    again = curves_of(imu_record())
    for one, other in zip(again.corrected(*(rows.gyro, rows.accelerometer)),
                          fit.corrected(rows.gyro, rows.accelerometer), strict=True):  # fmt: skip
        assert one == pytest.approx(other, rel=1e-12)
    for stored, own in zip((again.gyro, again.accelerometer), fit.triads, strict=True):
        assert [e.U for e in stored.estimates([25.0])] == pytest.approx([e.U for e in own.estimates([25.0])])


def test_what_the_image_makes_of_simulated_truth_is_the_truth():
    """Another judge than the fit: rates and forces that went into the unit come out again."""
    from benchmarks import imu_data
    from drivers.sim.truth.imu.drawn import drawn
    from drivers.sim.truth.imu.unit import respond

    random = np.random.default_rng(8)
    rate, force = random.uniform(-60.0, 60.0, (50, 3)), random.uniform(-9.8, 9.8, (50, 3))
    warm = [random.uniform(-20.0, 60.0, 50) for _ in range(4)]
    raw = respond(drawn(1), 3600.0 * rate, force, [warm[min(i, 3)] for i in range(6)])
    found = compensate(image_of(imu_record(), 42, 7, 0), raw[:, :3] / 3600.0, raw[:, 3:], np.transpose(warm))
    assert imu_data.LATITUDE_DEG  # the unit of the record
    assert found.rate == pytest.approx(rate, abs=4e-3)
    assert found.force == pytest.approx(force, abs=3e-3)
    assert np.abs(raw[:, :3] / 3600.0 - rate).max() > 0.2


@pytest.mark.skipif(shutil.which("gcc") is None, reason="needs gcc")
def test_the_c_code_agrees_with_double_precision_to_that_of_a_float(folder, tmp_path):
    assert bench(folder, "--format", "c", "--out", tmp_path).exit_code == 0
    (tmp_path / "harness.c").write_text(HARNESS)
    made = tmp_path / "calibration.so"
    done = subprocess.run(
        ["gcc", *FLAGS, "-shared", "-fPIC", "-o", made, tmp_path / "calibration.c", tmp_path / "harness.c"],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    rate, force, degc = samples()
    rate[3, 1], force[4, 2], degc[5, 0] = np.nan, np.inf, np.nan
    given = np.ascontiguousarray(np.hstack([rate, force, degc]), dtype=np.float32)
    out, flags = np.zeros((len(given), 12), dtype=np.float32), np.zeros(len(given), dtype=np.uint32)
    pointer = ctypes.c_void_p
    ctypes.CDLL(str(made)).run(
        ctypes.c_int32(len(given)), pointer(given.ctypes.data), pointer(out.ctypes.data), pointer(flags.ctypes.data)
    )
    exact = given.astype(np.float64)
    wanted = compensate(read_imu(words_of(image_of(imu_record(), 42, 7, 0))), exact[:, :3], exact[:, 3:6], exact[:, 6:])
    np.testing.assert_array_equal(flags, wanted.flags)
    assert np.all(out[[3, 4]] == 0.0)
    whole = np.setdiff1d(np.arange(len(given)), [3, 4])
    # The outputs to half a float's step at full scale; the corrections, which are small, to theirs.
    assert np.abs(out[whole, :3] - wanted.rate[whole]).max() < 4e-5
    assert np.abs(out[whole, 3:6] - wanted.force[whole]).max() < 8e-6
    for part, raw, answer in ((out[:, 6:9], exact[:, :3], wanted.rate), (out[:, 9:], exact[:, 3:6], wanted.force)):
        size = np.abs(raw - answer)[whole].max()
        assert np.abs(part[whole] - (raw - answer)[whole]).max() < 2e-6 * size
    bits = np.bitwise_or.reduce(flags)
    assert bits == FLAG_NO_VALUE | 0b111111


def test_all_formats_carry_the_same_words_which_read_back(folder, tmp_path):
    for name in IMU_FORMATS:
        done = bench(folder, "--format", name, "--out", tmp_path, "--address", 0x8000)
        assert done.exit_code == 0, done.output
    words = to_words((tmp_path / "calibration.bin").read_bytes())
    image = read_imu(words, 42)
    assert to_bytes(words_of(image)) == to_bytes(words)
    assert json.loads((tmp_path / "calibration.json").read_text())["words"] == words
    for name in ("hex", "srec"):
        placed = bincopy.BinFile(str(tmp_path / f"calibration.{name}"))
        assert placed.minimum_address == 0x8000
        assert to_words(bytes(placed.as_binary())) == words
    assert f"0x{words[-1]:08X}" in (tmp_path / "calibration.h").read_text()
    text = (tmp_path / "calibration.a2l").read_text()
    assert text.count("/begin ") == text.count("/end ")
    for name, number, values in re.findall(
        r"CHARACTERISTIC (\w+)_bias .*VAL_BLK (0x\w+) number.*\n +NUMBER (\d+)", text
    ):
        at = (int(number, 16) - 0x8000) // 4
        axis = image.axes[AXIS_NAMES.index(name)]
        own = np.frombuffer(to_bytes(words[at : at + int(values)]), dtype="<f4")
        assert own == pytest.approx(axis.slots[0], rel=1e-7)
    assert text.count("_bias ") == 6


@pytest.mark.parametrize(
    ("word", "value", "why"),
    [(0, 1, "not an image of an inertial unit"), (1, 2, "its format version is 2"), (4, 43, "serial number 43"),
     (20, 10**9, "CRC"), (3, 7, "its header states 7")],
)  # fmt: skip
def test_a_unit_refuses_an_image_that_is_not_its_own(word, value, why):
    words = words_of(image_of(imu_record(), 42, 7, 0))
    words[word] = value
    if why != "CRC":
        words[-1] = crc(words[:-1])
    with pytest.raises(InputError, match=why):
        read_imu(words, 42)


def parameters(text, pattern):
    return {name: float(value) for name, value in re.findall(pattern, text, re.MULTILINE)}


def biases(kind, degc):
    size = np.pi / 180.0 / 3600.0 if kind == "gyro" else 1.0
    triad = next(t for t in (fitted()[1].gyro, fitted()[1].accelerometer) if t.kind == kind)
    return [size * e.value for e in triad.estimates([degc]) if e.kind == "bias"]


def test_px4_gets_the_bias_over_temperature_and_is_told_what_it_lacks():
    """Evaluated by PX4's own formula (TemperatureCompensation.cpp)."""
    text, lost = px4(imu_record())
    found = parameters(text, r"^1\t1\t(\w+)\t(\S+)\t[69]$")
    assert found["TC_G_ENABLE"] == found["TC_A_ENABLE"] == 1
    for letter, kind in (("G", "gyro"), ("A", "accelerometer")):
        for degc in (-20.0, 60.0):
            d = degc - found[f"TC_{letter}0_TREF"]
            own = [sum(found[f"TC_{letter}0_X{k}_{i}"] * d**k for k in range(4)) for i in range(3)]
            assert own == pytest.approx(biases(kind, degc), rel=1e-5, abs=1e-9)
    scales = [e.value for e in fitted()[1].accelerometer.estimates([found["TC_A0_TREF"]]) if e.kind == "scale factor"]
    assert [found[f"CAL_ACC0_{a}SCALE"] for a in "XYZ"] == pytest.approx([1.0 / (1.0 + 1e-6 * s) for s in scales])
    for part in ("gyro scale factor", "gyro misalignment", "g-sensitivity", "second order", "a thermometer for each"):
        assert any(part in line for line in lost)
        assert any(part in line for line in text.splitlines() if line.startswith("#"))
    assert not any("beyond order 3" in line for line in lost)


def test_ardupilot_gets_the_bias_over_temperature():
    """Evaluated by ArduPilot's own formula (AP_InertialSensor_tempcal.cpp)."""
    found = parameters(ardupilot(imu_record())[0], r"^(\w+),(\S+)$")

    def p(letters, axis, degc):
        d = degc - 35.0
        c1, c2, c3 = (found[f"INS_TCAL1_{letters}{k}_{axis}"] for k in (1, 2, 3))
        return (c1 + (c2 + c3 * d) * d) * d * 1e-6

    for letters, kind in (("GYR", "gyro"), ("ACC", "accelerometer")):
        name = "GYROFFS" if kind == "gyro" else "ACCOFFS"
        at = found[f"INS_{letters}1_CALTEMP"]
        for degc in (-20.0, 60.0):
            own = [p(letters, a, degc) - p(letters, a, at) + found[f"INS_{name}_{a}"] for a in "XYZ"]
            assert own == pytest.approx(biases(kind, degc), rel=1e-5, abs=1e-9)


def test_a_bias_beyond_order_three_is_said_to_be_lost():
    record = imu_record()
    axis = record.gyro.axes[0]
    bias = axis.parameters[0]
    more = bias.model_copy(update={"coefficients": (*bias.coefficients, 25.0)})
    own = axis.model_copy(update={"parameters": (more, *axis.parameters[1:])})
    gyro = record.gyro.model_copy(update={"axes": (own, *record.gyro.axes[1:])})
    lost = px4(record.model_copy(update={"gyro": gyro}))[1]
    assert any(re.fullmatch(r"gyro bias beyond order 3: up to \d+ deg/h", line) for line in lost)


def test_kalibr_gets_the_noise_of_both_triads(folder, tmp_path):
    done = bench(folder, "--format", "kalibr", "--out", tmp_path)
    found = yaml.safe_load((tmp_path / "imu.yaml").read_text())
    # 5000 samples of unit variance, 100 a second: 1 unit * sqrt(0.01 s).
    assert found["accelerometer_noise_density"] == pytest.approx(0.1, rel=0.05)
    assert found["gyroscope_noise_density"] == pytest.approx(0.1 * np.pi / 180.0 / 3600.0, rel=0.05)
    assert found["update_rate"] == 100.0
    assert found["gyroscope_random_walk"] > 0.0
    assert found["accelerometer_random_walk"] > 0.0
    assert "it holds noise alone" in done.stdout


def test_the_csv_has_every_parameter_with_its_u_and_its_curve(folder, tmp_path):
    bench(folder, "--format", "csv", "--out", tmp_path)
    rows = list(csv.DictReader((tmp_path / "calibration.csv").read_text().splitlines()))
    assert len(rows) == 108
    curves = list(csv.DictReader((tmp_path / "calibration_curves.csv").read_text().splitlines()))
    own = [row for row in curves if row["parameter"] == "gyro x: bias"]
    z = (2.0 * 25.0 - float(own[0]["low_degc"]) - float(own[0]["high_degc"])) / (
        float(own[0]["high_degc"]) - float(own[0]["low_degc"])
    )
    value = np.polynomial.chebyshev.chebval(z, [float(row["value"]) for row in own])
    wanted = next(r for r in rows if r["parameter"] == "gyro x: bias" and r["temperature_degc"] == "25")
    assert value == pytest.approx(float(wanted["value"]), rel=1e-6)


def changed(folder, **update):
    imu_record().model_copy(update=update).write(folder)
    return folder


LAG = ImuFinding(cause="thermal_lag", where="gyro x", text="gyro x lacks thermal_lag")
SWAPPED = ImuFinding(cause="swapped_axes", where="gyro x and y", text="gyro: output x measures y")


def test_what_must_not_be_delivered_is_refused_unless_forced(tmp_path):
    folder = changed(tmp_path, findings=(LAG,), undetermined=("gyro z: bias: too few",))
    refused = bench(folder, "--format", "c")
    assert refused.exit_code == 2
    assert "not delivered: thermal_lag, gyro x: gyro x lacks thermal_lag (and 1 more)" in refused.stderr
    forced = bench(folder, "--format", "c", "--force", "--json")
    assert forced.exit_code == 0
    assert json.loads(forced.stdout)["objections"][1] == "not determined: gyro z: bias: too few"


@pytest.mark.parametrize(
    ("update", "words", "why"),
    [
        ({"findings": (SWAPPED,)}, ("--format", "c", "--force"), "not delivered: gyro: output x measures y; correct"),
        ({}, ("--format", "mf4"), "allowed for an inertial unit are json, csv"),
        ({}, ("--format", "c", "--form", "fixed"), "--model and --form are for a single gyro"),
        ({"unit": "prototype"}, ("--format", "c"), "unit 'prototype' has no number in its serial number"),
        ({}, ("--format", "c", "--name", "2x"), "'2x' is not a valid C name"),
    ],
)
def test_what_cannot_be_exported_is_one_line(tmp_path, update, words, why):
    done = bench(changed(tmp_path, **update), *words)
    assert done.exit_code == 2
    assert why in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1


def test_a_record_that_was_altered_is_refused(folder):
    path = folder / ImuRecord.FILE
    path.write_text(path.read_text().replace('"rate_ppm": 0.0', '"rate_ppm": 1.0'))
    done = bench(folder, "--format", "c")
    assert done.exit_code == 2
    assert "imu.json" in done.stderr


def test_one_thermometer_for_all_is_one_temperature():
    record = imu_record()
    image = image_of(record, 42, 7, 0)
    single = replace(image, thermometers=1, axes=tuple(replace(axis, thermometer=0) for axis in image.axes))
    rate, force, degc = samples(10)
    one = compensate(single, rate, force, degc[:, :1])
    many = compensate(image, rate, force, np.repeat(degc[:, :1], 4, axis=1))
    np.testing.assert_array_equal(one.rate, many.rate)


BENT = {"spline": TriadModel(bias=Curve(intervals=2)), "surface": TriadModel(surface=3)}


@pytest.mark.parametrize("name", BENT)
def test_curves_that_no_image_holds_are_kept_in_the_record_and_given_as_text(tmp_path, name):
    record = imu_record(BENT[name])
    (rows, fit), again = fitted(BENT[name]), curves_of(ImuRecord.model_validate_json(record.model_dump_json()))
    for kept, own, data in zip(again.triads, fit.triads, (rows.gyro, rows.accelerometer), strict=True):
        assert kept.corrected(data) == pytest.approx(own.corrected(data), rel=1e-9, abs=1e-9)
    record.write(tmp_path)
    refused = bench(tmp_path, "--format", "c", "--out", tmp_path)
    assert refused.exit_code == 2
    told = {"spline": "gyro x: bias is a spline; calibrate it with an order", "surface": "no place for gyro x: second"}
    assert told[name] in refused.output
    done = bench(tmp_path, "--format", "csv", "--out", tmp_path)
    assert (done.exit_code, told[name] in done.output) == (0, True)
    answer = json.loads(bench(tmp_path, "--format", "csv", "--out", tmp_path, "--json").stdout)
    assert (answer["serial"], answer["crc"]) == (42, None)
    (curves,) = tmp_path.glob("*_curves.csv")
    lines = [row for row in csv.DictReader(curves.read_text().splitlines()) if row["parameter"] == "gyro x: bias"]
    low, high, beta = float(lines[0]["low_degc"]), float(lines[0]["high_degc"]), [float(row["value"]) for row in lines]
    if name == "spline":  # by scipy alone
        middle = 0.5 * (low + high)
        found = BSpline([low] * 4 + [middle] + [high] * 4, beta, 3)(25.0)
    else:
        found = np.polynomial.Chebyshev(beta, domain=[low, high])(25.0)
    assert found == pytest.approx(next(e.value for e in fit.gyro.estimates([25.0]) if e.name == "gyro x: bias"))


def test_px4_gets_the_cubic_nearest_to_a_spline_and_is_told_by_how_much_it_is_off():
    text, lost = px4(imu_record(BENT["spline"]))
    assert any("gyro bias beyond order 3" in line for line in lost)
    found = parameters(text, r"^1\t1\t(\w+)\t(\S+)\t[69]$")
    d = 20.0 - found["TC_G0_TREF"]
    own = sum(found[f"TC_G0_X{k}_0"] * d**k for k in range(4))
    value = next(e.value for e in fitted(BENT["spline"])[1].gyro.estimates([20.0]) if e.name == "gyro x: bias")
    assert own == pytest.approx(np.radians(value / 3600.0), rel=0.05)
