"""A new gyro from the start page to its certificate in a real browser, without any file edited by hand."""

import json
import os
import re
import signal
import subprocess
import sys

import numpy as np
import pytest
from axe_playwright_python.sync_playwright import Axe

from bench.base import library
from bench.commands import STEP_NAMES, JobFile, Order
from tests.browser.test_operator import press_tab_to
from tests.support import bench_project
from tests.support.bench_project import LONG, SLOW_UNIT, bench_over
from tests.support.commands import bench as command
from tests.support.hidden_runs import HiddenUnit
from tests.support.visiting import PATIENCE_MS, PHONE, TABLET, day_and_night, english, picture
from tests.support.waiting import until


@pytest.fixture
def bench(tmp_path):
    """With a folder of its own: what is filled in on a form stays there."""
    with bench_over(tmp_path / "out", bench_project.made(tmp_path / "project")) as bench:
        yield bench


def fill_in_papers(page, press, touch):
    """What certificates name, on the page's forms."""

    def write(field, text, keys=None):
        if touch:
            field.fill(text)
        else:
            press_tab_to(page, field)
            page.keyboard.type(keys or text)

    for label, text in (("Laboratory", "Laboratory of tests"), ("Who signs", "Olha Koval")):
        write(page.locator("#laboratory ~ fieldset .papers-fields").get_by_label(label), text)
    press(page, page.get_by_role("button", name="Save Laboratory"))
    page.get_by_text("Saved.").wait_for()
    tool = page.locator("fieldset")
    write(tool.get_by_label("Instrument ("), "chamber sensor")
    write(tool.get_by_label("Serial number"), "P-1")
    write(tool.get_by_label("Valid until"), "2999-12-31", "12312999")
    write(tool.get_by_label("Uncertainty (k = 2)"), "0,1")
    unit = tool.get_by_label("Unit of the uncertainty")
    if touch:
        unit.select_option("degC")
    else:
        press_tab_to(page, unit)
        page.keyboard.press("ArrowDown")
    with page.expect_request(lambda request: request.method == "PUT") as asked:
        press(page, page.get_by_role("button", name="Save Reference equipment"))
    (tool,) = asked.value.post_data_json["content"]["equipment"]
    assert (tool["due"], tool["uncertainty"]) == ("2999-12-31", [{"value": 0.1, "unit": "degC"}])
    page.get_by_text("Saved.").nth(1).wait_for()


def enter(page, target):
    """Go to `target` by keyboard and press it."""
    target.wait_for()
    press_tab_to(page, target)
    page.keyboard.press("Enter")


def tap(page, target):
    """Touch `target`."""
    target.tap()


def choose(page, press, touch):
    """From a serial number that no station has to the confirmation."""
    page.goto("/")
    page.get_by_label("Serial number").wait_for()
    page.keyboard.type("GX-0815")
    page.get_by_role("button", name="Next").tap() if touch else page.keyboard.press("Enter")
    slot = page.get_by_role("button", name="Slot of BARE-1")
    slot.wait_for()
    picture(page, "new-unit")
    press(page, slot)
    plan = page.get_by_role("button", name=re.compile("^brief.*The whole way"))
    plan.wait_for()
    picture(page, "plans-calibrations")
    press(page, plan)


RIPPLE = (
    "identity: 1, simulation: {truth: [{mechanism: static_bias, coefficients_dph: [4, 1.5, -2, -0.8, 0.9]}, "
    "{mechanism: etalon, amplitude_dph: 3}]}"
)


def hidden_ripple(project, out):
    """The unit of the bare station has interference over temperature, as a run that was imported from it shows."""
    station = project / "profiles" / "stations" / "bare.yaml"
    station.write_text(station.read_text().replace("identity: 1", RIPPLE))
    run = HiddenUnit(({"mechanism": "etalon", "amplitude_dph": 3.0},), 1.0).run("short")
    table = np.column_stack([run.time, run.channel("rate"), run.channel("temperature")])
    log = project / "log.csv"
    np.savetxt(log, table, "%.6f", ",", header="time_s,rate_dph,temperature_degc", comments="")
    assert command("import", log, "--unit", "RIPPLED", "--out", out).exit_code == 0


