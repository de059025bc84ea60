"""The engineer's workbench in a real browser: a hidden effect is found by clicking, every step can be undone."""

import csv
import io
import json
import re
from urllib.parse import urlencode

import pytest
from axe_playwright_python.sync_playwright import Axe

from bench.base import library
from bench.mystery.mystery import make_mystery
from tests.browser.test_operator import press_tab_to
from tests.support.run_folders import keep
from tests.support.servers import site_over
from tests.support.visiting import DESKTOP, PHONE, picture

SEED = 7  # hides `aging`
MANY = 300


@pytest.fixture(scope="module")
def mystery(tmp_path_factory):
    """Runs of a unit that hides one effect, and so many empty ones of others that a page cannot draw them all."""
    out = tmp_path_factory.mktemp("runs")
    profiles = library()
    made = make_mystery(SEED, 1, out, profiles / "ramp_-40_85.yaml", profiles / "check_minor_loops.yaml")
    manifest = json.loads((made.run / "manifest.json").read_text())
    for number in range(MANY):
        unit = f"U-{number:05d}"
        folder = out / unit / made.run.name
        folder.mkdir(parents=True)
        keep(folder, "manifest.json", {**manifest, "unit": unit, "files": {}})
    return out


@pytest.fixture(scope="module")
def address(mystery):
    with site_over(mystery, project=mystery) as site:
        yield site.address


@pytest.fixture
def page(visitors, address):
    """The start page; console errors fail the test."""
    page = visitors.come(address, locale="en")
    page.goto("/")
    return page


def choose(page, words="MYSTERY ramp"):
    page.get_by_role("link", name="Workbench").click()
    page.get_by_role("combobox", name="Find a run").fill(words)
    page.locator("[role=option]", has_text="MYSTERY").first.click()


def held_out(page):
    return float(page.locator(".wb-tile b").first.inner_text())


def diagnosed(page):
    page.locator(".wb-verdict").wait_for()
    return page.locator(".wb-word").inner_text()


def test_the_first_figure_is_asked_for_once(page):
    asked = []
    page.on("request", lambda request: asked.append(request.url) if request.method == "POST" else None)
    choose(page)
    page.locator(".wb-plot .main-svg").first.wait_for()
    assert sum(url.endswith("/figures") for url in asked) == 1


def test_the_hidden_effect_is_found_in_at_most_five_clicks_and_the_error_falls(page):
    clicks = []
    page.expose_function("clicked", lambda: clicks.append(1))
    page.evaluate("addEventListener('click', () => clicked(), true)")
    choose(page)
    take_the_others(page)
    page.get_by_text("Effect missing", exact=True).wait_for()
    before = held_out(page)
    page.locator(".wb-suspect", has_text="Aging").get_by_text("A unit cannot hold it: ").wait_for()
    page.get_by_role("button", name="Add: Aging").or_(page.get_by_role("button", name="Add Aging")).click()
    page.locator(".wb-fell").wait_for()
    assert held_out(page) < 0.5 * before
    assert "lower" in page.locator(".wb-fell").inner_text()
    page.get_by_text("Adequate", exact=True).wait_for()
    assert len(clicks) <= 5
    page.get_by_role("button", name="Undo").click()
    page.get_by_text("Effect missing", exact=True).wait_for()
    assert held_out(page) == before
    page.get_by_role("button", name="Redo").click()
    page.locator(".wb-fell").wait_for()
    page.locator(".wb-plot .legend", has_text="residual before").wait_for()
    page.get_by_role("tab", name="Free axes").click()
    page.get_by_label("Residual over").select_option("quadrature")
    page.locator(".wb-words", has_text="over quadrature").wait_for()
    page.reload()
    page.locator(".wb-words", has_text="over quadrature").wait_for()
    page.locator(".wb-fell").wait_for()  # the step before is known, too
    assert held_out(page) < 0.5 * before
    for _ in range(3):
        page.go_back()
    page.get_by_text("Effect missing", exact=True).wait_for()
    page.locator(".wb-words", has_text="means over").wait_for()


