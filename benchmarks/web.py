"""The page, measured in a real browser: `python -m benchmarks.web [--updates 432000] [--docs]`.

First page, a day of live updates at 5 Hz without growing, the server's work for each browser, the filter of 10,000
runs, and the time to find a hidden effect. Prints one Markdown table; `--docs` also writes it to docs/web.md.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import shutil
import statistics
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from time import perf_counter, sleep
from typing import Any

import httpx
from playwright.sync_api import Browser, Page, sync_playwright

from bench.base import library
from bench.mystery.mystery import make_mystery

DOCS = Path(__file__).parent.parent / "docs" / "web.md"
MARKS = "<!-- measured: begin -->", "<!-- measured: end -->"
QUIET = ("--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-background-networking", "--js-flags=--expose-gc")
DAY_UPDATES = 5 * 86_400
ROUNDS = 10
USABLE = """(() => {
  const look = () => {
    if (document.activeElement?.id === "serial") globalThis.usable_ms = performance.now();
    else requestAnimationFrame(look);
  };
  look();
})()"""
COUNT = """import(document.querySelector('script[type=module]').src).then(({ live }) => {
  live.subscribe(() => {
    globalThis.updates = (globalThis.updates ?? 0) + 1;
    globalThis.seen_s = live.get().runs[0]?.t_s;
  });
})"""
DRAWN = """(ticks) => new Promise((done) => {
  const look = () => {
    if (globalThis.seen_s >= ticks) requestAnimationFrame(() => requestAnimationFrame(done));
    else setTimeout(look, 2);
  };
  look();
})"""
BURST = 256
"""Updates between two frames that are really shown; a flood without frames would measure the flood."""
Row = tuple[str, str]


@contextmanager
def child(*command: str) -> Iterator[tuple[Any, str]]:
    """Process and address of a server; ended with the block."""
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
    with subprocess.Popen(
        [sys.executable, *command],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=environment,
    ) as process:  # fmt: skip
        assert process.stdout
        said = iter(process.stdout)
        found = next((found for line in said if (found := re.search(r"http://127[^\s\"/]+", line))), None)
        rest = threading.Thread(target=process.stdout.read, daemon=True)
        rest.start()
        try:
            yield process, found.group(0) if found else ""
        finally:
            process.terminate()
            rest.join()


def ui(out: Path) -> Any:
    code = "from bench.cli import main; main()"
    return child("-c", code, "ui", "--port", "0", "--no-browser", "--out", str(out))


def first_page(browser: Browser, address: str) -> Row:
    """From the navigation to the serial field having the focus, each time with an empty cache [s]."""
    took = []
    for _ in range(ROUNDS):
        context = browser.new_context(base_url=address)
        context.add_init_script(USABLE)
        page = context.new_page()
        page.goto("/")
        took.append(page.wait_for_function("() => globalThis.usable_ms").json_value() / 1000)
        context.close()
    spread = f"{min(took):.2f} to {max(took):.2f}"
    return "first page, cold cache, until the serial field is usable", f"{statistics.median(took):.2f} s ({spread})"


def resident_mib(pid: int) -> float:
    """Memory of the server process; its computing processes are idle."""
    return int(re.search(r"VmRSS:\s+(\d+)", Path(f"/proc/{pid}/status").read_text(encoding="utf-8"))[1]) / 1024  # type: ignore[index]


def cpu_s(pid: int) -> float:
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def weighed(page: Page) -> dict[str, float]:
    """Memory of the page after a garbage collection."""
    session = page.context.new_cdp_session(page)
    for _ in range(3):
        session.send("HeapProfiler.collectGarbage")
    heap = session.send("Runtime.getHeapUsage")["usedSize"] / 2**20
    nodes = session.send("Memory.getDOMCounters")
    session.detach()
    return {"heap": heap, "nodes": nodes["nodes"], "listeners": nodes["jsEventListeners"]}


def go_on(process: Any, ticks: int) -> None:
    process.stdin.write(f"{ticks}\n")
    process.stdin.flush()


def renderer(browser: Browser) -> int:
    """Renderer process of the page: the largest one."""
    session = browser.new_browser_cdp_session()
    found = session.send("SystemInfo.getProcessInfo")["processInfo"]
    session.detach()
    return max((int(one["id"]) for one in found if one["type"] == "renderer"), key=resident_mib)


def a_day(browser: Browser, out: Path, updates: int, rest_s: float = 2.0) -> list[dict[str, float]]:
    """The live page through as many updates as a day has at 5 Hz, as fast as possible; memory is measured at rest."""
    measured = []
    with child("-m", "benchmarks.web_source", str(out), "0") as (process, address):
        page = browser.new_context(base_url=address, viewport={"width": 1440, "height": 900}).new_page()
        page.goto("/live/SIM-0001/day")
        page.get_by_role("progressbar").wait_for()
        page.evaluate(COUNT)
        ticks = 1
        # The trace is full for the first time after 4096 ticks: what counts is what happens then.
        for mark in (updates // 64, *(eighth * updates // 8 for eighth in range(1, 9))):
            while ticks < mark:
                ticks = min(ticks + BURST, mark)
                go_on(process, ticks)
                page.evaluate(DRAWN, ticks)
            sleep(rest_s)
            before, seen = resident_mib(renderer(browser)), weighed(page)
            after, server = resident_mib(renderer(browser)), resident_mib(process.pid)
            shown = page.evaluate("globalThis.updates")
            measured.append({**seen, "updates": shown, "before": before, "after": after, "server": server})
            print(*day_row(measured[-1]), flush=True)
        page.context.close()
    return measured


def day_row(seen: dict[str, float]) -> Row:
    """One measurement of `a_day` as a row of the table."""
    return (
        f"live page after {seen['updates']:,.0f} updates",
        f"heap {seen['heap']:.1f} MiB, {seen['nodes']:.0f} nodes, {seen['listeners']:.0f} listeners; "
        f"its process at the end of the burst {seen['before']:.0f}, then {seen['after']:.0f} MiB, "
        f"server {seen['server']:.0f} MiB",
    )


def per_browser(out: Path) -> Row:
    """The server's processor time for one more browser at 5 Hz [% of one core]."""
    shares = {}
    for count in (1, 21):
        with child("-m", "benchmarks.web_source", str(out / str(count)), "5") as (process, address):
            go_on(process, DAY_UPDATES)
            threads = [threading.Thread(target=_listen, args=(address,), daemon=True) for _ in range(count)]
            for thread in threads:
                thread.start()
            sleep(5)
            begin, before = perf_counter(), cpu_s(process.pid)
            sleep(20)
            shares[count] = 100 * (cpu_s(process.pid) - before) / (perf_counter() - begin)
    each = (shares[21] - shares[1]) / 20
    return "server at 5 Hz, of one core", f"{shares[1]:.1f} % with one browser, {each:.2f} % for each further one"


