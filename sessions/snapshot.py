"""Snapshot: what the recorder and the estimator hold at one moment, ready to be drawn; nobody computes from it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labnnum.frf import Frf
from labnnum.recording import Channel
from labnnum.verdict import Verdict
from labnnum.windows import window

TURNS = (-180.0, -270.0, 0.0, -90.0)
"""Degrees at which a full turn may begin, best first."""

POINTS = 4096
"""Samples of the scope, and of the spectrum's segment, at most."""


@dataclass(frozen=True, slots=True)
class HitLine:
    """One hit as shown: its number, whether it counts, and why; the checks that it failed, in a word each."""

    index: int
    accepted: bool
    reason: str
    peak: float = float("nan")
    failed: tuple[str, ...] = ()

    def headline(self, unit: str) -> str:
        """What can be read from where the hammer is.

        Examples
        --------
        >>> HitLine(3, False, "double hit: a further pulse of 30 %", 81.26, ("double hit",)).headline("N")
        'hit 3 rejected, 81.3 N: double hit'
        """
        word = "accepted" if self.accepted else "rejected"
        why = "" if self.accepted else f": {'; '.join(self.failed) or self.reason}"
        return f"hit {self.index} {word}, {self.peak:.3g} {unit}".rstrip() + why


@dataclass(frozen=True, slots=True)
class Progress:
    """One item of the plan: how far it is."""

    key: str
    done: int
    total: int
    current: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Curves:
    """FRFs ready to draw: magnitude and phase (degrees), coherence, shapes (n_curves, n_f)."""

    frequency: NDArray[np.float64]
    magnitude: NDArray[np.float64]
    phase: NDArray[np.float64]
    coherence: NDArray[np.float64] | None
    names: tuple[str, ...]
    unit: str
    averages: float


@dataclass(frozen=True, slots=True, eq=False)
class Snapshot:
    """Everything that a display shows.

    Parameters
    ----------
    state : str
        What goes on, in words.
    names, units : tuple of str
        Of the channels.
    scope : ndarray, shape (n_channels, n)
        The last samples, SI units; their rate is `rate`.
    spectrum : ndarray, shape (n_channels, n_f)
        Amplitude density of the last samples, unit/sqrt(Hz), at `lines` in Hz.
    hit : ndarray or None, shape (n_channels, n)
        The last hit.
    inputs : tuple of int
        Rows that are forces or base motions.
    overload : tuple of bool
        Channels that met the end of their range in this run.
    over_now : tuple of bool
        Those of them that did within the last seconds.
    band : (low, high) or None
        Hz that are excited.
    judged : bool
        Hits are measured, which the person may accept, reject and undo.
    finished, failed : bool
        The measurement is over, and `state` says how; it ended otherwise than asked for.
    """

    state: str
    names: tuple[str, ...]
    units: tuple[str, ...]
    rate: float
    scope: NDArray[np.float64]
    lines: NDArray[np.float64]
    spectrum: NDArray[np.float64]
    curves: Curves | None = None
    inputs: tuple[int, ...] = ()
    hit: NDArray[np.float64] | None = None
    hits: tuple[HitLine, ...] = ()
    progress: tuple[Progress, ...] = ()
    overload: tuple[bool, ...] = ()
    over_now: tuple[bool, ...] = ()
    band: tuple[float, float] | None = None
    time: float = 0.0
    lost: int = 0
    overflows: int = 0
    volts: float = float("nan")
    level: float = float("nan")
    target: float = float("nan")
    level_unit: str = ""
    messages: tuple[str, ...] = ()
    waiting: bool = False
    judged: bool = False
    finished: bool = False
    failed: bool = False


