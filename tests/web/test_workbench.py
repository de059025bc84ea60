"""The workbench over HTTP: analyse, zoom, diagnose, add, undo, save, compare; a hidden loop is found."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import httpx
import numpy as np
import pytest
from click.testing import CliRunner

from bench.analysis import DescribedFormula, Noise, load_model, model_from
from bench.analysis.diagnosis.answer import SuspectedEffect
from bench.analysis.diagnosis.experiment import Proposal
from bench.analysis.diagnosis.plan import chamber_limits, minor_loops
from bench.analysis.diagnosis.proof import Proof
from bench.analysis.thresholds import ADEQUATE_RATIO, EXPLAINED_RATIO, NAMED_FALL, NEAREST_RATIO
from bench.base import number, user_name
from bench.cli import main
from bench.deliver import coordinate_over, drawable_coordinates
from bench.record import Dataset, NotesRecord, prove
from bench.record.reading import load
from bench.web.ground.settings import Settings
from bench.web.people.access import Access
from bench.web.workbench import captions, diagnosing, drawing
from bench.web.workbench.zoom import view
from tests.support import run_folders
from tests.support.page_modules import told
from tests.support.web_client import served

API = "/api/v1"

RUN, OTHER = "SIM-0001/20261121T060000Z_ramp", "SIM-0002/20261121T070000Z_ramp"

SPLINE: dict[str, Any] = {"name": "spline", "effects": [{"effect": "spline", "intervals": 12}]}

LOOP: dict[str, Any] = {"name": "loop", "effects": [*SPLINE["effects"], {"effect": "hysteresis"}]}


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two units that hide a loop, one with a spike of a single sample."""
    out = tmp_path_factory.mktemp("store")
    for run, seed in ((RUN, 1), (OTHER, 2)):
        made = run_folders.ramp_run(rate_hz=4.0, seed=seed)
        made["columns"]["rate"][20_001] += 500.0
        run_folders.make_run(out / run, **made, unit=run.partition("/")[0])
    return out


@pytest.fixture(scope="module")
def client(store: Path) -> Iterator[httpx.Client]:
    with served(Settings(out=store, project=store)) as found:
        yield found


def done(client: httpx.Client, path: str, body: dict[str, Any]) -> dict[str, Any]:
    answer = ended(client, path, body)
    assert answer["state"] == "done", answer["detail"]
    result: dict[str, Any] = answer["result"]
    return result


def ended(client: httpx.Client, path: str, body: dict[str, Any]) -> dict[str, Any]:
    asked = client.post(f"{API}{path}", json=body)
    assert asked.status_code == 202, asked.text
    while True:
        answer = client.get(f"{API}/jobs/{asked.json()['job']}", params={"wait_s": 20}).json()
        if answer["state"] in {"done", "failed"}:
            found: dict[str, Any] = answer
            return found


@pytest.mark.slow
def test_the_hidden_effect_is_found_added_and_taken_back(client: httpx.Client, store: Path) -> None:
    before = done(client, "/analyses", {"runs": [RUN], "models": [SPLINE]})
    found = done(client, "/diagnoses", {"runs": [RUN], "model": SPLINE})
    assert found["verdict"] == "missing_effect"
    suspect = found["suspects"][0]
    assert suspect["effect"] in {"hysteresis", "creep"}
    assert suspect["partial"]["figure"]["data"]
    assert suspect["why"].startswith("Evidence")
    unheld = {one["effect"]: one["unheld"] for one in found["suspects"]}
    assert unheld["hysteresis"] == "", "as it is told of a model that is saved with it"
    assert all("filter_s" in why for effect, why in unheld.items() if effect == "temperature_rate")
    brief = done(client, "/diagnoses", {"runs": [RUN], "model": SPLINE, "brief": True})
    undrawn = [{**one, "partial": None} for one in found["suspects"]]
    assert brief == {**found, "suspects": undrawn, "figures": {}, "next_experiment": None}
    longer = {"name": "better", "effects": [*SPLINE["effects"], *suspect["add"]]}
    after = done(client, "/analyses", {"runs": [RUN], "models": [SPLINE, longer]})
    for error in ("rms_dph", "held_out_rms_dph"):
        assert after["rungs"][1][error] < 0.7 * after["rungs"][0][error]
    again = client.post(f"{API}/analyses", json={"runs": [RUN], "models": [SPLINE]}).json()
    assert again["state"] == "done"  # Undo: there already
    assert client.get(f"{API}/jobs/{again['job']}").json()["result"] == before
    assert sorted(path.name for path in (store / RUN).iterdir()) == [
        "chain.seal", "data.parquet", "events.jsonl", "manifest.json", "means.parquet",
    ]  # fmt: skip


FIRST_REQUESTS = """
import json, sys
from importlib import import_module
from bench.web.jobs.work import load

load()
before = set(sys.modules)
for target, inputs in json.load(sys.stdin):
    module, _, name = target.rpartition(".")
    getattr(import_module(f"bench.web.workbench.{module}"), name)(inputs)
large = ("bench", "cryptography", "narwhals", "pandas", "plotly", "pyarrow", "scipy")
small = "plotly.graph_objs"  # a class each
later = [name for name in set(sys.modules) - before if name.startswith(large) and not name.startswith(small)]
print(json.dumps(sorted({".".join(name.split(".")[:2]) for name in later})))
"""


