"""The verdict's page: its words before, with and without an analysis, of verifications and of several units."""

import json
import re

import pytest
from axe_playwright_python.sync_playwright import Axe

from bench.web.people import people
from tests.support.bench_project import bench_over
from tests.support.run_folders import make_run, ramp_run


def ended(out, name):
    """Folder of a run of SIM-0001 that ended as planned."""
    folder = out / "SIM-0001" / name
    folder.mkdir(parents=True, exist_ok=True)
    manifest = {"state": "done", "cause": "profile done", "unit": "SIM-0001"}
    (folder / "manifest.json").write_text(json.dumps(manifest))
    return folder


def test_a_run_whose_analysis_died_is_a_warning_until_somebody_analyses_it(site, visitors):
    address, out = site
    folder = ended(out, "20261121T060000Z_ramp")
    page = visitors.come(address)
    page.goto("/verdict/SIM-0001/20261121T060000Z_ramp")
    page.get_by_role("heading", name="NOT ANALYSED").wait_for()
    assert page.locator("article.tone-warn").count() == 1
    assert page.get_by_text("bench report").count() == 0
    assert page.get_by_role("link", name="Report").count() == 0
    (folder / "calibration.json").write_text(json.dumps({"verdict": {"verdict": "adequate", "sentence": "Good."}}))
    (folder / "report.html").write_text("")
    page.get_by_role("heading", name="ADEQUATE").wait_for()
    assert page.get_by_role("link", name="Report").count() == 1


def test_a_unit_without_an_analysed_run_has_no_history_yet_and_leads_back_to_its_run(site, visitors):
    address, out = site
    folder = make_run(out / "SIM-0099" / "20261121T060000Z_ramp", unit="SIM-0099", **ramp_run())
    page = visitors.come(address)
    visitors.of(page).forgives = re.compile("status of 404")
    page.goto(f"/verdict/SIM-0099/{folder.name}")
    page.get_by_role("link", name="History of the unit").click()
    page.get_by_text("SIM-0099 has no history yet").wait_for()
    page.get_by_role("main").get_by_role("link", name="Run", exact=True).click()
    page.wait_for_url(f"**/verdict/SIM-0099/{folder.name}")
    page.goto("/units/SIM-0099?job=SIM-0099/20261121T060000Z")
    leading = page.get_by_role("main").get_by_role("link", name="Calibration", exact=True)
    assert leading.get_attribute("href") == "/calibrations/SIM-0099/20261121T060000Z"
    page.goto("/units/SIM-0099")
    page.get_by_text("No unit SIM-0099 is known here").wait_for()


def test_a_run_that_was_not_analysed_is_analysed_by_one_click(site, visitors):
    address, out = site
    folder = make_run(out / "SIM-0002" / "20261121T060000Z_ramp", **ramp_run())
    page = visitors.come(address)
    page.goto(f"/verdict/SIM-0002/{folder.name}")
    page.get_by_role("button", name="Analyse now").click()
    page.get_by_role("link", name="Report").wait_for()
    assert page.get_by_role("heading", name="NOT ANALYSED").count() == 0


def test_a_heading_agrees_with_the_values_also_without_a_report(site, visitors):
    address, out = site
    folder = ended(out, "20261121T070000Z_ramp")
    over = {"name": "samples_lost", "value": 9, "low": 9, "high": 9, "unit": "1", "lower": None, "upper": 0,
            "reason": "", "verdict": "FAIL"}  # fmt: skip
    (folder / "limits.json").write_text(json.dumps({"name": "t", "verdict": "FAIL", "results": [over]}))
    page = visitors.come(address)
    page.goto(f"/verdict/SIM-0001/{folder.name}")
    page.get_by_role("heading", name="FAIL").wait_for()
    page.get_by_role("row", name="Samples lost").get_by_text("Fail").wait_for()
    page.get_by_role("button", name="Analyse now").wait_for()


