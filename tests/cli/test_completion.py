"""A shell completes names that only the bench knows."""

import pytest
from click.shell_completion import ShellComplete

from bench.cli import main


def offered(*typed: str) -> list[str]:
    *before, last = typed
    return [item.value for item in ShellComplete(main, {}, "bench", "_BENCH_COMPLETE").get_completions(before, last)]


@pytest.mark.parametrize(
    ("typed", "expected"),
    [
        (("cert",), ["certificate"]),
        (("compare", "RUN", "--model", "spl"), ["spline", "spline_lag_loop"]),
        (("add", "thermal"), ["thermal_lag"]),
        (("effects", "show", "creep"), ["creep"]),
        (("run", "profiles/quick.yaml", "--unit", "SIM"), ["SIM-0001"]),
        (("registry", "list", "--unit", "G-1"), ["G-1042"]),
    ],
)
def test_names_that_begin_as_what_was_typed(tmp_path, monkeypatch, typed, expected):
    (tmp_path / "reports" / "G-1042").mkdir(parents=True)
    monkeypatch.chdir(tmp_path)
    assert offered(*typed) == expected


def test_a_model_may_be_a_file_and_a_broken_station_is_no_traceback(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert offered("compare", "RUN", "--model", "./mine") == ["./mine"]
    (tmp_path / "broken.yaml").write_text("units: 5")
    assert offered("run", "p.yaml", "--station", "broken.yaml", "--unit", "S") == []
