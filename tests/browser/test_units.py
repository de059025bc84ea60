"""Units, fleet and imports in a real browser: found, looked at, opened, imported; by mouse and by keyboard."""

import json
import re
from datetime import datetime, timedelta
from itertools import pairwise
from zoneinfo import ZoneInfo

import numpy as np
import pyarrow.parquet as pq
import pytest

from bench.archive.fleet.figures import yields
from bench.commands import registry_rebuild
from bench.record import DiagnosisRecord
from tests.support.fleet_runs import BEGIN, line
from tests.support.servers import serving
from tests.support.unit_history import DAYS, PDF, UNIT, unit_with_history
from tests.support.visiting import picture
from tests.support.waiting import until


def fleet(out):
    unit_with_history(out)
    line(out, 48, odd=20)
    return out


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Runs of 49 units and the registry of them."""
    out = fleet(tmp_path_factory.mktemp("fleet"))
    registry_rebuild(out, None, False)
    return out


@pytest.fixture(scope="module")
def address(folder):
    with serving(folder) as found:
        yield found


@pytest.fixture
def page(visitors, address):
    """A window whose console errors fail the test."""
    return visitors.come(address, size={"width": 1280, "height": 900})


@pytest.fixture
def known(page, address):
    """Answer of the server for all units; another test may have imported one."""
    return page.context.request.get(f"{address}/api/v1/units").json()


@pytest.fixture
def unregistered(tmp_path):
    """The address of a server over the same runs without a registry; ended after the visitors' windows."""
    with serving(fleet(tmp_path)) as found:
        yield found


def test_the_registry_is_made_from_the_page_and_a_unit_is_found(unregistered, visitors):
    page = visitors.come(unregistered, size={"width": 1280, "height": 900})
    page.goto("/units")
    page.get_by_role("button", name="Build it from the run folders").click()
    page.get_by_role("link", name=UNIT).wait_for()
    page.get_by_role("searchbox").fill("gx 42")
    page.get_by_text("1 of 49 units").wait_for()
    assert "q=gx+42" in page.url, "the filter is in the address"
    page.get_by_role("link", name=UNIT).click()
    page.get_by_role("heading", name=UNIT).wait_for()


def test_a_unit_shows_which_calibration_counts_and_opens_its_certificate(page, address):
    page.goto(f"/units/{UNIT}")
    cards = page.locator(".st-card")
    cards.first.wait_for()
    assert cards.count() == 5
    assert "In the unit's memory" in cards.nth(2).inner_text()
    assert "Must not be used" in cards.nth(0).inner_text()
    link = cards.nth(2).get_by_role("link", name="Open certificate")
    assert page.request.get(address + link.get_attribute("href")).body() == PDF
    page.get_by_text("0x87323979").wait_for()


def test_a_trend_is_chosen_by_keyboard_and_drawn_with_its_limit(page):
    page.goto(f"/units/{UNIT}")
    page.get_by_text("upper limit").wait_for()
    page.get_by_role("button", name="Noise floor").press("Enter")
    page.get_by_role("group", name="Noise floor over 5 calibrated runs").wait_for()
    with page.expect_download() as download:
        page.get_by_role("button", name="Save the figure as CSV").click()
    assert "noise_floor" in download.value.suggested_filename


def test_the_calibration_of_a_unit_of_no_station_is_written_in_the_slot_that_is_chosen(page, visitors):
    page.goto(f"/units/{UNIT}")
    page.get_by_role("link", name="Deliver and check").first.click()
    page.get_by_text(f"No station file has a unit {UNIT}: choose the slot").wait_for()
    write = page.get_by_role("button", name="Write it into the unit")
    assert write.is_disabled()
    page.get_by_label("Station").select_option("Four units: Slot of SIM-0003")
    sent = []

    def refused(route):
        sent.append(route.request.post_data_json)
        route.fulfill(status=422, json={"detail": "in use"})

    page.route("**/flash", refused)
    visitors.of(page).forgives = re.compile("status of 422")
    write.click()
    page.get_by_text("in use").wait_for()
    assert (sent[0]["station"], sent[0]["slot"]) == ("four_units", f"{UNIT}@SIM-0003")