def failed_checks(bad: Sequence[Verdict]) -> tuple[str, ...]:
    """Names of the checks that failed, each once; with its channels where there are several of the kind.

    Examples
    --------
    >>> one = Verdict("overload", False, 3.0, 0.0, "a2 is clipped", "a2")
    >>> failed_checks([one, Verdict("double hit", False, 0.3, 0.2, "double hit: ...", "force")])
    ('overload a2', 'double hit')
    """
    channels: dict[str, list[str]] = {}
    for verdict in bad:
        channels.setdefault(verdict.name, []).append(verdict.channel)
    shared = ("pulse", "double hit", "level", "reach")  # of the force alone
    return tuple(k if k in shared else f"{k} {', '.join(names)}".rstrip() for k, names in channels.items())


def curves(frf: Frf) -> Curves:
    """An FRF of one or several inputs as curves, one for each pair."""
    n_out, n_in, n_f = frf.value.shape
    value = frf.value.reshape(n_out * n_in, n_f)
    names = tuple(f"{o.name} / {i.name}" for o in frf.outputs for i in frf.inputs)
    coherence = None if frf.coherence is None else np.repeat(frf.coherence, n_in, axis=0)
    unit = f"{frf.outputs[0].unit} / {frf.inputs[0].unit}" if n_out and n_in else ""
    return Curves(frf.frequency, np.abs(value), phase_to_show(value), coherence, names, unit, float(frf.n_averages))


def phase_to_show(value: NDArray) -> NDArray[np.float64]:
    """Phase in degrees over that full turn, from -180, -270, 0 or -90 upwards, in which it jumps least.

    Examples
    --------
    >>> phase_to_show(np.exp(1j * np.radians([[179.0, -179.0, 178.0]]))).round(6).tolist()
    [[-181.0, -179.0, -182.0]]
    """
    phase = np.degrees(np.angle(value))
    shown = [(phase - start) % 360.0 + start for start in TURNS]
    jumps = [np.count_nonzero(np.abs(np.diff(one, axis=-1)) > 180.0) for one in shown]
    return shown[int(np.argmin(jumps))]


def turn_shown(phase: NDArray) -> float:
    """Where the full turn begins that holds these phases, in degrees: the first of `TURNS` that does.

    Examples
    --------
    >>> turn_shown(np.array([10.0, 170.0])), turn_shown(np.array([2.0, 355.0])), turn_shown(np.array([-260.0, 80.0]))
    (-180.0, 0.0, -270.0)
    """
    low, high = float(np.nanmin(phase)), float(np.nanmax(phase))
    return next((start for start in TURNS if start <= low and high <= start + 360.0), 90.0 * float(np.floor(low / 90)))


def around_pulse(force: NDArray) -> tuple[int, int]:
    """Samples from shortly before the largest pulse to where a second one would have come: thirty widths later.

    Examples
    --------
    >>> x = np.zeros(1000); x[100:104] = [1, 4, 4, 1]
    >>> around_pulse(x)
    (69, 229)
    """
    size = np.abs(force - np.median(force))
    at = int(np.argmax(size))
    width = max(int(np.count_nonzero(size[max(at - 2000, 0) : at + 2000] > 0.1 * size[at])), 4)
    return max(at - 8 * width, 0), min(at + 32 * width, force.size)


def spectrum(scope: NDArray, rate: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Lines in Hz and amplitude densities, unit/sqrt(Hz), of the last samples through a Hann window."""
    n = scope.shape[1]
    if n < 16:
        return np.zeros(0), np.zeros((scope.shape[0], 0))
    shape = window("hann", n)
    x = np.fft.rfft((scope - scope.mean(axis=1, keepdims=True)) * shape, axis=1)
    return np.asarray(np.fft.rfftfreq(n, 1 / rate), float), np.asarray(
        np.abs(x) * np.sqrt(2 / (rate * np.sum(shape**2))), float
    )


def scope_view(channels: tuple[Channel, ...], rate: float, latest: NDArray) -> dict[str, Any]:
    """The part of a snapshot that comes from the last samples."""
    lines, density = spectrum(latest, rate)
    return {
        "names": tuple(c.name for c in channels),
        "units": tuple(c.unit for c in channels),
        "inputs": tuple(i for i, c in enumerate(channels) if c.role in ("reference", "base")),
        "rate": rate,
        "scope": latest,
        "lines": lines,
        "spectrum": density,
    }
