"""Responses of a diagnosed nonlinear model to any recorded input."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from labnnum.diagnosis.nonlinear.decision import NonlinearAnswer
from labnnum.diagnosis.nonlinear.lines import Lines
from labnnum.diagnosis.nonlinear.mended import filtered_run
from labnnum.diagnosis.nonlinear.problem import Joint
from labnnum.diagnosis.nonlinear.run import Run
from labnnum.diagnosis.scatter import Scatter
from labnnum.recording import Recording


def padded(recording: Recording, top: float, rest: float = 0.02) -> Run:
    """A record that is not periodic, as a period that ends at rest.

    Zeros follow the record, `rest` of its length: long enough for the structure to come to rest, so that the
    response repeats. Lines up to `top` Hz count as excited.
    """
    from scipy.fft import next_fast_len

    n = 2 * int(next_fast_len(int(np.ceil(recording.n_samples * (1 + rest) / 2)), real=True) or 0)
    data = np.zeros((len(recording.channels), n))
    data[:, : recording.n_samples] = recording.data
    spectra = np.fft.rfft(data, axis=1) * (2 / n)
    lines = np.arange(n // 2 + 1) * recording.rate / n
    on = (lines > 0) & (lines <= top)
    inputs, outputs = recording.inputs, list(recording.outputs)
    u = spectra[inputs[0]]
    return Run(
        recording.rate, n, u, spectra[outputs], np.zeros((len(outputs), lines.size)), on,
        float(np.sqrt(np.sum(np.abs(u) ** 2) / 2)), recording.label, tuple(recording.channels[i] for i in outputs),
        recording.channels[inputs[0]], 1,
    )  # fmt: skip


def response(found: NonlinearAnswer, run: Run, *, linear: bool = False, steps: int = 15) -> NDArray[np.float64]:
    """Responses (n_out, n) over the period of `run`, in each channel's unit.

    Parameters
    ----------
    linear : bool
        Of the base model alone.
    steps : int
        Newton steps at most; a steady state that does not close is what they end at.
    """
    spectrum = spectra(found, run, linear=linear, steps=steps)
    return np.fft.irfft(spectrum * (run.period / 2), run.period, axis=1)


def spectra(found: NonlinearAnswer, run: Run, *, linear: bool = False, steps: int = 15) -> NDArray[np.complex128]:
    """The same as spectra (n_out, n_lines). Where the recorder's filter was found, the run is as it was recorded, and
    so are these.
    """
    study = found.study
    x = found.base_x if linear else found.laws[-1].made.x
    recorder = None if found.recorder is None else found.recorder.fault
    acting = run if recorder is None else filtered_run(run, recorder)
    at = np.flatnonzero(run.excited)[:2]
    lines = Lines(at, np.ones((run.y.shape[0], at.size)))
    joint = Joint(study.engine, study.point, [acting], () if linear else found.laws[-1].made.terms, Scatter(), [lines],
                  whole=True)  # fmt: skip
    made = joint.predict(x, joint.settle(x, [None], steps))[0]
    return made if recorder is None else made * recorder.factor(run.decay + 2j * np.pi * run.frequency, back=True)


def errors(found: NonlinearAnswer, run: Run, *, linear: bool = False) -> NDArray[np.float64]:
    """Relative RMS error of each response (n_out,) over the lines of `run` that may be compared."""
    at = run.compared
    made, measured = (run.seen(a)[:, at] for a in (spectra(found, run, linear=linear), run.y))
    return np.sqrt(np.sum(np.abs(made - measured) ** 2, axis=1) / np.sum(np.abs(measured) ** 2, axis=1))
