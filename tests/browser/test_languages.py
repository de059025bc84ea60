"""No sentence stays English on a Ukrainian or Chinese page, whoever wrote it: the page, the bench or its files."""

import json
import re
from urllib.parse import urlencode

import numpy as np
import pytest

from tests.support.bench_project import LONG, SLOW_UNIT, bench_over
from tests.support.run_folders import make_run, ramp_run
from tests.support.visiting import PATIENCE_MS, PHONE, english, picture
from tests.support.waiting import until

RUN = "GX-1/20261101T000000Z_ramp"
OPEN = "() => document.querySelectorAll('details').forEach((one) => (one.open = true))"


@pytest.fixture(scope="module")
def bench(tmp_path_factory, project):
    """A unit with a disturbance that no effect explains."""
    out = tmp_path_factory.mktemp("said")
    made = ramp_run(loop_dph=0.0)
    made["columns"]["rate"] = made["columns"]["rate"] + 0.4 * np.sin(2 * np.pi * made["columns"]["time"] / 1100.0)
    make_run(out / RUN, unit="GX-1", **made)
    with bench_over(out, project) as bench:
        yield bench


@pytest.fixture(params=["uk", "zh"])
def page(bench, visitors, request):
    return visitors.come(bench.site.address, locale=request.param)


def test_a_diagnosis_with_a_formula(page, request):
    page.goto(f"/workbench?run={RUN.replace('/', '%2F')}")
    page.locator(".wb-verdict").wait_for()
    page.locator(".wb-plot .main-svg").first.wait_for()
    page.locator(".wb-suspects code").first.wait_for()
    page.evaluate(OPEN)
    picture(page, f"languages-{request.node.name}", full_page=True)
    assert english(page) == []


def test_a_curve_that_is_too_stiff_is_replaced_on_a_telephone(page, request):
    page.set_viewport_size(PHONE)
    model = {"name": "line", "effects": [{"effect": "polynomial", "order": 1}]}
    page.goto(f"/workbench?{urlencode({'run': RUN, 'model': json.dumps(model)})}")
    suspect = page.locator(".wb-suspect").filter(has=page.locator("h4[title='effect: spline']"))
    suspect.get_by_role("button").last.wait_for(timeout=PATIENCE_MS)
    page.locator(".wb-suspect button.wb-link").first.wait_for()
    assert english(page) == []
    assert page.evaluate("() => document.documentElement.scrollWidth <= innerWidth")
    suspect.get_by_role("button").last.click()
    page.locator(".wb-fell").wait_for()
    assert page.locator(".wb-effects code").all_inner_texts() == ["spline"]


def test_a_name_in_a_formula_is_shown_as_it_was_typed(page):
    model = {"name": "m", "effects": [{"effect": "spline"}, {"effect": "expression", "formula": "a*lag(dT_dt, b)"}]}
    model["effects"][1]["bounds"] = {"b": [10, 1000]}
    page.goto(f"/workbench?{urlencode({'run': RUN, 'model': json.dumps(model)})}")
    assert page.locator(".wb-parameter").inner_text().startswith("b ")


def test_a_profile_that_cannot_run(page, request):
    page.goto("/files?kind=profiles&id=short")
    text = page.locator("textarea").first
    text.wait_for()
    before = text.input_value()
    page.locator(".findings li").first.wait_for()
    assert english(page) == []
    text.fill(before.replace("to_degc: 10", "to_degc: -90", 1))
    page.locator(".findings .tone-bad").first.wait_for()
    assert english(page) == []
    text.fill(before.replace("to_degc: 10", "to_degree: 10", 1).replace("duration_min: 6", "duration_min: yes"))
    page.locator(".findings li", has_text="to_degree").first.wait_for()
    picture(page, f"languages-{request.node.name}")
    assert english(page) == []


def test_the_check_before_a_run_and_before_a_calibration(page):
    for address in (
        f"unit={SLOW_UNIT}&station=unhurried&plan=ramp_-40_85",
        "unit=BARE-1&station=bare&calibration=brief",
    ):
        page.goto(f"/start?{address}")
        page.locator(".checked").wait_for()
        page.evaluate(OPEN)
        assert english(page) == []


