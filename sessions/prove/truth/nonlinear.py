"""Response of the concealed truth with nonlinear laws: their forces by fine time marching, all else exactly.

Marching gives the forces of the laws on a fine raster of time. The outputs follow from them, and from the input,
through the exact transfer functions of the linear structure; what lies above half the digitiser's rate is taken
off by an ideal filter on the way.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from sessions.prove.truth import march
from sessions.prove.truth.physics import (
    across,
    any_element,
    any_node,
    band,
    found,
    ground,
    joint,
    node_row,
    quantity,
    scale,
    strain_row,
    yardstick,
)
from sessions.prove.truth.respond import Plant, answers, transfer
from sessions.prove.truth.state import Fault, LawTerm, State, plant

FINENESS, FRICTION = 36, 144
"""Steps a period at the top of the band; of dry friction, whose jumps and stops excite what lies above."""
REACH = 6.0
"""Modes above this many times the top of the band act by their flexibility only."""
LEAD = 256
"""Samples in which a record is led back to its beginning before it is filtered."""
STRENGTH = {True: 9.81, False: 20.0}


def nonlinear(state: State, signal: NDArray, rate: float) -> NDArray[np.float64]:
    """What every output measures, from rest, while the input is `signal`, shape (n_out, n_samples)."""
    whole, rows = plant(state), _rows(state)
    _, _, forces, over = _marched(state, whole, signal, rate)
    out = answers(whole, [signal], rate, (0.0, rate / 2))[0]
    for row, force, mean in zip(rows, forces, march.averaged(_laws(state)), strict=True):
        alone = replace(whole, load=row, carried=0 * whole.carried, extras=())
        out = out - answers(alone, [coarser(force, over, mean)], rate, (0.0, rate / 2))[0]
    return out


def stretched(state: State, signal: NDArray, rate: float) -> NDArray[np.float64]:
    """How far each law is stretched at most, (n_laws,), from rest, while the input is `signal`."""
    return np.max(np.abs(_marched(state, plant(state), signal, rate)[0]), axis=1)


def stroke(term: LawTerm) -> float:
    """Stretch at which a slider on a spring lets go, the first of several; infinite for what is no such law."""
    if term.kind != march.SLIDERS:
        return np.inf
    stiffness, limit, count = term.constants[:3]
    return 2 * limit / (count + 1) / stiffness


def _marched(state: State, whole: Plant, signal: NDArray, rate: float) -> tuple[NDArray, NDArray, NDArray, int]:
    """Stretch, speed and force of every law on the fine raster, and how many of its steps make a sample."""
    laws = _laws(state)
    fine = FRICTION if march.averaged(laws).any() else FINENESS
    over = int(np.ceil(fine * band(state)[1] / rate))
    coupled = coupling(whole, _rows(state), band(state)[1])
    z, v, f = march.march(coupled, laws, finer(signal, over), 1 / (rate * over))
    if not np.isfinite(z).all():
        raise FloatingPointError("the concealed structure runs away from its laws, which soften more than it is stiff")
    return z, v, f, over


def _rows(state: State) -> NDArray[np.float64]:
    return np.array([t.row for t in state.laws])[:, state.mesh.active]


def _laws(state: State) -> march.Laws:
    constants = np.zeros((len(state.laws), 8))
    for i, term in enumerate(state.laws):
        constants[i, : len(term.constants)] = term.constants
    return march.Laws(np.array([t.kind for t in state.laws]), constants)


def coupling(whole: Plant, rows: NDArray, top: float) -> march.Coupling:
    """Modes up to `REACH` times the band, and the flexibility of the others."""
    square, shape = np.real(whole.square), np.real(whole.shape)
    seen, load = rows @ shape, shape.T @ whole.load
    near = square < (REACH * 2 * np.pi * top) ** 2
    far = ~near
    left = seen[:, far] / square[far]
    return march.Coupling(
        square[near], whole.viscous[near], seen[:, near], load[near], left @ seen[:, far].T, left @ load[far]
    )


def finer(signal: NDArray, over: int) -> NDArray[np.float64]:
    """The same band-limited signal with `over` times as many samples."""
    return over * np.fft.irfft(np.fft.rfft(signal), signal.size * over)


def coarser(signal: NDArray, over: int, mean: bool = False) -> NDArray[np.float64]:
    """Every `over`-th sample of the signal after an ideal filter at half the new rate.

    The end is led back to the beginning softly, so that the filter does not ring there. `mean`: whether the samples are
    means over the step before each, of which the filter undoes what that takes off and how late it is.
    """
    n = signal.size // over
    total = n + LEAD + n % 2
    rest = (total - n) * over
    fade = 0.5 + 0.5 * np.cos(np.pi * np.arange(rest) / rest)
    led = np.concatenate([signal, signal[0] + (signal[-1] - signal[0]) * fade])
    spectrum = np.fft.rfft(led)[: total // 2 + 1]
    if mean:
        half = np.pi * np.arange(spectrum.size) / (total * over)
        spectrum = spectrum * np.exp(1j * half) / np.sinc(half / np.pi)
    return np.fft.irfft(spectrum, total)[:n] / over


def stretch(state: State, row: NDArray) -> tuple[float, float, float]:
    """RMS of a stretch and of its speed at the highest level, were there no law; and the stiffness it meets.

    Under a sweep it is the RMS in the highest resonance, under a hammer half the peak.
    """
    whole = plant(state)
    seen = row[:, state.mesh.active]
    watch = replace(whole, outputs=seen, carried_out=np.zeros(1), orders=np.zeros(1, int), extras=())
    low, high = band(state)
    frequency = np.linspace(low, high, 1500)
    size = np.abs(transfer(watch, 2j * np.pi * frequency)[0]) * STRENGTH[state.bench.base is not None]
    z = float(np.sqrt(np.mean(size**2)))
    v = float(np.sqrt(np.mean((2 * np.pi * frequency * size) ** 2)))
    if state.swept:
        z, v = float(np.max(size)), float(np.max(2 * np.pi * frequency * size))
    if not state.shaken:
        z, v = _blow_size(state, watch)
    inside = whole.frequency > 0.9 * low
    give = np.real(seen[0] @ whole.shape[:, inside]) ** 2 / np.real(whole.square[inside])
    return z, v, float(1 / np.sum(give))


def _blow_size(state: State, watch: Plant) -> tuple[float, float]:
    """Half the peaks of stretch and speed after a typical hammer blow."""
    high = band(state)[1]
    rate, n = 4 * high, 4096
    width = np.sqrt(np.log(10.0)) / (np.pi * 1.15 * high)
    blow = STRENGTH[False] * np.exp(-(((np.arange(n) / rate - 8 / high) / width) ** 2))
    z = answers(watch, [blow], rate, (0.0, rate / 2))[0][0]
    return float(np.max(np.abs(z)) / 2), float(np.max(np.abs(np.gradient(z, 1 / rate))) / 2)


def _spot(rng: Generator, state: State, lossy: bool) -> tuple[NDArray[np.float64], dict, bool]:
    """Where a law sits: from a node to the fixture, or across a joint; and whether it works on an angle.

    Across a joint of a beam or frame it works on the angle between the nodes, or on their motion across. A
    floating beam would be pushed away for good by a spring law from the fixture, and turned for good by two equal
    forces across it: there it gets angles only.
    """
    grounded = rng.random() < (0.5 if state.bench.kind == "chain" else 0.75)
    if grounded and (lossy or state.bench.kind != "free-beam"):
        node, axis = any_node(rng, state)
        return node_row(state, node, axis), ground(node), False
    home = any_element(rng, state, free=True)
    if state.bench.kind in ("chain", "free-beam") or rng.random() < 0.5:
        return strain_row(state, home)[0], joint(home), state.bench.kind != "chain"
    axis = 1 if state.bench.kind != "frame" else across(state.bench.coarse, home[1])
    return node_row(state, home[1], axis) - node_row(state, home[0], axis), joint(home), False


LOSSY = ("coulomb-friction", "quadratic-damping", "stick-slip", "hysteresis", "van-der-pol-damping")
Sizes = tuple[float, float, float, float]
Choice = tuple[int, tuple[float, ...], float, str, dict[str, dict], str]


def law(name: str, choose: Callable[[Generator, float, Sizes], Choice], inside: bool) -> Callable:
    """Maker of one nonlinear fault; `choose` takes severity and (z, v, stiffness, w1) to the law's constants."""

    def maker(rng: Generator, state: State, severity: float) -> State:
        row, place, turns = _spot(rng, state, name in LOSSY)
        sizes = (*stretch(state, row), yardstick(state)[1])
        kind, constants, share, measure_of, parameters, sense = choose(rng, severity, sizes)
        if turns:
            parameters = {k: {**v, "unit": f"{v['unit']}, of the angle"} for k, v in parameters.items()}
        accept = (("hysteresis", place),) if sense == "iwan" else ()
        fault = Fault(name, inside, place, severity, share, measure_of, parameters, sense, accept=accept)
        fault = replace(fault, places=moving_alike(state, row[0], place))
        return found(state, fault, laws=(*state.laws, LawTerm(kind, constants, row[0])))

    maker.__doc__ = choose.__doc__
    return maker


