"""Statistics of a fleet: what is there is found, what is not there is not, and the numbers are those of the books."""

import csv
import json
import re
from dataclasses import replace

import numpy as np
import pytest
from scipy import sparse, stats

from bench.analysis import load_limits
from bench.archive.fleet import statistics as judging
from bench.archive.fleet import trends
from bench.archive.fleet import units as reading
from bench.archive.fleet.board import overview
from bench.archive.fleet.capability import capability, proportion
from bench.archive.fleet.charts import chart, signals
from bench.archive.fleet.drift import Levelled, corrected
from bench.archive.fleet.drift import drifts as drifts_of
from bench.archive.fleet.figures import control, yields
from bench.archive.fleet.groups import coded, median, medians
from bench.archive.fleet.listing import listing
from bench.archive.fleet.mixed import Columns
from bench.archive.fleet.statistics import statistics
from bench.archive.fleet.units import Runs, fleet_of
from bench.archive.fleet.unlike import unlike
from bench.archive.registry.opening import FILE, open_registry
from tests.support.commands import bench
from tests.support.fleet_runs import LIMITS, line, station
from tests.support.page_modules import SOURCE
from tests.support.run_folders import keep

DAY_S = 86400.0


@pytest.mark.parametrize(
    ("rule", "z"),
    [
        (1, [0, 3.1]),
        (2, [0.2, 0.1] * 4 + [0.3]),
        (3, [-0.5, -0.3, 0.1, 0.2, 0.4, 0.6]),
        (4, [0.1, -0.1] * 7),
        (5, [2.1, 0, 2.2]),
        (6, [1.1, 1.2, 0, 1.3, 1.4]),
        (7, [0.5, -0.5, 0.2] * 5),
        (8, [1.1, -1.2] * 4),
    ],
)
def test_each_rule_of_nelson_is_broken_by_its_pattern_and_not_before(rule, z):
    assert rule in {signal.rule for signal in signals(np.array(z, dtype=float))}
    assert rule not in {signal.rule for signal in signals(np.array(z[:-1], dtype=float))}


def test_a_process_in_control_breaks_rule_one_as_often_as_chance_does():
    values = np.random.default_rng(1).normal(5.0, 2.0, 20_000)
    drawn = chart(values)
    assert drawn.centre == pytest.approx(5.0, abs=0.05)
    assert drawn.sigma == pytest.approx(2.0, rel=0.03)
    assert drawn.range_limit == pytest.approx(3.267 * 1.128 * 2.0, rel=0.03)
    beyond = sum(signal.rule == 1 for signal in drawn.signals)
    assert stats.binomtest(beyond, values.size, 0.0027).pvalue > 0.01


def test_too_few_or_equal_values_make_no_chart():
    assert chart(np.arange(7.0)) is None
    assert chart(np.ones(50)) is None


def test_capability_is_room_over_three_sigma_and_its_interval_covers():
    random = np.random.default_rng(2)
    covered = 0
    for _ in range(300):
        found = capability(random.normal(0.0, 1.0, 100), -6.0, 4.0)
        covered += found.ppk_interval[0] <= 4.0 / 3.0 <= found.ppk_interval[1]
    assert covered / 300 == pytest.approx(0.95, abs=0.03)
    assert capability(random.normal(size=100), None, None) is None
    assert capability(random.normal(size=7), 0.0, 1.0) is None


def test_indices_say_what_is_outside_whatever_the_shape():
    """One in a thousand beyond the limits is a Ppk of about one; the formula for normal values gave two."""
    random = np.random.default_rng(8)
    mixed = random.normal(0.0, 1.0, 100_000)
    mixed[::1000] = 20.0
    found = capability(mixed, -8.0, 8.0)
    assert (found.shape, found.outside) == ("counted", 100)
    assert found.ppk_interval[0] < stats.norm.isf(0.001) / 3.0 < found.ppk_interval[1]
    assert np.isnan(found.cpk)
    skewed = capability(random.lognormal(0.0, 0.8, 2000), None, float(stats.lognorm.isf(1e-4, 0.8)))
    assert skewed.shape == "transformed"
    assert skewed.ppk == pytest.approx(stats.norm.isf(1e-4) / 3.0, rel=0.06)
    assert [capability(random.normal(size=100), -4.0, 4.0).shape for _ in range(200)].count("normal") >= 198