def test_what_adds_a_suspect_stands_beside_its_name_in_the_longest_language(page):
    page.set_viewport_size({"width": 1366, "height": 768})
    page.locator(".bar select").select_option("uk")
    page.goto("/workbench")
    page.locator("input[role=combobox]").fill("MYSTERY ramp")
    page.locator("[role=option]", has_text="MYSTERY").first.click()
    page.locator(".wb-suspect").first.wait_for()
    page.locator(".wb-diagnosis .wb-link").last.wait_for()
    for head in page.locator(".wb-suspect-head").all():
        name, add = head.locator("h4").bounding_box(), head.get_by_role("button").last.bounding_box()
        assert add["x"] >= name["x"] + name["width"], head.inner_text()


def test_an_error_or_a_floor_that_is_not_known_says_why(page):
    """An hour of a log without a soak: two dashes, and no word."""

    def unknown(route):
        told = route.fetch().json()
        if told["kind"] == "analysis" and told["state"] == "done":
            (model,) = told["result"]["models"]
            model["held_out_rms_dph"] = None
            model["held_out"] = [{**model["held_out"][0], "rms_dph": None, "reason": "without block 7 of the run"}]
            model["segments"] = [{**one, "floor_ratio": None} for one in model["segments"]]
            told["result"] |= {"floor_dph": None, "floor_reason": "no isothermal stretch of at least 5 minutes"}
        route.fulfill(json=told)

    page.route("**/api/v1/jobs/*", unknown)
    asked = []
    page.on("request", lambda request: asked.append(request.post_data or "") if "/analyses" in request.url else None)
    choose(page)
    page.get_by_text("held-out: without block 7 of the run").wait_for()
    page.get_by_text("noise floor: no isothermal stretch of at least 5 minutes").wait_for()
    page.get_by_text("By segment, RMS [deg/h]").click()
    assert not [text for text in page.locator(".wb-segments b").all_inner_texts() if "×" in text]
    page.wait_for_url("**model=*")
    assert ['"intervals":"auto"' in body for body in asked][:2] == [False, True], "the data choose, once"
    page.unroute_all(behavior="ignoreErrors")


def test_a_formula_that_no_unit_can_hold_leads_to_the_next_that_one_can(page):
    shared = {"evidence": 40.0, "held_out_before_dph": 0.9, "beside": [], "words": "", "like": "", "equivalent": [],
              "caution": "", "partial": None, "add": []}  # fmt: skip
    of_time = {"formula": "k * time", "held_out_rms_dph": 0.103, "unheld": "expression: cannot be delivered"}
    of_quadrature = {"formula": "k * quadrature", "held_out_rms_dph": 0.412, "unheld": ""}
    formulas = [of_time, of_quadrature]

    def unknown(route):
        told = route.fetch().json()
        if told["kind"] == "diagnosis" and told["state"] == "done":
            told["result"] |= {"verdict": "unknown_effect", "formulas": [{**shared, **one} for one in formulas]}
        route.fulfill(json=told)

    page.route("**/api/v1/jobs/*", unknown)
    choose(page)
    first = page.locator(".wb-suspect", has_text="k * time").first
    first.get_by_text("The next that a unit can hold, k * quadrature, leaves 0.412 instead of 0.103 deg/h").wait_for()
    assert page.locator(".wb-suspect button.primary").count() == 0, "nothing leads to what cannot be written"
    formulas.reverse()
    page.reload()
    page.locator(".wb-suspect", has_text="k * quadrature").locator("button.primary").wait_for()
    assert page.get_by_text("The next that a unit can hold").count() == 0
    page.unroute_all(behavior="ignoreErrors")


def take_the_others(page):
    """Use the check run and the static run that the page offers."""
    for role in ("Check", "Static"):
        page.get_by_role("button", name=re.compile(f"use .* as {role}")).click()
    page.locator(".wb-chip").nth(2).wait_for()


def test_runs_of_the_same_days_are_offered_and_used_only_when_they_are_taken(page):
    choose(page)
    page.locator(".wb-tile", has_text="on blocks left out").wait_for()
    take_the_others(page)
    page.goto(page.url)  # the address names the runs
    parts = page.locator(".wb-chip")
    parts.nth(2).wait_for()
    assert [chip.locator("select").input_value() for chip in parts.all()] == ["fit", "check", "static"]
    page.locator(".wb-tile", has_text="on the check run").wait_for()
    parts.nth(1).get_by_role("button").click()
    page.locator(".wb-tile", has_text="on blocks left out").wait_for()


