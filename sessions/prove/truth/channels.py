"""The measurement chain of the concealed truth, and the faults of single channels."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from sessions.prove.truth.physics import Maker, band, scale
from sessions.prove.truth.state import ChannelFault, Fault, State


def channel_place(name: str, to: str | None = None) -> dict[str, Any]:
    """The place of a channel."""
    return {"kind": "channel", "id": name, "to": to}


def _any(rng: Generator, state: State, inputs: float = 0.15) -> str:
    names = state.channel_names()
    return names[0] if rng.random() < inputs else names[1 + int(rng.integers(len(names) - 1))]


def _with(state: State, fault: Fault, spoilt: ChannelFault) -> State:
    return replace(state, faults=(*state.faults, fault), channels=(*state.channels, spoilt))


def gain(rng: Generator, state: State, severity: float) -> State:
    """One channel's calibration is wrong by a factor."""
    name = _any(rng, state)
    share = scale(0.01, 0.8, severity)
    factor = 1 + share if rng.random() < 0.5 else 1 / (1 + share)
    both = {"a": {"value": factor, "unit": "1"}, "gain_error": {"value": factor - 1, "unit": "1"}}
    fault = Fault("channel-gain", True, channel_place(name), severity, share, "relative error of the gain")
    fault = replace(fault, parameters=both)
    return _with(state, fault, ChannelFault("gain", name, factor))


def delay(rng: Generator, state: State, severity: float) -> State:
    """One channel comes late, as through another converter."""
    name = _any(rng, state)
    phase = scale(0.004, 1.2, severity)
    tau = phase / (2 * np.pi * band(state)[1])
    fault = Fault("channel-delay", True, channel_place(name), severity, phase, "phase lag at the top of the band, rad")
    fault = replace(fault, parameters={"tau": {"value": tau, "unit": "s"}})
    return _with(state, fault, ChannelFault("delay", name, tau))


def highpass(rng: Generator, state: State, severity: float) -> State:
    """One channel is coupled through a capacitor."""
    name = _any(rng, state)
    ratio = scale(0.004, 1.5, severity)
    corner = ratio * 2 * band(state)[0]
    fault = Fault("channel-highpass", True, channel_place(name), severity, ratio, "corner over the first mode")
    fault = replace(fault, parameters={"f_c": {"value": corner, "unit": "Hz"}})
    return _with(state, fault, ChannelFault("highpass", name, corner))


def clipping(rng: Generator, state: State, severity: float) -> State:
    """One amplifier saturates below the range of its converter, or the converter's range is set too small."""
    name = _any(rng, state, inputs=0.1)
    rail = 1 - scale(0.03, 0.8, severity)
    fault = Fault("channel-clipping", True, channel_place(name), severity, 1 - rail, "part of the highest peak cut off")
    fault = replace(fault, parameters={"rail_over_peak": {"value": rail, "unit": "1"}})
    where = "converter" if rng.random() < 0.5 else "amplifier"
    return _with(state, replace(fault, sense=where), ChannelFault("clipping", name, rail, where))


def swap(rng: Generator, state: State, severity: float) -> State:
    """Two cables exchanged, or one sensor turned round."""
    kin = [
        (a.name, b.name)
        for i, a in enumerate(state.bench.sensors)
        for b in state.bench.sensors[i + 1 :]
        if a.order == b.order
    ]
    if kin and rng.random() < 0.6:
        one, other = kin[int(rng.integers(len(kin)))]
        fault = Fault("channel-swap", True, channel_place(one, other), severity, 1.0, "two channels exchanged")
        fault = replace(fault, sense="exchanged", places=(channel_place(other, one),))
        return _with(state, fault, ChannelFault("exchange", one, 1.0, other))
    name = _any(rng, state)
    fault = Fault("channel-swap", True, channel_place(name), severity, 1.0, "one channel inverted", sense="inverted")
    fault = replace(fault, accept=(("channel-gain", channel_place(name)),))
    return _with(state, fault, ChannelFault("gain", name, -1.0))


CHANNEL: dict[str, Maker] = {
    "channel-gain": gain,
    "channel-delay": delay,
    "channel-highpass": highpass,
    "channel-clipping": clipping,
    "channel-swap": swap,
}


