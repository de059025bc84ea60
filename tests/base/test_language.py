"""What operators read on the command line is in their language; what programs read is not."""

import ast
import json
import string
from pathlib import Path

import pytest

from bench.base import language
from bench.base.language import say
from tests.support.commands import bench

BENCH = Path(language.__file__).parents[1]


def texts(spoken):
    return json.loads((BENCH / "base" / "words" / f"{spoken}.json").read_text(encoding="utf-8"))


def values(text):
    return {name for _, name, _, _ in string.Formatter().parse(text) if name}


def used():
    """Keys that the code says."""
    for path in BENCH.rglob("*.py"):
        if "say(" in (source := path.read_text(encoding="utf-8")):
            for node in ast.walk(ast.parse(source)):
                if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "say" and node.args:
                    yield ast.literal_eval(node.args[0])


@pytest.mark.parametrize("spoken", ["uk", "zh"])
def test_every_text_has_its_values_in_every_language(spoken):
    english, other = texts("en"), texts(spoken)
    assert {key: values(text) for key, text in other.items()} == {key: values(text) for key, text in english.items()}
    assert not [key for key, text in other.items() if text == english[key]]


def test_every_key_that_is_said_has_a_text_and_every_text_is_said():
    said = {*used()}
    assert said == {key for key in texts("en") if not key.startswith("verdict.")}


@pytest.mark.parametrize(
    ("environment", "said"),
    [
        ({"LANG": "uk_UA.UTF-8"}, "камера"),
        ({"LANG": "uk_UA", "BENCH_LANG": "zh"}, "温箱"),
        ({"LANG": "fr_FR"}, "chamber"),
        ({"LC_ALL": "C", "LANG": "uk_UA"}, "chamber"),
        ({}, "chamber"),
    ],
)
def test_the_environment_names_the_language(monkeypatch, environment, said):
    for name in language.VARIABLES:
        monkeypatch.delenv(name, raising=False)
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    assert say("progress.chamber") == said


def test_a_command_answers_people_in_their_language_and_programs_always_alike(tmp_path, monkeypatch):
    monkeypatch.setenv("BENCH_LANG", "uk")
    told = bench("status", "--out", tmp_path)
    assert told.output.startswith("немає запущеного прогону")
    answer = bench("status", "--out", tmp_path, "--json")
    assert json.loads(answer.stdout) == {"runs": []}
