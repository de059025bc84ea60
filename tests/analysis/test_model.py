from pathlib import Path

import pytest

from bench.analysis.effects import registry as effects
from bench.analysis.effects.model import Model, load_model, model_from
from bench.base.errors import InputError


def write(path, text):
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize(
    "model",
    [
        Model("plain", (effects.make("polynomial"),)),
        Model("heated", (effects.make("polynomial", {"order": 5}),), "heating"),
        Model("both", (effects.make("spline", {"intervals": 24, "ends": "parabolic"}), effects.make("regression"))),
    ],
)
def test_a_model_survives_its_file(tmp_path, model):
    assert load_model(write(tmp_path / "m.yaml", model.to_yaml())) == model


def test_short_and_long_spellings_mean_the_same():
    short = model_from({"name": "m", "effects": ["spline", {"polynomial": None}]})
    long = model_from(
        {"name": "m", "effects": [{"spline": {"intervals": "auto", "ends": "natural"}}, {"polynomial": {}}]}
    )
    assert short == long


@pytest.mark.parametrize("name", ["polynomial", "regression", "spline"])
def test_the_papers_models_are_known_by_name(name):
    model = load_model(name)
    assert model.name == name
    assert [effect.name for effect in model.effects] == [name]


@pytest.mark.parametrize("path", sorted((Path(__file__).parents[2] / "profiles" / "models").glob("*.yaml")))
def test_every_shipped_model_can_be_read_and_carries_its_files_name(path):
    model = load_model(path)
    assert model.name == path.stem
    assert load_model(path.stem) == model


def test_a_users_own_model_folder_goes_before_the_shipped_one(tmp_path, monkeypatch):
    (tmp_path / "profiles" / "models").mkdir(parents=True)
    write(tmp_path / "profiles" / "models" / "spline.yaml", "name: mine\neffects: [polynomial]\n")
    monkeypatch.chdir(tmp_path)
    assert load_model("spline").name == "mine"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("name: m\neffects:\n  - splin\n", r"m\.yaml:3: unknown effect 'splin'; did you mean 'spline'\?"),
        ("name: m\nefects: [spline]\n", r"m\.yaml:2: unknown key 'efects'; did you mean 'effects'\?"),
        ("name: m\neffects:\n  - spline: {knots: 3}\n", r"m\.yaml:3: effect 'spline' has no option 'knots'"),
        ("name: m\neffects:\n  - spline: {intervals: 0}\n", "intervals is 0, allowed is a whole number"),
        ("name: m\neffects: []\n", "has no effects; known are polynomial"),
        ("name: m\neffects: spline\n", "'effects' must be a list"),
        ("name: m\neffects: [3]\n", "3 is not an effect"),
        ("name: m\neffects: [{spline: 3}]\n", "is not an effect"),
        ("name: m\nrows: some\neffects: [spline]\n", "rows is 'some', allowed are all, heating"),
        ("effects: [spline]\n", "needs a 'name'"),
        ("name: m\neffects: [\n", r"m\.yaml:\d+: "),
        ("name: m\nname: n\neffects: [spline]\n", r"m\.yaml:2: "),
        ("name: m\neffects:\n  - polynomial\n  - spline:\n      knots: 3\n", r"m\.yaml:4: effect"),
        ("- 3\n", "a model is a mapping"),
        ("", "is empty"),
    ],
)
def test_a_wrong_model_file_is_refused_in_one_line(tmp_path, text, message):
    with pytest.raises(InputError, match=message) as caught:
        load_model(write(tmp_path / "m.yaml", text))
    assert "\n" not in str(caught.value)
    assert "m.yaml" in str(caught.value)


def test_an_unknown_model_is_refused_with_the_nearest_name():
    with pytest.raises(InputError, match="unknown model 'splines'; did you mean 'spline'"):
        load_model("splines")
    with pytest.raises(InputError, match="no such model file"):
        load_model("nowhere/m.yaml")


def test_keys_are_unique_and_needs_are_listed_once():
    model = Model("m", (effects.make("polynomial"), effects.make("spline"), effects.make("polynomial")))
    assert model.keys == ("polynomial", "spline", "polynomial_2")
    assert model.needs == ("temperature",)
    assert model.adding(effects.make("regression")).name == "m + regression"


def test_a_spline_takes_the_place_of_the_polynomial_that_it_contains():
    lag = effects.make("thermal_lag")
    stiff = Model("m", (effects.make("polynomial"), lag))
    finer = stiff.adding(effects.make("spline", {"intervals": 12}))
    assert [effect.name for effect in finer.effects] == ["thermal_lag", "spline"]
    assert finer.name == "m, spline for polynomial"
    assert [effect.name for effect in stiff.adding(effects.make("aging")).effects] == [
        "polynomial",
        "thermal_lag",
        "aging",
    ]
