"""The documentation is correct: its commands run, its links exist, README and CI agree."""

import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from bench.record import load
from tests.support.calibrated import check_calibrated
from tests.support.shown import fences, unlike

ROOT = Path(__file__).parent.parent
PAGES = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md")])


README, TUTORIAL, WEB = "README.md", "docs/tutorial.md", "docs/web.md"
JOURNEYS = {
    "one unit": [f"docs/howto/{page}.md" for page in ("production", "runs", "delivery", "centre")],
    "equipment": [f"docs/howto/{page}.md" for page in ("chamber_map", "lines", "instruments")],
}
"""Pages that are pasted one after the other into one folder, each into a shell of its own."""


def blocks(page):
    """Commands of a page that a reader pastes, those above them that the page does not show, and its files."""
    names: list[str] = []
    for said, _, text in fences(page):
        if said.startswith("file: "):
            yield f"cat > {said.removeprefix('file: ')} <<'END'\n{text}END\n"
    for said, language, text in fences(page):
        if language == "bash" and not said.startswith(("not run: ", "command: ")):
            first = said.removeprefix("first:")
            names += re.findall(r"^([A-Z]+\d?)=", first, re.MULTILINE)
            named = "|".join(names) or "(?!)"
            yield first + "\n" + re.sub(rf"(?<![\w$-])({named})\b", r"$\1", text)


