"""A law behind a recorder's filter: the filter is fitted, taken off the runs, and the law sought once more."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Protocol

import numpy as np

from labnnum.diagnosis.nonlinear.above import FAR, Above, above
from labnnum.diagnosis.nonlinear.chain import FURTHER
from labnnum.diagnosis.nonlinear.decision import NonlinearAnswer
from labnnum.diagnosis.nonlinear.mended import Fault
from labnnum.diagnosis.nonlinear.predict import spectra
from labnnum.diagnosis.nonlinear.recorder import Recorder, fitted, harmonics, polished
from labnnum.diagnosis.nonlinear.run import Run
from labnnum.diagnosis.scatter import Scatter
from labnnum.diagnosis.verdict import Named


class Again(Protocol):
    """The search on runs from which a filter is taken off."""

    def __call__(self, fault: Fault, carried: NonlinearAnswer | None = None) -> NonlinearAnswer | None:
        """Laws sought anew, or those of another answer fitted on."""
        ...


def behind_recorder(
    found: NonlinearAnswer, runs: Sequence[Run], scatter: Scatter, again: Again, progress: Callable[[str], None]
) -> NonlinearAnswer:  # fmt: skip
    """The answer with the recorder's filter beside the laws; `found` itself where harmonics show none, or where it
    does not improve the prediction of runs held out.

    Parameters
    ----------
    found : NonlinearAnswer
        Of the runs as they were recorded.
    runs : sequence of Run
        Those fitted to, periodic.
    """
    usable = found.laws and found.laws[-1].simulated and all(r.lasting for r in runs)
    seen = harmonics(found.study, found.laws[-1], runs, scatter) if usable else None
    if seen is None or not seen.filtered:
        return found
    progress("fitting the recorder's filter")
    recorder = fitted(found.study, found.laws[-1], runs, scatter, seen)
    second = None if recorder is None else again(recorder.fault)
    if recorder is None or second is None or not second.laws or not (second.named or not found.named):
        return found
    progress("fitting the recorder's filter with these laws")
    last = polished(second.study, second.laws[-1], runs, scatter, recorder)
    better = None if last is None else again(last.fault, second)
    if last is not None and better is not None and better.extended_error[1] < second.extended_error[1]:
        recorder, second = last, better
    second = replace(second, recorder=recorder, named=(*second.named, told(recorder)) if second.named else ())
    if not foretells(second, found, found.held_out or runs):
        return found
    return replace(second, recorder=replace(recorder, shown=_harmonics_of_motion(second, recorder, runs)))


def _harmonics_of_motion(found: NonlinearAnswer, recorder: Recorder, runs: Sequence[Run]) -> Above | None:
    """Recorded harmonics over those of the motion before the filter."""
    made = []
    for run in runs:
        f = recorder.fault.factor(2j * np.pi * run.frequency, back=True)
        made.append(spectra(found, run) / np.where(f == 0, 1.0, f))
    return above(runs, made)


def foretells(second: NonlinearAnswer, found: NonlinearAnswer, held: Sequence[Run]) -> bool:
    """Whether the filter improves the prediction of runs held out, and explains their harmonics above the band."""
    if second.extended_error[1] > FURTHER * found.extended_error[1]:
        return False
    before, after = (above(held, [spectra(one, r) for r in held]) for one in (found, second))
    return before is not None and after is not None and after.plain < FAR * before.plain


def told(recorder: Recorder) -> Named:
    """The filter as a mechanism that is named."""
    return Named(recorder.fault.term, recorder.value, recorder.std, 0.95)
