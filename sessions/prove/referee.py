"""Is a fault visible at all? The user's own structure, updated as well as it can be, against the exact faulty response.

The referee knows the truth without noise, so it needs no tool: it fits stiffness parameters (with their prior)
and free modal dampings of the nominal model on half of the lines and takes the chi2 of the other half. Each line
weighs 1 % of itself and of its neighbourhood, about what mesh, calibration and mounting leave of a sound model.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg
from numpy.random import default_rng
from numpy.typing import NDArray

from sessions.prove.cases import Case
from sessions.prove.truth import excite, fe
from sessions.prove.truth.bench import sensor_row
from sessions.prove.truth.channels import transfer_factor
from sessions.prove.truth.respond import Plant, steady, transfer
from sessions.prove.truth.session import from_rest_to_rest
from sessions.prove.truth.state import State, plant

TOLERANCE = 0.01
PRIOR = 0.05
SHIFTS = (0.08, 0.025, 0.008, 0.0)
"""Added damping of the lines, in parts of their frequency, from stage to stage of the fit: wide valleys first."""
MOMENTS = 5
MOST_STEPS = 12
NEPER = 1.0
"""By how much a run without noise is faded out over its length."""
LONGEST = 32768


@dataclass(frozen=True, eq=False)
class Nominal:
    """The user's structure: mass, stiffness by zone, rows of the sensors, load."""

    M: NDArray[np.float64]
    parts: NDArray[np.float64]
    rows: NDArray[np.float64]
    load: NDArray[np.float64]
    carried_out: NDArray[np.float64]
    orders: NDArray[np.int_]
    n_ratios: int

    def response(self, p: NDArray, s: NDArray) -> NDArray:
        """Transfer functions at stiffness factors and log damping ratios p, shape (n_out, n_f)."""
        weight, pairs = self._modal(p, s)[:2]
        return (weight @ pairs.T + self.carried_out).T * s ** (self.orders[:, None] - 2)

    def slopes(self, p: NDArray, s: NDArray) -> NDArray:
        """The response's slopes to p, shape (n_p, n_out, n_f): stiffness by differences, damping exactly."""
        n, step = len(self.parts), 1e-6
        now = self.response(p, s)
        out = np.zeros((p.size, *now.shape), complex)
        for i in range(n):
            out[i] = (self.response(p + step * np.eye(p.size)[i], s) - now) / step
        weight, pairs, lossy = self._modal(p, s)
        change = -(weight**2) / s[:, None] ** 2 * lossy
        each = change[:, None, :] * pairs
        number = np.minimum(np.arange(pairs.shape[1]), self.n_ratios - 1)
        for r in range(self.n_ratios):
            out[n + r] = each[:, :, number == r].sum(axis=2).T * s ** (self.orders[:, None] - 2)
        return out

    def _modal(self, p: NDArray, s: NDArray) -> tuple[NDArray, NDArray, NDArray]:
        """Weights of the modes and their damping terms, each (n_f, n_modes), and their residues (n_out, n_modes)."""
        n = len(self.parts)
        K = np.tensordot(p[:n], self.parts, 1)
        square, shape = (np.asarray(a) for a in scipy.linalg.eigh(K, self.M, check_finite=False))
        omega = np.sqrt(np.maximum(square, 0))
        ratio = np.exp(p[n + np.minimum(np.arange(omega.size), self.n_ratios - 1)])
        lossy = 2 * s[:, None] * ratio * omega
        weight = s[:, None] ** 2 / (square + s[:, None] ** 2 + lossy)
        return weight, (self.rows @ shape) * (self.load @ shape), lossy


def nominal(case: Case) -> Nominal:
    """The user's structure of a case."""
    bench = case.state.bench
    mesh = bench.coarse
    a = mesh.active
    block = np.ix_(a, a)
    M = fe.assemble(mesh)[0]
    parts = np.array([fe.assemble(fe.zone_only(mesh, zone))[1][block] for zone in bench.zones.values()])
    rows = np.array([sensor_row(mesh, replace(s, offset=0.0)) for s in bench.sensors])
    carried = np.zeros(mesh.size)
    load = np.zeros(mesh.size)
    if bench.base is not None:
        carried[bench.base :: fe.DOFS_PER_NODE] = 1.0
        load = -M @ carried
    elif bench.drive is not None:
        load[mesh.dof(*bench.drive)] = 1.0
    orders = np.array([s.order for s in bench.sensors])
    return Nominal(M[block], parts, rows[:, a], load[a], rows @ carried, orders, bench.n_modes + 2)


