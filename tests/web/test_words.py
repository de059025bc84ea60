"""The page's catalogues: the same keys and placeholders in all languages, and no undefined key."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest

from bench.acquisition import IMPORTED
from bench.analysis import catalogue as library_of_effects
from bench.analysis.diagnosis.plan import ChamberLimits, plans
from bench.base import language as terminal
from bench.base import library
from bench.commands import load_station
from bench.commands.calibration.plan import Policy
from bench.commands.calibration.steps import STEP_NAMES
from bench.record import Verdict, slug
from tests.support.page_modules import SOURCE, catalogue, told

LANGUAGES = ("en", "uk", "zh")
PLURALS = {"en": {"one", "other"}, "uk": {"one", "few", "many", "other"}, "zh": {"other"}}
"""Cardinal plural categories of the Unicode CLDR."""

KEY = re.compile(r"""(?<![\w.$])(?:t|words\.t)\(\s*["']([^"']+)["']""")
PATTERN = re.compile(r"""(?<![\w.$])(?:t|words\.t)\(\s*`([^`]+)`""")


def forms(entry: str | dict[str, str]) -> dict[str, str]:
    """An entry's texts by plural category."""
    return {"": entry} if isinstance(entry, str) else entry


def placeholders(entry: str | dict[str, str]) -> set[str]:
    """Names in braces, of all forms."""
    return {name for text in forms(entry).values() for name in re.findall(r"\{(\w+)\}", text)}


def scripts() -> list[Path]:
    """Our own modules."""
    return sorted(SOURCE.rglob("*.js"))


@pytest.mark.parametrize("language", LANGUAGES[1:])
def test_every_language_has_the_keys_of_english(language: str) -> None:
    """A word that is missing in a language would appear in English."""
    assert catalogue(language).keys() == catalogue("en").keys()


@pytest.mark.parametrize("language", LANGUAGES)
def test_an_entry_has_the_placeholders_of_english(language: str) -> None:
    """A placeholder without a value, or a value without a placeholder, is an error of translation."""
    english = catalogue("en")
    wrong = [key for key, entry in catalogue(language).items() if placeholders(entry) != placeholders(english[key])]
    assert wrong == []


@pytest.mark.parametrize("language", LANGUAGES)
def test_counted_words_have_the_plural_forms_of_their_language(language: str) -> None:
    """Ukrainian has four, Chinese one."""
    counted = {key: set(entry) for key, entry in catalogue(language).items() if isinstance(entry, dict)}
    assert {key: have for key, have in counted.items() if have != PLURALS[language]} == {}


CHINESE = [*(SOURCE.parents[1]).glob("**/words/**/zh.json"), SOURCE.parents[1] / "base" / "words" / "told.json"]


def test_a_unit_and_the_bench_have_one_word_each_in_chinese() -> None:
    """产品 and 试验台, on the page, in what the bench says and in its reports."""
    assert [path.name for path in CHINESE if re.search("器件|测试台", path.read_text(encoding="utf-8"))] == []
    assert len(CHINESE) == 4


@pytest.mark.parametrize(
    "wrong",
    [
        "试验箱",
        "(?<!继续|没有)运行(?!中)|次运行",
        "校准(?!日期)",
        "等温",
        "剖面",
        "滞回",
        "工位位",
        "样本(?!内)",
        "缺失效应",
        "Allan偏差",
        "(?<!排入)计划",
        "嫌疑",
    ],
)
def test_a_chinese_word_means_one_thing(wrong: str) -> None:
    """温箱, 试验, 标定 (校准 of an instrument), 恒温, 曲线, 迟滞, 安装位, 采样, 缺少效应, Allan标准差, 方案, 可疑."""
    texts = [path.read_text(encoding="utf-8") for path in CHINESE]
    assert [line for text in texts for line in text.splitlines() if re.search(wrong, line)] == []


@pytest.mark.parametrize("path", CHINESE, ids=lambda path: path.name)
def test_no_chinese_text_has_a_space_beside_what_is_inserted(path: Path) -> None:
    """The browser sets the gap between scripts (`text-autospace`); a space would stand between Chinese words, too."""
    spaced = re.compile(r"[\u4e00-\u9fff] [\w{]|[\w}%] [\u4e00-\u9fff]")
    assert spaced.findall(path.read_text(encoding="utf-8")) == []


@pytest.mark.parametrize("language", LANGUAGES)
def test_no_text_is_empty(language: str) -> None:
    """An empty text would be invisible on the page."""
    texts = {key: forms(entry) for key, entry in catalogue(language).items()}
    assert [key for key, of_key in texts.items() if not all(text.strip() for text in of_key.values())] == []


@pytest.mark.parametrize("language", LANGUAGES)
def test_a_text_names_a_command_only_where_the_page_has_no_place_for_it(language: str) -> None:
    texts = {key: " ".join(forms(entry).values()) for key, entry in catalogue(language).items()}
    named = {key for key, text in texts.items() if re.search(r"[“«`]bench [a-z]| --[a-z]", text)}
    assert named == {"import.too_large", "run.unit.lot"}


