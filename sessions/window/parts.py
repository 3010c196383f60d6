"""Parts of the live window: plots, lamps, the plan, the table of hits."""

from __future__ import annotations

from typing import final

import numpy as np
import pyqtgraph as pg
from numpy.typing import NDArray
from PySide6 import QtCore, QtGui, QtWidgets

from sessions.snapshot import HitLine, Progress, Snapshot

COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00", "#7f7f7f", "#8c564b")
"""Told apart by most colour-blind people as well (Okabe and Ito)."""

GREEN, RED, AMBER, GREY = "#1b7f3b", "#c62828", "#a65f00", "#9e9e9e"
MARGIN = 62
"""Pixels beside every plot for its axis: plots below one another have their frequencies below one another."""


@final
class Traces:
    """A plot with as many curves as it is given."""

    def __init__(self, label: str, unit: str, left: str, log: bool = False, legend: bool = True) -> None:
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
        self._legend = None
        if legend:
            self._legend = item.addLegend(offset=(-6, 4), labelTextSize="8pt", brush=(255, 255, 255, 200))

    def draw(self, x: NDArray, rows: NDArray, names: list[str]) -> None:
        """One curve a row; what cannot be drawn on a logarithmic axis is left open."""
        if len(self.curves) != len(rows) or [c.name() for c in self.curves] != names:
            self._renew(names)
        for curve, row in zip(self.curves, rows, strict=True):
            shown = np.where(row > 0, row, np.nan) if self._log else row
            curve.setData(x, shown, connect="finite")

    def show_between(self, low: float, high: float) -> None:
        """Bring these bounds of the horizontal axis to the edges."""
        self._item.getViewBox().setXRange(low, high, padding=0.02)

    def _renew(self, names: list[str]) -> None:
        for curve in self.curves:
            self._item.removeItem(curve)
        if self._legend is not None:
            self._legend.clear()
        self.curves = [
            self._item.plot([], [], pen=pg.mkPen(COLOURS[i % len(COLOURS)], width=1), name=name)
            for i, name in enumerate(names)
        ]


@final
class Lamps(QtWidgets.QWidget):
    """One lamp a channel, red while it meets the end of its range, amber once it did; and one for lost frames."""

    def __init__(self) -> None:
        super().__init__()
        self._grid = QtWidgets.QGridLayout(self)
        self._grid.setContentsMargins(0, 0, 0, 0)
        self.lamps: list[QtWidgets.QLabel] = []

    def update_lamps(self, s: Snapshot) -> None:
        """Light them."""
        names = s.names
        while len(self.lamps) < len(names) + 1:
            lamp = QtWidgets.QLabel()
            lamp.setAlignment(QtCore.Qt.AlignmentFlag.AlignCenter)
            self._grid.addWidget(lamp, len(self.lamps) // 4, len(self.lamps) % 4)
            self.lamps.append(lamp)
        for row, (lamp, name) in enumerate(zip(self.lamps, names, strict=False)):
            if s.over_now[row : row + 1] == (True,):
                _lamp(lamp, f"{name} OVER", RED)
            elif s.overload[row : row + 1] == (True,):
                _lamp(lamp, f"{name} was over", AMBER)
            else:
                _lamp(lamp, name, GREEN)
        gaps = bool(s.lost or s.overflows)
        said = f"{s.lost} lost, {s.overflows} overflows" if gaps else "no gaps"
        _lamp(self.lamps[len(names)], said, RED if gaps else GREEN)


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
