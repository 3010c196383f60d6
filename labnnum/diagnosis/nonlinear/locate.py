"""Where a nonlinear force acts: forces recovered through the base model, and the motion there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft, rfft
from scipy.ndimage import uniform_filter1d

from labnnum.diagnosis.engine import Engine, Point
from labnnum.diagnosis.nonlinear.kernels import AROUND, weighed
from labnnum.diagnosis.nonlinear.laws import NAMES
from labnnum.diagnosis.nonlinear.orbit import Orbit
from labnnum.diagnosis.nonlinear.problem import Acting, Joint
from labnnum.diagnosis.nonlinear.receptance import Base, Receptance, per_place
from labnnum.diagnosis.nonlinear.run import Run, precise
from labnnum.mechanisms.base import Place

FINE = 2
"""Samples of the recovered motion to a measured one."""


@dataclass(frozen=True, eq=False)
class Spot:
    """A motion where a nonlinear force may act: its place, direction and column (n,)."""

    place: Place
    axis: str
    column: NDArray[np.float64]

    @property
    def where(self) -> tuple[Place, str]:
        """Place and axis, whichever side of it a stop is on."""
        return self.place, self.axis.lstrip("-")


@dataclass(frozen=True, eq=False)
class Recovered:
    """Force on the structure at a spot and the motion there, run by run, recovered from the measured responses.

    `share` of the distortion on lines that were not excited that one force there explains; `chance` of it that any
    force would, one complex number of as many as there are sensors.
    """

    spot: Spot
    share: float
    force: tuple[NDArray[np.complex128], ...]
    z: tuple[NDArray[np.float64], ...]
    v: tuple[NDArray[np.float64], ...]
    f: tuple[NDArray[np.float64], ...]
    receptance: dict[tuple[int, float, float], Receptance]
    gain: float = 0.0
    """What a law of motion and speed there removes of chi-square, see `ranked`."""
    unnamed: tuple[Lead, ...] = ()
    """The smooth laws of one term that have no name, see `ranked`."""

    @property
    def top(self) -> float:
        """Largest motion."""
        return float(max(np.max(np.abs(z)) for z in self.z))


@dataclass(frozen=True, eq=False)
class Lead:
    """A law at a spot with the parameters that fit the recovered motion, and what it removes of chi-square.

    A spring and a dashpot at the spot stand beside it, and what those remove alone is not counted.
    """

    spot: Spot
    mechanism: str
    p: NDArray[np.float64]
    gain: float

    @property
    def name(self) -> str:
        """Mechanism that it is named by."""
        return NAMES.get(self.mechanism, self.mechanism)

    def acting(self) -> Acting:
        """As the fit takes it."""
        sign = -1.0 if self.spot.axis.startswith("-") else 1.0
        return Acting(self.mechanism, sign * self.spot.column, self.p)


class Background:
    """The base model at `x` with what it and its ordinary errors may still explain of the residual."""

    def __init__(self, joint: Joint, x: NDArray, orbits: Sequence[Orbit | None] | None = None) -> None:
        given = orbits or [None] * len(joint.runs)
        self.joint, self.x = joint, x
        jac, given = joint.slopes(x, given)
        r, b = joint.parts(x, given)
        self.n_out, self.n = r.shape
        self.r = r
        self.b = b
        std = np.where(np.isfinite(joint.std), joint.std, 1.0)
        loose = np.isinf(joint.std)
        wide = np.where(loose, 1e3 * np.abs(x) + 1e-300, std) / joint.scale
        self.j = jac * wide[None, :, None]
        self.pull = np.where(loose, 0.0, (joint.mean - x) / std)
        nb, nn = self.j.shape[1], b.shape[1]
        size = nb + self.n_out * nn
        gram = np.eye(size)
        gram[:nb, :nb] += np.matmul(self.j, self.j.transpose(0, 2, 1)).sum(axis=0)
        for o in range(self.n_out):
            at = slice(nb + o * nn, nb + (o + 1) * nn)
            gram[at, at] += b[o] @ b[o].T
            cross = self.j[o] @ b[o].T
            gram[:nb, at] += cross
            gram[at, :nb] += cross.T
        self.inverse = np.linalg.inv(gram)
        self.right = self._inner(r)
        self.right[:nb] += self.pull
        self.solved = self.inverse @ self.right
        self.objective = float(np.sum(r * r) + self.pull @ self.pull - self.right @ self.solved)

    def _inner(self, c: NDArray) -> NDArray:
        own = np.matmul(self.b, c[..., None])[..., 0]
        return np.concatenate([np.matmul(self.j, c[..., None]).sum(axis=0)[:, 0], own.reshape(-1)])

    def moments(self, columns: NDArray) -> tuple[NDArray, NDArray]:
        """Products of whitened columns (n_c, n_out, N) among each other and with the residual, errors projected out."""
        inner = np.array([self._inner(c) for c in columns])
        flat = columns.reshape(columns.shape[0], -1)
        gram = flat @ flat.T - inner @ self.inverse @ inner.T
        return gram, flat @ self.r.reshape(-1) - inner @ self.solved

    def beside(self, held: NDArray) -> Beside:
        """Scores of single columns beside `held` (n_held, n_out, N), which may have any size."""
        return Beside(self, held)


def lengths(gram: NDArray) -> NDArray[np.float64]:
    """Lengths (n,) of columns with these products; infinite where rounding has left less than nothing, so that what is
    divided by them counts for nothing.
    """
    power = np.diag(gram)
    return np.where(power > 0, np.sqrt(np.maximum(power, 1e-300)), np.inf)


class Beside:
    """Scores of single columns beside held ones: what each removes of the objective that those leave."""

    def __init__(self, background: Background, held: NDArray) -> None:
        self.g, self.held = background, held
        self.inner = np.array([background._inner(c) for c in held])
        self.flat = held.reshape(held.shape[0], -1)
        gram = self.flat @ self.flat.T - self.inner @ background.inverse @ self.inner.T
        d = lengths(gram)
        self.solve = np.linalg.pinv(gram / np.outer(d, d), rcond=1e-10) / np.outer(d, d)
        self.along = self.flat @ background.r.reshape(-1) - self.inner @ background.solved
        self.gain = float(self.along @ self.solve @ self.along)

    def single(self, column: NDArray) -> tuple[float, float]:
        """Best amplitude of a column (n_out, N) and what it removes, that of the held ones included."""
        g = self.g
        inner = g._inner(column)
        cross = self.flat @ column.reshape(-1) - self.inner @ (g.inverse @ inner)
        whole = float(np.sum(column * column))
        size = whole - float(inner @ g.inverse @ inner) - float(cross @ self.solve @ cross)
        along = float(np.sum(column * g.r) - inner @ g.solved) - float(cross @ self.solve @ self.along)
        if size <= 1e-9 * whole:
            return 0.0, self.gain
        return along / size, self.gain + along**2 / size


def recover(
    joint: Joint, x: NDArray, point: Point, spot: Spot, orbits: Sequence[Orbit | None] | None = None
) -> Recovered:
    r"""Force at `spot` that best explains what the base model at `x` leaves of each run.

    .. math:: \hat F = \frac{h^H \Sigma^{-1} r}{h^H \Sigma^{-1} h + 1/S}, \quad z = z_0 U + G \hat F

    with S the force's own power around the line. Forces of laws that the joint holds (`orbits`) are known.
    """
    engine = joint.engine
    made: dict[tuple[int, float, float], Receptance] = {}
    for key in joint.bases:
        omega = 2 * np.pi * np.arange(key[0] // 2 + 1) * key[1] / key[0]
        columns = np.array([spot.column, *(t.column for t in joint.terms)]).T
        base = Base(engine, point, columns, omega, key[2])
        m = per_place(engine)
        own = joint.n_base - joint.k * m
        full = base.start()
        full[:own] = x[:own]
        full[own + m :] = x[own : joint.n_base]
        made[key] = base.at(full)
    forces, zs, vs, fs = [], [], [], []
    explained = total = 0.0
    for i, run in enumerate(joint.runs):
        r = made[run.key]
        orbit = orbits[i] if orbits is not None else None
        z, v, f, (force, kept, all_) = motion_of(run, r, orbit)
        explained += kept
        total += all_
        forces.append(force)
        zs.append(z)
        vs.append(v)
        fs.append(f)
    return Recovered(
        spot, explained / total if total > 0 else 0.0, tuple(forces), tuple(zs), tuple(vs), tuple(fs), made
    )


def motion_of(
    run: Run, r: Receptance, orbit: Orbit | None = None
) -> tuple[NDArray, NDArray, NDArray, tuple[NDArray, float, float]]:
    """Motion, speed and force (n,) at the first place of a receptance as the run shows them, `FINE` times its samples.

    Forces at its other places are known from `orbit`. Last the force's spectrum, and the power on detection lines that
    it explains and that there is, over noise.
    """
    drive = r.gain * run.u
    known, moved = r.plain * drive, r.z[0] * drive
    if orbit is not None:
        known = known + (r.h[:, 1:] * orbit.force).sum(axis=1)
        moved = moved + (r.g[0, 1:] * orbit.force).sum(axis=0)
    force, (kept, all_) = _one(run, r, run.y - r.lift * known)
    z = np.where(run.inside, run.seen(moved) + r.g[0, 0] * force, 0.0)
    n = run.period * FINE
    full = np.zeros((3, n // 2 + 1), precise(run))
    size = np.max(np.abs(force)) or 1.0  # single precision knows no forces of 1e30 N
    full[:, : z.size] = z / size, r.s * z / size, force / size
    time = np.asarray(irfft(full, axis=1), float) * (_unseen(run, n) * (size * n / 2))
    return time[0], time[1], time[2], (force, kept, all_)


RIDGE = 1e-3
"""Part of a force's own weight that is added where forces at several places are told apart for the first time."""


