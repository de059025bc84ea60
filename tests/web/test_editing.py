"""Profiles, stations, limits and plans are edited as text: errors at their lines, comments and shipped files kept."""

import pytest

from bench.base import library
from bench.commands.calibration import order
from bench.web.ground.settings import Settings
from bench.web.plans import catalog
from tests.support import bench_project
from tests.support.web_client import served
from tests.web.test_actions import done


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    root = tmp_path_factory.mktemp("editing")
    project = bench_project.made(root / "project")
    with served(Settings(root / "out", project=project)) as client:
        yield client, project


def test_the_errors_of_a_text_are_told_by_line(bench):
    client, _ = bench
    text = bench_project.SHORT.replace("to_degc: 40, rate", "to_degc: 400, rate").replace("dwell_min", "dwel_min")
    found = done(client, "/api/v1/files/profiles/short/checks", text=text)
    (wrong,) = [line for line, words in enumerate(text.splitlines(), 1) if "dwel_min" in words]
    assert not found["ok"]
    assert {one["line"] for one in found["findings"]} == {wrong}
    assert "short.yaml" not in found["findings"][0]["text"]
    tab = done(client, "/api/v1/files/limits/short/checks", text="name: a\n\tb: 1\n")
    assert tab["findings"][0]["line"] == 2


def test_a_profile_is_rehearsed_on_a_station_and_has_its_picture(bench):
    client, _ = bench
    text = bench_project.SHORT
    good = done(client, "/api/v1/files/profiles/new/checks", text=text)
    assert (good["ok"], max(degc for _, degc in good["curve"])) == (True, 40.0)
    assert good["duration_s"] > 3600
    hot = done(
        client, "/api/v1/files/profiles/new/checks", text=text.replace("to_degc: 40, rate", "to_degc: 120, rate")
    )
    assert not hot["ok"]
    assert any(one["level"] == "error" and one["line"] for one in hot["findings"])


def test_a_text_is_saved_as_it_was_typed_beside_the_shipped_file(bench):
    client, project = bench
    shipped = (library() / "limits" / "quick.yaml").read_text()
    opened = client.get("/api/v1/files/limits/quick").json()
    assert (opened["text"], opened["own"]) == (shipped, False)
    mine = f"# what our customer asked for\n{shipped}"
    saved = client.put("/api/v1/files/limits/quick", json={"text": mine, "digest": opened["digest"]})
    assert saved.status_code == 200, saved.text
    assert (project / "profiles" / "limits" / "quick.yaml").read_text() == mine
    assert (library() / "limits" / "quick.yaml").read_text() == shipped
    assert "quick" in client.get("/api/v1/files").json()["own"]["limits"]
    late = client.put("/api/v1/files/limits/quick", json={"text": shipped, "digest": opened["digest"]})
    assert (late.status_code, "has changed since" in late.text) == (409, True)


def test_a_station_that_cannot_be_read_is_not_saved(bench):
    client, project = bench
    opened = client.get("/api/v1/files/stations/bare").json()
    broken = opened["text"].replace("bus: can0", "bus: can9")
    refused = client.put("/api/v1/files/stations/bare", json={"text": broken, "digest": opened["digest"]})
    assert (refused.status_code, "line" in refused.json()["detail"]) == (400, True), refused.text
    assert (project / "profiles" / "stations" / "bare.yaml").read_text() == opened["text"]
    unit = "  - {serial: BARE-2, bus: can0, number: 1, identity: 1}\n"
    missing = opened["text"].replace("simulated: true", "simulated: true\nequipment: mine", 1)
    for text, line, words in (
        (opened["text"].rstrip() + f"\n{unit}", unit.strip(), "identity is 1, as that of BARE-1 on can0"),
        (missing, "equipment: mine", "no equipment file is called 'mine'"),
    ):
        told = done(client, "/api/v1/files/stations/bare/checks", text=text)["findings"]
        (found,) = [one for one in told if one["level"] == "error"]
        assert (words in found["text"], text.splitlines()[found["line"] - 1].strip()) == (True, line)
        refused = client.put("/api/v1/files/stations/bare", json={"text": text, "digest": opened["digest"]})
        assert refused.json()["detail"] == f"line {found['line']}: {found['text']}"
        assert refused.status_code == 400
    profile = {"text": bench_project.SHORT.replace("name: short", "nam: short"), "digest": ""}
    assert client.put("/api/v1/files/profiles/new", json=profile).status_code == 400
    outside = client.put("/api/v1/files/stations/..%2fx", json={"text": "", "digest": ""})
    assert outside.status_code in {404, 422}


WRONG = "recipients: [{name: desk, url: nonsense}]\n"