def test_the_words_of_an_own_plan_stay_as_they_were_written(page):
    page.goto(f"/start?unit={SLOW_UNIT}&station=unhurried")
    page.get_by_text("Its first ramp begins after a minute; then it goes on for hours of bench time.").wait_for()


def test_an_import_of_an_unclear_table_and_of_none(page, tmp_path):
    table, none = tmp_path / "a.csv", tmp_path / "b.csv"
    table.write_text("t,T,gyro\n" + "".join(f"{i},{20 + i / 50},{i % 7}\n" for i in range(500)))
    none.write_text("one column\nof words\n")
    for file, there in ((none, ".notice.bad"), (table, "#understood")):
        page.goto("/import")
        page.locator("input[type=file]").set_input_files(str(file))
        page.locator(there).first.wait_for()
        assert english(page) == []


def test_a_live_run_that_is_held_and_its_abort(bench, visitors):
    run = bench.start(plan=LONG, station="unhurried", units=[SLOW_UNIT])
    bench.moving(run)
    half = visitors.come(bench.site.address, locale="uk", size={"width": 683, "height": 1000})
    half.goto(f"/live/{run}")
    half.get_by_role("button", name="Перервати").wait_for()
    row, abort = (half.locator(part).bounding_box() for part in (".actions-row", ".actions-row > :last-child"))
    assert abort["x"] + abort["width"] == pytest.approx(row["x"] + row["width"]), "at the end, also in a second row"
    half.close()
    bench.client.post(f"/live/{run}/hold", json={}).raise_for_status()
    until(lambda: bench.get(f"/live/{run}").get("holding"))
    pages = [visitors.come(bench.site.address, locale=locale) for locale in ("uk", "zh")]
    for page in pages:
        page.goto(f"/live/{run}")
        page.locator(".log li.request").first.wait_for()
        page.locator(".log li.hold").first.wait_for()
        held = page.locator(".log li.segment", has_text=re.compile("утримано|已保持")).first
        assert re.search("−30", held.inner_text()), "the segment by what it does"
        page.set_viewport_size({"width": 683, "height": 1000})
        tops = [page.locator(part).bounding_box()["y"] for part in ("aside .figures-grid", "aside .guards")]
        assert tops[0] == pytest.approx(tops[1]), "the guards, which are long, stand beside the others"
        picture(page, f"languages-live-{pages.index(page)}", full_page=True)
        assert english(page) == []
        page.goto(f"/start?unit={SLOW_UNIT}&station=unhurried&plan=ramp_-40_85")
        page.locator(".checked").wait_for()
        page.evaluate(OPEN)
        assert english(page) == [], "also while the station is in use"
    bench.end_runs()
    for page in pages:
        page.goto(f"/verdict/{run}")
        page.locator(".fault details summary").click()
        until(lambda page=page: page.locator(".spinner").count() == 0)
        until(lambda page=page: not re.search("engineer|from", page.locator(".fault").inner_text()))
        picture(page, f"languages-verdict-{pages.index(page)}", full_page=True)
        assert english(page) == []


def test_a_page_that_cannot_be_fetched(page, visitors):
    visitors.of(page).forgives = re.compile("ERR_FAILED")
    page.goto("/")
    page.locator("#serial").wait_for()
    asked = []
    page.route(re.compile("/static/fleet-"), lambda route: (asked.append(1), route.abort()))
    with page.expect_event("load"):  # the whole page once more, in case the server is a newer one
        page.locator("nav a[href='/fleet']").click()
    page.get_by_role("alert").wait_for()
    with page.expect_event("load"):
        page.get_by_role("alert").get_by_role("button").click()
    page.get_by_role("alert").wait_for()
    assert len(asked) == 3
    assert re.search(r"[a-z]{4}", page.get_by_role("alert").inner_text()) is None


def test_what_the_server_refuses(page, visitors):
    visitors.of(page).forgives = re.compile("status of 4")
    for address in ("/units/NOBODY", "/runs/NOBODY/20261101T000000Z_ramp", f"/runs/{RUN}"):
        page.goto(address)
        page.locator("h1, .notice").first.wait_for()
        page.locator(".spinner").first.wait_for(state="detached")
        assert english(page) == []
