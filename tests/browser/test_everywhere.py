"""Requirements of every page: accessible, in three languages, light and dark, without requests to other machines.

Pictures of the pages are made on the way where `BENCH_SCREENS` names a folder for them.
"""

import re
from dataclasses import dataclass

import pytest

from bench.base import library
from bench.commands.lots import calibrate_lot
from bench.mystery.mystery import make_mystery
from bench.web.people import people
from tests.support.bench_project import LONG, SLOW_UNIT, bench_over
from tests.support.fleet_runs import line
from tests.support.page_modules import catalogue
from tests.support.run_folders import make_run, ramp_run
from tests.support.servers import serving
from tests.support.unit_history import UNIT, unit_with_history
from tests.support.visiting import DESKTOP, PHONE, TABLET, axe, english, picture

SEED = 7  # hides `aging`
GIVEN = {"simulated", "ramp"}
"""Names of a station and of segments, given by their files, that happen to be English words."""


@dataclass(frozen=True)
class Place:
    """A page: its name in pictures, its address, and what is there when it is complete."""

    name: str
    address: str
    there: str


PLACES = [
    Place("start", "/", "#serial"),
    Place("plans", "/start?unit={slow}&station=unhurried", "button.plan svg"),
    Place("ready", "/start?unit={slow}&station=unhurried&plan=short", "button.giant"),
    Place("verdict", "/verdict/{ended}", "h1"),
    Place("workbench", "/workbench", "[role=option]"),
    Place("workbench-run", "/workbench?run={mystery}", ".wb-verdict"),
    Place("calibrations", "/calibrations", "h1"),
    Place("laboratory", "/laboratory?station=simulated", "#equipment"),
    Place("run", "/runs/{ended}", "#run-unit"),
    Place("lot", "/runs/{lot}", "#run-unit"),
    Place("lot-verdict", "/verdict/{lot}", "#run-unit"),
    Place("files", "/files?kind=profiles&id=short", "svg.curve"),
    Place("units", "/units", "table a"),
    Place("unit", "/units/{unit}", ".main-svg"),
    Place("fleet", "/fleet", ".main-svg"),
    Place("import", "/import", ".st-drop"),
    Place("nowhere", "/live/nowhere", "h1"),
    Place("live", "/live/{live}", ".segment-words"),
    Place("live-all", "/live", ".segment-words"),
]
PICTURED = {"start", "ready", "live", "workbench-run", "unit", "fleet"}
"""Of these also dark and on a tablet."""


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """A fleet, a unit with a history, and a mystery."""
    out = tmp_path_factory.mktemp("everything")
    ended = unit_with_history(out)[-1]
    line(out, 48, odd=20)
    profiles = library()
    made = make_mystery(SEED, 1, out, profiles / "ramp_-40_85.yaml", profiles / "check_minor_loops.yaml")
    units = [make_run(out / f"LT-{n}" / "20261101T000000Z_ramp", unit=f"LT-{n}", **ramp_run(seed=n)) for n in range(3)]
    lot = calibrate_lot(units, "LOT-7", "polynomial", out).run
    return out, made.run, ended, lot


@pytest.fixture(scope="module")
def bench(runs, project):
    """A server over all of it, with the registry made."""
    out, *_ = runs
    with bench_over(out, project) as bench:
        bench.client.post("/registry", json={}).raise_for_status()
        yield bench


def going(bench):
    """The id of a live run in the middle of a ramp; it takes a core for itself."""
    run = bench.start(plan=LONG, station="unhurried", units=[SLOW_UNIT])
    bench.moving(run)
    return run


@pytest.fixture(scope="module")
def names(runs):
    """Names in the addresses; a live run, once it is there, is that of all tests."""
    mystery, ended, lot = (f"{run.parent.name}/{run.name}" for run in runs[1:])
    return {"slow": SLOW_UNIT, "mystery": mystery, "ended": ended, "lot": lot, "unit": UNIT}