@pytest.mark.parametrize(
    ("recipients", "said"),
    [
        (None, "profiles/stations/notify.yaml: no such file"),
        (WRONG, "profiles/stations/notify.yaml:1: recipients[0].url: begins with"),
    ],
)
def test_a_station_whose_recipients_are_wrong_is_not_saved(bench, recipients, said):
    client, project = bench
    opened = client.get("/api/v1/files/stations/bare").json()
    text = f"{opened['text'].rstrip()}\nnotify: notify.yaml\n"
    if recipients is not None:
        (project / "profiles" / "stations" / "notify.yaml").write_text(recipients)
    found = done(client, "/api/v1/files/stations/bare/checks", text=text)
    assert (found["ok"], found["findings"][0]["text"][: len(said)]) == (False, said)
    refused = client.put("/api/v1/files/stations/bare", json={"text": text, "digest": opened["digest"]})
    assert (refused.status_code, refused.json()["detail"]) == (400, found["findings"][0]["text"])
    assert client.get("/api/v1/files/stations/bare").json() == opened


@pytest.mark.parametrize("text", [WRONG, "# mail\n'recipients' : []\n", "{recipients: [\n"])
def test_a_file_of_recipients_among_others_is_listed_nowhere_and_shows_nobody_its_passwords(bench, text):
    client, project = bench
    file = project / "profiles" / "stations" / "people.yaml"
    for place in (file, project / "profiles" / "people.yaml"):
        place.write_text(text)
    listed = [client.get(f"/api/v1/{kind}").json() for kind in ("files", "stations", "plans")]
    assert "people" not in str(listed)
    for kind in ("stations", "profiles"):
        assert client.get(f"/api/v1/files/{kind}/people").status_code == 400
    station = client.get("/api/v1/files/stations/bare").json()["text"]
    over = client.put("/api/v1/files/stations/people", json={"text": station, "digest": ""})
    assert (over.status_code, file.read_text()) == (409, text)


@pytest.mark.parametrize("kind", ["laboratory", "equipment"])
def test_papers_beside_stations_and_plans_are_no_broken_station_or_plan(bench, kind):
    """docs/howto/delivery.md puts them there."""
    client, project = bench
    text = (library() / kind / "simulated.yaml").read_text()
    for place in ("stations", "plans"):
        (project / "profiles" / place / f"my_{kind}.yaml").write_text(text)
    (project / "profiles" / "stations" / "half.yaml").write_text("name: half\nlaboratory: mine\nunits: []\n")
    listed = [client.get(f"/api/v1/{each}").json() for each in ("files", "stations", "calibration-plans")]
    assert f"my_{kind}" not in str(listed)
    (half,) = [station for station in listed[1]["stations"] if station["id"] == "half"]
    assert half["problem"]


def test_a_place_that_cannot_be_written_is_named_with_a_way_on(bench):
    client, project = bench
    text = client.get("/api/v1/files/limits/quick").json()["text"]
    (project / "profiles" / "limits").rename(project / "limits")
    (project / "profiles" / "limits").write_text("no folder")
    answer = client.put("/api/v1/files/limits/mine", json={"text": text, "digest": ""})
    said = "the server cannot read or write profiles/limits: File exists; runs go on: tell whoever is in charge of its"
    assert (answer.status_code, answer.json()["detail"]) == (503, f"{said} computer")


def test_a_changed_copy_of_a_shipped_profile_needs_a_name_of_its_own(bench):
    client, project = bench
    opened = client.get("/api/v1/files/profiles/quick").json()
    for same in (opened["text"], f"# mine\n{opened['text']}"):
        assert done(client, "/api/v1/files/profiles/mine/checks", text=same)["ok"]
    hotter = opened["text"].replace("to_degc: 50", "to_degc: 55", 1)
    line = 1 + [words.startswith("name:") for words in hotter.splitlines()].index(True)
    found = done(client, "/api/v1/files/profiles/quick/checks", text=hotter)
    (wrong,) = [one for one in found["findings"] if "is taken by a shipped profile" in one["text"]]
    assert (found["ok"], wrong["level"], wrong["line"], bool(found["curve"])) == (False, "error", line, True)
    for name, digest in (("quick", opened["digest"]), ("mine", "")):
        refused = client.put(f"/api/v1/files/profiles/{name}", json={"text": hotter, "digest": digest})
        assert (refused.status_code, refused.json()["detail"]) == (400, f"line {line}: {wrong['text']}")
        assert not (project / "profiles" / f"{name}.yaml").exists()
    own = hotter.replace("name: quick", "name: quick_mine")
    saved = client.put("/api/v1/files/profiles/mine", json={"text": own, "digest": ""})
    assert saved.status_code == 200
    other = own.replace("to_degc: 55", "to_degc: 45", 1)
    found = done(client, "/api/v1/files/profiles/copied/checks", text=other)
    (wrong,) = [one for one in found["findings"] if "is taken by mine.yaml of other content" in one["text"]]
    assert (found["ok"], wrong["level"], wrong["line"]) == (False, "error", line)
    refused = client.put("/api/v1/files/profiles/copied", json={"text": other, "digest": ""})
    assert (refused.status_code, refused.json()["detail"]) == (400, f"line {line}: {wrong['text']}")
    again = {"text": other, "digest": saved.json()["digest"]}
    assert client.put("/api/v1/files/profiles/mine", json=again).status_code == 200