def test_the_slot_of_the_run_is_chosen_for_its_unit_and_can_be_changed(page):
    def in_slot(route):
        run = route.fetch().json()
        run["manifest"] |= {"station": "four-units", "gyro": {"layout": "", "bus": "can1", "number": 0}}
        route.fulfill(json=run)

    page.route(f"**/api/v1/runs/{UNIT}/2026*", in_slot)
    page.goto(f"/units/{UNIT}")
    page.get_by_role("link", name="Deliver and check").first.click()
    page.get_by_text("chosen is the slot that its run had").wait_for()
    station = page.get_by_label("Station")
    assert station.locator("option:checked").inner_text() == "Four units: Slot of SIM-0003"
    assert page.get_by_role("button", name="Write it into the unit").is_enabled()
    station.select_option("Four units: Slot of SIM-0002")
    assert station.locator("option:checked").inner_text() == "Four units: Slot of SIM-0002"


@pytest.mark.parametrize("verdict", [None, "undecided"])
def test_a_run_that_is_done_and_judged_by_nothing_says_so(page, verdict):
    def unjudged(route):
        unit = route.fetch().json()
        unit["runs"][0] |= {"judged": None, "verdict": verdict, "state": "done"}
        route.fulfill(json=unit)

    page.route(f"**/api/v1/units/{UNIT}?*", unjudged)
    page.goto(f"/units/{UNIT}")
    runs = page.locator("table").last.locator("tbody tr")
    assert runs.first.locator("td").nth(2).inner_text() == "Done"
    assert runs.first.locator("td").nth(2).locator(".tone-link").count() == 1, "no colour of a good one"


def test_a_figure_keeps_what_is_in_sight_when_it_speaks_another_language(page):
    page.goto(f"/units/{UNIT}")
    plot = page.locator(".st-plot")
    plot.locator(".main-svg").first.wait_for()
    plot.press("+")
    seen = "(plot) => JSON.stringify(plot.layout.xaxis.range)"
    until(lambda: plot.evaluate("(plot) => plot.layout.xaxis.autorange") is False)
    before = plot.evaluate(seen)
    page.locator(".bar select").select_option("uk")
    plot.get_by_text("верхня межа").wait_for()
    assert plot.evaluate(seen) == before


def test_a_trend_is_over_the_readers_time_as_the_list_of_runs(page):
    page.goto(f"/units/{UNIT}")
    page.locator(".st-plot .main-svg").first.wait_for()
    drawn = page.locator(".st-plot").evaluate("(plot) => [plot.data[0].x.at(-1), plot.layout.xaxis.title?.text ?? '']")
    run = page.request.get(f"/api/v1/units/{UNIT}").json()["runs"][0]
    here = datetime.fromisoformat(run["created"]).astimezone(ZoneInfo("Europe/Kyiv"))
    assert drawn == [f"{here:%Y-%m-%dT%H:%M:%S}.000", ""]


def test_the_fleet_names_the_odd_unit_and_leads_to_it(page):
    page.goto("/fleet?q=L")
    page.get_by_text("Different from their lot:").wait_for()
    page.get_by_text("Each unit counts once, by its newest judged run").wait_for()
    assert page.get_by_label("Plan").locator("option").first.inner_text() == "the one most units ran: ramp"
    page.get_by_role("group", name="Angle random walk of 48 units").wait_for()
    page.locator(".main-svg").first.wait_for()
    page.locator(".st-attention").get_by_role("link", name="L0-0020").click()
    page.get_by_role("heading", name="L0-0020").wait_for()


@pytest.mark.parametrize("wanted", ["q=nobody&station=station-A&since=2026-03-01", "limits=nothing"])
def test_a_filter_that_matches_nothing_is_cleared(visitors, page, wanted):
    visitors.of(page).forgives = re.compile("status of 404")  # limits that no file has
    page.goto(f"/fleet?{wanted}")
    page.get_by_role("button", name="Clear the filter").press("Enter")
    page.locator(".st-tiles").wait_for()
    assert not page.url.partition("?")[2]
    assert not any(field.input_value() for field in page.locator(".st-filter").locator("input, select").all())


