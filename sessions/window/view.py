"""View: scope, spectrum, FRF, coherence, hits, lamps, progress and a stop, drawn from snapshots."""

from __future__ import annotations

from collections.abc import Callable
from typing import final

import numpy as np
import pyqtgraph as pg
from numpy.typing import NDArray
from PySide6 import QtCore, QtGui, QtWidgets

from sessions.snapshot import Curves, HitLine, Progress, Snapshot, around_pulse, turn_shown

COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00", "#7f7f7f", "#8c564b")
"""Told apart by most colour-blind people as well (Okabe and Ito)."""

GREEN, RED, GREY = "#1b7f3b", "#c62828", "#9e9e9e"
KEYS = {"A": "accept", "R": "reject", "U": "undo", "N": "next", "Space": "next", "Esc": "stop"}
SILENCE = 3000
"""ms without a snapshot after which the window says so."""
MARGIN = 62
"""Pixels beside every plot for its axis: plots below one another have their frequencies below one another."""
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
        self.setWindowTitle("labnnum")
        self.resize(_fitting(1500, 900, self.screen().availableSize()))
        pg.setConfigOptions(antialias=False, background="w", foreground="k")
        self.inputs = Traces("time", "s", "inputs")
        self.scope = Traces("time", "s", "responses")
        self.spectrum = Traces("frequency", "Hz", "spectrum", log=True)
        self.magnitude = Traces("frequency", "Hz", "|H|", log=True)
        self.phase = Traces("frequency", "Hz", "phase, degrees")
        self.coherence = Traces("frequency", "Hz", "coherence")
        self.hit = Traces("time", "s", "force of the last hit")
        self._settle_axes()
        self.state = QtWidgets.QLabel("waiting for the first samples")
        self.state.setStyleSheet("font-size: 17px; font-weight: bold;")
        self.state.setWordWrap(True)
        self.state.setMinimumHeight(48)
        self.level = QtWidgets.QLabel("")
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
        self.level.setText(_level(s))
        self.messages.setText("\n".join(s.messages))
        self.lamps.update_lamps(s.names, s.overload, s.lost, s.overflows)
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
        self._draw_frf(s.curves)
        over = s.finished
        self.stop.setEnabled(not over and self.stop.isEnabled())
        for word, button in self.buttons.items():
            button.setVisible(s.judged)
            button.setEnabled(not over and (bool(s.hits) or word == "next"))

    def _draw_hit(self, s: Snapshot, labels: list[str]) -> None:
        self.hit.plot.setVisible(s.hit is not None)
        if s.hit is not None:
            time = np.arange(s.hit.shape[1]) / s.rate
            self.hit.draw(time, s.hit[list(s.inputs)], [labels[i] for i in s.inputs])
            if len(s.hits) != self._closed_in and s.inputs:
                self._closed_in = len(s.hits)
                low, high = around_pulse(s.hit[s.inputs[0]])
                self.hit.plot.setXRange(low / s.rate, high / s.rate)

    def _draw_frf(self, c: Curves | None) -> None:
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
            self.state.setText("the measurement has ended")
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


@final
class Traces:
    """A plot with as many curves as it is given."""

    def __init__(self, label: str, unit: str, left: str, log: bool = False) -> None:
        self.plot = pg.PlotWidget()
        self._log = log
        self.curves: list[pg.PlotDataItem] = []
        item = self.plot.getPlotItem()
        assert item is not None
        self._item = item
        item.setLabel("bottom", f"{label}, {unit}")
        for axis in ("bottom", "left"):
            item.getAxis(axis).enableAutoSIPrefix(False)
        item.setLabel("left", left)
        item.getAxis("left").setWidth(MARGIN)
        item.setLogMode(y=log)
        item.showGrid(x=True, y=True, alpha=0.25)
        item.setDownsampling(auto=True, mode="peak")
        item.setClipToView(True)
        self._legend = item.addLegend(offset=(-6, 4), labelTextSize="8pt", brush=(255, 255, 255, 200))

    def draw(self, x: NDArray, rows: NDArray, names: list[str]) -> None:
        """One curve a row; what cannot be drawn on a logarithmic axis is left open."""
        if len(self.curves) != len(rows) or [c.name() for c in self.curves] != names:
            self._renew(names)
        for curve, row in zip(self.curves, rows, strict=True):
            shown = np.where(row > 0, row, np.nan) if self._log else row
            curve.setData(x, shown, connect="finite")

    def _renew(self, names: list[str]) -> None:
        for curve in self.curves:
            self._item.removeItem(curve)
        self._legend.clear()
        self.curves = [
            self._item.plot([], [], pen=pg.mkPen(COLOURS[i % len(COLOURS)], width=1), name=name)
            for i, name in enumerate(names)
        ]