ALIKE = 0.005
"""Difference of two motions, relative, in all modes as they answer within the band, that no measurement shows."""
APART = 0.015
"""Difference of the motions of every node under a force at either, relative, at half of the band's frequencies, that
none shows: where the first mode outweighs all others, places that it alone moves alike are told apart by the others."""


def moving_alike(state: State, row: NDArray, place: dict) -> tuple[dict, ...]:
    """Other places of the user's model that move as `row` does: what acts there does the same."""
    whole = plant(state)
    square, shape, loss = np.real(whole.square), np.real(whole.shape), np.real(whole.viscous)
    low, high = (2 * np.pi * f for f in band(state))
    own = np.clip(np.sqrt(np.maximum(square, 0.0)), low, high)
    answer = 1 / np.abs(square - own**2 + 1j * loss * own)
    own_shape = row[state.mesh.active] @ shape
    mine = answer * own_shape
    every = [(other, candidate[state.mesh.active] @ shape) for other, candidate in _rows_of_all(state)]
    nodes = np.array([motion for other, motion in every if other["kind"] == "ground"])
    w = np.linspace(low, high, 300)[:, None]
    lines = 1 / (square - w**2 + 1j * loss * w)
    out = []
    for other, motion in every:
        for sense in (1.0, -1.0):
            apart = np.linalg.norm(mine - sense * answer * motion)
            if apart < ALIKE * np.linalg.norm(mine) and other != place and other not in out:
                change = np.linalg.norm((lines * (own_shape - sense * motion)) @ nodes.T, axis=1)
                if np.median(change / np.linalg.norm((lines * own_shape) @ nodes.T, axis=1)) < APART:
                    out.append(other)
    return tuple(out)


