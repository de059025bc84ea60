"""Calibrations in the page's API: the jobs of `bench calibrate`, new units in slots, a queue, forms for the papers."""

import json
from dataclasses import replace
from datetime import UTC, datetime, timedelta, timezone
from pathlib import Path

import pytest
from click.testing import CliRunner

import drivers
from bench.base import InputError, library, parse_yaml, read_yaml
from bench.cli import main
from bench.commands import Order, load_station
from bench.commands.calibration.calibrate import calibrate, calibrate_all
from bench.commands.calibration.job import Case, Done, JobFile
from bench.record import StartRecord
from bench.web.ground.settings import Settings
from bench.web.live import starts as webstarts
from bench.web.live.starts import Starts
from bench.web.people import people
from tests.commands.test_calibrate import Fake
from tests.support import bench_project
from tests.support.notices import webhook
from tests.support.waiting import until
from tests.support.web_client import served
from tests.web.test_starting import LONG, kill


@pytest.fixture
def settings(tmp_path, monkeypatch):
    project = bench_project.made(tmp_path / "project")
    (project / "profiles" / "long.yaml").write_text(LONG)
    monkeypatch.chdir(project)
    made = Settings(out=tmp_path / "reports", project=project)
    yield made
    for start in made.own.glob("starts/*/start.json"):
        if pid := json.loads(start.read_text()).get("pid"):
            kill(pid)


def at(job):
    return {step["name"]: step["state"] for step in job["steps"]}


def job_of(client, start):
    return until(lambda: client.get(f"/api/v1/starts/{start}/calibration").raise_for_status().json())


def begin(client, **wanted):
    answer = client.post("/api/v1/calibrations", json={"plan": "brief", **wanted})
    assert answer.status_code == 202, answer.text
    return answer.json()


LABORATORY = {"laboratory": {"name": "Lab", "address": ""}, "authorised_by": {"name": "Olha"}, "item": {"model": " "}}
EQUIPMENT = {
    "equipment": [{"name": "chamber sensor", "serial": "P1", "due": "2999-12-31",
                   "uncertainty": [{"value": 0.1, "unit": "degC"}]}]
}  # fmt: skip


@pytest.mark.slow
def test_a_new_unit_stops_at_missing_papers_goes_on_survives_a_restart_and_is_aborted(settings):
    with served(settings) as client:
        start = begin(client, station="bare", unit="GX-0815@BARE-1", operator="Olena")
        assert (start["who"]["name"], start["units"]) == ("Olena", ["GX-0815@BARE-1"])
        id_ = job_of(client, start["start"])["job"]
        stopped = until(lambda: (now := client.get(f"/api/v1/calibrations/{id_}").json())["state"] == "failed" and now)
        assert (stopped["exit_code"], at(stopped)["check"]) == (2, "failed")
        assert "no laboratory and no signatory" in stopped["sentence"]
        asked = {"plan": "brief", "station": "bare", "unit": "GX-0815@BARE-1"}
        checked = client.post("/api/v1/calibrations/checks", json=asked).json()["job"]
        checked = client.get(f"/api/v1/jobs/{checked}?wait_s=20").json()
        assert "no laboratory and no signatory" in str(checked["result"]["findings"])
        assert "or fill in the page 'Laboratory and equipment'; a plan with" in str(checked["result"]["findings"])
        assert str(settings.project) not in json.dumps([stopped, checked]), "nobody at a page needs the folder"
        for kind, content in (("laboratory", LABORATORY), ("equipment", EQUIPMENT)):
            answer = client.put(f"/api/v1/stations/bare/papers/{kind}", json={"content": content, "digest": ""})
            assert answer.status_code == 200, answer.text
        goes_on = client.post(f"/api/v1/calibrations/{id_}/continue", json={"operator": "Olena"})
        assert goes_on.status_code == 202, goes_on.text
        until(lambda: at(client.get(f"/api/v1/calibrations/{id_}").json())["run"] == "begun")
    with served(settings) as client:  # another server: the job goes on, and is found again
        told = client.get(f"/api/v1/calibrations/{id_}").json()
        assert told["state"] == "running"
        (listed,) = client.get("/api/v1/calibrations").json()["jobs"]
        assert (listed["job"], listed["unit"]) == (id_, "GX-0815")
        run = until(lambda: client.get(f"/api/v1/calibrations/{id_}").json()["live"])
        live = until(lambda: (now := client.get(f"/api/v1/live/{run}").json())["condition"] == "live" and now)
        assert (live["job"], live["who"]["name"]) == (id_, "Olena")
        until(lambda: client.post(f"/api/v1/live/{run}/abort?wait_s=30", json={}).json().get("safe"))
        aborted = until(lambda: (now := client.get(f"/api/v1/calibrations/{id_}").json())["state"] == "failed" and now)
        assert (aborted["exit_code"], at(aborted)["run"]) == (3, "failed")
        assert client.get(f"/api/v1/calibrations/{id_}/certificate").status_code == 404
    manifest = json.loads((settings.out / run / "manifest.json").read_text())
    assert (manifest["unit"], manifest["state"], manifest["operator"].split(" ")[0]) == ("GX-0815", "aborted", "Olena")
    assert read_yaml(settings.project / "profiles" / "laboratory" / "station_bare.yaml").content["laboratory"] == {
        "name": "Lab"
    }


