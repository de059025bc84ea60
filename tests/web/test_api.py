"""The whole API against its own description: whatever is sent, the answer is a described one, a refusal one line."""

import re
import shutil
from pathlib import Path

import pytest
import schemathesis
from hypothesis import HealthCheck, Phase, settings
from schemathesis.checks import CHECKS

from bench.web.ground import policy
from bench.web.ground.problems import RESPONSES
from bench.web.ground.settings import Settings
from bench.web.server.app import create_app
from bench.web.server.routes import add_routes
from tests.support.web_client import served

schemathesis.checks.load_all_checks()
APP = create_app(Settings(Path("nowhere")))
add_routes(APP)
SCHEMA = schemathesis.openapi.from_dict(APP.openapi())
EXAMPLES = 6
CONFORMS = [
    CHECKS.get_one(name)
    for name in ("status_code_conformance", "content_type_conformance", "response_schema_conformance")
]
UNENDING = "/api/v1/live/stream"


@pytest.fixture(scope="module")
def bench(short_run, tmp_path_factory):
    """A client of a server with one run, and the ids by which its paths name things."""
    root = tmp_path_factory.mktemp("api")
    run = root / "out" / short_run.path.parent.name / short_run.path.name
    shutil.copytree(short_run.path, run)
    with served(Settings(root / "out", project=root)) as client:
        yield client, {"unit": run.parent.name, "run": run.name, "serial": run.parent.name}


@SCHEMA.exclude(path=UNENDING).parametrize()
@settings(
    max_examples=EXAMPLES,
    derandomize=True,
    database=None,
    deadline=None,
    phases=[Phase.explicit, Phase.generate],
    suppress_health_check=list(HealthCheck),
)
def test_every_operation_answers_as_described(case, bench):
    client, ids = bench
    answered(case, client)
    known = {name: ids[name] for name in ids.keys() & case.path_parameters.keys()}
    if known:
        case.path_parameters.update(known)
        answered(case, client)


def answered(case, client):
    response = case.call(base_url=str(client.base_url), timeout=60)
    case.validate_response(response, checks=CONFORMS)
    assert response.status_code != 500, response.text
    assert response.headers["x-content-type-options"] == ["nosniff"]
    if response.status_code >= 400:
        (detail,) = response.json().values()
        assert detail
        assert "\n" not in detail
        assert "Traceback" not in detail


def test_the_description_names_every_refusal(bench):
    client, _ = bench
    described = client.get("/api/v1/openapi.json").json()
    assert len(described["paths"]) > 30
    for item in described["paths"].values():
        for operation in item.values():
            assert {str(status) for status in RESPONSES} <= set(operation["responses"])
            assert operation.get("summary")


def test_a_report_is_shown_in_an_origin_of_its_own(bench):
    client, ids = bench
    answer = client.get(f"/api/v1/runs/{ids['unit']}/{ids['run']}/report")
    assert answer.headers["content-security-policy"] == (policy.REPORT if answer.status_code == 200 else policy.PART)


def test_the_page_has_its_policy_and_parts_of_it_have_a_short_one(bench):
    client, _ = bench
    page = client.get("/")
    assert [one.headers["content-security-policy"] for one in (page, client.get("/nowhere"))] == [policy.PAGE] * 2
    assert policy.policy_of(None) == policy.PAGE, "that a copy is good is said without a type, and changes its headers"
    script = re.search(r'src="(/static/[^"]+)"', page.text).group(1)
    for part in (client.get(script), client.get("/api/v1/session")):
        assert part.headers["content-security-policy"] == policy.PART
        assert len(policy.PART) < 60