def misfit(case: Case, marched: bool | None = None) -> float:
    """Held-out chi2 per line and output of the updated nominal structure, without noise.

    `marched` asks for runs at three levels instead of the exact response; a case with nonlinear laws needs them.
    """
    if bool(case.state.laws) if marched is None else marched:
        return _nonlinear_misfit(case)
    omega = 2 * np.pi * lines(case)
    plants = [plant(state) for state in _moments(case.state)]
    exact = [_measured(case, x, 1j * omega) for x in plants]
    mean = np.mean(exact, axis=0)
    model = nominal(case)
    sigma = _spread(omega, mean, model.orders)
    p = _fit(case, model, plants, omega)
    held = slice(1, None, 2)
    wrong = np.mean([np.abs(h - model.response(p, 1j * omega)) ** 2 for h in exact], axis=0) / sigma**2
    return float(np.mean(wrong[:, held]) + np.mean(_distortion(case)))


def _nonlinear_misfit(case: Case) -> float:
    """The same on runs without noise under the own excitation, one a level, from rest to rest: distortion counts."""
    plan = replace(case.plan, repeats=1, keep=min(case.plan.keep, 2))
    plan = replace(plan, samples=min(plan.samples, LONGEST)) if plan.excitation == "random" else plan
    runs = from_rest_to_rest(default_rng(1), case.state, plan)
    size = runs[0].shape[1]
    decay = NEPER * plan.rate / size
    frequency = np.fft.rfftfreq(size, 1 / plan.rate)
    at = np.unique(np.searchsorted(frequency, lines(case)))
    s = decay + 2j * np.pi * frequency[at]
    model, whole = nominal(case), plant(case.state)
    sigma = _spread(s.imag, _measured(case, whole, s), model.orders)
    window = np.exp(-decay * np.arange(size) / plan.rate)
    exact, loose = zip(*(_ratios(np.fft.rfft(run * window, axis=1), frequency, at) for run in runs), strict=True)
    found, spread = np.concatenate(exact, axis=1), np.concatenate([sigma * x for x in loose], axis=1)
    every, half = np.tile(s, len(runs)), np.tile(np.arange(s.size) % 2 == 0, len(runs))
    p = _fit(case, model, [whole], s.imag, SHIFTS[:-1])
    p = _least_squares(model, p, every[half], found[:, half], spread[:, half])
    wrong = np.abs(found - model.response(p, every)) ** 2 / spread**2
    return float(np.mean(wrong[:, ~half]))


def _ratios(spectra: NDArray, frequency: NDArray, at: NDArray) -> tuple[NDArray, NDArray]:
    """Outputs over the input at lines `at`, and how much looser each is for the input that it happened to get."""
    power = np.concatenate([[0.0], np.cumsum(np.abs(spectra[0]) ** 2)])
    low, high = (np.searchsorted(frequency, (1 + x) * frequency[at]) for x in (-0.02, 0.02))
    around = (power[high] - power[low]) / np.maximum(high - low, 1)
    return spectra[1:, at] / spectra[0, at], np.sqrt(around) / np.abs(spectra[0, at])


def lines(case: Case) -> NDArray[np.float64]:
    """Frequencies in Hz: a logarithmic raster of the band, and more where the structure resonates."""
    low, high = case.state.bench.band
    raster = np.geomspace(low, high, 220)
    peaks = plant(case.state).frequency
    near = [f * (1 + 4 * case.state.bench.ratio * np.linspace(-1, 1, 14)) for f in peaks if low < f < high]
    out = np.sort(np.concatenate([raster, *near]))
    return out[(out >= low) & (out <= high)]


def _moments(state: State) -> list[State]:
    """The state at moments of a session that drifts; else itself."""
    if not state.drift:
        return [state]
    return [_stiffer(state, 1 + state.drift * t) for t in np.linspace(0, 1, MOMENTS)]


def _stiffer(state: State, factor: float) -> State:
    def scaled(bar: fe.Bar) -> fe.Bar:
        return replace(bar, axial=bar.axial * factor, bending=bar.bending * factor, shear=bar.shear * factor)

    springs = tuple((a, b, k * factor, loss) for a, b, k, loss in state.mesh.springs)
    return replace(state, mesh=replace(state.mesh, bars=tuple(scaled(b) for b in state.mesh.bars), springs=springs))


