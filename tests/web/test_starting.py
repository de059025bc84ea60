"""Runs started by the page: real processes that outlive the server, one a station, refused in one line."""

import contextlib
import json
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
from click.testing import CliRunner

from bench.acquisition import LiveFile, LiveRun
from bench.acquisition.profile.profile import load_profile, profile_from_text
from bench.base import config, library
from bench.base.errors import InputError
from bench.cli import main
from bench.record.folder import open_run
from bench.web.ground.problems import within
from bench.web.ground.settings import Settings
from bench.web.live.subject import describe
from bench.web.people import people
from bench.web.plans import catalog
from bench.web.plans.catalog import Catalog, named
from tests.support.waiting import until
from tests.support.web_client import served

LONG = """\
name: long
description: Longer than any test.
segments:
  - {kind: soak, name: first, duration_min: 3}
  - {kind: ramp, name: up, to_degc: 80, rate_degc_per_min: 0.05}
  - {kind: soak, name: last, duration_min: 6000}
"""
SHORT = """\
name: short
segments:
  - {kind: ramp, to_degc: 26, rate_degc_per_min: 2}
  - {kind: soak, duration_min: 2}
  - {kind: ramp, to_degc: 23, rate_degc_per_min: 1}
"""
LIMITS = """\
name: own
limits:
  - {quantity: samples_lost, unit: "1", upper: 0, reason: every sample counts}
"""
HOT = "name: hot\nsegments:\n  - {kind: ramp, to_degc: 120, rate_degc_per_min: 2}\n"


@pytest.fixture
def settings(tmp_path):
    """A project with plans of its own and an access file."""
    profiles = tmp_path / "project" / "profiles"
    (profiles / "stations").mkdir(parents=True)
    for text in (LONG, SHORT, HOT):
        (profiles / f"{profile_from_text(text).name}.yaml").write_text(text)
    (profiles / "broken.yaml").write_text("name: broken\nsegments: 5\n")
    file = tmp_path / "access.yaml"
    tokens = {role: people.add_person(file, f"{role.title()} Petrenko", role) for role in ("viewer", "operator")}
    made = Settings(out=tmp_path / "reports", project=profiles.parent, access=file)
    yield made, {role: {"Authorization": f"Bearer {token}"} for role, token in tokens.items()}
    for start in (tmp_path / "reports" / ".web" / "starts").glob("*/start.json"):
        kill(json.loads(start.read_text())["pid"])


def kill(pid):
    with contextlib.suppress(ProcessLookupError):
        os.kill(pid, signal.SIGKILL)
    with contextlib.suppress(ChildProcessError):  # the server that waits for it may be this process
        os.waitpid(pid, 0)


def state_of(client, start, *states):
    def told():
        answer = client.get(f"/api/v1/starts/{start}").json()
        return answer if answer["state"] in states else None

    return until(told)


def begin(client, plan, **more):
    answer = client.post("/api/v1/starts", json={"plan": plan, "models": ["polynomial"], **more})
    assert answer.status_code == 202, answer.text
    return answer.json()["start"]


