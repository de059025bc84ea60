"""Units and fleet through the API: which calibration counts, trends, certificates, charts; nothing else is reached."""

import csv
import io
import json
import threading

import pytest

from bench.archive import Archive, runs
from bench.archive.fleet import figures, trends
from bench.archive.fleet.board import harmless
from bench.commands.registering import register
from bench.record import DiagnosisRecord
from bench.web.ground.problems import CountingError
from bench.web.ground.settings import Settings
from bench.web.shelf import stock
from tests.support.fleet_runs import LIMITS, line, station, uncalibrated
from tests.support.run_folders import keep
from tests.support.unit_history import PDF, UNIT, unit_with_history
from tests.support.waiting import until
from tests.support.web_client import served

API = "/api/v1"


@pytest.fixture(scope="module")
def client(tmp_path_factory):
    out = tmp_path_factory.mktemp("units")
    unit_with_history(out)
    line(out, 48, odd=20)
    limits = out / "profiles" / "limits"
    limits.mkdir(parents=True)
    (limits / "line.yaml").write_text(LIMITS)
    with served(Settings(out=out, project=out)) as client:
        assert client.get(f"{API}/units").json()["registry"] is False
        assert client.get(f"{API}/fleet").json()["registry"] is False
        made = client.post(f"{API}/registry", json={})
        assert made.json()["units"] == 49
        yield client


def test_units_are_found_by_serial_lot_and_standing(client):
    every = client.get(f"{API}/units", params={"limit": 5}).json()
    assert (every["total"], every["matched"], len(every["units"])) == (49, 49, 5)
    assert every["units"][0]["serial"] == UNIT, "the last run first"
    assert every["standings"] == {"fail": 1, "unjudged": 48}
    found = client.get(f"{API}/units", params={"q": "l0- 001", "sort": "serial"}).json()
    assert [one["serial"] for one in found["units"]][:2] == ["L0-0001", "L0-0010"]
    assert client.get(f"{API}/units", params={"standing": "fail"}).json()["matched"] == 1


def test_a_history_says_which_calibration_counts_and_why_the_others_do_not(client):
    unit = client.get(f"{API}/units/{UNIT}").json()
    assert [one["status"] for one in unit["calibrations"]] == [
        "not_passed", "newest", "in_unit", "superseded", "superseded"
    ]  # fmt: skip
    assert unit["memory"]["calibration_id"] == "0x87323979"
    assert unit["memory"]["before"] == "0x1144AA07"
    assert unit["calibrations"][2]["validity"]["temperature"]["from"] == -36.0
    assert unit["calibrations"][0]["age_days"] < unit["calibrations"][4]["age_days"]
    aborted = [run for run in unit["runs"] if run["state"] == "aborted"]
    assert [run["cause"] for run in aborted] == ["guard: chamber temperature"]


def test_of_a_long_history_the_newest_part_is_answered_and_what_counts(client, monkeypatch):
    looked = []
    monkeypatch.setattr(Archive, "folder", lambda self, run, own=Archive.folder: looked.append(run) or own(self, run))
    whole, part = (client.get(f"{API}/units/{UNIT}", params=most).json() for most in ({}, {"most": 2}))
    assert len(looked) < 2 * len(whole["runs"]), "no folder is opened that is not told of"
    assert part["of"] == whole["of"] == {"runs": 6, "calibrations": 5}
    for name in ("runs", "calibrations"):
        assert [one["run"] for one in part[name]] == [one["run"] for one in whole[name]][:2]
    assert part["counts"]["run"] == whole["calibrations"][2]["run"], "the one in the unit, which is older"
    trend = part["trends"][0]
    assert (trend["of"], trend["change"]) == (5, pytest.approx(0.08))
    assert [point["value"] for point in trend["points"]] == pytest.approx([0.12, 0.168, 0.184, 0.2])


