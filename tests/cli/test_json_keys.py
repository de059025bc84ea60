"""The keys of `--json` are fixed: keys may be added, never removed."""

import json
from datetime import date
from pathlib import Path

import numpy as np
import pytest

from bench.archive import gauge
from bench.cli import rendering
from bench.commands import (
    Aborted,
    Asked,
    Calibrated,
    CalibratedAll,
    Flashed,
    GaugeJudged,
    LiveRuns,
    LotAudited,
    LotCompleted,
    LotPlanned,
    NotAnalysed,
    RunsRestored,
    StationServed,
    UnitReport,
    UnitsReported,
)
from bench.commands.calibration.job import JobFile
from bench.commands.calibration.steps import STEP_NAMES
from benchmarks import imu_data
from drivers.sim.truth.imu.drawn import drawn
from tests.cli.test_cli import LEGS, PROFILE
from tests.support.commands import bench
from tests.support.run_folders import make_run, ramp_run

REPORT = """run verdict sentence complete model rms_dph held_out_rms_dph held_out_by floor_dph bias_span_dph
    uncompensated_rms_dph samples missing_samples losses left_out admissible gaps warnings diagnosis report state
    notes views registry"""
COMPARE = "runs check floor_dph interval_s models refused left_out"
DIAGNOSE = """verdict proved nearest contradicted sentence runs check static sisters model floor_dph rms_dph
    held_out_rms_dph held_out_by floor_ratio where suspects formulas kernel surface next_experiment
    unexplained threshold not_excited smallest_detectable noise_finding resolution notes"""
IMPORT = "run file unit rows interval_s time columns segments warnings"
REGISTRY = "registry archive rows differences unreadable digest"
KEYS = {
    "check PROFILE": "profile station duration_s disk_bytes segments findings",
    "doctor --contract": "map agrees behaviours",
    "doctor --listen 0.1": "station agrees findings latency_s",
    "init OUT/mine": "folder files",
    "status --out OUT": "runs",
    "compare RUN --model polynomial": COMPARE,
    "compare RUN --model polynomial --every-sample": f"{COMPARE} samples seconds",
    "noise RUN": """runs angle_random_walk bias_instability rate_random_walk quantisation rate_ramp correlation_s
        floor_dph floor_interval_dph floor_duration_s stretches allan lines""",
    "report RUN --model polynomial": REPORT,
    "diagnose RUN --model polynomial": f"{DIAGNOSE} registry",
    "add aging --model spline --out OUT/m.yaml": "model effects",
    "effects": "effects",
    "effects show aging": "effect family look_alikes time_s temperature contribution",
    "import TABLE --preview": IMPORT,
    "import TABLE --out OUT": f"{IMPORT} registry",
    "replay RUN": "identical runs",
    "diff RUN RUN": "a b facts profile station versions segments losses quantities coefficients curves",
    "export RUN --format csv --model polynomial --force": """run format files model form unit serial calibration_id crc
        words worst_error_dph model_apart_dph forms objections""",
    "registry rebuild --out ROOT": REGISTRY,
    "registry rebuild --out ROOT --check": REGISTRY,
    "registry list --out ROOT": "registry runs",
    "registry show U-1 --out ROOT": "unit runs",
    "registry lot L U-1 --out ROOT": "ledger kind lot units",
    "registry operator Ada --out ROOT": "ledger kind name",
    "registry equipment add c s --kind chamber --out ROOT": "ledger kind name serial type calibrated_on due_on",
    "registry equipment list --out ROOT": "on equipment",
    "registry recall c --out ROOT": "equipment since runs unknown elsewhere",
    "fleet diagnose --model polynomial --out ROOT": """model units made failed left_out engine seconds lots
        in_common""",
    "fleet refit --model polynomial --out ROOT": """model units failed without_moments left_out engine seconds
        units_per_s rms_dph failures weights records""",
}
NO_SUBSET = {"effects show aging", "registry show U-1 --out ROOT"}
"""These have further keys by what there is: sections of the documentation, tables."""


@pytest.fixture(scope="module")
def places(tmp_path_factory):
    """Values of the placeholders in capitals."""
    root = tmp_path_factory.mktemp("keys")
    profile, table = root / "tiny.yaml", root / "log.csv"
    profile.write_text(PROFILE.replace("TO", "30"))
    rows = "\n".join(f"{t},{10 + t / 100},{20 + t / 50}" for t in range(400))
    table.write_text(f"time,rate,temperature\n{rows}\n")
    run = make_run(root / "reports" / "U-1" / "r1", **ramp_run(LEGS, loop_dph=0.0), unit="U-1", run="r1")
    (root / "out").mkdir()
    bench("report", run, "--model", "polynomial")
    bench("registry", "rebuild", "--out", root / "reports")
    return {"PROFILE": profile, "TABLE": table, "RUN": run, "ROOT": root / "reports", "OUT": root / "out"}


