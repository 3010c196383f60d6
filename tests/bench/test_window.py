"""The live window: shows what it is given, sends the keys, and cannot hold up a measurement."""

import os
import signal
import sys
import time
from dataclasses import replace

import numpy as np
import pytest

from labnnum.errors import LabnnumError, SafetyError
from labnnum.recording import Channel
from sessions.bench import measure
from sessions.display import Display
from sessions.snapshot import Curves, HitLine, Progress, Snapshot, scope_view
from sessions.store import open_session

from .rigs import live_rig

needs_qt = pytest.mark.usefixtures("qtbot")
CHANNELS = (Channel("hammer", "force", "reference"), Channel("a1"), Channel("a2"))


def snapshot(n_hits=3, **more) -> Snapshot:
    scope = np.random.default_rng(0).standard_normal((3, 512))
    lines = np.linspace(0, 500, 200)
    value = np.abs(np.sin(lines / 90))[None] * np.ones((2, 1))
    drawn = Curves(lines, value, 90 * value, np.clip(value, 0, 1), ("a1 / hammer", "a2 / hammer"), "m/s^2 / N", 3.0)
    hits = tuple(
        HitLine(i, i != 1, "double hit: 30 %" if i == 1 else "all checks passed", 80.0 + i) for i in range(n_hits)
    )
    given = {
        "curves": drawn, "hits": hits, "hit": scope, "overload": (False, True, False), "time": 12.5, "lost": 3,
        "progress": (Progress("hammer 1:x", 1, 1), Progress("hammer 2:x", 2, 5, True)), "messages": ("mind the cable",),
        "judged": True,
    }  # fmt: skip
    return Snapshot("point 2:x: strike", **scope_view(CHANNELS, 1024.0, scope), **(given | more))


@pytest.fixture
def view(qtbot):
    from sessions.window.view import View

    sent = []
    made = View(sent.append)
    made.sent = sent
    qtbot.addWidget(made)
    made.show()
    return made


def test_everything_is_shown(view):
    view.show_snapshot(snapshot())
    assert view.state.text() == "point 2:x: strike"
    assert [c.name() for c in view.scope.curves] == ["a1, m/s^2", "a2, m/s^2"]
    assert [c.name() for c in view.inputs.curves] == ["hammer, N"]
    assert len(view.spectrum.curves) == 3
    for part in (view.magnitude, view.phase, view.coherence):
        assert len(part.curves) == 2
        assert part.curves[0].getOriginalDataset()[0].size == 200
    assert [lamp.text() for lamp in view.lamps.lamps] == ["hammer", "a1 was over", "a2", "3 lost, 0 overflows"]
    view.show_snapshot(snapshot(over_now=(False, True, False)))
    assert view.lamps.lamps[1].text() == "a1 OVER"
    assert view.hits.item(1, 3).text() == "double hit: 30 %"
    assert view.hits.item(1, 2).text() == "rejected"
    assert view.progress.topLevelItem(1).text(0) == "▶ hammer 2:x"
    assert view.messages.text() == "mind the cable"
    assert "12.5 s" in view.level.text()


def test_the_pulse_of_a_hit_fills_its_plot_and_the_phase_its_turn(view):
    force = np.zeros((3, 4000))
    force[0, 500:510] = np.hanning(12)[1:-1]
    view.show_snapshot(snapshot(hit=force))
    (low, high), _ = view.hit.plot.viewRange()
    rate = view.snapshot.rate
    assert low < 500 / rate
    assert 510 / rate < high < 1000 / rate
    wrapped = np.tile([[181.0, 179.0]], (2, 100))  # a full turn from 0: nothing jumps, nothing is cut off
    curves = replace(snapshot().curves, phase=wrapped)
    view.show_snapshot(snapshot(curves=curves))
    _, (bottom, top) = view.phase.plot.viewRange()
    assert bottom < 179
    assert top > 181


def test_stop_is_in_reach_on_a_small_screen():
    from PySide6 import QtCore

    from sessions.window.view import _fitting

    assert _fitting(1500, 900, QtCore.QSize(1366, 768)) == QtCore.QSize(1366, 728)
    assert _fitting(1500, 900, QtCore.QSize(2560, 1440)) == QtCore.QSize(1500, 900)


def test_a_shaker_run_is_shown_without_hits(view):
    view.show_snapshot(
        snapshot(0, hit=None, level=1.9, target=2.0, level_unit="N", volts=0.4, curves=None, judged=False)
    )
    assert "level 1.9 of 2 N RMS, generator 0.4 V RMS" in view.level.text()
    assert not any(button.isVisible() for button in view.buttons.values())
    assert view.stop.isVisible()
    assert not view.hits.isVisible()
    assert not view.hit.plot.isVisible()
    assert view.magnitude.curves == []
    view.show_snapshot(snapshot())
    assert view.hits.isVisible()
    assert all(button.isVisible() for button in view.buttons.values())


