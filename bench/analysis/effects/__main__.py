"""`python -m bench.analysis.effects > docs/effects.md` writes the documentation of all effects."""

from __future__ import annotations

import sys

from bench.analysis.effects.catalogue import markdown

if __name__ == "__main__":
    sys.stdout.write(markdown())
