"""The word that somebody may have meant."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


def closest(word: str, known: Iterable[str], likeness: float = 0.5) -> str | None:
    """The known word that is most like this one, or that begins with it; None where none is near."""
    known = list(known)
    longer = [name for name in known if len(word) > 2 and name.startswith(word.lower())]
    return next(iter(longer or difflib.get_close_matches(word.lower(), known, 1, likeness)), None)


def nearest(word: str, known: Iterable[str]) -> str:
    """End of an error message: `; did you mean 'x'?`, or nothing where no known word is near."""
    close = closest(word, known)
    return f"; did you mean '{close}'?" if close else ""


def nearest_or_all(word: str, known: Iterable[str]) -> str:
    """The same, and all known words where none is near."""
    known = list(known)
    return nearest(word, known) or f"; known are {', '.join(known) or 'none'}"
