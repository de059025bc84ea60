"""A seeded sample of both campaigns: damaged files before every command, and attempts at a false PASS."""

from __future__ import annotations

import random

import pytest

from benchmarks import damaged_files, false_pass
from benchmarks.damaged_archive import KINDS, Archive

pytest.importorskip("typst")
SEED = 20261122
QUICK = ("export", "certificate", "diff", "list", "show", "rebuild", "fleet", "equipment", "archive", "flash that")


@pytest.fixture(scope="module")
def archive(tmp_path_factory):
    """A calibration in its unit, verified and registered; not to be changed."""
    return Archive.made(tmp_path_factory.mktemp("archive") / "reports", diagnosed=False)


@pytest.mark.slow
def test_nothing_that_was_changed_gets_a_certificate_or_into_a_unit(archive, tmp_path):
    root = Archive(archive.copy(tmp_path)).root
    untouched = {command: damaged_files.invoke(command, root) for command in ("certificate", "flash that")}
    assert {command: done.exit_code for command, done in untouched.items()} == {"certificate": 0, "flash that": 0}
    tried = [false_pass.attempt(name, archive, tmp_path) for name in false_pass.names(SEED)[:16]]
    assert [(one.name, one.passed, one.said) for one in tried if one.passed] == []


@pytest.mark.slow
def test_a_damaged_file_is_noticed_by_every_command_that_reads_it(archive, tmp_path):
    read_by = {
        "calibration.json": QUICK[:3], "manifest.json": QUICK[:6], "means.parquet": QUICK[:3],
        "limits.yaml": ("certificate",), "data.parquet": ("export", "certificate"), "limits.json": ("flash that",),
    }  # fmt: skip
    found = [
        damaged_files.Case(f"{archive.run}/{name}", kind, command)
        for name, commands in read_by.items()
        for command in (*commands, "archive")
        for kind in KINDS
    ] + [
        damaged_files.Case(name, kind, command)
        for name in ("ledger.jsonl", "chain.seal")
        for command in ("list", "rebuild", "fleet", "flash that", "archive")
        for kind in KINDS
    ]
    flashed = next(name for name in archive.files() if "/flash/" in name and name.endswith(".json"))
    lost = [(f"{archive.run}/calibration.json", "replay"), (flashed, "flash that"), (flashed, "flash")]
    sample = random.Random(SEED).sample(found, 40) + [damaged_files.Case(n, "deleted", c) for n, c in lost]
    done = [damaged_files.run_case(case, archive, SEED, tmp_path) for case in sample]
    assert [(outcome.case, outcome.wrong) for outcome in done if outcome.wrong] == []
