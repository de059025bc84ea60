"""Texts of the command line for operators, in the language of the page's user: English, Ukrainian or Chinese.

Help, error messages, JSON and what is recorded stay English. Words are in `words/LANGUAGE.json`, keys as in the page's.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from functools import cache
from importlib.resources import files

LANGUAGES = ("en", "uk", "zh")
VARIABLES = ("BENCH_LANG", "LC_ALL", "LC_MESSAGES", "LANG")
"""Environment variables that name it; the first that is set counts, as for other programs."""


def language() -> str:
    """The language of the command line; English where the environment names none of those that there are."""
    named = next((value for name in VARIABLES if (value := os.environ.get(name))), "")
    return named[:2].lower() if named[:2].lower() in LANGUAGES else "en"


@cache
def words(spoken: str) -> Mapping[str, str]:
    """All words of a language by their keys."""
    text = (files("bench.base") / "words" / f"{spoken}.json").read_text(encoding="utf-8")
    found: dict[str, str] = json.loads(text)
    return found


def say(key: str, **values: object) -> str:
    """The text of a key with its values; KeyError for a key without a text."""
    return words(language())[key].format(**values)


def verdict_word(verdict: str) -> str:
    """A verdict as an operator reads it; the word itself where it has no other."""
    return words(language()).get(f"verdict.{verdict}", verdict)
