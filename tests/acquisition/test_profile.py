"""Profiles: legs in order, a continuous set point, and everything that is wrong said with its line."""

import re
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bench.acquisition.profile import legs, preflight, profile
from bench.acquisition.profile.profile import Profile
from bench.acquisition.station.settings.station import StationSettings
from bench.base import load_config
from bench.base.errors import InputError

CALM = settings(max_examples=60)
SHIPPED = sorted((Path(__file__).parents[2] / "profiles").glob("*.yaml"))
COOLING = ((-40, 0.64), (-35, 1.2), (-30, 1.8), (0, 2.8), (23, 3.6), (85, 6.0))
"""Of the TestEquity 107, by the live-load table and the cool-down times of its manual, p. 7-1, and 3.29 kJ/K."""
CHAMBER = preflight.Limits(-42, 130, 5.0, COOLING, turn_dps=200.0)

RAMPS = """
name: test
start: {temperature_degc: 25}
settle: {dwell_min: 10, slope_degc_per_min: 1}
rates: {heating_degc_per_min: 3, cooling_degc_per_min: 1}
segments:
  - {kind: ramp, to_degc: 55}
  - {kind: soak, duration_min: 7}
  - kind: repeat
    times: 2
    segments:
      - {kind: ramp, to_degc: 15}
      - {kind: ramp, to_degc: 55, rate_degc_per_min: 2}
  - {kind: soak, until: settled, settle: {dwell_min: 20}}
  - {kind: step, temperatures_degc: [40, 25], average_min: 4}
"""


def load(text):
    return profile.profile_from_text(text, "p.yaml")


def refusal(text):
    with pytest.raises(InputError) as caught:
        load(text)
    return str(caught.value)


def levels(found, level):
    return [finding.text for finding in found if finding.level == level]


def test_legs_are_the_segments_in_order_with_repeats_written_out():
    legs = load(RAMPS).legs()
    assert [(leg.kind, leg.target_degc) for leg in legs] == [
        ("step", 25), ("ramp", 55), ("soak", 55), ("ramp", 15), ("ramp", 55), ("ramp", 15), ("ramp", 55),
        ("soak", 55), ("step", 40), ("soak", 40), ("step", 25), ("soak", 25),
    ]  # fmt: skip
    assert [leg.index for leg in legs] == list(range(12))
    assert len({leg.name for leg in legs}) == 12
    assert [leg.line for leg in legs] == [3, 7, 8, 12, 13, 12, 13, 14, 15, 15, 15, 15]


def test_a_ramp_without_a_rate_takes_the_limit_of_its_direction():
    up, down, own = (load(RAMPS).legs()[i] for i in (1, 3, 4))
    assert (up.rate_degc_per_min, down.rate_degc_per_min, own.rate_degc_per_min) == (3, 1, 2)
    assert (up.direction, down.direction) == ("heating", "cooling")
    assert (up.duration_s, down.duration_s, own.duration_s) == (600, 2400, 1200)


def test_settle_rules_of_a_segment_change_only_what_they_name():
    start, last_soak = load(RAMPS).legs()[0].settle, load(RAMPS).legs()[7].settle
    assert start.dwell_s == 600
    assert last_soak.dwell_s == 1200
    assert last_soak.slope_degc_per_min == start.slope_degc_per_min == 1


def test_a_step_settles_first_and_is_averaged_in_a_segment_of_its_own():
    go, stay = load(RAMPS).legs()[8:10]
    assert (go.settle is not None, go.duration_s) == (True, 0)
    assert (stay.kind, stay.settle, stay.duration_s) == ("soak", None, 240)


def test_a_ramp_faster_than_the_limits_is_refused_at_its_line():
    text = RAMPS.replace("to_degc: 15", "to_degc: 15, rate_degc_per_min: 1.5")
    assert "p.yaml:12: " in refusal(text)
    assert "rate_degc_per_min is 1.5, but `rates` limits cooling to 1" in refusal(text)


def test_a_ramp_without_any_rate_is_refused_at_its_line():
    assert refusal("name: x\nsegments:\n  - {kind: ramp, to_degc: 3}\n").startswith(
        "p.yaml:3: segments[0]: a ramp needs"
    )


@pytest.mark.parametrize(
    ("segment", "message"),
    [
        ("{kind: soak}", "a soak needs duration_min, `until: settled`, or both"),
        ("{kind: soak, duration_min: 3, settle: {dwell_min: 1}}", "`settle` has no effect without"),
        ("{kind: rampp, to_degc: 1}", "kind is 'rampp'; did you mean 'ramp'?"),
        ("{kind: ramp, to_degc: 10, rate: 1}", "unknown key 'rate'; did you mean 'rate_degc_per_min'?"),
        ("{kind: ramp, to_degc: -300, rate_degc_per_min: 1}", "must be greater than or equal to -273.15"),
        ("{kind: step, temperatures_degc: []}", "must have at least 1"),
        ("{kind: repeat, times: 1000, segments: [{kind: repeat, times: 3, segments: [{kind: soak, duration_min: 1}]}]}",
         "makes more than 2000 legs"),
    ],
)  # fmt: skip
def test_wrong_segments_are_refused_at_their_line(segment, message):
    text = refusal(f"name: x\nsegments:\n  - {segment}\n")
    assert text.startswith("p.yaml:3: ")
    assert message in text


