"""What the bench says in English is known in the languages of its users, sentence by sentence."""

import ast
import errno
import os
import re
from functools import cache
from pathlib import Path

import pytest

from bench.base import language
from tests.support import page_modules

ROOT = Path(language.__file__).parents[2]
PLACE = re.compile(r"\{\w*\}")
SEAM = 7
"""Letters of the shortest piece that a sentence is put together from."""
WHOLE = (
    "acquisition/profile/preflight.py", "acquisition/profile/standing.py", "acquisition/profile/guards.py",
    "acquisition/run/settling.py", "acquisition/run/sequencer.py", "analysis/judging/verdict.py",
    "analysis/judging/validity.py", "analysis/judging/completeness.py", "analysis/diagnosis/grammar.py",
    "analysis/diagnosis/blocks.py", "analysis/diagnosis/describing.py", "analysis/diagnosis/physics.py",
    "analysis/diagnosis/places.py", "analysis/diagnosis/proof.py", "analysis/diagnosis/notes.py",
    "analysis/diagnosis/needless.py", "analysis/diagnosis/first_fit.py", "analysis/fit/disturbances.py",
    "analysis/fit/own_jumps.py", "analysis/diagnosis/decision.py", "commands/calibration/doubts.py",
    "web/live/story.py", "web/jobs/lanes.py",
    "web/jobs/workers.py", "web/live/starting.py", "web/people/access.py", "web/imports/imports.py",
    "acquisition/importer/doubts.py", "acquisition/importer/header.py", "acquisition/importer/loggers.py",
    "acquisition/importer/tables.py", "acquisition/importer/text.py", "acquisition/importer/values.py",
    "acquisition/station/doctor.py", "acquisition/station/wires.py", "analysis/diagnosis/experiment.py",
    "acquisition/station/notices.py", "acquisition/station/settings/notify.py",
    "deliver/export/building.py", "deliver/export/parts.py",
)  # fmt: skip
"""Modules below `bench/` whose every sentence a page shows."""

STATION = (
    *sorted(path.relative_to(ROOT) for path in (ROOT / "bench/acquisition/station/settings").glob("[a-z]*.py")),
    "drivers/states.py", "drivers/units.py", "drivers/yaml12.py", "drivers/register.py", "drivers/register_map.py",
    "drivers/instrument.py", "drivers/wire.py", "drivers/interfaces.py",
)  # fmt: skip
"""Modules that refuse a station file."""


def bare(node: ast.expr) -> str:
    """A string of the source with `{}` for each value in it."""
    if isinstance(node, ast.Constant):
        return str(node.value)
    parts = node.values if isinstance(node, ast.JoinedStr) else []
    return "".join(str(part.value) if isinstance(part, ast.Constant) else "{}" for part in parts)


def strings(path: Path) -> list[str]:
    """All strings of a module but its docstrings."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    documented = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    inside = {id(part) for node in ast.walk(tree) if isinstance(node, ast.JoinedStr) for part in node.values}
    found = [node for node in ast.walk(tree) if isinstance(node, ast.Constant | ast.JoinedStr)]
    return [
        bare(node)
        for node in found
        if id(node) not in documented | inside and not (isinstance(node, ast.Constant) and type(node.value) is not str)
    ]


@cache
def source() -> str:
    """Everything that bench and drivers can say."""
    files = [path for folder in ("bench", "drivers") for path in (ROOT / folder).rglob("*.py")]
    return "\n".join(text for path in files for text in strings(path))


@cache
def shapes() -> list[re.Pattern[str]]:
    """Strings of the code with words and values in them, as patterns."""
    texts = {text for text in source().splitlines() if "{}" in text and re.search("[a-z]{2,}", text)}
    return [re.compile(".+".join(map(re.escape, text.split("{}")))) for text in texts]


def said_by_the_code(english: str) -> bool:
    """Whether a sentence is written in the code: between its values in pieces, or with a word in place of a value."""
    if english.startswith("must be ") or english in map(os.strerror, errno.errorcode):
        return True  # by pydantic, by the operating system
    bare = PLACE.sub("0", english)
    return all(map(pieced, PLACE.split(english))) or any(shape.fullmatch(bare) for shape in shapes())


def pieced(piece: str) -> bool:
    """Whether all of it is in the code, in pieces of some length."""
    left = piece
    while left.strip(" :;,.()'"):
        ends = range(len(left), min(SEAM, len(left)) - 1, -1)
        end = next((end for end in ends if left[:end] in source()), 0)
        if not end:
            return False
        left = left[end:]
    return True


def raised(path: Path) -> set[str]:
    """Strings of the functions of a module that refuse something."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    refusing = [
        node for node in ast.walk(tree)
        if isinstance(node, ast.FunctionDef) and any(isinstance(part, ast.Raise) for part in ast.walk(node))
    ]  # fmt: skip
    parts = [part for node in refusing for part in ast.walk(node)]
    return {bare(part) for part in parts if isinstance(part, ast.Constant | ast.JoinedStr)} & set(strings(path))