def test_a_trend_goes_over_runs_with_its_limits(client):
    unit = client.get(f"{API}/units/{UNIT}").json()
    trend = unit["trends"][0]
    assert trend["name"] == "residual_rms_dph"
    assert [point["value"] for point in trend["points"]] == pytest.approx([0.12, 0.136, 0.168, 0.184, 0.2])
    assert (trend["upper"], trend["outside"]) == (0.19, True)
    assert trend["change"] == pytest.approx(0.08)
    figure = client.get(f"{API}/units/{UNIT}/trends/residual_rms_dph").json()["figure"]
    assert figure["data"][0]["y"] == pytest.approx([0.12, 0.136, 0.168, 0.184, 0.2])
    assert "range" not in figure["layout"]["xaxis"]
    (limit,) = figure["layout"]["annotations"]
    assert (limit["text"], limit["xanchor"], limit["x"]) == ("upper limit", "left", 0), "the last point is at the right"
    single = client.get(f"{API}/units/L0-0000/trends/residual_rms_dph").json()["figure"]
    assert single["layout"]["xaxis"]["range"] == ["2026-02-28T23:00:00+00:00", "2026-03-01T01:00:00+00:00"]
    assert client.get(f"{API}/units/{UNIT}/trends/nothing").status_code == 404


def test_a_limit_is_named_beside_a_single_point():
    point = {"created": "2026-03-01T00:00:00+00:00", "value": 0.4, "profile": "ramp", "run": "r"}
    drawn = trends.figure({"unit": "deg/h", "lower": None, "upper": 0.5, "points": [point]})
    assert [one["xanchor"] for one in drawn["layout"]["annotations"]] == ["right"]


def test_a_certificate_opens_by_its_number_and_by_nothing_else(client):
    unit = client.get(f"{API}/units/{UNIT}").json()
    number = next(one["certificate"]["number"] for one in unit["calibrations"] if one["status"] == "in_unit")
    answer = client.get(f"{API}/units/{UNIT}/certificates/{number}")
    assert answer.content == PDF
    assert answer.headers["content-type"] == "application/pdf"
    for wrong in ("..%2F..%2Fledger.jsonl", "certificate.pdf", "%00", f"{number}%00"):
        assert client.get(f"{API}/units/{UNIT}/certificates/{wrong}").status_code == 404, wrong
    for wrong in ("..%2f..", "%2e%2e%2f", "L0-0001"):
        assert client.get(f"{API}/units/{wrong}/certificates/{number}").status_code == 404, wrong


def test_the_fleet_is_told_in_numbers_and_drawn_a_figure_at_a_time(client):
    fleet = client.get(f"{API}/fleet", params={"q": "L", "limits": "line"}).json()
    assert fleet["units"] == 48
    assert fleet["yield"]["judged"] == 48
    assert "line" in fleet["known_limits"]
    assert [one["unit"] for one in fleet["unlike"]][:1] == ["L0-0020"]
    assert "angle_random_walk_dprh" in fleet["attention"]["beyond"]
    chart = client.get(f"{API}/fleet/charts/angle_random_walk_dprh", params={"q": "L"}).json()
    assert chart["units"][20] == "L0-0020"
    assert {"rule": 1, "unit": "L0-0020", "at": 21, "text": "beyond three sigma"} in chart["signals"]
    assert client.get(f"{API}/fleet/charts/distances", params={"q": "L"}).json()["figure"]["data"]
    (passed,) = client.get(f"{API}/fleet/charts/yield", params={"q": "L", "limits": "line"}).json()["figure"]["data"]
    assert set(passed["y"]) == {100.0}
    assert client.get(f"{API}/fleet/charts/nothing").status_code == 404
    assert client.get(f"{API}/fleet", params={"limits": "../../line"}).status_code == 404
    assert client.get(f"{API}/fleet", params={"q": "(a+)+$"}).json()["units"] == 0, "text, not a pattern"