ramp = st.fixed_dictionaries(
    {"kind": st.just("ramp"), "to_degc": st.floats(-60, 120), "rate_degc_per_min": st.floats(0.05, 20)}
)
soak = st.fixed_dictionaries({"kind": st.just("soak"), "duration_min": st.floats(0, 300)})
step = st.fixed_dictionaries(
    {"kind": st.just("step"), "temperatures_degc": st.lists(st.floats(-60, 120), min_size=1, max_size=4)}
)
segments = st.recursive(
    ramp | soak | step,
    lambda inner: st.fixed_dictionaries(
        {"kind": st.just("repeat"), "times": st.integers(1, 3), "segments": st.lists(inner, min_size=1, max_size=3)}
    ),
    max_leaves=6,
)


@st.composite
def profiles(draw):
    content = {"name": "h", "segments": draw(st.lists(segments, min_size=1, max_size=6))}
    if draw(st.booleans()):
        content["start"] = {"temperature_degc": draw(st.floats(-40, 85))}
    return Profile.model_validate(content, strict=False)


@CALM
@given(profiles())
def test_the_set_point_is_continuous_and_meets_every_target(found):
    fastest = max([leg.rate_degc_per_min or 0 for leg in found.legs()] + [legs.STEP_DEGC_PER_MIN])
    times = np.linspace(0, found.duration_s, 2001)
    jump = np.abs(np.diff(found.setpoint(times)))
    assert np.all(jump <= fastest / 60 * np.diff(times) * (1 + 1e-6) + 1e-6)
    for leg in found.legs():
        if leg.nominal_s > 1e-3:
            assert found.setpoint(leg.nominal_end_s) == pytest.approx(leg.target_degc, abs=1e-3)


@CALM
@given(profiles())
def test_legs_follow_each_other_without_gaps_and_add_up_to_the_duration(found):
    legs = found.legs()
    assert legs[0].nominal_start_s == 0
    for leg, after in pairwise(legs):
        assert after.nominal_start_s == leg.nominal_end_s
        assert after.from_degc == leg.target_degc
    assert sum(leg.nominal_s for leg in legs) == pytest.approx(found.duration_s)
    assert all(leg.timeout_s > leg.nominal_s * (1 - 1e-9) or leg.settle is not None for leg in legs)


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_shipped_profiles_run_on_the_chamber_that_they_are_for(path):
    chamber = CHAMBER
    special = {"imu_quick": "imu", "imu_check": "imu", "rate_surface_-55_125": "wide_range"}
    if path.stem in special:
        chamber = load_config(path.parent / "stations" / f"{special[path.stem]}.yaml", StationSettings).limits()
    found = preflight.check_profile(profile.load_profile(path), replace(chamber, switches_power=True))
    assert levels(found, "error") == []
    assert not any("chamber can only do" in text for text in levels(found, "warning"))
    assert profile.load_profile(path).name == path.stem


@pytest.mark.parametrize(
    ("name", "low_h", "high_h"),
    [
        ("ramp_-40_85", 8, 8.5),
        ("check_minor_loops", 4, 5),
        ("quick", 1, 80 / 60),
        ("imu_quick", 1.2, 1.7),
        ("steps_-40_85", 8, 11),
    ],
)
def test_shipped_profiles_take_the_time_that_they_promise(name, low_h, high_h):
    path = next(path for path in SHIPPED if path.stem == name)
    assert low_h <= profile.load_profile(path).duration_s / 3600 <= high_h


def test_the_calibration_run_has_everything_that_separates_causes():
    path = next(path for path in SHIPPED if path.stem == "ramp_-40_85")
    assert levels(preflight.check_profile(profile.load_profile(path), CHAMBER), "warning") == []


def test_one_rate_is_warned_of():
    path = next(path for path in SHIPPED if path.stem == "one_rate")
    found = levels(preflight.check_profile(profile.load_profile(path), CHAMBER), "warning")
    assert any("all ramps at 1 degC/min" in text for text in found)
    assert any("no minor loop" in text for text in found)


def test_another_profile_under_the_name_of_a_shipped_one_is_warned_of():
    shipped = next(path for path in SHIPPED if path.stem == "quick").read_text()

    def found(text):
        told = preflight.check_profile(profile.profile_from_text(text), CHAMBER)
        return [(one.level, one.line) for one in told if "is taken by a shipped profile" in one.text]

    for own in (shipped, f"# mine\n{shipped}", shipped.replace("name: quick", "name: mine")):
        assert found(own) == []
    assert found(f"# mine\n{shipped.replace('to_degc: 50', 'to_degc: 55')}") == [
        ("warning", 2 + shipped.splitlines().index("name: quick"))
    ]