@pytest.mark.parametrize(
    ("locale", "listed"), [("en", "With rate table, Ring-laser gyro"), ("zh", "现有：光纤陀螺，惯性单元")]
)
def test_limits_that_are_not_there_are_answered_with_the_names_of_the_others(visitors, address, locale, listed):
    page = visitors.come(address, locale=locale)
    visitors.of(page).forgives = re.compile("status of 404")
    page.goto("/fleet?limits=nothing")
    page.get_by_role("alert").get_by_text(listed).wait_for()
    assert "rate_table" not in page.get_by_role("alert").inner_text()


def test_every_point_of_a_chart_is_reached_by_keyboard_with_its_unit_value_and_day(page):
    page.goto("/fleet?q=L")
    page.get_by_role("group", name="Angle random walk of 48 units").wait_for()
    points = page.locator("details", has_text="48 points").first
    points.locator("summary").press("Enter")
    row = points.get_by_role("row").filter(has_text="L0-0005")
    assert re.search(r"L0-0005 · .* · 2026-\d\d-\d\d UTC\s+\S*\d", row.inner_text())
    distances = page.get_by_role("region", name="Distance of each unit from its lot")
    distances.get_by_text("48 points").press("Enter")
    assert distances.get_by_role("row", name=re.compile("L[01]-")).count() == 48, "of both lots"
    row.get_by_role("link").press("Enter")
    page.wait_for_url("**/verdict/L0-0005/**")
    page.goto(f"/units/{UNIT}")
    page.locator(".main-svg").first.wait_for()
    trend = page.locator("#trends ~ * details").first
    trend.locator("summary").press("Enter")
    assert re.search(r"2026.*\s+\S*\d", trend.get_by_role("row").nth(1).inner_text())


DATES_APART = """(figure) => {
  const at = [...figure.querySelectorAll(".xtick text")].map((date) => date.getBoundingClientRect());
  const narrow = figure.querySelector(".main-svg").clientWidth < 390;
  return narrow && at.length > 1 && at.every(({ left }, i) => !i || left > at[i - 1].right);
}"""


def test_the_yield_over_time_is_drawn_and_no_limits_are_asked_for_that_were_chosen(page):
    passed = np.arange(48) % 9 > 0
    chart = {"name": "yield", "figure": yields(np.arange(48) * 2e4, passed), "histogram": None, "units": [], "runs": [],
             "signals": [], "all": 48}  # fmt: skip
    alone = chart | {"figure": yields(np.array([2e4]), passed[:1]), "all": 1}

    def judged(route):
        answer = route.fetch()
        fleet = answer.json()
        fleet["yield"] = {"judged": 48, "first": 42, "final": 42, "interval": [0.75, 0.94], "first_pass": 0.875}
        for one in fleet.get("quantities", []):  # it is being counted at first
            one["capability"] = {"cpk": None, "cpk_interval": [None, None], "ppk": 0.6, "outside": 1}
        route.fulfill(response=answer, json=fleet)

    page.route("**/api/v1/fleet?*", judged)
    page.route("**/api/v1/fleet/charts/yield?*", lambda route: route.fulfill(json=chart))
    page.goto("/fleet?q=L")
    drawn = page.get_by_role("group", name="First-pass yield of 48 judged units")
    drawn.locator(".scatterlayer .points path").first.wait_for()
    page.set_viewport_size({"width": 390, "height": 844})
    page.wait_for_function(DATES_APART, arg=drawn.element_handle())
    page.set_viewport_size({"width": 1366, "height": 768})
    assert page.locator(".st-tile", has_text="Least Cpk").get_by_text("far from normal").count() == 1
    page.route("**/api/v1/fleet/charts/yield?*", lambda route: route.fulfill(json=alone))
    page.goto("/fleet?q=L")
    drawn = page.get_by_role("group", name="First-pass yield of 1 judged unit by")
    drawn.locator(".xtick text").first.wait_for()
    assert all(re.fullmatch(r"19(69|70)-\d\d-\d\d", text) for text in drawn.locator(".xtick text").all_text_contents())


