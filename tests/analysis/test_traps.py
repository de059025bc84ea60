"""A few traps of `python -m benchmarks.traps`: the thermometer or the clock is wrong, not the gyro."""

import pytest

from benchmarks.recordings import TRAPS
from benchmarks.traps import Case, judged, run_case, section

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("trap", ["thermometer lag", "rate late", "thermometer loop, wide"])
def test_a_wrong_recording_is_not_blamed_on_the_gyro(trap):
    found = run_case(Case(trap, 1))
    assert judged(trap, found) in {"right", "tie"}, found


def test_the_campaign_has_at_least_twenty_traps_and_no_section_without_results(tmp_path):
    assert len(TRAPS) >= 20
    assert section(tmp_path / "none.jsonl") == ""