def test_the_check_of_a_calibration_refuses_what_its_start_would(settings):
    with served(settings) as client:
        asked = {"plan": "brief", "station": "bare", "unit": "GX-0815@BARE-1", "others": ["GX-0815@BARE-1"]}
        job = client.post("/api/v1/calibrations/checks", json=asked).json()["job"]
        answer = client.get(f"/api/v1/jobs/{job}?wait_s=20").json()
        assert "named twice" in json.dumps(answer)
        assert answer["state"] == "failed" or not answer["result"]["ok"]


def test_the_check_says_that_the_calibration_before_was_cut_off(settings):
    plan, station = settings.project / "profiles/plans/brief.yaml", settings.project / "profiles/stations/bare.yaml"
    order = Order.load(plan, station, "GX-0815@BARE-1", settings.out)
    folder = JobFile.create(settings.out / "GX-0815", order.serial, "brief", order.digest()).folder
    asked = {"plan": "brief", "station": "bare", "unit": "GX-0815@BARE-1"}
    with served(settings) as client:
        job = client.post("/api/v1/calibrations/checks", json=asked).json()["job"]
        found = client.get(f"/api/v1/jobs/{job}?wait_s=20").json()["result"]
    assert found["begun"] == {"job": f"GX-0815/{folder.name}", "state": "interrupted"}


def test_the_check_of_a_calibration_refuses_an_error_of_the_wire(settings):
    station = settings.project / "profiles" / "stations" / "cold.yaml"
    text = (station.parent / "bare.yaml").read_text().replace("name: bare", "name: cold")
    station.write_text(text.replace("lowest_degc: -42", "lowest_degc: -110"))
    for kind, content in (("laboratory", LABORATORY), ("equipment", EQUIPMENT)):
        file = station.parents[1] / kind / "station_cold.yaml"
        file.parent.mkdir(exist_ok=True)
        file.write_text(json.dumps(content))
    with served(settings) as client:
        asked = {"plan": "brief", "station": "cold", "unit": "GX-0815@BARE-1"}
        job = client.post("/api/v1/calibrations/checks", json=asked).json()["job"]
        found = client.get(f"/api/v1/jobs/{job}?wait_s=20").json()["result"]
    assert (found["ok"], "the map writes set points" in str(found["findings"])) == (False, True), found


def test_calibrations_of_the_command_line_are_listed_too(settings):
    plan = settings.project / "profiles" / "plans" / "brief.yaml"
    station = settings.project / "profiles" / "stations" / "bare.yaml"
    asked = ["--plan", str(plan), "--station", str(station), "--out", str(settings.out), "--json"]
    CliRunner().invoke(main, ["calibrate", "--unit", "GX-0901@BARE-1", *asked])
    with served(settings) as client:
        (listed,) = client.get("/api/v1/calibrations").json()["jobs"]
        assert (listed["unit"], listed["state"], listed["start"]) == ("GX-0901", "failed", None)
        refused = client.post(f"/api/v1/calibrations/{listed['job']}/continue", json={})
        assert (refused.status_code, "`bench calibrate --unit GX-0901` goes on" in refused.text) == (409, True)


