"""The notebooks of docs/ run from their first cell to their last, and find what they say they find."""

import ast
import json
from pathlib import Path

import pytest

NOTEBOOKS = Path(__file__).parent.parent / "docs" / "notebooks"


def run_all(name):
    """Run the code cells in order, render what each ends with, and return the variables at the end.

    A kernel would add seconds and sockets, and run the same code.
    """
    names = {"__name__": "__main__"}
    for cell in json.loads((NOTEBOOKS / f"{name}.ipynb").read_text(encoding="utf-8"))["cells"]:
        if cell["cell_type"] != "code":
            continue
        code = ast.parse("".join(cell["source"]), filename=f"{name}.ipynb, {cell['id']}")
        last = code.body.pop() if isinstance(code.body[-1], ast.Expr) else None
        exec(compile(code, f"{name}.ipynb, {cell['id']}", "exec"), names)
        if last is not None:
            shown = eval(compile(ast.Expression(last.value), f"{name}.ipynb, {cell['id']}", "eval"), names)
            assert repr(shown)
            assert not hasattr(shown, "summary") or "<table>" in shown._repr_html_()
    return names


@pytest.mark.slow
def test_from_a_run_folder_to_the_missing_effect(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    found = run_all("missing_effect")
    assert found["why"].verdict == "missing_effect"
    assert found["why"].found[0].effect == "temperature_rate"
    assert found["why"].proved
    coefficient = found["better"].coefficients["temperature_rate.k1"]
    assert coefficient.value == pytest.approx(0.6, abs=4 * coefficient.std)
    assert found["better"].held_out.rms_dph < 0.5 * found["fit"].held_out.rms_dph
    assert found["better"].floor.floor_dph > 0.0
    assert list(tmp_path.iterdir()) == []


def test_from_ones_own_csv_to_a_calibrated_polynomial(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    found = run_all("own_csv")
    truth = {"a0": 12.0, "a1": 0.08, "a2": -1.5e-3, "a3": 2e-5}
    for name, value in truth.items():
        coefficient = found["fit"].coefficients[f"polynomial.{name}"]
        assert coefficient.value == pytest.approx(value, abs=4 * coefficient.std)
    errors = {order: fit.held_out.rms_dph for order, fit in found["fits"].items()}
    assert errors[1] > errors[2] > errors[3]
    assert errors[3] < 1.2 * found["fit"].floor.floor_dph
    assert found["corrections"]["outside"].tolist() == [True, *[False] * 9, True]
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("path", sorted(NOTEBOOKS.glob("*.ipynb")), ids=lambda path: path.stem)
def test_notebooks_are_kept_without_outputs(path):
    cells = [cell for cell in json.loads(path.read_text(encoding="utf-8"))["cells"] if cell["cell_type"] == "code"]
    assert all(not cell["outputs"] and cell["execution_count"] is None for cell in cells)