def test_the_chosen_runs_stand_in_one_line_while_another_is_offered(page):
    choose(page)
    page.get_by_role("button", name=re.compile("use .* as Check")).click()
    page.get_by_role("button", name=re.compile("use .* as Static")).wait_for()
    chips = page.locator(".wb-chip")
    chips.nth(1).wait_for()
    page.evaluate("document.fonts.ready")
    assert len({chip.bounding_box()["y"] for chip in chips.all()}) == 1


def test_only_the_rows_in_sight_are_drawn(page):
    page.get_by_role("link", name="Workbench").click()
    page.get_by_text(f"{MANY + 3} of {MANY + 3} runs").wait_for()
    assert page.locator("[role=option]").count() < 60
    page.get_by_role("combobox", name="Find a run").fill("U-00271")
    page.get_by_text("1 of ").wait_for()
    assert page.locator("[role=option]").count() == 1
    page.keyboard.press("Control+a")
    page.keyboard.press("Delete")
    page.keyboard.press("End")
    page.keyboard.press("PageDown")
    page.locator(".wb-active").wait_for()


@pytest.mark.parametrize("width", [390, 820])
def test_plan_moment_and_verdict_of_a_run_are_not_cut_in_a_narrow_list(page, width):
    page.set_viewport_size({"width": width, "height": 844})
    page.goto("/workbench")
    row = page.locator("[role=option]", has=page.locator(".wb-row-state")).first
    row.wait_for()
    for part in ("unit", "name", "day", "state"):
        cell = row.locator(f".wb-row-{part}")
        assert cell.inner_text()
        assert cell.evaluate("(cell) => cell.scrollWidth - cell.clientWidth") <= 0, part
    assert row.evaluate("(row) => row.scrollHeight - row.clientHeight") <= 0


def test_a_run_is_named_by_plan_and_moment_and_found_by_what_names_it(page, mystery):
    folder = next(mystery.glob("MYSTERY*/*_ramp_-40_85")).name
    page.locator(".bar select").select_option("uk")
    page.goto("/workbench")
    page.get_by_text(f"{MANY + 3} з {MANY + 3}").wait_for()
    for words in (f"MYSTERY {folder}", "MYSTERY ramp", "mystery калібрування завершено", "mystery −40…85"):
        page.get_by_role("combobox").last.fill("")
        page.get_by_text(f"{MANY + 3} з {MANY + 3}").wait_for()
        page.get_by_role("combobox").last.fill(words)
        page.get_by_text(re.compile(rf"^1 з {MANY + 3}")).wait_for()
    row = page.locator("[role=option]")
    assert row.locator(".wb-row-name").inner_text() == "Калібрування, −40\u2060…\u206085\xa0°C"
    day = row.locator(".wb-row-day").inner_text()
    row.click()
    name = page.locator(".wb-chip-name")
    assert name.inner_text() == f"Калібрування, −40\u2060…\u206085\xa0°C · {day}"
    page.locator("button", has_text="+ ").first.wait_for()
    said = [*page.locator(".wb-chosen").all_inner_texts(), page.locator(".wb-x").first.get_attribute("aria-label")]
    assert not re.search(r"ramp_|check_|\dT\d", " ".join(said))


def test_every_figure_is_drawn_with_words(page):
    choose(page)
    words = page.locator(".wb-words")
    for tab in ("Over temperature", "Residual map", "Loop", "Free axes", "Allan deviation", "Channels"):
        before = words.inner_text()
        page.get_by_role("tab", name=tab).click()
        words.filter(has_text="MYSTERY" if tab != "Allan deviation" else "Allan").filter(has_not_text=before).wait_for()
        page.locator(".wb-plot .main-svg").first.wait_for()


