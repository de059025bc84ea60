"""Mutations of files: by bytes, and by the grammar of what stands in them. Each is a function of a random source."""

from __future__ import annotations

import random
import re
from collections.abc import Callable

NUMBERS = (
    "0", "-1", "1e308", "-1e308", "1e-308", "1e400", "9" * 4301, "-" + "7" * 6000, "0x" + "f" * 9000, "1e999999999",
    "nan", ".nan", ".inf", "-inf", "1_000", "1,5", "12:30:45", "0o17", "1e7", "1e-12", "100000000000000000000", "-400",
    "2147483648", "-9223372036854775809", "0.1e", "+", "1/0", "١٢٣", "1 000", "true", "null", "~",
    "''", '"', "2026-01-01",
)  # fmt: skip
TOKENS = (
    "{", "}", "[", "]", "- ", ": ", "#", "|", ">", "&a ", "*a", "<<: *a", "!!python/name:os.system", "!!int ", "? ",
    "---", "...", "\t", "\0", "\r", "\x1b[2J", "\ufeff", "\u2028", '"\\ud800"', "'", '"', '"a', "%YAML 1.1", "[" * 3000,
    "{a: " * 1500, "x" * 200_000, ",", ";", ",,", "\n\n\n", "é", "\U0001f600", "=cmd|'/c calc'!A0", "../../etc/passwd",
    "BO_ ", "SG_ ", "VAL_ ",
)  # fmt: skip
_NUMBER = re.compile(r"[-+]?\d+(\.\d+)?([eE][-+]?\d+)?")
_WORD = re.compile(r"[A-Za-z_][A-Za-z_0-9]*")

Mutation = Callable[[bytes, random.Random], bytes]


def _place(data: bytes, source: random.Random) -> int:
    """Somewhere, and more often near both ends, where headers and footers stand."""
    if not data:
        return 0
    near = min(len(data), 400)
    return source.choice((source.randrange(len(data)), source.randrange(near), len(data) - 1 - source.randrange(near)))


def flip(data: bytes, source: random.Random) -> bytes:
    """A few bits are others."""
    changed = bytearray(data)
    for _ in range(source.choice((1, 1, 2, 8, 64))):
        if changed:
            changed[_place(data, source)] ^= 1 << source.randrange(8)
    return bytes(changed)


def cut(data: bytes, source: random.Random) -> bytes:
    """The end is missing."""
    return data[: _place(data, source)]


def drop(data: bytes, source: random.Random) -> bytes:
    """A part is missing."""
    at = _place(data, source)
    return data[:at] + data[at + source.choice((1, 2, 8, 100, 5000)) :]


def double(data: bytes, source: random.Random) -> bytes:
    """A part is there twice, or many times."""
    at = _place(data, source)
    part = data[at : at + source.choice((1, 10, 100, 2000))]
    return data[:at] + part * source.choice((2, 2, 50, 1000)) + data[at:]


def noise(data: bytes, source: random.Random) -> bytes:
    """Random bytes stand in it."""
    at = _place(data, source)
    return data[:at] + source.randbytes(source.choice((1, 4, 100, 4000))) + data[at + source.choice((0, 4, 100)) :]


def field(data: bytes, source: random.Random) -> bytes:
    """A field of a binary header is extreme."""
    at, width = _place(data, source), source.choice((1, 2, 4, 8))
    value = source.choice((b"\xff" * width, bytes(width), b"\x7f".rjust(width, b"\xff"), b"\x80".rjust(width, b"\0")))
    return data[:at] + value + data[at + width :]


def _text(change: Callable[[str, random.Random], str]) -> Mutation:
    def mutation(data: bytes, source: random.Random) -> bytes:
        return change(data.decode("utf-8", errors="surrogateescape"), source).encode("utf-8", errors="surrogateescape")

    return mutation


def _one(pattern: re.Pattern[str], choices: Callable[[random.Random], str]) -> Callable[[str, random.Random], str]:
    def change(text: str, source: random.Random) -> str:
        found = list(pattern.finditer(text[:20_000]))
        if not found:
            return text + choices(source)
        match = source.choice(found)
        return text[: match.start()] + choices(source) + text[match.end() :]

    return change


def _lines(text: str, source: random.Random) -> str:
    lines = text.split("\n")
    at, other = source.randrange(len(lines)), source.randrange(len(lines))
    what = source.randrange(5)
    if what == 0:
        del lines[at]
    elif what == 1:
        lines[at:at] = [lines[other]] * source.choice((1, 3, 200))
    elif what == 2:
        lines[at], lines[other] = lines[other], lines[at]
    elif what == 3:
        lines[at] = " " * source.randrange(9) + lines[at].lstrip()
    else:
        lines[at] += lines[other]
    return "\n".join(lines)


def _insert(text: str, source: random.Random) -> str:
    at = source.randrange(len(text) + 1) if len(text) < 20_000 else source.randrange(20_000)
    return text[:at] + source.choice(TOKENS) + text[at:]


BINARY: tuple[Mutation, ...] = (flip, cut, drop, double, noise, field, field)
TEXT: tuple[Mutation, ...] = (
    flip, cut, drop, double, noise, _text(_lines), _text(_lines), _text(_insert), _text(_insert),
    _text(_one(_NUMBER, lambda source: source.choice(NUMBERS))),
    _text(_one(_NUMBER, lambda source: source.choice(NUMBERS))),
    _text(_one(_WORD, lambda source: source.choice((*NUMBERS, *TOKENS, "name", "kind", "segments")))),
)  # fmt: skip


def mutated(data: bytes, source: random.Random, mutations: tuple[Mutation, ...]) -> bytes:
    """One to four mutations after each other."""
    for _ in range(source.choice((1, 1, 1, 2, 4))):
        data = source.choice(mutations)(data, source)
    return data
