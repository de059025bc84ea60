"""The doors of the wings: every name that a wing gives to others loads, and is what it says."""

import ast
import importlib
from pathlib import Path

import pytest

import bench

ROOT = Path(bench.__file__).parent
DOORS = sorted(path.parent for path in ROOT.rglob("__init__.pyi"))


def names(stub):
    """Module and name of each import of a stub."""
    for node in ast.parse(stub.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.ImportFrom):
            yield from ((node.module, alias.asname or alias.name) for alias in node.names)


@pytest.mark.parametrize("door", DOORS, ids=lambda door: door.name)
def test_every_name_of_a_door_loads_and_no_module_hides_it(door):
    package = "bench" if door == ROOT else f"bench.{door.relative_to(ROOT).as_posix().replace('/', '.')}"
    for module, name in names(door / "__init__.pyi"):
        own = getattr(importlib.import_module(f"{package}.{module}" if module else package), name)
        assert getattr(importlib.import_module(package), name) is own, f"{package}.{name}"
