"""A short form of `python -m benchmarks.web --only day`: the live page shows every update and does not grow."""

from benchmarks.web import a_day

UPDATES = 512


def test_the_live_page_shows_every_update_and_keeps_no_nodes_or_listeners_of_old_ones(chromium, tmp_path):
    first, *_, last = a_day(chromium, tmp_path, UPDATES, rest_s=0.0)
    assert last["updates"] > 0.9 * UPDATES
    assert last["nodes"] < 1.1 * first["nodes"]
    assert last["listeners"] < 1.1 * first["listeners"]