def test_every_key_that_a_module_names_is_in_the_catalogue() -> None:
    """The page would show the key itself."""
    known = catalogue("en")
    named = {(key, path.name) for path in scripts() for key in KEY.findall(path.read_text(encoding="utf-8"))}
    assert {use for use in named if use[0] not in known} == set()


def test_every_pattern_of_keys_has_at_least_one_entry() -> None:
    """`verdict.${word}.next` needs words to choose from."""
    known = catalogue("en")
    patterns = {(key, path.name) for path in scripts() for key in PATTERN.findall(path.read_text(encoding="utf-8"))}
    for pattern, module in patterns:
        regex = "".join(
            ".+" if part.startswith("${") else re.escape(part) for part in re.split(r"(\$\{[^}]*\})", pattern)
        )
        assert any(re.fullmatch(regex, key) for key in known), f"{module}: {pattern}"


def test_languages_of_the_page_are_those_of_the_catalogues() -> None:
    """The switch offers the available languages."""
    offered = re.search(r"LANGUAGES = \{([^}]*)\}", (SOURCE / "lib" / "words.js").read_text(encoding="utf-8"))
    assert offered is not None
    assert tuple(re.findall(r"(\w+):", offered[1])) == LANGUAGES
    assert sorted(path.stem for path in (SOURCE / "words").glob("*.json")) == sorted(LANGUAGES)


def test_a_run_that_nobody_analysed_is_a_warning_and_never_measured() -> None:
    """Green means that the run was judged good."""
    script = """
    const { judged, toneOf } = page;
    const told = (word) => [word, toneOf(word)];
    const word = (end, unit) => told(judged({ state: "done", analysing: false, ...end }, unit));
    console.log(JSON.stringify([
      word({}, { analysed: false }), word({}, { analysed: true }), word({ analysing: true }, { analysed: false }),
      word({ state: "aborted" }, { analysed: false }), word({}, { analysed: true, limits: "PASS" }),
      word({}, { analysed: true, limits: "INVALID" }), told(page.worstFirst(["pass", "invalid", "fail"])[0]),
    ]));
    """
    assert told("pages/verdict/judged.js", script) == [
        ["not_analysed", "warn"],
        ["measured", "link"],
        ["analysing", "link"],
        ["aborted", "idle"],
        ["pass", "good"],
        ["invalid", "warn"],
        ["fail", "bad"],
    ]


@pytest.mark.parametrize(
    ("language", "told_of"),
    [
        ("en", ["3.0 s", "65,320 MB", "0.6\xa0°C/min", "23.4 °C"]),
        ("uk", ["3,0 с", "65\xa0320 МБ", "0,6\xa0°C/хв", "23,4 °C"]),
    ],
)
def test_the_value_of_a_guard_has_the_unit_of_the_language(language: str, told_of: list[str]) -> None:
    guards = [
        {"signal": "frame_age", "value": 3.0},
        {"signal": "disk_free_mb", "value": 65320.0},
        {"signal": "chamber_temperature", "value": 25.0, "per_min": 0.6},
        {"signal": "unit_coldest", "value": 23.4},
    ]
    assert spoken("pages/live/words.js", "valueOf", guards, language) == told_of


def test_a_margin_is_what_is_left_to_the_nearest_limit() -> None:
    given = [(0.5, None, 0.7), (3.0, -1.0, 2.0), (None, 0.0, 1.0)]
    script = "console.log(JSON.stringify(given.map(([value, lower, upper]) => page.margin({ value, lower, upper }))))"
    assert told("pages/verdict/judged.js", script, given) == [pytest.approx(0.2), -1.0, None]


def test_a_trend_joins_runs_of_one_profile_up_to_the_run_that_is_asked_for() -> None:
    points = [{"run": f"{n}", "profile": profile} for n, profile in enumerate("aabab")]
    script = "console.log(JSON.stringify(given.runs.map((run) => page.alike(given, run).map((point) => point.run))))"
    answer = told("pages/stock/trend.js", script, {"points": points, "runs": [None, "1", "gone"]})
    assert answer == [["2", "4"], ["0", "1"], ["2", "4"]]


def test_to_repeat_a_run_is_the_advice_only_where_it_can_help() -> None:
    whole = {"segments": [{"settled": True, "outcome": "done"}], "losses": {"received": 9, "lost": 0}}
    runs = [whole, {**whole, "losses": {"lost": 3}}, {**whole, "segments": [{"settled": False, "outcome": "timeout"}]}]
    script = "console.log(JSON.stringify(given.map((run) => page.advice('invalid', run))))"
    repeat, plan = "verdict.invalid.next", "verdict.invalid.next_plan"
    assert told("pages/verdict/advice.js", script, runs) == [plan, repeat, repeat]