def bash(script, folder):
    """Output of a script, run in a folder by a shell that stops at the first failure."""
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    done = subprocess.run(
        ["bash", "-euo", "pipefail", "-c", script],
        cwd=folder,
        env={**os.environ, "PATH": path},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, f"{script}\n{done.stdout}\n{done.stderr}"
    return done.stdout


def check_measured(folder, said):
    [run] = (folder / "measured" / "SIM-0001").glob("*_quick")
    assert load(run, 30.0).channel("supply_current") == pytest.approx(0.15)


def check_recomputed(folder, said):
    assert "identical; tables and results recomputed from its raw frames" in said


CHECKS = {
    "docs/howto/production.md": check_calibrated,
    "docs/howto/runs.md": check_recomputed,
    "docs/howto/instruments.md": check_measured,
}
"""What is right about a page besides the outputs that it shows, from its folder and what its commands said."""


def compare(page, said, folder):
    """The outputs that a page shows are what its commands said, to the last digit; `shown by:` has one of its own."""
    for comment, language, shown in fences(page):
        if not language and not comment:
            assert not unlike(shown, said), f"{page} shows what its commands do not say:\n{said}"
        elif comment.startswith("shown by: "):
            assert not unlike(shown, bash(f"{{ {comment.removeprefix('shown by: ')}; }} 2>&1 || true", folder)), page


@pytest.mark.slow(first=True)
@pytest.mark.timeout(1800)
def test_the_tutorial_goes_on_where_the_readme_ends_and_runs_to_its_calibration(tmp_path):
    started = "\n".join(blocks(README))
    compare(README, bash(started, tmp_path), tmp_path)
    (folder,) = tmp_path.iterdir()
    init, check, run, *commands, calibrate = blocks(TUTORIAL)
    assert init.strip() == "bench init ."
    # Both pages, and a how-to that a journey runs, have the same commands.
    for command in (check, run):
        assert re.search(rf"^{re.escape(command.strip().removesuffix(' --quiet'))} ", started, re.MULTILINE)
    assert calibrate.strip().removesuffix(" --quiet") in (ROOT / "docs" / "howto" / "production.md").read_text()
    said = bash("\n".join(commands), folder)
    compare(TUTORIAL, said, folder)
    assert "Missing: aging" in said
    assert re.search(r"^right +aging$", said, re.MULTILINE)
    assert list(folder.glob("reports/SIM-0001/*/report.html"))
    assert list(folder.glob("reports/MINE/*/data.parquet"))


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_the_commands_about_the_page_run_in_one_shell(tmp_path):
    said = bash("\n".join(blocks(WEB)), tmp_path)
    assert re.search(r'"request".*"who": ?"\S+ \(engineer\) from 127.0.0.1"', said)
    assert '"safe":true' in said
    assert '"/api/v1/starts/{start}"' in said


@pytest.mark.slow(first=True)
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("journey", JOURNEYS)
def test_the_commands_of_the_pages_run_from_the_first_to_the_last(tmp_path, journey):
    for page in JOURNEYS[journey]:
        said = bash("\n".join(blocks(page)), tmp_path)
        compare(page, said, tmp_path)
        CHECKS.get(page, lambda folder, said: None)(tmp_path, said)


def test_every_command_of_the_pages_is_run_or_says_why_not():
    run = {page for pages in JOURNEYS.values() for page in pages} | {README, TUTORIAL, WEB}
    for page in (str(page.relative_to(ROOT)) for page in PAGES):
        for said, language, text in fences(page):
            command = re.match(r"(bench|pip|python|git|curl|export|bash|sphinx-build) ", text)
            assert language or not command, f"{page}: mark this block as bash:\n{text}"
            if language == "bash":
                assert page in run or said.startswith("not run: "), f"{page} is in no journey:\n{text}"
            if language == "text" or not language:
                told = page in run and not said and not language
                told = told or said.startswith(("shown by: ", "ci: ", "not run: ", "drawing", "command: ", "test: "))
                assert told, f"{page} shows an output that nothing compares; say why in a comment:\n{text}"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_between_pages_lead_somewhere(page):
    for target in re.findall(r"\]\(([^)#]+)", page.read_text()):
        if not target.startswith("http"):
            assert (page.parent / target).exists(), f"{page.name} links to {target}"


def test_the_readme_names_every_command_and_no_other():
    from bench.cli import main

    named = set(re.findall(r"^\| `bench ([a-z-]+)", (ROOT / "README.md").read_text(), re.MULTILINE))
    assert named == set(main.commands)


def test_the_readme_names_every_extra():
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    rows = re.search(r"\| extra \| for \|\n(.*?)\n\n", (ROOT / "README.md").read_text(), re.DOTALL)
    named = [name for row in rows[1].splitlines()[1:] for name in re.findall(r"`([a-z0-9]+)`", row.split("|")[1])]
    assert sorted(named) == sorted(extras)


def test_the_files_page_lists_every_channel_with_its_unit_and_meaning():
    from bench.base import CHANNELS

    rows = {
        name: (unit, meaning)
        for name, unit, meaning in re.findall(
            r"^\| `(\w+)` \| (\S+) \| (.*) \|$", (ROOT / "docs" / "reference" / "files.md").read_text(), re.MULTILINE
        )
    }
    assert rows == {name: (channel.unit, channel.meaning) for name, channel in CHANNELS.items()}


PATH = re.compile(r"(?<![\w/.-])(?:bench|drivers|profiles|tests|benchmarks|docs)/[\w./-]*[\w/]")
"""A file or folder of the repository, as a page names it."""


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_path_that_a_page_names_exists(page):
    assert not [path for path in PATH.findall(page.read_text()) if not (ROOT / path).exists()]


def test_every_room_of_the_bench_is_in_the_tree_of_the_architecture():
    paths = PATH.findall((ROOT / "docs" / "architecture.md").read_text())
    packages = [file.parent for file in (ROOT / "bench").rglob("__init__.py")]
    rooms = {
        f"{folder.relative_to(ROOT)}/" for folder in packages if not any(folder in room.parents for room in packages)
    }
    assert rooms <= set(paths)


def test_the_version_is_that_of_the_newest_release_in_the_changelog():
    from bench import __version__

    changelog = (ROOT / "CHANGELOG.md").read_text()
    assert re.findall(r"^## (\d\S+) - \d{4}-\d\d-\d\d$", changelog, re.MULTILINE)[0] == __version__


def test_ci_runs_the_commands_that_the_readme_shows():
    readme = (ROOT / "README.md").read_text()
    for name in ("run", "test"):
        assert f"<!-- command: {name} -->\n```bash\n" in readme
        assert f"readme_command {name}" in (ROOT / ".ci" / "run").read_text()
