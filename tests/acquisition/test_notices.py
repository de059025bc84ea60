"""Somebody far from the bench hears that a run ended, tripped or holds; what cannot be delivered harms no run."""

import json
import re
import threading
from dataclasses import dataclass
from email import message_from_string
from pathlib import Path

import pytest

from bench.acquisition.run.runner import run_job
from bench.acquisition.station import watchdog
from bench.acquisition.station.notices import Notifier
from bench.acquisition.station.settings.notify import NotifyFile
from bench.base import load_config, parse_yaml
from bench.base.errors import InputError
from bench.commands import resuming
from bench.commands.acquisition import check
from bench.commands.calibration.calibrate import calibrate
from bench.commands.calibration.job import Done
from bench.commands.calibration.order import Order
from tests.support import acquisition, notices
from tests.support.acquisition import at
from tests.support.commands import bench

PROFILES = Path(__file__).parents[2] / "profiles"
SECRET = "correct-horse"


def declared(folder, *recipients):
    """A notification file; recipients are (name, url) or (name, url, when)."""
    path = folder / "notify.yaml"
    entries = [dict(zip(("name", "url", "when"), given, strict=False)) for given in recipients]
    path.write_text(json.dumps({"recipients": entries}))
    return str(path)


def run(folder, *recipients, look=lambda station, status: None, **changes):
    settings = acquisition.station(notify=declared(folder, *recipients), **changes)
    return run_job(acquisition.job(folder / "out", settings=settings), look)


def test_the_end_of_a_run_is_told_to_a_webhook_and_by_mail(tmp_path):
    with notices.webhook() as hook, notices.mailbox() as mail:
        ended = run(
            tmp_path,
            ("hook", f"json://127.0.0.1:{hook.port}/{SECRET}"),
            ("mail", f"mailto://bench.example:{mail.port}?smtp=127.0.0.1&from=bench@bench.example&to=a@b.example"),
        )
        told, (to, text) = hook.next(), mail.next()
    assert ended.error is None
    assert told["title"] == "SIM-0001 short: the run ended"
    assert told["type"] == "success"
    assert "end of profile" in told["message"]
    assert f"run SIM-0001/{ended.run.path.name} on station simulated" in told["message"]
    assert to == ["RCPT TO:<a@b.example>"] or "a@b.example" in to[0]
    assert message_from_string(text)["Subject"] == "SIM-0001 short: the run ended"
    assert not [event for event in ended.run.events() if event["kind"] == "notify"]


def test_a_trip_is_told_when_it_happens_and_then_the_end(tmp_path):
    hot = {"name": "hot", "signal": "chamber_temperature", "above": 23.5, "action": "abort"}
    with notices.webhook() as hook:
        ended = run(tmp_path, ("hook", f"json://127.0.0.1:{hook.port}"), guards=[hot])
        trip, end = hook.next(), hook.next()
    assert (trip["title"], trip["type"]) == ("SIM-0001 short: tripped", "failure")
    assert "hot" in trip["message"]
    assert (end["title"], end["type"]) == ("SIM-0001 short: the run was aborted", "failure")
    assert ended.run.manifest().state == "aborted"


def test_a_hold_is_told_to_those_who_want_to_hear_of_it(tmp_path):
    with notices.webhook() as first, notices.webhook() as second:
        warm = {
            "name": "warm",
            "signal": "chamber_temperature",
            "above": 23.5,
            "release_below": 23.0,
            "action": "hold",
        }
        run(
            tmp_path,
            ("night", f"json://127.0.0.1:{first.port}", ["hold"]),
            ("office", f"json://127.0.0.1:{second.port}", ["end"]),
            look=at(300.0, lambda station: (_ for _ in ()).throw(InputError("enough"))),
            guards=[warm],
        )
        assert [told["title"] for told in first.all()] == ["SIM-0001 short: holds"]
        assert [told["title"] for told in second.all()] == ["SIM-0001 short: the run failed"]


@pytest.mark.parametrize("status", [None, 500], ids=["nobody there", "refused"])
def test_what_cannot_be_delivered_is_an_event_and_harms_nothing(tmp_path, status):
    with notices.webhook(status or 200) as hook:
        port = hook.port
        if status:
            ended = run(tmp_path, ("hook", f"json://u:{SECRET}@127.0.0.1:{port}/{SECRET}"))
    if not status:
        ended = run(tmp_path, ("hook", f"json://u:{SECRET}@127.0.0.1:{port}/{SECRET}"))
    assert ended.error is None
    (event,) = [event for event in ended.run.events() if event["kind"] == "notify"]
    assert event["text"] == "hook was not told of: end; `bench doctor STATION --notify` says why"