def test_a_unit_is_passed_on_only_when_every_step_is_done() -> None:
    steps = {"calibrated": True, "flashed": True, "verified": True, "certified": True}
    runs = [{"steps": steps}, {"steps": {**steps, "certified": False}}]
    script = "console.log(JSON.stringify(given.map((run) => [page.advice('pass', run), page.achieved(run).missing])))"
    answer = told("pages/verdict/advice.js", script, runs)
    assert answer == [["verdict.pass.next_done", []], ["verdict.pass.next", ["certified"]]]
    words = [
        form
        for key, entry in catalogue("en").items()
        if key != "verdict.pass.next_done"
        for form in forms(entry).values()
    ]
    assert not [text for text in words if "pass it on" in text]


@pytest.mark.parametrize("language", LANGUAGES)
def test_a_verdict_against_limits_has_one_word_everywhere(language: str) -> None:
    """On the page, in the terminal, and in what the bench says."""
    page = catalogue(language)
    for verdict in Verdict:
        said = terminal.told(verdict.value, language) or verdict.value
        assert (page[f"verdict.{verdict.lower()}"], page[f"units.word.{verdict.lower()}"].upper()) == (said, said)
        assert terminal.words(language)[f"verdict.{verdict}"] == said
    assert page["units.word.invalid"] != page["units.word.unjudged"]


def test_every_verdict_has_a_word_a_sentence_and_a_next_step() -> None:
    """Every screen shows what to do."""
    judged = (SOURCE / "pages" / "verdict" / "judged.js").read_text(encoding="utf-8")
    table = re.search(r"WORDS = \{(.*?)\}", judged, re.DOTALL)
    assert table is not None
    words = re.findall(r"(\w+): \"", table[1])
    assert {"pass", "marginal", "fail", "invalid", "aborted", "equipment_failed"} <= set(words)
    known = catalogue("en")
    wanted = [f"verdict.{word}{part}" for word in words for part in ("", ".sentence", ".next")]
    assert [key for key in wanted if key not in known] == []


@pytest.mark.parametrize("language", LANGUAGES)
def test_an_outcome_has_one_word_and_one_tone_on_every_page(language: str) -> None:
    known = catalogue(language)
    words = {key.removeprefix("units.word."): text for key, text in known.items() if key.startswith("units.word.")}
    named = {word: text for word, text in words.items() if f"verdict.{word}" in known}
    assert len(named) == 13
    assert [word for word, text in named.items() if text.lower() != known[f"verdict.{word}"].lower()] == []
    assert spoken("pages/verdict/judged.js", "outcomeWord", ["PASS", "undecided"], language) == [
        words["pass"],
        words["undecided"],
    ]
    script = "console.log(JSON.stringify(given.map((word) => page.toneOf(word))))"
    tones = told("pages/verdict/judged.js", script, ["unknown_effect", "MARGINAL", "uncalibrated"])
    assert tones == ["warn", "warn", "idle"]
    own = [path.name for path in scripts() if re.search('missing_effect: *"', path.read_text(encoding="utf-8"))]
    assert own == ["judged.js"]


def test_every_channel_that_a_table_may_have_is_named_in_the_readers_language() -> None:
    names = spoken("lib/words.js", "channelWord", list(IMPORTED))
    assert [name for name in names if not re.search("[\u4e00-\u9fff]", name)] == []
    assert len(set(names)) == len(IMPORTED)


def spoken(module: str, call: str, given: Any, language: str = "zh") -> Any:
    """What a function of a module gives for each of the given values in a language."""
    script = f"""
    globalThis.document = {{ documentElement: {{}} }};
    const words = await import(new URL("{SOURCE.as_uri()}/lib/words.js"));
    await words.speak("{language}");
    await words.speakOfAll();
    console.log(JSON.stringify(given.map(page.{call})));
    """
    return told(module, script, given)


def test_every_effect_that_may_be_missing_is_explained_in_the_readers_language() -> None:
    summaries = {
        f"workbench.summary.{one.name}": one.summary
        for one in library_of_effects()
        if one.suspect or one.name == "spline"
    }
    english = catalogue("en")
    assert {key: text for key, text in english.items() if key.startswith("workbench.summary.")} == summaries


def test_a_lot_in_a_figure_is_called_one_in_the_readers_language() -> None:
    drawn = [{"data": [{"name": name}], "layout": {}} for name in ("lot L0", "lot no lot")]
    names = [figure["data"][0]["name"] for figure in spoken("lib/spoken.js", "spokenTitles", drawn)]
    assert names == [f"{catalogue('zh')['fleet.kind.lot']} L0", catalogue("zh")["fleet.no_lot"]]


def test_a_formula_among_the_rivals_of_a_run_is_written_as_it_can_be_used() -> None:
    formula = "(k + k_1 * temperature) * lag(dT_dt, tau_s)"
    assert spoken("pages/workbench/sentence.js", "rival", [formula, "my_effect"]) == [formula, "my effect"]