def test_two_profiles_of_the_user_under_one_name_are_warned_of(tmp_path, monkeypatch):
    text = next(path for path in SHIPPED if path.stem == "quick").read_text().replace("name: quick", "name: mine")
    hotter = text.replace("to_degc: 50", "to_degc: 55")
    first = tmp_path / "profiles" / "first.yaml"
    first.parent.mkdir()
    first.write_text(text)
    (first.parent / "limits.yaml").write_text("name: mine\nlimits: []\n")
    (first.parent / "broken.yaml").write_text("name: mine\n\tb: [")

    def found(file, text):
        file.write_text(text)
        told = preflight.check_profile(profile.load_profile(file), CHAMBER)
        return [
            (one.level, one.line, re.search("taken by (.*) of other", one.text)[1])
            for one in told
            if "taken" in one.text
        ]

    line = text.splitlines().index("name: mine") + 1
    beside, elsewhere = first.with_name("second.yaml"), tmp_path / "second.yaml"
    assert (found(first, text), found(beside, text), found(beside, hotter)) == (
        [],
        [],
        [("warning", line, "first.yaml")],
    )
    beside.unlink()
    assert (found(first, hotter), found(elsewhere, text)) == ([], []), "the file itself may change"
    monkeypatch.chdir(tmp_path)  # where its `profiles` are the user's
    assert found(elsewhere, hotter) == []
    assert found(elsewhere, text) == [("warning", line, "profiles/first.yaml")]
    assert found(elsewhere, text.replace("name: mine", "name: mine_2")) == []


def test_targets_outside_the_station_are_errors_with_their_line():
    found = preflight.check_profile(load(RAMPS), preflight.Limits(20, 50, 5.0, 5.0))
    errors = [str(finding) for finding in found if finding.level == "error"]
    assert errors[0].startswith("p.yaml:7: error: ramp to 55 at 3: 55 degC is outside the station's limits, 20 to 50")
    assert [text.split(":")[1] for text in errors] == ["7", "12", "13"]
    with pytest.raises(InputError, match=r"^p\.yaml:7: .*\np\.yaml:12: "):
        preflight.refuse_errors(found)


def test_a_ramp_that_the_chamber_cannot_follow_is_announced_with_its_delay():
    text = "name: x\nstart: {temperature_degc: -20}\nsegments:\n  - {kind: ramp, to_degc: -40, rate_degc_per_min: 2}\n"
    found = levels(preflight.check_profile(load(text), CHAMBER), "warning")
    assert any("from -24 to -40 degC the chamber can only do 0.64 degC/min" in line for line in found)


def test_expected_time_agrees_with_the_chambers_manual():
    """TestEquity 107 manual p. 7-1: from 23 degC to 0, -20, -40 degC in 7, 15, 30 min."""
    for target, minutes in ((0, 7), (-20, 15), (-40, 30)):
        text = f"name: x\nsegments:\n  - {{kind: ramp, to_degc: {target}, rate_degc_per_min: 50}}\n"
        assert preflight.expected_duration_s(load(text), CHAMBER) / 60 == pytest.approx(minutes, rel=0.15)


def test_a_profile_that_ends_cold_and_never_returns_is_warned_of():
    text = "name: x\nstart: {temperature_degc: 25}\nsegments:\n  - {kind: ramp, to_degc: -20, rate_degc_per_min: 1}\n"
    found = levels(preflight.check_profile(load(text), CHAMBER), "warning")
    assert any("frost" in line for line in found)
    assert any("never returns to its start temperature" in line for line in found)
    assert any("no heating branch" in line for line in found)
    assert any("noise floor is read where the unit stands still for 5 min" in line for line in found)


def test_a_disk_that_is_too_small_is_an_error():
    found = preflight.check_profile(
        load(RAMPS), CHAMBER, preflight.Recording((500.0, 500.0), bytes_per_s=40_000, free_bytes=1e6)
    )
    assert "only 1 MB are free" in levels(found, "error")[0]


@pytest.mark.parametrize(("width", "height"), [(40, 5), (78, 12), (120, 20)])
def test_the_picture_fits_and_shows_the_extremes(width, height):
    lines = preflight.profile_picture(load(RAMPS), width, height).splitlines()
    assert len(lines) == height + 1
    assert max(map(len, lines)) <= width
    assert lines[0].split()[0] == "55"
    assert lines[-2].split()[0] == "15"
    assert lines[-1].isascii()


@pytest.mark.parametrize("height", [5, 12])
def test_a_constant_profile_is_a_line_in_the_middle_of_its_picture(height):
    profile = load("name: flat\nstart: {temperature_degc: 23}\nsegments:\n  - {kind: soak, duration_min: 60}\n")
    lines = preflight.profile_picture(profile, 60, height).splitlines()[:height]
    assert [line.split()[0] for line in lines if line[:6].strip()] == ["24", "23", "22"]
    assert [y for y, line in enumerate(lines) if any(0x2800 < ord(sign) < 0x2900 for sign in line)] == [height // 2]