IMU_KEYS = {
    "imu IMU/imu.csv --plan IMU/imu.yaml --unit U-7 --out IMU/cal":
        "table out files rows left_out range_degc parameters undetermined findings",
    "imu IMU/check.csv --plan IMU/check.yaml --verify IMU/cal":
        """table calibration files format created sources verdict rows stays fitted_rows rows_beyond range_degc axes
        quantities rule""",
    "export IMU/cal --format px4 --force":
        "run format files unit serial calibration_id crc words lost objections",
}  # fmt: skip
"""One after the other, in one folder."""
SYNC_KEYS = {
    "sync send --centre ROOT/../centre --out ROOT": "centre sent there files bytes damaged unfinished",
    "sync status --centre ROOT/../centre --out ROOT": """centre waiting there damaged unfinished reached asked
        cause""",
    "sync list --centre ROOT/../centre": "centre folders",
    "sync fetch --centre ROOT/../centre --out ROOT/../here": "centre archive folders there kept damaged",
    "sync scrub --centre ROOT/../centre": "centre entries files bytes faults set_aside",
    "sync release --centre ROOT/../centre --older-than 9 --out ROOT": "centre folders bytes refused",
}
"""One after the other."""


def asked(command, places):
    words = command.split()
    for name, place in places.items():
        words = [str(place) + word.removeprefix(name) if word.split("/")[0] == name else word for word in words]
    answer = bench(*words, "--json")
    assert answer.exit_code in {0, 1}, answer.stderr
    return json.loads(answer.stdout)


@pytest.mark.parametrize("command", KEYS)
@pytest.mark.slow
def test_a_command_answers_with_its_keys(command, places):
    found, wanted = set(asked(command, places)), set(KEYS[command].split())
    assert found >= wanted
    if command not in NO_SUBSET:
        assert found == wanted


def test_a_bench_and_its_centre_answer_with_their_keys(places):
    for command, keys in SYNC_KEYS.items():
        assert set(asked(command, places)) == set(keys.split()), command


@pytest.mark.slow
def test_an_inertial_unit_answers_with_its_keys(tmp_path):
    plan = imu_data.calibration(1, (-10.0, 40.0), 4.0)
    imu_data.written(drawn(1), imu_data.at_home(), 1, plan, tmp_path)
    other = [imu_data.Move(imu_data.Attitude.of("other", (1.0, 2.0, 3.0), 20.0), 0.0, 25.0)] * 3
    imu_data.written(drawn(1), imu_data.at_home(), 2, other, tmp_path, "check")
    for command, keys in IMU_KEYS.items():
        assert set(asked(command, {"IMU": tmp_path})) == set(keys.split()), command


def test_results_of_lots_gauges_and_restored_runs_have_their_keys():
    expected = {"error_dph": 0.1, "low_dph": 0.05, "high_dph": 0.2}
    done = LotCompleted(Path("r"), "L", *expected.values())
    assert set(rendering.content(done)) == {"run", "lot", *expected}
    planned = LotPlanned("L", Path("p.yaml"), 0.3, *expected.values(), 2.0, 8.0)
    assert set(rendering.content(planned)) == {"lot", "profile", "target_dph", *expected, "hours", "whole_hours"}
    audited = LotAudited("L", {"stopped": 3}, 0.4, 0, 0, None, None, 0)
    wanted = {"lot", "outcomes", "saved", "audits", "held", "held_from", "held_to", "over"}
    assert set(rendering.content(audited)) == wanted
    (folder,) = rendering.content(RunsRestored([(Path("r"), 2)]))["folders"]
    assert folder == {"run": "r", "files": 2}
    values = np.random.default_rng(1).normal(0.0, 1.0, 12)
    names = [(f"U{i % 3}", f"S{i // 3 % 2}") for i in range(12)]
    found = gauge(values, [unit for unit, _ in names], [station for _, station in names])
    assert set(rendering.content(GaugeJudged("bias_max_dph", "deg/h", found, ()))) == {
        "quantity", "unit", "left_out", "units", "stations", "runs", "components", "sources", "share", "acceptable",
        "categories",
    }  # fmt: skip


def test_results_of_equipment_and_live_runs_have_their_keys(tmp_path):
    live = {"run": "r", "state": "holding", "folders": []}
    assert rendering.content(LiveRuns("here", [live])) == {"runs": [live]}
    assert rendering.content(Asked("hold", "r", live)) == live
    end = {"run": "r", "state": "aborted", "cause": "c", "safe": True, "safe_state": []}
    assert rendering.content(Aborted(end)) == end
    assert rendering.content(StationServed(502, {"can0": 1})) == {"modbus_port": 502, "can_ports": {"can0": 1}}
    record = {"unit": "U", "state": "already there", "calibration_id": "0x1"}
    assert rendering.content(Flashed(record)) == record
    units = UnitsReported((UnitReport("U", NotAnalysed(Path("r"), "why", 2)),))
    (unit,) = rendering.content(units)["units"]
    assert set(unit) == {"unit", "run", "verdict", "sentence", "rms_dph", "error"}
    job = JobFile.create(tmp_path, "U", "plan", f"{date.today()}")
    assert set(rendering.content(Calibrated(job, STEP_NAMES))) == {
        "unit", "plan", "state", "verdict", "sentence", "releases", "job", "run", "verification", "certificate",
        "steps",
    }  # fmt: skip
    both = CalibratedAll((Calibrated(job, STEP_NAMES),) * 2)
    assert [unit["unit"] for unit in rendering.content(both)["units"]] == ["U", "U"]


@pytest.mark.slow
def test_a_pipe_gets_tables_in_full_width_and_without_colour(places, monkeypatch):
    monkeypatch.setenv("COLUMNS", "40")
    answer = bench("compare", places["RUN"], "--model", "polynomial")
    title, row, *_ = answer.stdout.splitlines()
    assert title.split()[:3] == ["model", "in-sample", "held-out"]
    assert row.startswith("polynomial ")
    assert row.endswith(" x")
    assert "\x1b" not in answer.stdout