def test_every_shipped_file_that_is_chosen_has_a_name_in_the_readers_language() -> None:
    known = catalogue("en")
    shipped = [("plan", path) for path in library().glob("*.yaml")]
    shipped += [("limits", path) for path in library().glob("limits/*.yaml")]
    shipped += [("station", path) for path in library().glob("stations/*.yaml")]
    shipped += [("calibration", path) for path in library().glob("plans/*.yaml")]
    assert [f"{kind}.{path.stem}" for kind, path in shipped if f"{kind}.{path.stem}" not in known] == []


def test_an_arrow_of_a_figure_has_the_colour_of_its_words_and_hides_no_point() -> None:
    """By itself plotly draws it dark, also at night."""
    script = "console.log(JSON.stringify(page.themed({ annotations: [{ text: 'a' }] }, { ink: '#eee' }).annotations))"
    assert told("lib/figure.js", script) == [{"arrowcolor": "#eee", "standoff": 5, "text": "a"}]


def test_a_day_is_not_broken_into_lines() -> None:
    for language, written in (("en", "Nov 23, 2026"), ("uk", "23 лист. 2026 р.")):
        said = spoken("lib/words.js", "day", ["2026-11-23T12:00:00Z"], language)
        assert said == [written.replace(" ", "\u00a0")]


def test_what_a_diagnosis_proposed_is_offered_to_engineers_only() -> None:
    script = f"""
    const {{ session }} = await import(new URL("{SOURCE.as_uri()}/lib/store.js"));
    const offered = (role) => (session.set({{ role }}), given.map(page.isOffered));
    console.log(JSON.stringify([offered("operator"), offered("engineer")]));
    """
    plans = [{"id": "quick", "proposed": False}, {"id": "next-1", "proposed": True}]
    assert told("lib/names.js", script, plans) == [[True, False], [True, True]]


def test_a_plan_that_was_changed_has_its_own_words_not_those_of_the_shipped_one() -> None:
    plan = {"id": "quick", "title": "my quick", "summary": "0 to 70 degC"}
    given = [plan, {**plan, "shipped": True}, {**plan, "shipped": False}]
    named = spoken("lib/names.js", "planTitle", given, "en")
    assert named == ["Quick run, 0 to 50\u00a0°C", "Quick run, 0 to 50\u00a0°C", "my quick"]
    assert spoken("lib/names.js", "planPurpose", given, "en")[2] == "0 to 70 degC"
    runs = [{"profile": "quick", "shipped": shipped} for shipped in (True, False)]
    assert spoken("lib/names.js", "planName", runs, "en") == ["Quick run, 0 to 50\u00a0°C", "quick"]


def test_a_finding_names_a_plan_as_its_reader_knows_it() -> None:
    found = ["quick_check.yaml: is short", "S-1: plans/../mine.yaml:12: is short", "other.yaml:3: is short"]
    plans = [{"id": "quick_check", "title": "quick"}, {"id": "mine", "title": "My plan", "shipped": False}]
    said = spoken("lib/names.js", f"ofPlans && ((text) => page.ofPlans(text, {json.dumps(plans)}))", found, "en")
    assert spoken("lib/names.js", "ofPlans && ((text) => page.ofPlans(text))", found, "en") == [said[0], *found[1:]]
    assert said == ["Quick verification, 5 to 45\u00a0°C: is short", "S-1: My plan: is short", "other.yaml:3: is short"]


def test_a_shipped_station_is_named_whichever_way_its_name_is_written() -> None:
    given = ["four_units", "four-units", "my_own"]
    assert spoken("lib/names.js", "stationName", given) == ["四个产品", "四个产品", "my_own"]


def test_what_the_bench_says_in_english_is_written_as_the_page_writes_it() -> None:
    given = [
        "settled at 25 degC after 3 min; spline lacks thermal_lag and warm_up, 2.47 x its noise floor",
        "no 'warm_up' in profiles/warm_up.yaml: power_on_s: 3; 0.5 +- 0.1 degC/min, 4 x 2",
    ]
    assert spoken("lib/said.js", "english", given, "en") == [
        "settled at 25 °C after 3 min; spline lacks thermal lag and warm-up, 2.47 × its noise floor",
        "no 'warm_up' in profiles/warm_up.yaml: power_on_s: 3; 0.5 ± 0.1 °C/min, 4 × 2",
    ]


def test_a_segment_that_is_held_is_not_told_as_a_soak() -> None:
    ramp = {"kind": "ramp", "name": "ramp to -30 at 0.5", "target_degc": -30.0, "rate_degc_per_min": 0.5}
    held = {"kind": "soak", "name": "hold", "target_degc": 23.0, "rate_degc_per_min": None}
    told_of = spoken("pages/live/words.js", "segmentText", [ramp, held], "en")
    assert told_of == ["ramp to −30\u00a0°C at 0.5\u00a0°C/min", "held at 23\u00a0°C"]