@pytest.mark.slow
def test_a_calibration_waits_for_its_station_and_may_be_taken_out_of_the_queue(settings):
    with served(settings) as client:
        run = client.post("/api/v1/starts", json={"plan": "long", "units": ["SIM-0001"]}).json()["start"]
        running = until(lambda: (now := client.get(f"/api/v1/starts/{run}").json())["state"] == "running" and now)
        refused = client.post("/api/v1/calibrations", json={"plan": "brief", "unit": "SIM-0001"})
        assert (refused.status_code, "station simulated is in use" in refused.json()["detail"]) == (409, True)
        first, second = (begin(client, unit=unit, queue=True) for unit in ("SIM-0001", "GX-2@SIM-0001"))
        assert first["state"] == second["state"] == "waiting"
    with served(settings) as client:  # the queue outlives the server
        waiting = [one["start"] for one in client.get("/api/v1/calibrations").json()["waiting"]]
        assert waiting == [first["start"], second["start"]]
        assert queue(client, "move", "GX-2", "1") == [second["start"], first["start"]]
        assert queue(client, "move", second["start"], "1") == [second["start"], first["start"]]  # is first
        assert client.post(f"/api/v1/starts/{run}/move", json={"by": 1}).status_code == 409  # runs
        third = begin(client, unit="GX-3@SIM-0001", queue=True)["start"]
        assert queue(client, "move", "GX-3", "1") == [third, second["start"], first["start"]]
        assert queue(client, "move", "GX-3", "900") == [second["start"], first["start"], third]
        assert "nothing of 'GX-4' waits" in asked_of_queue(client, "drop", "GX-4").stderr
        assert queue(client, "drop", "GX-3") == [second["start"], first["start"]]
        assert queue(client, "drop", "GX-2") == queue(client, "list") == [first["start"]]
        assert client.delete(f"/api/v1/starts/{second['start']}").status_code == 404
        until(lambda: client.post(f"/api/v1/live/{running['runs'][0]}/abort?wait_s=30", json={}).json().get("done"))
        assert job_of(client, first["start"])["unit"] == "SIM-0001"
        late = client.delete(f"/api/v1/starts/{first['start']}")
        assert (late.status_code, "abort its run" in late.json()["detail"]) == (409, True)


def asked_of_queue(client, *arguments):
    return CliRunner().invoke(main, ["queue", *arguments, "--server", str(client.base_url), "--json"])


def queue(client, *arguments):
    answer = asked_of_queue(client, *arguments)
    assert answer.exit_code == 0, answer.output
    return [one["start"] for one in json.loads(answer.stdout)["waiting"]]


def held(settings):
    """The id of a held calibration that the page started."""
    station = library() / "stations" / "simulated.yaml"
    plan = settings.project / "profiles" / "plans" / "brief.yaml"
    order = Order.load(plan, station, "SIM-0001", settings.out, quiet=True)
    job = calibrate(order, steps=[Fake("check"), Fake("static", Done("doubt", hold="an unknown effect"))])
    about = StartRecord(
        start="20261123T000000Z-0", digest=order.digest(), plan="brief", station="simulated", units=("SIM-0001",),
        who={"name": "Ivan", "role": "operator", "address": "127.0.0.1"}, started="2026-11-23T00:00:00.000+00:00",
    )  # fmt: skip
    folder = settings.own / "starts" / about.start
    folder.mkdir(parents=True)
    about.write(folder)
    (folder / "exit_code").write_text("1\n")
    return f"SIM-0001/{job.folder.name}"


def test_a_held_calibration_goes_on_only_with_a_reason_which_stands_in_it_with_the_name(settings):
    id_ = held(settings)
    with served(settings) as client:
        told = client.get(f"/api/v1/calibrations/{id_}").json()
        assert (told["state"], told["sentence"], told["exit_code"]) == ("held", "static: an unknown effect", 1)
        bare = client.post(f"/api/v1/calibrations/{id_}/continue", json={})
        assert (bare.status_code, "needs a reason" in bare.json()["detail"]) == (400, True)
        further = {"release": "seen  before", "operator": "Olena"}
        assert client.post(f"/api/v1/calibrations/{id_}/continue", json=further).status_code == 202
        released = until(lambda: client.get(f"/api/v1/calibrations/{id_}").json()["releases"])
    assert released == [{"reason": "Olena: seen before", "held": "static: an unknown effect"}]


