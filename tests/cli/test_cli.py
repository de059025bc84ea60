"""The commands as seen by a user: exit codes, one line for bad input, one JSON object on stdout."""

import json
import shlex
import shutil
import signal
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from bench.analysis.diagnosis.answer import Place
from bench.base import user_name
from bench.cli import main
from bench.cli.rendering.diagnose import next_run, where_it_fails
from tests.support.commands import bench
from tests.support.run_folders import make_run, ramp_run


@pytest.fixture(scope="module")
def run_folder(tmp_path_factory):
    return make_run(tmp_path_factory.mktemp("run") / "r1", **ramp_run())


LEGS = [
    ("up", "ramp", 60.0, 2.0),
    ("down", "ramp", 0.0, 2.0),
    ("back", "ramp", 25.0, 2.0),
    ("still", "soak", 25.0, 1800.0),
]
PROFILE = """
name: tiny
segments:
  - {kind: ramp, to_degc: TO, rate_degc_per_min: 2}
  - {kind: soak, duration_min: 1}
"""


@pytest.fixture
def profile(tmp_path):
    def write(to):
        path = tmp_path / "tiny.yaml"
        path.write_text(PROFILE.replace("TO", to))
        return path

    return write


def test_every_command_explains_itself():
    listed = bench("--help").output
    for name in main.commands:
        assert name in listed
        assert main.commands[name].help
        assert bench(name, "--help").exit_code == 0


@pytest.mark.parametrize(
    ("to", "said"),
    [
        ("120", "tiny.yaml:4: "),
        (".nan", "tiny.yaml:4: '.nan' is not a finite number"),
        ("warm", "tiny.yaml:4: "),
    ],
)
def test_a_profile_that_cannot_run_is_refused_with_its_line_before_anything_moves(profile, tmp_path, to, said):
    answer = bench("run", profile(to), "--out", tmp_path / "reports")
    assert answer.exit_code == 2
    assert answer.stderr.startswith("bench: ")
    assert said in answer.stderr.splitlines()[0]
    assert not (tmp_path / "reports").exists()


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "is empty"),
        ("time,rate,temperature\n", "zero rows"),
        ("time,rate,temperature\n0,1,20\n1,1,21\n2,1", ":4: "),
        ("time,rate,temperature\n0,1,20\n1,fast,21\n", ":3: "),
    ],
)
def test_a_table_that_is_no_record_is_refused_with_its_line(tmp_path, text, said):
    path = tmp_path / "log.csv"
    path.write_text(text)
    answer = bench("import", path, "--out", tmp_path / "reports")
    assert answer.exit_code == 2
    assert said in answer.stderr
    assert len(answer.stderr.splitlines()) == 1
    assert not (tmp_path / "reports").exists()


def test_a_rate_that_looks_like_radians_is_imported_with_a_warning_that_says_so(tmp_path):
    time = np.arange(2000.0)
    temperature = 20 + 30 * np.sin(time / 400)
    rate = 5e-5 + 1e-6 * temperature
    table = "\n".join(f"{t},{r:.9e},{c:.4f}" for t, r, c in zip(time, rate, temperature, strict=True))
    path = tmp_path / "log.csv"
    path.write_text(f"time,rate,temperature\n{table}\n")
    answer = bench("import", path, "--preview", "--json")
    assert answer.exit_code == 0
    assert "rad/s" in " ".join(json.loads(answer.stdout)["warnings"])


def test_a_folder_without_a_manifest_is_no_run(tmp_path):
    (tmp_path / "old").mkdir()
    answer = bench("report", tmp_path / "old")
    assert answer.exit_code == 2
    assert "manifest.json is missing" in answer.stderr


def test_compare_answers_with_the_keys_that_others_rely_on(run_folder):
    answer = bench("compare", run_folder, "--model", "polynomial", "--model", "spline", "--json")
    content = json.loads(answer.stdout)
    assert answer.exit_code == 0
    assert {"runs", "floor_dph", "models"} <= set(content)
    for model in content["models"]:
        assert {"name", "effects", "rms_dph", "held_out_rms_dph", "segments"} <= set(model)
        assert all({"name", "rms_dph", "floor_ratio"} <= set(segment) for segment in model["segments"])
    assert content["models"][1]["rms_dph"] < content["models"][0]["rms_dph"]


