"""Runs pooled into one FRF: each without what its own inputs did to it, and what of each was used."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labnnum.calibration import InputResponse
from labnnum.errors import EstimationError
from labnnum.frf import Frf
from labnnum.recording import Recording
from labnnum.spectra import Processor, Spectra, pool
from sessions.runs import Run

Inputs = Mapping[str, InputResponse]
"""Channel name -> what its input does to its signal."""


def inputs_of(run: Run) -> dict[str, InputResponse]:
    """What was known of the run's inputs when it was recorded."""
    return {name: InputResponse(**told) for name, told in run.info.get("inputs", {}).items()}


def alike(recordings: Sequence[Recording], inputs: Sequence[Inputs]) -> list[tuple[Inputs, list[Recording]]]:
    """Recordings by what their inputs did, in the order in which each first came."""
    out: list[tuple[Inputs, list[Recording]]] = []
    for recording, told in zip(recordings, inputs, strict=True):
        same = next((held for known, held in out if known == told), None)
        if same is None:
            out.append((told, [recording]))
        else:
            same.append(recording)
    return out


@dataclass(frozen=True)
class Uncoloured:
    """Spectra of recordings whose inputs did unlike things to them: divided out before they are averaged.

    Parameters
    ----------
    processor : Processor
        What turns recordings into spectra.
    inputs : sequence of Inputs
        Of each recording, in order.
    """

    processor: Processor
    inputs: tuple[Inputs, ...]

    def __call__(self, recordings: Recording | Sequence[Recording]) -> Spectra:
        """Spectra averaged over all recordings; the line at 0 Hz is left out where a high-pass took it."""
        batch = pool(recordings)
        lowest = any(r.highpass for inputs in self.inputs for r in inputs.values())
        parts = [_divided(self.processor(held), told, lowest) for told, held in alike(batch, self.inputs)]
        return _merged(parts, batch[0].label)


def _divided(spectra: Spectra, inputs: Inputs, without_zero: bool) -> Spectra:
    """Spectra of the signals before their inputs."""
    first = 1 if without_zero and spectra.frequency[0] == 0 else 0
    frequency = spectra.frequency[first:]
    factor = np.array([inputs.get(c.name, InputResponse()).at(frequency) for c in spectra.channels])
    cross = spectra.cross[..., first:] / (factor.conj()[:, None] * factor[None])
    return replace(spectra, frequency=frequency, cross=cross)


def _merged(parts: Sequence[Spectra], label: str) -> Spectra:
    """Spectra over all segments of the parts; of the settings what is true of all."""
    first = parts[0]
    if any(p.frequency.size != first.frequency.size for p in parts):
        raise EstimationError(f"{label}: its hits are not as long as those of other runs; choose a segment for all")
    settings = {k: v for k, v in first.settings.items() if all(p.settings.get(k) == v for p in parts)}
    if settings.get("transient"):
        settings["pretrigger"] = min(int(p.settings["pretrigger"]) for p in parts)
    count = sum(p.n_segments for p in parts)
    cross = np.sum([p.cross * (p.n_segments / count) for p in parts], axis=0)
    averages = float(sum(p.n_averages for p in parts))
    return Spectra(first.frequency, cross, first.channels, averages, count, settings)


def averaged(frfs: Sequence[Frf], by_variance: bool = False) -> Frf:
    """Mean of FRFs of the same channels, on every line that one of them has.

    Parameters
    ----------
    frfs : sequence of Frf
    by_variance : bool
        Weighs each value by its inverse variance, where that is known well; else by its FRF's averages.

    Returns
    -------
    Frf
        With the variance of that mean; None where one is not known. Spectra of the inputs are left out; of the
        settings what is true of all stays.
    """
    first = frfs[0]
    if len(frfs) == 1:
        return first
    lines = np.unique(np.concatenate([f.frequency for f in frfs]))
    whole, value = (
        np.zeros((*first.value.shape[:2], lines.size)),
        np.zeros((*first.value.shape[:2], lines.size), complex),
    )
    spread = np.zeros(whole.shape)
    known = all(f.variance is not None for f in frfs)
    for f in frfs:
        at = np.searchsorted(lines, f.frequency)
        variance = np.ones(f.value.shape) if f.variance is None else f.variance
        weight = _weights(f, variance, by_variance and known)
        whole[..., at] += weight
        value[..., at] += weight * f.value
        spread[..., at] += weight**2 * variance
    value, spread = value / whole, spread / whole**2
    averages = float(sum(f.n_averages for f in frfs))
    coherence = _coherence(value, spread, averages) if known and first.coherence is not None else None
    settings = {k: v for k, v in first.settings.items() if all(f.settings.get(k) == v for f in frfs)}
    settings["n_realisations"] = sum(f.settings.get("n_realisations", 1) for f in frfs)
    return replace(
        first, settings=settings, frequency=lines, value=value, coherence=coherence, variance=spread if known else None,
        n_averages=averages, input_spectrum=None, input_condition=None, shared=None,
    )  # fmt: skip