def test_a_run_with_a_report_offers_the_model_that_the_report_is_of(page):
    def reported(route):
        run = route.fetch().json()
        route.fulfill(json={**run, "diagnosis": {"model": "spline_lag_loop"}})

    page.route("**/api/v1/runs/MYSTERY*/*", reported)
    choose(page)
    page.get_by_text("The report of this run is of another model, spline_lag_loop.").wait_for()
    page.get_by_role("button", name="Take it").click()
    page.get_by_text("The report of this run is of").wait_for(state="detached")
    page.wait_for_url("**spline_lag_loop*")


def test_a_link_has_the_steps_to_its_model_and_takes_the_name_of_one(page, visitors, address):
    choose(page)
    page.locator(".wb-suspect-head").first.get_by_role("button").last.click()
    page.locator(".wb-fell").wait_for()
    other = visitors.come(address, locale="en")
    other.goto(page.url)
    other.locator(".wb-fell").wait_for()
    other.get_by_role("button", name="Undo").click()
    other.locator(".wb-fell").wait_for(state="detached")
    run = page.url.partition("&")[0]
    other.goto(f"{run}&model=polynomial")
    other.locator(".wb-model select option:checked", has_text="polynomial").wait_for(state="attached")
    other.locator(".wb-tile").first.wait_for()
    other.goto(f"{run}&model=polynomiel")
    other.get_by_text("asks for the model “polynomiel”, which is not known here").wait_for()
    other.locator(".wb-tile").first.wait_for()


def test_a_zoom_by_keyboard_fetches_finer_data(page):
    held, free = [], []
    page.route("**/plotly*", lambda request: request.continue_() if free else held.append(request))
    choose(page)
    words = page.locator(".wb-words")
    words.filter(has_text="means over 2").wait_for()
    finer = words.filter(has_text="1 s means").filter(has_not_text="from 0.00 h")
    page.locator(".wb-plot").focus()
    for _ in range(5):  # its words come before it can be drawn: keys are kept for it
        page.keyboard.press("+")
    free.append(True)  # a request that comes later is not held
    for request in held:
        request.continue_()
    finer.wait_for()
    page.get_by_role("tab", name="Loop").click()
    only = page.locator(".wb-pictures .wb-chip", has_text="Only")
    only.wait_for()
    assert "zoom=h" in page.url
    page.reload()
    only.wait_for()
    page.get_by_role("tab", name="Over time").click()
    finer.wait_for()
    page.locator(".wb-plot").focus()
    page.keyboard.press("0")
    words.filter(has_text="from 0.00 h").wait_for()


ENDS = "() => document.querySelector('.wb-plot')._fullLayout.xaxis.range.slice()"


def test_a_figure_that_is_dragged_stays_within_its_data(page):
    choose(page)
    page.locator(".wb-plot .main-svg").first.wait_for()
    page.wait_for_function("document.querySelector('.wb-plot')._fullLayout?.xaxis.range")
    first, last = page.evaluate(ENDS)
    page.locator(".wb-plot").focus()
    page.keyboard.press("+")
    page.wait_for_url("**zoom=h*")
    before = page.evaluate(ENDS)
    box = page.locator(".wb-plot .nsewdrag").first.bounding_box()
    left, right, y = box["x"] + 5, box["x"] + box["width"] - 5, box["y"] + box["height"] / 2
    page.keyboard.down("Shift")  # moves instead of choosing a part
    for begin, end in ((left, right), (right, left)):
        for _ in range(2):
            page.mouse.move(begin, y)
            page.mouse.down()
            page.mouse.move(end, y, steps=4)
            page.mouse.up()
            low, high = page.evaluate(ENDS)
            assert first <= low < high <= last
        assert [low, high] != before, "it was dragged"
    page.keyboard.up("Shift")


def test_a_range_of_temperature_on_the_free_axes_is_in_the_address_and_holds_in_other_figures(page):
    choose(page)
    page.get_by_role("tab", name="Free axes").click()
    page.locator(".wb-words", has_text="over temperature of the unit").wait_for()
    page.locator(".wb-plot .main-svg").first.wait_for()
    page.locator(".wb-plot").focus()
    page.keyboard.press("+")
    page.wait_for_url("**zoom=degC*")
    page.get_by_role("tab", name="Over time").click()
    page.locator(".wb-pictures .wb-chip", has_text="whole").wait_for()
    page.get_by_role("tab", name="Free axes").click()
    page.get_by_label("Residual over").select_option("quadrature")
    page.locator(".wb-pictures .wb-chip", has_text="Only").wait_for()


