"""The job file: what every step of a calibration left behind, written whole at each of its boundaries."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from bench.base import InputError, __version__, hold, locked, read_yaml
from bench.record import CHAIN, MANIFEST, JobRecord, RunFolder, new_folder, slug

JOB = JobRecord.FILE
JOB_MARK = "job.yaml"
"""In the folder of a run: the job and the step that it was made for."""
_LOCK = ".lock"
HELD, FAILED, RUNNING, ENDED = "held", "failed", "running", "ended"


@dataclass(frozen=True)
class Case:
    """One thing that was judged: a limit, a doubt; `failure` is empty where it passed."""

    name: str
    failure: str = ""
    skipped: bool = False
    text: str = ""

    def to_json(self) -> dict[str, Any]:
        """An entry of `cases`."""
        return {"name": self.name, "failure": self.failure, "skipped": self.skipped, "text": self.text}


@dataclass(frozen=True)
class Done:
    """What a step did. `verdict` of the limits where it judged; `hold` and `stop` say why it does not simply go on."""

    sentence: str
    facts: dict[str, Any] = field(default_factory=dict)
    cases: Sequence[Case] = ()
    verdict: str | None = None
    hold: str = ""
    stop: str = ""


class JobFile:
    """A job of one unit, on disk at `folder`/job.json."""

    def __init__(self, folder: Path, content: dict[str, Any]) -> None:
        self.folder = folder
        self.content = content

    @classmethod
    def create(cls, unit_folder: Path, serial: str, plan: str, digest: str, created: datetime | None = None) -> JobFile:
        """A new job; InputError where it cannot be written. Jobs of the same moment have the same name."""
        created = created or datetime.now(UTC)
        try:
            folder = new_folder(unit_folder, f"{created:%Y%m%dT%H%M%SZ}_calibrate_{slug(plan)}")
            content: dict[str, Any] = {"unit": serial, "plan": plan, "digest": digest, "bench": __version__,
                       "created": created.isoformat(timespec="seconds"), "state": RUNNING, "verdict": None,
                       "sentence": "", "exit_code": None, "releases": [], "epochs": {}, "steps": {}}  # fmt: skip
            job = cls(folder, content)
            job.save()
        except OSError as error:
            raise InputError(f"cannot make a job folder: {error.strerror}; choose another place with --out",
                             unit_folder) from None  # fmt: skip
        return job

    @classmethod
    def newest(cls, unit_folder: Path, digest: str) -> JobFile | None:
        """The last job of this unit by this very plan; InputError where a job file is damaged: it may be that one."""
        folders = {path.parent for path in unit_folder.glob(f"*/{JOB}")} | {
            path for path in unit_folder.glob("*_calibrate_*") if path.is_dir() and not RunFolder(path).journal.is_dir()
        }
        known = {folder: _begun(folder) for folder in sorted(folders)}
        found = [cls(folder, record.content()) for folder, record in known.items() if record is not None]
        mine = [job for job in found if job.content["digest"] == digest]
        return max(mine, key=lambda job: (job.content["created"], job.folder.name), default=None)

    def runs(self) -> list[Path]:
        """Every run with a manifest that was made for it, also those that were begun anew, the oldest first."""
        marks = sorted(self.folder.parent.glob(f"*/{JOB_MARK}"))
        mine = [path.parent for path in marks if read_yaml(path).content.get("job") == self.folder.name]
        return [run for run in mine if (run / MANIFEST).is_file()]

    def save(self) -> None:
        """Write it: a reader, or a bench that is started again, sees the job before or after, never between."""
        JobRecord.model_validate(self.content).write(self.folder)

    @contextmanager
    def locked(self) -> Iterator[None]:
        """Keep a second bench from this job; the lock goes with the process, however that ends."""
        with (self.folder / _LOCK).open("w") as file:
            if not hold(file):
                raise InputError("another bench is at work on this job", self.folder)
            self.content = JobRecord.read(self.folder).content()
            yield

    @property
    def state(self) -> str:
        """running, held, failed or ended."""
        return str(self.content["state"])

    def step(self, name: str) -> dict[str, Any]:
        """What is known of a step; empty before it began."""
        found: dict[str, Any] = self.content["steps"].get(name, {})
        return found

    def is_done(self, name: str) -> bool:
        """Whether a step is done and need not be repeated."""
        return self.step(name).get("state") == "done"

    def facts(self, name: str) -> dict[str, Any]:
        """What a step found."""
        found: dict[str, Any] = self.step(name).get("facts", {})
        return found

    def begin(self, name: str) -> None:
        """A step begins, or is taken up again."""
        known = self.step(name)
        self.content["steps"][name] = {
            "state": "begun", "attempts": known.get("attempts", 0) + 1, "began": _now(), "facts": {},
        }  # fmt: skip
        self.content |= {"state": RUNNING, "sentence": "", "exit_code": None}
        self.save()

    def finish(self, name: str, done: Done) -> None:
        """A step is done; its facts are there for the later ones, and for a bench that is started again."""
        self.content["steps"][name] |= {
            "state": "done", "ended": _now(), "sentence": done.sentence, "verdict": done.verdict, "facts": done.facts,
            "cases": [case.to_json() for case in done.cases], "hold": done.hold or None, "stop": done.stop or None,
        }  # fmt: skip
        self.save()

    def fail(self, name: str, text: str, exit_code: int) -> None:
        """A step could not be done; it is the next to be done when the job is started again."""
        self.content["steps"][name] |= {"state": FAILED, "ended": _now(), "sentence": text}
        self._close(FAILED, None, text, exit_code)

    def forget(self, name: str, why: str) -> None:
        """A step that was begun or done counts no more, and neither does the run that it made."""
        if known := self.step(name):
            known |= {"state": "void", "sentence": why}
            self.renew(name)

    def epoch(self, name: str) -> int:
        """How often a step was begun from nothing: the runs of other epochs are not its own."""
        return int(self.content["epochs"].get(name, 1))

    def renew(self, name: str) -> None:
        """Begin a step from nothing."""
        self.content["epochs"][name] = self.epoch(name) + 1
        self.save()

    def hold(self, why: str) -> None:
        """The job waits for a person."""
        self._close(HELD, "HOLD", why, 1)

    def end(self, verdict: str, sentence: str, exit_code: int) -> None:
        """The job is over."""
        self._close(ENDED, verdict, sentence, exit_code)

    def release(self, reason: str) -> None:
        """A person lets a held job go on; InputError where it is not held."""
        if self.state != HELD:
            raise InputError(f"the job is {self.state}, not held: nothing to release", self.folder)
        held = [known for known in self.content["steps"].values() if known.get("hold")]
        for known in held:
            known |= {"hold": None, "released": known["hold"]}
        self.content["releases"].append({"utc": _now(), "reason": reason, "held": self.content["sentence"]})
        self.content |= {"state": RUNNING, "verdict": None, "exit_code": None}
        self.save()

    def _close(self, state: str, verdict: str | None, sentence: str, exit_code: int) -> None:
        self.content |= {"state": state, "verdict": verdict, "sentence": sentence, "exit_code": exit_code}
        self.content["ended"] = _now()
        self.save()


def at_work(folder: Path) -> bool:
    """Whether a bench works on the job in a folder."""
    return locked(folder / _LOCK)


def _begun(folder: Path) -> JobRecord | None:
    """The job in a folder; None where a bench was killed before it began one. InputError where its file is lost."""
    record = JobRecord.find(folder)
    if record is None and any(path.name != CHAIN and not path.name.startswith(".") for path in folder.iterdir()):
        raise InputError(JobRecord.MISSING, folder)
    return record


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="milliseconds")