def test_what_needs_attention_is_named_and_a_station_that_drifts_not_again_for_its_shift(page):
    drift = {"kind": "station", "place": "station-B", "quantity": "noise_floor_dph", "change": 0.001, "error": 0.0001,
             "p": 0.001, "count": 20, "unit": "deg/h"}  # fmt: skip
    shifts = [{"place": place, "quantity": "noise_floor_dph", "chart": "cusum", "change": 0.005, "since": "L0-0020",
               "since_created": "2026-04-09T04:48:00+00:00", "unit": "L0-0030", "before": 20, "count": 9,
               "unit_of_value": "deg/h"} for place in ("station-A", "station-B")]  # fmt: skip

    def moved(route):
        answer = route.fetch()
        fleet = answer.json()
        fleet |= {"drifts": [drift], "shifts": shifts}
        units = {"outside": 1, "outside_units": ["L0-0003"], "unjudged": 8,
                 "unjudged_units": [f"L1-004{n}" for n in range(6)], "later": 1,
                 "later_runs": [{"unit": "L0-0007", "run": "L0-0007/20260309T000000Z_ramp"}]}  # fmt: skip
        moving = {"stations": ["station-B"], "shifted": shifts[:1]}
        fleet.setdefault("attention", {}).update(moving | units)  # it is being counted at first
        route.fulfill(response=answer, json=fleet)

    page.route("**/api/v1/fleet?*", moved)
    page.goto("/fleet?q=L")
    lines = page.locator(".st-attention li")
    lines.filter(has_text=re.compile("^Drifting stations: station-B$")).wait_for()
    lines.filter(
        has_text=re.compile(r"^Shifted stations: station-A \(Noise floor \+0\.00500 deg/h since Apr\s9,\s2026\)$")
    ).wait_for()
    lines.filter(has_text="8 units are not judged").filter(has_text="L1-0045 and 2 more").wait_for()
    newer = lines.filter(has_text="The newest run of 1 unit is not judged").get_by_role("link", name="L0-0007")
    assert newer.get_attribute("href") == "/verdict/L0-0007/20260309T000000Z_ramp"
    lines.get_by_role("link", name="L0-0003").click()
    page.wait_for_url("**/units/L0-0003")


def test_a_newer_run_that_was_not_judged_is_told_beside_the_verdict_of_the_unit(page):
    def newer(route):
        answer = route.fetch()
        units = answer.json()
        units["units"][0] |= {"standing": "pass", "unjudged": "L0-0007/20260309T000000Z_ramp"}
        route.fulfill(response=answer, json=units)

    page.route("**/api/v1/units?*", newer)
    page.goto("/units")
    told = page.locator("tbody tr").first
    told.get_by_text("Pass").wait_for()
    told.get_by_role("link", name="newest run not judged").click()
    page.wait_for_url("**/verdict/L0-0007/20260309T000000Z_ramp")


def test_a_shift_of_a_station_has_its_day_and_what_no_cpk_is_known_of_has_none(page):
    shift = {"place": "station-B", "quantity": "noise_floor_dph", "chart": "cusum", "change": 0.005, "since": "L0-0020",
             "since_created": "2026-04-09T04:48:00+00:00", "unit": "L0-0030", "before": 20, "count": 9,
             "unit_of_value": "deg/h"}  # fmt: skip

    def shifted(route):
        answer = route.fetch()
        fleet = answer.json() | {"shifts": [shift]}
        for one in fleet.get("quantities", []):  # it is being counted at first
            one["capability"] = {"cpk": None, "cpk_interval": [None, None], "ppk": 0.6, "outside": 1}
        route.fulfill(response=answer, json=fleet)

    page.route("**/api/v1/fleet?*", shifted)
    page.goto("/fleet?q=L")
    page.get_by_role("row", name="station-B").get_by_text("since Apr 9, 2026").wait_for()
    cells = page.locator(".st-quantities tbody tr").first.get_by_role("cell").all_inner_texts()
    assert cells[4] == "–", "no interval of nothing"


@pytest.mark.parametrize("width", [390, 683])
def test_the_capability_of_a_fleet_is_in_sight_and_the_words_of_a_chart_stand_beside_its_curve(page, width):
    page.set_viewport_size({"width": width, "height": 900})
    page.goto("/fleet?q=L&limits=vibratory")
    page.locator(".bar select").select_option("uk")
    drawn = page.get_by_role("group", name="Випадкове блукання кута: 48 виробів")
    drawn.get_by_text("центр").wait_for()
    table = page.locator(".st-quantities")
    assert table.evaluate("(one) => one.parentElement.scrollWidth - one.parentElement.clientWidth") <= 1
    curve, whole = drawn.locator(".nsewdrag").first.bounding_box(), drawn.bounding_box()
    words = [one.bounding_box() for one in drawn.locator(".annotation-text-g").all()]
    assert len(words) >= 4
    assert all(word["x"] >= curve["x"] + curve["width"] for word in words)
    assert all(word["x"] + word["width"] <= whole["x"] + whole["width"] for word in words)
    heights = sorted((word["y"], word["height"]) for word in words)
    assert all(above + height <= below for (above, height), (below, _) in pairwise(heights))