def _weights(frf: Frf, variance: NDArray, by_variance: bool) -> NDArray[np.float64]:
    if by_variance:
        return 1 / np.maximum(variance, 1e-24 * np.abs(frf.value) ** 2 + 1e-300)
    return np.full(frf.value.shape, frf.n_averages if np.isfinite(frf.n_averages) else 1.0)


def _coherence(value: NDArray, variance: NDArray, averages: float) -> NDArray[np.float64]:
    """Coherence at which so many averages have this variance, the worst over inputs, shape (n_out, n_f)."""
    size = np.abs(value) ** 2
    return np.min(size / np.maximum(size + averages * variance, 1e-300), axis=1)


@dataclass(frozen=True)
class Used:
    """What of some runs an FRF rests on.

    Parameters
    ----------
    basis : mapping
        Number of each run -> its hits that were used; runs without hits are not named.
    left_out : mapping
        Number of a run -> its accepted hits that were not used, as they touch an overload.
    overloaded : float
        s that were left out because of overloads.
    unplaced : float
        s of bursts that begin nobody knows where, after an overflow.
    """

    basis: dict[str, list[int]]
    left_out: dict[str, list[int]] = field(default_factory=dict)
    overloaded: float = 0.0
    unplaced: float = 0.0

    @property
    def settings(self) -> dict[str, Any]:
        """What an FRF keeps of it."""
        found: dict[str, Any] = {"overloaded_seconds": self.overloaded, "hits_left_out": self.left_out}
        return {"basis": self.basis, **{k: v for k, v in found.items() if v}}

    @property
    def remarks(self) -> list[str]:
        """What a person should know of it."""
        out = []
        if self.left_out:
            kept = sum(len(hits) for hits in self.basis.values())
            count = kept + sum(len(hits) for hits in self.left_out.values())
            out.append(f"{kept} of {count} accepted hits are used: an overload touches {left_out_hits(self.left_out)}")
        elif self.overloaded:
            out.append(f"{self.overloaded:.4g} s with overloads are left out")
        if self.unplaced:
            out.append(
                f"{self.unplaced:.4g} s after an overflow are left out: it is not known where bursts begin there"
            )
        return out


def left_out_hits(found: Mapping[str, Sequence[int]]) -> str:
    """Hits by run, in words.

    Examples
    --------
    >>> left_out_hits({"1": [0, 2], "4": [1]})
    'hits 0, 2 of run 1, hit 1 of run 4'
    """
    return ", ".join(
        f"hit{'s' if len(hits) > 1 else ''} {', '.join(map(str, hits))} of run {run}" for run, hits in found.items()
    )


def used_of(runs: Sequence[Run], before: Sequence[Recording], after: Sequence[Recording]) -> Used:
    """What is used of the runs whose recordings `before` became `after` when overloads were taken out."""
    basis, left_out, unplaced = {}, {}, 0.0
    for run, recording in zip(runs, after, strict=True):
        spans, accepted = list(recording.spans()), [h for h in run.hits if h.accepted]
        used = [h.index for h in accepted if any(a < h.stop and b > h.start for a, b in spans)]
        lost = [h.index for h in accepted if h.index not in used]
        basis |= {str(run.index): used} if run.hits else {}
        left_out |= {str(run.index): lost} if lost else {}
        unplaced += _unplaced(recording, spans)
    overloaded = sum((_used(a) - _used(b)) / a.rate for a, b in zip(before, after, strict=True))
    return Used(basis, left_out, overloaded, unplaced)


def _unplaced(recording: Recording, spans: Sequence[tuple[int, int]]) -> float:
    """Seconds behind the last burst whose place is known."""
    if not recording.burst or not spans:
        return 0.0
    end = recording.bursts[-1] + recording.burst if recording.bursts else spans[0][0]
    behind = sum(b - max(a, end) for a, b in spans if b > end)
    return behind / recording.rate if behind >= recording.burst else 0.0


def _used(recording: Recording) -> int:
    return sum(stop - start for start, stop in recording.spans())