def test_a_run_is_named_by_its_unit_and_moment_where_the_bench_names_its_folder() -> None:
    run = "GX-7/20261128T120000Z_ramp_-40_85"
    given = [f"{run}: no such run folder", f"`bench report {run}`", "profiles/ramp_-40_85.yaml: 1/2"]
    named, typed, file = spoken("lib/said.js", "runsNamed", given, "en")
    (own,) = spoken("lib/said.js", "runsNamed", [f"{run}：没有证书（`laboratory:`）"], "zh")
    assert re.fullmatch(r"GX-7 · .+ · 2026年11月28日\s[\d:]+：没有证书（`laboratory:`）", own)
    assert re.fullmatch(r"GX-7 · .+ · Nov\s28,\s2026, .+: no such run folder", named)
    assert [typed, file] == given[1:]


def test_negative_numbers_have_the_minus_of_the_figures_and_nothing_else_has() -> None:
    given = ["chamber -47 °C (unit -46.5 °C), -40…-20", "`bench run -5`, GX-7 of 2026-11-28, 1e-05, ramp_-40_85.yaml"]
    assert spoken("lib/said.js", "signed", given, "en") == ["chamber −47 °C (unit −46.5 °C), −40…−20", given[1]]


def test_a_measured_value_keeps_its_digits_and_a_given_one_has_no_more_than_it_was_given() -> None:
    values = [0.53, 0.1101, 1234.56, -2.0, 0, 3, 0.9996, 1.5e-7, 12345.6]
    measured = ["0.530", "0.110", "1235", "−2", "0", "3", "1.000", "1.50·10⁻⁷", "12,346"]
    call = "console.log(JSON.stringify(given.map((value) => page.{}(value))))"
    assert told("lib/words.js", call.format("sig"), values) == measured
    limits = [0.5, 2.0, 0.0005, -40.0]
    assert told("lib/words.js", call.format("asGiven"), limits) == ["0.5", "2", "0.0005", "−40"]


def test_a_time_that_is_expected_is_told_in_whole_minutes() -> None:
    times = spoken("lib/words.js", "forecast", [45, 599, 2893, 3580, 18600, None], "en")
    assert [time.replace("\u00a0", " ") for time in times] == [
        "45 s", "9 min 59 s", "48 min", "1 h 00 min", "5 h 10 min", "–",
    ]  # fmt: skip


def test_an_import_has_the_name_of_its_file_and_where_only_its_folder_is_known_that_of_the_folder() -> None:
    runs = [{"profile": profile} for profile in ("import of лог № 7 (2).csv", f"import_{slug('лог № 7 (2)')}")]
    assert spoken("lib/names.js", "planName", runs, "en") == ["Import: лог № 7 (2)", "Import: лог-7-2"]


def test_a_step_that_ended_with_warnings_is_no_good_one() -> None:
    step = {"name": "check", "state": "done", "cases": [], "facts": {"warnings": []}, "verdict": None}
    script = "console.log(JSON.stringify(given.map((step) => page.stepTone(step, {state: 'running'}))))"
    steps = [step, {**step, "facts": {"warnings": ["no lot"]}}]
    assert told("pages/calibrations/words.js", script, steps) == ["good", "warn"]


@pytest.mark.parametrize(
    ("key", "now", "after"),
    [
        ("ArrowRight", [0, 5], [1, 6]),
        ("ArrowRight", [4.5, 9.5], [5, 10]),
        ("ArrowLeft", [0.5, 5.5], [0, 5]),
        ("ArrowLeft", [0, 10], None),
        ("-", [6, 10], [4.4, 10]),
        ("-", [1, 9], None),
    ],
)
def test_keys_keep_a_figure_within_its_data(key: str, now: list[float], after: list[float] | None) -> None:
    script = "console.log(JSON.stringify(page.moved(...given, [0, 10])))"
    assert told("lib/figure.js", script, [key, now]) == (after and pytest.approx(after))


def test_a_job_that_ended_names_its_step_as_the_page_does() -> None:
    steps = [{"name": name} for name in STEP_NAMES]
    sentences = ["fit: the calibration run is FAIL", "brief: no such plan", "calibrated and verified"]
    jobs = [{"sentence": sentence, "steps": steps} for sentence in sentences]
    assert spoken("pages/calibrations/words.js", "ofStep", jobs, "uk") == [
        "Модель: the calibration run is FAIL", *sentences[1:],
    ]  # fmt: skip


def test_a_step_has_the_colour_and_the_word_of_its_outcome() -> None:
    steps = [{"name": "fit", "state": "done", "cases": [], "verdict": verdict} for verdict in (None, "FAIL", "INVALID")]
    assert spoken("pages/calibrations/words.js", "stepTone", steps) == ["good", "bad", "warn"]
    assert spoken("pages/calibrations/words.js", "stepWord", steps, "en") == ["done", "Fail", "Invalid"]


