"""Effects that users bring: from a file and from an entry point, like the built-in ones once they are in."""

import re
import sys
from importlib.metadata import EntryPoint
from pathlib import Path

import numpy as np
import pytest

from bench.analysis.effects import catalogue, registry
from bench.analysis.effects import registry as effects
from bench.analysis.effects.model import load_model
from bench.analysis.effects.signature import signature
from bench.analysis.fit.fitting import fit_model
from bench.base.errors import InputError
from bench.cli import main
from tests.support.analysis_data import thermal_cycle, white, with_bias
from tests.support.commands import bench

GOOD = '''"""Bias that follows the sine of the temperature.

Equation: B = a sin(T / p).
Look-alikes: spline, thermal_lag.
"""
from dataclasses import dataclass
import numpy as np
from bench import Effect, Parameter

@dataclass(frozen=True)
class Etalon(Effect):
    name = "etalon"
    needs = ("temperature",)
    parameters = (Parameter("period_degc", "degC", 1.0, 3.0, 2.0),)
    amplitudes = (("a", "deg/h"),)
    phase_rad: float = 0.0

    def columns(self, record, theta):
        return np.sin(record.channel("temperature") / theta["period_degc"] + self.phase_rad)[:, None]
'''


@pytest.fixture(autouse=True)
def _registry_of_its_own(monkeypatch):
    monkeypatch.setattr(registry, "_REGISTRY", dict(registry._REGISTRY))
    monkeypatch.setattr(registry, "_BROKEN", {})


@pytest.fixture
def write(tmp_path):
    def write(text, name="mine.py"):
        (tmp_path / name).write_text(text, encoding="utf-8")
        return tmp_path / name

    return write


def test_an_effect_from_a_file_takes_part_like_a_built_in_one(write):
    assert effects.load_effect(f"{write(GOOD)}:Etalon") == "etalon"
    assert "etalon" in effects.effect_names()
    entry = catalogue.entry("etalon")
    assert (entry.summary, entry.suspect) == ("Bias that follows the sine of the temperature", True)
    assert entry.look_alikes == ("spline", "thermal_lag")
    assert np.abs(signature("etalon").contribution).max() == pytest.approx(1.0)
    model = load_model(write("name: m\neffects: [{polynomial: {order: 5}}, {etalon: {phase_rad: 0.5}}]\n", "m.yaml"))
    record = thermal_cycle()
    temperature = record.channel("temperature")
    bias = 1.0 + 0.02 * temperature + 0.3 * np.sin(temperature / 2.2 + 0.5) + white(record, 0.05)
    found = fit_model(model, with_bias(record, bias))
    assert found.theta["etalon.period_degc"] == pytest.approx(2.2, abs=0.002)
    assert {c.key: c.value for c in found.coefficients}["etalon.a"] == pytest.approx(0.3, abs=0.02)


def test_the_documentation_page_is_of_the_built_in_effects_only(write):
    before = catalogue.markdown()
    effects.load_effect(f"{write(GOOD)}:Etalon")
    assert catalogue.markdown() == before