def test_a_calibration_whose_plan_was_changed_does_not_go_on(settings):
    id_ = held(settings)
    limits = settings.project / "profiles" / "limits" / "brief.yaml"
    limits.write_text(limits.read_text().replace("2.0", "3.0"))
    with served(settings) as client:
        answer = client.post(f"/api/v1/calibrations/{id_}/continue", json={"release": "x"})
    assert (answer.status_code, "has changed since: begin a new calibration" in answer.json()["detail"]) == (409, True)


@pytest.mark.parametrize(
    ("wanted", "said"),
    [
        ({"plan": "breif"}, "did you mean 'brief'?"),
        ({"station": "nowhere"}, "no station 'nowhere'"),
        ({"unit": "GX-1"}, "unit 'GX-1' is not in station 'simulated'"),
        ({"unit": "GX-1@SIM-0009"}, "no slot 'SIM-0009' for unit 'GX-1'"),
        ({"unit": "GX@SIM-0001"}, "profiles/stations/simulated.yaml: serial number 'GX' has no digits"),
        ({"unit": "../x1@SIM-0001", "operator": "a\u0007b"}, "operator: must be visible characters"),
    ],
)
def test_a_calibration_that_cannot_be_is_refused_before_anything_starts(settings, wanted, said):
    with served(settings) as client:
        answer = client.post("/api/v1/calibrations", json={"plan": "brief", "unit": "SIM-0001", **wanted})
        assert (answer.status_code, said in answer.json()["detail"]) == (400, True), answer.text
        assert str(settings.project) not in answer.text
        assert client.get("/api/v1/starts").json() == {"starts": []}


def test_where_people_sign_in_nobody_gives_another_name(settings):
    token = people.add_person(settings.project / "access.yaml", "Ivan", "operator")
    with served(replace(settings, access=settings.project / "access.yaml")) as client:
        client.headers["Authorization"] = f"Bearer {token}"
        wanted = {"plan": "brief", "unit": "SIM-0001", "operator": "Olena"}
        assert "signed in" in client.post("/api/v1/calibrations", json=wanted).json()["detail"]
        paper = client.put("/api/v1/stations/bare/papers/laboratory", json={"content": LABORATORY, "digest": ""})
        assert paper.status_code == 403


def test_a_form_that_is_wrong_is_refused_with_its_field_and_leaves_the_file(settings):
    with served(settings) as client:
        put = "/api/v1/stations/bare/papers"
        digest = client.put(f"{put}/equipment", json={"content": EQUIPMENT, "digest": ""}).json()["digest"]
        file = settings.project / "profiles" / "equipment" / "station_bare.yaml"
        before = file.read_text()
        for content, said in (
            ({"equipment": [{"name": "x", "serial": "1", "due": "soon"}]}, "equipment[0].due"),
            ({"equipment": []}, "missing key 'equipment'"),
            ({"equipment": [{"name": "x"}]}, "missing key 'serial'"),
        ):
            answer = client.put(f"{put}/equipment", json={"content": content, "digest": digest})
            assert (answer.status_code, said in answer.json()["detail"]) == (400, True), answer.text
            assert "yaml" not in answer.json()["detail"], "who fills in a form sees no file"
        where = {"laboratory": {"name": "L", "country": "Ukraine"}}
        answer = client.put(f"{put}/laboratory", json={"content": where, "digest": ""})
        assert answer.json()["detail"] == "laboratory.country is \"Ukraine\": must be written like 'UA'"
        told = client.get(put).json()
        assert client.get("/api/v1/stations/simulated/papers").json()["laboratory"]["content"]["laboratory"]["name"]
    assert file.read_text() == before
    assert (told["laboratory"]["content"], told["equipment"]["content"]) == (None, EQUIPMENT)


