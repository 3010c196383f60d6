"""View: scope, spectrum, FRF, coherence, hits, lamps, progress and a stop, drawn from snapshots."""

from __future__ import annotations

from collections.abc import Callable
from typing import final

import numpy as np
import pyqtgraph as pg
from PySide6 import QtCore, QtGui, QtWidgets

from sessions.snapshot import Curves, HitLine, Snapshot, around_pulse, turn_shown
from sessions.window.parts import GREEN, GREY, RED, Hits, Lamps, Plan, Traces

KEYS = {"A": "accept", "R": "reject", "U": "undo", "N": "next", "Space": "next", "Esc": "stop"}
STATE = "font-size: 20px; font-weight: bold;"
SILENCE = 3000
"""ms without a snapshot after which the window says so."""
TITLE = 40
"""Pixels that a window's title bar and frame take at most."""


@final
class View(QtWidgets.QMainWindow):
    """The live window.

    Parameters
    ----------
    send : callable
        Takes the person's commands.
    """

    def __init__(self, send: Callable[[str], None]) -> None:
        super().__init__()
        self._send = send
        self.snapshot: Snapshot | None = None
        self._closed_in = 0
        self._judged: HitLine | None = None
        self._band: tuple[float, float] | None = None
        self.setWindowTitle("labnnum")
        self.resize(_fitting(1500, 900, self.screen().availableSize()))
        pg.setConfigOptions(antialias=False, background="w", foreground="k")
        self.inputs = Traces("time", "s", "inputs")
        self.scope = Traces("time", "s", "responses")
        self.spectrum = Traces("frequency", "Hz", "spectrum", log=True)
        self.magnitude = Traces("frequency", "Hz", "|H|", log=True)
        self.phase = Traces("frequency", "Hz", "phase, degrees", legend=False)
        self.coherence = Traces("frequency", "Hz", "coherence", legend=False)
        self.hit = Traces("time", "s", "force of the last hit")
        self._settle_axes()
        self.state = QtWidgets.QLabel("waiting for the first samples")
        self.state.setStyleSheet(STATE)
        self.state.setWordWrap(True)
        self.state.setMinimumHeight(56)
        self.verdict = QtWidgets.QLabel("")
        self.verdict.setWordWrap(True)
        self.verdict.setVisible(False)
        self.level = QtWidgets.QLabel("")
        self.level.setStyleSheet("font-size: 15px;")
        self.level.setWordWrap(True)
        self.messages = QtWidgets.QLabel("")
        self.messages.setWordWrap(True)
        self.messages.setStyleSheet("color: #8a5a00;")
        self.lamps = Lamps()
        self.progress = Plan()
        self.hits = Hits()
        self.buttons = {word: self._button(word) for word in ("accept", "reject", "undo", "next")}
        self.stop = self._stop_button()
        self._lay_out()
        for key, word in KEYS.items():
            shortcut = QtGui.QShortcut(QtGui.QKeySequence(key), self)
            shortcut.activated.connect(lambda word=word: self.command(word))
        self._silence = QtCore.QTimer(self)
        self._silence.setSingleShot(True)
        self._silence.timeout.connect(self._silent)

    def _settle_axes(self) -> None:
        self.phase.plot.setYRange(-185, 185)
        self.coherence.plot.setYRange(0, 1.02)
        self.phase.plot.setXLink(self.magnitude.plot)
        self.coherence.plot.setXLink(self.magnitude.plot)
        self.magnitude.plot.setAutoVisible(y=True)  # what is excited sets the scale, not the noise beside it

    def _button(self, word: str) -> QtWidgets.QPushButton:
        keys = "/".join(k for k, w in KEYS.items() if w == word)
        button = QtWidgets.QPushButton(f"{word.capitalize()}  ({keys})")
        button.setFocusPolicy(QtCore.Qt.FocusPolicy.NoFocus)
        button.clicked.connect(lambda: self.command(word))
        return button

    def _stop_button(self) -> QtWidgets.QPushButton:
        button = QtWidgets.QPushButton("STOP  (Esc)")
        button.setFocusPolicy(QtCore.Qt.FocusPolicy.NoFocus)
        button.setMinimumHeight(64)
        button.setStyleSheet(
            f"QPushButton {{ background: {RED}; color: white; font-size: 22px; font-weight: bold;"
            " border-radius: 6px; }"
            f" QPushButton:disabled {{ background: {GREY}; }}"
        )
        button.clicked.connect(lambda: self.command("stop"))
        return button

    def _lay_out(self) -> None:
        left, middle = QtWidgets.QSplitter(), QtWidgets.QSplitter()
        for splitter, parts in (
            (left, (self.inputs, self.scope, self.spectrum, self.hit)),
            (middle, (self.magnitude, self.phase, self.coherence)),
        ):
            splitter.setOrientation(QtCore.Qt.Orientation.Vertical)
            for part in parts:
                splitter.addWidget(part.plot)
        middle.setSizes([500, 250, 200])
        side = QtWidgets.QWidget()
        column = QtWidgets.QVBoxLayout(side)
        row = QtWidgets.QGridLayout()
        for number, button in enumerate(self.buttons.values()):
            row.addWidget(button, number // 2, number % 2)
        column.addWidget(self.state)
        column.addWidget(self.verdict)
        column.addWidget(self.level)
        column.addWidget(self.lamps)
        column.addWidget(self.progress, 2)
        column.addWidget(self.hits, 3)
        column.addLayout(row)
        column.addWidget(self.messages)
        column.addWidget(self.stop)
        whole = QtWidgets.QSplitter()
        for part in (left, middle, side):
            whole.addWidget(part)
        whole.setSizes([480, 620, 400])
        self.setCentralWidget(whole)

    def command(self, word: str) -> None:
        """Send what the person asked for; accept and reject mean the hit that is selected, else the last."""
        if word in ("accept", "reject"):
            number = self.hits.chosen()
            word = word if number is None else f"{word} {number}"
        if word == "stop":
            self.stop.setEnabled(False)
            self.state.setText("stopping: generator off first")
        self._send(word)

    def show_snapshot(self, s: Snapshot) -> None:
        """Draw a snapshot."""
        self.snapshot = s
        self._silence.start(SILENCE)
        self.state.setText(s.state if not s.finished else f"finished: {s.state}")
        self.state.setStyleSheet(f"{STATE} color: {RED};" if s.failed else STATE)
        self._show_verdict(s)
        self.level.setText(_level(s))
        self.messages.setText("\n".join(s.messages))
        self.lamps.update_lamps(s)
        self.progress.update_items(s.progress)
        self.hits.update_hits(s.hits, s.units[s.inputs[0]] if s.inputs else "")
        labels = [f"{name}, {unit}" for name, unit in zip(s.names, s.units, strict=True)]
        time = np.arange(s.scope.shape[1]) / s.rate
        others = [i for i in range(len(s.names)) if i not in s.inputs]
        self.inputs.draw(time, s.scope[list(s.inputs)], [labels[i] for i in s.inputs])
        self.scope.draw(time, s.scope[others], [labels[i] for i in others])
        self.spectrum.draw(
            s.lines, s.spectrum, [f"{name}, {unit}/√Hz" for name, unit in zip(s.names, s.units, strict=True)]
        )
        self._draw_hit(s, labels)
        self._draw_frf(s.curves, s.band)
        over = s.finished
        if over:
            self._silence.stop()
        self.stop.setEnabled(not over and self.stop.isEnabled())
        for word, button in self.buttons.items():
            button.setVisible(s.judged)
            button.setEnabled(not over and (bool(s.hits) or word == "next"))

    def _show_verdict(self, s: Snapshot) -> None:
        """The last hit in letters that are read from where the hammer is; a rejected one is heard as well."""
        last = s.hits[-1] if s.hits and s.judged else None
        if last == self._judged:
            return
        new = last is not None and (self._judged is None or last.index != self._judged.index)
        self._judged = last
        self.verdict.setVisible(last is not None)
        if last is not None:
            self.verdict.setText(last.headline(s.units[s.inputs[0]] if s.inputs else ""))
            colour = GREEN if last.accepted else RED
            self.verdict.setStyleSheet(
                f"background: {colour}; color: white; font-size: 24px; font-weight: bold; padding: 8px;"
                " border-radius: 6px;"
            )
            if new and not last.accepted:
                QtWidgets.QApplication.beep()

    def _draw_hit(self, s: Snapshot, labels: list[str]) -> None:
        self.hit.plot.setVisible(s.hit is not None)
        if s.hit is not None:
            time = np.arange(s.hit.shape[1]) / s.rate
            self.hit.draw(time, s.hit[list(s.inputs)], [labels[i] for i in s.inputs])
            if len(s.hits) != self._closed_in and s.inputs:
                self._closed_in = len(s.hits)
                low, high = around_pulse(s.hit[s.inputs[0]])
                self.hit.show_between(low / s.rate, high / s.rate)

    def _draw_frf(self, c: Curves | None, band: tuple[float, float] | None = None) -> None:
        if band is not None and band != self._band:  # once: after that the person may look elsewhere
            self._band = band
            self.magnitude.show_between(*band)
        if c is None:
            self.magnitude.plot.setTitle("no average yet")
            for part in (self.magnitude, self.phase, self.coherence):
                part.draw(np.zeros(0), np.zeros((0, 0)), [])
            return
        names = list(c.names)
        self.magnitude.plot.setTitle(f"{c.averages:.3g} average{'s' * (c.averages != 1)}")
        self.magnitude.draw(c.frequency, c.magnitude, [f"{n}, {c.unit}" for n in names])
        self.phase.draw(c.frequency, c.phase, names)
        if c.phase.size:
            low = turn_shown(c.phase)
            self.phase.plot.setYRange(low - 5, low + 365)
        if c.coherence is not None:
            self.coherence.draw(c.frequency, c.coherence, names)

    def _silent(self) -> None:
        if self.snapshot is not None and not self.snapshot.finished:
            self.messages.setText("no news from the measurement for 3 s; it goes on by itself")

    def ended(self) -> None:
        """The measuring process is gone."""
        self._silence.stop()
        if self.snapshot is None or not self.snapshot.finished:
            self.state.setText("the measurement has ended; the terminal says how")
            self.level.setText("")
            self.messages.setText("")
        self.stop.setEnabled(False)
        for button in self.buttons.values():
            button.setEnabled(False)


def _level(s: Snapshot) -> str:
    parts = [f"{s.time:.1f} s"]
    if not np.isnan(s.target):
        parts.append(f"level {s.level:.4g} of {s.target:g} {s.level_unit} RMS, generator {s.volts:.3g} V RMS")
    return "   ".join(parts)


def _fitting(width: int, height: int, screen: QtCore.QSize) -> QtCore.QSize:
    """A window of that size, or as much of it as the screen has room for under a title bar: stop must be in reach."""
    return QtCore.QSize(min(width, screen.width()), min(height, screen.height() - TITLE))
