"""Leakage as part of the random error of a refinement: predicted by the model, shared between lines and responses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from labnnum.frf import Frf
from labnnum.leakage_error import LeakageError, leakage_error, noise_share
from labnnum.response import frf as response
from labnnum.structures.base import Structure
from labnnum.updating.seen import points_needed, view_settings

LAGS = 4
"""Lines to either side within which leakage correlates errors."""


@dataclass(frozen=True, eq=False)
class Leaked:
    """How much of the error is noise, and the covariance of the rest.

    Parameters
    ----------
    noise : ndarray, shape (n_out, 1, n_f)
        Variance by noise alone.
    error : LeakageError
        Covariance of what leaks, scaled to what is really there.
    """

    noise: NDArray[np.float64]
    error: LeakageError


def leaked(structure: Structure, theta: NDArray, frf: Frf, position: NDArray) -> Leaked | None:
    """Leakage in the error of an H1 estimate from one random input; None where there is none or it is not known.

    Parameters
    ----------
    structure : Structure
    theta : ndarray, shape (n_parameters,)
        Where the model is good enough to predict what leaks.
    frf : Frf
        Measured, on the lines that are fitted.
    position : ndarray of int, shape (n_f,)
        Numbers of these lines.
    """
    settings = view_settings(frf)
    random = settings and not settings.get("transient") and frf.estimator == "H1" and len(frf.inputs) == 1
    if not random or frf.variance is None or not frf.n_averages >= 2 or settings.get("window_decay"):
        return None
    error = leakage_error(
        lambda lines: response(structure, theta, lines, frf.outputs, frf.inputs)[:, 0],
        frf.frequency,
        window=settings["window"],
        n_segment=settings["n_segment"],
        rate=settings["rate"],
        overlap=settings.get("overlap", 0.0),
        n_averages=frf.n_averages,
        lags=LAGS,
        refine=min(points_needed(settings, structure, theta), 16),
    )
    noise, share = noise_share(np.asarray(frf.variance)[:, 0], error, frf.n_averages, position)
    both = np.sqrt(share[:, None] * share[None])
    scaled = LeakageError(share * error.power, both * error.covariance, both * error.pseudo)
    return Leaked(noise[:, None], scaled)


def leaked_score(slope: NDArray, error: LeakageError, position: NDArray) -> NDArray[np.float64]:
    r"""Covariance by leakage of the score Re sum_f conj(j_f) dH_f, shape (n_par, n_par).

    Parameters
    ----------
    slope : ndarray, shape (n_par, n_out, 1, n_f)
        j: slopes times weights.
    error : LeakageError
    position : ndarray of int, shape (n_f,)

    Notes
    -----
    .. math:: \tfrac12 \mathrm{Re} \sum_{f, g} \bar\jmath_f\, (C_{fg}\, j_g^T + P_{fg}\, \bar\jmath_g^T)

    with C = E[dH dH*] and the pseudo-covariance P = E[dH dH], which overlapping segments do not let vanish.
    """
    rows = slope[:, :, 0]
    total = np.zeros((len(rows), len(rows)))
    for lag in range(len(error.covariance)):
        first, second = pairs(position, lag)
        left = rows[..., first].conj()
        inner = np.einsum("opf,bpf->bof", error.covariance[lag][..., first], rows[..., second], optimize=True)
        inner += np.einsum("opf,bpf->bof", error.pseudo[lag][..., first], rows[..., second].conj(), optimize=True)
        share = np.einsum("aof,bof->ab", left, inner, optimize=True).real
        total += (share if lag == 0 else share + share.T) / 2
    return total


def pairs(position: NDArray, lag: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Numbers of the lines that lie `lag` steps apart."""
    at = np.searchsorted(position, position + lag)
    inside = np.flatnonzero(at < position.size)
    match = inside[position[at[inside]] == position[inside] + lag]
    return match, at[match]