def test_a_form_does_not_write_over_what_somebody_else_filled_in_meanwhile(settings):
    mine, theirs = LABORATORY, {**LABORATORY, "place": "Kyiv"}
    with served(settings) as client:
        paper = "/api/v1/stations/bare/papers/laboratory"
        opened = [client.get("/api/v1/stations/bare/papers").json()["laboratory"]["digest"] for _ in range(2)]
        first = client.put(paper, json={"content": theirs, "digest": opened[0]})
        second = client.put(paper, json={"content": mine, "digest": opened[1]})
        told = client.get("/api/v1/stations/bare/papers").json()["laboratory"]
        assert (second.status_code, "laboratory/bare has changed since" in second.text) == (409, True)
        assert (told["content"]["place"], told["digest"]) == ("Kyiv", first.json()["digest"])
        assert client.put(paper, json={"content": mine, "digest": told["digest"]}).status_code == 200
        file = settings.project / "profiles" / "laboratory" / "station_bare.yaml"
        file.write_text("laboratory: [\n")  # by hand, and wrong: the form may write over what it told
        broken = client.get("/api/v1/stations/bare/papers").json()["laboratory"]
        assert (bool(broken["problem"]), broken["content"]) == (True, None)
        assert client.put(paper, json={"content": mine, "digest": broken["digest"]}).status_code == 200


def test_a_form_has_the_digest_of_the_text_that_it_shows(settings, monkeypatch):
    file = settings.project / "profiles" / "laboratory" / "station_bare.yaml"

    def changed_meanwhile(text, name):
        file.write_text(f"{text}place: Kyiv\n")
        return parse_yaml(text, name)

    with served(settings) as client:
        client.put("/api/v1/stations/bare/papers/laboratory", json={"content": LABORATORY, "digest": ""})
        monkeypatch.setattr("bench.web.plans.papers.parse_yaml", changed_meanwhile)
        opened = client.get("/api/v1/stations/bare/papers").json()["laboratory"]
        monkeypatch.undo()
        answer = client.put("/api/v1/stations/bare/papers/laboratory", json={**opened, "content": LABORATORY})
    assert (answer.status_code, "place: Kyiv" in file.read_text()) == (409, True)


def test_a_form_never_writes_outside_the_project(settings, tmp_path):
    file = settings.project / "profiles" / "stations" / "bare.yaml"
    file.write_text(file.read_text() + f"laboratory: {tmp_path / 'elsewhere.yaml'}\n")
    with served(settings) as client:
        answer = client.put("/api/v1/stations/bare/papers/laboratory", json={"content": LABORATORY, "digest": ""})
    assert (answer.status_code, "edit it there" in answer.json()["detail"]) == (409, True)
    assert not (tmp_path / "elsewhere.yaml").exists()


def test_units_that_began_together_are_told_together_and_one_goes_on_alone(settings, monkeypatch):
    plan, station = settings.project / "profiles/plans/brief.yaml", library() / "stations" / "four_units.yaml"
    units = ["SIM-0001", "GX-2@SIM-0002"]
    orders = Order.load_all(plan, station, units, settings.out, quiet=True)
    held = Fake("diagnose", done=Done("in doubt", hold="a person must look"))
    spoilt = Done("", cases=[Case("fit")], verdict="INVALID")
    skipped = Done("", cases=[Case("static", skipped=True)])
    warned = Done("checked", {"warnings": ["the certificate will not be signed"]})
    calibrate_all(
        orders[:1], steps=[Fake("check", done=warned), Fake("static", done=skipped), Fake("fit", done=spoilt)]
    )
    calibrate_all(orders[1:], steps=[Fake("check"), held])
    record(settings, units, orders)
    with served(settings) as client:
        listed = client.get("/api/v1/calibrations").json()["jobs"]
        assert {job["unit"]: job["state"] for job in listed} == {"SIM-0001": "ended", "GX-2": "held"}
        assert {mate["unit"]: mate["state"] for mate in listed[0]["together"]} == {"SIM-0001": "ended", "GX-2": "held"}
        assert listed[0]["together"][0]["steps"] == {
            "check": {"state": "done", "verdict": None, "warnings": 1},
            "static": {"state": "skipped", "verdict": None, "warnings": 0},
            "fit": {"state": "done", "verdict": "INVALID", "warnings": 0},
        }
        begun = []
        answer = lambda order, _: begun.append(order) or start_of(order)  # noqa: E731
        monkeypatch.setattr("bench.web.live.calibrating.begun", answer)
        (other,) = (job["job"] for job in listed if job["unit"] == "GX-2")
        go_on = client.post(f"/api/v1/calibrations/{other}/continue", json={"release": "known", "operator": "Olha"})
        assert go_on.status_code == 202, go_on.text
        assert (begun[0].units, begun[0].digests) == (["GX-2@SIM-0002"], [orders[1].digest()])
        whole = {"plan": "brief", "station": "four_units", "unit": units[0], "others": units[1:]}
        assert client.post("/api/v1/calibrations", json=whole).status_code == 202
        assert begun[1].arguments(settings.out).count("--unit") == 2
        twice = client.post("/api/v1/calibrations", json={**whole, "others": ["SIM-0001"]})
        assert (twice.status_code, "named twice" in twice.json()["detail"]) == (400, True)


