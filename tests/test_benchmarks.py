"""The measuring command: what it writes, and what it reports for missing packages. The tests do not measure time."""

from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

from benchmarks import mechanisms
from benchmarks.__main__ import PAGE, SECTIONS, write
from benchmarks.limits import bits, gyro_payloads
from benchmarks.rounds import Case, Method, Row, Table, best, compared, measured


def test_the_page_has_a_place_for_every_section_and_every_module_makes_tables():
    page = PAGE.read_text()
    for name, section in SECTIONS.items():
        assert page.count(f"<!-- benchmark: {name} -->\n") == page.count(f"<!-- end: {name} -->") == 1
        assert all(callable(import_module(f"benchmarks.{module}").tables) for module in section.modules)


def test_no_mechanism_takes_the_name_of_another():
    assert len(mechanisms.TRUTHS) == sum(len(mechanisms.truths(group)) for group in mechanisms.GROUPS)


def test_a_section_is_replaced_and_the_rest_of_the_page_stays(tmp_path):
    page = tmp_path / "page.md"
    page.write_text("# A\n<!-- benchmark: fit -->\nold\n<!-- end: fit -->\nB\n")
    for text in ("new", "newer"):
        write(page, "fit", text)
        assert page.read_text() == f"# A\n<!-- benchmark: fit -->\n{text}\n<!-- end: fit -->\nB\n"
    with pytest.raises(ValueError, match="no markers"):
        write(page, "allan", "text")


CASES = {
    "sum": Case(
        lambda folder: [1.0] * 100_000,
        lambda given: given[:10],
        {
            "sum": Method(sum),
            "length": Method(len, limit=True),
            "fails": Method(lambda given: 1 / 0),
            "gone": Method(sum, ("no_such_package",)),
        },
        lambda answer, given, folder: abs(answer / len(given) - 1.0),
    ),
    "copy": Case(lambda folder: bytes(50_000_000), lambda whole: whole[:10], {"copy": Method(bytearray)}),
}


def test_a_method_runs_in_a_process_of_its_own_and_what_fails_or_is_missing_says_so():
    module = f"{Path(__file__).parent.name}.{Path(__file__).stem}"
    ours, limit, fails, gone = measured(module, Path(), {"sum": CASES["sum"]}, 2)
    assert (ours.failed, ours.error, limit.error) == ("", 0.0, None)
    assert "ZeroDivisionError" in fails.failed
    assert gone.failed == "not installed: no_such_package"


def test_memory_is_that_of_the_work_and_not_of_its_input():
    """In a process of its own: the heap of this one may hold 50 MB that other tests freed."""
    (row,) = measured(f"{Path(__file__).parent.name}.{Path(__file__).stem}", Path(), {"copy": CASES["copy"]}, 1)
    assert (row.failed, row.peak_mb) == ("", pytest.approx(50.0, abs=10.0))


def test_the_least_time_and_the_largest_memory_of_the_rounds_count():
    row = best([Row("c", "m", 2.0, 3.0, 10.0), Row("c", "m", 1.0, 4.0, 11.0)])
    assert (row.cpu_s, row.wall_s, row.peak_mb) == (1.0, 3.0, 11.0)


def test_a_ratio_is_against_the_first_row_of_the_case():
    rows = [Row("c", "ours", 1.0, 1.0, 1.0, 1e-15), Row("c", "theirs", 9.51, 9.0, 200.0), Row("c", "x", failed="no")]
    text = compared("Title", "How to read it.", rows).markdown()
    assert text.startswith("### Title\n\nHow to read it.\n\n| case |")
    assert "| c | **ours** | 1000.0 | 1000.0 | 1 | 1e-15 | 1 |" in text
    assert "| c | theirs | 9510.0 | 9000.0 | 200 | | 9.5 x |" in text
    assert "| c | x | no | | | | |" in text


def test_a_short_row_is_filled():
    assert (
        Table("T", "R.", ("a", "b", "c"), [["x"]]).markdown().endswith("| a | b | c |\n| --- | --: | --: |\n| x | | |")
    )


def test_a_frame_has_the_bits_of_iso_11898():
    """Against bits written as text: the check sum by long division, a bit of the other kind after five alike."""
    identifiers, payloads = np.array([0x120, 0, 0x7FF]), gyro_payloads(3)
    payloads[1] = 0
    for identifier, payload, found in zip(identifiers, payloads, bits(identifiers, payloads), strict=True):
        body = f"0{identifier:011b}000{8:04b}" + "".join(f"{byte:08b}" for byte in payload)
        left = int(body, 2) << 15
        for place in range(len(body) - 1, -1, -1):
            if left >> place + 15 & 1:
                left ^= 0xC599 << place
        sent = ""
        for bit in f"{body}{left:015b}":
            sent += bit
            if len(set(sent[-5:])) == 1 and len(sent) >= 5:
                sent += "10"[int(bit)]
        assert found == len(sent) + 13


@pytest.mark.parametrize("path", sorted(PAGE.parents[1].glob("benchmarks/[a-z]*.py")), ids=lambda path: path.stem)
def test_every_benchmark_can_be_imported(path):
    pytest.importorskip("pysindy") if path.stem in {"peers", "tabulate", "trials"} else None
    import_module(f"benchmarks.{path.stem}")


@pytest.mark.slow
def test_figures_are_those_of_independent_code():
    from benchmarks import independent

    loose = {"scale factor at 25 degC [ppm]": 2e-3, "the same by Monte Carlo [deg/h]": 0.02}
    for row in independent.rows():
        assert row.ours == pytest.approx(row.theirs, rel=loose.get(row.what, 1e-6)), row.what