def test_every_sentence_that_is_translated_is_one_that_the_code_says() -> None:
    """A sentence that was changed in the code alone would be English again."""
    whole = [english for english in language.sentences() if len(english.split()) > 2]
    assert len(whole) > 200
    assert [one for one in whole if not said_by_the_code(one)] == []


@pytest.mark.parametrize("module", WHOLE)
def test_what_a_page_shows_of_a_module_has_a_translation(module: str) -> None:
    known = "\n".join(PLACE.sub("{}", english) for english in language.sentences())
    texts = strings(ROOT / "bench" / module)
    pieces = {piece.strip(" ;:,.'()") for text in texts for piece in re.split(r"\{\}|[;:] |`[^`]*`", text)}
    words = [piece for piece in pieces if len(piece.split()) > 2 and not re.search(r"[*/(_]| [-+x] ", piece)]
    assert [piece for piece in words if piece not in known] == []


@pytest.mark.parametrize("module", STATION, ids=str)
def test_what_is_wrong_in_a_station_file_has_a_translation(module: Path | str) -> None:
    known = "\n".join(PLACE.sub("{}", english) for english in language.sentences())
    pieces = {piece.strip(" ;:,.'()[]") for text in raised(ROOT / module) for piece in re.split(r"\{\w*\}|[;:] ", text)}
    assert [piece for piece in pieces if len(piece.split()) > 2 and piece not in known] == []


@pytest.mark.parametrize(("spoken", "column"), [("uk", 0), ("zh", 1)])
def test_a_translation_keeps_the_values_and_uses_its_own_letters(spoken: str, column: int) -> None:
    letters = {"uk": "[а-яіїєґА-ЯІЇЄҐ]", "zh": "[\u4e00-\u9fff]"}[spoken]
    own = {english: words[column] for english, words in language.sentences().items()}
    assert [e for e, text in own.items() if {*PLACE.findall(e)} - {"{lost}"} != {*PLACE.findall(text)}] == []
    long = {english: text for english, text in own.items() if len(re.findall("[a-z]{3,}", PLACE.sub("", english))) > 2}
    assert [text for text in long.values() if not re.search(letters, PLACE.sub("", text))] == []