def _measured(case: Case, exact: Plant, s: NDArray) -> NDArray:
    """Exact transfer functions as the faulty channels deliver them, shape (n_out, n_f)."""
    state = case.state
    return transfer_factor(state.channels, state.channel_names(), transfer(exact, s), s, _kept(case))


def _kept(case: Case) -> dict[str, float]:
    """Share of a clipped channel's signal that follows the signal itself."""
    return {name: share for name, share, _ in _clipped(case)}


def _distortion(case: Case) -> list[float]:
    """For every output the chi2 that clipping adds as distortion, spread over the lines."""
    found = {name: power for name, _, power in _clipped(case)}
    names = case.state.channel_names()
    everyone = found.get(names[0], 0.0)
    return [(found.get(name, 0.0) + everyone) / (2 * TOLERANCE**2) for name in names[1:]]


def _clipped(case: Case) -> list[tuple[str, float, float]]:
    """Name, kept share and relative power of the distortion of every clipped channel."""
    faults = [f for f in case.state.channels if f.kind == "clipping"]
    if not faults:
        return []
    names, rate = case.state.channel_names(), case.plan.rate
    signal = excite.odd_multisine(default_rng(1), 4096, rate, case.state.bench.band)
    data = np.vstack([signal, steady(plant(case.state), signal, rate)])
    out = []
    for fault in faults:
        y = data[names.index(fault.channel)]
        cut = np.clip(y, *(np.array([-1, 1]) * fault.value * np.max(np.abs(y))))
        share = float(cut @ y / (y @ y))
        out.append((fault.channel, share, float(np.sum((cut - share * y) ** 2) / np.sum(y**2))))
    return out


def _spread(omega: NDArray, H: NDArray, orders: NDArray) -> NDArray[np.float64]:
    """Tolerance of every line: 1 % of itself, of its neighbourhood within 4 % of its frequency, and of the others'."""
    near = np.abs(np.log(omega[:, None] / omega[None, :])) < 0.04
    around = (np.abs(H) ** 2) @ near / near.sum(axis=0)
    others = np.array([np.mean(around[orders == order], axis=0) for order in orders])
    return TOLERANCE * np.sqrt(np.abs(H) ** 2 + around + others)


def _fit(
    case: Case, model: Nominal, plants: list[Plant], omega: NDArray, shifts: tuple[float, ...] = SHIFTS
) -> NDArray[np.float64]:
    """Stiffness factors and log damping ratios that fit the even lines best, from wide valleys to narrow ones."""
    n = len(model.parts)
    p = np.concatenate([np.ones(n), np.full(model.n_ratios, np.log(0.01))])
    train = omega[::2]
    for shift in shifts:
        s = (shift + 1j) * train
        exact = np.mean([_measured(case, x, s) for x in plants], axis=0)
        p = _least_squares(model, p, s, exact, _spread(train, exact, model.orders))
    return p


def _least_squares(model: Nominal, p: NDArray, s: NDArray, exact: NDArray, sigma: NDArray) -> NDArray[np.float64]:
    n = len(model.parts)

    def residual(q: NDArray) -> NDArray[np.float64]:
        wrong = ((model.response(q, s) - exact) / sigma).ravel()
        prior = np.concatenate([(q[:n] - 1) / PRIOR, (q[n:] - np.log(0.01)) / 3.0])
        return np.concatenate([wrong.real, wrong.imag, prior])

    def jacobian(q: NDArray) -> NDArray[np.float64]:
        slopes = (model.slopes(q, s) / sigma).reshape(q.size, -1).T
        prior = np.diag(np.r_[np.full(n, 1 / PRIOR), np.full(q.size - n, 1 / 3.0)])
        return np.vstack([slopes.real, slopes.imag, prior])

    damping, now = 1e-2, residual(p)
    for _ in range(MOST_STEPS):
        J = jacobian(p)
        normal, slope = J.T @ J, J.T @ now
        for _ in range(6):
            move = -np.linalg.solve(normal + damping * np.diag(np.diag(normal)), slope)
            trial = p + np.clip(move, -0.5, 0.5)
            then = residual(trial)
            if then @ then < now @ now:
                break
            damping *= 6
        else:
            return p
        gain = 1 - (then @ then) / (now @ now)
        p, now, damping = trial, then, max(damping / 4, 1e-9)
        if gain < 1e-4:
            break
    return p
