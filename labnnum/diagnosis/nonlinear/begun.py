"""Responses over a record that does not begin at rest: the state it begins with, from its first samples."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from labnnum.diagnosis.nonlinear.decision import NonlinearAnswer
from labnnum.diagnosis.nonlinear.predict import padded, response
from labnnum.diagnosis.nonlinear.run import Run
from labnnum.errors import EstimationError
from labnnum.recording import Recording

ROUNDS, STEP = 4, 0.1
"""Steps of Gauss and Newton, and that of the differences, in units of the largest pulse so far."""
BEYOND = 1000
"""Samples after the first ones that the search for the state marches over."""


def started(
    found: NonlinearAnswer, recording: Recording, top: float, first: int = 50, *, linear: bool = False,
    offset: NDArray | float = 0.0,
) -> NDArray[np.float64]:  # fmt: skip
    """Responses (n_out, n_samples) of the model found to a record's input, from the state in which the record begins.

    Two pulses a mode before the record bring the model into that state; their sizes are those with which the first
    samples come out nearest.

    Parameters
    ----------
    top : float
        Hz, up to which the input counts as excited; a pulse is about as short as the shortest period.
    first : int
        Samples that tell the state.
    linear : bool
        Of the base model alone.
    offset : array_like, shape (n_out,)
        What was taken off the recorded responses, such as the mean of what the model makes.
    """
    some = replace(recording, data=recording.data[:, : first + BEYOND], breaks=())
    n = 2 * found.study.engine.band_modes.size
    short = padded(some, top, 1.0)
    measured = some.data[list(some.outputs), :first] + np.reshape(offset, (-1, 1))
    size = np.zeros(n)
    scale = float(np.sqrt(np.mean(np.abs(recording.data[recording.inputs[0]]) ** 2)))

    def made(sizes: NDArray) -> NDArray[np.float64]:
        return response(found, pulsed(short, sizes, top), linear=linear)[:, :first].ravel()

    for _ in range(ROUNDS):
        here, step = made(size), STEP * max(scale, float(np.max(np.abs(size))))
        slopes = np.array([(made(size + step * row) - here) / step for row in np.eye(n)])
        size = size + np.linalg.lstsq(slopes.T, measured.ravel() - here, rcond=1e-6)[0]
    whole = padded(recording, top)
    return response(found, pulsed(whole, size, top), linear=linear)[:, : recording.n_samples]


def pulsed(run: Run, sizes: NDArray, top: float) -> Run:
    """The run with pulses of the input, one after the other, that end where it begins.

    Raises
    ------
    EstimationError
        If the run is shorter than they are.
    """
    width = max(2, round(run.rate / top))
    shape = np.hanning(2 * width + 1)[1:]
    if (len(sizes) + 1) * width > run.period:
        raise EstimationError(
            f"{len(sizes)} pulses of {width} samples need {(len(sizes) + 1) * width} samples before the record begins;"
            f" it is {run.period} long in all: give a longer record, or one excited to higher frequencies"
        )
    time = np.zeros(run.period)
    for i, size in enumerate(sizes):
        time[run.period - (i + 2) * width : run.period - (i + 2) * width + 2 * width] += size * shape
    return replace(run, u=run.u + np.fft.rfft(time) * (2 / run.period))
