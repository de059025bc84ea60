"""A new unit in a slot of the station, without an edit of the station file."""

from pathlib import Path

import pytest

from bench.base import InputError, library, parse_yaml
from bench.commands import Order, RunOptions, run_profile
from bench.commands.acquisition import station_file, station_of
from bench.commands.slots import seated
from bench.record import Manifest

PROFILES = Path(__file__).parents[2] / "profiles"
SHORT = """\
name: short
segments:
  - {kind: ramp, to_degc: 26, rate_degc_per_min: 2}
  - {kind: soak, duration_min: 3}
"""


def units_of(document):
    return [(unit.serial, unit.identity, unit.number) for unit in station_of(document).units]


def test_a_new_unit_takes_the_slot_of_a_known_one_and_its_number_is_expected_in_its_heartbeat():
    four = station_file(library() / "stations" / "four_units.yaml")
    place, serials = seated(four, ["GX-0815@SIM-0002", "SIM-0003"])
    assert serials == ["GX-0815", "SIM-0003"]
    before, after = units_of(four), units_of(place)
    assert after[1] == ("GX-0815", 815, before[1][2])
    assert [after[i] for i in (0, 2, 3)] == [before[i] for i in (0, 2, 3)]
    again = parse_yaml(place.text, place.file)  # what a run folder keeps
    assert units_of(again) == after


def test_a_unit_that_is_not_asked_for_may_have_the_number_that_a_new_one_sends():
    four = station_file(library() / "stations" / "four_units.yaml")
    place, _ = seated(four, ["GX-2@SIM-0001"])
    assert [(serial, identity) for serial, identity, _ in units_of(place)][:2] == [("GX-2", 2), ("SIM-0002", None)]
    both, _ = seated(four, ["GX-2@SIM-0001", "SIM-0002"])
    with pytest.raises(InputError, match="identity is 2, as that of GX-2 on can0"):
        station_of(both)


def test_a_station_without_new_units_stays_as_it_was_written():
    document = station_file(None)
    assert seated(document, ["SIM-0001"]) == (document, ["SIM-0001"])
    assert seated(document, ["SIM-0001@SIM-0001"]) == (document, ["SIM-0001"])


@pytest.mark.parametrize(
    ("unit", "said"),
    [
        ("GX-1@SIM-0009", "no slot 'SIM-0009' for unit 'GX-1'"),
        ("@SIM-0001", "must be 1 to 64 visible characters"),
        ("a\nb1@SIM-0001", "must be 1 to 64 visible characters"),
        ("x" * 65 + "@SIM-0001", "must be 1 to 64 visible characters"),
        ("GX@SIM-0001", "has no digits: the station checks the number that the unit sends"),
        ("SIM-0002@SIM-0001", "unit 'SIM-0002' has a slot of its own"),
    ],
)
def test_a_unit_that_cannot_take_a_slot_is_refused_in_one_line(unit, said):
    with pytest.raises(InputError, match=r".") as refused:
        seated(station_file(library() / "stations" / "four_units.yaml"), [unit])
    assert said in str(refused.value)
    assert "\n" not in str(refused.value)


def test_a_unit_that_was_never_in_a_station_file_is_run_and_sends_its_own_number(tmp_path):
    profile = tmp_path / "short.yaml"
    profile.write_text(SHORT)
    options = RunOptions(serials=["GX-0815@SIM-0001"], models=["polynomial"], operator="Olena")
    run_profile(profile, None, options, tmp_path / "out", True)
    (folder,) = (tmp_path / "out" / "GX-0815").glob("*_short")
    manifest = Manifest.read(folder)
    assert (manifest.unit, manifest.unit_identity.serial, manifest.operator) == ("GX-0815", 815, "Olena")


def test_the_same_new_unit_in_the_same_slot_is_the_same_job(tmp_path):
    plan = PROFILES / "plans" / "quick.yaml"
    station = PROFILES / "stations" / "four_units.yaml"
    one, again, other, known = (
        Order.load(plan, station, unit, tmp_path)
        for unit in ("GX-0815@SIM-0001", "GX-0815@SIM-0001", "GX-0815@SIM-0002", "SIM-0001")
    )
    assert (one.serial, one.digest()) == ("GX-0815", again.digest())
    assert len({order.digest() for order in (one, other, known)}) == 3
    assert Order.load(plan, None, "GX-0815@SIM-0001", tmp_path).digest() != one.digest()


def test_two_units_in_one_slot_are_refused_by_the_slot(tmp_path):
    station = PROFILES / "stations" / "four_units.yaml"
    with pytest.raises(InputError, match="'A-78' and 'A-77' are both in slot 'SIM-0001'"):
        Order.load_all(PROFILES / "plans" / "quick.yaml", station, ["A-78@SIM-0001", "A-77@SIM-0001"], tmp_path)
