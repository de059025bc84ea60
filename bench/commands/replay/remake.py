"""The tables of a run made again from its journals, in a folder of their own; the run itself is only read."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from bench.acquisition import assemble
from bench.base import InputError
from bench.commands.replay.changes import Change, tables, texts, trees
from bench.record import HASHED_PATTERNS, Manifest, RunFolder, open_run, sha256, use, write_means

MADE = ("data.parquet", "means.parquet", "events.jsonl", "next.yaml")
"""Files that the bench makes from the others."""


def tampered(run: RunFolder, manifest: Manifest) -> tuple[Change, ...]:
    """Files that are not those whose SHA-256 the manifest holds, and journals that it does not know."""
    recorded = manifest.files
    found = []
    for name, digest in recorded.items():
        path = run.path / name
        now = sha256(path) if path.is_file() else "(absent)"
        if now != digest:
            found.append(Change(name, "sha256", digest, now))
    unknown = [name for name in _inputs(run) if name not in recorded and name.startswith("journal")]
    return (*found, *(Change(name, "sha256", "(absent)", sha256(run.path / name)) for name in unknown))


def remake(run: RunFolder, manifest: Manifest, scratch: Path) -> RunFolder:
    """The run made again below `scratch`, in a folder of the same name.

    An import has no frames: its means are made again from its data. InputError where the inputs are not enough.
    """
    made = RunFolder(scratch / run.path.resolve().name)
    made.path.mkdir()
    for name in _inputs(run):
        link = made.path / name
        link.parent.mkdir(exist_ok=True)
        link.symlink_to((run.path / name).resolve())
    if any(run.journal.glob("*.gtbj")):
        assemble(made, keep=True)
    elif run.data.is_file():
        use(run.path, run.data.name)
        made.data.symlink_to(run.data.resolve())
        write_means(run.data, made.means)
        manifest.write(made.path)
    else:
        raise InputError("holds neither journals nor data.parquet: nothing to make its numbers from", run.path)
    return made


def _inputs(run: RunFolder) -> Iterator[str]:
    """What a run is made from, by path inside the folder."""
    for pattern in HASHED_PATTERNS:
        for path in sorted(run.path.glob(pattern)):
            name = str(path.relative_to(run.path))
            if name not in MADE and not path.name.startswith("."):
                yield name


def compared(run: RunFolder, made: RunFolder) -> Iterator[Change]:
    """What differs between the tables of a run and those made again."""
    for name in ("data.parquet", "means.parquet"):
        then, now = run.path / name, made.path / name
        if not then.is_file():
            yield Change(name, "file", "(absent)", "present")
        elif sha256(then) != sha256(now):  # another version of the writer may store the same values in other bytes
            yield from tables(then, now)
    then, now = run.path / "events.jsonl", made.path / "events.jsonl"
    if now.is_file():
        yield from texts(now.name, then.read_text(encoding="utf-8") if then.is_file() else "", now.read_text("utf-8"))
    old, new = run.manifest().content(), open_run(made.path).manifest().content()
    # What was added to the manifest later, such as a verification, is not made from the frames.
    yield from trees("manifest.json", {key: old.get(key, "(absent)") for key in new}, new, skip=("files",))