def test_a_filter_by_days_means_the_days_of_the_reader() -> None:
    script = """
    process.env.TZ = "Europe/Kyiv";
    console.log(JSON.stringify(given.map(([text, later]) => page.beginOf(text, later))));
    """
    given = [["2026-11-27", 0], ["2026-11-27", 1], ["2026-03-29", 0], ["2026-03-29", 1], ["", 0], ["yesterday", 1]]
    assert told("lib/days.js", script, given) == [
        "2026-11-26T22:00:00.000Z", "2026-11-27T22:00:00.000Z", "2026-03-28T22:00:00.000Z",
        "2026-03-29T21:00:00.000Z", "", "",
    ]  # fmt: skip


def test_a_finding_is_a_sentence_on_the_page() -> None:
    given = ["longest soak is 4 min: too short", "dT/dt is small.", "chamber.yaml: no map"]
    call = "console.log(JSON.stringify(given.map((text) => page.sentence(text))))"
    sentences = ["Longest soak is 4 min: too short.", "dT/dt is small.", "chamber.yaml: no map."]
    assert told("lib/said.js", call, given) == sentences


def test_a_value_and_its_sign_stay_in_one_line() -> None:
    given = ["leaves 1.5 × the noise floor, 0.2 °C", "−40…85 °C, …", "0至50 °C"]
    told_of = ["leaves 1.5\u00a0×\u00a0the noise floor, 0.2\u00a0°C"]
    told_of += ["−40\u2060…\u206085\u00a0°C, …", "0\u2060至\u206050\u00a0°C"]
    assert spoken("lib/words.js", "unbroken", given, "en") == told_of


def test_a_step_of_the_ladder_speaks_the_language_that_is_chosen_later() -> None:
    labels = [["+", {"effect": "aging"}], ["spline"], [{"effect": "hysteresis"}, {"option": "width_degc"}, "5"]]
    added, begun, edited = spoken("pages/workbench/state.js", "labelWord", labels)
    assert (added, begun) == ("+ 老化", "spline")
    assert edited.startswith("迟滞 ")


def test_effects_that_explain_as_much_as_a_formula_have_their_names() -> None:
    given = ["hysteresis + aging", "thermal_lag", "lag(dT_dt, 60 s) + temperature"]
    assert spoken("lib/words.js", "effectsWord", given) == ["迟滞 + 老化", "热滞后", given[2]]


@pytest.mark.parametrize(("language", "said"), [("uk", "англійською)"), ("zh", "英文）")])
def test_what_opens_a_paper_in_english_says_so(language: str, said: str) -> None:
    keys = ["verdict.report", "units.run.report", "units.open_pdf", "job.print", "run.certificate.get"]
    keys.append("run.certificate.get_draft")
    assert all(text.endswith(said) for text in spoken("lib/words.js", "t", keys, language))


def test_a_finding_keeps_the_names_of_the_user() -> None:
    call = "console.log(JSON.stringify(given.map(([text, names]) => page.sentence(text, names))))"
    given = [["abc is on can0", ["abc"]], ["unit abc is on can0", ["abc"]]]
    assert told("lib/said.js", call, given) == ["abc is on can0.", "Unit abc is on can0."]


@pytest.mark.parametrize(
    ("language", "advice"),
    [
        ("en", ["give it as “Check”", "with --out of the command line", "or “bench diff A B --lot” in a terminal"]),
        ("uk", ["дайте його як “Перевірка”", "--out командного рядка", "“bench diff A B --lot” у терміналі"]),
        ("zh", ["作为“检验”给出", "命令行的--out", "终端中的“bench diff A B --lot”"]),
    ],
)
def test_advice_for_the_command_line_is_one_for_the_page(language: str, advice: list[str]) -> None:
    english = [
        "Record another run and give it as --check before adding anything",
        "cannot record: free some or choose another place with --out",
        "or `bench diff A B --lot`",
    ]
    given = [terminal.told(text, language) or text for text in english]
    for said, part in zip(spoken("lib/said.js", "advised", given, language), advice, strict=True):
        assert part in said


def test_every_option_of_an_effect_is_named_in_the_readers_language() -> None:
    options = {name for one in library_of_effects() for name in one.options}
    known = catalogue("zh")
    named = {name: known.get(f"workbench.option.{name}", "") for name in options}
    assert [name for name, word in named.items() if not re.search("[\u4e00-\u9fff]", word)] == []