@pytest.mark.slow
def test_a_run_outlives_the_server_is_found_again_and_is_aborted_by_name(settings):
    made, bearer = settings
    with served(made) as client:
        client.headers.update(bearer["operator"])
        start = begin(client, "long", units=["SIM-0001"])
        started = state_of(client, start, "running")
        second = client.post("/api/v1/starts", json={"plan": "short"})
        assert second.status_code == 409
        assert "station simulated is in use: " in second.json()["detail"]
        assert second.json()["detail"].endswith("wait for its end, or abort it first")
        assert client.get("/api/v1/starts", headers=bearer["viewer"]).json()["starts"][0]["start"] == start
    with served(made) as client:  # another server, the same run
        client.headers.update(bearer["operator"])
        assert state_of(client, start, "running")["runs"] == started["runs"]
        (run,) = started["runs"]
        seen = until(lambda: [one for one in client.get("/api/v1/live").json()["runs"] if "segment" in one])[0]
        assert (seen["run"], seen["start"], seen["who"]["name"]) == (run, start, "Operator Petrenko")
        assert {light["state"] for light in seen["guards"]} == {"ok"}
        held = client.post(f"/api/v1/live/{run}/hold", json={}).json()
        assert (held["done"], held["state"]) == (True, "holding")
        assert "Operator Petrenko (operator) from 127.0.0.1" in held["holding"][0]
        aborted = client.post(f"/api/v1/live/{run}/abort", json={}).json()
        assert (aborted["done"], aborted["state"], aborted["safe"]) == (True, "aborted", True)
        ended = state_of(client, start, "ended")
        assert (ended["exit_code"], ended["verdict"]) == (3, "partial")
        assert ended["message"] == "aborted by Operator Petrenko (operator) from 127.0.0.1"
        one = until(lambda: (told := client.get(f"/api/v1/live/{run}").json())["ended"]["verdict"] and told)
        assert (one["condition"], one["ended"]["verdict"], one["ended"]["analysing"]) == ("ended", "partial", False)
        assert [asked["request"] for asked in one["ended"]["requests"]] == ["hold", "stop"]
    folder = open_run(made.out / run)
    assert folder.manifest().operator == "Operator Petrenko (operator) from 127.0.0.1"
    first = next(event for event in folder.events() if event["kind"] == "run")
    assert (first["who"], first["text"]) == (folder.manifest().operator, "start")


def test_a_unit_that_is_in_a_run_begins_no_second_one_at_another_station(settings):
    made, bearer = settings
    with served(made) as client:
        client.headers.update(bearer["operator"])
        begin(client, "long", station="simulated", units=["GX-1@SIM-0001"])
        for units, code in ((["GX-1@SIM-0002"], 409), (["SIM-0003"], 202)):
            second = client.post("/api/v1/starts", json={"plan": "long", "station": "four_units", "units": units})
            assert second.status_code == code, second.text
            if code == 409:
                said = "unit GX-1 is in use: Operator Petrenko started long at station simulated at "
                assert second.json()["detail"].startswith(said)


@pytest.mark.slow
def test_a_plan_brings_the_limits_and_models_of_the_calibration_that_it_belongs_to(settings):
    with served(settings[0]) as client:
        answer = client.get("/api/v1/plans", headers=settings[1]["viewer"]).json()
    told = {plan["id"]: (plan["limits"], plan["models"]) for plan in answer["plans"]}
    assert told["quick_calibration"] == told["quick_check"] == ("quick", ["spline_lag_loop", "polynomial"])
    assert told["ramp_-40_85"] == ("vibratory", ["spline_lag_loop", "spline"])
    assert told["quick"] == ("", [])
    verified = {plan["id"]: plan["verification"] for plan in answer["plans"]}
    assert (verified["quick_calibration"], verified["quick_check"]) == ("quick_check", "")


def test_a_run_has_the_model_file_that_the_plan_of_its_profile_names(settings):
    made, bearer = settings
    own = made.project / "profiles" / "own_models" / "mine.yaml"
    own.parent.mkdir()
    own.write_text("name: mine\neffects:\n- polynomial: {order: 1}\n")
    (made.project / "profiles" / "limits").mkdir()
    (made.project / "profiles" / "limits" / "own.yaml").write_text(LIMITS)
    plans = made.project / "profiles" / "plans"
    plans.mkdir()
    plan = "name: own\nprofile: ../short.yaml\nverification: ../long.yaml\nlimits: ../limits/own.yaml\n"
    (plans / "own.yaml").write_text(f"{plan}models: [../own_models/mine.yaml]\n")
    with served(made) as client:
        client.headers.update(bearer["operator"])
        told = {plan["id"]: plan["models"] for plan in client.get("/api/v1/plans").json()["plans"]}
        assert told["short"] == ["../own_models/mine.yaml"]
        ended = state_of(client, begin(client, "short", models=told["short"]), "ended")
        again = client.get(f"/api/v1/live/{ended['runs'][0]}").json()["again"]
        repeated = state_of(client, begin(client, again["plan"], models=again["models"]), "ended")
    (model,) = (made.out / repeated["runs"][0]).glob("model*.yaml")
    assert model.read_text().startswith("name: mine\n"), "as on the page's Repeat"