@pytest.mark.slow
def test_nothing_large_is_loaded_while_somebody_waits_for_the_first_answers(store: Path) -> None:
    run = {"run": RUN, "path": str(store / RUN), "content": "1"}
    content = {"name": "spline", "effects": [{"spline": {"intervals": 12}}], "rows": "all"}
    inputs = {"runs": [run], "check": [], "static": None, "sisters": [], "model": content, "models": [content]}
    requests = [
        ("computing.analysis", inputs),
        ("drawing.draw", {**inputs, "kind": "time", "over": "temperature", "every": False}),
        ("diagnosing.diagnosis", {**inputs, "brief": True, "plans": ""}),
    ]
    answer = subprocess.run(
        [sys.executable, "-c", FIRST_REQUESTS], input=json.dumps(requests), capture_output=True, text=True, check=True
    )
    assert json.loads(answer.stdout) == []


def test_runs_of_sister_units_go_to_the_diagnosis(client: httpx.Client) -> None:
    answer = ended(client, "/diagnoses", {"runs": [RUN], "sisters": [OTHER], "model": SPLINE})
    assert answer["state"] == "failed"
    assert "compared with one of the unit itself" in answer["detail"]


def test_the_next_experiment_is_a_plan(client: httpx.Client, store: Path) -> None:
    limits = chamber_limits([load(store / RUN)])
    text = minor_loops(limits).to_yaml(limits, "Tells apart: hysteresis, creep.")
    proposal = Proposal(("hysteresis", "creep"), "they look alike", 2.0, 60.0, 150.0, "minor_loops", text, (0.1, 0.9))
    experiment = diagnosing.planned(proposal, store / ".web" / "plans", "20261121T060000Z_ramp")
    assert experiment["curve"][0][0] == 0.0
    assert experiment["probability_after"] > experiment["probability_before"]
    plans = client.get(f"{API}/plans").json()["plans"]
    assert experiment["plan"] in [plan["id"] for plan in plans if not plan["problem"]]


@pytest.mark.parametrize("kind", ["time", "temperature", "map", "loop", "axes", "allan", "ladder"])
def test_every_figure_has_words_and_a_table(client: httpx.Client, kind: str) -> None:
    made = done(client, "/figures", {"kind": kind, "runs": [RUN], "model": SPLINE})
    assert made["figure"]["data"]
    assert len(made["words"]) > 40
    assert len({len(row) for row in made["csv"]}) == 1
    assert str(made["words"]).isprintable()
    most = max(len(trace["x"]) for trace in made["figure"]["data"])
    assert most <= 2100


@pytest.mark.parametrize("kind", ["time", "temperature", "loop", "axes"])
def test_a_figure_of_a_range_says_how_far_all_data_go(client: httpx.Client, kind: str) -> None:
    made = [
        done(client, "/figures", {"kind": kind, "runs": [RUN], "model": SPLINE, **asked})
        for asked in ({"from_s": 600.0, "to_s": 1800.0}, {})
    ]
    part, whole = (one["figure"]["layout"]["meta"]["whole"] for one in made)
    assert part == whole
    assert whole[1] - whole[0] > 0.4


def test_a_range_of_temperature_is_that_of_all_channels(client: httpx.Client) -> None:
    layout = done(client, "/figures", {"kind": "channels", "runs": [RUN], "model": None})["figure"]["layout"]
    others = [value for name, value in layout.items() if re.fullmatch(r"xaxis\d+", name)]
    assert others
    assert {one["matches"] for one in others} == {"x"}


def test_a_caption_counts_time_as_its_figure_and_names_only_what_is_drawn(client: httpx.Client) -> None:
    made = done(client, "/figures", {"kind": "time", "runs": [RUN], "model": SPLINE})
    assert re.search(r"largest here at \d+\.\d\d h: ", made["words"])
    found = done(client, "/diagnoses", {"runs": [RUN], "model": SPLINE})
    units = {one["channel"]: one["unit"] for one in found["where"]}
    assert units["dT_dt"] == "degC/min"
    assert all(units.values())
    for partial in (one["partial"] for one in found["suspects"] if one["partial"]):
        drawn = any(trace.get("marker", {}).get("symbol") == "diamond" for trace in partial["figure"]["data"])
        assert ("Diamonds" in partial["words"]) == drawn


def test_a_formula_is_what_to_add_first_where_the_catalogue_does_not_hold_what_is_missing() -> None:
    cases = [{"verdict": verdict, "formulas": [{}]} for verdict in ("unknown_effect", "missing_effect")]
    assert told("pages/workbench/suspects.js", "console.log(JSON.stringify(given.map(page.leads)))", cases) == [
        True,
        False,
    ]


def test_a_noise_floor_above_the_error_is_said_to_be_an_upper_bound() -> None:
    script = "console.log(JSON.stringify(given.map((rung) => page.floorWord(rung, 0.1))))"
    rungs = [{"heldOut": error, "inSample": 0.05} for error in (0.06, 0.09, 0.2)]
    words = ["workbench.ladder.floor_high", "workbench.ladder.noise", "workbench.ladder.noise"]
    assert told("pages/workbench/ladder.js", script, rungs) == words
    limits = told(
        "lib/floor.js", "console.log(JSON.stringify([page.BOUND, page.NEAREST, page.ADEQUATE, page.UNCHANGED]))", []
    )
    assert limits == [EXPLAINED_RATIO, NEAREST_RATIO, ADEQUATE_RATIO, NAMED_FALL]  # of the terminal


