"""The workbench's own state in the page: address, steps, what is typed, and figures that go together."""

from __future__ import annotations

import pytest

from tests.support.page_modules import told

RUN, OTHER = "SIM-0001/20261121T060000Z_ramp", "SIM-0002/20261121T070000Z_ramp"
LABELS = "steps.map(({ model }, i) => page.labelWord(page.labelOf(model, steps[i - 1]?.model)))"
ADDRESS = """
const { actions } = given;
let state = page.stateOf("", null);
const texts = [page.addressOf(state)];
for (const action of actions) {
  state = page.change(state, action);
  texts.push(page.addressOf(state));
}
const link = page.stateOf(texts.at(-1));
console.log(JSON.stringify({ texts, state, link }));
"""


def test_the_address_holds_runs_model_and_what_is_shown() -> None:
    actions = [
        {"type": "choose", "runs": [{"run": RUN, "role": "fit"}, {"run": OTHER, "role": "check"}]},
        {"type": "add", "effects": [{"effect": "expression", "formula": "k * dT_dt + a & b"}]},
        {"type": "view", "view": {"figure": "axes", "over": "quadrature"}},
        {"type": "zoom", "zoom": "h:0.01,0.02"},
    ]
    found = told("pages/workbench/state.js", ADDRESS, {"actions": actions})
    state, link = found["state"], found["link"]
    assert (link["steps"], link["at"]) == (state["steps"], 1), "the step before is in the link, too"
    for key in ("chosen", "figure", "over", "zoom", "picture", "wrong"):
        assert link[key] == state[key], key
    assert link["chosen"] == [{"run": RUN, "role": "fit"}, {"run": OTHER, "role": "check"}]
    assert found["texts"][0] == ""
    assert len(set(found["texts"])) == len(actions) + 1


def test_a_time_that_is_selected_holds_in_its_run_and_a_temperature_in_every_one() -> None:
    actions = [{"type": "view", "view": {"figure": "loop"}}, {"type": "view", "view": {"of": OTHER}}]
    script = """
    const { zooms, actions } = given;
    const after = (zoom) => actions.map((action) => page.change({ ...page.stateOf(""), zoom }, action).zoom);
    console.log(JSON.stringify(zooms.map(after)));
    """
    given = {"zooms": ["h:1,2", "degC:-10,20"], "actions": actions}
    assert told("pages/workbench/state.js", script, given) == [["h:1,2", ""], ["degC:-10,20", "degC:-10,20"]]


def test_steps_are_taken_back_and_made_again_until_another_is_made() -> None:
    added = [{"type": "add", "effects": [{"effect": name}]} for name in ("aging", "creep")]
    back, again = {"type": "undo"}, {"type": "redo"}
    script = """
    const names = given.map((actions) => {
      const { steps, at } = actions.reduce(page.change, page.stateOf(""));
      return [steps[at].model.effects.map(({ effect }) => effect).join(" "), steps.length];
    });
    console.log(JSON.stringify(names));
    """
    assert told("pages/workbench/state.js", script, [
        [*added, back], [*added, back, back, back], [*added, back, again, again], [*added, back, back, added[1], again],
    ]) == [["spline aging", 3], ["spline", 3], ["spline aging creep", 3], ["spline creep", 2]]  # fmt: skip


def test_a_suspect_that_takes_the_place_of_a_term_brings_its_own_model() -> None:
    model = {"name": "aging for spline", "effects": [{"effect": "aging"}]}
    action = {"type": "add", "effects": model["effects"], "model": model}
    script = f"""
    const {{ steps }} = page.change(page.stateOf(''), given);
    console.log(JSON.stringify([steps[1].model, {LABELS}]));
    """
    assert told("pages/workbench/state.js", script, action) == [model, ["spline", "+ aging − spline"]]


def test_a_long_way_to_a_model_leaves_its_newest_steps_in_the_address() -> None:
    script = """
    const { steps } = page.stateOf(page.addressOf(given.reduce(page.change, page.stateOf(""))));
    console.log(JSON.stringify(steps.map(({ model }) => model.effects.length)));
    """
    actions = [{"type": "add", "effects": [{"effect": "aging"}]}] * 9
    assert told("pages/workbench/state.js", script, actions) == [4, 5, 6, 7, 8, 9, 10]


@pytest.mark.parametrize(
    "model", ["", "nonsense", "[]", '{"name":"a"}', '{"name":"a","effects":[]}', '{"name":1,"effects":[{}]}']
)
def test_a_model_in_the_address_that_cannot_be_read_is_said_and_not_used(model: str) -> None:
    script = """
    const { wrong, steps } = page.stateOf(new URLSearchParams({ model: given }));
    console.log(JSON.stringify([wrong, steps[0].model.name]));
    """
    assert told("pages/workbench/state.js", script, model) == [model, "spline"]


def test_a_decimal_comma_is_understood_and_what_is_no_number_stays_what_it_is() -> None:
    given = ["2,5", "-0.5", "−1,5e2", "auto", "[1, 2]", "1,2,3", "true"]
    script = "console.log(JSON.stringify(given.map(page.typed)))"
    wanted = [2.5, -0.5, -150, "auto", [1, 2], "1,2,3", True]
    assert told("lib/typed.js", script, given) == wanted


