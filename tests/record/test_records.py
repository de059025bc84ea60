"""Reading a record: what is missing, damaged, older or newer, and what is kept."""

import json

import pytest

from bench.base.errors import InputError
from bench.record import CalibrationRecord, ComparisonRecord, DiagnosisRecord, LimitsRecord, Manifest, Record

SEGMENT = {"index": 0, "name": "up", "kind": "ramp", "from_s": 0.0, "to_s": 60.0, "unheard_of": 3}
CONTENT = {"format": 1, "run": "r", "unit": "U", "state": "done", "segments": [SEGMENT], "of_a_newer_bench": {"a": [1]}}


def test_what_is_missing_is_none_or_an_error_as_the_caller_asks(tmp_path):
    assert Manifest.find(tmp_path) is None
    with pytest.raises(InputError, match=r"manifest\.json is missing"):
        Manifest.read(tmp_path)
    with pytest.raises(InputError, match="no such run folder"):
        Manifest.read(tmp_path / "nowhere")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "is not valid JSON"),
        ("{", "is not valid JSON"),
        ("[" * 100_000, "is not valid JSON"),
        ("\xff", "is not valid JSON"),
        ("[]", "is not a JSON object"),
        ('{"format": 7}', "is of format 7, this bench reads up to 1: use the bench that wrote it"),
        ('{"format": "1"}', r'format is "1": input should be a valid integer'),
        ('{"format": 1, "rows": "12"}', r'rows is "12": input should be a valid integer'),
        ('{"format": 1, "duration_s": NaN}', "duration_s is NaN: input should be a finite number"),
        ('{"format": 1, "segments": [{"name": "up", "from_s": 0}]}', r"key 'segments\[0\]\.to_s' is missing"),
    ],
)
def test_damage_is_one_error_that_names_the_file_and_what_to_do(tmp_path, text, message):
    (tmp_path / "manifest.json").write_text(text, encoding="latin-1")
    for reader in (Manifest.find, Manifest.read):
        with pytest.raises(InputError, match=message) as caught:
            reader(tmp_path)
        assert str(caught.value).startswith(f"{tmp_path}/manifest.json: ")
        assert "\n" not in str(caught.value)


def test_a_file_that_cannot_be_read_is_an_error(tmp_path):
    (tmp_path / "manifest.json").mkdir()
    with pytest.raises(InputError, match="cannot be read: Is a directory"):
        Manifest.find(tmp_path)


def test_keys_of_a_newer_bench_are_kept_and_what_nobody_said_is_not_written(tmp_path):
    (tmp_path / "manifest.json").write_text(json.dumps(CONTENT))
    Manifest.read(tmp_path).model_copy(update={"state": "aborted"}).write(tmp_path)
    assert json.loads((tmp_path / "manifest.json").read_text()) == CONTENT | {"state": "aborted"}


def test_a_number_stays_the_same_number_bit_for_bit(tmp_path):
    content = {"format": 1, "sample_rate_hz": 500, "rate_step_dph": 5e-324, "duration_s": 0.1 + 0.2}
    (tmp_path / "manifest.json").write_text(json.dumps(content))
    assert Manifest.read(tmp_path).text() == json.dumps(content, indent=1) + "\n"


def test_a_file_without_a_format_is_an_older_one_and_is_written_in_the_newest(tmp_path):
    class Weighed(Record):
        """A record whose key `mass` was once called `weight`."""

        FILE = "weighed.json"
        TITLE = "weighed"

        format: int = 2
        mass: float

        @classmethod
        def _migrated(cls, content, found):
            return {**content, "mass": content["weight"]} if found < 2 else content

    for older in ({"weight": 3.0}, {"format": 1, "weight": 3.0}):
        (tmp_path / "weighed.json").write_text(json.dumps(older))
        read = Weighed.read(tmp_path)
        assert (read.mass, read.content()["format"]) == (3.0, 2)
    assert Weighed(mass=1.0).content() == {"format": 2, "mass": 1.0}


def test_records_of_the_first_benches_which_have_no_version_open(tmp_path):
    texts = {
        ComparisonRecord: '{"runs": ["r"], "floor_dph": 0.1, "models": [{"name": "line", "held_out_rms_dph": 2.0},'
        ' {"name": "spline", "rms_dph": 0.15, "held_out_rms_dph": 0.2}, {"name": "cubic", "held_out_rms_dph": null}]}',
        DiagnosisRecord: '{"verdict": "adequate", "runs": ["r"], "check": ["c"], "static": null, "model": "spline"}',
        LimitsRecord: '{"name": "grade A", "verdict": "FAIL", "results": [{"name": "condition", "value": null}]}',
        Manifest: '{"run": "r", "unit": "U", "state": "done"}',
    }
    for kind, text in texts.items():
        (tmp_path / kind.FILE).write_text(text)
        assert kind.read(tmp_path).content() == {"format": 1, **json.loads(text)}
    best = ComparisonRecord.read(tmp_path).best()
    assert best is not None
    assert (best.name, best.rms_dph) == ("spline", 0.15)
    assert DiagnosisRecord.read(tmp_path).everything() == {"r", "c"}


def test_a_calibration_of_a_bench_that_knew_no_quantities_opens_without_them(tmp_path):
    fit = {"model": {"name": "m", "effects": [{"effect": "spline", "options": {"intervals": 8}}]},
           "validity": {"temperature": {"from": -40.0, "to": 85.0, "unit": "degC"}}}  # fmt: skip
    (tmp_path / "calibration.json").write_text(json.dumps({"format": 1, "averaging_s": 10.0, "calibration": fit}))
    read = CalibrationRecord.read(tmp_path)
    assert read.quantities is None
    assert read.calibration is not None
    assert read.calibration.model.description() == {
        "name": "m",
        "rows": "all",
        "effects": [{"spline": {"intervals": 8}}],
    }
    assert (read.calibration.validity["temperature"].low, read.calibration.content()) == (-40.0, fit)