@pytest.mark.parametrize(("over", "axis", "words"), [("dT_dt", "dT_dt", "over dT/dt"), ("time", "h", "over time")])
def test_a_range_of_any_free_abscissa_is_kept_by_the_address(page, over, axis, words):
    choose(page)
    page.get_by_role("tab", name="Free axes").click()
    page.get_by_label("Residual over").select_option(over)
    page.locator(".wb-words", has_text=words).wait_for()
    page.locator(".wb-plot .main-svg").first.wait_for()
    page.locator(".wb-plot").focus()
    page.keyboard.press("+")
    page.wait_for_url(f"**zoom={axis}%3A*")
    kept = "() => document.querySelector('.wb-plot')._fullLayout?.xaxis.range.map((end) => end.toPrecision(6)).join()"
    before = page.evaluate(kept)
    page.reload()
    page.locator(".wb-plot .main-svg").first.wait_for()
    assert page.evaluate(kept) == before
    page.get_by_role("tab", name="Loop").click()
    page.locator(".wb-words", has_text="over temperature").wait_for()
    assert page.locator(".wb-pictures .wb-chip").count() == (axis == "h"), "rows of this time, or all"


def test_figure_and_data_can_be_taken_away(page):
    choose(page)
    page.locator(".wb-words", has_text="MYSTERY").wait_for()
    files = {}
    for kind in ("PNG", "SVG", "CSV"):
        with page.expect_download() as download:
            page.locator(".wb-pictures").get_by_role("button", name=kind).click()
        files[kind] = download.value.path().read_bytes()
    assert files["PNG"].startswith(b"\x89PNG")
    assert b"<svg" in files["SVG"]
    assert b"deg/h" in files["SVG"]
    rows = list(csv.reader(io.StringIO(files["CSV"].decode())))
    assert rows[0][:2] == ["time [s]", "bias [deg/h]"]
    assert len(rows) > 300


def test_a_term_of_ones_own_is_checked_while_it_is_typed_added_and_saved(page, mystery):
    choose(page)
    diagnosed(page)
    term, said = page.get_by_label("User-defined term"), page.locator("#wb-term-check")
    term.fill("k * quadratur")
    said.filter(has_text="did you mean 'quadrature'").wait_for()
    term.fill("k * slew(temperature, v)")
    said.filter(has_text="fitted: k, v").wait_for()
    assert page.get_by_label("Smallest v").input_value() == "0.1"
    page.get_by_label("Largest v").fill("0,01")
    said.filter(has_text="low < high").wait_for()
    term.fill("k * time")
    said.filter(has_text=re.compile("fitted: k$")).wait_for()
    before = held_out(page)
    term.press("Enter")
    page.locator(".wb-fell").wait_for()
    assert held_out(page) < 0.5 * before
    written = page.get_by_role("textbox", name="formula of", exact=False)
    assert written.evaluate("(box) => box.scrollWidth <= box.clientWidth"), "a formula is seen whole"
    ends = "(box) => [box, box.closest('li')].map((one) => one.getBoundingClientRect().right)"
    field, line = written.evaluate(f"(box) => {{ box.value += ' + k'.repeat(40); return ({ends})(box); }}")
    assert field <= line, "a long one stays in its line"
    page.get_by_label("Save as model").fill("mine")
    page.get_by_label("Save as model").press("Enter")
    page.get_by_text("Saved as mine; it is in the list of models").wait_for()
    page.get_by_text("“time” needs time").or_(page.get_by_text("'time' needs time")).wait_for()
    assert "polynomial" in page.locator(".wb-save .wb-warn").inner_text(), "a model that a unit can hold"
    page.get_by_label("Save as model").fill("моя модель")
    page.get_by_label("Save as model").press("Enter")
    page.get_by_text("no spaces").wait_for()
    page.get_by_label("Save as model").fill("моя_модель")
    page.get_by_label("Save as model").press("Enter")
    page.get_by_text("Saved as моя_модель; it is in the list of models").wait_for()
    assert "k * time" in (mystery / "profiles" / "models" / "моя_модель.yaml").read_text()
    page.goto(page.url)
    page.get_by_label("Start with").select_option("моя_модель")
    page.get_by_role("textbox", name=re.compile("formula", re.IGNORECASE)).first.wait_for()
    values = [box.input_value() for box in page.locator(".wb-effects input.wb-code").all()]
    assert any("k * time" in value for value in values), values