def test_a_point_of_a_chart_is_named_and_opens_its_run(page):
    page.goto("/fleet?q=L")
    page.get_by_role("button", name="Angle random walk").click()
    drawn = page.get_by_role("group", name="Angle random walk of 48 units")
    drawn.locator(".legend", has_text=re.compile("station-A.*station-B")).wait_for()
    dots = [drawn.locator(".scatterlayer .trace").nth(n).locator(".points path") for n in (1, 2)]
    point = dots[1].nth(2)  # L0-0005 breaks no rule
    point.wait_for()
    fills = [station.first.evaluate("(dot) => getComputedStyle(dot).fill") for station in dots]
    assert fills[0] != fills[1], "a colour for each station"
    drawn.scroll_into_view_if_needed()
    box = point.bounding_box()
    page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    drawn.locator(".hovertext", has_text="L0-0005 · L0 · station-B").first.wait_for()
    page.mouse.down()
    page.mouse.up()
    page.wait_for_url("**/verdict/L0-0005/*")


def test_a_point_is_named_in_the_readers_language(page):
    def without_lot(route):
        chart = route.fetch().json()
        chart["figure"]["data"][0]["text"][5] = "L0-0005 · no lot · unknown · 2026-03-02 UTC"
        route.fulfill(json=chart)

    page.route("**/api/v1/fleet/charts/angle_random_walk_dprh?*", without_lot)
    page.goto("/fleet?q=L")
    page.locator(".bar select").select_option("uk")
    drawn = page.get_by_role("group", name="Випадкове блукання кута: 48")
    drawn.locator(".main-svg").first.wait_for()
    said = "L0-0005 · без партії · стенд не названо · 2026-03-02 UTC"
    assert drawn.evaluate("(plot) => plot.data[0].text[5]") == said
    assert page.get_by_text(said).count() == 1, "in the table beside it, too"


def table(path):
    time = np.arange(2000) * 2.0
    temperature = 25 + 50 * np.sin(2 * np.pi * time / time[-1])
    rate = (3 + 0.02 * temperature) / 3600
    rows = zip(time, rate, temperature, strict=True)
    path.write_text("t [s],gx,T (degC),=1+1\n" + "".join(f"{a},{b:.8f},{c:.4f},7\n" for a, b, c in rows))
    return path


def offered(page, path):
    """Give a file to the page of the import."""
    page.goto("/import")
    page.locator("input[type=file]").set_input_files(str(path))


def test_a_table_is_dropped_put_right_and_imported(page, tmp_path, folder):
    offered(page, table(tmp_path / "лог 7.csv"))
    page.get_by_text("does not say its unit").wait_for()
    assert page.get_by_label("Column of: Rate (gyro output)", exact=True).input_value() == "gx", (
        "what is clear is chosen already"
    )
    unit = page.get_by_label("Unit of: Rate (gyro output)", exact=True)
    unit.fill("deg/s")
    unit.press("Tab")
    page.get_by_text("Everything that is needed was recognised").wait_for()
    page.get_by_role("button", name="+ =1+1").click()
    further = page.get_by_label("Column of: Further quantity 1", exact=True)
    assert further.input_value() == "=1+1"
    page.get_by_text("Not used:").wait_for(state="detached")
    page.locator(".main-svg").first.wait_for()
    serial = page.get_by_label("Serial number of the unit")
    serial.fill("../escape")
    assert page.get_by_role("button", name="Import").is_disabled()
    serial.fill("IMP-7")
    serial.press("Enter")
    page.get_by_role("heading", name="Imported").wait_for()
    made = json.loads(next(folder.glob("IMP-7/*/manifest.json")).read_text())
    assert made["rows"] == 2000
    assert "other_1" in pq.read_schema(next(folder.glob("IMP-7/*/data.parquet"))).names
    page.get_by_role("link", name="History of IMP-7").click()
    page.get_by_role("cell", name="Import", exact=True).wait_for()
    page.get_by_role("cell", name="Import: лог 7").wait_for()