def test_why_a_run_is_proposed_is_said_in_the_readers_language() -> None:
    known = {"channels": [], "predicted_before": None, "use": "run", "decides": True, "name": "minor_loops"}
    designed = {**known, "predicted_before": 2.0, "predicted_after": 60.0, "probability_after": 0.9}
    names = [plan.name for plan in plans(ChamberLimits(-40.0, 85.0, 3.0, 2.0))]
    cases = [
        *({**known, "use": use} for use in ("run", "check", "static")),
        {**known, "use": "by_hand", "channels": ["supply", "chamber_setpoint"]},
        *({**designed, "name": name, "probability_after_repeats": 0.99} for name in names),
        {**designed, "name": names[0], "probability_after_repeats": 0.9, "faster_degc_per_min": [2.0, 1.5]},
        {**designed, "decides": False, "probability_after_repeats": 0.3},
    ]
    for sentences in spoken("pages/workbench/sentence.js", "reasons", cases):
        text = " ".join(sentences).replace("dT/dt", "").replace("°C/min", "")
        assert re.search("[\u4e00-\u9fff]", text)
        assert not re.search(r"[A-Za-z]{2,}|[{}]", text), text
    english = spoken("pages/workbench/sentence.js", "reasons", cases[-3:], "en")
    assert english[0][1:] == [
        "Diagnose all runs together after it, and again if it does not decide. If one of them alone is the cause, "
        "three such runs decide with a probability of 99\xa0%.",
    ]
    assert "it has to heat with up to 2 and cool with up to 1.5\xa0°C/min" in english[1][1]
    assert "No profile within the limits of the chamber can tell them apart" in english[2][0]
    assert "such runs" not in english[2][0], "no run was named before"


def test_what_a_step_of_a_calibration_found_is_said_in_the_readers_language() -> None:
    facts: dict[str, dict[str, Any]] = {
        "check": {"warnings": ["x"]},
        "static": {"duration_s": 7200.0},
        "run": {"rows": 900, "duration_s": 30000.0, "lost": 2},
        "fit": {"limits": "PASS", "model": "M1", "held_out_rms_dph": 0.123},
        "diagnose": {"doubts": [{"kind": kind} for kind in Policy.model_fields if kind != "marginal"]},
        "flash": {"calibration_id": "42"},
        "verify": {"rms_dph": 0.2, "over_floor": 1.5},
        "certificate": {"number": "7"},
    }
    assert list(facts) == list(STEP_NAMES)
    steps = [{"name": name, "state": "done", "facts": own, "verdict": "PASS"} for name, own in facts.items()]
    steps += [
        {"name": "fit", "state": "done", "facts": {"findings": []}},
        {"name": "verify", "state": "done", "facts": {"rms_dph": 0.2, "over_floor": None}, "verdict": "PASS"},
        {"name": "verify", "state": "done", "facts": {"worst": "z", "over_floor": 2.0}, "verdict": "PASS"},
    ]
    for text in spoken("pages/calibrations/words.js", "said", steps):
        assert not re.search(r"[A-Za-z]{2,}|[{}]", text.replace("RMS", "")), text
    older = [{"name": "run", "state": "done", "facts": {"run": "x"}}, {"name": "run", "state": "failed", "facts": {}}]
    assert spoken("pages/calibrations/words.js", "said", older) == ["", ""]


def test_lists_and_clauses_of_a_chinese_text_have_its_own_signs() -> None:
    parameters = {name: {"value": 12.0, "std": 1.0, "unit": "s"} for name in ("tau_s", "delay_s")}
    proof = {"by": "check", "before_dph": 2.0, "after_dph": 1.0}
    suspect = {"found": True, "proved": True, "proof": proof, "parameters": parameters}
    suspects = [{**suspect, "effect": one, "look_alikes": ["creep", "aging"]} for one in ("thermal_lag", "warm_up")]
    found = {"verdict": "missing_effect", "suspects": suspects, "unexplained": [], "rms_dph": 1.0, "floor_dph": 0.5}
    (chinese,), (english,) = (spoken("pages/workbench/sentence.js", "sentences", [found], one) for one in ("zh", "en"))
    assert not re.search("[,;:()]", "".join(chinese)), chinese
    values = "（时间常数 12.0\u00a0±\u00a01.0\u00a0s，延迟 12.0\u00a0±\u00a01.0\u00a0s）"
    assert chinese[0] == f"缺少：热滞后{values}、预热{values}。"
    assert "Thermal lag from Creep, Aging." in english[2]
    assert spoken("lib/spoken.js", "labelled", ["bias, residual [deg/h]"]) == ["零偏，残差 [°/h]"]
    channels = ["rate [deg/h]", "rate_x"]
    assert spoken("lib/spoken.js", "labelled", channels) == ["角速率 [°/h]", "角速率 x"]
    step = {"name": "verify", "state": "done", "facts": {"rms_dph": 0.2, "over_floor": 1.5}, "verdict": "PASS"}
    assert not re.search("[,;()]", *spoken("pages/calibrations/words.js", "said", [step]))


def test_every_guard_that_all_runs_have_is_named_in_the_readers_language() -> None:
    names = {standing.guard.name for standing in load_station(None).standing_guards()}
    assert len(names) > 5
    assert [name for name in names if f"guard.{name}" not in catalogue("en")] == []


