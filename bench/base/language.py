"""Texts of the command line for operators, in the language of the page's user: English, Ukrainian or Chinese.

Help, error messages, JSON and what is recorded stay English. Words are in `words/LANGUAGE.json`, keys as in the page's.
`words/told.json` has the sentences that are recorded or answered in English: page and command line translate them alike
(`told`; `bench/web/page/lib/told.js`).
"""

from __future__ import annotations

import json
import os
import re
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


JOINTS = {"; ": "；", ". ": "。", ": ": "：", ", ": "，", " and ": "和", " or ": "或"}
"""Where a text of several sentences is cut, in this order, and what joins it in Chinese."""
_AND = {" and ": " і ", " or ": " або "}
_PLACE = r"(?:(?![;.] )(?s:.))+?"
_PLACES = {"text": "(?s:.)+?", "lost": "(?s:.)+?", "serial": r"\S+?"}
_NUMBER = re.compile(r"[-+−]?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")


@cache
def sentences() -> Mapping[str, list[str]]:
    """English sentences with places `{name}` for values; each in Ukrainian and in Chinese.

    A place ends where a sentence does; `{text}` takes all, `{serial}` one word, and `{lost}` may be left out.
    """
    found: dict[str, list[str]] = json.loads((files("bench.base") / "words" / "told.json").read_text(encoding="utf-8"))
    return found


def told(text: str, spoken: str | None = None) -> str | None:
    """An English text of the bench in a language, else in that of the command line; None where it is not known."""
    spoken = spoken or language()
    return _told(text, spoken) if text and spoken in ("uk", "zh") else None


def in_own(text: str) -> str:
    """The text in the language of the command line where it is known there."""
    return told(text) or text


@cache
def _patterns() -> list[tuple[re.Pattern[str], list[str]]]:
    """Sentences as patterns, those with the most letters first."""
    made = []
    for english, own in sentences().items():
        parts = re.split(r"\{(\w+)\}", english)
        places = (f"(?P<{name}>{_PLACES.get(name, _PLACE)})" for name in parts[1::2])
        source = "".join(map(str.__add__, map(re.escape, parts[::2]), [*places, ""]))
        made.append((sum(map(len, parts[::2])), re.compile(source), own))
    return [(pattern, own) for _, pattern, own in sorted(made, key=lambda one: -one[0])]


@cache
def _told(text: str, spoken: str) -> str | None:
    if (plain := _plain(text, spoken)) is not None:
        return plain
    for pattern, own in _patterns():
        if match := pattern.fullmatch(text):
            values = {name: _told(value, spoken) or value for name, value in match.groupdict().items()}
            return own[spoken == "zh"].format(**values)
    for joint, chinese in JOINTS.items():
        parts = text.split(joint)
        made = [_told(part, spoken) for part in parts] if len(parts) > 1 else []
        if any(made):
            between = chinese if spoken == "zh" else _AND.get(joint, joint)
            return between.join(one or part for one, part in zip(made, parts, strict=True))
    bare = _told(text[:-1], spoken) if text[1:].endswith(".") else None
    return None if bare is None else bare + ("。" if spoken == "zh" else ".")


def _plain(text: str, spoken: str) -> str | None:
    """A number, or numbers with units, as the language writes it."""
    if _NUMBER.fullmatch(text):
        return (text.replace(".", ",") if spoken == "uk" else text).replace("-", "−")
    if not re.match(r"[-+−]?\d", text) or " " not in text:
        return None
    parts = [_told(part, spoken) or (part if re.match(r"[-+−±…\d]", part) else None) for part in text.split(" ")]
    return None if None in parts else " ".join(map(str, parts))