def test_a_formula_of_ones_own_is_added_and_saved_by_keyboard_alone(page, mystery):
    def has_focus(target):
        target.and_(page.locator(":focus")).wait_for()

    page.get_by_role("link", name="Workbench").press("Enter")
    has_focus(page.get_by_role("combobox", name="Find a run"))
    page.keyboard.type("MYSTERY ramp")
    page.locator("[role=option]", has_text="MYSTERY").first.wait_for()
    page.keyboard.press("ArrowDown")
    page.keyboard.press("Enter")
    has_focus(page.get_by_role("heading", name="Workbench"))
    diagnosed(page)
    term = page.locator("#wb-term")
    press_tab_to(page, term)
    page.keyboard.type("k * time")
    page.locator("#wb-term-check", has_text=re.compile("fitted: k$")).wait_for()
    page.keyboard.press("Enter")
    page.locator(".wb-fell").wait_for()
    has_focus(term)
    press_tab_to(page, page.get_by_label("Save as model"))
    page.keyboard.type("by_keys")
    page.keyboard.press("Enter")
    page.get_by_text("Saved as").wait_for()
    press_tab_to(page, page.get_by_role("button", name="Undo"))
    page.keyboard.press("Enter")
    has_focus(page.get_by_role("heading", name="Model error"))
    press_tab_to(page, page.get_by_role("button", name="Redo"), most=2)


def test_the_range_of_a_parameter_in_a_formula_is_changed_in_place(page):
    choose(page)
    diagnosed(page)
    page.get_by_label("User-defined term").fill("k * lag(temperature, tau_s)")
    page.get_by_label("User-defined term").press("Enter")  # before the check has answered
    page.locator(".wb-ladder title", has_text="+ k * lag(temperature, tau_s)").wait_for(state="attached")
    effects = page.locator(".wb-effects")
    highest = effects.get_by_label("Largest tau_s")
    lowest = effects.get_by_label("Smallest tau_s")
    assert float(lowest.input_value()) < float(highest.input_value())
    highest.fill("1234,5")
    highest.press("Enter")
    page.wait_for_function("() => decodeURIComponent(location.href).includes('1234.5')")
    assert "{" not in "".join(box.input_value() for box in effects.get_by_role("textbox").all())


def test_a_long_computation_is_given_up_and_asked_again(page):
    page.route("**/jobs/*", lambda route: route.continue_() if route.request.method == "DELETE" else None)
    choose(page)
    missing = page.get_by_role("region", name="Missing effects")
    with page.expect_request(lambda request: request.method == "DELETE"):
        missing.get_by_role("button", name="Cancel").click()
    missing.get_by_text("Cancelled").wait_for()
    page.unroute_all(behavior="ignoreErrors")
    missing.get_by_role("button", name="Try again").click()
    page.locator(".wb-verdict").wait_for()


def test_what_is_being_typed_stays_while_the_page_is_drawn_again(page):
    held = []

    def pictured(request):
        """Whether a request is for the pictures of the diagnosis, not for its brief form."""
        return request.url.endswith("/diagnoses") and "brief" not in (request.post_data_json or {})

    page.route("**/diagnoses", lambda route: held.append(route) if pictured(route.request) else route.continue_())
    with page.expect_request(pictured):
        choose(page)
        diagnosed(page)
    box = page.get_by_label(re.compile("intervals", re.IGNORECASE)).first
    box.press("Control+A")
    box.press_sequentially("12")
    held[0].continue_()
    page.locator(".wb-further").wait_for()
    assert box.input_value() == "12"
    box.press("Enter")
    page.locator(".wb-fell").wait_for()


