"""The page calls somebody who is not looking: a sound, and a notice of the browser."""

from tests.support.visiting import TABLET

HEARD = """
window.heard = [];
window.Notification = class { constructor(title) { heard.push(title); } };
Notification.permission = "granted";
Notification.requestPermission = () => heard.push("asked");
const original = AudioContext.prototype.createOscillator;
AudioContext.prototype.createOscillator = function () { heard.push("tone"); return original.call(this); };
"""
ENDS = """import(document.querySelector('script[type=module]').src).then(({ live }) => {
  const run = { run: "G-1/r1", state: "running", condition: "live", units: [], serials: [], segment: null };
  live.set({ ...live.get(), runs: [run] });
  live.set({ ...live.get(), runs: [], ended: { "G-1/r1": { run: "G-1/r1" } } });
})"""
BELL = "Call me: a sound and a notice when a run ends, holds or is lost"


def test_the_page_calls_where_somebody_asked_for_it(site, visitors, tmp_path):
    page = visitors.come(site[0], size=TABLET)
    page.add_init_script(HEARD)
    page.goto("/units")
    bell = page.get_by_role("button", name=BELL)
    assert bell.get_attribute("aria-pressed") == "false"
    page.evaluate(ENDS)
    assert page.evaluate("heard") == []
    bell.click()
    assert page.evaluate("heard") == ["tone", "asked"]
    page.reload()
    assert bell.get_attribute("aria-pressed") == "true"
    page.evaluate(ENDS)
    assert page.evaluate("heard") == ["tone", "G-1 r1 has ended"]
    page.screenshot(path=tmp_path / "bell.png", clip={"x": 0, "y": 0, "width": 820, "height": 80})
    bell.click()
    page.evaluate("heard.length = 0")
    page.evaluate(ENDS)
    assert page.evaluate("heard") == []


def test_a_browser_that_shows_no_notices_is_not_stopped_by_one(site, visitors):
    """Chrome on a telephone has them, grants them, and refuses to make one."""
    page = visitors.come(site[0])
    page.add_init_script(
        HEARD + 'window.Notification = class { static permission = "granted"; constructor() { throw TypeError(); } };'
    )
    page.add_init_script("localStorage.setItem('bench.calling', 'true')")
    page.goto("/units")
    page.get_by_role("button", name=BELL, pressed=True).wait_for()
    page.evaluate(ENDS)
    assert page.evaluate("heard") == ["tone"]