def spoil(
    faults: tuple[ChannelFault, ...], names: tuple[str, ...], data: NDArray, rate: float, peak: NDArray, edges: tuple
) -> NDArray[np.float64]:
    """Samples, shape (n_channels, n), as the faulty channels deliver them; `peak` is each one's highest of the session.

    `edges` bound the pieces that were recorded without a break (start, stop).
    """
    out = data.copy()
    for fault in faults:
        row = names.index(fault.channel)
        if fault.other == "converter":
            continue
        if fault.kind == "exchange":
            other = names.index(fault.other)
            out[[row, other]] = out[[other, row]]
        elif fault.kind == "crosstalk":
            out[row] += fault.value * out[names.index(fault.other)]
        else:
            for start, stop in edges:
                piece = out[row, start:stop]
                out[row, start:stop] = FILTERS[fault.kind](piece, fault.value, rate, float(peak[row]))
    return out


def _filtered(piece: NDArray, rate: float, law: Callable[[NDArray], NDArray]) -> NDArray[np.float64]:
    """A causal filter on a signal that starts from rest."""
    n = piece.size
    padded = 2 * n
    time = np.arange(padded) / rate
    sigma = 16.0 / time[-1]
    spectrum = np.fft.rfft(piece * np.exp(-sigma * time[:n]), padded)
    s = sigma + 2j * np.pi * np.fft.rfftfreq(padded, 1 / rate)
    return np.fft.irfft(spectrum * law(s), padded)[:n] * np.exp(sigma * time[:n])


def _gain(piece: NDArray, value: float, rate: float, peak: float) -> NDArray[np.float64]:
    return value * piece


def _delay(piece: NDArray, value: float, rate: float, peak: float) -> NDArray[np.float64]:
    return _filtered(piece, rate, lambda s: np.exp(-s * value))


def _highpass(piece: NDArray, value: float, rate: float, peak: float) -> NDArray[np.float64]:
    return _filtered(piece, rate, lambda s: s / (s + 2 * np.pi * value))


def _clipping(piece: NDArray, value: float, rate: float, peak: float) -> NDArray[np.float64]:
    return np.clip(piece, -value * peak, value * peak)


def _resonance(piece: NDArray, value: float, rate: float, peak: float) -> NDArray[np.float64]:
    w = 2 * np.pi * value
    return _filtered(piece, rate, lambda s: 1 / (1 + 0.06 * s / w + (s / w) ** 2))


FILTERS: dict[str, Callable[[NDArray, float, float, float], NDArray[np.float64]]] = {
    "gain": _gain,
    "delay": _delay,
    "highpass": _highpass,
    "clipping": _clipping,
    "resonance": _resonance,
}


def digitise(
    rng: Generator, data: NDArray, calibration: NDArray, floor: NDArray, full: NDArray, bits: int
) -> NDArray[np.float64]:
    """Samples after calibration error, noise of standard deviation `floor`, and a converter of range +-`full`."""
    step = 2 * full / 2**bits
    noisy = data * calibration[:, None] + floor[:, None] * rng.standard_normal(data.shape)
    held = np.clip(noisy, -full[:, None], (full - step)[:, None])
    return np.round(held / step[:, None]) * step[:, None]


def transfer_factor(
    faults: tuple[ChannelFault, ...], names: tuple[str, ...], H: NDArray, s: NDArray, kept: dict[str, float]
) -> NDArray:
    """Transfer functions, shape (n_out, n_f), as faulty channels show them; `kept` is what clipping leaves of one."""
    full = np.vstack([np.ones(s.size, complex), H])
    laws: dict[str, Callable[[float], NDArray]] = {
        "gain": lambda v: v * np.ones(s.size, complex),
        "delay": lambda v: np.exp(-s * v),
        "highpass": lambda v: s / (s + 2 * np.pi * v),
        "resonance": lambda v: 1 / (1 + 0.06 * s / (2 * np.pi * v) + (s / (2 * np.pi * v)) ** 2),
    }
    for fault in faults:
        row = names.index(fault.channel)
        if fault.kind == "exchange":
            other = names.index(fault.other)
            full[[row, other]] = full[[other, row]]
        elif fault.kind == "crosstalk":
            full[row] = full[row] + fault.value * full[names.index(fault.other)]
        elif fault.kind == "clipping":
            full[row] = kept[fault.channel] * full[row]
        else:
            full[row] = laws[fault.kind](fault.value) * full[row]
    return full[1:] / full[0]
