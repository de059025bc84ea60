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
from typing import Any

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


@cache
def _catalogue() -> Mapping[str, Any]:
    """`words/told.json`: its sentences, and the rules by which a text is found among them.

    A place `{name}` of a sentence ends where the sentence does; `rules.places` has the pattern of each name that takes
    another text; what stands at those of `rules.kept` stays as it is, at those of `rules.own` all that is not of this
    pattern, and at those of `rules.lists` all but what joins it. `rules.joints` is where a text of several
    sentences is cut, in this order, with what joins it in each language.
    """
    found: dict[str, Any] = json.loads((files("bench.base") / "words" / "told.json").read_text(encoding="utf-8"))
    return found


def sentences() -> Mapping[str, list[str]]:
    """English sentences with places `{name}` for values; each in Ukrainian and in Chinese."""
    found: dict[str, list[str]] = _catalogue()["sentences"]
    return found


def told(text: str, spoken: str | None = None) -> str | None:
    """An English text of the bench in a language, else in that of the command line; None where it is not known."""
    column = _catalogue()["rules"]["columns"].get(spoken or language())
    return _told(text, column) if text and column is not None else None


def in_own(text: str) -> str:
    """The text in the language of the command line where it is known there."""
    return told(text) or text


@cache
def _patterns() -> list[tuple[re.Pattern[str], list[str]]]:
    """Sentences as patterns: what follows the name of a file, then those with the most letters first."""
    places, made = _catalogue()["rules"]["places"], []
    for english, own in sentences().items():
        parts = re.split(r"\{(\w+)\}", english)
        named = (f"(?P<{name}>{places.get(name, places[''])})" for name in parts[1::2])
        source = "".join(map(str.__add__, map(re.escape, parts[::2]), [*named, ""]))
        weight = (english.startswith("{at}: "), sum(map(len, parts[::2])))
        made.append((weight, re.compile(source), own))
    return [(pattern, own) for _, pattern, own in sorted(made, key=lambda one: one[0], reverse=True)]


@cache
def _told(text: str, column: int) -> str | None:
    if (plain := _plain(text, column)) is not None:
        return plain
    if text[1:].endswith(".") and (bare := _told(text[:-1], column)) is not None:
        return bare + str(_catalogue()["rules"]["stop"][column])
    for pattern, own in _patterns():
        if match := pattern.fullmatch(text):
            given = match.groupdict()
            ours = ((name, value) for name, value in given.items() if not _peoples(name, value))
            known = {name: one for name, value in ours if (one := _told_at(name, value, column))}
            if known or not given or re.search(r"[^\W_]", re.sub(r"\{\w+\}", "", own[column])):
                return own[column].format(**given | known)
    rules = _catalogue()["rules"]
    for joint, *own in rules["joints"]:
        parts = text.split(joint, 1)  # a sentence behind it may have the same sign in it
        made = [_told(part, column) for part in parts] if len(parts) > 1 else []
        if any(made):
            return str(own[column].join(one or part for one, part in zip(made, parts, strict=True)))
    return None


def _told_at(name: str, value: str, column: int) -> str | None:
    """What stands at a place: a list has the language's own joint, and no other change."""
    joint, *own = _catalogue()["rules"]["lists"].get(name, [""])
    return value.replace(joint, own[column]) if joint else _told(value, column)


def _peoples(name: str, value: str) -> bool:
    """Whether a person wrote what stands at a place."""
    rules = _catalogue()["rules"]
    return name in rules["kept"] or (name in rules["own"] and not re.fullmatch(rules["own"][name], value))


def _plain(text: str, column: int) -> str | None:
    """A number, or numbers with units, as the language writes it."""
    rules = _catalogue()["rules"]
    if re.fullmatch(rules["number"], text):
        grouped = text.replace(",", rules["thousands"][column])
        return grouped.replace(".", rules["decimal"][column]).replace("-", "−")
    if not re.fullmatch(rules["measured"], text):
        return None
    parts = [_told(part, column) or (part if re.fullmatch(rules["bare"], part) else None) for part in text.split(" ")]
    return None if None in parts else re.sub(rules["tight"], "", " ".join(map(str, parts)))
