"""Status signals: the DBC describes what they must say for a sample to be used, also of gyros that are not ours."""

import numpy as np
import pytest

from drivers.errors import ConfigError
from drivers.gyro import GyroDecoder
from drivers.journal import FRAME
from drivers.wire import load_dbc

DBC = """VERSION ""
NS_ :
BS_:
BU_: Gyro
BO_ 100 OUT: 8 Gyro
 SG_ Rate : 0|24@1- (0.0001,0) [-700|700] "deg/s" Gyro
 SG_ SampleCounter : 24|12@1+ (1,0) [0|4095] "" Gyro
 SG_ Health : 36|4@1+ (1,0) [0|15] "" Gyro
 SG_ Mode : 40|3@1+ (1,0) [0|7] "" Gyro
BO_ 200 ALIVE: 8 Gyro
 SG_ State : 0|8@1+ (1,0) [0|255] "" Gyro
 SG_ Serial : 8|32@1+ (1,0) [0|4294967295] "" Gyro
BA_DEF_ BO_ "GenMsgCycleTime" INT 0 65535;
BA_DEF_ SG_ "BenchValid" STRING ;
BA_DEF_ SG_ "BenchRaw" STRING ;
BA_DEF_DEF_ "GenMsgCycleTime" 0;
BA_DEF_DEF_ "BenchValid" "";
BA_DEF_DEF_ "BenchRaw" "";
BA_ "GenMsgCycleTime" BO_ 100 10;
BA_ "GenMsgCycleTime" BO_ 200 1000;
BA_ "BenchValid" SG_ 100 Health "3, 6..7";
BA_ "BenchRaw" SG_ 100 Mode "2";
VAL_ 100 Health 9 "loop unlocked" ;
"""


def block(path, rates=(), **signals):
    message = load_dbc(path)["OUT"]
    count = max(np.size(value) for value in signals.values())
    values = {"Rate": np.arange(count) * 1e-4, "SampleCounter": np.arange(count)} | signals
    frames = np.zeros(count, dtype=FRAME)
    frames["t_ns"], frames["id"], frames["len"] = np.arange(count) * 10_000_000, 100, 8
    frames["data"] = message.pack(count, values)
    return GyroDecoder(path, 0).decode(frames)


@pytest.fixture
def path(tmp_path):
    (tmp_path / "other.dbc").write_text(DBC)
    return tmp_path / "other.dbc"


def test_a_signal_of_any_name_says_which_samples_are_valid(path):
    found = block(path, Health=np.array([3, 6, 7, 9, 0, 3]), Mode=2)
    assert found.valid.tolist() == [True, True, True, False, False, True]
    assert {why: rows.tolist() for why, rows in found.faults.items()} == {
        "Health = 9 (loop unlocked)": [False] * 3 + [True, False, False],
        "Health = 0": [False] * 4 + [True, False],
    }
    assert np.isnan(found.rate_dph[3:5]).all()
    assert found.corrected is None


def test_another_one_says_which_are_corrected_by_the_unit_itself(path):
    assert block(path, Health=3, Mode=np.array([2, 2, 5, 2])).corrected.tolist() == [False, False, True, False]


@pytest.mark.parametrize("rate", [838.8607, -838.8608, 700.1])
def test_a_rate_at_the_end_of_its_code_or_outside_what_the_dbc_allows_is_none(path, rate):
    found = block(path, Health=3, Mode=2, Rate=np.array([0.1, rate, 0.2]))
    assert found.valid.tolist() == [True, False, True]
    assert list(found.faults) == ["rate outside its range"]


@pytest.mark.parametrize("text", ["good", "3..", "5..1", "1,,2", "1..2,2", ""])
def test_an_attribute_that_cannot_be_understood_is_named(path, text):
    path.write_text(DBC.replace("3, 6..7", text))
    with pytest.raises(ConfigError, match=r"OUT\.Health: BenchValid is '.*'; it must list|a value is listed twice"):
        GyroDecoder(path, 0)
