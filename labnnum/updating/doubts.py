"""Reasons to doubt a refinement, each one line for the user."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from labnnum.errors import EstimationError
from labnnum.parameters import Parameter
from labnnum.updating.covariance import confusions
from labnnum.updating.modal_data import modal_data, model_modal_data
from labnnum.updating.problem import Problem

_SHIFT = 0.005
"""Relative distance between a measured resonance and the model's that is worth a warning."""


def misfit(level: float, widening: float) -> str:
    """That the residuals exceed the random error, and what became of the standard deviations."""
    return (
        f"misfit: the model leaves {level:.3g} times the random error (chi2); it lacks some physics, or a sensor is"
        f" wrong; standard deviations are widened {np.sqrt(widening):.3g} times"
    )


def roughness(level: float = 0.0, line: float = 0.0) -> str:
    """That no variance was stated, and how large the model's own errors were found to be."""
    text = "the FRF carries no variance: its noise was estimated from its roughness"
    if line > 0:
        text += (
            f"; misfit: a model error of {100 * level:.2g} % in the level of each FRF and {100 * line:.2g} % from line"
            " to line explains the rest"
        )
    return text


def shifts(problem: Problem, theta: NDArray) -> list[str]:
    """Resonances that the model puts elsewhere than the data, where the bands show one."""
    try:
        measured = modal_data(problem.frf, problem.bands)
        model = model_modal_data(problem.structure, theta, measured)[0]
    except EstimationError:  # no peak inside a band: there is nothing to compare
        return []
    n = model.size // 2
    shift = model[:n] / measured.values[:n] - 1
    worst = int(np.abs(shift).argmax())
    if np.abs(shift[worst]) < _SHIFT:
        return []
    where = "above" if shift[worst] > 0 else "below"
    size = 100 * abs(shift[worst])
    return [f"the model's resonance near {model[worst]:.4g} Hz lies {size:.2g} % {where} the measured one"]


def not_converged(steps: int) -> str:
    """That the steps ran out."""
    return f"not converged after {steps} steps: start closer, or check the bounds"


def confused(problem: Problem, covariance: NDArray) -> list[str]:
    """Parameters that the data leave open, alone or against each other."""
    out = []
    for size, names in confusions(covariance, problem.structure.parameters):
        what = (
            f"hardly determine {names[0]}"
            if len(names) == 1
            else f"cannot tell {', '.join(names[:-1])} and {names[-1]} apart"
        )
        out.append(f"the data {what}: {100 * size:.0f} % of the prior's spread is left open")
    return out


def at_bounds(parameters: Sequence[Parameter], theta: NDArray) -> list[str]:
    """Parameters that stopped at a bound."""
    return [
        f"{p.name} ended at its bound {v:g} {p.unit}: widen it, or look for missing physics"
        for p, v in zip(parameters, theta, strict=True)
        if min(v - p.lower, p.upper - v) <= 1e-9 * (p.upper - p.lower)
    ]
