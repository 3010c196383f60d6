"""The model as the estimator's window sees it, built from the settings that an Frf carries."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from labnnum import leakage
from labnnum.frf import Frf
from labnnum.response import poles
from labnnum.structures.base import Structure


class View(Protocol):
    """How an estimator's window sees a model: `labnnum.leakage.WindowView` or anything like it."""

    frequency: NDArray
    """Fine grid, in Hz, on which the model is wanted."""

    def apply(self, fine: NDArray) -> NDArray:
        """FRFs on the data's lines, (..., n_f), from those on the fine grid."""
        ...


KEYS = ("window", "n_segment", "overlap", "rate", "window_decay", "transient", "pretrigger")
"""Settings of an Frf that decide how it sees a structure and how its lines share their error."""

NEEDED = ("window", "n_segment", "rate")
"""Settings without which nothing is known of a window."""


def view_settings(frf: Frf) -> dict[str, Any]:
    """The settings of an Frf that its window's view of a model depends on; empty where none applies.

    Whole periods ("periodic") and whole bursts ("burst") do not leak, whatever was estimated from them.
    """
    if frf.settings.get("periodic") or frf.settings.get("burst") or any(frf.settings.get(k) is None for k in NEEDED):
        return {}
    return {k: frf.settings[k] for k in KEYS if k in frf.settings}


def view_of(frf: Frf, structure: Structure | None = None, theta: ArrayLike | None = None) -> View | None:
    """How the window that made an Frf sees a model, on the Frf's lines; None where the FRF is free of leakage.

    With a structure and its parameters the fine grid is as dense as its slowest pole needs.
    """
    return view_like(view_settings(frf), frf.frequency, structure, theta)


def view_like(
    settings: Mapping[str, Any],
    frequency: NDArray[np.float64],
    structure: Structure | None = None,
    theta: ArrayLike | None = None,
) -> View | None:
    """The view that `settings` describe, on the lines `frequency`; None where no window is named."""
    points = 8 if structure is None else points_needed(settings, structure, theta)
    return leakage.view_of(settings, frequency, refine=points)


def points_needed(settings: Mapping[str, Any], structure: Structure, theta: ArrayLike | None = None) -> int:
    """Fine points a line that the slowest oscillation of the structure needs, 4 to 64; 8 where no window is named."""
    if any(settings.get(k) is None for k in NEEDED):
        return 8
    found = poles(structure, structure.nominal if theta is None else theta)
    found = found[np.imag(found) > 0]
    return leakage.refine_for(found, settings, share=1e-3) if found.size else 8