def take_the_formula(page):
    """From the formula that the diagnosis offers to a calibration plan with it, by clicks; the name is typed."""
    page.goto("/workbench?model=polynomial")
    page.get_by_role("combobox", name="Find a run").fill("RIPPLED")
    page.locator("[role=option]", has_text="RIPPLED").click()
    page.locator(".wb-model select option:checked", has_text="polynomial").wait_for(state="attached")
    page.get_by_role("button", name=re.compile(r"^Add k \* sin\(2\*pi\*temperature")).click()
    page.locator(".wb-fell").wait_for()
    page.get_by_label("Save as model").fill("інтерференція")
    page.get_by_role("button", name="Save", exact=True).and_(page.locator(".wb-save button")).click()
    picture(page, "workbench-formula-saved")
    page.get_by_role("link", name="Name it in a calibration plan").click()
    page.get_by_label("File", exact=True).select_option("brief")
    text = page.get_by_label("Text of the file")
    text.wait_for()
    text.fill(text.input_value().replace("[polynomial]", "[інтерференція]"))
    page.get_by_role("button", name="Save", exact=True).click()
    page.get_by_role("status").get_by_text("Saved", exact=True).wait_for()


def begin(page, touch):
    """From the start page to the calibration's run, by way of the forms that its certificate needs."""
    press = tap if touch else enter
    choose(page, press, touch)
    page.locator("#check").get_by_text("no laboratory and no signatory").wait_for()
    picture(page, "ready-calibration-refused")
    press(page, page.get_by_role("link", name="Laboratory and equipment"))
    page.get_by_role("heading", name="Reference equipment").wait_for()
    fill_in_papers(page, press, touch)
    picture(page, "laboratory", full_page=True)
    press(page, page.get_by_role("link", name="Start", exact=True))
    operator = page.get_by_label("Operator")
    operator.wait_for()
    operator.tap() if touch else press_tab_to(page, operator)
    page.keyboard.type("Olena")
    page.locator("button.giant:enabled").wait_for()
    picture(page, "ready-calibration")
    press(page, page.locator("button.giant"))
    page.wait_for_url("**/calibrations/GX-0815/*")
    page.get_by_role("heading", name="Calibration run").wait_for()
    page.get_by_role("progressbar").wait_for()


def print_certificate(page, bench, press, path):
    """Print the certificate of the calibration that the page shows, when it is there, and check it."""
    printed = page.get_by_role("link", name="Print the certificate")
    printed.wait_for(timeout=2 * PATIENCE_MS)
    picture(page, f"calibration-done-{press.__name__}")
    page.get_by_text("Signed by: Simulated laboratory (certifies nothing)").wait_for()
    with page.context.expect_page():
        press(page, printed)
    pdf = page.request.get(bench.site.address + printed.get_attribute("href"))
    path.write_bytes(pdf.body())
    verify = ("-P", "-c", "from bench.cli import main; main()", "certificate", "--verify", path)
    checked = subprocess.run((sys.executable, *verify), check=False, capture_output=True, text=True)
    assert checked.returncode == 0, checked.stdout
    assert (pdf.headers["content-disposition"].partition(";")[0], pdf.body()[:5]) == ("inline", b"%PDF-")


@pytest.mark.slow
def test_a_new_gyro_goes_to_its_signed_certificate_by_keyboard_alone(bench, visitors, tmp_path):
    """With a formula that the diagnosis of another unit offered, without which this one would fail."""
    hidden_ripple(tmp_path / "project", bench.out)
    page = visitors.come(bench.site.address)
    take_the_formula(page)
    begin(page, touch=False)
    picture(page, "calibration")
    print_certificate(page, bench, enter, tmp_path / "printed.pdf")
    assert page.locator(".job-steps [lang=en]").all_inner_texts() == []
    assert page.locator(".job-steps .warning").first.bounding_box()["width"] > 200
    job = page.url.partition("/calibrations/")[2]
    told = json.loads((bench.out / job / "job.json").read_text())
    assert (told["unit"], told["verdict"]) == ("GX-0815", "PASS")
    for language in ("uk", "zh"):
        page.locator(".bar select").select_option(language)
        page.locator(f"html[lang|={language}]").wait_for()
        assert english(page) == []
    run = bench.out / "GX-0815" / told["steps"]["run"]["facts"]["run"]
    assert json.loads((run / "manifest.json").read_text())["operator"].startswith("Olena ")


