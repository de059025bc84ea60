"""Where the files stand that the bench ships: profiles, stations, models, limits, plans."""

from __future__ import annotations

from pathlib import Path

PACKAGE = Path(__file__).parents[1]


def library() -> Path:
    """The shipped profiles, stations and models: those of the wheel, or of the source tree."""
    packaged = PACKAGE / "_profiles"
    return packaged if packaged.is_dir() else PACKAGE.parent / "profiles"
