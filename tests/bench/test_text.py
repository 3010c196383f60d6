"""The terminal shows what the window shows, and takes the same commands as keys."""

import io
import os
import sys
from types import SimpleNamespace

import numpy as np
import pytest
from rich.console import Console

from labnnum.recording import Channel
from sessions.display import Keys, Quiet, Text
from sessions.snapshot import Curves, HitLine, Progress, Snapshot, scope_view
from sessions.text import render

CHANNELS = (Channel("hammer", "force", "reference"), Channel("a1"))


def snapshot(**more) -> Snapshot:
    scope = np.random.default_rng(0).standard_normal((2, 256))
    lines = np.linspace(0, 500, 100)
    value = np.abs(np.sin(lines / 90))[None]
    drawn = Curves(lines, value, 90 * value, np.full((1, 100), 0.97), ("a1 / hammer",), "m/s^2 / N", 3.0)
    given = {
        "curves": drawn,
        "hits": (HitLine(0, True, "all checks passed", 80.0), HitLine(1, False, "double hit: 30 %", 90.0)),
        "overload": (False, True), "over_now": (False, True),
        "time": 12.5, "lost": 3, "progress": (Progress("hammer 1:x", 2, 5, True),),
        "messages": ("mind the cable",), "level": 0.5, "target": 0.6, "level_unit": "N", "volts": 0.25,
    }  # fmt: skip
    return Snapshot("point 1:x: strike", **scope_view(CHANNELS, 1024.0, scope), **(given | more))


def shown(s: Snapshot) -> str:
    out = io.StringIO()
    Console(file=out, width=160).print(render(s))
    return out.getvalue()


def test_everything_is_in_the_text():
    text = shown(snapshot())
    for words in (
        "point 1:x: strike", "12.5 s", "level 0.5 of 0.6 N RMS at 0.25 V", "3 frames lost", "OVERLOAD", "hammer 1:x",
        "2/5", "1 of 2 hits accepted", "double hit: 30 %", "FRF, 3 averages", "0.970", "mind the cable",
    ):  # fmt: skip
        assert words in text


def test_an_empty_beginning_can_be_shown():
    empty = Snapshot("starting", ("f",), ("N",), 1e3, np.zeros((1, 0)), np.zeros(0), np.zeros((1, 0)))
    assert "starting" in shown(empty)


@pytest.mark.skipif(not hasattr(os, "openpty"), reason="needs a pseudo-terminal")
def test_keys_come_from_the_terminal_and_it_is_given_back(monkeypatch):
    import termios

    ours, theirs = os.openpty()
    with os.fdopen(theirs, "r") as terminal:
        monkeypatch.setattr(sys, "stdin", terminal)
        before = termios.tcgetattr(terminal)
        display = Text()
        os.write(ours, b"a?q")
        assert display.commands() == ["accept", "stop"]
        assert display.commands() == []
        display.show(snapshot())
        display.close()
        assert termios.tcgetattr(terminal) == before
    os.close(ours)


def test_no_terminal_no_keys(monkeypatch):
    monkeypatch.setattr(sys, "stdin", io.StringIO("a"))
    keys = Keys()
    assert keys.pressed() == []
    keys.close()


def test_keys_of_a_windows_console(monkeypatch):
    typed = list("a\xe0Hr")  # an arrow key between two commands
    console = SimpleNamespace(kbhit=lambda: bool(typed), getwch=lambda: typed.pop(0))
    monkeypatch.setitem(sys.modules, "termios", None)
    monkeypatch.setitem(sys.modules, "msvcrt", console)
    monkeypatch.setattr(sys, "stdin", SimpleNamespace(isatty=lambda: True))
    keys = Keys()
    assert keys.pressed() == ["a", "r"]
    assert keys.pressed() == []
    keys.close()


def test_the_last_hit_stands_out_and_an_overload_that_is_over_is_told_apart():
    drawn = shown(snapshot())
    assert "hit 1 rejected, 90 N: double hit: 30 %" in drawn
    now = snapshot(overload=(True, True), over_now=(False, True))
    assert "was over" in shown(now)
    assert "OVERLOAD" in shown(now)


def test_quiet_keeps_the_last():
    quiet = Quiet([(2, "undo")])
    assert quiet.commands() == []
    quiet.show(snapshot())
    assert quiet.commands() == ["undo"]
    assert quiet.commands() == []