SAMPLES = [
    ("unit too hot: unit_temperature = 91.5 is above 90", "uk",
     "виріб перегрітий: температура виробу = 91,5, вище за 90"),
    ("unit too hot: unit temperature = 91.5 degC is above 90 degC", "uk",
     "виріб перегрітий: температура виробу = 91,5 °C, вище за 90 °C"),
    ("Complete, no frame lost; M1 leaves 1.2 × the noise floor on unseen data.", "zh",
     "已完成，没有丢帧；模型“M1”在未见数据上的残差为噪声底的1.2倍。"),
    ("all ramps at 2 degC/min: thermal lag, dT/dt and hysteresis cannot be separated; give some ramps another rate",
     "uk",
     "усі рампи 2 °C/хв: теплове запізнення, dT/dt і гістерезис не розділити; дайте деяким рампам іншу швидкість"),
    ("log.csv:101: '|t|' is 'abc', not a number; leave a field empty where there is no value, and begin a line that is "
     "no row with #", "uk",
     "log.csv:101: '|t|' — 'abc', не число; де немає значення, лишіть поле порожнім, а рядок, що не є рядком таблиці, "
     "почніть знаком #"),
    ("not calibrated on 2026-11-29: Bridge No. 4 B-7, due 2026-11-01; Probe P-2, calibrated later, on 2026-12-01; "
     "calibrate it, or use another instrument", "uk",
     "немає чинного калібрування на 2026-11-29: Bridge No. 4 B-7, строк до 2026-11-01; Probe P-2, калібрування лише "
     "2026-12-01; відкалібруйте його або візьміть інший прилад"),
    ("not calibrated on 2026-11-29: Bridge No. 4 B-7, due 2026-11-01; calibrate it, or use another instrument", "zh",
     "2026-11-29没有有效标定：Bridge No. 4 B-7，有效期至2026-11-01；请标定该仪器，或改用其他仪器"),
    ("not started: unit M-1: no sound rate frame as number 0 on bus can0 (socketcan can0, 0 frames); check its power, "
     "number and bit rate", "uk",
     "не почато: виріб M-1: немає справного кадру швидкості під номером 0 на шині can0 (socketcan can0, кадрів: 0); "
     "перевірте його живлення, номер і швидкість шини"),
    ("the run is not complete: aborted (aborted by guard: unit silent: frame_age = 5.002 is above 5), 1 of its "
     "segments failed", "uk",
     "прогін неповний: перервано (перервано захистом: виріб мовчить: вік останнього кадру = 5,002, вище за 5); не "
     "вдалося ділянок: 1"),
    ("the run is not complete: aborted (aborted by guard: unit silent: age of the newest frame = 5.002 s is "
     "above 5 s), 1 of its segments failed", "zh",
     "试验不完整：已中止（由保护项中止：产品无应答：距最后一帧的时间 = 5.002秒，高于5秒），1段失败"),
    ("aborted by guard: sensor break: yes", "uk", "перервано захистом: обрив датчика: так"),
    ("aborted by guard: operator override: set point is 60 degC, the bench commanded 33", "zh",
     "由保护项中止：设定值被人改动：设定值为60 °C，试验台下达的是33"),
    ("g: door open: no", "zh", "g：箱门打开：否"),
    ("units[0].bus: bus 'can9' is not in this station; known: can0, can1", "uk",
     "units[0].bus: шини 'can9' немає в цьому стенді; відомі: can0, can1"),
    ("units[1]: GX-2 and GX-1 are both number 0 on can0", "uk",
     "units[1]: GX-2 і GX-1 мають той самий номер 0 на can0"),
    ("s.yaml:34: unknown key 'chambr'; did you mean 'chamber'?; known here: name, chamber, fixture", "zh",
     "s.yaml:34：未知的键“chambr”；是否指“chamber”？；此处可用：name、chamber、fixture"),
    ("buses.can0.interface: a simulated station runs on virtual or blocks, a real one never does; this one is on "
     "'socketcan'", "zh", "buses.can0.interface：仿真工位使用virtual或blocks，真实工位从不使用；此处为'socketcan'"),
    ("instruments[0]: instrument 'psu' of this station is real: it needs an address", "uk",
     "instruments[0]: прилад 'psu' цього стенда справжній: йому потрібна адреса"),
    ("watchdog.silent_s: silent_s is 5: a bench that waits for a chamber which does not answer is silent for up to 3 "
     "times its timeout_s, 2; raise it", "uk",
     "watchdog.silent_s: silent_s = 5: чекаючи на камеру, яка не відповідає, програма мовчить до 3 її timeout_s (2); "
     "збільште його"),
    ("units[1].serial: serial number GX-1 stands twice", "zh", "units[1].serial：序列号GX-1出现两次"),
    ("ambient_degc: ambient_degc is 23, outside the chamber's -42 to 5 degC: there would be no safe state", "uk",
     "ambient_degc: ambient_degc = 23, а камера має від −42 до 5 °C: безпечного стану не було б"),
    ("chamber: lowest_degc (60) must be below highest_degc (5)", "zh",
     "温箱：lowest_degc（60）必须低于highest_degc（5）"),
    ("faults[0]: on is 'moon': must be chamber, a bus, a unit or an instrument of this station", "uk",
     "faults[0]: on = 'moon': має бути chamber, шина, виріб або прилад цього стенда"),
    ("fixture.operator: must be 'asked' or 'simulated'", "uk", "fixture.operator: має бути 'asked' або 'simulated'"),
    ("instruments[0].address: rtu:///dev/x is an address of Modbus, which has `modbus`", "zh",
     "instruments[0].address：rtu:///dev/x是Modbus地址，应写`modbus`"),
    ("run U-1/20261101T000000Z_ramp is running: only an ended run can be analysed", "uk",
     "прогін U-1/20261101T000000Z_ramp: триває: аналізувати можна лише закінчений прогін"),
    ("run U-1/20261101T000000Z_ramp is unfinished: only an ended run can be analysed; “Resume” on the page of its "
     "verdict goes on with it", "zh",
     "试验U-1/20261101T000000Z_ramp：未完成：只能分析已结束的试验；可在其判定页按“继续”"),
    ("m.yaml:12: registers.pv.address: takes addresses 4 to 5, as sv does; correct one of them, or give both a `mask`",
     "uk", "m.yaml:12: registers.pv.address: займає адреси від 4 до 5, як і sv; виправте одне з них або дайте обом "
     "`mask`"),
    ("m.yaml:3: function code 6 writes one word; use 16", "zh", "m.yaml:3：功能码6只写一个字；请用16"),
    ("can0 (foo can0): python-can has no interface 'foo'; it has gs_usb, kvaser", "uk",
     "can0 (foo can0): python-can не має інтерфейсу 'foo'; є gs_usb, kvaser"),
    ("setpoint cannot be set to 300 degC; limits -70 to 180", "uk",
     "setpoint: не можна задати 300 °C; межі від −70 до 180"),
    ("12 s", "zh", "12秒"),
    ("15,178,500", "uk", "15\u00a0178\u00a0500"),
    ("15,178,500", "zh", "15,178,500"),
    ("no column is rate; the table has 't', 'T, °C'; choose it below", "zh",
     "没有一列是“陀螺输出”；表中有't'、'T, °C'；请在下方选择"),
    ("'gx', 'gy' do not say their units, which may be deg/h, mdps, rad/s; choose them below", "zh",
     "'gx'、'gy'没有注明单位；可以是deg/h、mdps、rad/s；请在下方选择"),
    ("'gx' does not say its unit, which may be deg/h, mdps, rad/s; choose it below", "uk",
     "'gx' не називає своєї одиниці; можливі deg/h, mdps, rad/s; виберіть нижче"),
    ("worst 2.5 ms, median 0.1 ms of 10; timeout_s is 1.5", "uk",
     "найгірша 2,5 мс, медіана 0,1 мс із 10; timeout_s = 1,5"),
    ("spline: intervals is 'lots', allowed is a whole number from 1 to 200", "zh",
     "spline：intervals为'lots'，允许1至200的整数"),
    ("Missing: thermal_lag or clock_delay or a formula", "uk", "Бракує: thermal_lag або clock_delay або формула"),
    ("no frame lost; M1 lacks no effect that this run could show.", "uk",
     "жодного кадру не втрачено; моделі M1 не бракує жодного ефекту, який цей прогін міг показати."),
    ("line 2: the name 'quick' is taken by a shipped profile of other content; histories and fleet would mix their "
     "runs; give this one a name of its own", "uk",
     "рядок 2: назву «quick» має профіль із комплекту з іншим змістом; історії й парк виробів змішали б їхні "
     "прогони; дайте цьому власну назву"),
    ("chamber.lowest_degc is -110: the map writes set points from -100 to 250 degC; correct one of them", "uk",
     "chamber.lowest_degc = −110: карта регістрів записує уставки від −100 до 250 °C; виправте одне з них"),
    ("plans/quick.yaml: no certificate: no equipment; give a file with every instrument that the results are traced "
     "to in the plan or the station file (`equipment:`), or fill in the page 'Laboratory and equipment'; a plan with "
     "`certificate: false` calibrates without one", "uk",
     "plans/quick.yaml: без сертифіката: немає обладнання; заповніть сторінку «Лабораторія й обладнання» або назвіть "
     "файл у плані чи у файлі стенда (`equipment:`); план із `certificate: false` калібрує без сертифіката"),
    ("plans/own.yaml: model 'mine': expression: cannot be delivered: a unit evaluates terms of one or two of "
     "temperature, drive, each at one moment, and 'lag(drive, 60)' needs drive, lag; leave it out of the delivered "
     "model; models that a unit can hold: spline, лінія", "uk",
     "plans/own.yaml: модель «mine»: expression: не можна записати у виріб: виріб обчислює доданки з однієї чи двох "
     "величин тієї самої миті (можливі: температура, амплітуда збудження), а доданок «lag(drive, 60)» потребує: "
     "амплітуда збудження, lag; вилучіть це з моделі, яку записують; моделі, які виріб може вмістити: spline, лінія"),
    ("unit G-1: model 'spline': supply_voltage: cannot be delivered: this unit has no channel supply; leave it out of "
     "the delivered model; models that a unit can hold: polynomial", "uk",
     "виріб G-1: модель «spline»: supply_voltage: не можна записати у виріб: у цього виробу немає каналу: напруга "
     "живлення; вилучіть це з моделі, яку записують; моделі, які виріб може вмістити: polynomial"),
    ("channel 'applied_rate' [deg/s] is missing; the run has rate, temperature", "uk",
     "немає каналу «applied_rate» [°/с]; прогін має: вихід гіроскопа, температура"),
    ("brief.yaml: longest soak is 10 min: the noise floor is read where the unit stands still for 5 min, which takes a "
     "soak of about 15 min", "uk",
     "brief.yaml: найдовша витримка 10 хв: рівень шуму визначають там, де виріб стоїть 5 хв, а це витримка приблизно "
     "15 хв"),
    ("the server cannot read or write profiles/stations: File exists; runs go on: tell whoever is in charge of its "
     "computer", "uk",
     "сервер не може читати чи писати profiles/stations: такий файл уже є; прогони тривають: скажіть тому, хто "
     "доглядає його комп'ютер"),
    ("no stations 'time'; there are imu, rate, short", "uk", "немає «time»; є: imu, rate, short"),
    ("20261127T172726Z_ramp: the unit corrected its rate itself during this run: it is a verification and cannot be "
     "fitted or checked against; use runs of the raw rate", "uk",
     "20261127T172726Z_ramp: виріб у цьому прогоні сам коригував свій вихід: це перевірка, за нею не можна ні будувати "
     "модель, ні перевіряти її; візьміть прогони з необробленим виходом"),
    ("aborted by Rows (operator) from 127.0.0.1", "uk", "перервав Rows (оператор) з 127.0.0.1"),
    ("aborted by rows and cooling (operator) from 127.0.0.1", "uk", "перервав rows and cooling (оператор) з 127.0.0.1"),
    ("column 'cooling' for temperature does not exist", "uk", "стовпця 'cooling' для каналу «температура» немає"),
    ("start heating", "uk", "початок: heating"),
    ("end cooling: done", "zh", "结束：cooling：完成"),
    ("end ramp to 60 at 1.5: done", "uk", "кінець: рампа до 60 зі швидкістю 1,5: виконано"),
    ("start start", "uk", "початок: початок"),
    ("like nothing that was ever said", "uk", None),
    ("the glove was lost", "uk", None),
]  # fmt: skip