def test_an_option_that_cannot_be_is_refused_once(page, visitors):
    choose(page)
    diagnosed(page)
    visitors.of(page).forgives = re.compile("status of 400")
    box = page.get_by_label(re.compile("intervals", re.IGNORECASE)).first
    box.fill("-1")
    box.press("Tab")
    page.get_by_role("alert").first.wait_for()
    page.locator(".wb-pulse").first.wait_for(state="detached")
    page.wait_for_load_state("networkidle")
    assert ["intervals" in said for said in page.get_by_role("alert").all_inner_texts()] == [True]


def test_a_note_and_a_view_are_kept_with_the_run_and_opened_again(page):
    choose(page)
    page.get_by_role("tab", name="Loop").click()
    page.get_by_label("Note", exact=True).fill("Cable touched at 3 h")
    page.get_by_role("button", name="Add", exact=True).and_(page.locator(".wb-notes button")).click()
    page.locator(".wb-notes .wb-note", has_text="Cable touched").wait_for()
    page.get_by_label("Save this view as").fill("the loop")
    page.keyboard.press("Enter")
    page.get_by_role("link", name="the loop").wait_for()
    page.locator(".wb-plot .main-svg").first.wait_for()
    picture(page, "workbench-notes")
    assert Axe().run(page).response["violations"] == []
    page.goto("/workbench")
    choose(page)
    page.get_by_role("link", name="the loop").click()
    assert page.get_by_role("tab", name="Loop").get_attribute("aria-selected") == "true"
    page.get_by_role("button", name="Remove the view the loop").click()
    page.get_by_role("link", name="the loop").wait_for(state="detached")


POINT = """() => {
  const plot = document.querySelector('.wb-plot'), box = plot.getBoundingClientRect();
  const { xaxis, yaxis } = plot._fullLayout;
  const upper = plot._fullData.filter((trace) => (trace.yaxis ?? 'y') === 'y' && trace.hoverinfo !== 'skip');
  const { x, y } = upper.find((trace) => trace.x.length > 100);
  const middle = Math.floor(x.length / 2);
  return [box.x + xaxis._offset + xaxis.d2p(x[middle]), box.y + yaxis._offset + yaxis.d2p(y[middle])];
}"""


def point_at_a_row(page):
    """Move the mouse to a row in the middle of the first figure."""
    page.locator(".wb-plot .main-svg").first.wait_for()
    page.wait_for_function("document.querySelector('.wb-plot')._fullData")
    at = page.evaluate(POINT)
    page.mouse.move(at[0] - 3, at[1])
    page.mouse.move(*at)
    page.locator(".wb-plot .hoverlayer .hovertext").first.wait_for()


def compare(page):
    page.get_by_role("button", name="Compare").click()
    page.get_by_role("combobox", name="Compare with").fill("MYSTERY check")
    page.locator("[role=option]", has_text="Verification, minor loops").click()


def test_two_runs_are_compared(page, visitors, address):
    choose(page)
    compare(page)
    page.get_by_text("Conditions").or_(page.get_by_text("Segments")).first.wait_for()
    page.locator(".wb-words", has_text="MYSTERY").wait_for()
    with page.expect_download() as download:
        page.locator(".wb-pair-pictures").get_by_role("button", name="CSV").first.click()
    rows = list(csv.reader(io.StringIO(download.value.path().read_text())))
    assert rows[0] == ["run", "time [s]", "temperature [degC]", "bias [deg/h], minus its mean"]
    assert len({row[0] for row in rows[1:]}) == 2
    point_at_a_row(page)
    page.get_by_role("button", name="Back to the workbench").click()
    page.get_by_text("The dotted line is the moment").wait_for()
    point_at_a_row(page)
    compare(page)
    page.locator(".wb-compare").get_by_text("The dotted line is the moment").wait_for()
    page.reload()
    page.get_by_text("Conditions").or_(page.get_by_text("Segments")).first.wait_for()
    told = page.locator(".wb-compare").text_content()
    assert "Done, " in told
    assert not re.search(r"duration s|\^2", told)
    for locale, said in (("zh-CN", "变温至"), ("uk", "рампа до")):
        other = visitors.come(address, locale=locale)
        other.goto(page.url)
        compared = other.locator(".wb-compare")
        compared.get_by_text(said).first.wait_for(state="attached")
        compared.locator(".wb-words").first.filter(has_text="MYSTERY").wait_for()
        words = compared.text_content()
        assert not re.search(r"segments?\[|to_degc|ramp to|soak at|check_minor_loops|\d{8}T\d{6}Z", words), words
    page.get_by_role("button", name="Back to the workbench").click()
    page.reload()
    page.locator(".wb-verdict").wait_for()


