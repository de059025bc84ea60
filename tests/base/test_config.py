"""Strict YAML and its errors: every trap of YAML 1.1 is closed, every error says where and what is allowed."""

import math

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import BaseModel, Field

from bench.base import config
from bench.base.errors import InputError
from bench.base.yaml12 import dump, parse_yaml

CALM = settings(max_examples=60)


class Inner(BaseModel):
    model_config = config.STRICT

    soak_min: float = Field(gt=0, le=100)
    times: int = 1
    on: bool = False


class Outer(BaseModel):
    model_config = config.STRICT

    name: str
    """What it is called."""
    inner: Inner | None = None
    items: tuple[Inner, ...] = ()


def content(text):
    return parse_yaml(text, "x.yaml").content


def refusal(text, model=Outer):
    with pytest.raises(InputError) as caught:
        config.load_config(parse_yaml(text, "x.yaml"), model)
    return str(caught.value)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("on", "on"), ("no", "no"), ("yes", "yes"), ("12:30", "12:30"), ("12:30:45", "12:30:45"), ("1_000", "1_000"),
        ("1e3", 1000.0), ("-1.5E-2", -0.015), (".5", 0.5), ("5.", 5.0), ("010", 10), ("0o10", 8), ("0x1F", 31),
        ("true", True), ("False", False), ("null", None), ("~", None), ("'1'", "1"), ('"true"', "true"),
        ("2024-01-01", "2024-01-01"), ("'.nan'", ".nan"), ("nano", "nano"), ("info", "info"),
    ],
)  # fmt: skip
def test_scalars_follow_yaml_1_2(text, value):
    found = content(f"a: {text}")["a"]
    assert found == value
    assert type(found) is type(value)


@pytest.mark.parametrize("text", [".nan", ".NaN", "nan", ".inf", "-.inf", "inf", "1e999"])
def test_numbers_that_are_not_finite_are_refused_with_their_line(text):
    with pytest.raises(InputError, match=r"x\.yaml:2: .*finite"):
        parse_yaml(f"a: 1\nb: {text}", "x.yaml")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a: 1\nb: 2\na: 3", "x.yaml:3: duplicate key 'a': already given in line 1"),
        ("a: [1, 2", "x.yaml:1: not YAML"),
        ("a: !!python/object:os.system x", "x.yaml:1: the tag"),
        ("a: &x {b: 1}\nc: {<<: *x}", "x.yaml:2: merge keys"),
        ("a: &x\n  - *x", "x.yaml:1: an alias refers to something that contains it"),
        ("a: 1\n---\na: 2", "not YAML"),
        ("? [1, 2]\n: 3", "x.yaml:1: a key must be plain text"),
        ("", "x.yaml: is empty"),
        ("# nothing", "x.yaml: is empty"),
        ("[" * 5000, "nested too deeply"),
    ],
)
def test_what_is_outside_strict_yaml_is_refused(text, message):
    with pytest.raises(InputError) as caught:
        parse_yaml(text, "x.yaml")
    assert message in str(caught.value)


def test_aliases_that_multiply_are_refused():
    bomb = "a0: &a0 [x, x, x, x, x, x, x, x, x, x]\n"
    bomb += "".join(f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 10)}]\n" for i in range(1, 9))
    with pytest.raises(InputError, match="more than 100000 values"):
        parse_yaml(bomb, "x.yaml")


def test_an_alias_may_be_used_twice():
    assert content("a: &x [1]\nb: *x\nc: *x") == {"a": [1], "b": [1], "c": [1]}


def test_an_unknown_key_names_the_nearest_known_one_and_all_of_them():
    text = refusal("name: x\ninner:\n  soak_mins: 3")
    assert "x.yaml:3: unknown key 'soak_mins'; did you mean 'soak_min'?; known here: soak_min, times, on" in text


def test_every_error_of_a_file_is_said_at_once_in_order_of_lines():
    text = refusal("nam: x\nitems:\n  - {soak_min: 0}\n  - {soak_min: 1, times: 1.5}\n  - {soak_min: on}\n")
    lines = text.splitlines()
    assert [line.split(": ")[0] for line in lines] == ["x.yaml:1", "x.yaml:1", "x.yaml:3", "x.yaml:4", "x.yaml:5"]
    assert "missing key 'name' (What it is called)" in text
    assert "items[0].soak_min is 0: must be greater than 0" in text
    assert "items[1].times is 1.5: must be a whole number" in text
    assert 'items[2].soak_min is "on": must be a number' in text


def test_text_is_not_taken_for_a_number_nor_a_number_for_text():
    assert "must be a number" in refusal("name: x\ninner: {soak_min: '3'}")
    assert "must be text; put it in quotes" in refusal("name: 0042")
    assert "must be true or false" in refusal("name: x\ninner: {soak_min: 3, on: yes}")


def test_an_exponent_without_a_point_is_a_number():
    assert config.load_config(parse_yaml("name: x\ninner: {soak_min: 1e1}", "x"), Outer).inner == Inner(soak_min=10.0)


def test_a_list_at_the_top_is_refused():
    assert "must hold keys and values" in refusal("- 1")


def test_files_that_cannot_be_read_are_refused(tmp_path):
    (tmp_path / "latin.yaml").write_bytes("name: x\ninner: \xb0".encode("latin-1"))
    for path, message in [(tmp_path / "no.yaml", "no such file"), (tmp_path, "cannot be read"),
                          (tmp_path / "latin.yaml", ":2: is not text in UTF-8")]:  # fmt: skip
        with pytest.raises(InputError, match=message):
            config.load_config(path, Outer)


def test_a_byte_order_mark_is_no_part_of_the_first_key(tmp_path):
    (tmp_path / "bom.yaml").write_bytes(b"\xef\xbb\xbfname: x")
    assert config.load_config(tmp_path / "bom.yaml", Outer).name == "x"


plain = st.one_of(
    st.text(max_size=20).filter(lambda text: text.isprintable()), st.integers(), st.booleans(), st.none(),
    st.floats(allow_nan=False, allow_infinity=False),
)  # fmt: skip
values = st.recursive(plain, lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(
    alphabet="abcdefgh_1", min_size=1, max_size=6), inner, max_size=4), max_leaves=12)  # fmt: skip


@CALM
@given(st.dictionaries(st.sampled_from(["a", "b", "on", "y"]), values, min_size=1))
def test_what_is_dumped_is_read_back_equal(found):
    assert content(dump(found)) == found


@CALM
@given(st.floats(allow_nan=False, allow_infinity=False))
def test_numbers_keep_every_digit(number):
    found = content(f"a: {number!r}")["a"]
    assert float(found) == number
    assert math.copysign(1, found) == math.copysign(1, number) or number == 0


@CALM
@given(st.text(alphabet=st.characters(codec="utf-8"), max_size=60))
def test_any_text_is_parsed_or_refused_in_one_way(text):
    try:
        parse_yaml(text, "x.yaml")
    except InputError:
        return
    yaml.compose(text)  # PyYAML agrees that it is YAML