def test_a_calibration_that_is_running_is_not_one_that_start_goes_on_with(site, visitors):
    address, out = site
    plan, station = (library() / name for name in ("plans/quick.yaml", "stations/simulated.yaml"))
    order = Order.load(plan, station, "GX-7@SIM-0001", out)
    page = visitors.come(address)
    with JobFile.create(out / "GX-7", order.serial, "quick", order.digest()).locked():
        page.goto("/start?unit=GX-7@SIM-0001&station=simulated&calibration=quick")
        page.get_by_text("GX-7: a calibration by this plan is running.").wait_for()
    assert not page.get_by_label("Begin again with the first step").count()


def test_between_two_runs_the_live_page_says_which_calibration_is_at_work_and_leads_to_it(site, visitors):
    address, out = site
    page = visitors.come(address)
    job = JobFile.create(out / "GX-8", "GX-8", "quick", "digest")
    job.begin("fit")
    with job.locked():
        page.goto("/live")
        item = page.get_by_role("listitem").filter(has_text="GX-8")
        item.get_by_text("Quick whole calibration, 0 to 50 °C · Fit").wait_for()
        assert item.get_by_role("link").get_attribute("href") == f"/calibrations/GX-8/{job.folder.name}"
        assert not page.get_by_text("No live run").count()
    page.get_by_role("heading", name="No live run").wait_for()


@pytest.mark.slow
def test_by_touch_a_new_gyro_goes_to_its_certificate_after_an_abort(bench, visitors, tmp_path):
    page = visitors.come(bench.site.address, size=TABLET, touch=True)
    begin(page, touch=True)
    page.get_by_role("button", name="Abort …").tap()
    page.get_by_role("button", name="Abort the run").tap()
    page.get_by_text("It can go on from there").wait_for()
    picture(page, "calibration-aborted-tablet")
    page.get_by_role("link", name="Repeat").tap()
    page.get_by_text(
        "GX-0815: a calibration by this plan was begun before (Stopped); START begins a new one."
    ).wait_for()
    page.get_by_role("checkbox", name="Begin again with the first step").tap()
    page.get_by_text("(Stopped); START goes on with it.").wait_for()
    page.goto("/calibrations")
    picture(page, "calibrations-tablet")
    page.get_by_role("link", name="GX-0815").tap()
    page.get_by_role("button", name="Continue").tap()
    page.get_by_role("progressbar").wait_for()
    print_certificate(page, bench, tap, tmp_path / "printed.pdf")
    page.goto("/calibrations")
    page.get_by_role("link", name="GX-0815").wait_for()
    page.set_viewport_size(PHONE)
    page.evaluate("document.fonts.ready")
    state = page.get_by_role("row", name="GX-0815").locator(".lamp").bounding_box()
    assert state["x"] + state["width"] <= PHONE["width"], "how it stands is seen without a move"


def test_a_calibration_that_was_cut_off_says_on_one_screen_how_it_goes_on(bench, visitors, tmp_path):
    station = tmp_path / "project" / "profiles" / "stations" / "unhurried.yaml"
    station.write_text(f"{station.read_text()}laboratory: simulated\nequipment: simulated\n")
    page = visitors.come(bench.site.address, size={"width": 1366, "height": 768})
    asked = {"plan": "brief", "station": "unhurried", "unit": SLOW_UNIT}
    start = bench.client.post("/calibrations", json=asked).raise_for_status().json()["start"]
    job = until(lambda: bench.get(f"/starts/{start}/calibration"))["job"]
    page.goto(f"/calibrations/{job}")
    page.locator(".several-run").get_by_text("started by").wait_for()
    assert page.locator(".several-run .headline-what").bounding_box()["height"] < 80, "two lines"
    os.kill(json.loads((bench.out / ".web" / "starts" / start / "start.json").read_text())["pid"], signal.SIGKILL)
    page.get_by_text("Its calibration can go on.").wait_for()
    assert not page.get_by_text("bench resume").count()
    assert day_and_night(page) == []
    assert page.locator(".several-run .headline-what").bounding_box()["height"] < 80
    fails = []
    page.on("requestfinished", lambda request: fails.append(request.url) if request.response().status == 409 else None)
    page.reload()
    page.get_by_text("Its calibration can go on.").wait_for()
    page.wait_for_timeout(3000)
    assert fails == []


