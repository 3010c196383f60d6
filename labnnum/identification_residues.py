r"""Poles and complex residues of measured FRFs, with residual terms and standard deviations.

.. math:: H(s) = s^q \left[\sum_k \frac{r_k}{s - p_k} + \frac{\bar r_k}{s - \bar p_k} + \sum_j e_j s^j\right]

q is 0 for displacements and 2 for accelerations. What modes outside the band leave is a short series in s: inertia and
stiffness, s^-2 and 1, first, and as many more terms as the FRFs ask for. Poles are common to all responses and follow
by Gauss-Newton steps on the maximum likelihood cost; residues and residual terms are linear and are eliminated
(variable projection). What the sum misses beyond the stated noise is estimated with it, even over the lines of a
response, and counts as noise; where none is stated, the fit is plain least squares on responses over their RMS.

References
----------
P. Guillaume, P. Verboven, S. Vanlanduit, "Frequency-domain maximum likelihood identification of modal parameters with
confidence intervals", ISMA 23, 1998.
L. Kaufman, "A variable projection method for solving separable nonlinear least squares problems", BIT 15, 1975.
G. Schwarz, "Estimating the dimension of a model", Annals of Statistics 6, 1978 (how many residual terms).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import qr, solve_triangular
from scipy.optimize import brentq

from labnnum.errors import EstimationError
from labnnum.frf import MOTION_ORDER, Frf

TERMS = ((-2, 0), (-2, -1, 0, 1), (-4, -3, -2, -1, 0, 1, 2, 3))
"""Powers of s of the residual terms that are tried."""
ROUNDS, STEPS = 6, 40
"""Estimates of what is missed beyond noise, and Gauss-Newton steps for each, at most."""
SETTLED = 1e-6
"""What a further step promises to take off chi-square, below which the poles have settled."""
WAY = 0.5, 2.0
"""How far a pole may go: its frequency by so many times the line spacing and damping together, log of its damping."""


@dataclass(frozen=True, eq=False)
class PoleResidues:
    """Poles, residues and residual terms of FRFs with one input.

    Attributes
    ----------
    frequency, damping_ratio : ndarray, shape (n_modes,)
        |p| in Hz, and -Re p / |p|.
    frequency_std, damping_std : ndarray, shape (n_modes,)
        Standard deviations of both, of the noise and of what the sum misses as if it were noise.
    residue : ndarray, shape (n_modes, n_out)
        Complex residues of displacement per force, m/(N s), along the axes of the places.
    residue_std : ndarray, shape (n_modes, n_out)
        Standard deviation of each, E|dr|^2 taken over real and imaginary part together.
    powers : tuple of int
        Powers of s of the residual terms.
    residual : ndarray, shape (n_powers, n_out)
        Their real coefficients.
    fitted : ndarray, shape (n_out, n_f)
        The FRFs that they make, as they were measured.
    lack : ndarray, shape (n_out,)
        RMS of what is missed beyond the stated noise, over the RMS of the FRF.
    error : float
        Relative RMS error over the responses.
    """

    frequency: NDArray[np.float64]
    damping_ratio: NDArray[np.float64]
    frequency_std: NDArray[np.float64]
    damping_std: NDArray[np.float64]
    residue: NDArray[np.complex128]
    residue_std: NDArray[np.float64]
    powers: tuple[int, ...]
    residual: NDArray[np.float64]
    fitted: NDArray[np.complex128]
    lack: NDArray[np.float64]
    error: float

    @property
    def poles(self) -> NDArray[np.complex128]:
        """Poles with positive imaginary part, 1/s, shape (n_modes,)."""
        return _poles(np.log(self.omega), np.log(self.damping_ratio))

    @property
    def omega(self) -> NDArray[np.float64]:
        """|p| in rad/s, shape (n_modes,)."""
        return 2 * np.pi * self.frequency

    @property
    def collinearity(self) -> NDArray[np.float64]:
        """Modal phase collinearity of the residues, shape (n_modes,): 1 where all are in phase, as of real modes.

        That of J. N. Juang and R. S. Pappa (1985) without the mean taken off, so that it is 1 for one response.
        """
        re, im = self.residue.real, self.residue.imag
        a, b, c = (re**2).sum(axis=1), (im**2).sum(axis=1), (re * im).sum(axis=1)
        return ((a - b) ** 2 + 4 * c**2) / np.maximum(a + b, 1e-300) ** 2


def fit_residues(frf: Frf, poles: NDArray, terms: Sequence[Sequence[int]] = TERMS) -> PoleResidues:
    """Maximum likelihood poles, residues and residual terms of FRFs with one input.

    Parameters
    ----------
    frf : Frf
        One input; lines cut to the band of interest. Its variance weighs the lines where it is stated.
    poles : ndarray, shape (n_modes, 2)
        Frequencies in Hz and damping ratios to begin with, from a stabilisation diagram.
    terms : sequence of sequences of int
        Powers of s of the residual terms that are tried; the set of the least Bayesian information criterion is taken.

    Raises
    ------
    EstimationError
        If there are several inputs, no pole, or fewer lines than a response has unknowns.
    """
    if len(frf.inputs) != 1:
        raise EstimationError(f"residues are fitted to FRFs with one input, not {len(frf.inputs)}")
    poles = np.asarray(poles, float).reshape(-1, 2)
    if not len(poles):
        raise EstimationError("residues need at least one pole to begin with")
    problem = _Problem.of(frf)
    few = [t for t in terms if 2 * problem.s.size > 2 * len(poles) + len(t) + 2]
    if not few:
        raise EstimationError(
            f"{problem.s.size} lines are too few for {len(poles)} modes and their residual terms: widen the band"
        )
    found = [_search(problem, poles, tuple(t)) for t in few]
    return min(found, key=lambda f: f.criterion).answer(frf, problem)


# -------------------------------------------------------------------- one set of residual terms


@dataclass(frozen=True, eq=False)
class _Problem:
    """Lines s (n_f,), FRFs (n_out, n_f) over their RMS `scale`, their variance; derivatives and signs of responses."""

    s: NDArray[np.complex128]
    value: NDArray[np.complex128]
    variance: NDArray[np.float64]
    rise: NDArray[np.int64]
    scale: NDArray[np.float64]
    sign: NDArray[np.float64]

    @classmethod
    def of(cls, frf: Frf) -> _Problem:
        use = frf.frequency > 0
        value = frf.value[:, 0, use]
        scale = np.sqrt(np.mean(np.abs(value) ** 2, axis=1, keepdims=True))
        scale = np.where(scale > 0, scale, 1.0)
        variance = np.zeros(value.shape) if frf.variance is None else frf.variance[:, 0, use]
        rise = np.array([MOTION_ORDER[c.quantity] for c in frf.outputs])
        sign = np.array([c.sign for c in frf.outputs]) * frf.inputs[0].sign
        return cls(
            np.array(1j * frf.omega[use], complex),
            value / scale,
            variance / scale**2,
            rise,
            scale[:, 0],
            sign.astype(float),
        )

    def basis(self, p: NDArray, powers: tuple[int, ...], rise: int) -> NDArray[np.complex128]:
        """Columns of real and imaginary parts of residues, then of residual terms, (n_f, 2 n_modes + n_powers)."""
        s = self.s[:, None]
        plus, minus = 1 / (s - p), 1 / (s - p.conj())
        middle = np.abs(self.s).mean()
        series = [(s / middle) ** j for j in powers]
        return s**rise * np.concatenate([plus + minus, 1j * (plus - minus), *series], axis=1)

    def slope(self, p: NDArray, change: NDArray, r: NDArray, rise: int) -> NDArray[np.complex128]:
        """Derivative (n_f, n) to something that changes poles p (n,) with residues r (n,) by `change` (n,)."""
        s = self.s[:, None]
        return s**rise * (r * change / (s - p) ** 2 + (r * change).conj() / (s - p.conj()) ** 2)


def _poles(log_omega: NDArray, log_zeta: NDArray) -> NDArray[np.complex128]:
    zeta = np.minimum(np.exp(log_zeta), 0.999)
    return np.exp(log_omega) * (-zeta + 1j * np.sqrt(1 - zeta**2))


@dataclass(frozen=True, eq=False)
class _Round:
    """Cost, linear unknowns, left-over and normal equations at some poles with some variance."""

    cost: float
    linear: NDArray[np.float64]
    left: NDArray[np.complex128]
    curvature: NDArray[np.float64]
    gradient: NDArray[np.float64]
    linear_std: NDArray[np.float64]
    follows: NDArray[np.float64]
    tangents: NDArray[np.float64]
    residual: NDArray[np.float64]
    leverage: NDArray[np.float64]


def _at(problem: _Problem, x: NDArray, powers: tuple[int, ...], variance: NDArray) -> _Round:
    n = x.size // 2
    p, zeta = _poles(x[:n], x[n:]), np.exp(x[n:])
    bent = np.exp(x[:n]) * zeta * (-1 - 1j * zeta / np.sqrt(1 - np.minimum(zeta, 0.999) ** 2))
    curvature, gradient, cost = np.zeros((2 * n, 2 * n)), np.zeros(2 * n), 0.0
    out: list[tuple[NDArray, ...]] = []
    for row, v, rise in zip(problem.value, variance, problem.rise, strict=True):
        weight = np.sqrt(2 / v)[:, None]
        basis = problem.basis(p, powers, rise)
        a, b = _real(basis * weight), _real(row[:, None] * weight)[:, 0]
        size = np.linalg.norm(a, axis=0)
        q, r = qr(a / size, mode="economic")
        y = solve_triangular(r, q.T @ b)
        unknown = y / size
        e = b - q @ (q.T @ b)
        residue = unknown[:n] + 1j * unknown[n : 2 * n]
        g = np.concatenate([problem.slope(p, p, residue, rise), problem.slope(p, bent, residue, rise)], axis=1)
        g = _real(g * weight)
        inside = q.T @ g
        g = g - q @ inside
        curvature += g.T @ g
        gradient += g.T @ e
        cost += float(e @ e)
        spread = np.linalg.norm(solve_triangular(r, np.eye(len(r))), axis=1) / size
        follows = solve_triangular(r, inside) / size[:, None]
        out.append((unknown, row - basis @ unknown, spread, follows, g, e, np.sum(q**2, axis=1)))
    linear, left, spread, follows, tangents, residual, leverage = (np.array(a) for a in zip(*out, strict=True))
    return _Round(cost, linear, left, curvature, gradient, spread, follows, tangents, residual, leverage)


def _real(a: NDArray) -> NDArray[np.float64]:
    return np.concatenate([a.real, a.imag])


@dataclass(frozen=True, eq=False)
class _Found:
    """Poles as logarithms of |p| and damping ratio, the last round there, and what counts against it."""

    x: NDArray[np.float64]
    powers: tuple[int, ...]
    at: _Round
    missed: NDArray[np.float64]
    criterion: float

    def answer(self, frf: Frf, problem: _Problem) -> PoleResidues:
        n = self.x.size // 2
        covariance = _covariance(self.at)
        std = np.sqrt(np.diag(covariance))
        order = np.argsort(self.x[:n])
        unit = (problem.scale * problem.sign)[:, None]
        linear = self.at.linear * unit
        spread = np.sqrt(
            self.at.linear_std**2 + np.einsum("oij,jk,oik->oi", self.at.follows, covariance, self.at.follows)
        ) * np.abs(unit)  # fmt: skip
        residue = (linear[:, :n] + 1j * linear[:, n : 2 * n]).T[order]
        residue_std = np.hypot(spread[:, :n], spread[:, n : 2 * n]).T[order]
        middle = np.abs(problem.s).mean()
        residual = linear[:, 2 * n :].T / middle ** np.array(self.powers)[:, None]
        frequency, zeta = np.exp(self.x[:n]) / (2 * np.pi), np.exp(self.x[n:])
        fitted = np.array(frf.value[:, 0])
        fitted[:, frf.frequency > 0] -= self.at.left * problem.scale[:, None]
        return PoleResidues(
            frequency[order], zeta[order], (frequency * std[:n])[order], (zeta * std[n:])[order], residue, residue_std,
            self.powers, residual, fitted, self.missed, float(np.sqrt(np.mean(np.abs(self.at.left) ** 2))),
        )  # fmt: skip


def _covariance(at: _Round) -> NDArray[np.float64]:
    """Covariance of the poles' unknowns: by the stated noise, and no less than by how lines differ from one another.

    The second is the sandwich form with residuals over one less their leverage (MacKinnon and White 1985, HC3), which
    holds where what is left grows with the response.
    """
    stated = np.linalg.pinv(at.curvature, hermitian=True)
    leverage = at.leverage + np.einsum("oij,jk,oik->oi", at.tangents, stated, at.tangents)
    score = at.tangents * (at.residual / np.maximum(1 - leverage, 0.1))[..., None]
    seen = stated @ np.einsum("oij,oik->jk", score, score) @ stated
    rise = np.sqrt(np.maximum(np.diag(seen) / np.maximum(np.diag(stated), 1e-300), 1.0))
    return stated * np.outer(rise, rise)


def _search(problem: _Problem, poles: NDArray, powers: tuple[int, ...]) -> _Found:
    x = np.concatenate([np.log(2 * np.pi * poles[:, 0]), np.log(poles[:, 1])])
    n, n_f = len(poles), problem.s.size
    step = float(np.median(np.diff(np.abs(problem.s)))) if n_f > 1 else 0.0
    reach = WAY[0] * (4 * poles[:, 1] + 4 * step / np.exp(x[:n]))
    low, high = (x + sign * np.concatenate([reach, np.full(n, WAY[1])]) for sign in (-1, 1))
    missed = _missed(problem, _at(problem, x, powers, np.ones(problem.value.shape)).left, n, len(powers))
    for _ in range(ROUNDS):
        variance = problem.variance + missed[:, None] ** 2
        x, at = _settled(problem, x, powers, variance, low, high)
        before, missed = missed, _missed(problem, at.left, n, len(powers))
        if np.abs(missed - before).max() <= 1e-3 * max(missed.max(), 1e-12):
            break
    count = 2 * n + problem.rise.size * (2 * n + len(powers))
    criterion = 2 * float(np.sum(np.log(variance))) + at.cost + count * np.log(2 * problem.value.size)
    return _Found(x, powers, at, missed, criterion)


def _settled(
    problem: _Problem, x: NDArray, powers: tuple[int, ...], variance: NDArray, low: NDArray, high: NDArray
) -> tuple[NDArray[np.float64], _Round]:
    """Poles of the least cost near x, by steps that are shortened until they lower it."""
    here, damping = _at(problem, x, powers, variance), 1e-3
    for _ in range(STEPS):
        diagonal = np.diag(here.curvature)
        short = here.curvature + damping * np.diag(np.maximum(diagonal, 1e-12 * diagonal.max()))
        wanted = np.clip(x + np.linalg.solve(short, here.gradient), low, high)
        if here.gradient @ (wanted - x) < SETTLED:
            break
        there = _at(problem, wanted, powers, variance)
        if there.cost <= here.cost:
            x, here, damping = wanted, there, max(damping / 10, 1e-12)
        else:
            damping *= 10
            if damping > 1e8:
                break
    return x, here


def _missed(problem: _Problem, left: NDArray, n: int, terms: int) -> NDArray[np.float64]:
    """RMS (n_out,), beside the noise, with which what is left of each response is as large as expected.

    Where no noise is stated it is the same of all responses: the one that happens to fit best must not set the poles.
    """
    out = []
    for e, v in zip(np.abs(left) ** 2, problem.variance, strict=True):
        free = e.size - (2 * n + terms) / 2 - n / len(left)

        def over(square: float, e: NDArray = e, v: NDArray = v, free: float = free) -> float:
            return float(np.sum(e / (v + square))) - free

        floor, top = 1e-24, 4 * float(e.mean()) + 1e-24
        out.append(np.sqrt(floor if over(floor) <= 0 else brentq(over, floor, max(top, e.sum() / max(free, 1e-9)))))
    return np.array(out) if problem.variance.any() else np.full(len(out), np.sqrt(np.mean(np.square(out))))
