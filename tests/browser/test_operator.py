"""The operator's way in a real browser: from serial number to verdict, abort, a server that comes back."""

import json
import os
import re
import signal

import pytest

from bench.web.people import people
from tests.support import bench_project
from tests.support.bench_project import LONG, SLOW_UNIT, bench_over
from tests.support.servers import site_over
from tests.support.visiting import DESKTOP, PATIENCE_MS, PHONE, PICTURES, TABLET, day_and_night, picture
from tests.support.waiting import until


@pytest.fixture(scope="module")
def operated(tmp_path_factory, project):
    with bench_over(tmp_path_factory.mktemp("out"), project) as bench:
        yield bench


@pytest.fixture
def bench(operated):
    """The bench of all these tests, without a run that goes on."""
    yield operated
    operated.end_runs()


def test_from_serial_number_to_verdict(bench, visitors):
    page = visitors.come(bench.site.address)
    page.goto("/")
    serial = page.get_by_label("Serial number")
    assert serial.evaluate("(field) => field === document.activeElement"), "who scans need not click first"
    page.keyboard.type("nobody")
    page.keyboard.press("Enter")
    page.get_by_text("No station has a unit nobody").wait_for()
    page.keyboard.type("sim-0001")
    page.keyboard.press("Enter")
    page.get_by_role("button", name=re.compile("^Embedded station 1 unit")).click()
    page.get_by_role("button", name=re.compile("^short Temperature")).click()
    page.get_by_text("Check passed").wait_for()
    page.get_by_label("Judge by these limits").select_option("short")
    later = page.get_by_label("Not before")
    later.fill("2020-01-01T00:00")
    page.get_by_text("This time has passed").wait_for()
    assert page.locator("button.giant").is_disabled(), "a planned start never begins at once"
    later.fill("")
    page.get_by_role("button", name="START").click()
    page.wait_for_url("**/live/SIM-0001/*")
    page.get_by_role("heading", name="PASS").wait_for()
    picture(page, "verdict-pass")
    run = page.url.partition("/verdict/")[2]
    manifest = json.loads((bench.out / run / "manifest.json").read_text())
    assert (manifest["unit"], manifest["profile"], manifest["state"]) == ("SIM-0001", "short", "done")
    assert page.request.get(page.get_by_role("link", name="Report").get_attribute("href")).ok
    page.get_by_role("link", name="Deliver and check").click()
    page.get_by_role("button", name="Make the numbers again").click()
    page.get_by_text("Identical: every number and every file").wait_for()
    page.get_by_label("Format").select_option("json")
    page.get_by_role("button", name="Export", exact=True).click()
    file = page.locator(".run-files a")
    file.wait_for()
    picture(page, "run-delivered")
    assert page.request.get(file.get_attribute("href")).json()
    page.goto(f"/verdict/{run}")
    seen_on_paper(page)
    page.get_by_role("link", name="Next unit").click()
    page.get_by_label("Serial number").wait_for()


def seen_on_paper(page):
    """When the unit was measured and what to do with it, without buttons."""
    page.get_by_role("link", name="Next unit").wait_for()
    page.emulate_media(media="print")
    page.locator(".verdict-who time").wait_for()
    page.locator("#next").wait_for()
    assert not page.get_by_role("link", name="Next unit").is_visible()
    page.emulate_media(media="screen")


def fill_in_recipients(page):
    """Somebody is told of runs, whose address is not shown again; then nobody any more."""
    page.get_by_label("Name, as events call it").fill("chat")
    address = page.get_by_label("Address (URL)")
    address.fill("json://secret@127.0.0.1:1")
    page.get_by_label("Run ended").uncheck()
    page.get_by_role("button", name="Save notices").click()
    page.get_by_text("Runs that start from now on tell them").wait_for()
    assert day_and_night(page) == []
    assert (address.input_value(), address.get_attribute("placeholder")) == ("", "saved, not shown")
    assert "secret" not in page.content()
    page.get_by_role("button", name="Send everybody a trial").click()
    page.get_by_text("chat: ").wait_for()
    page.reload()
    page.get_by_label("Run holds").wait_for()
    assert not page.get_by_label("Run ended").is_checked()
    page.get_by_role("button", name="Remove chat").click()
    page.get_by_role("button", name="Save notices").click()
    page.get_by_text("Nothing is filled in yet.").nth(2).wait_for()


def test_a_profile_is_edited_and_the_equipment_of_its_station_asked(bench, visitors, project):
    page = visitors.come(bench.site.address)
    page.goto("/")
    page.get_by_role("link", name="Files").click()
    page.get_by_label("File", exact=True).select_option("short")
    text = page.get_by_label("Text of the file")
    page.get_by_text("Check passed, with").wait_for()
    page.get_by_role("img", name=re.compile("Temperature curve from 10")).wait_for()
    before = text.input_value()
    text.fill(before.replace("to_degc: 10", "to_degc: -90", 1))
    page.get_by_text("It cannot be used like this").wait_for()
    page.get_by_role("button", name="Line 10").first.click()
    assert text.evaluate("(area) => area.value.slice(area.selectionStart, area.selectionEnd)").endswith("per_min: 2}")
    picture(page, "files-wrong")
    colder = before.replace("to_degc: 10", "to_degc: 5").replace("name: short", "name: short_5")
    text.fill(f"# colder, as the customer wants\n{colder}")
    page.get_by_label("Save as").fill("short_5")
    page.get_by_role("button", name="Save as my own").click()
    page.wait_for_url("**id=short_5")
    saved = (project / "profiles" / "short_5.yaml").read_text()
    assert saved.startswith("# colder, as the customer wants\n")
    page.goto("/laboratory?station=bare")
    page.get_by_role("button", name="Send everybody a trial").click()
    page.get_by_text("this station tells nobody").wait_for()
    fill_in_recipients(page)
    page.get_by_role("button", name="Ask the equipment").click()
    page.get_by_text("Everything that answered agrees").wait_for()


