"""The commands that write, the states that they begin with, and what a user gives after a kill."""

from __future__ import annotations

import json
import os
import shutil
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.killing import Words, in_a_copy
from tests.support.web_client import served

UNIT = "SIM-0001"
LINKED = {".parquet", ".gtbj"}
"""Files that no command changes in place; they are linked, not copied."""

Give = Callable[[Words], int]
"""Gives a command, and returns its exit code."""


@dataclass(frozen=True)
class Command:
    """A command that writes, the state that it begins with, and how its work is given again after a kill."""

    name: str
    words: Callable[[Path], Words]
    """In the folder of the trial."""
    again: Callable[[Path, Give], int] | None = None
    """After a kill, where a user would not give the same command; returns the last exit code."""
    state: str = "calibrated"
    repeats: bool = False
    """Whether, given again, it rightly makes a further record: each verification is a measurement of its own."""


_SETTLE = "settle: {band_degc: 1, unit_band_degc: 5, slope_degc_per_min: 20, dwell_min: 0.05, timeout_min: 5}\n"
FILES = {
    "profiles/brief.yaml": f"name: brief\n{_SETTLE}segments:\n  - {{kind: soak, name: warm, duration_min: 0.5}}\n",
    "profiles/long.yaml": f"""\
name: long
{_SETTLE}segments:
  - {{kind: ramp, to_degc: 50, rate_degc_per_min: 3}}
  - {{kind: soak, duration_min: 10}}
  - {{kind: ramp, to_degc: 10, rate_degc_per_min: 3}}
  - {{kind: soak, duration_min: 10}}
  - {{kind: ramp, to_degc: 25, rate_degc_per_min: 3}}
  - {{kind: soak, duration_min: 5}}
""",
    "profiles/other.yaml": f"""\
name: other
{_SETTLE}segments:
  - {{kind: ramp, to_degc: 47, rate_degc_per_min: 4}}
  - {{kind: soak, duration_min: 10}}
  - {{kind: ramp, to_degc: 22, rate_degc_per_min: 4}}
""",
    "limits.yaml": """\
name: wide
limits:
  - {quantity: residual_rms_dph, unit: deg/h, upper: 500, reason: kills are what matters}
  - {quantity: samples_lost, unit: "1", upper: 0, reason: every sample counts}
""",
    **{
        f"plan {name}.yaml": f"""\
name: {name}
profile: profiles/{name}.yaml
verification: profiles/other.yaml
models: [polynomial]
limits: limits.yaml
policy: {{marginal: ship, missing_effect: ship, unknown_effect: ship, undecided: ship, tie: ship, undiagnosed: ship}}
"""
        for name in ("brief", "long")
    },
    "log.csv": "time [s],rate [deg/h],temperature [degC]\n"
    + "".join(f"{t},{3.0 + 0.01 * t % 7:.4f},{20.0 + 0.002 * t:.4f}\n" for t in range(3600)),
}


def _run(folder: Path, name: str = "long") -> Path:
    return next((folder / "reports" / UNIT).glob(f"*_{name}"))


def _recorded(folder: Path, profile: str) -> Words:
    models = ("--model", "polynomial", "--limits", folder / "limits.yaml", "--out", folder / "reports")
    return ("run", folder / "profiles" / f"{profile}.yaml", "--quiet", *models)


def _brief(folder: Path) -> Words:
    return _recorded(folder, "brief")


def _finished(folder: Path, give: Give) -> int:
    """What a user gives after `bench run` was killed: what each refusal advises; a run without a sample is repeated."""
    for run in (folder / "reports").glob("*/*_brief"):
        for words in (("resume", run, "--quiet"), ("report", run, "--model", "polynomial")):
            code = give(words)
            if code in {0, 1} and json.loads((run / "manifest.json").read_bytes())["rows"]:
                return code
    return give(_brief(folder))


def _calibrate(folder: Path, plan: str) -> Words:
    return ("calibrate", "--unit", UNIT, "--plan", folder / f"plan {plan}.yaml", "--out", folder / "reports", "--quiet")


def _verify(folder: Path, profile: str = "brief") -> Words:
    given = ("--unit", UNIT, "--limits", folder / "limits.yaml", "--out", folder / "reports", "--quiet")
    return ("verify", folder / "profiles" / f"{profile}.yaml", *given)


def _flash(folder: Path) -> Words:
    return ("flash", UNIT, "--out", folder / "reports", "--quiet")


def _again_verified(folder: Path, give: Give) -> int:
    """What is left of the killed one becomes a record, then it is given again."""
    for run in (folder / "reports" / UNIT).glob("*_brief"):
        give(("report", run, "--model", "polynomial"))
    return give(_verify(folder))


def _certificate(folder: Path) -> Words:
    return ("certificate", _run(folder), "--verification", _run(folder, "other"), "--issued", "2026-11-22")


