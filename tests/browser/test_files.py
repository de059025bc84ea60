"""The texts of profiles, stations, limits and plans in the page."""

import re
from urllib.parse import quote

import pytest

from bench.commands import init
from bench.web.people import people
from tests.support.servers import site_over


@pytest.fixture(scope="module")
def address(tmp_path_factory, project):
    with site_over(tmp_path_factory.mktemp("files"), project=project) as site:
        yield site.address


def test_a_file_that_does_not_exist_is_said_with_a_way_on(address, visitors):
    page = visitors.come(address)
    visitors.of(page).forgives = re.compile("status of 400")
    page.goto("/files?kind=profiles&id=nowhere")
    gone = page.get_by_role("alert").get_by_text("'nowhere'")
    gone.wait_for()
    page.get_by_role("button", name="Choose a file").click()
    gone.wait_for(state="detached")
    page.get_by_label("File", exact=True).select_option("short")
    page.get_by_label("Text of the file").wait_for()


def test_a_copy_of_a_shipped_profile_has_its_name_until_it_is_changed(tmp_path, visitors):
    init(tmp_path)
    own = tmp_path / "profiles" / "one_rate.yaml"
    own.write_text(own.read_text().replace("name: one_rate", "name: one_rate_mine"))
    with site_over(tmp_path / "out", project=tmp_path) as site:
        page = visitors.come(site.address)
        visitors.may_lose_the_server(page)
        page.goto("/files?kind=profiles&id=quick")
        page.get_by_role("heading", name="Quick run, 0 to 50 °C").wait_for()
        named = page.get_by_label("File", exact=True).locator("option").all_inner_texts()
    assert [one.split(" · ")[0].replace("\u00a0", " ") for one in named if "uick run" in one or "one_rate" in one] == [
        "one_rate", "Quick run, 0 to 50 °C",
    ]  # fmt: skip


def test_changes_that_are_not_saved_are_not_lost_without_a_question(address, visitors):
    page = visitors.come(address)
    page.goto("/units")
    page.get_by_role("heading").first.wait_for()
    page.evaluate("history.pushState(null, '', '/files?kind=profiles&id=short'); history.go(0)")
    text, question = page.locator("textarea"), page.get_by_role("dialog")
    stay = question.get_by_role("button", name="Keep editing")
    text.press("Control+End")
    text.type("# mine\n")
    for leave in (
        page.get_by_role("link", name="Fleet").click,
        page.go_back,
        lambda: page.locator("#files-id").select_option("brief"),
        lambda: page.locator("#files-kind").select_option("limits"),
    ):
        leave()
        stay.click()
        question.wait_for(state="detached")
        assert text.input_value().endswith("# mine\n")
        assert (page.locator("#files-kind").input_value(), page.locator("#files-id").input_value()) == (
            "profiles", "short",
        )  # fmt: skip
        assert page.url.endswith("/files?kind=profiles&id=short")
    with page.expect_event("dialog") as closing:
        page.evaluate("setTimeout(() => location.reload())")
    assert closing.value.type == "beforeunload"
    closing.value.dismiss()
    page.go_back()
    question.get_by_role("button", name="Discard changes").click()
    page.wait_for_url("**/units")


def test_a_file_that_could_not_be_fetched_is_asked_for_again(address, visitors):
    page = visitors.come(address)
    visitors.of(page).forgives = re.compile("ERR_FAILED")
    page.goto("/files")
    file = "**/api/v1/files/profiles/quick"
    page.route(file, lambda route: route.abort())
    page.get_by_label("File", exact=True).select_option("quick")
    again = page.get_by_role("button", name="Try again")
    again.wait_for()
    page.unroute(file)
    again.click()
    page.get_by_label("Text of the file").wait_for()


def test_who_may_not_change_a_file_reads_it_and_is_told_so(tmp_path, project, visitors):
    access = tmp_path / "access.yaml"
    token = people.add_person(access, "screen", "viewer")
    with site_over(tmp_path / "out", "--access", str(access), project=project) as site:
        page = visitors.come(site.address)
        page.goto("/files?kind=profiles&id=short")
        page.get_by_label("Token").fill(token)
        page.keyboard.press("Enter")
        page.get_by_text("Only engineers may change it.").wait_for()
        assert page.locator("textarea").get_attribute("readonly") is not None
        page.wait_for_load_state("networkidle")
        assert page.locator(".notice.bad").count() == 0
        page.goto("/laboratory?station=bare")
        page.get_by_text("Only engineers may change it.").first.wait_for()
        assert page.get_by_text("Only engineers may change it.").count() == page.locator(".papers form").count() == 3
        assert page.locator(".papers form :is(input, select, button):enabled").count() == 0
        page.goto("/units")
        page.get_by_text("Building it now needs the role of an engineer.").wait_for()
        page.close()