def test_a_verification_shows_its_own_verdict_and_offers_no_calibration(site, visitors):
    address, out = site
    folder = ended(out, "20261121T080000Z_check")
    ended(out, "20261121T060000Z_ramp")
    verified = {
        "verdict": "MARGINAL", "rms_dph": 0.1318, "over_floor": 1.21, "calibration_run": "20261121T060000Z_ramp",
        "rule": "RMS of the corrected rate at most 1.2 times the noise floor",
    }  # fmt: skip
    (folder / "verification.json").write_text(json.dumps(verified))
    page = visitors.come(address)
    page.goto(f"/verdict/SIM-0001/{folder.name}")
    page.get_by_role("heading", name="MARGINAL").wait_for()
    page.get_by_text(verified["rule"]).wait_for()
    page.get_by_text("0.1318 deg/h RMS of its own output").wait_for()
    assert page.get_by_role("link", name="Report").count() == 0
    page.get_by_role("link", name="Deliver and check").click()
    page.get_by_role("link", name="The calibration that it verifies").wait_for()
    assert page.get_by_role("heading", name="Certificate").count() == 0


def test_a_report_on_a_verification_does_not_take_the_place_of_its_verdict(site, visitors):
    address, out = site
    folder = ended(out, "20261121T083000Z_check")
    (folder / "verification.json").write_text(json.dumps({"verdict": "FAIL", "rms_dph": 0.9}))
    unproven = {"verdict": {"verdict": "unproven", "sentence": "No model could be fitted."}}
    (folder / "calibration.json").write_text(json.dumps(unproven))
    (folder / "limits.json").write_text(json.dumps({"name": "t", "verdict": "INVALID"}))
    page = visitors.come(address)
    page.goto(f"/verdict/SIM-0001/{folder.name}")
    page.get_by_role("heading", name="FAIL").wait_for()


@pytest.mark.parametrize(("refusals", "tone"), [([], "good"), (["the run is not complete: aborted"], "idle")])
def test_a_value_within_its_limits_is_green_only_where_the_run_gives_a_result(site, visitors, refusals, tone):
    address, out = site
    folder = ended(out, f"20261121T094000Z_{tone}")
    within = {"name": "samples_lost", "value": 0, "low": 0, "high": 0, "unit": "1", "lower": None, "upper": 0,
              "reason": "", "verdict": "PASS"}  # fmt: skip
    word = "INVALID" if refusals else "PASS"
    limits = {"name": "t", "verdict": word, "results": [within], "refusals": refusals}
    (folder / "limits.json").write_text(json.dumps(limits))
    page = visitors.come(address)
    page.goto(f"/verdict/SIM-0001/{folder.name}")
    page.get_by_role("row", name="Samples lost").locator(f".lamp.tone-{tone}").wait_for()


UNHEARD = "unit SIM-0001: no sound rate frame as number 0 on bus can0; check its power, number and bit rate"


@pytest.mark.parametrize(
    ("state", "cause", "heading"),
    [("failed", f"not started: {UNHEARD}", "NOT STARTED"),
     ("aborted", "aborted by guard: unit silent: age of the newest frame = 5.002 is above 5", "ABORTED")],
)  # fmt: skip
def test_a_unit_that_is_not_heard_is_no_failure_of_the_equipment_and_says_what_to_check(
    site, visitors, state, cause, heading
):
    address, out = site
    folder = ended(out, f"20261121T093000Z_{state}")
    (folder / "manifest.json").write_text(json.dumps({"state": state, "cause": cause, "unit": "SIM-0001"}))
    end = {"t_s": 10.0, "utc": "2026-11-21T09:30:10.000+00:00", "kind": "end", "text": cause, "state": state}
    (folder / "events.jsonl").write_text(json.dumps(end) + "\n")
    refused = {"name": "t", "verdict": "INVALID", "results": [], "refusals": [f"the run is not complete: {state}"]}
    (folder / "limits.json").write_text(json.dumps(refused))
    page = visitors.come(address)
    page.goto(f"/verdict/SIM-0001/{folder.name}")
    page.get_by_role("heading", name=heading).wait_for()
    page.get_by_text("its connector and power, its number and the bit rate. Then repeat the run").wait_for()
    page.get_by_text("Nothing was switched on").wait_for()
    reasons = page.locator(".verdict-reasons .findings li")
    if state == "aborted":
        reasons.wait_for()
    assert reasons.all_inner_texts() == (["The run is not complete: aborted."] if state == "aborted" else [])