def motions_of(run: Run, r: Receptance) -> NDArray[np.float64]:
    """Motions, speeds and forces (n, k, 3) at all places of a receptance, which act together, as the run shows them.

    The forces are those that together explain best what the base leaves, each with its own power around the line as
    its prior: what two places explain alike they share.
    """
    drive = r.gain * run.u
    left, weight, _ = weighted(run, run.y - r.lift * (r.plain * drive))
    top, power = moments(r.lift[:, None] * r.h, weight, left)
    own = np.einsum("ncc->nc", power).real
    eye = np.eye(r.g.shape[0])
    least = np.maximum(own, 1e-12 * np.max(own, axis=0)) + 1e-300
    raw = np.linalg.solve(power + RIDGE * least[:, :, None] * eye, top[..., None])[..., 0]
    inside = run.inside.astype(float)
    felt = np.maximum(uniform_filter1d(own, 41, axis=0), 1e-300)
    spread = uniform_filter1d(np.abs(raw) ** 2 * own, 41, axis=0) / felt
    count = uniform_filter1d(inside, 41)[:, None]
    prior = np.maximum(spread - count / felt, 1e-3 * spread) + 1e-300
    force = np.linalg.solve(power + eye / prior[:, :, None], top[..., None])[..., 0].T * run.inside
    moved = run.seen(r.z * drive)
    z = np.where(run.inside, moved + (r.g * force).sum(axis=1), 0.0)
    n = run.period * FINE
    full = np.zeros((3, r.g.shape[0], n // 2 + 1), precise(run))
    size = np.max(np.abs(force)) or 1.0
    full[..., : z.shape[1]] = np.stack([z, r.s * z, force]) / size
    time = np.asarray(irfft(full, axis=2), float) * (_unseen(run, n) * (size * n / 2))
    return np.ascontiguousarray(np.moveaxis(time, (0, 2), (2, 0)))


def weighted(run: Run, left: NDArray) -> tuple[NDArray, NDArray, NDArray]:
    """Residuals (n_out, n_lines) as the run is seen, their weights, zero outside the band, and its quiet lines."""
    variance, quiet = _expected(run)
    left = run.seen(left)
    return left, _weight(left, variance, quiet) * run.inside, quiet


def moments(seen: NDArray, weight: NDArray, left: NDArray) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
    """h^H W r (n_lines, k) and h^H W h (n_lines, k, k) of responses `seen` (n_out, k, n_lines) to forces."""
    top = np.einsum("okn,on,on->nk", np.conj(seen), weight, left)
    rows = np.moveaxis(seen * np.sqrt(weight)[:, None], 2, 0)
    return top, np.conj(np.swapaxes(rows, 1, 2)) @ rows


def _weight(left: NDArray, variance: NDArray, quiet: NDArray) -> NDArray[np.float64]:
    """Weights (n_out, n_lines) of residuals: what is known of their variance, and a part of the power around them."""
    size = np.where(quiet, np.abs(left) ** 2, 0.0)
    beside = np.maximum(uniform_filter1d(quiet.astype(float), AROUND, mode="reflect"), 1e-9)
    around = np.maximum(uniform_filter1d(size, AROUND, axis=1, mode="reflect"), 0.0) / beside
    return 1.0 / np.maximum(variance + 0.03**2 * around, 1e-300)


ENDS = 0.1
"""Height of a window below which what it hides is not brought back."""


def window_of(run: Run, n: int, ends: bool = True) -> NDArray[np.float64]:
    """What the run's spectra are seen through, at n samples over its period; not `ends`: what they are taken with."""
    return _window(n, run.decay * run.period / run.rate, run.open and ends)


@lru_cache(maxsize=8)
def _window(n: int, fall: float, hann: bool) -> NDArray[np.float64]:
    """exp(-fall) at its end, or a Hann window, or none."""
    x = np.arange(n) / n
    out = np.sin(np.pi * x) ** 2 if hann else np.exp(-fall * x)
    out.setflags(write=False)
    return out


def _unseen(run: Run, n: int) -> NDArray[np.float64]:
    """What takes the window off again, zero where there is too little of it."""
    window = window_of(run, n)
    return 1.0 / window if run.decay else np.where(window < ENDS, 0.0, 1.0 / np.maximum(window, ENDS))


@lru_cache(maxsize=16)
def _expected(run: Run) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Variance of a run's residuals (n_out, n_lines) that is known beforehand, and its quiet lines."""
    inside, quiet = run.inside, run.quiet
    size = np.abs(run.y)
    noise = run.noise
    if not np.isfinite(noise).all():
        noise = np.full(size.shape, (1e-3 * np.sqrt(np.mean(size[:, inside] ** 2, axis=1, keepdims=True))) ** 2)
    if not run.lasting:
        size = np.sqrt(uniform_filter1d(np.abs(run.seen(run.y)) ** 2, 15, axis=1))
    return noise + np.where(run.excited, (0.01 * size) ** 2, 0.0), quiet if quiet.any() else inside


def _one(run: Run, r: Receptance, left: NDArray) -> tuple[NDArray[np.complex128], tuple[float, float]]:
    """Force spectrum at the first place, and the power on quiet lines that it explains and that there is."""
    inside = run.inside
    variance, quiet = _expected(run)
    top, power, all_ = weighed(left, r.lift, np.ascontiguousarray(r.h[:, 0]), variance, quiet, run.open)
    raw = np.where(inside, top / np.maximum(power, 1e-300), 0.0)
    felt = np.maximum(uniform_filter1d(np.where(inside, power, 0.0), 41), 1e-300)
    spread = uniform_filter1d(np.where(inside, np.abs(raw) ** 2 * power, 0.0), 41) / felt
    count = uniform_filter1d(inside.astype(float), 41)
    prior = np.maximum(spread - count / felt, 1e-3 * spread) + 1e-300
    force = np.where(inside, top / (power + 1.0 / prior), 0.0)
    kept = float(np.sum(np.abs(top[quiet]) ** 2 / np.maximum(power[quiet], 1e-300)))
    return force, (kept, all_)


def spectra_of(joint: Joint, series: Sequence[NDArray]) -> list[NDArray]:
    """Spectra, complex64, of a series in time for each run, (n,) on as many samples as the recovered motion has."""
    pairs = zip(joint.runs, series, strict=True)
    return [
        np.asarray(rfft((x * window_of(run, x.size)).astype(np.float32))) * np.float32(2 / x.size) for run, x in pairs
    ]


def through(joint: Joint, found: Recovered, spectra: Sequence[NDArray]) -> NDArray[np.float64]:
    """Whitened responses (n_out, N) to minus the forces with these spectra, a run each."""
    out = []
    for run, lines, phi in zip(joint.runs, joint.lines, spectra, strict=True):
        r = found.receptance[run.key]
        at = lines.at
        out.append(joint._real(-r.lift[:, at] * r.h[:, 0, at] * phi[at] / lines.sigma))
    return np.concatenate(out, axis=-1)


def spots(engine: Engine, site, rows_only: bool = False) -> list[Spot]:
    """Every translation of every free node against the ground, every motion of one node against its neighbour, of those
    that modes move by more than rounding.
    """
    from labnnum.mechanisms.base import ROTATIONS, TRANSLATIONS
    from labnnum.mechanisms.nonlinear_law import between

    out = []
    for node in site.free_nodes:
        for axis in TRANSLATIONS:
            column = site.rows(node, (axis,))
            if column.size:
                out.append(Spot(Place("ground", node), axis, column[:, 0]))
    for a, b in site.elements:
        if a in site.supports and not site.rows(a, TRANSLATIONS).size:
            continue
        if b in site.supports and not site.rows(b, TRANSLATIONS).size:
            continue
        for axis in (*TRANSLATIONS, *ROTATIONS):
            column = between(site, a, b, axis)
            if column is not None:
                out.append(Spot(Place("joint", a, b), axis, column[:, 0]))
    moved = [np.abs(s.column @ site.shape).max() / max(float(np.linalg.norm(s.column)), 1e-300) for s in out]
    return [s for s, much in zip(out, moved, strict=True) if much > ROUNDING * max(moved)]


ROUNDING = 1e-9
"""Part of the largest motion, or of what sensors see of a force, that rounding makes."""