def test_a_label_that_was_scanned_twice_is_asked_about_before_an_import(page, tmp_path, folder):
    rows = "".join(f"{t},{25 + t / 100},{t % 7}\n" for t in range(500))
    (tmp_path / "run.csv").write_text(f"time [s],temperature [degC],rate [deg/h]\n{rows}")
    offered(page, tmp_path / "run.csv")
    page.get_by_label("Serial number of the unit").fill("GX-7GX-7")
    page.keyboard.press("Enter")
    page.get_by_role("button", name="GX-7", exact=True).press("Enter")
    page.get_by_role("heading", name="Imported").and_(page.locator(":focus")).wait_for()
    assert list(folder.glob("GX-7/*/manifest.json"))
    assert not list(folder.glob("GX-7GX-7/*"))


def test_the_first_values_of_a_long_time_differ(page, tmp_path):
    rows = [f"{1_700_000 - i},{25 + 0.01 * i},{5 + 0.1 * (i % 7)}" for i in range(500)]
    (tmp_path / "old.csv").write_text("\n".join(["time [s],temperature [degC],rate [deg/h]", *rows]))
    offered(page, tmp_path / "old.csv")
    page.get_by_text("1,700,000, 1,699,999, 1,699,998").wait_for()


def test_how_a_table_was_read_is_no_warning_and_time_has_a_range(page, tmp_path):
    path = tmp_path / "commas.csv"
    rows = "".join(f"{i};{5 + i % 7},5;{20 + i // 100},25\n" for i in range(4000))
    path.write_text(f"time [s];rate [deg/h];temperature [degC]\n{rows}")
    offered(page, path)
    page.get_by_text("Its decimal commas were read as points").wait_for()
    assert page.locator(".notice.warn", has_text="decimal commas").count() == 0
    time = page.get_by_role("row").filter(has=page.get_by_label("Column of: Time", exact=True))
    time.get_by_text("0 … 3999 s (1 h 07 min)").wait_for()


def test_the_step_of_a_table_has_the_unit_of_the_language(visitors, address, tmp_path):
    path = tmp_path / "zh.csv"
    path.write_text("t [s],rate [deg/h],T [degC]\n" + "".join(f"{i},{i % 7},{20 + i / 50}\n" for i in range(4000)))
    page = visitors.come(address, locale="zh-CN")
    offered(page, path)
    assert page.get_by_text("一行。").inner_text().endswith("，每1秒一行。")


def test_rows_that_are_counted_get_their_time_from_the_step_of_a_sample(page, tmp_path):
    path = tmp_path / "counted.csv"
    rows = "".join(f"{i},{i % 3},{i % 5},1,{20 + i / 100}\n" for i in range(400))
    path.write_text(f"sample,gx_dph,gy_dph,gz_dph,temp_C\n{rows}")
    offered(page, path)
    page.get_by_text("counts samples, and nothing says how long one takes").wait_for()
    time = page.get_by_label("Column of: Time", exact=True)
    time.select_option("sample")
    page.get_by_text("counts samples, and nothing says how long one takes").wait_for()
    unit = page.get_by_label("Unit of: Time", exact=True)
    unit.fill("5 Hz")
    unit.press("Tab")
    page.get_by_text("400 rows over 1 min 20 s, one every 0.2").wait_for()
    assert unit.input_value() == "5 Hz"
    assert not page.get_by_label("Column of: Rate (gyro output)", exact=True).is_visible(), "three axes are enough"
    page.get_by_text("Rate (gyro output) y").first.wait_for()


def test_what_is_no_table_is_refused_in_a_line_and_another_may_be_tried(page, tmp_path):
    bad = tmp_path / "bomb.parquet"
    bad.write_bytes(b"PAR1" + b"\xff" * 100 + b"PAR1")
    offered(page, bad)
    assert "not a readable Parquet file" in page.get_by_role("alert").inner_text()
    page.get_by_role("button", name="Choose a file").wait_for()
    until(lambda: bad.name not in page.request.get("/api/v1/imports").text())