def record(settings, units, orders, started="2026-01-01T00:00:00.000+00:00"):
    """The record of a start of these units, which has ended."""
    start = StartRecord(
        start=f"{started[:4]}1123T000000Z-0", digest=orders[0].digest(), plan="brief", station="four_units",
        digests=tuple(order.digest() for order in orders), units=tuple(units), who={"name": "Olena"},
        started=started,
    )  # fmt: skip
    folder = settings.own / "starts" / start.start
    folder.mkdir(parents=True)
    start.write(folder)


def test_a_calibration_that_stopped_before_anybody_asked_is_found_by_its_start(settings):
    plan, station = settings.project / "profiles/plans/brief.yaml", library() / "stations" / "simulated.yaml"
    order = Order.load(plan, station, "SIM-0001", settings.out, quiet=True)
    job = calibrate(order, steps=[Fake("check", errors=[InputError("no laboratory")])])
    for started in ("2026-01-01T00:00:00.000+00:00", "2999-01-01T00:00:00.000+00:00"):
        record(settings, ["SIM-0001"], [order], started)
    for start in settings.own.glob("starts/*"):
        (start / "exit_code").write_text("2\n")
        (start / "stderr").write_text("bench: another word\n")
    with served(settings) as client:
        told = client.get("/api/v1/starts/20261123T000000Z-0/calibration").json()
        refused = client.get("/api/v1/starts/29991123T000000Z-0/calibration")
    assert (told["job"], told["state"]) == (f"SIM-0001/{job.folder.name}", "failed")
    assert "no laboratory" in told["sentence"]
    assert (refused.status_code, refused.json()["detail"]) == (400, "another word")  # the job had stopped before it


def test_all_units_that_stopped_together_go_on_together(settings, monkeypatch):
    plan, station = settings.project / "profiles/plans/brief.yaml", library() / "stations" / "four_units.yaml"
    units = ["SIM-0001", "GX-2@SIM-0002", "SIM-0003"]
    orders = Order.load_all(plan, station, units, settings.out, quiet=True)
    jobs = calibrate_all(orders, steps=[Fake("check"), Fake("run", errors=[InputError("stopped")] * 3)])
    jobs[2].end("FAIL", "fit: outside limits", 1)
    record(settings, units, orders)
    id_ = f"GX-2/{jobs[1].folder.name}"
    begun = []
    monkeypatch.setattr("bench.web.live.calibrating.begun", lambda order, _: begun.append(order) or start_of(order))
    with served(settings) as client:
        assert client.post(f"/api/v1/calibrations/{id_}/continue", json={}).status_code == 202
        record(settings, begun[0].units[:1], orders[1:2], "2999-01-01T00:00:00.000+00:00")  # one alone
        mates = client.get(f"/api/v1/calibrations/{id_}").json()["together"]
    assert (begun[0].units, begun[0].digests) == (
        ["GX-2@SIM-0002", "SIM-0001"], [orders[1].digest(), orders[0].digest()],
    )  # fmt: skip
    assert {mate["unit"]: mate["state"] for mate in mates} == {
        "SIM-0001": "failed",
        "GX-2": "failed",
        "SIM-0003": "ended",
    }