def test_a_plan_is_copied_gets_a_model_of_ones_own_and_is_checked_as_its_calibration_would_be(tmp_path, monkeypatch):
    project = bench_project.made(tmp_path / "project")
    monkeypatch.chdir(project)
    with served(Settings(tmp_path / "out", project=project)) as client:
        edit_a_plan(client, project)


@pytest.mark.parametrize(
    ("name", "status"),
    [("моя_межа", 200), ("限值-2", 200), ("CON", 400), ("nul.2", 400), ("моя межа", 422), (".моя", 422), ("a%07b", 422),
     ("..%2Fмежа", 404), ("межа%5C2", 422)],
)  # fmt: skip
def test_a_file_has_a_name_in_its_users_own_script_that_every_computer_can_keep(bench, name, status):
    client, project = bench
    answer = client.put(f"/api/v1/files/profiles/{name}", json={"text": bench_project.SHORT, "digest": ""})
    assert answer.status_code == status, answer.text
    assert (project / "profiles" / f"{name}.yaml").exists() == (status == 200)
    if status == 200:
        assert name in client.get("/api/v1/files").json()["own"]["profiles"]
        assert client.get(f"/api/v1/files/profiles/{name}").json()["text"] == bench_project.SHORT
    if status == 400:
        assert f"take '_{name}'" in answer.json()["detail"]


def test_a_plan_is_read_once_for_a_check(tmp_path, monkeypatch):
    project = bench_project.made(tmp_path)
    read = []
    monkeypatch.setattr(order, "read_yaml", lambda path, known=order.read_yaml: (read.append(path), known(path))[1])
    places = {"file": str(project / "profiles/plans/mine.yaml"), "project": str(project)}
    text = (project / "profiles/plans/brief.yaml").read_text()
    station = library() / "stations" / "simulated.yaml"
    told = catalog.drafted({**places, "kind": "plans", "text": text, "station": str(station)})
    assert told["ok"], told
    assert len(read) == len({*read}) > 0


def edit_a_plan(client, project):
    models = project / "profiles" / "models"
    models.mkdir(exist_ok=True)
    (models / "лінія.yaml").write_text("name: лінія\neffects: [{polynomial: {order: 2}}]\n")
    (models / "formula.yaml").write_text("name: formula\neffects: [spline, {expression: {formula: k * time}}]\n")
    assert "quick" in client.get("/api/v1/files").json()["plans"]
    opened = client.get("/api/v1/files/plans/quick").json()
    text = opened["text"].replace("[spline_lag_loop, polynomial]", "[MODEL]").replace("name: quick", "name: mine")
    checks = "/api/v1/files/plans/mine/checks"
    found = done(client, checks, text=text.replace("MODEL", "лінія"))
    assert (found["ok"], found["duration_s"] > 3600, found["curve"][0][0]) == (True, True, 0.0), found
    for model, said in (("formula", "models that a unit can hold: "), ("lnia", "unknown model 'lnia'")):
        wrong = text.replace("MODEL", model)
        told = done(client, checks, text=wrong)
        assert (told["ok"], said in told["findings"][0]["text"]) == (False, True), told
        refused = client.put("/api/v1/files/plans/mine", json={"text": wrong, "digest": ""})
        assert (refused.status_code, said in refused.json()["detail"]) == (400, True), refused.text
    wrong = text.replace("limits: ..", "limit: ..")
    lines = {one["line"] for one in done(client, checks, text=wrong)["findings"]}
    assert next(n for n, line in enumerate(wrong.splitlines(), 1) if line.startswith("limit:")) in lines
    bare = done(client, checks, text=text.replace("MODEL", "лінія"), station="bare")
    assert "no laboratory and no signatory" in bare["findings"][0]["text"]
    kept = client.put("/api/v1/files/plans/mine", json={"text": text.replace("MODEL", "лінія"), "digest": ""})
    assert kept.status_code == 200, kept.text
    plans = {plan["id"]: plan for plan in client.get("/api/v1/calibration-plans").json()["plans"]}
    assert (plans["mine"]["problem"], plans["mine"]["title"]) == ("", "mine"), "its profiles are the shipped ones"
    asked = {"plan": "mine", "station": "simulated", "unit": "SIM-0001"}
    assert done(client, "/api/v1/calibrations/checks", **asked)["ok"]