LINES = """(one) => {
  const range = document.createRange(), text = document.createTreeWalker(one, NodeFilter.SHOW_TEXT).nextNode();
  const lines = new Map();
  [...text.data].forEach((sign, at) => {
    range.setStart(text, at);
    range.setEnd(text, at + 1);
    const top = range.getBoundingClientRect().top;
    lines.set(top, (lines.get(top) ?? "") + sign);
  });
  return [...lines.values()].map((line) => line.replace(/[\\s\u200b]+/g, " ").trim()).filter(Boolean);
}"""
"""The text of an element, line by line."""


@pytest.mark.parametrize("language", ["uk", "zh"])
def test_the_pages_speak_other_languages(page, language):
    page.goto("/units")
    page.locator(".bar select").select_option(language)
    page.get_by_role("heading", name={"uk": "Вироби", "zh": "产品"}[language]).wait_for()
    page.goto(f"/units/{UNIT}")
    page.get_by_text({"uk": "Чинне калібрування", "zh": "有效标定"}[language]).first.wait_for()
    page.set_viewport_size({"width": 683, "height": 900})
    day = page.locator(".st-tile b").first
    assert day.evaluate(LINES)[-1] in {"19 лип. 2026 р.", "2026 р.", "7月19日", "2026年7月19日"}, (
        "not broken within a part"
    )
    signs = "".join(page.locator(".st-tile .more").all_inner_texts())
    assert ("；" in signs, "; " in signs) == (language == "zh", language == "uk"), "each language has its own signs"


def test_what_leads_from_a_run_is_in_sight_on_half_a_window_in_the_longest_language(page):
    page.set_viewport_size({"width": 683, "height": 900})
    page.goto(f"/units/{UNIT}")
    page.locator(".bar select").select_option("uk")
    report = page.locator("table.lines").get_by_role("link", name="Звіт").first
    report.wait_for()
    box = report.bounding_box()
    assert box["x"] + box["width"] < 683


@pytest.mark.parametrize("width", [683, 1280, 1920])
def test_the_limits_of_the_trends_are_in_sight(page, width):
    page.set_viewport_size({"width": width, "height": 900})
    page.goto(f"/units/{UNIT}")
    page.locator(".bar select").select_option("uk")
    page.locator(".main-svg").first.wait_for()
    table = page.get_by_role("region", name="Величина")
    assert table.evaluate("(one) => one.scrollWidth - one.clientWidth") <= 1


def test_the_columns_of_the_list_of_units_stand_below_their_heads_on_half_a_window(page):
    page.set_viewport_size({"width": 683, "height": 900})
    page.goto("/units")
    page.locator("table a").first.wait_for()
    ends = page.locator("table.lines tr").evaluate_all(
        "(rows) => rows.map((row) => [...row.cells].filter((cell) => cell.offsetWidth).map((cell) => {"
        " const box = cell.getBoundingClientRect(); return Math.round(box.right); }).at(1))"
    )
    assert len(set(ends)) == 1, "whatever stands before them"


def test_a_long_history_is_drawn_in_parts(page):
    """A unit of 5000 runs took 12 s and 178,000 nodes, and its answer 6 MB."""

    def long(route):
        told, most = route.fetch().json(), int(route.request.url.partition("most=")[2])
        for part in ("runs", "calibrations"):
            told[part] = [{**told[part][0], "run": f"{UNIT}/{n}"} for n in range(min(most, 250))]
            told["of"][part] = 250
        route.fulfill(json=told)

    page.route(f"**/api/v1/units/{UNIT}?most=*", long)
    page.goto(f"/units/{UNIT}")
    rows, cards = page.locator("section[aria-labelledby=runs] tbody tr"), page.locator(".st-card")
    rows.first.wait_for()
    assert (rows.count(), cards.count()) == (100, 20)
    more = page.locator("section[aria-labelledby=runs]").get_by_role("button", name="Show more")
    for shown in (200, 250):
        more.click()
        rows.nth(shown - 1).wait_for()
    assert (rows.count(), more.count()) == (250, 0)
    page.unroute_all(behavior="wait")


