"""The live display: a table in a terminal, plain lines elsewhere, nothing when it is asked to be quiet."""

import io
from types import SimpleNamespace

import pytest
from rich.console import Console

from bench.acquisition.profile.guards import Signal
from bench.acquisition.profile.profile import profile_from_text
from bench.acquisition.run.status import Status
from bench.commands.terminal import progress
from bench.commands.terminal.progress import Progress
from drivers.chamber import ChamberReading

PROFILE = profile_from_text(
    "name: p\nsegments:\n  - {kind: ramp, to_degc: 33, rate_degc_per_min: 2}\n  - {kind: soak, duration_min: 10}\n"
)
LOSSES = {"received": 6010, "lost": 3, "corrupt": 1}
STATION = SimpleNamespace(losses=lambda: LOSSES, everyone=[None])


def status(t_s, leg=0, leg_from_s=0.0, holding=()):
    reading = ChamberReading(t_s, 25.04, 33.0, 25.1, 10.0, True, (), False)
    return Status(t_s, PROFILE.legs()[leg], leg_from_s, 2, reading, 24.567, holding)


@pytest.fixture
def terminal(monkeypatch):
    """What a terminal of 100 columns is sent."""
    console = Console(file=io.StringIO(), force_terminal=True, width=100, color_system=None)
    monkeypatch.setattr(progress, "Console", lambda **_: console)
    return console.file


def test_plain_lines_at_every_leg_and_not_at_every_tick(capsys):
    with Progress(PROFILE) as show:
        for t_s in range(1, 100):
            show(STATION, status(float(t_s)))
        show(STATION, status(301.0, leg=1, leg_from_s=300.0))
    out, err = capsys.readouterr()
    assert out == ""
    assert err.splitlines() == [
        "[0:00:01] 1/2 ramp to 33 at 2: chamber 25.0 degC, unit 24.57 degC, 6010 frames, 3 lost, 0:14:59 left",
        "[0:05:01] 2/2 soak at 33: chamber 25.0 degC, unit 24.57 degC, 6010 frames, 3 lost, 0:09:59 left",
    ]


def test_a_terminal_gets_a_table(terminal):
    with Progress(PROFILE) as show:
        show(STATION, status(10.0, holding=("too hot: unit temperature = 90 degC is above 85 degC",)))
    text = terminal.getvalue()
    for part in ("1/2  ramp to 33 at 2", "25.04 degC", "33.00 degC", "24.57 degC", "6010 received, 3 lost", "601/s"):
        assert part in text
    assert "HOLD" in text
    assert "too hot: unit temperature = 90 degC is above 85 degC" in text


def several():
    """Three units, the second of which has left."""
    losses = SimpleNamespace(received=601, lost=2)
    units = [
        SimpleNamespace(serial=f"G{n}", temperature=Signal(24.0 + n, 0.0), decoder=SimpleNamespace(losses=losses))
        for n in (1, 2, 3)
    ]
    gone = [SimpleNamespace(unit=units[1], reason="no sound rate frame for 5.1 s")]
    return SimpleNamespace(losses=lambda: LOSSES, everyone=units, units=[units[0], units[2]], dropped=gone)


def test_each_of_several_units_has_its_row_or_its_reason(terminal):
    with Progress(PROFILE) as show:
        show(several(), status(10.0))
    text = terminal.getvalue()
    for part in ("G1", "25.00 degC   601 frames, 2 lost", "left: no sound rate frame for 5.1 s", "27.00 degC"):
        assert part in text


def test_a_plain_line_names_those_of_several_units_that_have_left(capsys):
    with Progress(PROFILE) as show:
        show(several(), status(10.0))
    assert "chamber 25.0 degC, 2 units 25.00 to 27.00 degC (G2 left), 6010 frames" in capsys.readouterr().err


def test_a_terminal_is_left_as_it_was(terminal):
    with Progress(PROFILE) as show:
        show(STATION, status(10.0))
    assert terminal.getvalue().endswith("\x1b[2K")  # the table is gone
    assert "\x1b[?25h" in terminal.getvalue()  # the cursor is back


def test_quiet_is_quiet(terminal, capsys):
    with Progress(PROFILE, quiet=True) as show:
        show(STATION, status(10.0))
    assert terminal.getvalue() == ""
    assert capsys.readouterr() == ("", "")


def test_time_left_follows_a_leg_that_is_late():
    show = Progress(PROFILE)
    assert show.left_s(status(0.0)) == pytest.approx(300 + 600)
    assert show.left_s(status(100.0)) == pytest.approx(200 + 600)
    assert show.left_s(status(1000.0)) == pytest.approx(600)  # the ramp is late: the soak is still to come
    assert show.left_s(status(1100.0, leg=1, leg_from_s=1000.0)) == pytest.approx(500)


def test_a_hold_is_told_in_a_pipe_at_once_with_its_reason(capsys):
    with Progress(PROFILE) as show:
        show(STATION, status(1.0))
        show(STATION, status(2.0, holding=("ada at the keyboard",)))
        show(STATION, status(3.0, holding=("ada at the keyboard",)))
        show(STATION, status(4.0))
    lines = capsys.readouterr().err.splitlines()
    assert [line.endswith("; HELD by ada at the keyboard") for line in lines] == [False, True, False]