MOST_BYTES = 60_000


@pytest.mark.parametrize("locale", ["en-GB", "uk", "zh"])
def test_the_start_page_is_small_and_brings_no_library_of_charts(site, visitors, locale):
    page = visitors.come(site[0], locale=locale)
    sizes = {}
    page.on("requestfinished", lambda request: sizes.update({request.url: request.sizes()["responseBodySize"]}))
    page.goto("/")
    page.locator("#serial").wait_for()
    page.wait_for_load_state("networkidle")
    static = {url.rpartition("/static/")[2]: size for url, size in sizes.items() if "/api/" not in url}
    assert 10_000 < sum(static.values()) <= MOST_BYTES, static
    assert len([name for name in static if re.match("(en|uk|zh)-", name)]) == 1
    code = "".join(page.request.get(url).text() for url in sizes if url.endswith(".js"))
    assert "uplot" not in code.lower().replace("uplot.min.css", "")
    assert "plotly_relayout" not in code
    files = [url for url in sizes if "/static/" in url and not url.endswith("icon.svg")]
    assert {url.rpartition(".")[2] for url in files} == {"js", "css"}
    assert all("immutable" in page.request.get(url).headers["cache-control"] for url in files)


def test_the_start_page_is_fetched_beside_its_words(site, visitors):
    page, held = visitors.come(site[0], locale="uk"), []

    def hold(route):
        held.append(route)

    page.route("**/static/uk-*.js", hold)
    with page.expect_request("**/static/start-*.js", timeout=20_000):
        page.goto("/", wait_until="commit")
    while not held:
        page.wait_for_timeout(10)
    held[0].continue_()
    page.locator("#serial").wait_for()


def test_a_unit_is_scanned_before_the_lists_are_there_and_waits_for_them(bench, visitors):
    page, held = visitors.come(bench.site.address), []

    def hold(route):
        held.append(route)

    page.route("**/api/v1/plans", hold)
    page.goto("/")
    page.locator("#serial").wait_for()
    page.keyboard.type(SLOW_UNIT)
    page.keyboard.press("Enter")
    while not held:
        page.wait_for_timeout(10)
    assert page.locator("#serial").input_value() == SLOW_UNIT
    assert page.locator(".question .spinner").count() == 1
    held[0].continue_()
    page.get_by_role("heading", name="Which test plan?").wait_for()
    page.get_by_role("button", name=re.compile("^Calibration, −40 to 85")).wait_for()


@pytest.mark.parametrize("locale", ["en-GB", "uk", "zh"])
def test_every_page_is_in_sight_in_the_menu_of_a_telephone(site, visitors, locale):
    page = visitors.come(site[0], locale=locale, size=PHONE)
    page.goto("/")
    page.locator("#serial").wait_for()
    links = page.get_by_role("navigation").get_by_role("link").all()
    assert len(links) == 8
    for box in (link.bounding_box() for link in links):
        assert box["x"] + box["width"] <= PHONE["width"]


def press_tab_to(page, target, most=60):
    """Walk with Tab until `target` has the focus."""
    for _ in range(most):
        if target.evaluate("(element) => element === document.activeElement"):
            return
        page.keyboard.press("Tab")
    pytest.fail("Tab does not get there")


def test_from_serial_number_to_abort_by_keyboard_alone(bench, visitors):
    page = visitors.come(bench.site.address, size=TABLET)
    page.goto("/")
    page.get_by_label("Serial number").wait_for()
    page.keyboard.type(SLOW_UNIT)
    page.keyboard.press("Enter")
    plan = page.get_by_role("button", name=re.compile("^Calibration, −40 to 85"))
    plan.wait_for()
    press_tab_to(page, plan)
    page.keyboard.press("Enter")
    start = page.locator("button.giant:enabled")
    start.wait_for()
    press_tab_to(page, start)
    page.keyboard.press("Enter")
    page.wait_for_url(f"**/live/{SLOW_UNIT}/*")
    page.go_back()
    page.get_by_role("heading", name="Which unit?").wait_for()  # not START again
    page.go_forward()
    page.get_by_text("Time left").wait_for()
    abort = page.get_by_role("button", name="Abort …")
    press_tab_to(page, abort)
    page.keyboard.press("Enter")
    keep = page.get_by_role("button", name="Keep running")
    keep.wait_for()
    assert keep.evaluate("(button) => button === document.activeElement"), "Enter twice must not abort"
    page.keyboard.press("Escape")
    keep.wait_for(state="detached")
    assert abort.evaluate("(button) => button === document.activeElement"), "the focus is where it was"
    page.keyboard.press("Enter")
    press_tab_to(page, page.get_by_role("button", name="Abort the run"))
    page.keyboard.press("Enter")
    page.get_by_role("heading", name="ABORTED").wait_for()