def test_more_units_than_can_be_listed_are_searched_for(page, known):
    """The button did nothing."""
    page.route("**/api/v1/units?*", lambda route: route.fulfill(json={**known, "matched": 5001, "total": 5001}))
    page.goto("/units")
    more = page.get_by_role("button", name="Show more")
    for listed in (400, 600, 800, 1000):
        with page.expect_request(f"**/api/v1/units?*limit={listed}*"):
            more.click()
    more.wait_for(state="detached")
    page.get_by_text(f"Only the first {len(known['units'])} are listed. Search for others.").wait_for()


FIRST_ANSWER = """() => {
  const fetched = window.fetch;
  let first = true;
  window.fetch = async (path, options) => {
    const answer = await fetched(path, options);
    if (!String(path).includes("/units?") || !first) return answer;
    first = false;
    answer.json = () => new Promise((_, fail) => { HOW });
    return answer;
  };
}"""


def test_an_answer_that_is_cut_off_is_told(page, known):
    """The page waited for ever, without a word."""
    page.add_init_script(f"({FIRST_ANSWER.replace('HOW', 'fail(new TypeError())')})()")
    page.goto("/units")
    page.get_by_role("alert").get_by_text("The server does not answer").wait_for()
    page.get_by_role("button", name="Try again").click()
    page.get_by_text(f"{known['total']} of {known['total']} units").wait_for()


def test_an_answer_that_is_no_longer_wanted_takes_nothing_off_the_page(page, known):
    """The list of units vanished while it was searched."""
    how = 'options.signal.addEventListener("abort", () => fail(new DOMException("", "AbortError")))'
    page.goto("/units")
    page.get_by_text(f"{known['total']} of {known['total']} units").wait_for()
    page.evaluate(FIRST_ANSWER.replace("HOW", how))
    held = []

    def hold(route):
        held.append(route)

    with page.expect_response("**/api/v1/units?*q=gx&*"):
        page.get_by_role("searchbox").fill("gx")
    page.route("**/api/v1/units?*q=gx+42&*", hold)
    with page.expect_request("**/api/v1/units?*q=gx+42&*"):
        page.get_by_role("searchbox").fill("gx 42")
    page.get_by_text(f"{known['total']} of {known['total']} units").wait_for()
    held[0].continue_()
    page.get_by_text(f"1 of {known['total']} units").wait_for()


def test_a_day_is_not_broken_within_a_number(visitors, address):
    page = visitors.come(address, locale="uk-UA", size={"width": 820, "height": 1180})
    page.goto("/fleet")
    day = page.locator(".st-tile b").last
    day.wait_for()
    assert day.evaluate("(one) => one.scrollWidth <= one.clientWidth")
    assert "\u00a0" not in day.inner_text()


def test_every_tile_of_a_unit_names_the_run_that_it_is_of(page, folder):
    days = [f"{BEGIN + timedelta(days=day):%b\xa0%-d,\xa0%Y}, " for day in DAYS]
    page.goto(f"/units/{UNIT}")
    tiles = page.locator(".st-tiles > *")
    tiles.first.wait_for()
    told = tiles.all_inner_texts()[:3]
    assert [text for text in told if not any(f"Calibration, −40 to 85\xa0°C · {day}" in text for day in days)] == []


def test_the_fleet_page_shows_what_models_lack_by_lot(tmp_path, visitors):
    out = fleet(tmp_path)
    for run in sorted(out.glob("L0-*/*"))[:5]:
        suspects = [{"effect": "thermal_lag", "found": True, "proved": True}]
        content = {
            "format": 1,
            "verdict": "missing_effect",
            "model": "spline",
            "runs": [run.name],
            "suspects": suspects,
        }
        DiagnosisRecord.model_validate(content).write(run)
    registry_rebuild(out, None, False)
    with serving(out) as address:
        page = visitors.come(address, size={"width": 1366, "height": 768})
        page.goto("/fleet?q=L0")
        table = page.get_by_role("region", name="What models lack, by lot").last
        table.wait_for()
        assert table.get_by_role("row", name="Thermal lag").locator("td").first.inner_text() == "5"
        table.scroll_into_view_if_needed()
        picture(page, "fleet-lacks")
        page.get_by_role("button", name="Diagnose the units that were not yet").click()
        page.locator(".findings li", has_text="L0-").first.wait_for()
        page.goto("/fleet?until=2026-03-02")
        page.get_by_text("Too few units to test: a station needs eight").wait_for()
        assert page.get_by_text("No station drifts").count() == 0
        page.context.close()