@pytest.mark.parametrize(("params", "units"), [
    ({"station": "station-A"}, 24),
    ({"lot": "L1"}, 8),
    ({"station": "station-B", "lot": "L1"}, 4),
    ({"since": "2026-03-03", "until": "2026-03-04"}, 10),
    ({"until": "2026-03-01"}, 5),
    ({"since": "2026-03-02T22:00:00Z", "until": "2026-03-04T22:00:00.000Z"}, 10),
    ({"since": "2026-03-02T00:00:00Z", "until": "2026-03-03T00:00:00Z"}, 5),
    ({"since": "2026-03-04", "until": "2026-03-03"}, 0),
    ({"since": "0001-01-01", "until": "9999-12-31"}, 48),
    ({"since": "0001-01-01T00:00:00+14:00", "until": "9999-12-31T23:59:59-12:00"}, 48),
    ({"plan": "ramp"}, 48),
    ({"plan": "other"}, 0),
    ({"since": "2027-01-01"}, 0),
])  # fmt: skip
def test_a_fleet_is_told_of_some_stations_lots_plans_and_days(client, params, units):
    fleet = client.get(f"{API}/fleet", params={"q": "L", **params}).json()
    assert fleet["units"] == units
    assert {"station-A", "station-B"} <= set(fleet["choices"]["stations"]), "of all, whatever is chosen"
    assert {"L0", "L1"} <= set(fleet["choices"]["lots"])
    assert "ramp" in fleet["choices"]["plans"]


def test_a_day_that_is_none_is_refused(client):
    assert "since" in client.get(f"{API}/fleet", params={"since": "yesterday"}).json()["detail"]


def test_a_point_of_a_chart_is_named_and_leads_to_its_run(client):
    for name in ("angle_random_walk_dprh", "distances"):
        chart = client.get(f"{API}/fleet/charts/{name}", params={"q": "L"}).json()
        labels = {
            x: text for trace in chart["figure"]["data"] for x, text in zip(trace["x"], trace["text"], strict=True)
        }
        assert labels[21.0] == "L0-0020 · L0 · station-A · 2026-03-05 UTC"
        assert chart["runs"][20] == "L0-0020/20260305T000000Z_ramp"


def test_a_histogram_counts_every_unit_and_shows_the_limits(client):
    params = {"q": "L", "limits": "line"}
    figure = client.get(f"{API}/fleet/charts/angle_random_walk_dprh", params=params).json()["histogram"]
    (bars,) = figure["data"]
    assert sum(bars["y"]) == 48
    assert [shape["x0"] for shape in figure["layout"]["shapes"]] == [0.02]
    low, high = figure["layout"]["xaxis"]["range"]
    assert low < min(bars["x"])
    assert high > 0.02
    assert client.get(f"{API}/fleet/charts/distances", params=params).json()["histogram"] is None


def test_a_verification_is_no_calibration(tmp_path):
    folders = unit_with_history(tmp_path)
    manifest = json.loads((folders[-1] / "manifest.json").read_text())
    keep(folders[-1], "manifest.json", {**manifest, "purpose": "verification"})
    with served(Settings(out=tmp_path)) as client:
        client.post(f"{API}/registry", json={})
        (line_of,) = client.get(f"{API}/units").json()["units"]
        unit = client.get(f"{API}/units/{UNIT}").json()
    assert len(unit["calibrations"]) == line_of["calibrations"] == 4
    assert unit["runs"][0]["kind"] == "verification"


@pytest.mark.parametrize(("state", "word"), [("aborted", "PASS"), ("fault", None), ("done", "INVALID")])
def test_a_run_that_was_aborted_or_is_invalid_is_no_calibration(tmp_path, state, word):
    """The last calibration of the unit is the one before it; its runs list it with its outcome."""
    folders = unit_with_history(tmp_path)
    with served(Settings(out=tmp_path)) as client:

        def told():
            client.post(f"{API}/registry", json={})
            (line_of,) = client.get(f"{API}/units").json()["units"]
            return line_of, client.get(f"{API}/units/{UNIT}").json()

        before, _ = told()
        assert before["calibrated"] == json.loads((folders[-1] / "manifest.json").read_text())["created"]
        last = json.loads((folders[-1] / "manifest.json").read_text())
        keep(folders[-1], "manifest.json", {**last, "state": state, "cause": "operator"})
        keep(folders[-1], "limits.json", {"name": "vibratory", "verdict": word, "results": []})
        after, unit = told()
    earlier = json.loads((folders[-2] / "manifest.json").read_text())["created"]
    assert (after["calibrated"], after["calibrations"], after["runs"]) == (earlier, 4, 6)
    assert (before["standing"], after["standing"]) == ("fail", "pass")
    assert len(unit["calibrations"]) == unit["of"]["calibrations"] == 4
    assert {trend["of"] for trend in unit["trends"]} == {4}, "nor is it a point of a trend"
    assert (unit["runs"][0]["state"], unit["runs"][0]["judged"]) == (state, word)