def test_a_run_goes_to_its_verdict_and_is_announced(settings):
    made, bearer = settings
    with served(made) as client:
        client.headers.update(bearer["operator"])
        start = begin(client, "short")
        with client.stream("GET", "/api/v1/live/stream") as stream:
            ends = []
            for line in stream.iter_lines():
                if line.startswith("data: ") and '"analysing"' in line[:4000]:
                    ends.append(json.loads(line[6:]))
                if ends and not ends[-1]["analysing"]:
                    break
        ended = state_of(client, start, "ended")
        assert ends[-1]["run"] == ended["runs"][0]
        assert (ends[-1]["state"], ends[-1]["safe"], ends[-1]["verdict"]) == ("done", True, ended["verdict"])
        assert ended["verdicts"][0]["unit"] == "SIM-0001"
        assert ended["message"] == ""
        begin(client, "hot")  # the station is free again


@pytest.mark.slow
def test_what_the_bench_refuses_is_a_start_that_was_refused_with_its_line(settings):
    made, bearer = settings
    with served(made) as client:
        client.headers.update(bearer["operator"])
        refused = state_of(client, begin(client, "hot"), "refused", "ended")
        assert (refused["state"], refused["exit_code"], refused["runs"]) == ("refused", 2, [])
        assert "hot.yaml:3: ramp to 120 at 2: 120 degC is outside the station's limits" in refused["message"]
        assert "\n" not in refused["message"]


@pytest.mark.slow
def test_a_run_that_was_killed_says_how_to_go_on(settings):
    made, bearer = settings
    with served(made) as client:
        client.headers.update(bearer["operator"])
        start = begin(client, "long")
        run = state_of(client, start, "running")["runs"][0]
        pid = json.loads((made.own / "starts" / start / "start.json").read_text())["pid"]
        kill(pid)
        ended = state_of(client, start, "ended")
        assert (ended["exit_code"], ended["verdict"]) == (None, None)
        assert f"`bench resume {run}` goes on with it" in ended["message"]
        assert until(lambda: client.get("/api/v1/live").json()["runs"][0]["condition"] == "gone")
        answer = client.post(f"/api/v1/live/{run}/hold", json={})
        assert (answer.status_code, "goes on with it" in answer.json()["detail"]) == (409, True)
        begin(client, "hot")  # a dead run has no station


@pytest.mark.slow
def test_a_run_that_was_killed_goes_on_in_its_folder(settings):
    made, bearer = settings
    (made.project / "profiles" / "limits").mkdir()
    (made.project / "profiles" / "limits" / "own.yaml").write_text(LIMITS)
    with served(made) as client:
        client.headers.update(bearer["operator"])
        start = begin(client, "long", limits="own", units=["GX-9@SIM-0001"])
        run = state_of(client, start, "running")["runs"][0]
        live = client.post(f"/api/v1/runs/{run}/resume", json={})
        assert (live.status_code, live.json()["detail"]) == (409, f"{run} is live: there is nothing to go on with")
        until(lambda: client.get(f"/api/v1/live/{run}").json().get("t_s", 0) > 60)
        kill(json.loads((made.own / "starts" / start / "start.json").read_text())["pid"])
        until(lambda: client.get("/api/v1/live").json()["runs"][0]["condition"] == "gone")
        refused = client.post(f"/api/v1/runs/{run}/resume", json={}, headers=bearer["viewer"])
        assert refused.status_code == 403
        told = client.post(f"/api/v1/runs/{run}/resume", json={})
        assert (told.status_code, told.json()["units"]) == (202, ["GX-9@SIM-0001"]), told.text
        assert state_of(client, told.json()["start"], "running", "ended")["runs"] == [run]
        until(lambda: client.get(f"/api/v1/live/{run}").json()["condition"] == "live")
        again = client.get(f"/api/v1/live/{run}").json()["again"]
        assert (again["plan"], again["limits"], again["models"]) == ("long", "own", ["polynomial"])
        client.post(f"/api/v1/live/{run}/abort?wait_s=60", json={})
        state_of(client, told.json()["start"], "ended")
        assert client.get("/api/v1/starts").json()["starts"][0]["verdicts"][0]["limits"] is not None
    assert (made.out / run / "journal-2").is_dir(), "what is recorded is a part of its own in the same folder"