@pytest.mark.parametrize(("english", "spoken", "own"), SAMPLES)
def test_the_command_line_and_the_page_say_the_same(english: str, spoken: str, own: str | None) -> None:
    script = "console.log(JSON.stringify(page.told(...given)))"
    assert language.told(english, spoken) == own
    assert page_modules.told("lib/told.js", script, [english, spoken]) == own


@pytest.mark.parametrize(
    ("written", "own"),
    [
        ("Simulated laboratory (certifies nothing)", "Лабораторія симуляції (нічого не засвідчує)"),
        ("ramp to 60 at 1.5", "рампа до 60 зі швидкістю 1,5"),
        ("ramp to cold at night", None),
        ("rows and cooling", None),
        ("Institute of rows, cooling", None),
    ],
)
def test_what_people_wrote_is_not_translated_in_part(written: str, own: str | None) -> None:
    script = "console.log(JSON.stringify(page.ofBench(given, 'uk')))"
    assert page_modules.told("lib/told.js", script, written) == own


@pytest.mark.parametrize(
    ("name", "own"),
    [
        ("heating", None),
        ("rows", None),
        ("start", "початок"),
        ("hold", "утримання"),
        ("2: constant at 55", "2: стало за 55"),
        ("soak at 25 (2)", "витримка за 25 (2)"),
    ],
)
def test_a_segment_that_a_person_named_stays_so_where_the_bench_has_that_word_elsewhere(
    name: str, own: str | None
) -> None:
    script = "console.log(JSON.stringify(page.ofBench(given, 'uk', true)))"
    assert page_modules.told("lib/told.js", script, name) == own