@pytest.fixture
def guarded(tmp_path, project):
    """A bench with tokens, used by a line controller; and the token of Olena, an operator."""
    access = tmp_path / "access.yaml"
    controller, olena = (people.add_person(access, name, "operator") for name in ("MES", "Olena"))
    with bench_over(tmp_path / "out", project, "--access", str(access), token=controller) as bench:
        yield bench, olena


def test_an_abort_in_mid_ramp_ends_in_the_safe_state_and_says_who(guarded, visitors):
    bench, token = guarded
    run = bench.start(plan=LONG, station="unhurried", units=[SLOW_UNIT], limits="short", models=["polynomial"])
    page = visitors.come(bench.site.address)
    page.goto(f"/live/{run}")
    page.get_by_label("Token").fill(token)
    page.keyboard.press("Enter")
    page.wait_for_url(f"**/live/{run}")
    page.get_by_text("started by MES").wait_for()
    bench.moving(run)
    page.get_by_role("button", name="Abort …").click()
    picture(page, "abort")
    page.get_by_role("button", name="Abort the run").click()
    page.get_by_role("heading", name="ABORTED").wait_for()
    page.get_by_text(re.compile(r"^Aborted by Olena \(operator\)", re.IGNORECASE)).wait_for()
    page.get_by_text("The chamber is in its safe state; the bench has read it back.").wait_for()
    picture(page, "verdict-aborted")
    told = until(lambda: (found := bench.get(f"/live/{run}")) and not found["ended"]["analysing"] and found)
    assert (told["ended"]["state"], told["ended"]["safe"]) == ("aborted", True)
    (asked,) = told["ended"]["requests"]
    assert asked["who"].startswith("Olena (operator) from 127.0.0.1")
    assert re.fullmatch(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d.*(Z|\+00:00)", asked["utc"])
    events = [json.loads(line) for line in (bench.out / run / "events.jsonl").read_text().splitlines()]
    kinds = [event["kind"] for event in events]
    assert kinds.index("request") < kinds.index("safe_state") < kinds.index("end")
    assert events[kinds.index("request")]["who"] == asked["who"]
    assert page.locator(".verdict-ways .primary").all_inner_texts() == ["Repeat"], "as the next step says"
    page.get_by_role("link", name="Repeat").click()
    judged = page.get_by_label("Judge by these limits")
    judged.wait_for()
    assert judged.input_value() == "short", "chosen for that run, not in this browser"
    page.get_by_text("Models: polynomial").wait_for()


TRACES = "import(document.querySelector('script[type=module]').src).then(({ traces }) => traces.get(run))"
TRACE = f"""(run) => {TRACES}
  .then((trace) => trace ? [trace.complete, trace.generation, trace.t, trace.chamber] : null)"""
CAUGHT_UP = f"""([run, s]) => {TRACES}
  .then((trace) => trace?.complete && trace.t.at(-1) >= s)"""


def drawn(page, run):
    """The run's trace in the page: whether complete, generation, times [s], chamber [degC]."""
    return page.evaluate(TRACE, run)


def same(one, other):
    """Whether two traces agree as far as both go."""
    length = min(len(one[2]), len(other[2]))
    return one[1] == other[1] and length > 0 and all(one[k][:length] == other[k][:length] for k in (2, 3))


def test_the_page_says_that_the_server_does_not_answer_and_finds_the_run_again_after_its_restart(bench, visitors):
    run = bench.start(plan=LONG, station="unhurried", units=[SLOW_UNIT])
    page, starting = visitors.come(bench.site.address), visitors.come(bench.site.address)
    page.goto(f"/live/{run}")
    starting.goto("/start?unit=SIM-0001&station=simulated&plan=short")
    starting.locator("button.giant:enabled").wait_for()
    before_s = bench.moving(run)["t_s"]
    page.get_by_role("progressbar").wait_for()
    for window in (page, starting):
        visitors.may_lose_the_server(window)
    bench.site.end()
    page.get_by_role("button", name="Hold now").click()
    starting.locator("button.giant").click()
    for window in (page, starting):
        window.get_by_text("The server does not answer").wait_for()
        window.get_by_text("the data shown are old").wait_for()
    page.get_by_role("button", name="Abort …").click()
    page.get_by_role("button", name="Abort the run").click()
    page.get_by_text("Go to the chamber now").wait_for()
    journal = bench.out / run / "journal" / "bench.gtbj"
    size = journal.stat().st_size
    until(lambda: journal.stat().st_size > size + 20_000)  # the run does not care
    bench.site.start()
    for window in (page, starting):
        window.get_by_text("The server does not answer").wait_for(state="detached")
        window.get_by_text("the data shown are old").wait_for(state="detached")
    now_s = until(lambda: bench.get(f"/live/{run}").get("t_s"))
    page.wait_for_function(CAUGHT_UP, arg=[run, now_s])

    def agreeing():
        seen, points = drawn(page, run), bench.get(f"/live/{run}/trace")
        told = (True, points["generation"], [p[0] for p in points["points"]], [p[2] for p in points["points"]])
        return (seen, points) if same(seen, told) else None

    seen, points = until(agreeing)
    assert seen[2][-1] > before_s
    steps = {round(after - before, 3) for before, after in zip(seen[2], seen[2][1:], strict=False)}
    assert steps == {points["every_s"]}, "nothing is missing of the time without a server"
    assert page.get_by_role("button", name="Abort …").is_enabled()


TOLD = """(change) => import(document.querySelector('script[type=module]').src).then(({ live }) =>
  live.set((now) => ({ ...now, runs: now.runs.map((run) => ({ ...run, ...change })) })))"""
"""The stream tells this of the live runs."""


def test_an_abort_that_a_silent_server_has_not_confirmed_is_not_told_as_done(bench, visitors):
    run = bench.start(plan=LONG, station="unhurried", units=[SLOW_UNIT])
    page = visitors.come(bench.site.address)
    page.clock.install()
    page.goto(f"/live/{run}")
    page.get_by_role("button", name="Abort …").click()
    with bench.site.silent():
        page.get_by_role("button", name="Abort the run").click()
        page.get_by_text("The abort is requested").wait_for()
        assert not page.get_by_text("The chamber goes to its safe state").count()
        page.clock.run_for(SILENT_MS)
        page.get_by_text("this run may NOT be aborted").wait_for()
    page.get_by_role("heading", name="ABORTED").wait_for()
    page.wait_for_function("() => document.title.startsWith('ABORTED · ')")  # for who has the tab in the background


RETRIED_MS, SILENT_MS = 2000, 12_000
TRIES = SILENT_MS // RETRIED_MS + 1


def test_after_a_long_time_without_a_server_both_tabs_stay_connected_again(bench, visitors):
    site = bench.site
    tabs = [visitors.come(site.address) for _ in range(2)]
    for tab in tabs:
        visitors.may_lose_the_server(tab)
        tab.clock.install()
        tab.goto("/units")
        tab.get_by_role("heading", name="Units").wait_for()
    site.end()
    for tab in tabs:
        tab.get_by_text("the data shown are old").wait_for()
        for _ in range(TRIES):
            with tab.expect_event("requestfailed"):
                tab.clock.run_for(RETRIED_MS)
    site.start()
    for tab in tabs:
        tab.clock.run_for(RETRIED_MS)
        tab.get_by_text("the data shown are old").wait_for(state="detached")
        asked = []
        tab.on("request", lambda request, asked=asked: asked.append(request.url))
        tab.clock.run_for(SILENT_MS / 2)  # the tries of before are over: none of them ends this connection
        assert asked == []


def test_a_page_that_was_asked_for_without_a_server_comes_when_it_answers_again(bench, visitors):
    site = bench.site
    page = visitors.come(site.address)
    page.goto("/units")
    page.get_by_role("heading", name="Units").wait_for()
    page.get_by_role("link", name="Start", exact=True).click()
    page.locator("#serial").wait_for()
    visitors.may_lose_the_server(page)
    for name in ("Units", "Fleet"):  # of the one only the data are missing, of the other the page itself
        site.end()
        page.get_by_role("link", name=name, exact=True).click()
        again = page.get_by_role("button", name="Try again")
        again.wait_for()
        again.click()
        again.wait_for()  # the page stays, with its button
        site.start()
        again.wait_for(state="detached")
        page.get_by_role("heading", name=name, exact=True).wait_for()


SMALL = {"width": 1366, "height": 768}
PLOTTED_PX = 200


NOTE_PX = "document.querySelector('.actions-gap').clientWidth"


def plotted_px(page):
    """Heights of the plotted areas, without axes, of temperatures and means."""
    charts = page.get_by_role("img", name=re.compile("^(Curves of temperature|Mean output)"))
    return charts.locator(".u-over").evaluate_all("(all) => all.map((one) => one.clientHeight)")


def test_nothing_is_under_the_actions_of_a_small_screen_and_an_abort_that_did_not_arrive_is_told(bench, visitors):
    run = bench.start(plan=LONG, station="unhurried", units=[SLOW_UNIT])
    page = visitors.come(bench.site.address, size=SMALL)
    page.goto(f"/live/{run}")
    page.get_by_role("progressbar").wait_for()
    seen_above_the_actions(page, bench, run)
    page.set_viewport_size(DESKTOP)
    visitors.of(page).forgives = re.compile("ERR_FAILED")
    page.route("**/abort", lambda route: route.abort())
    page.get_by_role("button", name="Abort …").click()
    page.get_by_role("button", name="Abort the run").click()
    page.get_by_text("this run may NOT be aborted").wait_for()
    page.evaluate(TOLD, {"state": "ending"})
    page.get_by_text("this run may NOT be aborted").wait_for(state="detached")


def seen_above_the_actions(page, bench, run):
    """Everything of the live page has its place on small screens."""
    picture(page, "live-small")
    widths = page.locator(".segment-bar i").evaluate_all(
        "(cells) => cells.map((cell) => cell.getBoundingClientRect().width)"
    )
    now = until(lambda: bench.in_segment(run))
    lasts = now["segments_s"]
    longest = lasts.index(max(lasts))
    assert widths[longest] == max(widths)
    assert widths[longest] / widths[1] == pytest.approx(lasts[longest] / lasts[1], rel=0.05)
    shown, actions = (page.locator(place).bounding_box() for place in (".live-body", ".actions"))
    assert shown["height"] > 250
    assert shown["y"] + shown["height"] <= actions["y"] + 1
    assert actions["y"] + actions["height"] <= 769
    for plot in page.locator(".live .plot").all():
        box = plot.bounding_box()
        assert box["y"] + box["height"] <= actions["y"] + 1, "the charts are in sight without scrolling"
    for size in (SMALL, PHONE):
        page.set_viewport_size(size)
        until(lambda: min(plotted_px(page), default=0) >= PLOTTED_PX)
    soak = {**now["segment"], "anew": True}
    wide = f"(change) => ({TOLD})(change).then(() => new Promise(requestAnimationFrame)).then(() => {NOTE_PX})"
    assert page.evaluate(wide, {"segment": soak}) > 0.8 * PHONE["width"], "what a hold does is read without squinting"


FILLED = "new DOMMatrix(getComputedStyle(document.querySelector('.segment-bar .now span')).transform).a"
"""Share of the current segment that is shown as done."""


def test_two_browsers_see_the_same(bench, visitors):
    run = bench.start(plan=LONG, station="unhurried", units=[SLOW_UNIT])
    one, other = visitors.come(bench.site.address), visitors.come(bench.site.address, size=TABLET, locale="uk")
    one.goto(f"/live/{run}")
    bench.moving(run)
    other.goto("/live")
    for page in (one, other):
        page.get_by_role("progressbar").wait_for()
    one.wait_for_function(f"() => {FILLED} > 0.1")
    one.get_by_role("button", name="Hold now").click()
    one.get_by_role("button", name="Resume").wait_for()
    assert one.evaluate(FILLED) > 0.05, "what was done of the segment stays done"
    one.locator(".log", has_text="hold by").wait_for()
    one.locator(".legend", has_text="mean over 30 s").wait_for()
    one.wait_for_function("document.title.startsWith('Holding · ')")
    assert day_and_night(one) == []
    other.get_by_role("button", name="Продовжити").wait_for()
    assert same(drawn(one, run), until(lambda: (found := drawn(other, run)) and found[0] and found))
    other.get_by_role("button", name="Продовжити").click()
    one.get_by_role("button", name="Hold now").wait_for()
    other.get_by_role("button", name="Перервати").first.click()
    other.get_by_role("dialog").get_by_role("button").last.click()
    one.get_by_role("heading", name="ABORTED").wait_for()
    other.wait_for_url(f"**/verdict/{run}")


CUT_OFF = "The run was interrupted: its process has ended. Look at the chamber."


def test_a_run_that_was_cut_off_is_resumed_in_the_page(bench, visitors):
    run = bench.start(plan=LONG, station="unhurried", units=[SLOW_UNIT])
    page = visitors.come(bench.site.address)
    page.goto(f"/live/{run}")
    page.get_by_role("button", name="Hold now").wait_for()
    start = bench.get("/starts")["starts"][0]["start"]
    os.kill(json.loads((bench.out / ".web" / "starts" / start / "start.json").read_text())["pid"], signal.SIGKILL)
    resume = page.get_by_role("button", name="Resume")
    resume.wait_for()
    assert page.locator(".notice.bad").inner_text() == CUT_OFF, "no command beside the button"
    picture(page, "live-cut-off")
    assert day_and_night(page) == []
    other = visitors.come(bench.site.address)
    other.goto("/")
    other.get_by_role("link", name="Live 1").wait_for()
    assert not other.locator(".already").count(), "nothing goes on"
    resume.click()
    page.get_by_role("button", name="Hold now").wait_for()
    assert page.url.endswith(f"/live/{run}")


def test_warnings_are_in_sight_with_start_in_a_low_window(bench, visitors):
    low = {"width": 683, "height": 384}
    page = visitors.come(bench.site.address, size=low)
    page.goto("/start?unit=SIM-0001&station=four_units&plan=brief")
    start = page.locator("button.giant:focus")
    start.wait_for()
    for box in (start.bounding_box(), page.get_by_role("link", name="1 warning").bounding_box()):
        assert box["y"] >= page.locator(".bar").bounding_box()["height"]
        assert box["y"] + box["height"] <= low["height"]


def test_a_scan_right_after_the_click_loses_no_character(bench, visitors):
    page = visitors.come(bench.site.address)
    page.goto("/")
    fill = page.get_by_role("region", name="Four units").get_by_role("button", name="Fill 4 slots")
    focused = fill.evaluate(
        """async (button) => {
             const shown = new Promise((done) => {
               const watch = new MutationObserver(() => {
                 if (document.querySelector("form.slots")) done(document.activeElement.tagName);
               });
               watch.observe(document.body, { childList: true, subtree: true });
             });
             button.click();
             return shown;
           }"""
    )
    assert focused == "INPUT"
    page.get_by_role("heading", level=2).first.click()
    page.keyboard.type("GX-1\n")
    assert page.locator("form.slots input").first.input_value() == "GX-1"


def test_a_label_that_was_scanned_twice_is_one_unit(site, visitors):
    page = visitors.come(site[0])
    page.goto("/")
    page.get_by_label("Serial number").wait_for()
    page.keyboard.type("sim-0001sim-0001\n")
    page.get_by_text("sim-0001sim-0001 repeats SIM-0001").wait_for()
    page.keyboard.type("GX-77GX-77\n")
    page.get_by_role("button", name="GX-77GX-77").click()
    page.get_by_text("GX-77GX-77 is new").wait_for()
    page.keyboard.type("GX-77GX-77\n")
    page.get_by_role("button", name="GX-77", exact=True).click()
    page.get_by_text("GX-77 is new").wait_for()
    page.get_by_role("button", name="Slot of SIM-0002").first.click()
    page.get_by_role("button", name=re.compile("^Calibration, −40 to 85")).click()
    page.get_by_label("Serial number in the slot of SIM-0002").fill("GX-77 GX-77")
    page.keyboard.press("Enter")
    page.get_by_role("button", name="GX-77", exact=True).click()
    assert page.locator(".steps strong").first.inner_text() == "GX-77"


def test_after_the_choice_of_a_serial_number_by_keyboard_the_next_question_has_the_focus(site, visitors):
    page = visitors.come(site[0])
    page.goto("/")
    page.get_by_label("Serial number").wait_for()
    page.keyboard.type("GX-77GX-77\n")
    page.get_by_role("button", name="GX-77", exact=True).press("Enter")
    page.get_by_role("heading", name="GX-77 is new").and_(page.locator(":focus")).wait_for()
    page.keyboard.press("Tab")
    page.get_by_role("button", name=re.compile("^Slot of")).first.and_(page.locator(":focus")).press("Enter")
    page.get_by_role("button", name=re.compile("^Calibration, −40 to 85")).press("Enter")
    page.locator("button.giant:focus").wait_for()
    page.get_by_label(re.compile("^Serial number in the slot of")).first.fill("GX-78GX-78")
    page.keyboard.press("Enter")
    page.get_by_role("button", name="GX-78", exact=True).press("Enter")
    page.locator("button.giant:focus").wait_for()


def test_slots_ask_which_number_is_meant_and_go_on(site, visitors):
    page = visitors.come(site[0])
    page.goto("/")
    page.get_by_role("region", name="Four units").get_by_role("button", name="Fill 4 slots").click()
    page.get_by_role("button", name="Next").wait_for()
    page.get_by_role("heading", name="A unit in each slot of Four units").wait_for()
    page.keyboard.type("GX-7GX-7\n")
    page.get_by_role("button", name="GX-7", exact=True).click()
    page.keyboard.type("GX-8GX-8\n")
    page.get_by_role("button", name="GX-8GX-8").click()
    page.keyboard.type("\n\n")
    page.get_by_role("button", name=re.compile("^Calibration, −40 to 85")).wait_for()
    assert page.locator(".steps strong").first.inner_text() == "GX-7, GX-8GX-8"


def test_the_enter_of_a_second_scan_presses_nothing(site, visitors):
    page = visitors.come(site[0])
    page.goto("/")
    page.get_by_label("Serial number").wait_for()
    page.keyboard.type("SIM-0001\n")
    first = page.locator(".choice").first
    first.wait_for()
    page.keyboard.type("SIM-0001\n")
    assert first.is_visible(), "no station was chosen"
    page.goto("/start?unit=SIM-0001&station=four_units&plan=quick")
    start = page.locator("button.giant")
    page.locator("button.giant:focus").wait_for()
    page.keyboard.type("GX-9\n")
    assert start.is_enabled(), "no run was started"
    assert "/live/" not in page.url


def test_four_units_stand_side_by_side(bench, visitors):
    page = visitors.come(bench.site.address, scheme="dark")
    page.goto("/")
    page.get_by_role("region", name="Four units").get_by_role("button", name="Fill 4 slots").click()
    page.get_by_role("button", name="Next").wait_for()
    for serial in ("SIM-0001", "SIM-0001"):
        page.keyboard.type(serial)
        page.keyboard.press("Enter")
    page.get_by_text("stands in two slots").wait_for()
    for serial in ("GX-0815", "sim-0003", "SIM-0004"):
        page.keyboard.type(serial)
        page.keyboard.press("Enter")
    page.get_by_role("button", name=re.compile("^Calibration, −40 to 85")).click()
    serials, steps = page.locator(".neighbours input").last.bounding_box(), page.locator(".steps").bounding_box()
    assert serials["x"] + serials["width"] < steps["x"] + steps["width"]
    page.get_by_role("button", name="START").click()
    page.wait_for_url("**/live/*/*")
    for serial in ("SIM-0001", "GX-0815", "SIM-0003", "SIM-0004"):
        page.get_by_text(serial).first.wait_for()
    assert page.locator(".output .chart > header .legend svg").first.is_visible(), "a number is told by its line"
    for language, told in (("uk", r"1\sс\S+ °/год30\sс\S+ °/год"), ("en", r"1\ss\S+ deg/h30\ss\S+ deg/h")):
        page.locator(".bar select").select_option(language)
        page.locator(".output .chart > header .legend").filter(has_text=re.compile(told)).first.wait_for()
    places = page.locator(".output").evaluate_all("(all) => all.map((one) => one.getBoundingClientRect().x)")
    assert places[:2] == places[2:], "two beside two"
    page.set_viewport_size(SMALL)
    assert min(plotted_px(page)) >= PLOTTED_PX
    page.set_viewport_size(DESKTOP)
    if PICTURES:  # a curve is better to look at than its beginning
        page.get_by_text(re.compile("Segment [5-7] of")).first.wait_for(timeout=3 * PATIENCE_MS)
    picture(page, "live-four-dark")
    page.get_by_role("button", name="Abort …").first.click()
    page.get_by_role("button", name="Abort the run").click()
    page.wait_for_url("**/verdict/**")


def test_a_serial_number_that_stands_in_two_slots_is_told_where_it_is_typed(site, visitors):
    page = visitors.come(site[0])
    page.goto("/start?unit=SIM-0001&station=four_units&plan=quick")
    page.get_by_role("button", name="All 4 units").click()
    page.get_by_label("Serial number in the slot of SIM-0002").fill("sim-0001")
    page.keyboard.press("Enter")
    page.locator(".neighbours").get_by_text("Serial number sim-0001 stands in two slots.").wait_for()
    assert "sim-0001" not in page.locator(".ready-facts").inner_text()
    page.get_by_label("Serial number in the slot of SIM-0002").fill("sim-0002")
    page.keyboard.press("Enter")
    page.get_by_text("stands in two slots").wait_for(state="detached")
    page.locator("button.giant:enabled").wait_for()
    assert page.locator(".steps strong").first.inner_text() == "SIM-0001, SIM-0002, SIM-0003, SIM-0004"
    lines = "(all) => all.map((one) => Math.round(one.offsetHeight / parseFloat(getComputedStyle(one).lineHeight)))"
    assert page.locator(".steps strong span").evaluate_all(lines) == [1, 1, 1, 1], "none is broken at its hyphen"


def test_an_abort_is_not_offered_any_more_when_the_pin_has_expired(tmp_path, project, visitors):
    access = tmp_path / "access.yaml"
    viewer, engineer = people.add_person(access, "screen", "viewer"), people.add_person(access, "lead", "engineer")
    pin = people.add_pin(access, "Olena", "operator")
    with bench_over(tmp_path / "out", project, "--access", str(access), token=engineer) as bench:
        run = bench.start(plan=LONG, station="unhurried", units=[SLOW_UNIT])
        page = visitors.come(bench.site.address)
        page.clock.install()
        page.goto(f"/live/{run}")
        page.get_by_label("Token").fill(viewer)
        page.keyboard.press("Enter")
        page.get_by_role("button", name="Operator").click()
        page.get_by_label("PIN or badge").fill(pin)
        page.keyboard.press("Enter")
        page.get_by_role("button", name="Leave the screen").wait_for()
        page.goto(f"/live/{run}")
        page.get_by_role("button", name="Abort …").click()
        page.get_by_role("button", name="Keep running").wait_for()
        left = page.request.get(f"{bench.site.address}/api/v1/session").json()["pin_s"]
        cookie = next(one["name"] for one in page.context.cookies() if one["name"].endswith("-pin"))
        page.context.clear_cookies(name=cookie)  # the server forgets it then, too
        page.clock.fast_forward(1000 * (left + 2))
        for name in ("Abort …", "Abort the run"):
            page.get_by_role("button", name=name).wait_for(state="detached")
        page.get_by_role("button", name="Operator").wait_for()
        page.context.close()


def test_operators_of_one_screen_name_themselves_by_their_badges_and_answer_for_themselves(tmp_path, visitors):
    access = tmp_path / "access.yaml"
    viewer = people.add_person(access, "screen", "viewer")
    badges = {
        name: people.add_pin(access, name, "operator", badge)
        for name, badge in (("Olena", "0004471199"), ("Ivan", "0004471200"))
    }
    with site_over(tmp_path / "out", "--access", str(access)) as site:
        page = visitors.come(site.address)
        visitors.of(page).forgives = re.compile("status of (401|422)")
        page.goto("/")
        page.get_by_label("Token").fill(viewer)
        page.keyboard.press("Enter")
        page.get_by_label("PIN or badge").wait_for()
        for wrong in ("0004471201", "   "):
            page.keyboard.type(wrong)
            page.keyboard.press("Enter")
            page.get_by_text("This PIN or badge is not known").wait_for()
            page.reload()
            page.get_by_label("PIN or badge").wait_for()

        def named(name):
            page.keyboard.type(badges[name])  # a reader: nobody has pointed at a field
            page.keyboard.press("Enter")
            page.locator(".who", has_text=name).wait_for()

        def left():
            page.get_by_role("button", name="Leave the screen").click()
            page.get_by_label("PIN or badge").wait_for()

        named("Olena")
        page.get_by_role("region", name="Embedded station").get_by_role("button", name="SIM-0001").click()
        page.get_by_role("heading", name="Which test plan?").wait_for()
        left()
        named("Olena")
        page.get_by_role("heading", name="Which test plan?").wait_for()
        left()
        named("Ivan")
        page.get_by_role("heading", name="Which unit?").wait_for()
        page.go_back()
        page.get_by_role("heading", name="Which unit?").wait_for()
        told = {"Olena": "If this is a badge, press “Leave the screen”", "Ivan": "This is the badge or PIN of Ivan"}
        for name, words in told.items():  # while Ivan is named
            page.keyboard.type(badges[name] + "\n")
            page.get_by_text(words).wait_for()
        assert page.locator("#serial").input_value() == ""  # nobody else shall read it
        left()
        assert page.get_by_text(badges["Olena"]).count() == 0
        page.context.close()


def test_after_too_many_wrong_pins_the_form_counts_the_seconds_and_accepts_again(tmp_path, visitors):
    access = tmp_path / "access.yaml"
    viewer = people.add_person(access, "screen", "viewer")
    pin = people.add_pin(access, "Olena", "operator", "0004471199")
    with site_over(tmp_path / "out", "--access", str(access)) as site:
        page = visitors.come(site.address)
        visitors.of(page).forgives = re.compile("status of 429")
        page.clock.install()
        page.goto("/")
        slow = {"status": 429, "json": {"detail": "too many wrong tokens from 127.0.0.1: wait 5 s"}}
        page.route("**/api/v1/session", lambda route: route.fulfill(**slow), times=1)
        page.get_by_label("Token").fill(viewer)
        page.keyboard.press("Enter")
        told = page.get_by_role("alert")
        told.wait_for()
        assert told.inner_text().replace("\xa0", " ") == "Too many wrong tokens from 127.0.0.1: wait 5 s."
        page.keyboard.press("Enter")
        refused = {"status": 429, "headers": {"Retry-After": "5"}, "json": {"detail": "too many wrong PINs: wait 5 s"}}
        page.route("**/session/pin", lambda route: route.fulfill(**refused))
        page.get_by_label("PIN or badge").fill("1234")
        enter = page.locator("form.pin").get_by_role("button", name="Sign in")
        enter.click()
        told = page.get_by_role("alert").filter(has_text="Too many wrong PINs. Try again in 5 s.")
        told.wait_for()
        assert enter.is_disabled()
        page.clock.run_for(1000)
        page.get_by_text("Try again in 4 s.").wait_for()
        for _ in range(4):
            page.clock.run_for(1000)
        page.get_by_role("alert").wait_for(state="detached")
        page.unroute("**/session/pin")
        page.get_by_label("PIN or badge").fill(pin)
        enter.click()
        page.locator(".who", has_text="Olena").wait_for()
        page.context.close()


def test_back_asks_the_question_before_again(site, visitors):
    page = visitors.come(site[0])
    page.goto("/units")
    page.get_by_role("link", name="Start", exact=True).click()
    page.get_by_role("region", name="Embedded station").get_by_role("button", name="SIM-0001").click()
    page.get_by_role("button", name=re.compile("^Quick run")).click()
    page.get_by_role("heading", name="Ready to start?").wait_for()
    page.go_back()
    page.get_by_role("heading", name="Which test plan?").wait_for()
    assert page.locator(".steps strong").all_inner_texts() == ["SIM-0001"]
    page.go_forward()
    page.get_by_role("heading", name="Ready to start?").wait_for()
    page.get_by_role("link", name="Files").click()
    page.get_by_role("link", name="Start", exact=True).click()
    page.get_by_role("heading", name="Ready to start?").wait_for()  # kept meanwhile
    for _ in range(2):
        page.go_back()
    for _ in range(2):
        page.go_back()
    page.get_by_role("heading", name="Which unit?").wait_for()
    page.go_back()
    page.wait_for_url("**/units")
    page.goto("/start?unit=SIM-0001&station=simulated&plan=quick")
    page.get_by_role("button", name="Change Test plan").click()
    page.get_by_role("heading", name="Which test plan?").wait_for()
    page.go_back()
    page.get_by_role("heading", name="Ready to start?").wait_for()


def test_a_serial_number_that_no_unit_can_have_is_refused_before_anything_is_chosen(bench, visitors):
    page = visitors.come(bench.site.address)
    page.goto("/")
    page.get_by_label("Serial number").fill("9" * 65)
    page.keyboard.press("Enter")
    page.get_by_text("at most 64 characters").wait_for()
    assert page.get_by_role("button", name="Slot of").count() == 0


def test_a_unit_of_the_address_that_no_station_has_is_told_and_no_other_station_is_taken_for_the_one_that_is_named(
    site, visitors
):
    page = visitors.come(site[0])
    page.goto("/start?unit=NOPE-1&plan=quick")
    page.get_by_text("No station has a unit NOPE-1").wait_for()
    page.goto("/start?unit=SIM-0005&station=nowhere&plan=quick")
    page.get_by_text("Station nowhere of this link is missing").wait_for()
    page.goto("/start?unit=SIM-0002&station=four-units&plan=quick")
    page.get_by_role("heading", name="Ready to start?").wait_for()
    page.get_by_role("button", name="Change Unit").click()
    page.get_by_role("heading", name="Which unit?").wait_for()
    assert not page.get_by_text("No station has").count()


def test_start_says_why_it_cannot(tmp_path, visitors):
    project = bench_project.made(tmp_path / "project")
    bare = project / "profiles" / "stations" / "bare.yaml"
    bare.write_text(bare.read_text().replace("lowest_degc: -42", "lowest_degc: -110"))
    with site_over(tmp_path / "out", project=project) as site:
        page = visitors.come(site.address)
        page.goto("/start?unit=BARE-1&station=bare&plan=short")
        page.get_by_role("heading", name="Ready to start?").wait_for()
        page.get_by_text("chamber.lowest_degc is \u2212110: the map writes set points").wait_for()
        start = page.get_by_role("button", name="START", description=re.compile("chamber.lowest_degc is [-\u2212]110"))
        assert start.is_disabled()
        page.get_by_role("link", name="The run cannot be started").click()
        page.get_by_role("heading", name="Ready to start?").wait_for()
        assert page.locator("#check").is_visible()
        page.close()