def test_loading_the_same_effect_again_replaces_it(write):
    path = write(GOOD)
    effects.load_effect(f"{path}:Etalon")
    write(GOOD.replace("phase_rad: float = 0.0", "phase_rad: float = 1.0"))
    effects.load_effect(f"{path}:Etalon")
    assert effects.make("etalon").phase_rad == 1.0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("frozen=True", "frozen=False"), r"decorated with @dataclass\(frozen=True\)"),
        (("class Etalon(Effect)", "class Etalon"), r"derives from bench\.Effect"),
        (('    name = "etalon"\n', ""), "name is None, it must be a word"),
        (('= "etalon"\n    needs', '= "spline"\n    needs'), "the name 'spline' is a built-in effect's"),
        (('= "etalon"\n    needs', '= "my etalon"\n    needs'), "it must be a word such as 'my_effect'"),
        (('("temperature",)', '("temperatur",)'), "needs 'temperatur', which is not a channel"),
        (("[:, None]", ""), r"columns\(\) must give an array"),
        (("np.sin(", "np.nan * np.sin("), "values that are not finite"),
        (("[:, None]", "[:, None][:, :0]"), "the effect would do nothing"),
        (('(("a", "deg/h"),)', '(("a", "deg/h"), ("b", "deg/h"))'), "a name and a unit for each of the 1 columns"),
        (('    amplitudes = (("a", "deg/h"),)\n', ""), "`amplitudes` must hold a name and a unit"),
        (("1.0, 3.0, 2.0", "1.0, 3.0, 5.0"), "low <= start <= high"),
        (('theta["period_degc"]', 'theta["p"]'), "fails on an example run: KeyError: 'p'"),
        (("phase_rad: float = 0.0", "phase_rad: float"), "option 'phase_rad' needs a default"),
        (("import numpy as np", "import nonsense_that_is_not_there"), "cannot be loaded: ModuleNotFoundError"),
        (("def columns(self, record, theta):", "def columns(self, record, theta)"), "cannot be loaded: SyntaxError"),
    ],
)
def test_a_class_that_breaks_the_contract_is_refused_in_one_line(write, change, message):
    assert change[0] in GOOD
    with pytest.raises(InputError, match=message) as caught:
        effects.load_effect(f"{write(GOOD.replace(*change))}:Etalon")
    assert "\n" not in str(caught.value)
    assert "etalon" not in effects.effect_names()


def test_a_place_without_an_effect_is_refused(write, tmp_path):
    with pytest.raises(InputError, match="has no class 'Etalom'; it has Etalon"):
        effects.load_effect(f"{write(GOOD)}:Etalom")
    with pytest.raises(InputError, match="no such file"):
        effects.load_effect(f"{tmp_path / 'other.py'}:Etalon")
    with pytest.raises(InputError, match=r"write mine\.py:Class"):
        effects.load_effect("mine.py")
    with pytest.raises(InputError, match="cannot be loaded: ModuleNotFoundError"):
        effects.load_effect("no_such_package.module:Etalon")


@pytest.fixture
def installed(monkeypatch, write, tmp_path):
    """What an installed package offers under `bench.effects`."""

    def installed(text):
        write(text, "offered_effects.py")
        monkeypatch.syspath_prepend(str(tmp_path))
        sys.modules.pop("offered_effects", None)
        offered = [EntryPoint("etalon", "offered_effects:Etalon", "bench.effects")]
        monkeypatch.setattr(registry, "entry_points", lambda group: offered if group == "bench.effects" else [])
        registry._discover.cache_clear()

    yield installed
    monkeypatch.undo()
    registry._discover.cache_clear()


def test_an_effect_of_an_installed_package_is_found(installed):
    installed(GOOD)
    assert "etalon" in effects.effect_names()
    assert effects.make("etalon").name == "etalon"


def test_a_broken_package_breaks_only_its_own_effect(installed):
    installed(GOOD.replace("[:, None]", ""))
    assert "etalon" not in effects.effect_names()
    assert effects.make("spline").name == "spline"
    with pytest.raises(InputError, match=r"effect 'etalon' of offered_effects:Etalon cannot be used: .*columns"):
        effects.make("etalon")


def test_every_command_that_reads_a_model_takes_effects_of_the_user(tmp_path):
    (tmp_path / "mine.py").write_text(GOOD, encoding="utf-8")
    own = ["--effect", f"{tmp_path / 'mine.py'}:Etalon"]
    assert "etalon " in bench("effects", *own).output
    added = bench("add", "etalon", "--model", "spline", "--out", tmp_path / "m.yaml", *own)
    assert added.exit_code == 0
    for name in ("run", "compare", "report", "diagnose", "improve", "add", "reveal"):
        assert "own_effects" in {parameter.name for parameter in main.commands[name].params}


def test_the_class_in_the_documentation_is_an_effect(write):
    text = (Path(__file__).parents[2] / "docs" / "howto" / "effects.md").read_text(encoding="utf-8")
    (code,) = re.findall(r"```python\n# etalon\.py\n(.*?)```", text, re.DOTALL)
    assert effects.load_effect(f"{write(code)}:Etalon") == "etalon"