def test_a_recipient_that_does_not_answer_holds_up_neither_the_run_nor_its_end(tmp_path, monkeypatch):
    monkeypatch.setattr("bench.acquisition.station.notices.PATIENCE_S", 0.0)
    gate = threading.Event()
    with notices.webhook(gate=gate) as hook:
        hot = {"name": "hot", "signal": "chamber_temperature", "above": 23.5, "action": "abort"}
        ended = run(tmp_path, ("hook", f"json://127.0.0.1:{hook.port}?rto=60"), guards=[hot])
        hook.next()
        gate.set()
    (event,) = [event for event in ended.run.events() if event["kind"] == "notify"]
    assert event["text"].startswith("hook was not told of: trip, end; ")


def test_more_notices_than_a_recipient_takes_are_dropped_not_kept(tmp_path):
    gate = threading.Event()
    with notices.webhook(gate=gate) as hook:
        notifier = Notifier(declared(tmp_path, ("hook", f"json://127.0.0.1:{hook.port}?rto=60")))
        for _ in range(60):
            notifier.tell("hold", "t", "b")
        gate.set()
        notifier.close()
        assert 16 <= len(hook.all()) <= 20
        (text,) = notifier.troubles()
    assert text.startswith("hook was not told of: hold (4")


def test_who_only_reads_the_file_leaves_no_thread(tmp_path):
    before = threading.active_count()
    notifier = Notifier(declared(tmp_path, ("hook", "json://127.0.0.1:9")))
    notifier.close()
    assert threading.active_count() == before
    assert notifier.troubles() == []


def test_no_secret_reaches_the_run_folder(tmp_path):
    with notices.webhook(500) as hook:
        ended = run(tmp_path, ("hook", f"json://u:{SECRET}@127.0.0.1:{hook.port}/{SECRET}"))
    kept = [path for path in ended.run.path.rglob("*") if path.is_file()]
    assert kept
    assert not [path for path in kept if SECRET.encode() in path.read_bytes()]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("recipients: []", "recipients is []: must have at least 1 of them"),
        (f"recipients:\n- {{name: {'a' * 81}, url: 'json://h'}}", "must have at most 80 characters"),
        (
            "recipients:\n- {name: a, url: 'nonsense://h'}",
            ":2: recipients[0].url: apprise has no service 'nonsense://'",
        ),
        (f"recipients:\n- {{name: a, url: '{SECRET}'}}", ":2: recipients[0].url: begins with no service"),
        (
            "recipients:\n- {name: a, url: 'json://'}",
            ":2: recipients[0].url: is not complete for the",
        ),
        ("recipients:\n- {name: a, url: 'json://h', when: [ends]}", "end"),
        (
            "recipients:\n- {name: a, url: 'json://h'}\n- {name: a, url: 'json://g'}",
            "recipients[1].name: 'a' stands",
        ),
    ],
)
def test_a_wrong_file_is_refused_before_anything_moves_and_shows_no_secret(tmp_path, text, said):
    path = tmp_path / "notify.yaml"
    path.write_text(text)
    with pytest.raises(InputError) as refused:
        Notifier(str(path))
    assert said in str(refused.value)
    assert SECRET not in str(refused.value)
    station = tmp_path / "station.yaml"
    station.write_text(json.dumps(acquisition.station_content(notify="notify.yaml")))
    profile = tmp_path / "short.yaml"
    profile.write_text(acquisition.SHORT)
    with pytest.raises(InputError) as refused:
        check(profile, station)
    assert said in str(refused.value)


@dataclass
class Step:
    """A step of a calibration that finds something."""

    done: Done
    name: str = "one"

    def do(self, order, job):
        return self.done


@pytest.mark.parametrize(
    ("done", "title", "mood"),
    [
        (Done("fine", verdict="PASS"), "calibration PASS", "success"),
        (Done("doubt", hold="two models tie"), "calibration HOLD", "warning"),
        (Done("bad", verdict="FAIL", stop="too large"), "calibration FAIL", "failure"),
    ],
)
def test_the_end_of_a_calibration_is_told_and_what_it_waits_for(tmp_path, done, title, mood):
    with notices.webhook() as hook:
        declared(tmp_path, ("hook", f"json://127.0.0.1:{hook.port}"))
        order = calibration(tmp_path)
        calibrate(order, steps=[Step(done)])
        calibrate(order, steps=[Step(done)])  # it has ended, or waits on: nothing is news
        (told,) = hook.all()
    assert (told["title"], told["type"]) == (f"SIM-0001 quick: {title}", mood)
    assert (done.hold or done.stop or "calibrated and verified") in told["message"]


