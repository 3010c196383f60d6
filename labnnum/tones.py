"""FRFs from stepped sines: each tone fitted by least squares where the plan measures it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from labnnum.errors import ChannelError, EstimationError
from labnnum.excitation import SteppedSine
from labnnum.frf import Frf
from labnnum.recording import Recording


@dataclass(frozen=True, eq=False)
class Tones:
    """Complex amplitude of every channel at every tone of a plan, in the order they were played.

    Parameters
    ----------
    frequency : ndarray, shape (n_steps,)
        Hz.
    amplitude : ndarray, shape (n_ch, n_steps)
        A cosine of amplitude A and phase p at the start of the tone's window is A exp(ip).
    harmonics : ndarray, shape (n_ch, n_harmonics, n_steps)
        Complex amplitudes at twice, three times, ... the tone; NaN beyond half the sample rate.
    variance : ndarray, shape (n_ch, n_steps)
        E|noise|^2 of `amplitude`, from what tone, harmonics and mean leave over, taken as white.
    """

    frequency: NDArray[np.float64]
    amplitude: NDArray[np.complex128]
    harmonics: NDArray[np.complex128]
    variance: NDArray[np.float64]


def tones(recording: Recording, plan: SteppedSine, start: int = 0, harmonics: int = 4) -> Tones:
    r"""Amplitudes at the tones of a stepped-sine test.

    Parameters
    ----------
    recording : Recording
    plan : SteppedSine
    start : int
        Sample of the recording at which the plan began.
    harmonics : int
        How many harmonics are fitted beside each tone.

    Raises
    ------
    EstimationError
        The rates differ, a tone lies outside the recording or across a break, or holds too few samples.

    Notes
    -----
    .. math:: x(t) = x_0 + \sum_{h=1}^{1 + n_h} \mathrm{Re}(X_h e^{2\pi i h f t})

    References
    ----------
    IEEE Std 1057 (2017), four-parameter sine fit, here with the frequency known.
    """
    if recording.rate != plan.rate:
        raise EstimationError(f"{recording.label}: rate {recording.rate:g} Hz is not the plan's {plan.rate:g} Hz")
    spans = list(recording.spans())
    fits = [
        _fit(recording, float(f), (a + start, b + start), harmonics, spans)
        for f, (a, b) in zip(plan.frequency, plan.windows, strict=True)
    ]
    amplitude, above, variance = (np.stack(part, axis=-1) for part in zip(*fits, strict=True))
    return Tones(plan.frequency, amplitude, above, variance)


def _fit(
    recording: Recording, frequency: float, window: tuple[int, int], harmonics: int, spans: list[tuple[int, int]]
) -> tuple[NDArray, NDArray, NDArray]:
    first, stop = window
    if not any(a <= first and stop <= b for a, b in spans):
        raise EstimationError(
            f"{recording.label}: the tone at {frequency:g} Hz (samples {first} to {stop}) lies outside the recording"
            " or across a gap; record that step again"
        )
    orders = [h for h in range(1, harmonics + 2) if h * frequency < 0.5 * recording.rate]
    size = stop - first
    if size < 2 * len(orders) + 3 or not orders:
        raise EstimationError(f"{recording.label}: {size} samples at {frequency:g} Hz are too few; measure more cycles")
    angle = 2 * np.pi * frequency / recording.rate * np.outer(np.arange(size), orders)
    basis = np.hstack([np.ones((size, 1)), np.cos(angle), -np.sin(angle)])
    signal = recording.data[:, first:stop].T
    solution, _, rank, _ = np.linalg.lstsq(basis, signal, rcond=None)
    if rank < basis.shape[1]:
        raise EstimationError(f"{recording.label}: too few cycles at {frequency:g} Hz to tell it from its harmonics")
    left = signal - basis @ solution
    power = np.sum(left**2, axis=0) / (size - basis.shape[1])
    inverse = np.diagonal(np.linalg.inv(basis.T @ basis))
    count = len(orders)
    value = solution[1 : 1 + count] + 1j * solution[1 + count :]
    above = np.full((signal.shape[1], harmonics), np.nan + 0j)
    above[:, : count - 1] = value[1:].T
    return value[0], above, power * (inverse[1] + inverse[1 + count])


def stepped(recording: Recording, plan: SteppedSine, start: int = 0) -> tuple[Frf, ...]:
    """FRFs of a stepped-sine test with one input: one for each direction of the plan, up first as played.

    Parameters
    ----------
    recording, plan, start
        As for `tones`.

    Returns
    -------
    tuple of Frf
        Lines ascend in each, whichever way they were played; settings["direction"] is "up" or "down".

    Raises
    ------
    ChannelError
        There is not exactly one input, or no response.
    EstimationError
        As for `tones`; or the input is silent.
    """
    ins, outs = recording.inputs, recording.outputs
    if len(ins) != 1 or not outs:
        raise ChannelError(
            f"{recording.label}: a stepped sine needs one input and a response; it has {len(ins)} inputs"
        )
    found = tones(recording, plan, start)
    u, y = found.amplitude[ins[0]], found.amplitude[list(outs)]
    if not np.abs(u).all():
        raise EstimationError(f"{recording.label}: channel {recording.channels[ins[0]].name!r} is silent at a tone")
    value = y / u
    noise_u, noise_y = found.variance[ins[0]], found.variance[list(outs)]
    variance = (noise_y + np.abs(value) ** 2 * noise_u) / np.abs(u) ** 2
    return tuple(_direction(recording, plan, part, value, variance) for part in _sweeps(plan.frequency))


def _sweeps(frequency: NDArray) -> list[NDArray[np.intp]]:
    """Steps of each stretch in which the frequency goes one way."""
    if frequency.size < 2:
        return [np.arange(frequency.size)]
    way = np.sign(np.diff(frequency))
    starts = [0]
    for step in range(1, frequency.size):
        first = step == starts[-1] + 1
        if way[step - 1] == 0 or (not first and way[step - 1] != way[step - 2]):
            starts.append(step)
    return np.split(np.arange(frequency.size), starts[1:])


def _direction(recording: Recording, plan: SteppedSine, part: NDArray, value: NDArray, variance: NDArray) -> Frf:
    frequency = plan.frequency[part]
    up = frequency.size < 2 or frequency[-1] > frequency[0]
    order = part if up else part[::-1]
    return Frf(
        frequency=plan.frequency[order],
        value=value[:, None, order],
        outputs=tuple(recording.channels[o] for o in recording.outputs),
        inputs=tuple(recording.channels[i] for i in recording.inputs),
        variance=variance[:, None, order],
        estimator="stepped",
        settings={"rate": recording.rate, "direction": "up" if up else "down", "periodic": True},
    )