@pytest.fixture(scope="module")
def foreign(tmp_path_factory):
    """Only ramps, rate and temperature, as in many logs of other programs."""
    run = ramp_run([("up", "ramp", 85.0, 2.0), ("down", "ramp", -20.0, 2.0), ("up again", "ramp", 30.0, 2.0)])
    columns = {name: run["columns"][name] for name in ("time", "rate", "temperature")}
    return make_run(tmp_path_factory.mktemp("foreign") / "r", columns)


def test_compare_shows_the_models_that_a_run_allows_and_says_why_not_the_others(foreign):
    answer = bench("compare", foreign)
    assert answer.exit_code == 0
    assert "\nspline " in answer.stdout
    assert "not fitted: regression: r: channel 'frequency' [Hz] is missing" in answer.stdout
    asked = bench("compare", foreign, "--model", "regression")
    assert asked.exit_code == 2
    assert "channel 'frequency' [Hz] is missing" in asked.stderr


def test_a_diagnosis_of_a_run_without_a_soak_says_what_to_record_and_shows_no_nan(foreign):
    answer = bench("diagnose", foreign, "--model", "polynomial")
    assert "noise floor - deg/h RMS" in answer.stdout
    assert " nan" not in answer.stdout
    assert "Not testable here: drive_amplitude: no channel 'drive'" in answer.stdout
    assert "(--static)" in answer.stdout


@pytest.mark.slow
def test_a_diagnosis_ends_with_commands_that_add_what_is_missing(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "better.yaml").write_text("of an earlier diagnosis\n")
    run, check = (make_run(tmp_path / f"run {n}", **ramp_run(seed=n), cause="imported", run=f"r{n}") for n in (1, 2))
    text = bench("diagnose", run, "--check", check, "--model", "spline").stdout
    add, compare = (shlex.split(line)[1:] for line in text.split("Add it and see the error fall\n")[1].splitlines()[:2])
    assert bench(*add).exit_code == 0
    plain, better = json.loads(bench(*compare, "--json").stdout)["models"]
    assert better["name"] == "better2"
    assert better["held_out_rms_dph"] < 0.5 * plain["held_out_rms_dph"]


def test_where_a_model_fails_the_systematic_part_is_shown_that_puts_the_place_there():
    place = Place("chamber_temperature", -40.0, -36.6, 0.156, 0.85, 0.0653, 1e-12)
    _, listed, _ = where_it_fails(SimpleNamespace(where=(place,)))
    (row,) = zip(*(column.cells for column in listed.columns), strict=True)
    assert row[2:4] == ("0.0653 deg/h systematic", "0.85 x floor, p < 1e-09")


def test_the_run_that_a_diagnosis_of_an_imported_log_proposes_is_not_for_a_station():
    found = SimpleNamespace(next_experiment={"decides": True, "profile": "reports/next.yaml", "why": "it tells"})
    assert next(next_run(found, imported=False)) == "next: bench run reports/next.yaml"
    elsewhere = "next: run reports/next.yaml in the chamber that this log is from, and import what it records"
    assert next(next_run(found, imported=True)) == elsewhere