def start_of(order):
    """An answer like that of a start."""
    return {"start": "s", "state": "waiting", "plan": order.plan, "station": order.station, "units": order.units,
            "who": {}, "started": "", "runs": [], "exit_code": None, "verdict": None, "sentence": "",
            "message": ""}  # fmt: skip


def test_what_is_planned_for_later_begins_then_and_lets_others_go_before_it(settings, monkeypatch):
    now, begun = [datetime(2026, 11, 23, 20, 0, tzinfo=UTC)], []
    monkeypatch.setattr(Starts, "_spawn", lambda self, folder, *_: begun.append(folder.name) or 1)
    monkeypatch.setattr("bench.web.live.starts.locked", lambda path: False)
    starts = Starts(settings.own, settings.out, settings.project, lambda: now[0])
    order = webstarts.Order(plan="p", station="s", station_file=Path("s.yaml"), equipment=frozenset({"station s"}))
    night = replace(order, not_before=datetime(2026, 11, 24, 0, 0, tzinfo=timezone(timedelta(hours=2))))  # 22:00 UTC
    later = starts.begin(night, {})
    assert (later["state"], later["not_before"]) == ("waiting", "2026-11-24T00:00:00+02:00")
    first = starts.begin(order, {})
    assert begun == [first["start"]]
    starts.take_up({})
    assert len(begun) == 1
    again = Starts(settings.own, settings.out, settings.project, lambda: now[0])  # the plan outlives the server
    now[0] = datetime(2026, 11, 23, 22, 0, 1, tzinfo=UTC)
    again.take_up({"station s": "another run"})
    assert len(begun) == 1
    again.take_up({})
    assert begun == [first["start"], later["start"]]


@pytest.mark.parametrize("change", ["edited", "replaced", "removed"])
@pytest.mark.parametrize("of", ["station", "profile behind a plan"])
def test_what_waits_begins_by_the_files_that_were_confirmed_or_says_that_they_changed(
    settings, monkeypatch, of, change
):
    spawned = []
    monkeypatch.setattr(Starts, "_spawn", lambda self, folder, words, who: spawned.append(folder.name) or 1)
    monkeypatch.setattr("bench.web.live.starts.locked", lambda path: False)
    starts = Starts(settings.own, settings.out, settings.project)
    shipped, own = (folder.resolve() / "stations" / "imu.yaml" for folder in (library(), settings.project / "profiles"))
    mine = own.with_name("mine.yaml")
    mine.write_text(shipped.read_text())
    file = shipped if change == "replaced" else mine
    more = {"station_file": file} if of == "station" else {"station_file": settings.project, "behind": (file,)}
    order = webstarts.Order(plan="short", station="imu", equipment=frozenset({"station imu"}), queue=True, **more)
    first, second = (starts.begin(each, {"station imu": "a run"}) for each in (order, replace(order, behind=())))
    if change == "removed":
        mine.unlink()
    else:
        (own if change == "replaced" else mine).write_text(f"{shipped.read_text()}notify: notify.yaml\n")
    told = {one["start"]: one["message"] for one in starts.waiting()}
    assert told[first["start"]] == (
        f"{file.name} changed while this waited, so it does not begin; take it out of the queue and start it again"
    )
    starts.take_up({})
    starts.take_up({})
    assert spawned == ([] if of == "station" else [second["start"]]), "the others do not wait for it"


def test_a_calibration_that_waits_knows_all_files_behind_its_plan(settings):
    with served(settings) as client:
        start = begin(client, unit="SIM-0001", not_before=f"{datetime.now(UTC) + timedelta(days=1):%Y-%m-%dT%H:%MZ}")
        profile = settings.project / "profiles" / "brief.yaml"
        profile.write_text(profile.read_text().replace("duration_min: 18", "duration_min: 19"))
        (waiting,) = client.get("/api/v1/calibrations").json()["waiting"]
        assert (waiting["start"], waiting["message"][:18]) == (start["start"], "brief.yaml changed")
        assert (
            "brief.yaml changed while"
            in CliRunner().invoke(main, ["queue", "list", "--server", str(client.base_url)]).output
        )


