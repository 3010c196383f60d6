"""Search over the catalogue: which terms are worth a full fit, by two cheap and exact-in-part scores.

`grid_score`: from the nominal structure, with the resonances broadened so far that a shifted peak still overlaps
its old place, the objective of every term on a grid of sizes, the model's ordinary errors profiled out.
`direction_score`: at the fitted base, on the lines themselves, how much of the objective a small step along each
term's signature removes (the score test, projected off the parameters and errors).
The first finds gross faults, the second faint ones; both keep the best of each place and mechanism.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from labnnum.diagnosis.engine import Engine
from labnnum.diagnosis.objective import Problem
from labnnum.diagnosis.point import Point
from labnnum.diagnosis.scatter import Data, Scatter
from labnnum.diagnosis.sweep import sweep
from labnnum.mechanisms.base import Term


@dataclass(frozen=True, eq=False)
class Lead:
    """A term worth a full fit, from parameters `start`, with the gain in the objective that the score promised."""

    term: Term
    start: NDArray[np.float64]
    gain: float
    others: tuple[NDArray[np.float64], ...] = ()
    """Further starts worth a try, best first, each far from those before it."""


def _inverse_root(gram: NDArray) -> NDArray[np.float64]:
    """W (rows, n, n) with W W^T the inverse of gram (rows, n, n), whose eigenvalues are one at least.

    Beside entries of 1e8, as on a resonance without damping, rounding leaves some of them below.
    """
    size, axes = np.linalg.eigh(gram)
    return axes / np.sqrt(np.maximum(size, 1.0))[:, None, :]


class Profile:
    """The objective about one point with every ordinary error profiled out linearly."""

    def __init__(self, engine: Engine, data: Data, scatter: Scatter, x: NDArray, terms: Sequence[Term] = ()) -> None:
        self.problem = Problem(engine, data, terms, scatter)
        self.x = x
        r, b, c, own, moved = self.problem._parts(x, jacobian=True)
        assert own is not None
        j = np.concatenate([c, own], axis=2)
        k = c.shape[2]
        gram = np.matmul(b.transpose(0, 2, 1), b) + np.eye(b.shape[2])
        self.u = np.matmul(b, _inverse_root(gram))  # rows, 2f, nb
        self.j = j - np.matmul(self.u, np.matmul(self.u.transpose(0, 2, 1), j))
        prior = self.problem._prior
        offsets = self.problem._with_offsets(x, moved) if k else np.zeros((x.size + 1, x.size + 1))
        a = np.matmul(j.transpose(0, 2, 1), self.j).sum(0) + np.diag(np.concatenate([np.ones(k), prior]))
        a += offsets[:-1, :-1]
        scale = np.concatenate([np.sqrt(np.diag(a)[:k]), self.problem.scale(a[k:, k:])])
        self.scale = scale
        self.a_inverse = np.linalg.inv(a / np.outer(scale, scale) + 1e-12 * np.eye(scale.size))
        self.pull = np.concatenate([np.zeros(k), -prior * (x - self.problem.mean)]) + offsets[:-1, -1]
        self.r = r
        self.constant = float(np.sum(prior * (x - self.problem.mean) ** 2) + offsets[-1, -1])

    def rows(self, value: NDArray) -> NDArray[np.float64]:
        """Complex (n, o, i, f) to whitened real (rows, n, 2 f)."""
        return self.problem.whitened(value).transpose(1, 0, 2)

    def project(self, r: NDArray) -> tuple[NDArray, NDArray]:
        """u-part removed (rows, n, 2 f) and the gradient to the explicit errors (n, n_x)."""
        free = r - np.matmul(np.matmul(r, self.u), self.u.transpose(0, 2, 1))
        return free, np.matmul(r, self.j).sum(0)

    def objective(self, r: NDArray) -> NDArray[np.float64]:
        """Profiled objective of residuals r (rows, n, 2 f), shape (n,)."""
        free, g = self.project(r)
        g = (g + self.pull) / self.scale
        return np.einsum("rnf,rnf->n", r, free) + self.constant - np.einsum("nx,xy,ny->n", g, self.a_inverse, g)

    def gains(self, directions: NDArray) -> tuple[NDArray, NDArray]:
        """Gain of the best step along each direction (rows, n, 2 f), and the step, shapes (n,)."""
        free, g = self.project(directions)
        g = g / self.scale
        _, g0 = self.project(self.r[:, None])
        g0 = (g0[0] + self.pull) / self.scale
        size = np.einsum("rnf,rnf->n", directions, free) - np.einsum("nx,xy,ny->n", g, self.a_inverse, g)
        along = np.einsum("rf,rnf->n", self.r, free) - g @ self.a_inverse @ g0
        scale = np.einsum("rnf,rnf->n", directions, directions)
        ok = size > 1e-9 * np.maximum(scale, 1e-300)
        step = np.where(ok, along / np.where(ok, size, 1.0), 0.0)
        return np.where(ok, along * step, 0.0), step

    def joint_gain(self, directions: NDArray) -> float:
        """Gain of the best step in the space of the directions (rows, n, 2 f)."""
        free, g = self.project(directions)
        g = g / self.scale
        _, g0 = self.project(self.r[:, None])
        g0 = (g0[0] + self.pull) / self.scale
        a = np.einsum("rnf,rmf->nm", directions, free, optimize=True) - g @ self.a_inverse @ g.T
        along = np.einsum("rf,rnf->n", self.r, free) - g @ self.a_inverse @ g0
        size = np.sqrt(np.maximum(np.einsum("rnf,rnf->n", directions, directions), 1e-300))
        value, vector = np.linalg.eigh(a / np.outer(size, size))
        seen = value > 1e-9 * max(float(value[-1]), 1e-300)
        return float(np.sum((vector.T @ (along / size))[seen] ** 2 / value[seen]))


def broaden(engine: Engine, data: Data, point: Point, terms: Sequence[Term], kappa: float, n: int = 120) -> Data:
    """The data with every resonance broadened to a relative half-width `kappa`, on `n` logarithmic lines.

    H(sigma + i omega) is the Poisson integral of H(i nu); it is applied to the difference from the model at `point`,
    which dies out at the ends of the band, and the model there is evaluated exactly. How far the sum over the lines
    misses the model's own integral goes into `sigma`.
    """
    nu = data.s.imag
    omega = np.geomspace(nu[0] if nu[0] > 0 else nu[1], nu[-1], n)
    model = engine.response(point, terms, data.s).value
    weight = np.gradient(nu)
    half = kappa * omega[:, None]
    kernel = half / np.pi / (half**2 + (omega[:, None] - nu) ** 2) * weight
    mirror = half / np.pi / (half**2 + (omega[:, None] + nu) ** 2) * weight
    s = omega * (1j + kappa) + data.s.real.mean()
    exact = engine.response(point, terms, s).value
    value = exact + (data.value - model) @ kernel.T + np.conj(data.value - model) @ mirror.T
    quadrature = np.abs(model @ kernel.T + np.conj(model) @ mirror.T - exact)
    noise = np.sqrt(data.sigma**2 @ (kernel.T**2))
    size = np.maximum(np.abs(value), np.abs(exact))
    typical = np.median(size, axis=2, keepdims=True)
    sigma = np.sqrt(noise**2 + quadrature**2 + (0.01 * size) ** 2 + (0.003 * typical) ** 2)
    return Data(s, value, sigma, data.lead)


def thin(data: Data, n: int = 160) -> Data:
    """About `n` of the lines, each standing for its neighbours: `sigma` smaller by the root of what was left out."""
    if data.s.size < 1.5 * n:
        return data
    pick = ((np.arange(n) + 0.5) * data.s.size / n).astype(int)
    s = data.s[pick]
    return Data(s, data.value[..., pick], data.sigma[..., pick] * np.sqrt(s.size / data.s.size), data.lead)


def probes(term: Term) -> NDArray[np.float64]:
    """Few of the term's starts: of each sign and each set of further parameters the faintest and a middling one."""
    if term.n == 0 or len(term.starts) < 3:
        return term.starts
    groups: dict[tuple, list[int]] = {}
    for i in np.argsort(np.abs(term.starts[:, 0]), kind="stable"):
        p = term.starts[i]
        groups.setdefault((bool(p[0] < 0), *p[1:]), []).append(int(i))
    return term.starts[[i for g in groups.values() for i in g[:3:2]]]