@pytest.mark.slow
def test_a_report_without_the_isothermal_run_keeps_the_diagnosis_that_knew_it(tmp_path):
    run = make_run(tmp_path / "r", **ramp_run(LEGS, loop_dph=0.0))
    static = make_run(tmp_path / "s", **ramp_run([("soak at 25", "soak", 25.0, 5400.0)], seed=2))
    told = json.loads(bench("diagnose", run, "--static", static, "--model", "polynomial", "--json").stdout)
    assert told["static"] == "s"

    alone = json.loads(bench("report", run, "--model", "polynomial", "--json").stdout)
    assert any(
        "also made with s, the new one was not; the former is kept as diagnosis-before.json" in text
        for text in alone["warnings"]
    )
    floors = [json.loads((run / "diagnosis.json").read_text())["floor_dph"], alone["floor_dph"]]
    floors.append(json.loads(bench("compare", run, "--model", "polynomial", "--json").stdout)["floor_dph"])
    assert floors == 3 * [floors[0]], "every command reads the same noise floor from a run"
    assert floors[0] > 0.0
    before = json.loads((run / "diagnosis-before.json").read_text())
    assert before == {"format": 1, **told}
    assert "Made from r with no isothermal run" in (run / "report.html").read_text()

    again = json.loads(bench("report", run, "--static", static, "--model", "polynomial", "--json").stdout)
    saved = json.loads((run / "diagnosis.json").read_text())
    assert not any("diagnosis-before" in text for text in again["warnings"])
    assert saved == {"format": 1, **told}
    assert again["floor_dph"] == saved["floor_dph"]
    assert "Made from r with the isothermal run s" in (run / "report.html").read_text()


@pytest.mark.parametrize(
    "words", ["diagnose RUN --model spline --check COPY", "diagnose RUN RUN --model spline",
              "diagnose RUN --model spline --static RUN", "improve RUN --model spline --check RUN",
              "compare RUN --check COPY", "compare RUN COPY --lot", "report RUN --check COPY", "noise RUN COPY"],
)  # fmt: skip
def test_a_recording_that_is_given_twice_judges_nothing(run_folder, tmp_path, words):
    copy = shutil.copytree(run_folder, tmp_path / "copy")
    before = sorted(path.name for path in run_folder.iterdir())
    places = {"RUN": run_folder, "COPY": copy}
    refused = bench(*(places.get(word, word) for word in words.split()))
    assert (refused.exit_code, refused.stderr.count("\n")) == (2, 1)
    assert "are the same recording: give each run once" in refused.stderr
    assert sorted(path.name for path in run_folder.iterdir()) == before