@pytest.mark.slow
def test_what_waits_for_a_station_is_listed_and_taken_out(bench, visitors):
    bench.start(plan=LONG, station="unhurried", units=[SLOW_UNIT])
    page = visitors.come(bench.site.address)
    visitors.of(page).forgives = re.compile("status of 409")
    page.goto(f"/start?unit={SLOW_UNIT}&station=unhurried&plan=short")
    page.get_by_role("button", name="START").click()
    page.get_by_text("is in use").wait_for()
    page.get_by_role("button", name="Start when the station is free").click()
    page.wait_for_url("**/calibrations")
    page.get_by_role("heading", name="Waiting for their station").wait_for()
    second = bench.client.post(
        "/starts", json={"plan": "short", "station": "unhurried", "units": [SLOW_UNIT], "queue": True}
    )
    assert second.json()["state"] == "waiting"

    def waiting():
        return [start["start"] for start in bench.get("/calibrations")["waiting"]]

    before = waiting()
    page.get_by_role("button", name=f"Earlier: {SLOW_UNIT}").nth(1).click()
    until(lambda: waiting() == before[::-1])
    picture(page, "queue")
    bench.client.delete(f"/starts/{second.json()['start']}").raise_for_status()
    page.get_by_role("button", name=f"Remove {SLOW_UNIT}").nth(1).wait_for(state="detached")
    page.get_by_role("button", name=f"Remove {SLOW_UNIT}").click()
    page.get_by_role("heading", name="Waiting for their station").wait_for(state="detached")


@pytest.mark.parametrize("locale", ["uk-UA", "zh-CN"])
def test_a_calibration_that_stopped_is_printed_whole_and_says_why_in_the_readers_language(site, visitors, locale):
    why = "aborted by Olena (operator) from 127.0.0.1"
    steps = [{"name": name, "state": "open", "sentence": "", "cases": [], "facts": {}, "verdict": None, "run": None}
             for name in STEP_NAMES]  # fmt: skip
    steps[0] = {**steps[0], "state": "failed", "sentence": why}
    steps[2]["run"] = "GX-1/r1"
    steps[3] |= {
        "state": "done",
        "verdict": "INVALID",
        "facts": {"limits": "INVALID", "model": "spline", "held_out_rms_dph": 0.4},
    }
    began = {
        "check": {"state": "done", "verdict": None, "warnings": 2},
        "run": {"state": "failed", "verdict": None, "warnings": 0},
        "fit": {"state": "done", "verdict": "INVALID", "warnings": 0},
    }
    mate = {"state": "failed", "verdict": None, "sentence": why, "certificate": False, "steps": began}
    job = {
        "job": "GX-1/1", "unit": "GX-1", "plan": "brief", "state": "failed", "verdict": None, "sentence": why,
        "exit_code": 3, "created": "2026-11-27T06:00:00Z", "steps": steps, "live": None, "start": None,
        "certificate": None, "releases": [],
        "together": [{**mate, "unit": unit, "job": f"{unit}/1"} for unit in ("GX-1", "GX-20815")],
    }  # fmt: skip
    page = visitors.come(site[0], locale=locale, size={"width": 718, "height": 1000})
    page.route("**/api/v1/calibrations/GX-1/1", lambda route: route.fulfill(json=job))
    page.goto("/calibrations/GX-1/1")
    page.locator(".job-mates").wait_for()
    assert Axe().run(page).response["violations"] == []
    assert english(page) == []
    box = "document.querySelector('.job-mates').parentElement"
    assert page.locator(".job-steps a[href='/verdict/GX-1/r1']").count() == 1, "why it is INVALID"
    assert page.locator(".job-mates td.tone-good").count() == 0, "nor is an INVALID fit a good one beside the others"
    check = page.locator(".job-mates td.tone-warn .unseen").first
    assert "2" in check.inner_text(), "a check with warnings is no plain pass"
    lamp = f"{box}.querySelector('.lamp').getBoundingClientRect()"
    assert page.evaluate(f"{lamp}.right < {box}.getBoundingClientRect().right"), "how each stands is in sight"
    page.emulate_media(media="print")
    page.wait_for_function(f"() => {box}.scrollWidth <= {box}.clientWidth")
    page.goto("about:blank")  # which asks for nothing when the answer is not given any more
    page.unroute_all(behavior="wait")