def _rows_of_all(state: State) -> list[tuple[dict, NDArray]]:
    """Every node of the user's model against the ground and its neighbour, along every axis that moves."""
    bench = state.bench
    axes = {"chain": (0,), "frame": (0, 1, 2)}.get(bench.kind, (1, 2))
    out = []
    for node in bench.coarse.named:
        if node not in bench.feet:
            out += [(ground(node), node_row(state, node, a)[0]) for a in axes if a != 2]
    for home in bench.elements:
        out += [(joint(home), (node_row(state, home[1], a) - node_row(state, home[0], a))[0]) for a in axes]
    return out


def _cubic(rng: Generator, severity: float, sizes: Sizes) -> Choice:
    """A spring that hardens or softens with the cube of its stretch, until it has taken all the stiffness there."""
    z, _, k, _ = sizes
    soft = rng.random() < 0.3
    share = scale(0.003, 0.03, severity) if soft else scale(0.003, 0.6, severity)
    k3 = (-share if soft else share) * k / (3 * z**2)
    sense = "softening" if soft else "hardening"
    return march.CUBIC, (k3, np.sqrt(k / (3 * abs(k3)))), share, EXTRA, {"k3": quantity(k3, "N/m^3")}, sense


def _quadratic(rng: Generator, severity: float, sizes: Sizes) -> Choice:
    """A spring whose force grows with the square of its stretch, one way only.

    On the side where it softens it takes no more than the stiffness that is there: beyond, its force grows in
    proportion, or else the structure would run away from it.
    """
    z, _, k, _ = sizes
    share = scale(0.004, 0.18, severity)
    k2 = share * k / (2 * z) * (1 if rng.random() < 0.5 else -1)
    return march.QUADRATIC, (k2, k / (2 * abs(k2))), share, EXTRA, {"k2": quantity(k2, "N/m^2")}, ""


def _gap(rng: Generator, severity: float, sizes: Sizes) -> Choice:
    """A stop on one side."""
    return _stop(march.GAP, rng, severity, sizes)


def _clearance(rng: Generator, severity: float, sizes: Sizes) -> Choice:
    """A spring with play on either side."""
    return _stop(march.CLEARANCE, rng, severity, sizes)