def test_models_of_the_ladder_that_begin_and_end_alike_have_unlike_names() -> None:
    longer = "spline + thermal_lag + {}hysteresis + creep"
    names = [longer.format(""), longer.format("aging + "), longer.format("aging + "), "spline"]
    script = "console.log(JSON.stringify(page.shortened(given, 160)))"
    plain, aged, again, short = told("pages/workbench/ladder.js", script, names)
    assert (plain, aged, again) == ("…hysteresis + creep", "…aging + hy…esis + creep", aged)
    assert short == "spline"


@pytest.mark.parametrize(("over", "title"), [
    ("time", "time [h]"), ("dT_dt", "dT/dt [°C/min]"), ("quadrature", "quadrature [V]"),
])  # fmt: skip
def test_a_residual_is_drawn_over_whatever_the_run_has(client: httpx.Client, over: str, title: str) -> None:
    made = done(client, "/figures", {"kind": "axes", "runs": [RUN], "model": SPLINE, "over": over})
    assert made["figure"]["layout"]["xaxis"]["title"]["text"] == title
    assert made["figure"]["layout"]["yaxis"]["title"]["text"] == "measured − model [deg/h]"
    header, *rows = made["csv"]
    whole = done(client, "/figures", {"kind": "loop", "runs": [RUN], "model": SPLINE})["csv"]
    assert header == ["time [s]", title, "residual [deg/h]"]
    assert [row[2] for row in rows] == [row[2] for row in whole[1:]]
    assert {"time", "temperature", "dT_dt", over, "drive"} <= set(made["axes"])
    assert "rate" not in made["axes"]


def test_a_residual_is_drawn_over_the_time_since_the_last_extreme_and_its_temperature(client: httpx.Client) -> None:
    time_s = 60.0 * np.arange(100)
    degc = np.interp(time_s, [0, 1800, 2400, 4200, 6000], [20, 50, 50, 20, 35])
    zero = np.zeros(100)
    data = Dataset("run", time_s, {"rate": zero, "temperature": degc}, zero.astype(np.int64), (), 60.0)
    since, last = (coordinate_over(data, name).values for name in ("since_extreme", "last_extreme"))
    assert np.isnan(since[:29]).all()
    reached = 30 + np.flatnonzero(np.diff(since[30:]) < 0) + 1
    assert abs(int(reached[0]) - 70) <= 1
    assert np.ptp(since[35:65] - time_s[35:65] / 60) == 0, "the stay counts from the moment that it began"
    np.testing.assert_allclose([last[50], last[90]], [50, 20], atol=1)
    body = {"kind": "axes", "runs": [RUN], "model": SPLINE, "over": "last_extreme"}
    assert {"since_extreme", "last_extreme"} <= set(done(client, "/figures", body)["axes"])
    still = Dataset("run", time_s, {"rate": zero, "temperature": zero}, zero.astype(np.int64), (), 60.0)
    assert "since_extreme" not in drawable_coordinates(still)


def test_residuals_of_all_runs_lie_over_each_other_and_a_selected_time_holds_for_every_axis(
    client: httpx.Client,
) -> None:
    body = {"kind": "axes", "runs": [RUN], "check": [OTHER], "over": "dT_dt", "every": True}
    for model in (SPLINE, None):
        drawn = done(client, "/figures", {**body, "model": model})
        assert [trace["name"] for trace in drawn["figure"]["data"] if trace["mode"] == "lines+markers"] == [RUN, OTHER]
        head, *rows = drawn["csv"]
        assert head[:2] == ["run", "time [s]"]
        assert {row[0] for row in rows} == {RUN, OTHER} == {trace["legendgroup"] for trace in drawn["figure"]["data"]}
    some = done(client, "/figures", {"kind": "axes", "runs": [RUN], "over": "temperature", "from_s": 0, "to_s": 3000})
    assert max(row[0] for row in some["csv"][1:]) <= 3000


def test_a_run_that_lacks_the_quantity_is_named_beside_those_that_lie_over_each_other(tmp_path: Path) -> None:
    for run in (RUN, OTHER):
        made = run_folders.ramp_run(rate_hz=1.0)
        if run == OTHER:
            del made["columns"]["drive"]
        run_folders.make_run(tmp_path / run, **made, unit=run.partition("/")[0])
    body = {"kind": "axes", "runs": [RUN], "check": [OTHER], "every": True}
    with served(Settings(out=tmp_path, project=tmp_path)) as client:
        words = [done(client, "/figures", {**body, "over": over})["words"] for over in ("drive", "temperature")]
    assert [f"Without such data, and not drawn: {OTHER}." in text for text in words] == [True, False]


