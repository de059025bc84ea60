"""What a page shows as output is what its commands say.

`python -m tests.support.shown SAID`, where README's main job has just run and its output is in the file SAID, compares
README's outputs with it, and with what its lines of Python print of the run. Then it runs the commands of blocks of the
how-tos that are too slow for the tests, and compares those.
"""

from __future__ import annotations

import contextlib
import io
import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
FENCE = re.compile(r"^(?:<!--((?:(?!-->).)*)-->\n)?```([^\n]*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
"""A block, and the comment above it: `not run: WHY`, `command: NAME` of CI, `ci: COMMANDS` whose output it is,
`file: NAME`, or `first:` and commands."""


def fences(page: str) -> list[tuple[str, str, str]]:
    """Comment, language and text of each block of a page."""
    return [(said.strip(), language, text) for said, language, text in FENCE.findall((ROOT / page).read_text())]


def outputs(page: str, of: str = "") -> list[str]:
    """Blocks that show what commands said: they have no language; `of` is the comment above them."""
    return [text for comment, language, text in fences(page) if not language and comment == of]


def unlike(shown: str, said: str) -> str:
    """The first line of a block that was not said; empty: all were, in their order. `…` stands for anything."""
    lines, place = said.splitlines(), 0
    for line in filter(None, map(str.rstrip, shown.splitlines())):
        wanted = re.compile(".*".join(map(re.escape, line.split("…"))))
        found = [n for n, one in enumerate(lines[place:], place) if wanted.fullmatch(one.rstrip())]
        if not found:
            return line
        place = found[0] + 1
    return ""


def main(said: Path) -> None:
    """Compare README; exits with the line that differs."""
    [run] = Path("reports/SIM-0001").glob("*_ramp_-40_85")
    [code] = [text for _, language, text in fences("README.md") if language == "python"]
    code = re.sub(r'bench.open\(".*"\)', f'bench.open("{run}")', code).replace("fit.plot().show()", "")
    with contextlib.redirect_stdout(io.StringIO()) as printed:
        exec(code, {})
    for of, text in (("command: run", said.read_text()), ("command: python", printed.getvalue())):
        for shown in outputs("README.md", of):
            if line := unlike(shown, text):
                sys.exit(f"README.md shows what its commands do not say: {line}\n{text}")


def slow() -> None:
    """Compare the blocks of the how-tos whose commands only CI runs, in this folder."""
    for page in sorted((ROOT / "docs" / "howto").glob("*.md")):
        for comment, _, shown in fences(str(page.relative_to(ROOT))):
            if comment.startswith("ci: "):
                done = subprocess.run(
                    comment.removeprefix("ci: "), shell=True, capture_output=True, text=True, check=True
                )
                if line := unlike(shown, done.stdout):
                    sys.exit(f"{page.name} shows what its commands do not say: {line}\n{done.stdout}")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
    slow()