def grid_score(
    engine: Engine, data: Data, scatter: Scatter, terms: Sequence[Term], x: NDArray, held: Sequence[Term] = ()
) -> list[Lead]:
    """Best start and gain of every term on its grid, about `x` of the model with `held` (see the module's text)."""
    profile = Profile(engine, data, scatter, x, held)
    point = profile.problem.start.with_vector(x)
    base = float(profile.objective(profile.r[:, None])[0])
    leads = []
    for term in terms:
        if term.data.get("extra_mode"):
            leads.append(_mode_lead(engine, profile, term, data, point, held))
            continue
        value = sweep(engine, point, term, term.starts, data.s, held)
        objective = profile.objective(profile.rows(data.value[None] - value))
        order = _apart(term.starts, np.argsort(objective, kind="stable"))
        best = order[0]
        others = tuple(term.starts[i] for i in order[1:])
        leads.append(Lead(term, term.starts[best], base - float(objective[best]), others))
    return leads


def _apart(starts: NDArray, order: NDArray, n: int = 4) -> list[int]:
    """The first `n` of `order` whose starts differ from each other by more than a factor of three in some parameter."""
    size = np.log(np.maximum(np.abs(starts), 1e-300))
    kept: list[int] = []
    for i in order:
        ratios = [np.where(starts[i] * starts[j] < 0, np.inf, np.abs(size[i] - size[j])) for j in kept]
        if all(r.size and r.max() > np.log(3.1) for r in ratios):
            kept.append(int(i))
        if len(kept) == n:
            break
    return kept