def test_a_residual_over_what_the_run_does_not_have_is_refused_with_what_there_is(client: httpx.Client) -> None:
    answer = ended(client, "/figures", {"kind": "axes", "runs": [RUN], "model": SPLINE, "over": "quadratur"})
    assert answer["state"] == "failed"
    assert f"{RUN} has no channel 'quadratur'" in answer["detail"]
    assert "quadrature" in answer["detail"]


@pytest.mark.parametrize("kind", ["temperature", "loop", "axes"])
def test_a_selection_without_data_is_said_and_no_other_figure_stands_for_it(client, kind):
    body = {"kind": kind, "runs": [RUN], "model": SPLINE, "over": "temperature", "from_degc": 300, "to_degc": 301}
    answer = ended(client, "/figures", body)
    assert (answer["state"], "nothing was captured in this range" in answer["detail"]) == ("failed", True)


@pytest.mark.parametrize("kind", ["time", "temperature", "loop", "axes"])
def test_the_residual_in_a_figure_can_be_keptfrom_all_else(client: httpx.Client, kind: str) -> None:
    made = done(client, "/figures", {"kind": kind, "runs": [RUN], "model": SPLINE})["figure"]
    left = [trace for trace in made["data"] if trace.get("meta") == "residual"]
    assert left
    for trace in left:
        title = made["layout"][f"yaxis{trace.get('yaxis', 'y')[1:]}"]["title"]["text"]
        assert title in {"residual [deg/h]", "measured − model [deg/h]"}
    bare = done(client, "/figures", {"kind": kind, "runs": [RUN]})["figure"]
    assert not [trace for trace in bare["data"] if trace.get("meta") == "residual"]


def test_one_error_and_one_floor_whatever_is_shown(client: httpx.Client, store: Path) -> None:
    struck = run_folders.ramp_run(rate_hz=4.0)
    time = struck["columns"]["time"]
    struck["columns"]["rate"] = struck["columns"]["rate"] + 20.0 * ((time >= 4500.0) & (time < 4800.0))
    run_folders.make_run(store / "SIM-0005" / "struck", **struck, unit="SIM-0005")
    for runs in ([RUN], ["SIM-0005/struck"]):
        known = done(client, "/analyses", {"runs": runs, "models": [SPLINE]})
        said, errors = set(), set()
        for view_of in ({"width": 100}, {"width": 2000}, {"from_s": 3000.0, "to_s": 3400.0}):
            words = done(client, "/figures", {"kind": "time", "runs": runs, "model": SPLINE, **view_of})["words"]
            errors.add(re.search(r": ([\d.]+) deg/h RMS", words)[1])
            said.add(re.search(r"oise floor ([\d.]+)", words)[1])
        assert (errors, said) == ({number(known["models"][0]["rms_dph"])}, {number(known["floor_dph"])})


def test_data_that_a_model_does_not_fit_are_drawn_all_the_same_and_a_model_that_follows_them_is_there(
    client: httpx.Client, store: Path
) -> None:
    legs = [("up", "ramp", 60.0, 4.0), ("end", "soak", 60.0, 1800.0), ("down", "ramp", 20.0, 4.0)]
    run_folders.make_run(store / "SIM-0004" / "short", **run_folders.ramp_run(legs))
    runs = {"runs": ["SIM-0004/short"]}
    fine = {"name": "fine", "effects": [{"effect": "spline", "intervals": 24}]}
    for kind in ("time", "temperature"):
        drawn = done(client, "/figures", {"kind": kind, **runs, "model": fine})
        assert "use fewer intervals" in drawn["note"]
        assert drawn["figure"]["data"]
    first = told("pages/workbench/first.js", "console.log(JSON.stringify(page.FOLLOWING_MODEL))")
    analysed = done(client, "/analyses", {**runs, "models": [first]})["models"][0]
    assert analysed["rms_dph"] < 1.0
    script = "console.log(JSON.stringify(given.map(page.isOpen)))"
    assert told("pages/workbench/first.js", script, [first, analysed["model"]]) == [True, False]
    settled = done(client, "/analyses", {**runs, "models": [analysed["model"]]})["models"][0]
    assert settled["rms_dph"] == analysed["rms_dph"]
    assert "note" not in done(client, "/figures", {"kind": "time", **runs, "model": analysed["model"]})


def test_looking_closer_fetches_finer_data_until_every_sample_is_seen(client: httpx.Client) -> None:
    wide = done(client, "/figures", {"kind": "time", "runs": [RUN], "model": SPLINE, "width": 500})
    spike_s = 20_001 / 4.0
    near = done(client, "/figures", {
        "kind": "time", "runs": [RUN], "model": SPLINE, "from_s": spike_s - 20, "to_s": spike_s + 20,
    })  # fmt: skip
    assert wide["interval_s"] > 10
    assert near["interval_s"] == pytest.approx(0.25)
    assert near["of"] == "samples"
    highest = [max(row[3] for row in made["csv"][1:] if row[3] is not None) for made in (wide, near)]
    assert highest[1] > 500
    assert highest[0] > 125  # of 1 s means, four samples each: the spike survives there, too


def test_a_stretch_without_data_says_so(client: httpx.Client) -> None:
    answer = ended(client, "/figures", {"kind": "time", "runs": [RUN], "from_s": 1e7, "to_s": 2e7})
    assert answer["state"] == "failed"
    assert "the run has" in answer["detail"]
    assert "\n" not in answer["detail"]