def calibration(folder):
    station = folder / "station.yaml"
    station.write_text(json.dumps(acquisition.station_content(notify="notify.yaml")))
    return Order.load(PROFILES / "plans" / "quick.yaml", station, "SIM-0001", folder / "reports", quiet=True)


def test_a_calibration_whose_notice_is_lost_ends_as_it_would_and_says_so(tmp_path, capsys):
    with notices.webhook(500) as hook:
        declared(tmp_path, ("hook", f"json://127.0.0.1:{hook.port}"))
        job = calibrate(calibration(tmp_path), steps=[Step(Done("fine", verdict="PASS"))])
    assert job.content["verdict"] == "PASS"
    assert "bench: hook was not told of: calibration" in capsys.readouterr().err


def doctor(station, *options):
    return bench("doctor", station, "--notify", *options)


def test_doctor_sends_a_trial_and_says_why_one_was_not_taken(tmp_path):
    with notices.webhook() as good, notices.webhook(503) as bad:
        declared(
            tmp_path, ("good", f"json://127.0.0.1:{good.port}"), ("bad", f"json://u:{SECRET}@127.0.0.1:{bad.port}")
        )
        calibration(tmp_path)
        answer = doctor(tmp_path / "station.yaml")
        assert good.next()["title"] == "bench: trial"
        content = json.loads(doctor(tmp_path / "station.yaml", "--json").stdout)
    assert answer.exit_code == 4
    assert re.search(r"^ok +good +taken$", answer.stdout, re.MULTILINE)
    assert re.search(r"^!! +bad +Failed to send JSON .*503", answer.stdout, re.MULTILINE)
    assert SECRET not in answer.output
    assert set(content) == {"file", "recipients"}
    assert content["recipients"]["good"] == ""


def test_doctor_says_how_to_tell_somebody_where_a_station_tells_nobody():
    answer = doctor(acquisition.STATION)
    assert answer.exit_code == 2
    assert "this station tells nobody: fill in 'Notices'" in answer.stderr


def test_the_watchdog_tells_what_it_did_in_place_of_the_bench(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(watchdog._Safe, "make", lambda self: [])
    with notices.webhook() as hook:
        settings = acquisition.station(notify=declared(tmp_path, ("hook", f"json://127.0.0.1:{hook.port}")))
        log = watchdog.Log(tmp_path, 0)
        found = watchdog._notices(settings, log)
        listener = watchdog.Listener(0, 1.0)
        listener.failed = True
        watchdog._replace(None, listener, watchdog._Safe(settings, log, None, found), "the bench ended unexpectedly")
        first, last = hook.next(), hook.next()
        found.close()
    assert first["title"].endswith(": the watchdog took over")
    assert first["message"].startswith("the bench ended unexpectedly: the watchdog makes the equipment safe")
    assert "equipment is safe, verified after" in last["message"]


def test_a_watchdog_whose_notification_file_was_spoilt_meanwhile_watches_on(tmp_path, capsys):
    (tmp_path / "notify.yaml").write_text("nonsense")
    settings = acquisition.station(notify=str(tmp_path / "notify.yaml"))
    watchdog._notices(settings, watchdog.Log(tmp_path, 0)).tell("trip", "t", "b")
    assert "notify.yaml:1" in json.loads((tmp_path / watchdog.EVENTS).read_text())["text"]


def test_a_resumed_run_says_when_it_does_not_find_whom_to_tell(tmp_path, capsys):
    path = declared(tmp_path, ("hook", "json://127.0.0.1"))
    assert resuming._unmoved(acquisition.station(notify=path)).notify == path
    assert resuming._unmoved(acquisition.station(notify="notify.yaml")).notify is None
    assert "notify.yaml is not found from here: nobody is told how this run ends; --station" in capsys.readouterr().err


def test_the_notification_file_of_the_how_to_is_right():
    page = (PROFILES.parent / "docs" / "howto" / "production.md").read_text(encoding="utf-8")
    (text,) = re.findall(r"```yaml\n(# notify.yaml\n.*?)```", page, re.DOTALL)
    kinds = [recipient.when for recipient in load_config(parse_yaml(text, "notify.yaml"), NotifyFile).recipients]
    assert kinds == [("end", "trip", "hold"), ("trip", "calibration"), ("end", "trip", "hold", "calibration")]
