"""The shipped JSON Schemas are those of the code, and agree with the strict loader."""

import json
from pathlib import Path

import jsonschema
import pytest

from bench.acquisition.profile.profile import Profile, from_document
from bench.base import config
from bench.base.errors import InputError
from bench.base.yaml12 import parse_yaml
from bench.commands.schemas import RECORD_SCHEMAS, SCHEMAS, export
from bench.record import RECORDS, Record

ROOT = Path(__file__).parents[2]
PROFILES = ROOT / "profiles"
ALL = SCHEMAS | RECORD_SCHEMAS


def schema(kind):
    return json.loads((PROFILES / "schemas" / f"{kind}.json").read_text(encoding="utf-8"))


@pytest.mark.parametrize("kind", ALL)
def test_schemas_are_up_to_date(kind):
    assert schema(kind) == config.json_schema(ALL[kind], kind), "run `python -m bench.commands.schemas`"


@pytest.mark.parametrize("kind", ALL)
def test_schemas_are_valid_schemas(kind):
    jsonschema.Draft202012Validator.check_schema(schema(kind))


@pytest.mark.parametrize("path", sorted(PROFILES.glob("*.yaml")), ids=lambda path: path.stem)
def test_profiles_name_their_schema_and_satisfy_it(path):
    first = path.read_text(encoding="utf-8").splitlines(keepends=True)[0]
    assert first == "# yaml-language-server: $schema=schemas/profile.json\n"
    assert (path.parent / "schemas/profile.json").is_file()
    jsonschema.validate(config.read_yaml(path).content, schema("profile"))


@pytest.mark.parametrize(
    "path",
    [*(ROOT / "drivers" / "chambers").glob("*.yaml"), PROFILES / "chambers" / "example.yaml"],
    ids=lambda p: p.stem,
)
def test_maps_satisfy_their_schema(path):
    jsonschema.validate(config.read_yaml(path).content, schema("chamber_map"))


@pytest.mark.parametrize(
    "text",
    [
        "name: x\nsegments: []",
        "name: x\nsegments: [{kind: ramp, to_deg: 3, rate_degc_per_min: 1}]",
        "name: x\nsegments: [{kind: soak, duration_min: on}]",
        "name: x\nsegments: [{kind: step, temperatures_degc: []}]",
        "name: x\nsegments: [{kind: soak, duration_min: -1}]",
        "nam: x\nsegments: [{kind: soak, duration_min: 1}]",
    ],
)
def test_schema_and_loader_refuse_the_same(text):
    document = parse_yaml(text, "x.yaml")
    with pytest.raises(InputError):
        from_document(document)
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(document.content, schema("profile"))


def test_every_key_of_a_profile_is_explained_to_the_editor():
    definitions = config.json_schema(Profile)["$defs"]
    silent = [f"{name}.{key}" for name, node in definitions.items() if name != "GuardSettings"
              for key, value in node.get("properties", {}).items()
              if "description" not in value and key not in {"kind", "name"} and name != "SettleChange"]  # fmt: skip
    assert silent == []


def test_export_writes_only_what_changed(tmp_path):
    assert len(export(tmp_path)) == len(ALL)
    assert export(tmp_path) == ()


def _kinds(base):
    for kind in base.__subclasses__():
        yield kind
        yield from _kinds(kind)


def test_every_record_has_a_schema_and_a_line_in_the_documentation():
    ours = {kind for kind in _kinds(Record) if kind.__module__.startswith("bench.")}
    assert ours == set(RECORDS)
    page = (ROOT / "docs/reference/records.md").read_text(encoding="utf-8")
    rows = [line for line in page.splitlines() if line.startswith("| `")]
    assert len(rows) == len(RECORDS)
    for record in RECORDS:
        version = record.model_fields["format"].default
        end = f"| {version} | `profiles/schemas/records/{record.TITLE}.json` |"
        assert any(record.FILE in row and row.endswith(end) for row in rows), record.FILE
