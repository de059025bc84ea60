"""People at browsers: whatever their page complains about is remembered; pictures of it where they are wanted."""

import io
import os
import re
from pathlib import Path
from urllib.parse import urlsplit

PATIENCE_MS = 150_000
DESKTOP, TABLET, PHONE = ({"width": w, "height": h} for w, h in ((1440, 900), (820, 1180), (390, 844)))
PICTURES = os.environ.get("BENCH_SCREENS")
"""Folder for pictures of the pages; nothing is written without it."""
_COLOURS = 128
_POLICY = (
    "addEventListener('securitypolicyviolation', (e) => console.error('policy', e.violatedDirective, e.blockedURI))"
)
_DOWN = re.compile(
    r"ERR_CONNECTION_REFUSED|ERR_INCOMPLETE_CHUNKED|ERR_CONNECTION_RESET|ERR_EMPTY_RESPONSE|bench does not answer"
)


_CONFLICT = re.compile("status of 409 ")
_LATE = re.compile(r"status of 409 .*/api/v1/live/")
"""A run on a busy computer that does not answer at once; the page asks again."""


class Visitors:
    """Windows of one browser program that share nothing."""

    def __init__(self, chromium):
        self._chromium, self._all = chromium, []

    def come(self, address, **options):
        """A new window at the start page of `address`, not yet opened."""
        visitor = Visitor(self._chromium, address, **options)
        self._all.append(visitor)
        return visitor.page

    def of(self, page):
        return next(visitor for visitor in self._all if visitor.page is page)

    def may_lose_the_server(self, page):
        """The server is ended on purpose: that its requests fail is no complaint."""
        self.of(page).forgives = _DOWN

    def may_come_too_late(self, page):
        """Somebody else changed the file on purpose: that it is not written over is no complaint."""
        self.of(page).forgives = _CONFLICT

    def go(self):
        for visitor in self._all:
            visitor.context.close()
        complaints = [said for visitor in self._all for said in visitor.complaints]
        assert not complaints, "\n".join(complaints)


class Visitor:
    def __init__(self, chromium, address, *, size=DESKTOP, locale="en-GB", scheme="light", touch=False):
        self._origin, self._said, self.forgives = urlsplit(address)[:2], [], None
        self.context = chromium.new_context(
            base_url=address, viewport=size, locale=locale, color_scheme=scheme, reduced_motion="reduce",
            timezone_id="Europe/Kyiv", has_touch=touch,
        )  # fmt: skip
        self.context.set_default_timeout(PATIENCE_MS)
        self.context.add_init_script(_POLICY)
        self.context.on("request", self._asked)
        self.page = self.context.new_page()
        self.page.on("console", self._told)
        self.page.on("pageerror", lambda error: self._said.append(str(error)))

    def _told(self, message):
        said = f"{message.text} {message.location.get('url', '')}"
        if message.type in {"error", "warning"} and not _LATE.search(said):
            self._said.append(said)

    def _asked(self, request):
        parts = urlsplit(request.url)
        if parts.scheme not in {"data", "blob", "chrome", "chrome-extension"} and parts[:2] != self._origin:
            self._said.append(f"asked another machine: {request.url}")

    @property
    def complaints(self):
        return [said for said in self._said if not (self.forgives and self.forgives.search(said))]


def picture(page, name, **options):
    """A picture of the window for the documentation, with few colours, if pictures are wanted."""
    if not PICTURES:
        return
    from PIL import Image

    png = page.screenshot(animations="disabled", caret="hide", **options)
    few = Image.open(io.BytesIO(png)).convert("RGB").quantize(_COLOURS, dither=Image.Dither.NONE)
    folder = Path(PICTURES)
    folder.mkdir(parents=True, exist_ok=True)
    few.save(folder / f"{name}.png", optimize=True)


_SAID = """() => {
  const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT), said = [];
  for (let node = walker.nextNode(); node; node = walker.nextNode())
    if (!node.parentElement.closest('code, noscript, textarea, script, style, .mono, .wb-code'))
      said.push(node.data.trim());
  for (const element of document.querySelectorAll('[aria-label], [title], [placeholder]'))
    for (const name of ['aria-label', 'title', 'placeholder']) said.push(element.getAttribute(name) ?? '');
  return said.filter(Boolean);
}"""
_ENGLISH = re.compile(r"\b[a-z]{2,}(?: [a-z]{2,}){2,}")


def axe(page):
    """Violations of moderate, serious and critical impact: rule, what it wants, where."""
    from axe_playwright_python.sync_playwright import Axe

    found = Axe().run(page).response
    return [
        (one["id"], one["help"], node["target"], node.get("failureSummary"))
        for one in found["violations"]
        if one["impact"] in {"moderate", "serious", "critical"}
        for node in one["nodes"]
    ]


def english(page):
    """Runs of English words, without what people or files have named, once the sentences have been fetched."""
    for _ in range(100):
        found = [text for text in page.evaluate(_SAID) if _ENGLISH.search(re.sub(r"`[^`]*`", "", text))]
        if not found:
            break
        page.wait_for_timeout(100)
    return found


def day_and_night(page):
    """What is not accessible, in light and in dark colours."""
    found = []
    for scheme in ("dark", "light"):
        page.emulate_media(color_scheme=scheme)
        page.wait_for_function("(scheme) => document.documentElement.dataset.theme === scheme", arg=scheme)
        found += axe(page)
    return found