def page_imports(folder: Path) -> int:
    """The page's server, and a person who imports a table."""
    with _page(folder) as page:
        headers = {"X-Bench": "1"}
        sent = page.post(
            "/api/v1/imports", files={"file": ("log.csv", (folder / "log.csv").read_bytes())}, headers=headers
        )
        place = f"/api/v1/imports/{sent.json()['import']}"
        _told(page, sent)
        made = _told(page, page.post(place, json={"unit": "IMP-1"}))
        return 0 if made["state"] == "done" and not made["result"]["warnings"] else 1


def page_starts(folder: Path) -> int:
    """The page's server, and a person who starts a run, if none was started, and waits for its end."""
    with _page(folder) as page:
        known = _starts(page)
        if not any(start["runs"] for start in known):
            wanted = {"plan": "brief", "models": ["polynomial"]}
            page.post("/api/v1/starts", json=wanted).raise_for_status()
        known = _starts(page)
        return 0 if any(start["exit_code"] in {0, 1} for start in known) else 1


def _starts(page: Any) -> list[dict[str, Any]]:
    """Starts, when all have ended."""
    while True:
        known: list[dict[str, Any]] = page.get("/api/v1/starts").json()["starts"]
        if not any(start["state"] in {"starting", "running"} for start in known):
            return known
        time.sleep(0.1)


def _told(page: Any, answer: Any) -> dict[str, Any]:
    answer.raise_for_status()
    job = answer.json()["job"]
    while True:
        told: dict[str, Any] = page.get(f"/api/v1/jobs/{job}?wait_s=20").json()
        if told["state"] not in {"waiting", "running"}:
            return told


def _page(folder: Path) -> Any:
    from bench.web.ground.settings import Settings

    return served(Settings(out=folder / "reports", project=folder))


COMMANDS = {
    command.name: command
    for command in (
        Command("run", _brief, _finished),
        Command("first run", _brief, _finished, "empty"),
        Command("resume", lambda at: ("resume", _run(at, "brief"), "--quiet"), _finished, "killed"),
        Command("calibrate", lambda at: _calibrate(at, "brief"), state="empty"),
        Command("calibrate, from the fit on", lambda at: _calibrate(at, "long"), state="recorded"),
        Command("report", lambda at: ("report", _run(at), "--model", "polynomial")),
        Command("diagnose", lambda at: ("diagnose", _run(at), "--model", "polynomial")),
        Command("export", lambda at: ("export", _run(at), "--format", "json", "--out", at / "exported")),
        Command("flash", _flash),
        Command("verify", _verify, _again_verified, "verified", repeats=True),
        Command("certificate", _certificate, state="verified"),
        Command(
            "import", lambda at: ("import", at / "log.csv", "--unit", "IMP-1", "--out", at / "reports"), state="empty"
        ),
        Command("page imports", lambda at: (page_imports, at), state="empty"),
        Command("page starts", lambda at: (page_starts, at), state="empty"),
        Command("registry rebuild", lambda at: ("registry", "rebuild", "--out", at / "reports")),
        Command("registry lot", lambda at: ("registry", "lot", "L1", UNIT, "--out", at / "reports")),
    )
}


def _empty(place: Path) -> None:
    (place / "profiles").mkdir(parents=True)
    for name, text in FILES.items():
        (place / name).write_text(text, encoding="utf-8")


def _calibrated(place: Path) -> None:
    _empty(place)
    _done(_recorded(place, "long"), place)


def _killed(place: Path) -> None:
    """A run whose bench was killed when it had written some seconds of its journal."""
    _calibrated(place)
    in_a_copy(_brief(place), place, when=lambda _: any(_sizes(place, "*_brief/journal/can0.gtbj")))


def _sizes(place: Path, pattern: str) -> Iterator[bool]:
    return (path.stat().st_size > 100_000 for path in (place / "reports" / UNIT).glob(pattern))


def _recorded_job(place: Path) -> None:
    """A calibration whose bench was killed when its run was done."""
    _empty(place)

    def reached(_: float) -> bool:
        files = (place / "reports" / UNIT).glob("*/job.json")
        return any(json.loads(file.read_bytes())["steps"].get("run", {}).get("state") == "done" for file in files)

    in_a_copy(_calibrate(place, "long"), place, when=reached)


def _calibrated_unit(place: Path) -> None:
    """A calibration in its unit, and verified."""
    _calibrated(place)
    for words in (_flash(place), _verify(place, "other")):
        _done(words, place)


def _done(words: Words, place: Path) -> None:
    done = in_a_copy(words, place)
    if done.code not in {0, 1}:
        raise RuntimeError(f"{words[0]} failed: {done.said}")


STATES: dict[str, Callable[[Path], None]] = {
    "empty": _empty,
    "calibrated": _calibrated,
    "killed": _killed,
    "recorded": _recorded_job,
    "verified": _calibrated_unit,
}
"""Makers of what commands begin with, in the folder where every trial will stand: records name their folder."""


def copied(source: Path, target: Path) -> None:
    """A copy of a state; large files that no command changes in place are linked."""

    def take(name: str, where: str) -> object:
        return os.link(name, where) if Path(name).suffix in LINKED else shutil.copy2(name, where)

    shutil.copytree(source, target, copy_function=take)