@pytest.mark.parametrize(
    ("wanted", "words"),
    [
        ({"plan": "shrot"}, "; did you mean 'short'?"),
        ({"plan": "../../etc/passwd"}, "no plan '../../etc/passwd'"),
        ({"plan": "/etc/passwd"}, "no plan '/etc/passwd'"),
        (
            {"plan": "short", "station": "nowhere"},
            "no station 'nowhere'; there are four_units, imu, instruments, other_gyros, rate_table, simulated",
        ),
        ({"plan": "short", "units": ["X-1"]}, "unit 'X-1' is not in station 'simulated'"),
        ({"plan": "short", "models": ["../x"]}, "no model '../x'"),
        ({"plan": "short", "limits": "nothing"}, "no limits 'nothing'"),
        ({"plan": "short", "models": ["--out=/"]}, "no model '--out=/'"),
    ],
)
def test_a_name_that_is_none_is_refused_before_anything_starts(settings, wanted, words):
    made, bearer = settings
    with served(made) as client:
        answer = client.post("/api/v1/starts", json=wanted, headers=bearer["operator"])
        assert answer.status_code == 400
        assert words in answer.json()["detail"]
        assert client.get("/api/v1/starts", headers=bearer["viewer"]).json() == {"starts": []}


def test_paths_are_told_as_they_are_from_the_folders_of_the_bench(tmp_path):
    project, out = tmp_path / "line", tmp_path / "data" / "reports"
    told = [
        (f"bench: {project}/profiles/hot.yaml:3: no", "bench: profiles/hot.yaml:3: no"),
        (f"({out}/GX-1/run; '{library()}/stations/imu.yaml')", "(GX-1/run; 'profiles/stations/imu.yaml')"),
        (f"/mnt{project}/a {tmp_path}/other", f"/mnt{project}/a {tmp_path}/other"),
    ]
    assert [within(project, text, out) for text, _ in told] == [short for _, short in told]


def test_a_viewer_starts_nothing(settings):
    made, bearer = settings
    with served(made) as client:
        for path in ("/starts", "/checks"):
            assert client.post(f"/api/v1{path}", json={"plan": "short"}, headers=bearer["viewer"]).status_code == 403


def test_a_check_rehearses_elsewhere_and_says_all_that_is_wrong(settings):
    made, bearer = settings
    with served(made) as client:
        client.headers.update(bearer["operator"])

        def result(plan):
            job = client.post("/api/v1/checks", json={"plan": plan, "units": ["SIM-0001"]}).json()["job"]
            return until(lambda: client.get(f"/api/v1/jobs/{job}?wait_s=20").json()["result"])

        good, bad = result("short"), result("hot")
    assert (good["ok"], good["units"], good["curve"][-1]) == (True, ["SIM-0001"], [390.0, 23.0])
    assert good["duration_s"] > 390.0
    assert (bad["ok"], bad["findings"][0]["level"], bad["findings"][0]["line"]) == (False, "error", 3)


BLIND = "guards: [{name: blind, signal: humidity, above: 60, action: abort}]"
"""A guard that could never trip."""
BEYOND = "lowest_degc: -110"
"""Colder than the chamber's register map writes."""