def _stop(kind: int, rng: Generator, severity: float, sizes: Sizes) -> Choice:
    z, _, k, _ = sizes
    share = scale(0.01, 1.0, severity)
    g = z * rng.uniform(0.3, 1.4)
    parameters = {"k": quantity(share * k, "N/m"), "g": quantity(g, "m")}
    return kind, (share * k, g), share, "stiffness of the stop over that of the place", parameters, ""


def _coulomb(rng: Generator, severity: float, sizes: Sizes) -> Choice:
    """Dry friction."""
    z, _, k, _ = sizes
    share = scale(0.0006, 0.4, severity)
    limit = share * k * z
    return march.COULOMB, (limit,), share, "friction over the elastic force", {"F": quantity(limit, "N")}, ""


def _drag(rng: Generator, severity: float, sizes: Sizes) -> Choice:
    """Damping by the square of the speed."""
    _, v, k, w = sizes
    share = scale(0.005, 0.6, severity)
    c2 = share * k / (w * v)
    return march.DRAG, (c2,), share, "c2 v w1 over the stiffness of the place", {"c2": quantity(c2, "N*s^2/m^2")}, ""


def _sliders(rng: Generator, severity: float, sizes: Sizes) -> Choice:
    """A spring that slips: one slider, or five that let go one after the other."""
    z, _, k, _ = sizes
    share = scale(0.01, 1.5, severity)
    stiffness, limit = share * k, share * k * z * rng.uniform(0.4, 1.2)
    count = 1 if rng.random() < 0.6 else 5
    parameters = {"k_t": quantity(stiffness, "N/m"), "F_s": quantity(limit, "N")}
    sense = "jenkins" if count == 1 else "iwan"
    return march.SLIDERS, (stiffness, limit, float(count)), share, EXTRA, parameters, sense


def _bouc_wen(rng: Generator, severity: float, sizes: Sizes) -> Choice:
    """A smooth loop with memory."""
    z, _, k, _ = sizes
    share = scale(0.01, 1.5, severity)
    limit = z * rng.uniform(0.4, 1.2)
    constants = (share * k, limit, 1.0, float(rng.uniform(0.5, 0.7)))
    parameters = {"k": quantity(share * k, "N/m"), "limit": quantity(limit, "m")}
    return march.BOUC_WEN, constants, share, EXTRA, parameters, ""


def _van_der_pol(rng: Generator, severity: float, sizes: Sizes) -> Choice:
    """Damping that grows with the square of the stretch: z^2 dz/dt."""
    z, _, k, w = sizes
    share = scale(0.03, 1.5, severity)
    c = share * k / (w * z**2)
    return march.VAN_DER_POL, (c,), share, "c z^2 w1 over the stiffness of the place", {"c": quantity(c, "SI")}, ""


def _signed_square(rng: Generator, severity: float, sizes: Sizes) -> Choice:
    """A spring with force |z| z."""
    z, _, k, _ = sizes
    share = scale(0.03, 0.35, severity)
    k2 = share * k / (2 * z)
    return march.SIGNED_SQUARE, (k2,), share, EXTRA, {"k": quantity(k2, "N/m^2")}, ""


def _delayed(rng: Generator, severity: float, sizes: Sizes) -> Choice:
    """A spring that answers late, with a dashpot beside it so that it never feeds the motion."""
    _, _, k, w = sizes
    share, tau = scale(0.05, 1.5, severity), rng.uniform(0.3, 1.0) / w
    constants = (share * k, tau, 1.05 * share * k * tau)
    parameters = {"k": quantity(share * k, "N/m"), "delay_s": quantity(tau, "s")}
    return march.DELAY, constants, share, EXTRA, parameters, ""


EXTRA = "stiffness that it adds over that of the place"

NONLINEAR = {
    "cubic-stiffness": law("cubic-stiffness", _cubic, True),
    "quadratic-stiffness": law("quadratic-stiffness", _quadratic, True),
    "one-sided-gap": law("one-sided-gap", _gap, True),
    "clearance": law("clearance", _clearance, True),
    "coulomb-friction": law("coulomb-friction", _coulomb, True),
    "quadratic-damping": law("quadratic-damping", _drag, True),
    "stick-slip": law("stick-slip", _sliders, True),
    "hysteresis": law("hysteresis", _bouc_wen, True),
}
OUTSIDE_LAWS = {
    "van-der-pol-damping": law("van-der-pol-damping", _van_der_pol, False),
    "signed-square-spring": law("signed-square-spring", _signed_square, False),
    "delayed-spring": law("delayed-spring", _delayed, False),
}