@pytest.mark.parametrize("way", ["starts", "calibrations"])
def test_what_waits_knows_the_files_that_its_station_names(settings, way):
    stations = settings.project / "profiles" / "stations"
    dbc = stations / "own.dbc"
    dbc.write_text((Path(drivers.__file__).parent / "gyros" / "vibratory.dbc").read_text())
    text = (library() / "stations" / "simulated.yaml").read_text()
    (stations / "own.yaml").write_text(text.replace("identity: 1\n", "identity: 1\n    gyro: own.dbc\n"))
    wanted = {"starts": {"plan": "brief"}, "calibrations": {"plan": "brief", "unit": "SIM-0001"}}[way]
    with served(settings) as client:
        later = f"{datetime.now(UTC) + timedelta(days=1):%Y-%m-%dT%H:%MZ}"
        begun = client.post(f"/api/v1/{way}", json={**wanted, "station": "own", "not_before": later})
        assert begun.status_code == 202, begun.text
        dbc.write_text(dbc.read_text() + "\n")
        (waiting,) = client.get("/api/v1/calibrations").json()["waiting"]
        assert waiting["message"].startswith("own.dbc changed while this waited")


@pytest.mark.parametrize("way", ["starts", "calibrations"])
def test_a_time_to_begin_that_has_passed_moves_nothing(settings, way):
    wanted = {"starts": {"plan": "long"}, "calibrations": {"plan": "brief", "unit": "SIM-0001"}}[way]
    with served(settings) as client:
        answer = client.post(f"/api/v1/{way}", json={**wanted, "not_before": "2020-01-01T00:00:00Z"})
        assert (answer.status_code, "which has passed" in answer.json()["detail"]) == (400, True), answer.text
        assert client.get("/api/v1/starts").json() == {"starts": []}


def test_a_time_without_its_zone_is_refused(settings):
    with served(settings) as client:
        answer = client.post("/api/v1/starts", json={"plan": "long", "not_before": "2026-11-24T00:00:00"})
        assert answer.status_code == 422
        assert "timezone" in answer.text


def test_who_is_told_of_runs_is_filled_in_on_the_page_which_shows_no_address_again(settings):
    path = settings.project / "profiles" / "notify" / "station_bare.yaml"
    with served(settings) as client, webhook() as hook:
        url = f"json://user:secret@127.0.0.1:{hook.port}"

        def fill_in(*recipients):
            digest = client.get("/api/v1/stations/bare/papers").json()["notify"]["digest"]
            asked = {"content": {"recipients": recipients}, "digest": digest}
            return client.put("/api/v1/stations/bare/papers/notify", json=asked)

        def trial():
            job = client.post("/api/v1/stations/bare/notices", json={}).json()["job"]
            return until(lambda: client.get(f"/api/v1/jobs/{job}?wait_s=20").json()["result"])["recipients"]

        wrong = fill_in({"name": "chat", "url": "secret"})
        assert (wrong.status_code, wrong.json()["detail"][:40]) == (400, "recipients[0].url: begins with no servic")
        assert fill_in({"name": "chat", "url": url, "when": []}).status_code == 400, "told of nothing"
        saved = fill_in({"name": "чат", "url": url, "when": ["trip"]}).raise_for_status()
        assert path.stat().st_mode & 0o777 == 0o600
        renamed = fill_in({"kept": "чат", "name": "chat", "when": ["end"]}).raise_for_status()
        shown = client.get("/api/v1/stations/bare/papers")
        assert shown.json()["notify"]["content"] == {"recipients": [{"kept": "chat", "name": "chat", "when": ["end"]}]}
        assert not [answer for answer in (wrong, saved, renamed, shown) if "secret" in answer.text]
        assert trial() == {"chat": ""}
        assert hook.next()["title"] == "bench: trial"
        assert load_station(settings.project / "profiles" / "stations" / "bare.yaml").notify == str(path)
        assert fill_in().raise_for_status().json()["content"] is None
        assert not path.exists(), "nobody is told any more"