def test_a_verdict_is_dark_on_white_paper_also_from_a_dark_page(site, visitors):
    address, out = site
    folder = ended(out, "20261121T090000Z_ramp")
    page = visitors.come(address, scheme="dark")
    page.goto(f"/verdict/SIM-0001/{folder.name}")
    page.get_by_role("heading", name="NOT ANALYSED").wait_for()
    shown = "(color) => getComputedStyle(document.querySelector('.verdict-sentence')).color === color"
    page.wait_for_function(shown, arg="rgb(232, 237, 241)")
    page.emulate_media(media="print")
    page.wait_for_function(shown, arg="rgb(20, 32, 43)")


def test_the_longest_verdict_does_not_break_within_a_word_on_a_telephone(site, visitors):
    address, out = site
    folder = ended(out, "20261121T090000Z_ramp")
    page = visitors.come(address, size={"width": 360, "height": 780}, locale="uk-UA")
    page.goto(f"/verdict/SIM-0001/{folder.name}")
    word = page.get_by_role("heading", name="НЕ ПРОАНАЛІЗОВАНО")
    word.wait_for()
    lines = word.evaluate("(h) => h.getBoundingClientRect().height / parseFloat(getComputedStyle(h).lineHeight)")
    assert round(lines) <= 2


def test_the_verdict_on_a_unit_does_not_wait_for_those_beside_it_and_that_on_all_does(site, visitors):
    page = visitors.come(site[0])
    units = [{"unit": f"U-{n}", "run": f"U-{n}/run", "verdict": None, "sentence": "", "limits": None, "analysed": False}
             for n in range(4)]  # fmt: skip
    units[2] |= {"verdict": "adequate", "limits": "PASS", "analysed": True}
    units[3] |= {"verdict": "missing_effect", "limits": "MARGINAL", "analysed": True}
    end = {"state": "done", "cause": "", "analysing": True, "units": units, "verdict": None, "safe": True,
           "safe_state": [], "requests": []}  # fmt: skip
    run = {"run": "U-0/run", "runs": [one["run"] for one in units], "condition": "ended", "profile": "short",
           "station": "s", "ended": end}  # fmt: skip
    page.route("**/api/v1/live/U-0/run", lambda route: route.fulfill(json=run))
    page.route("**/api/v1/runs/*/run", lambda route: route.fulfill(json={"limits": None, "steps": {}}))
    page.goto("/verdict/U-0/run")
    page.locator(".verdict-units li").nth(3).wait_for()
    told = page.locator(".verdict-units strong").all_inner_texts()
    assert [text.upper() for text in told] == ["MEASURED", "MEASURED", "PASS", "MARGINAL"]
    assert page.locator("h1").inner_text().upper() == "MEASURED", "a worse one may come"
    assert "MEASURED" in page.title()
    for unit in units[:2]:
        unit |= {"verdict": "adequate", "limits": "PASS", "analysed": True}
    end["analysing"] = False
    page.get_by_role("heading", name="MARGINAL").wait_for()


