"""Keys of a terminal: single letters, abort asks once, the terminal is left as it was; without one nothing happens."""

import os
import sys
import threading
from types import SimpleNamespace

import pytest

from bench.acquisition.run.remote import whoami
from bench.commands.terminal.keyboard import HELP, QUESTION, Keyboard


class Desk:
    """Remembers what it was asked for."""

    def __init__(self):
        self.asked = []
        self.news = threading.Event()

    def ask(self, action, who):
        self.asked.append((action, who))
        self.news.set()


def pressed(keys):
    desk = Desk()
    keyboard = Keyboard(desk)
    for key in keys:
        keyboard.press(key)
    return [action for action, _ in desk.asked]


@pytest.mark.parametrize(
    ("keys", "asked"),
    [
        ("hrp", ["hold", "resume", "pause"]),
        ("H", ["hold"]),
        ("qy", ["abort"]),
        ("QY", ["abort"]),
        ("qn", []),
        ("qh", []),  # the answer to the question is no, not a hold
        ("q\n", []),
        ("y", []),
        ("qqy", []),
        ("xz 3\x1b[A", []),
    ],
)
def test_keys_ask_for_what_they_say(keys, asked):
    assert pressed(keys) == asked


def test_who_pressed_the_key_is_told():
    desk = Desk()
    Keyboard(desk).press("h")
    assert desk.asked == [("hold", f"{whoami()} at the keyboard")]


def test_a_run_that_only_just_starts_says_so():
    def not_yet(action, who):
        raise RuntimeError("the run is only just starting; ask again in a moment")

    keys = iter("h")
    with Keyboard(SimpleNamespace(ask=not_yet), SimpleNamespace(read=lambda _: read(keys))) as keyboard:
        keyboard._thread.join()
        assert keyboard.notice.startswith("the run is only just starting")


def read(keys):
    try:
        return next(keys)
    except StopIteration:
        raise EOFError from None


def test_the_notice_explains_the_keys_and_asks_before_an_abort():
    keys = iter("q")
    with Keyboard(Desk(), SimpleNamespace(read=lambda _: read(keys))) as keyboard:
        keyboard._thread.join()
        assert keyboard.notice == QUESTION
        keyboard.press("n")
        assert keyboard.notice == HELP


def test_without_a_terminal_nothing_is_read():
    with Keyboard(Desk()) as keyboard:  # pytest has replaced the standard input
        assert keyboard.notice == ""


@pytest.mark.skipif(sys.platform == "win32", reason="needs a pseudo-terminal")
def test_a_terminal_hands_over_single_keys_and_is_left_as_it_was(monkeypatch):
    import pty
    import termios

    ours, theirs = pty.openpty()
    monkeypatch.setattr(sys, "stdin", os.fdopen(theirs, closefd=False))
    monkeypatch.setattr(sys, "stderr", SimpleNamespace(isatty=lambda: True, write=sys.stderr.write))
    monkeypatch.setattr("bench.commands.terminal.keyboard._in_foreground", lambda handle: True)
    before = termios.tcgetattr(theirs)
    desk = Desk()
    try:
        with Keyboard(desk) as keyboard:
            assert keyboard.notice == HELP
            os.write(ours, b"h")  # no Return
            assert desk.news.wait(10)
            assert not termios.tcgetattr(theirs)[3] & termios.ECHO
            assert termios.tcgetattr(theirs)[3] & termios.ISIG  # Ctrl-C stays what it is
        assert desk.asked[0][0] == "hold"
        assert termios.tcgetattr(theirs) == before
    finally:
        sys.stdin.close()
        os.close(ours)
        os.close(theirs)


@pytest.mark.skipif(sys.platform == "win32", reason="needs a pseudo-terminal")
def test_in_the_background_of_a_terminal_nothing_is_taken_from_it(monkeypatch):
    import pty
    import termios

    ours, theirs = pty.openpty()
    monkeypatch.setattr(sys, "stdin", os.fdopen(theirs, closefd=False))
    monkeypatch.setattr(sys, "stderr", SimpleNamespace(isatty=lambda: True, write=sys.stderr.write))
    before = termios.tcgetattr(theirs)
    desk = Desk()
    try:
        with Keyboard(desk):  # this pseudo-terminal is not the one that controls pytest
            os.write(ours, b"hold\n")
            assert not desk.news.wait(0.5)
            assert termios.tcgetattr(theirs) == before
        assert desk.asked == []
    finally:
        sys.stdin.close()
        os.close(ours)
        os.close(theirs)
