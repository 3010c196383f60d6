"""Observations with the faults of channels taken off, or put back: spectra, FRFs and samples alike."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from labnnum.diagnosis.nonlinear.run import Run
from labnnum.diagnosis.observe import Observation
from labnnum.frf import Frf
from labnnum.mechanisms.base import ChannelMechanism, Term
from labnnum.recording import Recording

LOST = 0.02
"""Gain of a faulty channel below which what it let through cannot be brought back, and counts as nothing."""
ALL = 2j * np.pi * np.logspace(-1, 6, 57)
"""Lines s at which a channel may let something through, whatever the band."""


@dataclass(frozen=True, eq=False)
class Fault:
    """What is wrong with a channel: the term of the mechanism, and its parameters."""

    term: Term
    value: NDArray[np.float64]

    def factor(self, s: NDArray, back: bool = False) -> NDArray[np.complex128]:
        """What the channel's spectrum is multiplied by to take the fault off; to put it on with `back`."""
        assert isinstance(self.term.mechanism, ChannelMechanism)
        f = self.term.mechanism.factor(np.where(s == 0, s[min(1, s.size - 1)], s), self.value)
        return f if back else np.where(np.abs(f) < LOST, 0.0, 1.0 / np.where(f == 0, 1.0, f))

    @property
    def lost(self) -> bool:
        """Whether the channel lets nothing through at any frequency, so that taking the fault off leaves no channel."""
        return self.changes and not np.any(self.factor(ALL))

    @property
    def changes(self) -> bool:
        """Whether it changes a spectrum; else channels have changed places or sign."""
        return isinstance(self.term.mechanism, ChannelMechanism) and ("channel" in self.term.data or self.common)

    @property
    def common(self) -> bool:
        """Whether it is on all channels alike."""
        return isinstance(self.term.mechanism, ChannelMechanism) and self.term.mechanism.common


def faults_of(terms: Sequence[Term], values: NDArray) -> list[Fault]:
    """Those of a fit's terms that are faults of channels, their parameters cut from the fit's."""
    out, at = [], 0
    for t in terms:
        if t.mechanism.domain == "channel" and (t.data.keys() & {"swap", "invert", "channel"}):
            out.append(Fault(t, np.asarray(values[at : at + t.n], float)))
        at += t.n
    return out


def mended(o: Observation, faults: Sequence[Fault], back: bool = False) -> Observation:
    """The observation with the faults taken off, the last first; with them put back, where `back` is set."""
    for fault in faults if back else reversed(faults):
        o = _one(o, fault, back)
    return o


def _one(o: Observation, fault: Fault, back: bool) -> Observation:
    outputs = [c.name for c in o.frf.outputs]
    names = [*outputs, *(c.name for c in o.frf.inputs)]
    recordings = tuple(_samples(r, names, fault, back) for r in o.recordings)
    return replace(o, run=_run(o, fault, back), frf=_frf(o.frf, fault, back), recordings=recordings)


def _rows(n: int, fault: Fault) -> list[int]:
    """Order of the responses' rows with two of them exchanged."""
    order = list(range(n))
    a, b = fault.term.data["swap"]
    order[a], order[b] = b, a
    return order


def filtered_run(run: Run, fault: Fault, back: bool = False) -> Run:
    """The run with a fault that is common to all channels taken off, or put on with `back`."""
    f = fault.factor(run.decay + 2j * np.pi * run.frequency, back)
    return replace(run, u=run.u * f, y=run.y * f, noise=run.noise * np.abs(f) ** 2)


def _run(o: Observation, fault: Fault, back: bool):
    run = o.run
    if run is None:
        return None
    if fault.common:
        return filtered_run(run, fault, back)
    u, y, noise, n_out = run.u.copy(), run.y.copy(), run.noise.copy(), len(run.outputs)
    data = fault.term.data
    if "swap" in data:
        order = _rows(n_out, fault)
        return replace(run, y=y[order], noise=noise[order])
    if "invert" in data:
        i = data["invert"]
        return replace(run, u=-u) if i >= n_out else replace(run, y=_signed(y, i))
    if not fault.changes:
        return run
    f = fault.factor(run.decay + 2j * np.pi * run.frequency, back)
    i = data["channel"]
    if i >= n_out:
        return replace(run, u=u * f)
    y[i], noise[i] = y[i] * f, noise[i] * np.abs(f) ** 2
    return replace(run, y=y, noise=noise)


def _frf(frf: Frf, fault: Fault, back: bool) -> Frf:
    h, n_out = frf.value.copy(), len(frf.outputs)
    variance = None if frf.variance is None else frf.variance.copy()
    data = fault.term.data
    if fault.common:
        return frf
    if "swap" in data:
        order = _rows(n_out, fault)
        shared = None if frf.shared is None else frf.shared[order]
        return replace(frf, value=h[order], variance=None if variance is None else variance[order], shared=shared)
    if "invert" in data:
        i = data["invert"]
        return replace(frf, value=-h) if i >= n_out else replace(frf, value=_signed(h, i))
    if not fault.changes:
        return frf
    f = fault.factor(2j * np.pi * frf.frequency, back)
    i = data["channel"]
    if i < n_out:
        h[i] *= f
        if variance is not None:
            variance[i] *= np.abs(f) ** 2
    else:
        through = np.where(f == 0, 0.0, 1.0 / np.where(f == 0, 1.0, f))
        h[:, i - n_out] *= through
        if variance is not None:
            variance[:, i - n_out] *= np.abs(through) ** 2
    return replace(frf, value=h, variance=variance)


def _signed(rows: NDArray, i: int) -> NDArray:
    out = rows.copy()
    out[i] = -out[i]
    return out


def _samples(r: Recording, names: Sequence[str], fault: Fault, back: bool) -> Recording:
    """The recording, whose channels may stand in another order than those of the FRFs."""
    at = {c.name: i for i, c in enumerate(r.channels)}
    x = r.data.copy()
    data = fault.term.data
    if "swap" in data:
        a, b = (at[names[int(i)]] for i in data["swap"])
        x[[a, b]] = x[[b, a]]
    elif "invert" in data:
        x[at[names[int(data["invert"])]]] *= -1
    elif fault.changes:
        i = slice(None) if fault.common else at[names[int(data["channel"])]]
        s = 2j * np.pi * np.fft.rfftfreq(x.shape[1], 1 / r.rate)
        x[i] = np.fft.irfft(np.fft.rfft(x[i], axis=-1) * fault.factor(s, back), x.shape[1], axis=-1)
    return replace(r, data=x)