@pytest.mark.parametrize("at", ["chamber", "guard", "plan", "recipients"])
def test_what_the_start_would_refuse_is_no_good_check(settings, at):
    made, bearer = settings
    station, plan = (library() / "stations" / "simulated.yaml").read_text(), SHORT.replace("name: short", "name: blind")
    station += {"guard": f"{BLIND}\n", "recipients": "notify: nowhere.yaml\n"}.get(at, "")
    station = station.replace("lowest_degc: -42", BEYOND if at == "chamber" else "lowest_degc: -42")
    (made.project / "profiles" / "stations" / "mine.yaml").write_text(station)
    (made.project / "profiles" / "blind.yaml").write_text(plan + (f"{BLIND}\n" if at == "plan" else ""))
    with served(made) as client:
        client.headers.update(bearer["operator"])
        job = client.post("/api/v1/checks", json={"plan": "blind", "station": "mine"}).json()["job"]
        found = until(lambda: client.get(f"/api/v1/jobs/{job}?wait_s=20").json()["result"])
        refused = state_of(client, begin(client, "blind", station="mine"), "refused", "ended")
    (error,) = [one["text"] for one in found["findings"] if one["level"] == "error"]
    assert (found["ok"], refused["state"]) == (False, "refused")
    assert error in refused["message"]
    assert str(made.project) not in f"{found} {refused}", "nobody at a page needs the folder"


def test_a_run_that_has_no_room_on_the_disk_is_no_good_check(settings, monkeypatch):
    monkeypatch.setattr("bench.commands.acquisition.shutil.disk_usage", lambda _: SimpleNamespace(free=1))
    files = {"plan": library() / "quick.yaml", "station": library() / "stations" / "simulated.yaml", "limits": None}
    found = catalog.rehearsed({**files, "units": [], "models": {}, "project": settings[0].project})
    assert (found["ok"], found["findings"][0]["level"]) == (False, "error")
    answer = CliRunner().invoke(main, ["check", str(library() / "quick.yaml")])
    assert (answer.exit_code, "are free" in answer.stdout) == (1, True)


PLAIN = """
name: plain
simulated: true
chamber: {map: watlow_f4t, lowest_degc: -42, highest_degc: 95, heating_degc_per_min: 5, cooling_degc_per_min: 3}
buses: {can0: {interface: blocks, channel: plain}}
units:
  - serial: PLAIN-1
    bus: can0
    signals:
      rate: {id: 0x100, start: 0, length: 32, order: little, type: signed, scale: 1.0e-6, unit: deg/s, cycle_ms: 2}
      temperature: {id: 0x100, start: 32, length: 16, order: little, type: signed, scale: 0.01, unit: degC}
"""
"""A unit that sends its rate and its temperature, and nothing else."""


def test_a_model_that_a_unit_cannot_hold_is_told_before_the_run_which_may_begin(settings):
    made, bearer = settings
    (made.project / "profiles" / "stations" / "plain.yaml").write_text(PLAIN)
    with served(made) as client:
        client.headers.update(bearer["operator"])

        def warned(*models, station):
            asked = {"plan": "short", "station": station, "models": models}
            answer = client.post("/api/v1/checks", json=asked)
            assert answer.status_code == 202, answer.text
            job = answer.json()["job"]
            found = until(lambda: client.get(f"/api/v1/jobs/{job}?wait_s=20").json()["result"])
            assert found["ok"], found
            return [one["text"] for one in found["findings"] if "model '" in one["text"]]

        assert warned("polynomial", "mems", station="simulated") == []
        (memory,) = warned("polynomial", "expression", station="simulated")
        assert memory.startswith("unit SIM-0001: model 'expression': expression: cannot be delivered: a unit evaluates")
        assert memory.endswith("models that a unit can hold: mems, polynomial, regression, spline, spline_lag_loop")
        (channel,) = warned("polynomial", "mems", station="plain")
        assert channel == (
            "unit PLAIN-1: model 'mems': quadrature_leakage: cannot be delivered: this unit has no channel quadrature; "
            "leave it out of the delivered model; models that a unit can hold: polynomial, spline, spline_lag_loop"
        )


