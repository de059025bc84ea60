"""The image of an inertial unit in its memory: a second reader of docs/eeprom.md, write and read back over the bus."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from bench.base import InputError
from bench.commands.flash_source import from_file, from_imu
from bench.deliver.export.imu_image import compensate, image_of, words_of
from bench.deliver.export.words import crc, to_bytes
from bench.record import FlashRecord, ImuFinding
from drivers.sim.correction import RefusedImageError
from drivers.sim.imu_correction import ImuCorrection
from tests.support.commands import bench
from tests.support.flash_bench import World
from tests.support.imu_units import imu_record

UNIT = SimpleNamespace(serial="SIM-IMU-0042", identity=7)


def words(serial=7):
    return words_of(image_of(imu_record(), serial, 9, 1_700_000_000))


def channels(rows=500):
    random = np.random.default_rng(4)
    values = {f"rate_{axis}": random.uniform(-7e5, 7e5, rows) for axis in "xyz"}
    values |= {f"acceleration_{axis}": random.uniform(-40.0, 40.0, rows) for axis in "xyz"}
    return values | {f"temperature_{k}": random.uniform(-45.0, 90.0, rows) for k in (1, 2, 3, 4)}


def test_the_simulated_unit_and_the_exporter_read_one_document():
    given = channels()
    given["rate_y"][3], given["temperature_2"][5] = np.nan, np.nan
    sent, flags = ImuCorrection.read(to_bytes(words()), 7, 1000).apply(given)
    rate = np.stack([given[f"rate_{axis}"] for axis in "xyz"], axis=1) / 3600.0
    force = np.stack([given[f"acceleration_{axis}"] for axis in "xyz"], axis=1)
    degc = np.stack([given[f"temperature_{k}"] for k in (1, 2, 3, 4)], axis=1)
    wanted = compensate(image_of(imu_record(), 7, 9, 0), rate, force, degc)
    for i, axis in enumerate("xyz"):
        assert np.abs(sent[f"rate_{axis}"] / 3600.0 - wanted.rate[:, i]).max() < 6e-5
        assert np.abs(sent[f"acceleration_{axis}"] - wanted.force[:, i]).max() < 2e-5
    assert flags == int(np.bitwise_or.reduce(wanted.flags))
    np.testing.assert_array_equal(sent["temperature_1"], given["temperature_1"])


@pytest.mark.parametrize(
    ("word", "value"), [(0, 1), (1, 2), (3, 5), (4, 8), (6, 3), (10, 9999), (11, 40), (16, 7), (19, 400)]
)
def test_the_simulated_unit_refuses_an_image_that_is_not_its_own(word, value):
    image = words()
    image[word] = value
    image[-1] = crc(image[:-1])
    with pytest.raises(RefusedImageError):
        ImuCorrection.read(to_bytes(image), 7, 1000)
    image = words()
    image[30] ^= 1
    with pytest.raises(RefusedImageError, match="CRC"):
        ImuCorrection.read(to_bytes(image), 7, 1000)


@pytest.mark.parametrize("protocol", ["canopen", "uds"])
def test_an_image_is_written_read_back_and_corrects_the_outputs(protocol):
    unit, image = World(protocol=protocol), to_bytes(words())
    with unit.store() as store:
        done = store.program(image, lambda old: None)
        assert store.read(store.active()) == image
    assert done.bank == unit.memory.active
    given = channels(50)
    sent, _ = unit.memory.correct(given)
    assert np.abs(sent["rate_x"] - given["rate_x"]).max() > 100.0


def test_a_calibration_goes_into_its_own_unit_only(tmp_path):
    record = imu_record()
    record.write(tmp_path)
    ready = from_imu(tmp_path, UNIT)
    assert (ready.image.serial, ready.content[:4]) == (7, b"GTBI")
    (tmp_path / "imu.bin").write_bytes(ready.content)
    assert from_file(tmp_path / "imu.bin").image.label == ready.image.label
    with pytest.raises(InputError, match="is a calibration of unit SIM-IMU-0042, this is OTHER"):
        from_imu(tmp_path, SimpleNamespace(serial="OTHER", identity=1))
    lag = ImuFinding(cause="thermal_lag", where="gyro x", text="gyro x lacks it")
    record.model_copy(update={"findings": (lag,)}).write(tmp_path)
    with pytest.raises(InputError, match="not delivered: thermal_lag"):
        from_imu(tmp_path, UNIT)


def test_a_simulated_unit_gets_its_calibration_over_its_bus_and_reads_it_back(tmp_path):
    imu_record().model_copy(update={"unit": "IMU-0001"}).write(tmp_path)
    station = Path(__file__).parents[2] / "profiles" / "stations" / "imu.yaml"
    words = ("flash", "IMU-0001", "--run", tmp_path, "--station", station, "--out", tmp_path / "reports", "--quiet")
    done = bench(*words)
    assert done.exit_code == 0, done.output
    assert "read back and compared word by word" in done.stdout
    record = FlashRecord.read(tmp_path)
    assert (record.state, record.serial, record.coefficient_set) == ("done", 1, 1)
    again = bench(*words)
    assert "already" in again.stdout