def test_a_process_that_wanders_has_a_ppk_below_its_cpk():
    values = np.random.default_rng(3).normal(0, 0.1, 200) + np.linspace(0, 2, 200)
    found = capability(values, -5.0, 5.0)
    assert found.ppk < 0.5 * found.cpk


def test_a_proportion_has_an_interval_where_all_passed():
    low, high = proportion(200, 200)
    assert (low, high) == (pytest.approx(0.98, abs=0.005), pytest.approx(1.0))
    assert np.isnan(proportion(0, 0)).all()


def production(seed, slope=0.0, offset=0.0, units=200):
    random = np.random.default_rng(seed)
    days = np.arange(units) / 5.0
    lots = [f"L{i // 40}" for i in range(units)]
    stations = ["AB"[i % 2] for i in range(units)]
    values = random.normal(1.0, 0.1, units)
    values += np.where(np.array(stations) == "B", slope * days, 0.0) + np.where(np.array(lots) == "L2", offset, 0.0)
    return values, days * DAY_S, stations, lots


def drifts(*values_to_lots_and_quantity):
    *given, quantity = values_to_lots_and_quantity
    levelled = Levelled.of(*given)
    return drifts_of(levelled, quantity) if levelled else []


def significant(found):
    return {(one.kind, one.place) for one in corrected(found) if one.significant}


def test_a_drifting_station_and_an_odd_lot_are_told_apart():
    assert significant(drifts(*production(1, slope=0.02), "q")) == {("station", "B")}
    assert significant(drifts(*production(1, offset=0.15), "q")) == {("lot", "L2")}
    assert significant(drifts(*production(1, slope=0.02, offset=0.2), "q")) == {("station", "B"), ("lot", "L2")}


def test_chance_is_rarely_called_a_drift():
    alarms = sum(bool(significant(drifts(*production(seed), "q"))) for seed in range(300))
    assert stats.binomtest(alarms, 300, 0.01, alternative="greater").pvalue > 0.001


def of_many_stations(seed, drift=0.0, *, units=4000, stations=10, per_lot=100, lot_sigma=0.5, mixed=True):
    """Units of noise 1, a lot after the other, over 100 days; station 3 drifts by `drift` in all."""
    random = np.random.default_rng(seed)
    days = np.sort(random.uniform(0.0, 100.0, units))
    lot = np.arange(units) // per_lot
    station = random.integers(0, stations, units) if mixed else random.integers(0, stations, lot[-1] + 1)[lot]
    values = random.normal(0.0, lot_sigma, lot[-1] + 1)[lot] + random.normal(0.0, 1.0, units)
    values += np.where(station == 3, drift * days / 100.0, 0.0)
    return values, days * DAY_S, [f"S{i}" for i in station], [f"L{i:03d}" for i in lot]


def test_slopes_and_their_errors_are_those_of_a_mixed_model():
    sm = pytest.importorskip("statsmodels.api")
    values, time_s, stations, lots = of_many_stations(4, drift=1.0, units=800, stations=4, per_lot=40)
    t, s, lot = time_s / DAY_S, np.array(stations), np.array(lots)
    when = np.array([t[lot == one].mean() for one in lot])
    columns = np.column_stack(
        [*((s == f"S{i}").astype(float) for i in range(4)),
         *(np.where(s == f"S{i}", t - t[s == f"S{i}"].mean(), 0.0) for i in range(4)), when - when.mean()]
    )  # fmt: skip
    direct = sm.MixedLM(values, columns, groups=lot).fit(reml=True)
    covariance = np.asarray(direct.cov_params())[4:8, 4:8]
    weights = 1.0 / np.diag(covariance)[:3]
    along = np.append(-weights / weights.sum(), 1.0)
    mine = {one.place: one for one in drifts(values, time_s, stations, lots, "q") if one.kind == "station"}
    assert mine["S3"].change == pytest.approx(float(along @ np.asarray(direct.fe_params)[4:8]), rel=0.01)
    assert mine["S3"].error == pytest.approx(float(np.sqrt(along @ covariance @ along)), rel=0.01)