def _listen(address: str) -> None:
    try:
        with httpx.stream("GET", f"{address}/api/v1/live/stream", timeout=60, trust_env=False) as answer:
            for _ in answer.iter_raw():
                pass
    except httpx.HTTPError:
        pass


def mystery(root: Path) -> Path:
    profiles = library()
    return make_mystery(7, 1, root, profiles / "ramp_-40_85.yaml", profiles / "check_minor_loops.yaml").run


def filtered(browser: Browser, out: Path, run: Path) -> Row:
    """From a word typed into the list of 10,000 runs to the filtered list."""
    for i in range(10_000):
        folder = out / f"U-{i // 20:04d}" / f"2026{1 + i % 12:02d}{1 + i % 28:02d}T{i % 20:02d}0000Z_ramp"
        folder.mkdir(parents=True)
        manifest = {**json.loads((run / "manifest.json").read_text()), "unit": f"U-{i // 20:04d}", "files": {}}
        (folder / "manifest.json").write_text(json.dumps(manifest))
    with ui(out) as (_, address):
        page = browser.new_context(base_url=address, locale="en").new_page()
        page.goto("/workbench")
        page.get_by_text("10,000 of 10,000 runs").wait_for()
        took = []
        for number in range(ROUNDS):
            field, unit = page.get_by_role("combobox", name="Find a run"), f"u-0{number % 5}{number}3"
            begin = perf_counter()
            field.fill(unit)
            page.get_by_text("20 of 10,000 runs").wait_for()
            took.append(perf_counter() - begin)
            field.fill("")
            page.get_by_text("10,000 of 10,000 runs").wait_for()
        page.context.close()
    return (
        "filter of 10,000 runs, from typing to the list",
        f"{statistics.median(took):.2f} s ({max(took):.2f} at most)",
    )


