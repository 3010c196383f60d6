"""Models fitted to natural frequencies alone: parameters with their priors, and one mechanism of the catalogue."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh
from scipy.optimize import least_squares

from labnnum.errors import ModelError
from labnnum.mechanisms import CATALOGUE, ExtendedStructure, Term
from labnnum.mechanisms.extended import Added, site_of
from labnnum.response import modes
from labnnum.structures.base import Structure
from sessions.model import Model

STRAINLESS = 1e-6
"""Share of the highest frequency below which a motion is one of a rigid body, and its frequency rounding."""
SUSPENDED = 0.5
"""Share of the lowest measured frequency below which a rigid body that a term holds swings, unmeasured."""


@dataclass(frozen=True, eq=False)
class ModalFit:
    """A model fitted to natural frequencies.

    `theta` and `value` are the parameters of the structure and of the added term with the standard deviations `std` of
    both; `missing` (n_modes,) what is left, measured over model less 1; `chi2` the squared weighted misfit, priors
    included; `predicted` (n_modes,) the misfit of each mode when the fit sees only the others.
    """

    term: Term | None
    theta: NDArray[np.float64]
    value: NDArray[np.float64]
    std: NDArray[np.float64]
    missing: NDArray[np.float64]
    chi2: float
    predicted: NDArray[np.float64]

    @property
    def held_out(self) -> float:
        """Relative RMS error of modes that the fit did not see."""
        return float(np.sqrt(np.mean(self.predicted**2)))


def frequencies(
    structure: Structure, term: Term | None, x: NDArray, count: int, rigid: int = 0, floor: float = 0.0
) -> NDArray[np.float64]:
    """Lowest natural frequencies in Hz at the structure's parameters, then the term's; NaN where it is unstable.

    Rigid-body motions are no modes of a table and are left out: of a structure with a term up to `rigid` of the lowest,
    also where the term makes them swing below `floor` Hz.
    """
    if term is None:
        found = modes(structure, x).frequency
        return _filled(found[found > 0], count)
    m = ExtendedStructure(structure, (Added(term, term.parameters),)).matrices(x)
    try:
        value = np.asarray(eigh(np.real(m.K), np.real(m.M), eigvals_only=True))
    except np.linalg.LinAlgError:
        return np.full(count, np.nan)
    rounding = STRAINLESS**2 * value[-1]
    lowest = value[:rigid]
    still = (lowest >= -rounding) & (lowest <= max(rounding, (2 * np.pi * floor) ** 2))
    value = np.delete(value, np.flatnonzero(still))
    return _filled(np.sqrt(np.where(value > 0, value, np.nan)) / (2 * np.pi), count)


def rigid_modes(structure: Structure) -> int:
    """How many motions a structure has without strain, at its nominal parameters."""
    return int(np.count_nonzero(modes(structure, structure.nominal).frequency == 0))


def _filled(found: NDArray, count: int) -> NDArray[np.float64]:
    """The first `count`, NaN where there are not so many."""
    return np.pad(found[:count], (0, max(count - found.size, 0)), constant_values=np.nan)


def fit_modes(structure: Structure, term: Term | None, measured: NDArray, sigma: NDArray) -> ModalFit:
    """Parameters (with their priors) and a term's values that fit natural frequencies best.

    Parameters
    ----------
    measured : ndarray, shape (n_modes,)
        Hz.
    sigma : ndarray, shape (n_modes,)
        Relative standard deviation: of the mean, and of what an ordinary model misses.

    Raises
    ------
    ModelError
        If the structure has fewer modes than were measured.
    """
    has = int(np.isfinite(frequencies(structure, None, structure.nominal, measured.size)).sum())
    if has < measured.size:
        raise ModelError(
            f"{measured.size} natural frequencies were measured, but the model has only {has} modes that strain it"
        )
    every = np.ones(measured.size, bool)
    x, cost, std = best_fit(structure, term, measured, sigma, every)
    n = len(structure.parameters)
    told = (rigid_modes(structure), SUSPENDED * measured[0])
    missing = measured / frequencies(structure, term, x, measured.size, *told) - 1
    predicted = []
    for i in range(measured.size):
        others = every.copy()
        others[i] = False
        y = best_fit(structure, term, measured, sigma, others, x)[0]
        predicted.append(measured[i] / frequencies(structure, term, y, measured.size, *told)[i] - 1)
    return ModalFit(term, x[:n], x[n:], std, missing, cost, np.array(predicted))


def best_fit(
    structure: Structure,
    term: Term | None,
    measured: NDArray,
    sigma: NDArray,
    used: NDArray,
    start: NDArray | None = None,
) -> tuple[NDArray, float, NDArray]:
    """Parameters, chi2 and standard deviations of the best fit to the modes `used`, from every start of the term."""
    own = structure.parameters
    low = np.array([p.lower for p in own] + [p.lower for p in (term.parameters if term else ())])
    high = np.array([p.upper for p in own] + [p.upper for p in (term.parameters if term else ())])
    starts = [np.concatenate([structure.nominal, s]) for s in (term.starts if term else [np.empty(0)])]
    if start is not None:
        starts = [start]
    spread, size = np.array([p.spread for p in own]), np.abs(np.array(starts)).max(axis=0)
    size = np.where(size > 0, size, 1.0)

    rigid, floor = rigid_modes(structure), SUSPENDED * measured[0]

    def residual(y: NDArray) -> NDArray[np.float64]:
        found = frequencies(structure, term, y * size, measured.size, rigid, floor)
        wrong = np.where(np.isfinite(found), np.log(measured / found), 10.0) / sigma
        return np.concatenate([wrong[used], (y[: len(own)] * size[: len(own)] - structure.nominal) / spread])

    found = []
    for x in starts:
        inside = np.clip(x, low + 1e-9 * (high - low), high - 1e-9 * (high - low)) / size
        found.append(least_squares(residual, inside, bounds=(low / size, high / size), x_scale="jac"))
    best = min(found, key=lambda f: f.cost)
    std = np.linalg.norm(np.linalg.pinv(best.jac, rcond=3e-8), axis=1)
    return best.x * size, 2 * float(best.cost), std * size


def candidates(model: Model) -> list[Term]:
    """Terms of the catalogue with one parameter that move natural frequencies and add no motion of their own."""
    structure, places = model.structure, model.places
    site = site_of(structure)
    out = []
    for term in (t for m in CATALOGUE if m.domain in ("linear", "modal") for t in m.terms(site)):
        if term.n != 1 or not term.starts.size or not _allowed(term, places):
            continue
        extended = ExtendedStructure(structure, (Added(term, term.parameters),))
        there = extended.matrices(np.concatenate([structure.nominal, term.starts[-1]]))
        base = structure.matrices(structure.nominal)
        if there.M.shape == base.M.shape and not (np.allclose(there.M, base.M) and np.allclose(there.K, base.K)):
            out.append(term)
    return out


def _allowed(term: Term, places: Any) -> bool:
    kind, name, to = term.place.kind, term.place.id, term.place.to
    if kind in ("node", "ground") and places.nodes is not None:
        return name in places.nodes
    if kind in ("element", "joint") and places.elements is not None:
        return {name, to} in [set(e) for e in places.elements]
    return kind != "support" or places.supports is None or name in places.supports