def test_keys_and_buttons_send_commands(view, qtbot):
    from PySide6 import QtCore

    view.show_snapshot(snapshot())
    view.activateWindow()
    qtbot.waitUntil(view.isActiveWindow)
    key = QtCore.Qt.Key
    for pressed in (key.Key_A, key.Key_R, key.Key_U, key.Key_N, key.Key_Space):
        qtbot.keyClick(view, pressed)
    assert view.sent == ["accept", "reject", "undo", "next", "next"]
    view.hits.selectRow(1)
    qtbot.mouseClick(view.buttons["accept"], QtCore.Qt.MouseButton.LeftButton)
    assert view.sent[-1] == "accept 1"
    qtbot.keyClick(view, key.Key_Escape)
    assert view.sent[-1] == "stop"
    assert not view.stop.isEnabled()
    assert "generator off first" in view.state.text()


def test_it_says_when_news_stop_and_when_it_is_over(view, qtbot, monkeypatch):
    monkeypatch.setattr("sessions.window.view.SILENCE", 20)
    view.show_snapshot(snapshot())
    qtbot.waitUntil(lambda: "no news" in view.messages.text(), timeout=2000)
    view.show_snapshot(snapshot(finished=True))
    assert view.state.text().startswith("finished")
    assert not view.stop.isEnabled()
    view.ended()
    assert not view.buttons["accept"].isEnabled()


def test_the_last_hit_is_written_large_and_a_rejected_one_is_heard_once(view, monkeypatch):
    heard = []
    monkeypatch.setattr("PySide6.QtWidgets.QApplication.beep", lambda: heard.append(1))
    view.show_snapshot(snapshot(0))
    assert not view.verdict.isVisible()
    view.show_snapshot(snapshot(1))
    assert view.verdict.text() == "hit 0 accepted, 80 N"
    assert heard == []
    for _ in range(2):
        view.show_snapshot(snapshot(2))
    assert view.verdict.text() == "hit 1 rejected, 81 N: double hit: 30 %"
    assert heard == [1]
    second = snapshot(2)
    view.show_snapshot(replace(second, hits=(second.hits[0], replace(second.hits[1], accepted=True))))
    assert view.verdict.text() == "hit 1 accepted, 81 N"
    assert heard == [1]


def test_what_is_excited_fills_the_plots_until_the_person_looks_elsewhere(view):
    view.show_snapshot(snapshot(band=(20.0, 300.0)))
    (low, high), _ = view.coherence.plot.viewRange()
    assert (low, high) == pytest.approx((20, 300), abs=30)
    view.magnitude.plot.setXRange(100, 110)
    view.show_snapshot(snapshot(band=(20.0, 300.0)))
    assert view.magnitude.plot.viewRange()[0] == pytest.approx([100, 110], abs=2)


def test_a_hundred_pictures(view, qtbot):
    for k in range(100):
        view.show_snapshot(snapshot(k % 5, curves=None if k % 7 == 0 else snapshot().curves))
        if k % 50 == 0:
            qtbot.wait(1)
    assert len(view.scope.curves) == 2


def test_a_snapshot_computes_its_spectrum_right():
    t = np.arange(4096) / 1024.0
    view = scope_view(CHANNELS[:1], 1024.0, 3 * np.cos(2 * np.pi * 100 * t)[None])
    density = view["spectrum"][0]
    power = np.sum(density**2) * (view["lines"][1] - view["lines"][0])
    assert power == pytest.approx(9 / 2, rel=1e-6)
    assert view["lines"][np.argmax(density)] == pytest.approx(100.0)


def rig_of(folder, hits, real_time="true"):
    return live_rig(folder, ("hits = 3", f"hits = {hits}"), ("real_time = true", f"real_time = {real_time}"))


@needs_qt
def test_a_real_window_lives_through_a_real_time_session(tmp_path):
    from sessions.window.link import Window

    with Window(stay=False) as window:
        outcome = measure(rig_of(tmp_path, 3), tmp_path / "out.h5", window)
        assert window.alive
    assert outcome.complete
    assert window.process.returncode == 0


@needs_qt
@pytest.mark.parametrize("shown", [True, False])
def test_the_end_is_told_with_its_reason_and_no_generator_stays_on_in_the_picture(tmp_path, view, shown, monkeypatch):
    from sessions.window.link import Window

    told = []
    with Window(stay=False) as window:
        if shown:
            window.show(snapshot(0, volts=0.4, level=1.9, target=2.0, level_unit="N", judged=False))
        monkeypatch.setattr(window, "show", told.append)
        window.end("channel 'a1' reached 9 m/s^2, over its stop limit 5 m/s^2", failed=True)
    view.show_snapshot(told[0])
    assert "finished: channel 'a1' reached 9" in view.state.text()
    assert "generator" not in view.level.text()
    assert not view.stop.isEnabled()