def test_a_drift_of_one_station_of_many_is_found():
    """Units of other lots count, not those within a lot alone, which see a fortieth of the drift."""
    for seed in range(10):
        assert significant(drifts(*of_many_stations(seed, drift=1.6), "q")) == {("station", "S3")}


@pytest.mark.parametrize("mixed", [True, False])
def test_lots_that_are_drawn_alike_and_stations_that_see_few_of_them_do_not_differ(mixed):
    assert sum(bool(significant(drifts(*of_many_stations(seed, mixed=mixed), "q"))) for seed in range(50)) <= 2


def test_the_first_and_the_last_lot_are_known_as_well_as_those_between():
    found = {one.place: one for one in drifts(*of_many_stations(5), "q") if one.kind == "lot"}
    assert found["L039"].error < 2.0 * found["L020"].error
    assert found["L000"].error < 2.0 * found["L020"].error


def test_a_drift_that_lots_hide_is_not_claimed():
    days = np.repeat(np.arange(10.0), 10)
    lots = [f"L{day:.0f}" for day in days]
    found = drifts(np.random.default_rng(5).normal(days, 0.1), days * DAY_S, ["A"] * 100, lots, "q")
    assert not [one for one in found if one.kind == "station"]


def test_one_bad_unit_is_no_drift():
    values, *rest = production(6)
    values[-1] += 50.0
    assert significant(drifts(values, *rest, "q")) == set()