def test_units_that_cannot_be_judged_are_not_counted_as_rejects(tmp_path):
    line(tmp_path, 12)
    limits = tmp_path / "profiles" / "limits"
    limits.mkdir(parents=True)
    (limits / "wider.yaml").write_text(
        f"{LIMITS}  - {{quantity: condition, unit: '1', upper: 1e6, reason: nobody measured it}}\n"
    )
    with served(Settings(out=tmp_path, project=tmp_path)) as client:
        client.post(f"{API}/registry", json={})
        fleet = client.get(f"{API}/fleet", params={"limits": "wider"}).json()
    assert (fleet["yield"]["judged"], fleet["yield"]["unjudged"]) == (0, 12)
    assert (fleet["attention"]["outside"], fleet["attention"]["unjudged"]) == (0, 12)
    assert fleet["attention"]["unjudged_units"][0] == "L0-0011", "the newest first"
    assert fleet["missing"] == ["condition"]


def test_the_table_for_a_spreadsheet_has_no_cell_that_is_calculated(client):
    rows = list(csv.reader(io.StringIO(client.get(f"{API}/fleet.csv").text)))
    assert len(rows) > 48
    assert harmless("=1+1") == "'=1+1"
    assert harmless("@SUM(A1)") == "'@SUM(A1)"
    assert harmless("-0.25") == "-0.25"


def test_a_run_that_is_registered_meanwhile_is_seen_at_the_next_look(tmp_path):
    register([station(tmp_path, "A-1", "one", 0.0, residual=0.1)])
    with served(Settings(out=tmp_path)) as client:
        assert client.get(f"{API}/units").json()["total"] == 1
        register([station(tmp_path, "A-2", "one", 1.0, residual=0.1)])
        assert client.get(f"{API}/units").json()["total"] == 2


@pytest.fixture
def counted(tmp_path, monkeypatch):
    """A registry of one run, and a count of its runs that waits until it may go on."""
    monkeypatch.setattr(stock, "_PATIENCE_S", -1.0)
    register([station(tmp_path, "A-1", "one", 0.0, residual=0.1)])
    go_on = threading.Event()

    def slowly(registry):
        go_on.wait()
        return {"runs": len(runs(registry))}

    return slowly, go_on


def ended():
    """Wait for a count that is under way."""
    for thread in threading.enumerate():
        if thread.name == "stock":
            thread.join()


def test_an_answer_that_takes_long_is_given_as_it_was_and_made_anew_beside_it(tmp_path, counted):
    slowly, go_on = counted
    shelf = stock.Stock(tmp_path)
    with pytest.raises(CountingError, match="ask again"):
        shelf.answer("runs", slowly)
    go_on.set()
    ended()
    assert shelf.answer("runs", slowly) == stock.Answer({"runs": b"1"}, current=True)
    go_on.clear()
    register([station(tmp_path, "A-2", "one", 1.0, residual=0.1)])
    assert shelf.answer("runs", slowly) == stock.Answer({"runs": b"1"}, current=False)
    go_on.set()
    ended()
    assert shelf.answer("runs", slowly) == stock.Answer({"runs": b"2"}, current=True)


def test_an_answer_that_is_still_being_counted_is_in_the_description(tmp_path, monkeypatch):
    def takes_long(shelf, question, ask):
        raise CountingError("ask again")

    monkeypatch.setattr(stock.Stock, "answer", takes_long)
    register([station(tmp_path, "A-1", "one", 0.0, residual=0.1)])
    with served(Settings(out=tmp_path), repeats=False) as client:
        described = client.get(f"{API}/openapi.json").json()["paths"]
        for path in ("/fleet", "/fleet/lacks", "/fleet/charts/{name}"):
            answer = client.get(API + path.format(name="distances"))
            assert (answer.status_code, answer.headers["Retry-After"]) == (202, "1")
            assert "202" in described[API + path]["get"]["responses"]