READ_S = 5.0
"""Time that somebody reads the list of runs before choosing one; the computing processes start meanwhile [s]."""


def hidden_effect(browser: Browser, out: Path) -> list[Row]:
    """From the server's start, and from the choice of an 8-hour run, to the refitted model without the error."""
    began = perf_counter()
    with ui(out) as (_, address):
        ready = perf_counter() - began
        httpx.get(f"{address}/api/v1/session", trust_env=False)
        answering = perf_counter() - began
        page = browser.new_context(base_url=address, locale="en", viewport={"width": 1440, "height": 900}).new_page()
        clicks: list[int] = []
        page.expose_function("clicked", lambda: clicks.append(1))
        page.goto("/")
        page.evaluate("addEventListener('click', () => clicked(), true)")
        page.get_by_role("link", name="Workbench").click()
        run = page.locator("[data-run*=ramp_-40_85]").first
        run.wait_for()
        sleep(READ_S)
        chosen = perf_counter()
        run.click()
        page.locator(".wb-plot .main-svg").first.wait_for(timeout=180_000)
        drawn = perf_counter() - chosen
        page.locator(".wb-verdict").wait_for(timeout=180_000)
        named = perf_counter() - chosen
        before = page.locator(".wb-tile b").first.inner_text()
        pressed = perf_counter()
        page.get_by_role("button", name=re.compile("^Add:? Aging")).first.click()
        page.locator(".wb-fell").wait_for()
        fell = perf_counter() - pressed
        after = page.locator(".wb-tile b").first.inner_text()
        page.context.close()
    return [
        ("server, from its start to its address; to the first answer of its API", f"{ready:.1f} s; {answering:.1f} s"),
        ("first figure of an 8-hour run, from choosing it", f"{drawn:.1f} s"),
        ("hidden effect named, from choosing the run", f"{named:.1f} s"),
        (
            "from *Add* to the lower error",
            f"{fell:.1f} s, {before} → {after} deg/h held out, {len(clicks)} clicks in all",
        ),
    ]


def table(rows: list[Row]) -> str:
    return "\n".join(["| what | measured |", "|---|---|", *(f"| {what} | {value} |" for what, value in rows)])


def write(text: str) -> None:
    begin, end = MARKS
    before, _, rest = DOCS.read_text().partition(begin)
    DOCS.write_text(f"{before}{begin}\n{text}\n{end}{rest.partition(end)[2]}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--updates", type=int, default=DAY_UPDATES, help="of the live page (default: a day at 5 Hz)")
    parser.add_argument("--only", choices=("first", "day", "cpu", "filter", "effect"), action="append")
    parser.add_argument("--docs", action="store_true", help="put the table into docs/web.md")
    parser.add_argument("--chromium", default="/usr/bin/chromium")
    wanted = parser.parse_args()
    parts = wanted.only or ["first", "effect", "filter", "cpu", "day"]
    rows: list[Row] = []
    root = Path(tempfile.mkdtemp(prefix="bench-web-"))
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=wanted.chromium, args=list(QUIET))
        if "first" in parts:
            with ui(root / "none") as (_, address):
                rows.append(first_page(browser, address))
                print(rows, flush=True)
        if {"effect", "filter"} & set(parts):
            run = mystery(root / "mystery")
        if "effect" in parts:
            rows += hidden_effect(browser, root / "mystery")
            print(rows, flush=True)
        if "filter" in parts:
            rows.append(filtered(browser, root / "many", run))
            print(rows[-1], flush=True)
        if "cpu" in parts:
            rows.append(per_browser(root / "cpu"))
        if "day" in parts:
            rows += map(day_row, a_day(browser, root / "day", wanted.updates))
        browser.close()
    shutil.rmtree(root, ignore_errors=True)
    print(table(rows))
    if wanted.docs:
        write(table(rows))


if __name__ == "__main__":
    main()