def test_messages_name_runs_by_their_id(client: httpx.Client, store: Path) -> None:
    folder = run_folders.make_run(store / "SIM-0003" / "one", **run_folders.ramp_run(rate_hz=1.0))
    (folder / "means.parquet").unlink()
    answer = ended(client, "/figures", {"kind": "loop", "runs": ["SIM-0003/one"]})
    assert answer["detail"].startswith("SIM-0003/one/means.parquet: missing")


def test_runs_of_two_units_are_compared_but_not_fitted_together(client: httpx.Client) -> None:
    both = ended(client, "/analyses", {"runs": [RUN, OTHER], "models": [SPLINE]})
    assert "different units" in both["detail"]
    drawn = done(client, "/figures", {"kind": "temperature", "runs": [RUN, OTHER]})
    means = {
        trace["name"]: np.nanmean(np.array(trace["y"], dtype=float))
        for trace in drawn["figure"]["data"]
        if trace["name"] in {RUN, OTHER}
    }
    assert means == {RUN: pytest.approx(0.0, abs=0.1), OTHER: pytest.approx(0.0, abs=0.1)}  # on one zero
    found = done(client, "/differences", {"a": RUN, "b": OTHER})
    assert (found["a"]["run"], found["b"]["run"]) == (RUN, OTHER)


def test_a_formula_is_checked_as_it_is_typed_and_fitted_like_any_effect(client: httpx.Client) -> None:
    def asked(expression: str, **more: Any) -> dict[str, Any]:
        answer: dict[str, Any] = client.post(f"{API}/effects/formula", json={"expression": expression, **more}).json()
        return answer

    assert asked("k * dT_dt")["parameters"] == ["k"]
    assert "did you mean 'temperature'" in asked("k * tempratur")["detail"]
    assert not asked("__import__('os')")["ok"]
    assert asked("k * supply")["ok"]
    lacking = asked("k * supply", runs=[RUN])
    assert not lacking["ok"]
    assert f"{RUN} has no channel 'supply': choose one of temperature, " in lacking["detail"]
    assert asked("k * dT_dt * temperature", runs=[RUN])["ok"]
    assert asked("a * slew(temperature, v) + b * exp(lag(dT_dt, tau_s) / c) + k * time ** p")["bounds"] == {
        "v": [0.1, 10.0], "tau_s": [10.0, 3600.0], "c": [0.1, 10.0], "p": [0.1, 10.0],
    }  # fmt: skip
    assert asked("k * dT_dt / pi")["bounds"] == asked("k * lag(")["bounds"] == {}
    term = asked("a * play(temperature, w)", bounds={"w": [1, 20]})
    model = {"name": "own", "effects": [*SPLINE["effects"], term["effect"]]}
    rungs = done(client, "/analyses", {"runs": [RUN], "models": [SPLINE, model]})["rungs"]
    assert rungs[1]["held_out_rms_dph"] < 0.7 * rungs[0]["held_out_rms_dph"]


def test_models_are_kept_by_name_and_never_replaced(client: httpx.Client, store: Path) -> None:
    made = client.post(f"{API}/models", json={"name": "mine", "model": LOOP})
    assert made.status_code == 201
    assert client.post(f"{API}/models", json={"name": "mine", "model": LOOP}).status_code == 200
    other = client.post(f"{API}/models", json={"name": "mine", "model": SPLINE})
    assert (other.status_code, "choose another name" in other.json()["detail"]) == (409, True)
    assert client.post(f"{API}/models", json={"name": "spline", "model": LOOP}).status_code == 409
    assert client.post(f"{API}/models", json={"name": "../mine", "model": LOOP}).status_code == 422
    known = {model["name"]: model for model in client.get(f"{API}/models").json()["models"]}
    assert known["mine"]["where"] == "project"
    assert [effect["effect"] for effect in known["mine"]["effects"]] == ["spline", "hysteresis"]