def test_many_questions_at_once_are_counted_a_few_at_a_time(tmp_path, counted):
    _, go_on = counted
    shelf, begun = stock.Stock(tmp_path), []

    def slowly(registry):
        begun.append(registry)
        go_on.wait()
        return {"runs": 0}

    for number in range(20):
        with pytest.raises(CountingError):
            shelf.answer(f"question {number}", slowly)
    assert sum(thread.name == "stock" for thread in threading.enumerate()) == stock._COUNTING
    assert len(begun) <= stock._COUNTING
    go_on.set()
    ended()
    assert len(begun) == 20


def test_a_server_that_starts_gives_the_last_answer_that_took_long_at_once(tmp_path, counted):
    slowly, go_on = counted
    own = tmp_path / ".web"
    own.mkdir()

    def asked_at_a_start():
        return stock.Stock(tmp_path, own=lambda: own).answer("runs", slowly)

    for damage in (False, True):
        with pytest.raises(CountingError):
            asked_at_a_start()
        go_on.set()
        ended()
        go_on.clear()
        register([station(tmp_path, f"A-{2 + damage}", "one", 1.0, residual=0.1)])
        assert asked_at_a_start() == stock.Answer({"runs": b"2" if damage else b"1"}, current=False)
        go_on.set()
        ended()
        go_on.clear()
        (kept,) = (own / "counted").iterdir()
        kept.write_bytes(b"{")


def test_who_asks_for_what_is_being_counted_is_told_when_to_ask_again(tmp_path, counted):
    _, go_on = counted
    with served(Settings(out=tmp_path, project=tmp_path), repeats=False) as client:
        answer = client.get(f"{API}/fleet")
        assert (answer.status_code, answer.headers["retry-after"]) == (202, "1")
    go_on.set()
    ended()


def test_a_figure_has_the_newest_units_and_the_limits_of_all(client, monkeypatch):
    whole = client.get(f"{API}/fleet/charts/residual_rms_dph").json()
    monkeypatch.setattr(figures, "MOST", 10)
    part = client.get(f"{API}/fleet/charts/residual_rms_dph", params={"until": "2099-01-01"}).json()
    assert (part["units"], part["all"]) == (whole["units"][-10:], len(whole["units"]))
    assert part["histogram"] == whole["histogram"]
    assert part["figure"]["data"][0]["y"] == whole["figure"]["data"][0]["y"][-10:]
    assert len(client.get(f"{API}/fleet/charts/distances", params={"until": "2099-01-01"}).json()["units"]) == 10


def test_a_fleet_says_which_runs_it_leaves_out_and_whose_lots_are_cut_from_serial_numbers(tmp_path):
    for number in range(3):
        station(tmp_path, f"SIM-{number}", "S", number, residual=0.1, simulated=True)
    station(tmp_path, "REAL", "S", 4.0, residual=0.2, simulated=False)
    with served(Settings(out=tmp_path, project=tmp_path)) as client:
        client.post(f"{API}/registry", json={}).raise_for_status()
        real = client.get(f"{API}/fleet").json()
        assert (real["units"], real["simulated"], real["left_out"]) == (1, False, ["3 simulated"])
        assert (real["choices"]["lots"], real["choices"]["cut"]) == (["SIM", "no lot"], ["SIM"])
        others = client.get(f"{API}/fleet", params={"simulated": "true"}).json()
        assert (others["units"], others["simulated"], others["left_out"]) == (3, True, ["1 not simulated"])


def diagnosed(folder, model, lacks):
    suspects = [{"effect": name, "found": True, "proved": True} for name in lacks]
    word = "missing_effect" if lacks else "adequate"
    DiagnosisRecord.model_validate(
        {"format": 1, "verdict": word, "model": model, "runs": [folder.name], "suspects": suspects}
    ).write(folder)