@final
class Lamps(QtWidgets.QWidget):
    """One lamp a channel, red once it met the end of its range; and one for lost frames."""

    def __init__(self) -> None:
        super().__init__()
        self._grid = QtWidgets.QGridLayout(self)
        self._grid.setContentsMargins(0, 0, 0, 0)
        self.lamps: list[QtWidgets.QLabel] = []

    def update_lamps(self, names: tuple[str, ...], overload: tuple[bool, ...], lost: int, overflows: int) -> None:
        """Light them."""
        while len(self.lamps) < len(names) + 1:
            lamp = QtWidgets.QLabel()
            lamp.setAlignment(QtCore.Qt.AlignmentFlag.AlignCenter)
            self._grid.addWidget(lamp, len(self.lamps) // 4, len(self.lamps) % 4)
            self.lamps.append(lamp)
        for lamp, name, over in zip(self.lamps, names, [*overload, *[False] * len(names)], strict=False):
            _lamp(lamp, f"{name} OVER" if over else name, RED if over else GREEN)
        gaps = bool(lost or overflows)
        _lamp(
            self.lamps[len(names)], f"{lost} lost, {overflows} overflows" if gaps else "no gaps", RED if gaps else GREEN
        )


def _lamp(label: QtWidgets.QLabel, text: str, colour: str) -> None:
    if label.text() != text:
        label.setText(text)
        label.setStyleSheet(f"background: {colour}; color: white; border-radius: 4px; padding: 3px;")


@final
class Plan(QtWidgets.QTreeWidget):
    """The items of the plan, each with its bar; the current one is marked."""

    def __init__(self) -> None:
        super().__init__()
        self.setHeaderLabels(["plan", "done"])
        self.setRootIsDecorated(False)
        self.setFocusPolicy(QtCore.Qt.FocusPolicy.NoFocus)
        self.setColumnWidth(0, 220)
        self._bars: list[QtWidgets.QProgressBar] = []

    def update_items(self, items: tuple[Progress, ...]) -> None:
        """Bring bars and marks up to date."""
        while self.topLevelItemCount() < len(items):
            row, bar = QtWidgets.QTreeWidgetItem([""]), QtWidgets.QProgressBar()
            bar.setMaximumHeight(16)
            self.addTopLevelItem(row)
            self.setItemWidget(row, 1, bar)
            self._bars.append(bar)
        for number, (item, bar) in enumerate(zip(items, self._bars, strict=True)):
            row = self.topLevelItem(number)
            assert row is not None
            font = row.font(0)
            font.setBold(item.current)
            row.setFont(0, font)
            row.setText(0, f"▶ {item.key}" if item.current else item.key)
            bar.setMaximum(max(item.total, 1))
            bar.setValue(min(item.done, item.total))
            bar.setFormat(f"{item.done}/{item.total}" if item.total <= 100 else "%p%")


@final
class Hits(QtWidgets.QTableWidget):
    """Every hit with its verdict and reason; the last at the top."""

    def __init__(self) -> None:
        super().__init__(0, 4)
        self.setHorizontalHeaderLabels(["hit", "peak", "", "why"])
        self.verticalHeader().setVisible(False)
        header = self.horizontalHeader()
        header.setSectionResizeMode(3, QtWidgets.QHeaderView.ResizeMode.Stretch)
        for column, width in ((0, 36), (1, 64), (2, 76)):
            self.setColumnWidth(column, width)
        self.setWordWrap(True)
        self.setSelectionBehavior(QtWidgets.QAbstractItemView.SelectionBehavior.SelectRows)
        self.setSelectionMode(QtWidgets.QAbstractItemView.SelectionMode.SingleSelection)
        self.setEditTriggers(QtWidgets.QAbstractItemView.EditTrigger.NoEditTriggers)
        self.setFocusPolicy(QtCore.Qt.FocusPolicy.ClickFocus)
        self._shown: tuple[HitLine, ...] = ()
        self.setVisible(False)

    def update_hits(self, hits: tuple[HitLine, ...], unit: str = "") -> None:
        """Bring the table up to date."""
        if hits == self._shown:
            return
        self.setHorizontalHeaderLabels(["hit", f"peak, {unit}" if unit else "peak", "", "why"])
        grown = len(hits) != len(self._shown)
        self._shown = hits
        self.setVisible(bool(hits))
        self.setRowCount(len(hits))
        for row, hit in enumerate(reversed(hits)):
            word = "accepted" if hit.accepted else "rejected"
            for column, text in enumerate((str(hit.index), f"{hit.peak:.4g}", word, hit.reason)):
                cell = QtWidgets.QTableWidgetItem(text)
                if column == 2:
                    cell.setForeground(QtGui.QColor(GREEN if hit.accepted else RED))
                cell.setToolTip(hit.reason)
                self.setItem(row, column, cell)
        self.resizeRowsToContents()
        if grown:
            self.clearSelection()

    def chosen(self) -> int | None:
        """Number of the selected hit; None if none is."""
        rows = self.selectionModel().selectedRows() if self._shown else []
        return self._shown[len(self._shown) - 1 - rows[0].row()].index if rows else None