def test_units_unlike_their_lot_are_found_though_each_quantity_alone_is_ordinary():
    random = np.random.default_rng(8)
    common = random.normal(size=200)
    table = np.column_stack(
        [common + random.normal(0, 0.1, 200), common + random.normal(0, 0.1, 200), random.normal(size=200)]
    )
    table[77] = (1.0, -1.0, 0.0)
    lots = [f"L{i // 50}" for i in range(200)]
    table += np.array([10.0, 0.0, 5.0]) * (np.arange(200) // 50)[:, None]
    distances, odd = unlike(table, ["a", "b", "c"], lots)
    assert [one.row for one in odd] == [77]
    assert np.argmax(distances) == 77


def test_a_tenth_of_odd_units_does_not_hide_itself():
    table = np.random.default_rng(9).normal(size=(200, 4))
    table[:20] += 8.0
    _, odd = unlike(table, list("abcd"), ["L"] * 200)
    assert {one.row for one in odd} == set(range(20))


def test_a_fleet_without_odd_units_rarely_has_one():
    alarms = 0
    for seed in range(100):
        table = np.random.default_rng(seed).normal(size=(200, 4))
        alarms += bool(unlike(table, list("abcd"), ["L"] * 200)[1])
    assert alarms <= 8


def test_gaps_and_constant_quantities_are_left_out():
    table = np.random.default_rng(10).normal(size=(50, 3))
    table[:, 1] = 4.0
    table[7, 0] = np.nan
    distances, _ = unlike(table, list("abc"), ["L"] * 50)
    assert np.flatnonzero(np.isnan(distances)).tolist() == [7]
    assert np.isnan(unlike(table[:5], list("abc"), ["L"] * 5)[0]).all()


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A line with a drifting station, an odd unit, a lot that differs, and a unit that fails, then passes."""
    root = tmp_path_factory.mktemp("line") / "reports"
    line(root, drift_dph_per_day=0.0006, odd=77, lot="L2")
    station(root, "L5-0200", "station-A", 40.0, residual=0.25)
    station(root, "L5-0200", "station-A", 41.0, residual=0.12)
    limits = root.parent / "limits.yaml"
    limits.write_text(LIMITS)
    assert bench("registry", "rebuild", "--out", root).exit_code == 0
    return root, limits


def test_the_whole_line_is_told_in_json_csv_and_a_page(made, tmp_path):
    root, limits = made
    page, table = tmp_path / "fleet.html", tmp_path / "fleet.csv"
    said = bench("fleet", "--out", root, "--limits", limits, "--html", page, "--csv", table, "--json")
    assert said.exit_code == 0
    found = json.loads(said.stdout)
    assert found["units"] == 201
    assert (found["yield"]["judged"], found["yield"]["first"], found["yield"]["final"]) == (201, 200, 201)
    moved = {(one["kind"], one["place"], one["quantity"]) for one in found["drifts"] if one["significant"]}
    assert moved == {("station", "station-B", "noise_floor_dph"), ("lot", "L2", "noise_floor_dph")}
    assert {(one["place"], one["quantity"]) for one in found["shifts"]} == {("station-B", "noise_floor_dph")}
    assert found["station_charts"]["false_alarm"] == 0.01
    assert {one["kind"] for one in found["station_charts"]["charts"]} == {"cusum", "ewma"}
    assert "L1-0077" in [one["unit"] for one in found["unlike"]]
    able = {one["name"]: one["capability"] for one in found["quantities"]}
    assert able["residual_rms_dph"]["outside"] == 0
    assert able["noise_floor_dph"] is None
    with table.open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 201 * 4
    assert {row["lot"] for row in rows} == {f"L{i}" for i in range(6)}
    html = page.read_text()
    assert "Fleet of 201 units" in html
    assert "station-B" in html
    assert "Stations that left their level" in html
    assert 'src="http' not in html


def test_a_station_that_drifts_is_not_named_again_for_its_shift(made):
    root, limits = made
    with open_registry(root / FILE) as registry:
        found = statistics(fleet_of(registry, limits=load_limits(limits)))
    further = replace(found.shifts[0], place="station-A")
    attention = overview(replace(found, shifts=(further, *found.shifts)))["attention"]
    assert {one.place for one in found.shifts} == {"station-B"}
    assert (attention["stations"], [one["place"] for one in attention["shifted"]]) == (["station-B"], ["station-A"])
    told = overview(replace(found, shifts=(replace(found.shifts[0], sudden=True),)))
    sudden = told["attention"]
    assert (sudden["stations"], [one["place"] for one in sudden["shifted"]]) == ([], ["station-B"])
    assert [one["kind"] for one in told["drifts"]] == ["lot"], (
        "a station that stepped is in the table of the shifts alone"
    )


def test_the_yield_over_time_is_that_of_the_first_attempts_of_each_week(tmp_path):
    """Weeks begin on Monday; a unit that passed when it was repeated failed in the week of its first run."""
    for number in range(40):
        failed = number in {8, 9, 37}  # two units in the week of 2026-03-16, one in that of 2026-05-11
        station(tmp_path, f"L0-{number:04d}", "A", 2.0 * number, residual=0.25 if failed else 0.12)
    station(tmp_path, "L0-0008", "A", 60.0, residual=0.12)
    limits = tmp_path / "limits.yaml"
    limits.write_text(LIMITS)
    assert bench("registry", "rebuild", "--out", tmp_path).exit_code == 0
    with open_registry(tmp_path / FILE) as registry:
        found = statistics(fleet_of(registry, limits=load_limits(limits)))
    (points,) = yields(*found.attempts)["data"]
    told = dict(zip(points["x"], points["text"], strict=True))
    assert told["2026-03-19T12:00:00Z"] == "2026-03-17 … 2026-03-21<br>33.3 % (1 / 3)"
    assert (found.passes.first, sum(share < 100 for share in points["y"])) == (37, 2)
    assert yields(found.attempts[0][:5], found.attempts[1][:5])["data"][0]["text"][0] == "2026-03-01<br>100.0 % (1 / 1)"
    first_day = yields(found.attempts[0][:1], found.attempts[1][:1])["layout"]["xaxis"]
    assert first_day["range"] == ["2026-02-27T12:00:00+00:00", "2026-03-03T12:00:00+00:00"], (
        "an axis of days, not of seconds"
    )


def test_no_points_have_the_colour_of_a_line_across_their_figure():
    stations = [f"S-{number:02d}" for number in range(12)]
    charted = control(chart(np.arange(12.0) % 5), "x", "deg/h", (0.1, 3.9), stations)
    looks = {(one["marker"]["color"], one["marker"]["symbol"]) for one in charted["data"] if one["name"] in stations}
    assert len(looks) == len(stations)
    points = [{"run": "r", "created": f"2026-03-0{day}T00:00:00Z", "profile": day, "value": 0.4} for day in range(1, 7)]
    drawn = [charted, trends.figure({"unit": "deg/h", "lower": None, "upper": 0.5, "points": points})]
    for figure in drawn:
        lines = {shape["line"]["color"] for shape in figure["layout"]["shapes"]}
        coloured = [one for one in figure["data"] if one["name"] != "breaks a rule"]
        assert lines
        assert [one["name"] for one in coloured if one.get("marker", {}).get("color") in lines] == []
    dark = (SOURCE / "style" / "tokens.css").read_text().partition('theme="dark"')[2]
    by_night = re.findall(r"--figure-(?!purple|grey)\w+: (#\w+)", dark.partition("} }")[0])
    assert len(set(by_night)) == len(by_night)


def test_a_fleet_is_counted_without_an_object_for_each_unit(made, monkeypatch):
    asked = []
    monkeypatch.setattr(Runs, "__getitem__", lambda self, place: asked.append(place))
    with open_registry(made[0] / FILE) as registry:
        assert {one.values.size for one in statistics(fleet_of(registry)).measured} == {201}
    assert asked == []


def test_two_processes_say_of_a_fleet_what_one_says(made, monkeypatch):
    def told():
        with open_registry(made[0] / FILE) as registry:
            return statistics(fleet_of(registry)).to_json()

    alone = told()
    monkeypatch.setattr(reading, "_LARGE", 0)
    monkeypatch.setattr(judging, "_MANY", 0)
    monkeypatch.setenv("BENCH_WORKERS", "2")
    assert told() == alone
    assert alone["drifts"]
    assert alone["quantities"]


def test_a_unit_outside_its_limits_is_exit_code_one_and_a_filter_leaves_it_out(made, tmp_path):
    root = made[0]
    strict = tmp_path / "strict.yaml"
    strict.write_text(LIMITS.replace("0.02,", "0.0125,").replace("name: line", "name: strict"))
    assert bench("fleet", "--out", root, "--limits", strict).exit_code == 1
    said = bench("fleet", "--out", root, "--limits", strict, "--unit-filter", "L[02-5]-.*")
    assert said.exit_code == 0
    assert "161 units" in said.output


def test_verdicts_of_the_reports_count_without_limits(tmp_path):
    root = tmp_path / "reports"
    for unit, word in (("U-1", "PASS"), ("U-2", "FAIL"), ("U-3", None)):
        folder = station(root, unit, "A", float(unit[-1]), residual=0.1)
        if word:
            keep(folder, "limits.json", {"name": "line", "verdict": word, "results": []})
    bench("registry", "rebuild", "--out", root)
    found = json.loads(bench("fleet", "--out", root, "--json").stdout)
    assert (found["yield"]["judged"], found["yield"]["first"]) == (2, 1)


def test_values_of_a_run_that_must_not_be_judged_move_nothing(tmp_path):
    root, limits = tmp_path / "reports", tmp_path / "limits.yaml"
    limits.write_text(LIMITS)

    def told():
        bench("registry", "rebuild", "--out", root)
        return json.loads(bench("fleet", "--out", root, "--limits", limits, "--json").stdout)

    line(root, 24)
    before = told()
    folder = station(root, "L0-0024", "station-A", 5.0, residual=9.0, walk=0.4)
    keep(folder, "limits.json", {"name": "line", "verdict": "INVALID", "results": []})
    after = told()
    assert (after["yield"]["judged"], after["yield"]["unjudged"]) == (24, 1)
    for part in ("quantities", "drifts", "shifts", "unlike"):
        assert after[part] == before[part]


def test_a_unit_stands_by_its_newest_judged_run_and_a_newer_one_is_told_beside(tmp_path):
    """A run that was not judged is no reject and proves nothing new: its values move nothing, either."""
    root = tmp_path / "reports"

    def told():
        bench("registry", "rebuild", "--out", root)
        said = bench("fleet", "--out", root, "--json")
        with open_registry(root / FILE) as registry:
            (unit,) = listing(registry, "L0-0003", None, "serial", 1, 0).units
        return said.exit_code, json.loads(said.stdout), unit

    line(root, 24)
    for number in range(24):
        (folder,) = (root / f"L0-{number:04d}").iterdir()
        keep(folder, "limits.json", {"name": "line", "verdict": "PASS", "results": []})
    before = told()
    newer = station(root, "L0-0003", "station-A", 30.0, residual=9.0, walk=0.4)
    for word in ("INVALID", None):
        keep(newer, "limits.json", {"name": "line", "verdict": word, "results": []})
        code, after, unit = told()
        assert code == before[0] == 0
        assert after["yield"] == before[1]["yield"]
        assert (after["yield"]["judged"], after["yield"]["unjudged"]) == (24, 0)
        for part in ("quantities", "drifts", "shifts", "unlike"):
            assert after[part] == before[1][part]
        assert [(one["unit"], one["run"]) for one in after["later"]] == [("L0-0003", unit["unjudged"])]
        assert (unit["standing"], unit["judged"]) == ("pass", "PASS")
        assert unit["unjudged"] == f"L0-0003/{newer.name}"
        assert "L0-0003 (2026-03-31 00:00 UTC): the newest run is not judged" in bench("fleet", "--out", root).output
    keep(newer, "limits.json", {"name": "line", "verdict": "FAIL", "results": []})
    code, after, unit = told()
    assert (code, after["later"], unit["standing"], unit["unjudged"]) == (1, [], "fail", None)


def test_a_unit_of_which_no_run_was_judged_is_not_judged_in_both_lists(tmp_path):
    for days in (0.0, 1.0):
        folder = station(tmp_path, "A-1", "one", days, residual=0.1)
        keep(folder, "limits.json", {"name": "line", "verdict": "INVALID", "results": []})
    bench("registry", "rebuild", "--out", tmp_path)
    with open_registry(tmp_path / FILE) as registry:
        assert statistics(fleet_of(registry)).passes.unjudged == 1
        assert listing(registry, "", None, "serial", 100, 0).standings == {"unjudged": 1}


def test_a_quantity_of_earlier_runs_only_has_no_mean(tmp_path):
    station(tmp_path, "A-1", "one", 0.0, residual=0.1)
    folder = station(tmp_path, "A-1", "one", 1.0, residual=0.1)
    content = json.loads((folder / "calibration.json").read_text())
    keep(folder, "calibration.json", {**content, "noise": {"coefficients": []}})
    bench("registry", "rebuild", "--out", tmp_path)
    with open_registry(tmp_path / FILE) as registry:
        found = {one["name"]: one["mean"] for one in overview(statistics(fleet_of(registry)))["quantities"]}
    assert found["residual_rms_dph"] == pytest.approx(0.1)
    assert found["noise_floor_dph"] is None


def test_of_too_few_units_for_a_chart_nothing_is_said_that_only_a_chart_could_show(tmp_path):
    (limits := tmp_path / "limits.yaml").write_text(LIMITS)
    for unit in ("A-1", "A-2"):
        station(tmp_path / "out", unit, "one", 0.0, residual=0.1)
    bench("registry", "rebuild", "--out", tmp_path / "out")
    said = bench("fleet", "--limits", limits, "--out", tmp_path / "out").stdout
    assert "No judged unit is outside its limits; there are too few for a chart." in said
    assert "no drift" not in said


def test_imported_units_are_one_fleet_whatever_their_tables_were_called(tmp_path):
    root, limits = tmp_path / "reports", tmp_path / "limits.yaml"
    limits.write_text(LIMITS)
    for n in range(30):
        told = {"profile": f"import of log{n}.csv", "cause": "imported", "station": None}
        station(root, f"U-{n}", "", float(n), residual=0.4 if n == 7 else 0.1, **told)
    bench("registry", "rebuild", "--out", root)
    found = json.loads(bench("fleet", "--out", root, "--limits", limits, "--json").stdout)
    assert (found["yield"]["judged"], found["yield"]["first"]) == (30, 29)


@pytest.mark.parametrize(
    ("pattern", "said"), [("Z.*", "no calibrated unit matches"), ("(", "not a regular expression")]
)
def test_a_filter_that_finds_nothing_is_bad_input(made, pattern, said):
    answer = bench("fleet", "--out", made[0], "--unit-filter", pattern)
    assert answer.exit_code == 2
    assert said in answer.stderr


def test_a_certificate_says_more_than_the_report(tmp_path):
    root = tmp_path / "reports"
    folder = station(root, "U-1", "A", 1.0, residual=0.1)
    keep(folder, "limits.json", {"name": "line", "verdict": "PASS", "results": []})
    results = [{"name": "bias_span_dph", "unit": "deg/h", "value": 7.5}]
    certificate = {"number": "C-1", "verdict": "FAIL", "issued": "2026-04-01", "operator": "Ada", "results": results}
    keep(folder, "certificate.json", certificate)
    bench("registry", "rebuild", "--out", root)
    shown = json.loads(bench("registry", "show", "U-1/" + folder.name, "--out", root, "--json").stdout)
    assert shown["certificates"][0]["number"] == "C-1"
    assert {"bias_span_dph": 7.5}.items() <= {one["name"]: one["value"] for one in shown["quantities"]}.items()
    assert bench("fleet", "--out", root).exit_code == 1


def test_names_are_numbered_and_medians_taken_as_numpy_does():
    random = np.random.default_rng(2)
    names = [f"L{number}" for number in random.integers(0, 7, 200)]
    values = random.normal(size=200)
    known, code = coded(names)
    there, place = np.unique(names, return_inverse=True)
    assert (list(known), code.tolist()) == (there.tolist(), place.tolist())
    wanted = [np.median(values[place == number]) for number in range(len(there))]
    assert medians(values, code).tolist() == wanted
    assert [median(values[:count]) for count in (1, 2, 7, 200)] == [
        np.median(values[:count]) for count in (1, 2, 7, 200)
    ]
    rows = np.array([5, 3, 3, 150])
    some, own = coded(names).at(rows)
    assert ([some[one] for one in own], len(some)) == ([names[row] for row in rows], len({names[row] for row in rows}))


def test_columns_of_few_entries_are_those_of_a_sparse_matrix():
    random = np.random.default_rng(4)
    place = np.column_stack([random.integers(0, 3, 50), random.integers(3, 6, 50), np.full(50, 6)])
    columns, y, group = (
        Columns(place, random.normal(size=(50, 3)), 7),
        random.normal(size=50),
        random.integers(0, 4, 50),
    )
    whole = sparse.csr_array((columns.value.ravel(), (np.repeat(np.arange(50), 3), place.ravel())), shape=(50, 7))
    assert np.array_equal(columns.gram(), (whole.T @ whole).todense())
    assert np.array_equal(columns.product(y), whole.T @ y)
    of_groups = sparse.csr_array((np.ones(50), (group, np.arange(50))), shape=(4, 50))
    assert np.array_equal(columns.sums(group, 4), (of_groups @ whole).todense())
    assert np.array_equal(columns.at(y > 0.0).gram(), (whole[y > 0.0].T @ whole[y > 0.0]).todense())


def test_simulated_runs_alone_or_none_of_them_can_be_asked_for(tmp_path):
    for number, simulated in enumerate((True, True, False)):
        station(tmp_path, f"U-{number}", "S", number, residual=0.1, simulated=simulated)
    bench("registry", "rebuild", "--out", tmp_path)
    asked = {(): 1, ("--real",): 1, ("--simulated",): 2}
    said = {option: bench("fleet", *option, "--out", tmp_path, "--json").stdout for option in asked}
    assert {option: json.loads(text)["units"] for option, text in said.items()} == asked