def direction_score(
    engine: Engine, data: Data, scatter: Scatter, terms: Sequence[Term], x: NDArray, held: Sequence[Term] = ()
) -> list[Lead]:
    """Best start and gain of every term by the projected score test at the fitted `x` of the model with `held`."""
    profile = Profile(engine, data, scatter, x, held)
    point = profile.problem.start.with_vector(x)
    plain = engine.response(point, held, data.s).value
    leads = []
    for term in terms:
        if term.data.get("extra_mode"):
            leads.append(_mode_lead(engine, profile, term, data, point, held))
            continue
        starts = probes(term)
        value = sweep(engine, point, term, starts, data.s, held)
        gain, step = profile.gains(profile.rows(value - plain))
        gain = np.where(step > (0.0 if term.n else 0.3), gain, 0.0)
        best = int(np.argmax(gain))
        start = starts[best].copy()
        if term.n:
            first = term.parameters[0]
            start[0] = np.clip(start[0] * min(max(step[best], 1e-3), 3.0), first.lower, first.upper)
        leads.append(Lead(term, start, float(gain[best])))
    return leads


def subspace_score(
    engine: Engine, data: Data, scatter: Scatter, terms: Sequence[Term], x: NDArray, held: Sequence[Term] = ()
) -> list[Lead]:
    """Gain of the best step in all parameters of a term together, at the fitted `x` of the model with `held`.

    For laws without a name, whose parameters are coefficients: one of them alone may promise nothing where together
    they explain everything. Each lead starts from zero, where a fit finds that step by itself.
    """
    profile = Profile(engine, data, scatter, x, held)
    point = profile.problem.start.with_vector(x)
    plain = engine.response(point, held, data.s).value
    leads = []
    for term in terms:
        sizes = np.array([1e-6 * np.abs(term.starts[:, k]).max(initial=0.0) for k in range(term.n)])
        sizes = np.where(sizes > 0, sizes, 1e-6 * np.abs(term.starts).max())
        value = sweep(engine, point, term, np.diag(sizes), data.s, held)
        gain = profile.joint_gain(profile.rows((value - plain) * 1e6))
        leads.append(Lead(term, np.zeros(term.n), gain))
    return leads


def _mode_lead(engine: Engine, profile: Profile, term: Term, data: Data, point: Point, held: Sequence[Term]) -> Lead:
    """An added mode: its residues follow linearly at each trial frequency, row by row."""
    free = profile.r - np.einsum("rfn,rn->rf", profile.u, np.einsum("rfn,rf->rn", profile.u, profile.r))
    lift = engine.response(point, held, data.s, modal=True).lift
    n_o = len(engine.outputs)
    best, start = -1.0, term.starts[0].copy()
    for p in term.starts:
        w = 2 * np.pi * p[0]
        d = 1.0 / (w**2 + 2 * p[1] * w * data.s + data.s**2)
        column = profile.rows((d * lift)[None])[:, 0]
        size = np.einsum("rf,rf->r", column, column)
        step = np.einsum("rf,rf->r", column, free) / size
        inner = np.einsum("rfn,rf->rn", profile.u, column)
        real = np.maximum(size - np.einsum("rn,rn->r", inner, inner), 1e-9 * size)
        along = np.einsum("rf,rf->r", column, free)
        gain = float(np.sum(along**2 / real))
        if gain > best:
            best = gain
            start = p.copy()
            start[2:] = step.reshape(n_o, -1).mean(axis=1)
    return Lead(term, start, best - 4.0 * n_o)


def shortlist(leads: Sequence[Lead], n: int, counts: Mapping[str, int] | None = None) -> list[Lead]:
    """The best of every mechanism, and up to `n` leads the best of the rest, three a mechanism at most.

    They are ranked by what they gain beyond their parameters, and beyond luck in as many terms as a mechanism has.
    Scores are rough: the right mechanism may stand behind ten others, and only a fit tells.
    """
    counts = counts or {}

    def net(x: Lead) -> float:
        return x.gain - 4.0 * x.term.n - 2.0 * float(np.log(counts.get(x.term.mechanism.id, 1)))

    worth = sorted((x for x in leads if x.gain > 3.0 * x.term.n), key=lambda x: -net(x))
    first: dict[str, Lead] = {}
    for lead in worth:
        first.setdefault(lead.term.mechanism.id, lead)
    out = list(first.values())[: n - 2 if not counts else None]
    for lead in worth:
        if len(out) >= n:
            break
        alike = sum(x.term.mechanism.id == lead.term.mechanism.id for x in out)
        if alike < 3 and not any(x is lead for x in out):
            out.append(lead)
    return out