def go(page, place, names, bench):
    if place.name.startswith("live") and "live" not in names:
        names["live"] = going(bench)
    page.goto(place.address.format(**names))
    page.locator(place.there).first.wait_for()
    if place.name == "ready":
        page.locator("button.giant:enabled").wait_for()
    if place.name == "workbench-run":
        page.locator(".wb-plot .main-svg").first.wait_for()
    page.locator(".spinner").first.wait_for(state="detached")
    page.evaluate("document.fonts.ready")


SAID = """() => {
  const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT), said = [];
  for (let node = walker.nextNode(); node; node = walker.nextNode())
    if (!node.parentElement.closest('[lang=en], script, style, .main-svg, option')) said.push(node.data.trim());
  for (const element of document.querySelectorAll('[aria-label], [title], [placeholder]'))
    if (!element.closest('[lang=en], .main-svg'))
      for (const name of ['aria-label', 'title', 'placeholder']) said.push(element.getAttribute(name) ?? '');
  return [document.title, ...said].filter(Boolean);
}"""


SMALL = """() => [...document.querySelectorAll('main :is(button, a, select, input:not([type=checkbox], [type=radio]))')]
  .filter((one) => one.checkVisibility() && getComputedStyle(one).display !== 'inline' && !one.closest('.unseen'))
  .map((one) => [one.outerHTML.slice(0, 80), one.offsetWidth, one.offsetHeight])
  .filter(([, width, height]) => width < 24 || height < 24)"""
# The name and the tools of the bar share their middle. Both are measured at one moment: a window
# that has just been made narrow is laid out again between two questions.
ONE_LINE = """() => {
  const [name, tools] = [".brand", ".tools"].map((part) => document.querySelector(part).getBoundingClientRect());
  return Math.abs(name.top + name.height / 2 - tools.top - tools.height / 2) <= 4;
}"""
COLOUR = """(one, name) => {
  const probe = one.appendChild(document.createElement("i"));
  probe.style.backgroundColor = `var(${name})`;
  const colour = getComputedStyle(probe).backgroundColor;
  probe.remove();
  return colour;
}"""


def untranslated(said, language):
    """Texts that are a key, have a placeholder left, or are English though this language has another word."""
    english, own = map(catalogue, ("en", language))
    heads = "|".join(sorted({re.escape(key.split(".")[0]) for key in english}))
    key = re.compile(rf"^({heads})\.[a-z0-9_.-]+$")
    foreign = {text for name, text in english.items() if isinstance(text, str) and own[name] != text}
    foreign -= {text for text in own.values() if isinstance(text, str)} | GIVEN
    return [text for text in said if key.match(text) or re.search(r"\{\w+\}", text) or text in foreign]


@pytest.mark.parametrize("place", PLACES, ids=lambda place: place.name)
def test_everybody_can_use_the_page_by_day_at_night_on_a_tablet_and_on_a_telephone(bench, names, visitors, place):
    page = visitors.come(bench.site.address)
    for scheme in ("light", "dark"):
        page.emulate_media(color_scheme=scheme)
        go(page, place, names, bench)
        assert page.evaluate("document.documentElement.dataset.theme") == scheme
        if scheme == "light" or place.name in PICTURED:
            picture(page, f"{place.name}-{scheme}" if scheme == "dark" else place.name)
        assert axe(page) == []
    assert untranslated(page.evaluate(SAID), "en") == []
    for size, name in ((TABLET, "tablet"), (PHONE, "phone")):
        page.set_viewport_size(size)
        page.wait_for_function("() => document.documentElement.scrollWidth <= innerWidth")  # nothing sideways
        assert page.evaluate(SMALL) == [], "each can be touched: WCAG 2.2, 2.5.8"
        picture(page, f"{place.name}-{name}")


@pytest.mark.parametrize("language", ["uk", "zh"])
def test_no_page_shows_a_missing_word(bench, names, visitors, language):
    page = visitors.come(bench.site.address, locale=language, size=DESKTOP)
    wrong = {}
    for place in PLACES:
        go(page, place, names, bench)
        if place.name in {"live", "ready"}:
            picture(page, f"{place.name}-{language}")
        if found := untranslated(page.evaluate(SAID), language):
            wrong[place.name] = found
        if place.name == "lot":
            assert english(page) == []
    assert wrong == {}