def test_several_units_stand_in_the_order_of_their_numbers_and_are_spoken_of_as_several(site, visitors):
    page = visitors.come(site[0])
    units = [{"unit": f"U-{n}", "run": f"U-{n}/run", "verdict": "missing_effect", "sentence": "", "limits": None,
              "analysed": True} for n in (2, 1, 10)]  # fmt: skip
    end = {"state": "done", "cause": "", "analysing": False, "units": units, "verdict": None, "safe": True,
           "safe_state": [], "requests": []}  # fmt: skip
    run = {"run": "U-2/run", "runs": [one["run"] for one in units], "condition": "ended", "profile": "short",
           "station": "s", "ended": end}  # fmt: skip
    page.route("**/api/v1/live/U-2/run", lambda route: route.fulfill(json=run))
    page.goto("/verdict/U-2/run")
    page.get_by_text("Remove the units.").wait_for()
    assert page.locator(".verdict-units b").all_inner_texts() == ["U-1", "U-2", "U-10"]
    assert "effect of these units" in page.locator(".verdict-sentence").inner_text()
    units[0]["verdict"] = "adequate"
    page.reload()
    page.locator(".verdict-sentence").get_by_text("U-1, U-10: ").wait_for()
    todo = page.locator(".verdict-next p").all_inner_texts()
    assert [text.partition(": ")[0] for text in todo] == ["U-1, U-10", "U-2"], "each is told what to do with"


def test_a_table_of_values_says_which_of_several_units_it_is_about(site, visitors):
    page = visitors.come(site[0])
    unit = {"verdict": "adequate", "sentence": "", "analysed": True}
    units = [{**unit, "unit": f"Ж-{n}", "run": f"-{n}/run", "limits": ("PASS", "MARGINAL")[n]} for n in range(2)]
    end = {"state": "done", "cause": "", "analysing": False, "units": units, "verdict": "adequate", "safe": True,
           "safe_state": [], "requests": []}  # fmt: skip
    run = {"run": "-0/run", "runs": ["-0/run", "-1/run"], "condition": "ended", "profile": "short", "ended": end}
    peak = {"name": "residual_peak_dph", "value": 0.3, "low": 0.0, "high": None, "unit": "deg/h", "lower": None,
            "upper": 2.5, "reason": "", "verdict": "MARGINAL"}  # fmt: skip
    judged = {
        "limits": {"name": "short", "results": [peak], "refusals": ["a gap"]},
        "steps": {},
        "segments": [],
        "losses": {},
    }
    page.route("**/api/v1/live/-0/run", lambda route: route.fulfill(json=run))
    page.route("**/api/v1/runs/*/run", lambda route: route.fulfill(json=judged))
    page.goto("/verdict/-0/run")
    page.get_by_role("table", name="Ж-0").wait_for()
    assert page.get_by_role("table").first.locator("caption").inner_text() == "Ж-1", "the worst first"
    table = page.get_by_role("table", name="Ж-1")
    why = table.get_by_role("cell").first.inner_text().split()
    assert page.locator(".verdict-reasons .findings li").all_inner_texts() == ["Ж-1: a gap", "Ж-0: a gap"]
    assert why == ["0.300", "deg/h", "0", "…", "∞"], "why it is marginal"
    assert page.locator(".verdict-units a:visible").count() == 6
    assert Axe().run(page).response["violations"] == []
    page.emulate_media(media="print")
    assert page.locator(".verdict-units a:visible").count() == 0, "nobody clicks on paper"