@pytest.mark.parametrize(
    ("plan", "limits", "said"),
    [
        ("quick", "vibratory", "the limits ask for -38 degC or less and 83 degC or more, the plan goes from 0 to 50"),
        (
            "quick",
            "hot",
            "the limits ask for 60 degC or more, the plan goes from 0 to 50 degC: the run would be INVALID",
        ),
        ("quick", "quick", ""),
        ("ramp_-40_85", "vibratory", ""),
    ],
)
def test_limits_that_no_set_point_of_the_plan_can_meet_are_warned_of_before_the_start(settings, plan, limits, said):
    made, bearer = settings
    (made.project / "profiles" / "limits").mkdir()
    (made.project / "profiles" / "limits" / "hot.yaml").write_text(
        "name: hot\nlimits:\n  - {quantity: highest_temperature_degc, unit: degC, lower: 60, reason: it is hot}\n"
    )
    with served(made) as client:
        client.headers.update(bearer["operator"])
        job = client.post("/api/v1/checks", json={"plan": plan, "limits": limits}).json()["job"]
        found = until(lambda: client.get(f"/api/v1/jobs/{job}?wait_s=20").json()["result"])
    texts = [one["text"] for one in found["findings"] if one["level"] == "warning" and "the limits ask" in one["text"]]
    assert found["ok"]
    assert [text[: len(said)] for text in texts] == ([said] if said else [])


def test_only_a_plan_that_is_as_it_was_shipped_has_the_name_of_the_shipped_one(settings, tmp_path):
    made, bearer = settings
    profiles = made.project / "profiles"
    (profiles / "plans").mkdir()
    names = ("quick_calibration.yaml", "quick_check.yaml", "quick_static.yaml", "plans/quick.yaml", "quick.yaml")
    for name in names:
        shutil.copy(library() / name, profiles / name)
    hotter = (profiles / "quick.yaml").read_text().replace("to_degc: 50", "to_degc: 70")

    def shipped(way):
        with served(made) as client:
            client.headers.update(bearer["viewer"])
            return {plan["id"] for plan in client.get(f"/api/v1/{way}").json()["plans"] if plan["shipped"]}

    assert {"quick", "quick_check", "ramp_-40_85"} <= shipped("plans")
    assert "long" not in shipped("plans")
    assert {"quick", "vibratory"} <= shipped("calibration-plans")
    (profiles / "quick.yaml").write_text(hotter)
    check = profiles / "quick_check.yaml"
    check.write_text(check.read_text().replace("45", "60"))
    assert {"quick", "quick_check"} & shipped("plans") == set()
    assert "quick" not in shipped("calibration-plans")
    run = tmp_path / "run"
    for text, same in ((hotter, False), ((library() / "quick.yaml").read_text(), True)):
        run.mkdir(exist_ok=True)
        (run / "profile.yaml").write_text(text)
        assert describe(LiveRun((run,), LiveFile(0, 0, "", [], "")), None)["shipped"] is same


def test_what_a_run_was_started_with_is_what_repeats_it(tmp_path, settings):
    made, bearer = settings
    with served(made) as client:
        client.headers.update(bearer["operator"])
        later = {"units": ["SIM-0001"], "not_before": "2126-11-24T00:00:00Z"}
        start = client.get(f"/api/v1/starts/{begin(client, 'short', **later)}").json()
        client.delete(f"/api/v1/starts/{start['start']}").raise_for_status()
    again = {"plan": "short", "station": "simulated", "units": ["SIM-0001"], "limits": None, "models": ["polynomial"]}
    assert describe(LiveRun((tmp_path,), LiveFile(0, 0, "", [], "")), start)["again"] == again


def test_plans_and_stations_are_those_of_the_project_and_of_the_library(settings):
    made, bearer = settings
    diagnosed = made.own / "plans"
    diagnosed.mkdir()
    (diagnosed / "next-1.yaml").write_text(SHORT)
    with served(made) as client:
        client.headers.update(bearer["viewer"])
        plans = {plan["id"]: plan for plan in client.get("/api/v1/plans").json()["plans"]}
        stations = {one["id"]: one for one in client.get("/api/v1/stations").json()["stations"]}
        limits = client.get("/api/v1/limits").json()["limits"]
    assert {"long", "short", "hot", "next-1", "quick", "ramp_-40_85"} <= plans.keys()
    assert [id_ for id_, plan in plans.items() if plan["proposed"]] == ["next-1"]
    assert plans["long"]["summary"] == "Longer than any test."
    assert plans["rates_quick"]["kind"] == "rate"
    assert plans["broken"]["problem"] == "profiles/broken.yaml:2: segments is 5: must be a list"
    assert stations["four_units"]["units"] == [f"SIM-000{n}" for n in (1, 2, 3, 4)]
    assert {"quick", "vibratory"} <= {one["id"] for one in limits}