LEGEND_ABOVE = """() => {
  const plot = document.querySelector('.wb-plot'), { width, yaxis } = plot._fullLayout;
  const bottom = plot.querySelector('.legend').getBoundingClientRect().bottom - plot.getBoundingClientRect().y;
  return Math.abs(width - plot.clientWidth) < 2 && bottom <= yaxis._offset + 1;
}"""
LADDER_AS_PAGE = """() => {
  const soft = getComputedStyle(document.documentElement).getPropertyValue('--soft').trim();
  return document.querySelector('.wb-ladder text').getAttribute('fill') === soft;
}"""


APART = """() => [...document.querySelectorAll('.wb-plot [class*="infolayer"] [class^="g-y"]')]
  .map((title) => title.getBoundingClientRect()).filter(({ height }) => height)
  .sort((a, b) => a.y - b.y).every(({ y }, at, all) => at === 0 || all[at - 1].bottom <= y)"""


def test_a_figure_speaks_the_language_that_is_chosen_beside_it(page):
    page.set_viewport_size({"width": 1366, "height": 768})
    choose(page)
    diagnosed(page)
    page.locator(".wb-suspect-head").get_by_role("button", name="Add").first.click()
    legend = page.locator(".wb-plot .legend")
    legend.filter(has_text="residual before").wait_for()
    assert "modelcompensated" in legend.text_content(), "names of effects that the page has other words for"
    for language, said in (("uk", "попередній залишок"), ("zh", "之前的残差")):
        page.locator(".bar select").select_option(language)
        legend.filter(has_text=said).wait_for()
        assert not re.search("[a-z]{3}", legend.text_content())
        page.wait_for_function(APART)
        page.locator(".wb-words").filter(has_text=re.compile(r"^[^+]*[а-я一-龥] \+ ")).wait_for()


def test_figures_follow_the_size_of_the_window_and_its_colours(page):
    choose(page)
    page.locator(".wb-plot .legend").wait_for()
    page.locator(".wb-ladder text").first.wait_for()
    for size in (PHONE, DESKTOP):
        page.set_viewport_size(size)
        page.wait_for_function(LEGEND_ABOVE)
    for scheme in ("dark", "light"):
        page.emulate_media(color_scheme=scheme)
        page.wait_for_function(LADDER_AS_PAGE)


def test_what_the_mouse_points_at_in_one_figure_is_marked_in_the_others(page):
    choose(page)
    point_at_a_row(page)
    page.get_by_role("tab", name="Over temperature").click()
    page.get_by_text("The dotted line is the moment").wait_for()
    page.locator('.wb-plot .shapelayer path[style*="dasharray"]').first.wait_for(state="attached")
    picture(page, "workbench-moment")


def test_what_the_mouse_points_at_in_overlaid_runs_is_marked_in_the_figure_of_that_run(page, mystery):
    check, ramp = (f"{path.parent.name}/{path.name}" for path in sorted(mystery.glob("MYSTERY-*/*_[cr]*")))
    asked = {"run": ramp, "check": check, "figure": "axes", "over": "dT_dt", "of": "all"}
    page.goto(f"/workbench?{urlencode(asked)}")
    point_at_a_row(page)
    page.get_by_label("Residual over").select_option("temperature")
    page.get_by_text("The dotted line is the moment").wait_for()
    picture(page, "workbench-overlaid-moment")
    page.get_by_role("tab", name="Over time").click()
    page.get_by_text("The dotted line is the moment").wait_for()