@needs_qt
def test_the_last_picture_arrives_however_soon_the_measurement_closes(monkeypatch):
    from sessions.window import link

    sent = []
    monkeypatch.setattr(link.Window, "_tell", lambda self, what: sent.append(what) or True)
    for _ in range(2):
        with link.Window(stay=False) as window:
            window.show(snapshot(0))
            window.end("the plan is complete")
            window.process.kill()  # nobody asks any more
        assert sent[-2].state == "the plan is complete"
        assert sent[-1] == link.CLOSE


class Listening(Display):
    """Hears how it ended."""

    def show(self, snapshot): ...

    def end(self, why, failed=False):
        self.ended = (why, failed)


def test_every_end_reaches_the_display(tmp_path):
    rig = rig_of(tmp_path, 2, "false")
    seen = Listening()
    measure(rig, tmp_path / "a.h5", seen)
    assert seen.ended == ("the plan is complete", False)
    with pytest.raises(LabnnumError):
        measure(rig_of(tmp_path, 3, "false"), tmp_path / "a.h5", seen)
    assert "begun with another rig.toml" in seen.ended[0]
    assert seen.ended[1]
    stopping = Listening()
    stopping.commands = lambda: ["stop"]
    measure(rig, tmp_path / "b.h5", stopping)
    assert stopping.ended == ("stopped by the user; the same command goes on from here", False)

    def interrupt():
        raise KeyboardInterrupt

    stopping.commands = interrupt
    with pytest.raises(KeyboardInterrupt):
        measure(rig, tmp_path / "c.h5", stopping)
    assert stopping.ended == ("interrupted; the same command goes on from here", False)


@needs_qt
def test_a_window_that_hangs_or_dies_loses_no_sample(tmp_path):
    from sessions.window.link import Window

    window = Window(stay=False)
    os.kill(window.process.pid, signal.SIGSTOP)
    try:
        outcome = measure(rig_of(tmp_path, 4), tmp_path / "out.h5", window)
    finally:
        os.kill(window.process.pid, signal.SIGKILL)
        window.close()
    assert outcome.complete
    with open_session(tmp_path / "out.h5") as session:
        run = session.runs[0]
        assert run.gaps() == ()
        blocks = run.blocks
    assert blocks["lost"].sum() == 0
    np.testing.assert_array_equal(blocks["start"], 256 * np.arange(len(blocks)))


@needs_qt
def test_stop_from_the_window_switches_off_at_once(tmp_path):
    from sessions.window.link import Window

    window = Window(stay=False)
    order = []
    window.urgent = lambda: order.append("off")
    window._hear("stop")
    order += window.commands()
    window.close()
    assert order == ["off", "stop"]


STAND_IN = """#!{python}
import sys
from multiprocessing.connection import Client
key = bytes.fromhex(sys.stdin.readline().strip())
with Client(sys.argv[-1], authkey=key) as line:
    line.send("ready")
    line.recv()
    for word in {words}:
        line.send(word)
"""
"""What takes the place of the window's process: it says these words once it was shown something, and is gone."""


@pytest.mark.skipif(os.name == "nt", reason="needs an executable script")
def test_a_stop_is_heard_though_switching_off_fails_and_so_is_what_comes_after_it(tmp_path, monkeypatch):
    from sessions.window import link

    script = tmp_path / "window"
    script.write_text(STAND_IN.format(python=sys.executable, words=["undo", "stop", "next", "stop"]))
    script.chmod(0o755)
    monkeypatch.setattr(link.sys, "executable", str(script))
    heard = []

    def failing():
        heard.append(window.commands())
        raise SafetyError("it did not confirm; its output may be on")

    with link.Window(stay=False) as window:
        window.urgent = failing
        window.show(snapshot(0))
        window._threads[1].join(60)
    assert heard == [["undo", "stop"], ["next", "stop"]]


def test_a_window_that_cannot_open_says_why(monkeypatch):
    from sessions.window import link

    monkeypatch.setattr(link.sys, "executable", "/bin/false")
    began = time.monotonic()
    with pytest.raises(LabnnumError, match="measure without --live"):
        link.Window()
    assert time.monotonic() - began < 20


@needs_qt
def test_a_person_who_waits_for_the_window_is_told(monkeypatch, capsys):
    from sessions.window import link

    monkeypatch.setattr(link, "PATIENCE", 0.0)
    with link.Window(stay=False):
        assert "still waiting" in capsys.readouterr().err