@pytest.mark.parametrize(
    ("locale", "width"),
    [("en-GB", 360), ("uk-UA", 360), ("zh-CN", 360), ("uk-UA", 683), ("uk-UA", 865)],
)
def test_the_verdict_on_each_quantity_is_in_sight_without_scrolling_sideways(site, visitors, locale, width):
    page = visitors.come(site[0], size={"width": width, "height": 780}, locale=locale)
    unit = {"unit": "U-1", "run": "U-1/run", "verdict": "adequate", "sentence": "", "analysed": True, "limits": "PASS"}
    end = {"state": "done", "cause": "", "analysing": False, "units": [unit], "verdict": "adequate", "safe": True,
           "safe_state": [], "requests": []}  # fmt: skip
    run = {"run": "U-1/run", "runs": ["U-1/run"], "condition": "ended", "profile": "short", "ended": end}
    results = [
        {"name": "residual_peak_dph", "value": -1234.5, "low": -1300.25, "high": 1200.5, "unit": "deg/h",
         "lower": -1250.0, "upper": 1250.0, "reason": "", "verdict": word}
        for word in ("PASS", "MARGINAL", "FAIL", None)
    ]  # fmt: skip
    judged = {"limits": {"name": "short", "results": results}, "steps": {}, "segments": [], "losses": {}}
    page.route("**/api/v1/live/U-1/run", lambda route: route.fulfill(json=run))
    page.route("**/api/v1/runs/U-1/run", lambda route: route.fulfill(json=judged))
    page.goto("/verdict/U-1/run")
    page.get_by_role("table").wait_for()
    frame = page.locator(".verdict-reasons .scroll")
    assert frame.evaluate("(frame) => frame.scrollWidth - frame.clientWidth") == 0
    for row in page.locator(".verdict-reasons tr").all():
        quantity, verdict = (row.locator(f":scope > :{place}-child").bounding_box() for place in ("first", "last"))
        assert abs(verdict["y"] - quantity["y"]) < 2, "beside the quantity"
        assert verdict["x"] + verdict["width"] <= width
    page.emulate_media(media="print")
    page.set_viewport_size({"width": 718, "height": 1047})  # A4 between its margins
    assert frame.evaluate("(frame) => frame.scrollWidth - frame.clientWidth") == 0
    lines = "(rows) => rows.map((row) => new Set([...row.cells].map((cell) => cell.getBoundingClientRect().y)).size)"
    assert set(page.locator(".verdict-reasons tr").evaluate_all(lines)) == {1}, "a line of paper for each quantity"


@pytest.mark.parametrize(
    ("locale", "word", "choose"),
    [
        ("en", "MEASURED", "Choose limits and repeat"),
        ("uk", "ВИМІРЯНО", "Вибрати межі й повторити"),
        ("zh", "已测完", "选择限值并重做"),
    ],
)
def test_a_run_without_limits_says_so_and_where_they_are_chosen(site, visitors, locale, word, choose):
    page = visitors.come(site[0], locale=locale)
    unit = {"unit": "SIM-0001", "run": "SIM-0001/run", "verdict": "undecided", "sentence": "", "analysed": True,
            "limits": None}  # fmt: skip
    end = {"state": "done", "cause": "", "analysing": False, "units": [unit], "verdict": "undecided", "safe": True,
           "safe_state": [], "requests": []}  # fmt: skip
    run = {"run": "SIM-0001/run", "runs": ["SIM-0001/run"], "condition": "ended", "profile": "quick",
           "station": "simulated", "ended": end}  # fmt: skip
    page.route("**/api/v1/live/SIM-0001/run", lambda route: route.fulfill(json=run))
    page.goto("/verdict/SIM-0001/run")
    page.get_by_role("heading", name=word).wait_for()
    assert page.locator("article.tone-link").count() == 1, "neither good nor bad"
    page.get_by_role("link", name=choose).click()
    page.locator("#limits").wait_for()


def test_who_may_not_use_the_workbench_is_not_led_to_it(tmp_path, project, visitors):
    access = tmp_path / "access.yaml"
    tokens = {role: people.add_person(access, role, role) for role in ("operator", "engineer")}
    folder = ended(tmp_path / "out", "20261121T060000Z_ramp")
    (folder / "calibration.json").write_text(json.dumps({"verdict": {"verdict": "adequate", "sentence": "Good."}}))
    (folder / "report.html").write_text("")
    with bench_over(tmp_path / "out", project, "--access", str(access), token=tokens["engineer"]) as bench:
        for role, led in (("operator", 0), ("engineer", 2)):
            page = visitors.come(bench.site.address)
            page.goto(f"/verdict/SIM-0001/{folder.name}")
            page.get_by_label("Token").fill(tokens[role])
            page.keyboard.press("Enter")
            page.get_by_role("heading", name="ADEQUATE").wait_for()
            assert page.get_by_role("link", name=re.compile("workbench", re.IGNORECASE)).count() == led
            page.context.close()