def test_check_predicts_every_segment_without_moving_anything(profile, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    answer = bench("check", profile("30"), "--json")
    content = json.loads(answer.stdout)
    assert answer.exit_code == 0
    assert len(content["segments"]) == 2
    assert content["duration_s"] > 7 / 2 * 60 + 60
    assert sorted(path.name for path in tmp_path.iterdir()) == ["tiny.yaml"]


def test_check_warns_of_limits_that_no_set_point_of_the_profile_meets(profile, tmp_path):
    limits = tmp_path / "hot.yaml"
    limits.write_text(
        "name: hot\nlimits:\n  - {quantity: highest_temperature_degc, unit: degC, lower: 60, reason: it is hot}\n"
    )
    warned = bench("check", profile("30"), "--limits", limits)
    assert (warned.exit_code, "the limits ask for 60 degC or more, the plan goes from" in warned.stdout) == (0, True)
    assert "the limits ask" not in bench("check", profile("65"), "--limits", limits).stdout
    limits.write_text(limits.read_text().replace("lower: 60", "lower: warm"))
    wrong = bench("check", profile("30"), "--limits", limits)
    assert (wrong.exit_code, wrong.stderr.count("\n")) == (2, 1)
    assert wrong.stderr.startswith(f'bench: {limits}:3: limits[0].lower is "warm": must be a number')


def test_init_gives_a_copy_once_and_never_overwrites_it(tmp_path):
    assert bench("init", tmp_path / "mine").exit_code == 0
    profile = tmp_path / "mine" / "profiles" / "quick.yaml"
    profile.write_text("mine now")
    again = bench("init", tmp_path / "mine")
    assert again.exit_code == 2
    assert "nothing was written" in again.stderr
    assert profile.read_text() == "mine now"


def test_run_captures_fits_and_reports_in_one_command(profile, tmp_path):
    answer = bench("run", profile("30"), "--out", tmp_path / "reports", "--json")
    content = json.loads(answer.stdout)
    assert answer.exit_code in {0, 1}
    assert {"run", "verdict", "rms_dph", "floor_dph"} <= set(content)
    assert content["losses"]["lost"] == content["losses"]["corrupt"] == 0
    for name in ("manifest.json", "data.parquet", "means.parquet", "events.jsonl", "report.html", "calibration.json"):
        assert (tmp_path / "reports" / "SIM-0001" / content["run"].rsplit("/", 1)[1] / name).is_file()


@pytest.mark.slow
def test_resume_makes_a_run_of_what_a_killed_bench_left(profile, tmp_path):
    run = json.loads(bench("run", profile("30"), "--out", tmp_path, "--json").stdout)["run"]
    before = json.loads((Path(run) / "manifest.json").read_text())
    for made in ("manifest.json", "data.parquet", "means.parquet", "events.jsonl"):
        (Path(run) / made).unlink()
    answer = bench("resume", run, "--json")
    content = json.loads(answer.stdout)
    assert answer.exit_code == 0
    assert content["rows"] == before["rows"]
    assert json.loads((Path(run) / "manifest.json").read_text())["files"] == before["files"]


def test_an_error_with_json_is_one_object_on_stdout_and_the_line_on_stderr(tmp_path):
    answer = bench("compare", tmp_path / "nothing", "--json")
    assert answer.exit_code == 2
    told = json.loads(answer.stdout)
    assert told["exit_code"] == 2
    assert answer.stderr == f"bench: {told['error']}\n"


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("decide RUN --most 0", "Invalid value for '--most': 0 is not in the range 1<=x<=20. See `bench decide"),
        ("diagnose RUN", "Missing option '--model'. See `bench diagnose"),
        ("diagnose RUN --check", "Option '--check' requires an argument. See `bench diagnose"),
        ("diagnos", "No such command 'diagnos'. Did you mean 'diagnose'? See `bench"),
        ("certificate --withdraw 1", "say why it is amended or withdrawn with --reason TEXT. See `bench certificate"),
    ],
)  # fmt: skip
def test_words_that_a_command_does_not_take_are_told_in_one_line(words, said):
    result = bench(*words.split())
    assert (result.exit_code, result.stdout, result.stderr) == (2, "", f"bench: {said} --help`\n")
    command, *more = words.split()
    result = bench(command, "--json", *more)
    assert (result.exit_code, json.loads(result.stdout)["error"]) == (2, f"{said} --help`")


def test_who_imported_a_table_is_on_record(tmp_path):
    (tmp_path / "log.csv").write_text("time,rate,temperature\n" + "".join(f"{n},1,{20 + n}\n" for n in range(9)))
    made = bench("import", tmp_path / "log.csv", "--out", tmp_path / "reports", "--json")
    assert made.exit_code == 0
    (run,) = json.loads(bench("registry", "list", "--out", tmp_path / "reports", "--json").stdout)["runs"]
    assert run["operator"] == user_name()


WAITS = """
import tempfile
from bench.cli import main
from bench.cli.rendering.diagnose import next_run

@main.command()
def wait():
    with tempfile.TemporaryDirectory() as folder:
        print(folder, flush=True)
        input()

main()
"""


@pytest.mark.skipif(sys.platform == "win32", reason="ends a process by a signal")
@pytest.mark.parametrize(("number", "code"), [(signal.SIGTERM, 128 + signal.SIGTERM), (signal.SIGINT, 1)])
def test_a_command_that_is_ended_removes_its_temporary_files(number, code):
    before = signal.getsignal(signal.SIGTERM)
    assert bench("effects").exit_code == 0
    assert signal.getsignal(signal.SIGTERM) is before, "a program that calls the bench keeps its own signals"
    pipe = subprocess.PIPE
    with subprocess.Popen(
        [sys.executable, "-c", WAITS, "wait"], stdin=pipe, stdout=pipe, stderr=pipe, text=True
    ) as command:
        folder = Path(command.stdout.readline().strip())
        assert folder.is_dir()
        command.send_signal(number)
        assert command.wait() == code
    assert not folder.exists()