def test_what_units_lack_is_told_of_the_units_of_the_other_figures(tmp_path):
    for number in range(3):
        diagnosed(station(tmp_path, f"A-{number}", "S", number, residual=0.1, simulated=False), "spline", ["creep"])
    diagnosed(station(tmp_path, "B-1", "", 4.0, residual=0.1, simulated=False), "polynomial", ["hysteresis"])
    diagnosed(station(tmp_path, "C-1", "S", 4.0, residual=0.1, simulated=True), "spline", ["thermal_lag"])
    with served(Settings(out=tmp_path, project=tmp_path)) as client:
        client.post(f"{API}/registry", json={}).raise_for_status()
        for chosen in ({}, {"lot": "A"}, {"lot": "B"}, {"station": "unknown"}, {"q": "B-"}, {"simulated": "true"}):
            told = client.get(f"{API}/fleet/lacks", params=chosen).json()
            units = client.get(f"{API}/fleet", params=chosen).json()["units"]
            assert (chosen, sum(told["models"].values())) == (chosen, units)
            assert told["units"] == (3 if not chosen else units)


def test_units_that_were_not_diagnosed_are_by_a_job_that_names_those_it_cannot(tmp_path):
    folders = [station(tmp_path, unit, "S", 1.0, residual=0.1) for unit in ("A-1", "A-2", "B-1")]
    with served(Settings(out=tmp_path, project=tmp_path)) as client:
        client.post(f"{API}/registry", json={}).raise_for_status()
        diagnosed(folders[0], "spline", ["creep"])
        shown = f"{API}/fleet/lacks?q=A-&since=2026-01-01"
        assert client.post(shown, json={"model": "nobody"}).status_code == 400
        job = client.post(shown, json={"model": "spline"}).json()["job"]
        done = until(lambda: (seen := client.get(f"{API}/jobs/{job}?wait_s=20").json())["state"] == "done" and seen)
        assert done["result"]["made"] == 0
        assert [text.partition(":")[0] for text in done["result"]["failed"]] == ["A-2"]
        assert str(tmp_path) not in str(done)
        assert client.get(f"{API}/fleet/lacks").json()["lots"][0]["lacks"] == {"creep": 1}


def test_runs_without_a_calibration_do_not_choose_of_which_plan_it_is_told_what_units_lack(tmp_path):
    diagnosed(station(tmp_path, "A-0", "S", 0.0, residual=0.1, simulated=True), "spline", ["creep"])
    for number in range(3):
        folder = uncalibrated(tmp_path, f"B-{number}", "S", number, profile="check", simulated=False)
        diagnosed(folder, "polynomial", ["hysteresis"])
    with served(Settings(out=tmp_path, project=tmp_path)) as client:
        client.post(f"{API}/registry", json={}).raise_for_status()
        shown = client.get(f"{API}/fleet").json()
        assert (shown["units"], shown["plan"], shown["simulated"]) == (1, "ramp", True)
        told = client.get(f"{API}/fleet/lacks").json()
        assert (told["models"], told["lots"][0]["lot"]) == ({"spline": 1}, "A")
        assert client.get(f"{API}/fleet/lacks", params={"lot": "B"}).json()["models"] == {"polynomial": 3}


def test_what_units_lack_is_told_by_lot_of_the_model_that_most_were_diagnosed_with(tmp_path):
    for lot, number, model, lacks in (
        *(("A", i, "spline", ["thermal_lag"]) for i in range(9)),
        *(("B", i, "spline", ["hysteresis"] if i < 2 else []) for i in range(30)),
        ("B", 40, "polynomial", ["creep"]),
    ):
        diagnosed(station(tmp_path, f"{lot}-{number}", "S", number / 10, residual=0.1), model, lacks)
    with served(Settings(out=tmp_path, project=tmp_path)) as client:
        assert client.get(f"{API}/fleet/lacks").json()["units"] == 0
        client.post(f"{API}/registry", json={}).raise_for_status()
        told = client.get(f"{API}/fleet/lacks").json()
        assert (told["model"], told["models"], told["units"]) == ("spline", {"spline": 39, "polynomial": 1}, 39)
        assert told["lots"] == [
            {"lot": "A", "units": 9, "verdicts": {"missing_effect": 9}, "lacks": {"thermal_lag": 9}},
            {"lot": "B", "units": 30, "verdicts": {"missing_effect": 2, "adequate": 28}, "lacks": {"hysteresis": 2}},
        ]
        assert [(one["lot"], one["effect"]) for one in told["in_common"]] == [("A", "thermal_lag")]
        other = client.get(f"{API}/fleet/lacks", params={"model": "polynomial"}).json()
        assert other["lots"][0]["lacks"] == {"creep": 1}