def test_what_is_filled_in_for_a_laboratory_is_not_lost_without_a_question(address, visitors):
    page = visitors.come(address)
    page.goto("/laboratory?station=bare")
    who, question = page.get_by_label("Who signs"), page.get_by_role("dialog")
    name = page.locator('[id="laboratory.name"]')
    page.get_by_text("Nothing is filled in yet.").first.wait_for()
    who.fill("O. Petrenko")
    who.fill("")
    page.get_by_role("link", name="Fleet").click()  # as it was: nothing is lost
    page.wait_for_url("**/fleet")
    page.goto("/laboratory?station=bare")
    who.fill("O. Petrenko")
    page.get_by_label("Serial number").fill("S-1")
    for leave in (
        page.get_by_role("link", name="Fleet").click,
        lambda: page.locator("#station").select_option("simulated"),
    ):
        leave()
        question.get_by_role("button", name="Keep editing").click()
        question.wait_for(state="detached")
        assert (who.input_value(), page.locator("#station").input_value()) == ("O. Petrenko", "bare")
    assert {button.inner_text() for button in page.locator("form button[type=submit]:not(.unseen)").all()} == {
        "Save laboratory", "Save reference equipment", "Save notices",
    }  # fmt: skip
    name.fill("Gyro laboratory")
    page.get_by_role("button", name="Save Laboratory").click()
    page.get_by_text("Saved.").wait_for()
    assert page.get_by_text("Nothing is filled in yet.").count() == 2
    name.fill("Gyro laboratory 2")  # over what was saved last, and then over what somebody else saved
    page.get_by_role("button", name="Save Laboratory").click()
    page.get_by_text("Saved.").wait_for()
    visitors.may_come_too_late(page)
    other = visitors.come(address)
    other.goto("/laboratory?station=bare")
    for one, said in ((other, "Saved."), (page, "laboratory/bare has changed since it was opened")):
        one.locator('[id="place"]').fill("Kyiv")
        one.get_by_role("button", name="Save Laboratory").click()
        one.get_by_text(said).wait_for()
    other.close()
    page.locator('[id="place"]').fill("")
    page.get_by_role("link", name="Fleet").click()  # the other form is not saved
    question.wait_for()
    question.get_by_role("button", name="Discard changes").click()
    page.wait_for_url("**/fleet")
    page.go_back()
    assert who.input_value() == "O. Petrenko"


@pytest.mark.parametrize(
    ("locale", "said"),
    [("en-GB", "Recipient 1, Address (URL): apprise has no service 'foo://'; its documentation lists them"),
     ("uk-UA", "Отримувач 1, Адреса (URL): apprise не має служби «foo://»; перелік є в її документації")],
)  # fmt: skip
def test_what_is_wrong_in_a_form_is_told_by_the_name_of_its_field_which_gets_the_focus(address, visitors, locale, said):
    page = visitors.come(address, locale=locale)
    visitors.of(page).forgives = re.compile("status of 400 .*/papers/")
    page.goto("/laboratory?station=bare")
    field = page.locator('[id="recipients.0.url"]')
    page.locator('[id="recipients.0.name"]').fill("Olena")
    field.fill("foo://x")
    page.locator("form[aria-labelledby=notify] [type=submit]").click()
    page.get_by_text(said).wait_for()
    assert field.evaluate("field => field === document.activeElement")
    if locale == "en-GB":
        field.fill("jsons://localhost/x")
        for kind in page.get_by_role("group", name="Is told of").get_by_role("checkbox").all():
            kind.uncheck()
        page.get_by_role("button", name="Save notices").click()
        page.get_by_text("Recipient 1, Is told of: must have at least 1 of them").wait_for()
        page.locator('[id="recipients.0.name"]').fill("O" * 81)
        page.get_by_role("group", name="Is told of").get_by_role("checkbox").first.check()
        page.get_by_role("button", name="Save notices").click()
        page.get_by_text("Recipient 1, Name, as events call it: must have at most 80 characters").wait_for()
        for name in ("name", "serial", "due"):
            page.locator(f'[id="equipment.0.{name}"]').fill("2026-12-01")
        page.locator('[id="equipment.0.uncertainty.0.value"]').fill("0.1")
        page.get_by_role("button", name="Save reference equipment").click()
        page.get_by_text("Instrument 1, Unit of the uncertainty: must be filled in").wait_for()


def test_a_file_with_warnings_can_be_used_and_is_not_said_to_have_nothing_wrong(address, visitors):
    page = visitors.come(address)
    page.goto("/files?kind=profiles&id=one_rate")
    page.get_by_text("Check passed, with 2 warnings").wait_for()
    assert page.get_by_text("Nothing is wrong").count() == 0


def test_a_model_of_ones_own_gets_into_a_plan_that_the_start_page_offers(address, visitors, project):
    models = project / "profiles" / "models"
    models.mkdir(exist_ok=True)
    (models / "лінія.yaml").write_text("name: лінія\neffects: [{polynomial: {order: 2}}]\n")
    (models / "formula.yaml").write_text("name: formula\neffects: [spline, {expression: {formula: k * time}}]\n")
    page = visitors.come(address)
    page.goto("/files?kind=plans&id=quick")
    text = page.get_by_label("Text of the file")
    text.wait_for()
    shipped = text.input_value().replace("name: quick", "name: of_lines")
    text.fill(shipped.replace("spline_lag_loop, polynomial", "formula"))
    page.get_by_text("models that a unit can hold").wait_for()
    page.get_by_text("It cannot be used like this").wait_for()
    text.fill(shipped.replace("spline_lag_loop, polynomial", "лінія"))
    page.locator("svg.curve").wait_for()
    name = page.get_by_label("Save as")
    name.fill("за лініями")
    page.get_by_text("no spaces").wait_for()
    assert page.get_by_role("button", name="Save as my own").is_disabled()
    name.fill("за_лініями")
    page.get_by_role("button", name="Save as my own").click()
    page.wait_for_url(f"**id={quote('за_лініями')}")
    page.get_by_role("heading", name="за_лініями").wait_for()
    assert (project / "profiles" / "plans" / "за_лініями.yaml").read_text().startswith("# yaml-language-server")
    page.goto("/start?unit=SIM-0001&station=simulated")
    page.get_by_role("button", name="of lines").click()
    page.locator("button.giant:enabled").wait_for()