def test_the_axis_of_a_profile_that_hardly_moves_has_at_least_two_numbers() -> None:
    curves = [[[0, low], [60, high]] for low, high in ((23, 23), (23, 24.5), (10, 40))]
    script = """
    const size = { width: 320, height: 130, axes: true, label: "-" };
    const parts = (curve) => [page.Drawing({ curve, ...size }).props.children].flat();
    const grid = (curve) => parts(curve).find((one) => one?.props?.edge).props;
    console.log(JSON.stringify(given.map((curve) => grid(curve)).map(({ low, high }) => high - low)));
    """
    assert min(told("lib/curve.js", script, curves)) >= 10


def test_runs_of_a_calibration_are_drawn_apart() -> None:
    curve = [[0, 23], [600, 40], [600, 23], [1200, 5]]
    script = """
    const size = { width: 320, height: 130, axes: false, label: "-" };
    const parts = [page.Drawing({ curve: given, ...size }).props.children].flat(4);
    const lines = parts.filter((one) => one?.props?.class === "curve-line").map(({ props }) => props.d);
    console.log(JSON.stringify(lines.map((line) => line.match(/[\\d.]+ /g).map(Number))));
    """
    first, second = told("lib/curve.js", script, curve)
    assert first[1] + 5 < second[0], "from the end of one to the beginning of the other"
    assert second[1] == 310


@pytest.mark.parametrize(("width", "ticks"), [(250, 3), (600, 8)])
def test_a_drawn_curve_has_as_many_numbers_as_its_place_has_room_for(width: int, ticks: int) -> None:
    script = """
    const size = { width: given, height: 300, axes: true, label: "-" };
    const drawn = page.Drawing({ curve: [[0, 10], [4860, 40]], ...size }).props;
    const grid = [drawn.children].flat().find((one) => one?.props?.edge);
    const times = [grid.type(grid.props)].flat(3).filter((one) => one?.props?.["text-anchor"] === "middle");
    console.log(JSON.stringify(times.length));
    """
    assert 2 <= told("lib/curve.js", script, width) <= ticks


@pytest.mark.parametrize(
    ("language", "texts"),
    [
        (
            "en",
            [
                "25 Nov",
                "nov 25, 2026",
                "25 november",
                "2026-11-25",
                "25.11.2026",
                "quick 25.11",
                "25/11/2026",
                "quick 11/25/2026",
            ],
        ),
        ("uk", ["25.11.2026", "25 листопада", "25 лист. 2026 р.", "25 лис", "виріб 25.11"]),
        ("zh", ["11月25日", "2026年11月25日", "2026/11/25"]),
    ],
)
def test_a_day_is_searched_as_the_readers_language_writes_it(language: str, texts: list[str]) -> None:
    """By the day that the page shows, which in Kyiv begins two hours before that of UTC."""
    script = """
    globalThis.document = { documentElement: {} };
    process.env.TZ = "Europe/Kyiv";
    const words = await import(new URL("words.js", process.argv[1]));
    await words.speak(given.language);
    console.log(JSON.stringify(given.texts.map((text) => page.dayIn(text.toLowerCase()))));
    """
    for text, day in zip(texts, told("lib/days.js", script, {"language": language, "texts": texts}), strict=True):
        assert text.lower().endswith(day["found"])
        hours = [f"-11-{hour}" for hour in ("24t22", "24t23", *(f"25t{hour:02d}" for hour in range(22)))]
        assert [hour.removeprefix("2026") for hour in day["hours"]] == hours
        assert all(hour.startswith("2026") == ("2026" in text) for hour in day["hours"])


def test_a_day_with_slashes_that_may_be_either_is_searched_as_both() -> None:
    script = "console.log(JSON.stringify(given.map((text) => page.dayIn(text).hours.map((hour) => hour.slice(0, 10)))))"
    either, same = told("lib/days.js", script, ["u 5/11/2026", "11/11/2026"])
    assert {"2026-11-05", "2026-05-11"} <= set(either)
    assert len(set(same)) <= 2


def test_a_word_that_is_no_day_is_searched_as_it_is() -> None:
    """Serial numbers, plans, and days that no month has."""
    script = "console.log(JSON.stringify(given.map((text) => page.dayIn(text))));"
    texts = ["sim-0001", "ramp 25", "u 31.13.2026", "30.02.2026", "0.5", "31/13/2026"]
    assert told("lib/days.js", script, texts) == [None] * len(texts)


@pytest.mark.parametrize("language", LANGUAGES)
def test_no_option_of_an_effect_is_called_by_its_raw_name(language: str) -> None:
    words = {key: text for key, text in catalogue(language).items() if key.startswith("workbench.option.")}
    assert len(words) > 20
    assert [text for text in words.values() if "_" in text] == []