def test_who_must_sign_in_is_asked_for_a_token(tmp_path, visitors):
    access = tmp_path / "access.yaml"
    token = people.add_person(access, "kiosk", "viewer")
    pin = people.add_pin(access, "Olena", "operator")
    with serving(tmp_path / "out", "--access", str(access)) as address:
        page = visitors.come(address)
        page.goto("/units?q=GX-1")
        page.get_by_label("Token").wait_for()
        picture(page, "login")
        assert axe(page) == []
        page.get_by_label("Token").fill(token)
        page.keyboard.press("Enter")
        page.get_by_role("heading", name="Units").wait_for()
        assert page.url.endswith("/units?q=GX-1"), "what was asked for is shown"
        assert page.get_by_role("link", name="Start").count() == 0
        page.goto("/")
        page.get_by_role("heading", name="Who works here?").wait_for()
        assert axe(page) == []
        page.set_viewport_size(PHONE)
        page.wait_for_function(ONE_LINE)
        page.set_viewport_size(DESKTOP)
        visitors.of(page).forgives = re.compile("status of 401")
        page.get_by_role("button", name="Operator").click()
        dialog = page.get_by_role("dialog")
        enter = dialog.get_by_role("button", name="Sign in")
        assert enter.evaluate("(one) => getComputedStyle(one).backgroundColor") == enter.evaluate(COLOUR, "--action")
        for typed in ("0000000", pin):
            dialog.get_by_label("PIN or badge").fill(typed)
            page.keyboard.press("Enter")
            if typed != pin:
                page.get_by_text("This PIN or badge is not known").wait_for()
                picture(page, "pin")
                assert axe(page) == []
        page.get_by_role("link", name="Start").wait_for()
        page.get_by_text("Olena").wait_for()
        page.get_by_role("button", name="Leave the screen").click()
        page.get_by_role("link", name="Start").wait_for(state="detached")
        page.context.close()


@pytest.mark.parametrize("address", ["/nowhere/at/all", "/units/%zz"])
def test_an_address_that_does_not_exist_is_said_with_a_way_on(bench, visitors, address):
    page = visitors.come(bench.site.address)
    visitors.of(page).forgives = re.compile("status of 404")
    page.goto(address)
    page.get_by_role("heading", name="Page not found").wait_for()
    assert axe(page) == []
    page.get_by_role("main").get_by_role("link", name="Start").click()
    page.locator("#serial").wait_for()


def test_a_run_that_was_cut_off_has_no_verdict_but_a_sentence_and_a_way_on(bench, runs, visitors):
    cut = "CUT-1/20261101T000000Z_ramp_-40_85"
    (runs[0] / cut / "journal").mkdir(parents=True)
    page = visitors.come(bench.site.address)
    visitors.of(page).forgives = re.compile("status of 409")
    page.goto(f"/verdict/{cut}")
    page.get_by_text("was cut off before its end").wait_for()
    assert str(runs[0]) not in page.content(), "no path of the server"
    assert axe(page) == []
    page.get_by_role("link", name="Deliver and check").click()
    page.get_by_role("heading", name="CUT-1").wait_for()
    named = " ".join(page.locator(".st-head .soft").inner_text().split())
    assert re.fullmatch(r"Calibration, −40 to 85 °C · [^–·]* 2026[^–·]*", named)


def test_a_page_that_was_left_holds_no_connection(bench, visitors):
    """A browser has six of them for a server, and keeps pages that were left, for its button `Back`."""
    page = visitors.come(bench.site.address)
    for place in ("/live", "/calibrations", "/import", "/laboratory") * 2:
        page.goto(place, timeout=20_000)
        page.locator("h1").wait_for()
    with page.expect_request("**/live/stream"):
        page.go_back()


def test_a_request_to_another_machine_would_be_noticed(bench, visitors):
    page = visitors.come(bench.site.address)
    page.goto("/")
    with page.expect_console_message():
        page.evaluate("fetch('http://127.0.0.1:9/').catch(() => 0)")
    visitor = visitors.of(page)
    assert any("connect-src" in said for said in visitor.complaints)
    visitor.forgives = re.compile("")