def test_what_is_next_to_nothing_has_a_power_of_ten_and_no_row_of_zeros() -> None:
    given = [0.000001339, 5.72e-7, -0.000034, 0.00012, 0, 2.5]
    script = "console.log(JSON.stringify(given.map((one) => page.number(one))))"
    wanted = ["1.34·10⁻⁶", "5.72·10⁻⁷", "−3.40·10⁻⁵", "0.000120", "0", "2.50"]
    assert told("pages/workbench/parts.js", script, given) == wanted


def test_the_residual_before_is_drawn_pale_behind_the_new_one() -> None:
    new = {"data": [{"name": "measured"}, {"name": "compensated", "meta": "residual", "yaxis": "y2"}], "layout": {}}
    old = {
        "data": [
            {"name": "measured"},
            {"x": [1], "meta": "residual", "yaxis": "y2", "line": {"color": "blue", "width": 3}},
        ]
    }
    script = "console.log(JSON.stringify(page.haunted(...given)))"
    drawn = told("pages/workbench/ghost.js", script, [new, old])
    assert [trace["name"] for trace in drawn["data"]] == ["residual before", "measured", "compensated"]
    ghost = drawn["data"][0]
    assert (ghost["yaxis"], ghost["x"], ghost["line"]["width"]) == ("y2", [1], 3)
    assert ghost["line"]["color"] != "blue"


def test_a_moment_of_one_figure_is_found_in_the_others() -> None:
    head = ["time [s]", "temperature [degC]", "bias [deg/h]", "model [deg/h]"]
    rows = [[60.0 * i, 20.0 + (i if i < 50 else 100 - i), 1.0 + 0.1 * (i >= 50), 1.0] for i in range(100)]
    script = """
    const csv = given;
    console.log(JSON.stringify([
      page.momentOf("time", csv, { x: 1.5, y: 0 }), page.momentOf("temperature", csv, { x: 30, y: 1.1 }),
      page.momentOf("temperature", csv, { x: 30, y: 1.0 }), page.placeOf("temperature", csv, 5400),
      page.placeOf("time", csv, 5400), page.placeOf("loop", csv, 1e6), page.placeOf("allan", null, 5400),
    ]));
    """
    found = told("pages/workbench/moment.js", script, [head, *rows])
    assert found == [5400, 5400, 600, 30, 1.5, None, None]


def test_a_moment_is_not_marked_where_its_rows_are_not_shown() -> None:
    head = ["time [s]", "temperature [degC]", "deg/h"]
    rows = [[60.0 * i, 20.0 + i, 1.0] for i in range(100) if not 40 < i < 60]
    script = "console.log(JSON.stringify([39, 50, 61].map((i) => page.placeOf('loop', given, 60 * i))))"
    assert told("pages/workbench/moment.js", script, [head, *rows]) == [59, None, 81]


def test_a_moment_of_one_of_several_runs_is_found_among_its_own_rows() -> None:
    head = ["run", "time [s]", "dT/dt [°C/min]", "residual [deg/h]"]
    rows = [[run, 60.0 * i, i + j, None if i == 7 else 0.001 * i] for j, run in enumerate(("a", "b")) for i in range(9)]
    script = """
    const csv = given;
    console.log(JSON.stringify([
      page.momentOf("axes", csv, { x: 4, y: 0.003 }, "b"), page.momentOf("axes", csv, { x: 4, y: 0.004 }, "a"),
      page.placeOf("axes", csv, 120, "b"), page.placeOf("axes", csv, 120, "c"),
    ]));
    """
    assert told("pages/workbench/moment.js", script, [head, *rows]) == [180, 240, 3, None]


def test_steps_with_formulas_are_told_apart_by_them() -> None:
    formulas = ("k * time", "k * dT_dt")
    actions = [{"type": "add", "effects": [{"effect": "expression", "formula": formula}]} for formula in formulas]
    actions += [{"type": "edit", "index": 1, "option": "formula", "value": "k * t"}, {"type": "remove", "index": 1}]
    script = f"const {{ steps }} = given.reduce(page.change, page.stateOf('')); console.log(JSON.stringify({LABELS}))"
    labels = told("pages/workbench/state.js", script, actions)[1:]
    assert labels[:2] == ["+ k * time", "+ k * dT_dt"]
    assert labels[3] == "− k * t"
    assert labels[2].startswith("k * time ")
    assert labels[2].endswith(" k * t")


def test_a_step_is_told_by_what_it_added_and_not_by_an_option_that_the_data_chose_again() -> None:
    effects = [{"effect": "spline", "intervals": 13}, {"effect": "thermal_lag"}]
    actions = [
        {"type": "add", "model": {"name": "spline + thermal_lag", "effects": effects}, "effects": effects[1:]},
        {"type": "edit", "index": 0, "option": "intervals", "value": 8},
    ]
    script = f"const {{ steps }} = given.reduce(page.change, page.stateOf('')); console.log(JSON.stringify({LABELS}))"
    _, added, edited = told("pages/workbench/state.js", script, actions)
    assert added == "+ thermal lag"
    assert "8" in edited
