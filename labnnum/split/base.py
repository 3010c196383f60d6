"""The split of what coherence lacks to one, line by line and band by band."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from labnnum.errors import EstimationError
from labnnum.recording import Channel

NOISE, DISTORTION, TRANSIENT = "noise", "nonlinear distortion", "transient"
LEAKAGE, BOTH = "leakage", "noise and nonlinear distortion"
SCATTER, ALL = "scatter between hits", "noise and scatter between hits"
ODD, EVEN = "odd distortion on detection lines", "even distortion on detection lines"
ENDS, RINGING = "ends of the record", "ringing on past the end"
"""Names of the parts."""

DRIVEN = 1e-3
"""Power of an input, of its largest, below which a line is left out: there is nothing to be coherent with."""

OCTAVES = 6
"""Bands of a table where none are given, at most: octaves down from the highest line."""

SURE = 4.0
"""Standard errors above which a mean share is more than chance."""


@dataclass(frozen=True)
class Share:
    """Mean share of a response's power in a band, and the standard error that noise alone makes of it.

    Shares are estimates without bias and may come out below zero where there is nothing.
    """

    value: float
    std: float

    @property
    def seen(self) -> bool:
        """Whether it is more than noise alone would make of it."""
        return bool(self.value > SURE * self.std)


@dataclass(frozen=True, eq=False)
class Split:
    """Shares of every response's power that its inputs do not explain, by what made them.

    Parameters
    ----------
    kind : str
        "periods", "record" or "hits".
    frequency : ndarray, shape (n_f,)
        Hz.
    outputs : tuple of Channel
    coherence : ndarray, shape (n_out, n_f)
        Ordinary (or multiple) coherence of all segments: periods, transient ones too; windowed segments; hits.
    parts : mapping of str to ndarray, shape (n_out, n_f)
        Shares of the power; on every line they add up to 1 - coherence. Each is estimated without bias, so that one
        that is nothing scatters about zero: means over a band are to be read, not single lines.
    beside : mapping of str to ndarray, shape (n_out, n_f)
        Shares that coherence does not see, since they repeat from segment to segment.
    chance : mapping of str to ndarray, shape (n_out, n_f)
        Standard deviation, line by line, that noise alone gives each of both.
    related : mapping of str to float
        Lines over which that of each is correlated; 1 where it is not told.
    common : mapping of str to ndarray, shape (n_out, n_f)
        Standard deviation that all lines of a part share beside that; 0 where it is not told.
    remarks : tuple of str
        What could not be told, and what would tell it.
    """

    kind: str
    frequency: NDArray[np.float64]
    outputs: tuple[Channel, ...]
    coherence: NDArray[np.float64]
    parts: Mapping[str, NDArray[np.float64]]
    beside: Mapping[str, NDArray[np.float64]]
    chance: Mapping[str, NDArray[np.float64]]
    related: Mapping[str, float] = field(default_factory=dict)
    common: Mapping[str, NDArray[np.float64]] = field(default_factory=dict)
    remarks: tuple[str, ...] = ()

    def shares(self, output: int, low: float, high: float) -> dict[str, Share]:
        """Mean share of every part, those beside coherence last, over the lines from `low` to `high` Hz; none if there
        is no line.
        """
        at = (self.frequency >= low) & (self.frequency <= high)
        if not at.any():
            return {}
        n, out = np.count_nonzero(at), {}
        for name, part in (*self.parts.items(), *self.beside.items()):
            some = min(max(self.related.get(name, 1.0), 1.0), n)
            spread = np.sqrt(some * np.sum(self.chance[name][output, at] ** 2)) / n
            shared = float(self.common[name][output, at].mean()) if name in self.common else 0.0
            out[name] = Share(float(part[output, at].mean()), float(np.hypot(spread, shared)))
        return out

    def lost(self, output: int, low: float, high: float) -> float:
        """Mean of 1 - coherence over the lines from `low` to `high` Hz; NaN if there is none."""
        at = (self.frequency >= low) & (self.frequency <= high)
        return float(np.mean(1 - self.coherence[output, at])) if at.any() else float("nan")

    def bands(self, given: Sequence[tuple[float, float]] = ()) -> list[tuple[float, float]]:
        """The bands of a table: those given that hold a line, else octaves down from the highest line."""
        if given:
            return [b for b in given if np.any((self.frequency >= b[0]) & (self.frequency <= b[1]))]
        edges = [float(self.frequency[-1])]
        while len(edges) < OCTAVES and edges[-1] / 2 > max(float(self.frequency[0]), 1e-300):
            edges.append(edges[-1] / 2)
        edges.append(float(self.frequency[0]))
        pairs = zip(edges[:0:-1], edges[-2::-1], strict=True)
        return [(a, b) for a, b in pairs if np.any((self.frequency >= a) & (self.frequency <= b))]

    def table(self, given: Sequence[tuple[float, float]] = ()) -> list[dict]:
        """A row for each response and band, ready for JSON: response, low, high, lost (mean of 1 - coherence), parts
        and beside, each share with its standard error.
        """
        rows = []
        for i, channel in enumerate(self.outputs):
            for low, high in self.bands(given):
                found = self.shares(i, low, high)
                told = {k: {"share": s.value, "std": s.std, "seen": s.seen} for k, s in found.items()}
                rows.append(
                    {
                        "response": channel.name,
                        "low": low,
                        "high": high,
                        "lost": self.lost(i, low, high),
                        "parts": {k: told[k] for k in self.parts},
                        "beside": {k: told[k] for k in self.beside},
                    }
                )
        return rows


def share_of(part: NDArray, power: NDArray) -> NDArray[np.float64]:
    """`part` over `power`; zero where there is no power."""
    return np.divide(part, power, out=np.zeros(np.broadcast(part, power).shape), where=power > 0)


def solved(u: NDArray, y: NDArray) -> NDArray[np.complex128]:
    """H (n_f, n_out, n_in) of least squares, y = H u, over segments: u (n_f, n_seg, n_in), y (n_f, n_seg, n_out)."""
    gram = np.einsum("fki,fkj->fij", u.conj(), u)
    right = np.einsum("fki,fko->fio", u.conj(), y)
    try:
        return np.linalg.solve(gram, right).transpose(0, 2, 1)
    except np.linalg.LinAlgError:
        raise EstimationError("inputs are silent or linearly dependent on a line: nothing can be told apart") from None


def left_of(u: NDArray, y: NDArray, h: NDArray) -> NDArray[np.complex128]:
    """What H leaves of the responses, (n_f, n_seg, n_out)."""
    return y - np.einsum("foi,fki->fko", h, u)