def test_a_model_of_the_page_is_one_of_the_command_line_by_its_name(
    client: httpx.Client, store: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    saved = client.post(f"{API}/models", json={"name": "ours", "model": LOOP}).json()
    monkeypatch.chdir(store)
    assert [effect.name for effect in load_model(saved["name"]).effects] == ["spline", "hysteresis"]
    (store / "profiles" / "models" / "theirs.yaml").write_text(load_model("ours").to_yaml())
    assert "theirs" in {model["name"] for model in client.get(f"{API}/models").json()["models"]}


@pytest.mark.parametrize("name", ["лінія_1", "模型-2"])
def test_a_model_has_a_name_in_its_users_own_script_on_the_command_line_too(
    client: httpx.Client, store: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    saved = client.post(f"{API}/models", json={"name": name, "model": LOOP})
    assert (saved.status_code, saved.json()["name"]) == (201, name)
    assert name in saved.json()["yaml"], "people can read it"
    assert client.post(f"{API}/models", json={"name": f"{name} /", "model": LOOP}).status_code == 422
    monkeypatch.chdir(store)
    compared = CliRunner().invoke(main, ["compare", str(store / RUN), "--model", name])
    assert compared.exit_code == 0, compared.output
    assert name in compared.output


def test_who_saves_a_model_is_told_that_no_unit_can_hold_it_and_which_ones_a_unit_can(client: httpx.Client) -> None:
    term = {"effect": "expression", "formula": "k * time"}
    model = {"name": "x", "effects": [*SPLINE["effects"], term]}
    told = client.post(f"{API}/models", json={"name": "of_time", "model": model}).json()["undeliverable"]
    assert "'time' needs time" in told
    named = told.partition("models that a unit can hold: ")[2].split(", ")
    assert {"polynomial", "spline"} <= {*named}
    assert not {"of_time", "expression", "scale_factor"} & {*named}
    assert client.post(f"{API}/models", json={"name": "held", "model": LOOP}).json()["undeliverable"] == ""
    for needs, option in (
        ({"effect": "temperature_rate"}, "filter_s"),
        ({"effect": "creep", "initial": "free"}, "initial"),
    ):
        model = {"name": "x", "effects": [*SPLINE["effects"], needs]}
        told = client.post(f"{API}/models", json={"name": needs["effect"], "model": model}).json()["undeliverable"]
        assert option in told, "it is told now, not after the run"
    follows = {"name": "x", "effects": [*SPLINE["effects"], {"effect": "supply_voltage"}]}
    for runs, said in (([], ""), ([RUN], "this unit has no channel supply")):
        asked = {"name": "follows", "model": follows, "runs": runs}
        told = client.post(f"{API}/models", json=asked).json()["undeliverable"]
        assert (said in told, bool(said) == bool(told)) == (True, True), told


def test_a_parameter_of_a_model_has_its_unit(client: httpx.Client) -> None:
    (model,) = done(client, "/analyses", {"runs": [RUN], "models": [LOOP]})["models"]
    assert [(one["key"], one["unit"]) for one in model["parameters"]] == [("hysteresis.width_degc", "degC")]


def test_the_page_offers_every_model_that_can_be_read(client: httpx.Client, store: Path) -> None:
    client.post(f"{API}/models", json={"name": "offered", "model": LOOP})
    (store / "profiles" / "models" / "broken.yaml").write_text("name: broken")
    answer = client.get(f"{API}/models").json()
    script = "console.log(JSON.stringify(page.offered(given.models)))"
    offered = {one["name"]: one["model"] for one in told("pages/workbench/offered.js", script, answer)}
    assert {"spline", "surface", "offered"} <= offered.keys()
    assert "broken" not in offered
    assert [effect["effect"] for effect in offered["offered"]["effects"]] == ["spline", "hysteresis"]
    assert client.post(f"{API}/analyses", json={"runs": [RUN], "models": [offered["offered"]]}).status_code == 202


@pytest.mark.parametrize(
    ("path", "body", "status", "said"),
    [
        ("/analyses", {"runs": [RUN], "models": [{"name": "x", "effects": [{"effect": "splin"}]}]}, 400, "'spline'"),
        ("/analyses", {"runs": ["../../etc/passwd"], "models": [SPLINE]}, 404, "no run"),
        ("/analyses", {"runs": [], "models": [SPLINE]}, 422, "runs"),
        ("/figures", {"kind": "pie", "runs": [RUN]}, 422, "kind"),
        ("/figures", {"kind": "time", "runs": [RUN], "from_s": "nan"}, 422, "from_s"),
        ("/differences", {"a": RUN, "b": RUN}, 400, "choose two runs"),
        ("/diagnoses", {"runs": [RUN], "model": {"name": "x", "effects": [{"effect": "spline", "intervals": -1}]}}, 400,
         "intervals"),
    ],
)  # fmt: skip
def test_bad_input_is_refused_before_anything_is_computed(
    client: httpx.Client, path: str, body: dict[str, Any], status: int, said: str
) -> None:
    answer = client.post(f"{API}{path}", json=body)
    assert (answer.status_code, said in answer.json()["detail"]) == (status, True), answer.text
    assert "\n" not in answer.json()["detail"]


def test_a_run_that_goes_on_is_not_analysed(client: httpx.Client, store: Path) -> None:
    (store / "SIM-0001" / "live" / "journal").mkdir(parents=True)
    answer = client.post(f"{API}/analyses", json={"runs": ["SIM-0001/live"], "models": [SPLINE]})
    assert (answer.status_code, "only an ended run" in answer.json()["detail"]) == (409, True)
    assert "`bench" not in answer.json()["detail"], "the page has a button"


def test_viewers_look_and_engineers_compute(store: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from bench.web.people.access import Who

    monkeypatch.setattr(Access, "who", lambda self, request: Who("Vera", "viewer", "127.0.0.1"))
    with served(Settings(out=store)) as client:
        assert client.post(f"{API}/figures", json={"kind": "loop", "runs": [RUN]}).status_code == 202
        for path, body in (
            ("/analyses", {"runs": [RUN], "models": [SPLINE]}),
            ("/diagnoses", {"runs": [RUN], "model": SPLINE}),
            ("/models", {"name": "x", "model": SPLINE}),
            ("/differences", {"a": RUN, "b": OTHER}),
            (f"/runs/{RUN}/notes", {"text": "x"}),
        ):
            assert client.post(f"{API}{path}", json=body).status_code == 403
        saved = f"{API}/runs/{RUN}/views/x"
        assert client.put(saved, json={"address": "?run=a"}).status_code == client.delete(saved).status_code == 403
        assert client.get(f"{API}/runs/{RUN}/notes").json()["notes"] == []


def test_notes_and_views_stay_with_the_run_whoever_writes_at_the_same_time(client: httpx.Client, store: Path) -> None:
    place = f"{API}/runs/{OTHER}"
    texts = [f"note {number}" for number in range(12)]
    with ThreadPoolExecutor(6) as people:
        answers = list(people.map(lambda text: client.post(f"{place}/notes", json={"text": text}), texts))
    assert {answer.status_code for answer in answers} == {201}
    for address in ("?run=a&figure=map", "?run=a&figure=loop"):
        client.put(f"{place}/views/до ремонту", json={"address": address}).raise_for_status()
    client.put(f"{place}/views/dT/dt, second", json={"address": "?run=b"}).raise_for_status()
    client.delete(f"{place}/views/dT/dt, second").raise_for_status()
    kept = client.get(f"{place}/notes").json()
    assert sorted(note["text"] for note in kept["notes"]) == sorted(texts)
    assert {note["who"] for note in kept["notes"]} == {user_name()}
    assert [(view["name"], view["address"]) for view in kept["views"]] == [("до ремонту", "?run=a&figure=loop")]
    prove(store / OTHER)
    assert NotesRecord.read(store / OTHER).content() == kept


@pytest.mark.parametrize("address", ["//evil.example/", "?a b", "javascript:alert(1)", "?" + "a" * 16000])
def test_a_view_is_a_state_of_the_workbench_and_nothing_else(client: httpx.Client, address: str) -> None:
    assert client.put(f"{API}/runs/{OTHER}/views/x", json={"address": address}).status_code == 422


def test_a_view_keeps_gaps_and_extremes(tmp_path: Path) -> None:
    time = np.arange(100.0) + 0.5
    rate = np.sin(time)
    rate[40] = 99.0
    keep = (time < 60) | (time > 80)
    data = Dataset("x", time[keep], {"rate": rate[keep], "temperature": time[keep]}, np.zeros(keep.sum(), dtype=int))
    shown = view(data, tmp_path / "none", (None, None), 20, None)
    assert shown.time.size == 20
    assert np.nanmax(shown.high) == 99.0
    assert np.isnan(shown.bias[(shown.time > 62) & (shown.time < 78)]).all()
    assert json.dumps(shown.of) == '"1 s means"'
    logged = Dataset("x", 10 * time, {"rate": rate, "temperature": time}, np.zeros(100, dtype=int), interval_s=1.0)
    assert np.isfinite(view(logged, tmp_path / "none", (None, None), 300, None).bias).all(), "10 s from row to row"


def test_a_formula_is_added_with_the_effects_that_it_stands_beside_in_one_step(store: Path) -> None:
    model = model_from({"name": "m", "effects": [{"polynomial": {"order": 2}}]})
    after = model_from({"name": "m", "effects": [
        {"polynomial": {"order": 2}}, "aging", {"expression": {"formula": "k * dT_dt"}},
    ]})  # fmt: skip
    formula = DescribedFormula("k*dT_dt", "k * dT_dt", "", "", 9.0, 0.0, 2.0, 1.0, Proof(), 1.0, (), (0.0, 1.0), "", (),
                               ("aging",), after)  # fmt: skip
    added = diagnosing.drawn(load(store / RUN), model, formula)["add"]
    assert [effect["effect"] for effect in added] == ["aging", "expression"]
    script = """
    const { steps, at } = page.change(page.stateOf(""), { type: "add", effects: given });
    console.log(JSON.stringify([at, steps[at].model.effects.map(({ effect }) => effect), steps[at].model.name]));
    """
    assert told("pages/workbench/state.js", script, added) == [
        1, ["spline", "aging", "expression"], "spline + aging + expression",
    ]  # fmt: skip


def test_a_suspect_tells_everything_that_comes_with_it() -> None:
    """It is judged beside what else was found, and its model has that, too: its step named it alone."""
    model = model_from({"name": "m", "effects": [{"polynomial": {"order": 2}}]})
    alone, both = (
        model_from({"name": "m", "effects": [{"polynomial": {"order": 2}}, *more, "temperature_rate"]})
        for more in ((), ("warm_up",))
    )
    data: Any = [SimpleNamespace(channels={"temperature"})]
    for after, coming in ((alone, ["temperature_rate"]), (both, ["warm_up", "temperature_rate"])):
        suspect = SuspectedEffect("temperature_rate", {}, True, 9.0, 0.0, 2.0, 1.0, 1.0, {}, (), (), after, ())
        found: Any = SimpleNamespace(model=model, threshold=7.0)
        told_of = diagnosing._pictured(data, found, suspect, brief=True)
        assert [effect["effect"] for effect in told_of["add"]] == coming
    script = (
        "const [before, after] = page.change(page.stateOf(''), { type: 'add', effects: given }).steps;"
        "console.log(JSON.stringify(page.labelOf(after.model, before.model)))"
    )
    assert told("pages/workbench/state.js", script, told_of["add"]).count("+") == 2


LATIN = r"[A-Za-z]{3,}"

KEPT = {"SIM-0001", "ramp", "spline", "RMS", "Allan", "loop", "min", "span", "soak", "again"}

"""Names and signs that every language writes so."""


def in_chinese(answers: list[dict[str, Any]]) -> list[list[Any]]:
    """Caption and labels of each answer as the page shows them in Chinese."""
    script = """
    globalThis.document = { documentElement: {} };
    const words = await import(new URL("./words.js", process.argv[1]));
    await words.speak("zh");
    await words.speakOfAll();
    const said = (answer) => {
      const { data, layout } = page.spoken(answer.figure);
      const bars = data.flatMap((trace) => [trace.colorbar, trace.marker?.colorbar]).map((bar) => bar?.title?.text);
      const axes = Object.entries(layout).filter(([key]) => /^[xy]axis/.test(key)).map(([, axis]) => axis.title?.text);
      const labels = [...data.flatMap((trace) => [trace.name, trace.hovertemplate]), ...bars, ...axes,
        ...(layout.annotations ?? []).map((one) => one.text)];
      return [page.caption(answer), ...new Set(labels.filter(Boolean))];
    };
    console.log(JSON.stringify(given.map(said)));
    """
    thin = [
        {"said": answer["said"], "figure": {
            "data": [{key: value for key, value in trace.items() if key not in {"x", "y"}} for trace in
                     ({**trace, "z": [] if "z" in trace else None} for trace in answer["figure"]["data"])],
            "layout": answer["figure"]["layout"],
        }} for answer in answers
    ]  # fmt: skip
    found: list[list[Any]] = told("lib/spoken.js", script, thin)
    return found


def test_figures_and_captions_are_in_the_language_of_the_page(client: httpx.Client) -> None:
    """Nothing English is left, and the English caption is made of the same words."""
    kinds = [
        {"kind": kind, "runs": [RUN], "model": model}
        for kind in ("time", "temperature", "map", "loop", "axes", "allan", "channels") for model in (SPLINE, None)
    ]  # fmt: skip
    wanted = [*kinds, *({**kinds[8], "over": over} for over in ("time", "dT_dt", "drive")), {**kinds[8], "every": True}]
    found = done(client, "/diagnoses", {"runs": [RUN], "model": SPLINE})
    pictures = [*found["figures"].values(), *(one["partial"] for one in found["suspects"] if one["partial"])]
    answers = [*(done(client, "/figures", body) for body in wanted), *pictures]
    assert [sorted(answer) for answer in answers if "said" not in answer] == []
    assert len(answers) > 19
    for caption, *labels in in_chinese(answers):
        assert re.search("[\u4e00-\u9fff]", caption)
        assert not re.search(r"[{}]|undefined|NaN|workbench\.", caption)
        assert not re.search(r"\d{8}T\d{6}Z", " ".join((caption, *labels)))  # a run has a name, not a folder
        for text in (caption, *labels):
            left = re.sub(r"%\{[^}]*\}|<[^>]*>|\S*SIM-000\S*(?: ramp(?:, |，)rows)?", " ", text)
            assert not set(re.findall(LATIN, left)) - KEPT, text


def test_a_diagnosis_is_said_in_the_language_of_the_page(client: httpx.Client) -> None:
    found = done(client, "/diagnoses", {"runs": [RUN], "model": SPLINE})
    wide = {**found, "verdict": "unknown_effect", "nearest": None}
    bare = {**found, "suspects": [], "unexplained": []}
    bares = [{**bare, "verdict": word} for word in ("adequate", "undecided", "unknown_effect")]
    cases = [found, wide, *bares, {**bares[1], "floor_dph": None}]
    script = """
    globalThis.document = { documentElement: {} };
    const words = await import(new URL("../../lib/words.js", process.argv[1]));
    const said = [];
    await words.speakOfAll();
    for (const name of ["en", "uk", "zh"]) { await words.speak(name); said.push(given.map(page.sentences)); }
    console.log(JSON.stringify(said));
    """
    english, ukrainian, chinese = told("pages/workbench/sentence.js", script, cases)
    assert english[0][0].startswith("Missing: Hysteresis (loop width 5.0")
    assert english[0][0].endswith("deg/h).")
    assert number(found["suspects"][0]["proof"]["after_dph"]) in english[0][1]
    assert ukrainian[0][0].startswith("Бракує: Гістерезис (ширина петлі 5,0")
    assert [len(case) for case in english] == [len(case) for case in ukrainian] == [len(case) for case in chinese]
    assert english[5][0] == "The noise floor is unknown."
    for sentence in (text for case in chinese for text in case):
        assert re.search("[\u4e00-\u9fff]", sentence)
        assert not re.search(rf"[{{}}]|undefined|{LATIN}", sentence.replace("RMS", "")), sentence


def test_a_noise_that_the_data_cannot_tell_from_zero_is_told_by_its_bound_as_in_the_report() -> None:
    noise = Noise(0.01, 0.0, 0.2, intervals={"flicker": (0.0, 0.04)}, undetermined=("flicker",))
    assert drawing._size(noise, "white") == 0.01
    parts = captions.said("noise", white=0.01, flicker=drawing._size(noise, "flicker"), walk=0.2)
    assert "flicker below 0.0400 deg/h" in captions.english(parts)