def test_the_projects_own_file_takes_the_place_of_a_shipped_one(tmp_path):
    (tmp_path / "profiles").mkdir()
    own = tmp_path / "profiles" / "quick.yaml"
    own.write_text(SHORT)
    plans = Catalog(tmp_path, tmp_path / ".web").plans()
    assert plans["quick"] == own.resolve()
    assert plans["ramp_-40_85"].parent == library().resolve()
    with pytest.raises(InputError, match=r"no plan 'quikc'; there are .*; did you mean 'quick'\?"):
        named(plans, "quikc", "plan")


def test_a_curve_has_a_bounded_number_of_corners():
    legs = "".join(f"  - {{kind: ramp, to_degc: {20 + n % 2 * 30}, rate_degc_per_min: 2}}\n" for n in range(1500))
    curve = catalog.curve(profile_from_text(f"name: saw\nsegments:\n{legs}"))
    assert len(curve) == catalog.MOST_CORNERS
    flat = profile_from_text("name: flat\nsegments:\n" + "  - {kind: soak, duration_min: 1}\n" * 50)
    assert catalog.curve(flat) == [(0.0, 23.0), (3000.0, 23.0)]
    assert [t_s for t_s, _ in catalog.curve(flat, flat)] == [0.0, 3000.0, 3000.0, 6000.0]


def test_a_calibration_is_drawn_with_all_of_its_runs():
    drawn = catalog.calibration(library() / "plans" / "quick.yaml", catalog.Read())
    files = [library() / f"quick_{name}.yaml" for name in ("static", "calibration", "check")]
    parts = [catalog.curve(load_profile(file)) for file in files]
    assert drawn["curve"][-1] == (pytest.approx(drawn["nominal_s"], abs=1.0), parts[-1][-1][1])
    for part in parts:
        assert {degc for _, degc in part} <= {degc for _, degc in drawn["curve"]}
    times = [t_s for t_s, _ in drawn["curve"]]
    assert len(times) - len(set(times)) == len(parts) - 1, "each run begins where its time stands twice"


def test_two_station_files_of_one_chamber_are_one_station():
    text = (library() / "stations" / "simulated.yaml").read_text()
    one = catalog.station(library() / "stations" / "simulated.yaml")
    real = text.replace("simulated: true", "simulated: false").replace("interface: blocks", "interface: socketcan")
    real = real.replace("  map: watlow_f4t", "  map: watlow_f4t\n  connection: {url: 'tcp://10.0.0.5:502'}")
    real = real.replace("{name: supply,", "{name: supply, address: 'socket://10.0.0.6:5025',")
    stations = [
        config.load_config(config.parse_yaml(real.replace("name: simulated", f"name: {name}"), "s"), type(one))
        for name in "ab"
    ]
    shared = catalog.equipment(stations[0]) & catalog.equipment(stations[1])
    assert shared == {"chamber tcp://10.0.0.5:502", "instrument socket://10.0.0.6:5025"}


def test_the_wrapper_leaves_the_exit_code_of_the_bench(tmp_path):
    lock = os.open(tmp_path, os.O_RDONLY)
    try:
        command = [sys.executable, "-m", "bench.cli.started", str(tmp_path), str(lock), "run", "nothing.yaml"]
        done = subprocess.run(command, pass_fds=[lock], capture_output=True, text=True, check=False)
    finally:
        os.close(lock)
    assert (done.returncode, Path(tmp_path / "exit_code").read_text(encoding="utf-8")) == (2, "2\n")
    assert done.stderr.startswith("bench: nothing.yaml: ")