@pytest.mark.parametrize("wrong", ["станці", "випробуван", r"\bза межами", "поза вибірк|відкладен", "вердикт"])
def test_a_ukrainian_word_means_one_thing(wrong: str) -> None:
    """A station is «стенд», a run «прогін», unseen data «перевірочні»; «за межами» says two things at once."""
    texts = [words[0] for words in language.sentences().values()]
    texts += [str(words) for words in page_modules.catalogue("uk").values()]
    texts.append((ROOT / "bench" / "base" / "words" / "uk.json").read_text())
    assert [text for text in texts if re.search(wrong, text.lower())] == []


@pytest.mark.parametrize(
    ("english", "own"),
    [
        ("the memory of dT/dt of heating alone times a window in temperature", "仅升温的dT/dt的记忆 × 温度窗口"),
        ("the lowest temperature so far times the drive above a value", "迄今最低温度 × 驱动幅度高于某值的部分"),
        ("(dT/dt of heating alone)^2 times the drive, late", "(仅升温的dT/dt)² × 驱动幅度，延迟"),
        ("the memory of |dT/dt| times time", "|dT/dt|的记忆 × 时间"),
        ("the square of the drive above a value", "驱动幅度高于某值的部分的平方"),
    ],
)
def test_a_product_is_told_factor_by_factor(english: str, own: str) -> None:
    assert language.told(english, "zh") == own
    assert page_modules.told("lib/told.js", "console.log(JSON.stringify(page.told(given, 'zh')))", english) == own


def test_a_channel_within_a_sentence_has_no_capital_letter() -> None:
    english = "the drive times time"
    lacking = "M1 lacks thermal_lag or clock_delay"
    script = f"""
    globalThis.document = {{ documentElement: {{}} }};
    const words = await import(new URL("{page_modules.SOURCE.as_uri()}/lib/words.js"));
    await words.speak("uk");
    await words.speakOfAll(); // with the names of channels, which begin the rows of a table
    console.log(JSON.stringify(given.map((text) => page.told(text, 'uk'))));
    """
    said, of_effects, alone = page_modules.told("lib/told.js", script, [english, lacking, "thermal_lag"])
    assert of_effects == "моделі M1 бракує: теплове запізнення або запізнення годинника"
    assert alone == "Теплове запізнення"
    assert said == language.told(english, "uk") == "амплітуда збудження × час"
