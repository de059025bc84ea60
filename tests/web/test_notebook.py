"""An analysis of the workbench as a notebook: valid, and its code gives the same numbers as the page."""

import json
import subprocess
import sys

import nbformat
import pytest

from bench.web.ground.settings import Settings
from bench.web.people import people
from tests.support import run_folders
from tests.support.web_client import served

LOOP = [
    ("up", "ramp", 60.0, 2.0),
    ("down", "ramp", 0.0, 2.0),
    ("back", "ramp", 25.0, 2.0),
    ("still", "soak", 25.0, 1800.0),
]
RUN = "SIM-0001/20261121T060000Z_ramp"
CHECK = "SIM-0001/20261121T070000Z_ramp"
MODELS = [
    {"name": "straight", "effects": [{"effect": "polynomial", "order": 2}]},
    {"name": "mine \"'''\\", "effects": [{"effect": "polynomial", "order": 4}, {"effect": "hysteresis"}]},
]
SHOW = """
import json
score = comparison.to_dataframe().loc[models[-1].name]
print("NUMBERS", json.dumps([score["rms_dph"], score["held_out_rms_dph"], score["floor_dph"], why.verdict]))
"""


@pytest.fixture(scope="module")
def store(tmp_path_factory):
    out = tmp_path_factory.mktemp("runs")
    for run, seed in ((RUN, 1), (CHECK, 2)):
        run_folders.make_run(out / run, **run_folders.ramp_run(LOOP, rate_hz=1.0, seed=seed), unit="SIM-0001")
    return out


def result(client, path, body):
    job = client.post(f"/api/v1{path}", json=body).raise_for_status().json()["job"]
    while (answer := client.get(f"/api/v1/jobs/{job}?wait_s=20").json())["state"] not in {"done", "failed"}:
        pass
    return answer["result"]


def test_a_notebook_repeats_the_analysis_with_the_same_numbers(store, tmp_path):
    chosen = {"runs": [RUN], "check": [CHECK]}
    with served(Settings(out=store, project=store)) as client:
        made = client.post("/api/v1/notebooks", json={**chosen, "models": MODELS}).raise_for_status().json()
        told = result(client, "/analyses", {**chosen, "models": MODELS})
        found = result(client, "/diagnoses", {**chosen, "model": MODELS[-1]})
    nbformat.validate(nbformat.from_dict(made))
    code = "\n".join("".join(cell["source"]) for cell in made["cells"] if cell["cell_type"] == "code")
    done = subprocess.run(
        [sys.executable, "-c", code + SHOW], cwd=tmp_path, capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == 0, done.stderr
    (numbers,) = (json.loads(line[8:]) for line in done.stdout.splitlines() if line.startswith("NUMBERS "))
    last = told["models"][-1]
    expected = [last["rms_dph"], last["held_out_rms_dph"], told["floor_dph"]]
    assert numbers == [*(pytest.approx(value, rel=1e-9) for value in expected), found["verdict"]]


def test_a_server_for_others_does_not_say_where_its_runs_are(store, tmp_path):
    access = tmp_path / "access.yaml"
    headers = {"Authorization": f"Bearer {people.add_person(access, 'Olha', 'engineer')}"}
    with served(Settings(out=store, project=store, access=access)) as client:
        answer = client.post("/api/v1/notebooks", json={"runs": [RUN], "models": MODELS}, headers=headers)
    assert answer.status_code == 200, answer.text
    assert str(store) not in answer.text
