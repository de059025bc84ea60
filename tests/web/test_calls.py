"""Whom the page calls for: runs that ended, hold or were lost while the page was open."""

import pytest

from tests.support.page_modules import told


def run(name, state="running", condition="live"):
    return {"run": name, "state": state, "condition": condition}


def state(*runs, ended=()):
    return {"runs": list(runs), "ended": {name: {"run": name} for name in ended}}


def news(before, now):
    return told("lib/news.js", "console.log(JSON.stringify(page.news(...given)));", [before, now])


@pytest.mark.parametrize(
    ("before", "now", "what"),
    [
        (state(run("a")), state(ended=["a"]), ["a ended"]),
        (state(run("a")), state(run("a", "holding")), ["a holding"]),
        (state(run("a", "holding")), state(run("a", "holding")), []),
        (state(run("a", "holding")), state(run("a")), []),
        (state(run("a")), state(run("a", condition="gone")), ["a gone"]),
        (state(run("a")), state(run("a", condition="silent")), ["a silent"]),
        (state(run("a")), state(run("a", condition="unheard")), []),
        (state(), state(run("a", "holding")), []),
        (state(ended=["b"]), state(run("a"), ended=["b", "c"]), []),
        (state(run("a"), run("b")), state(run("b", "holding"), ended=["a"]), ["a ended", "b holding"]),
    ],
)
def test_what_is_news(before, now, what):
    assert [f"{one['run']} {one['what']}" for one in news(before, now)] == what
