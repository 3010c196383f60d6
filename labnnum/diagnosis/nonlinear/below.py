"""Levels below the loudest one: where a strong law sends a structure far from its base, quieter runs show the way."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from labnnum.diagnosis.nonlinear.decision import NonlinearAnswer
from labnnum.diagnosis.nonlinear.records import LEVELS
from labnnum.diagnosis.observe import Observation

LOST = 5.0
"""Chi-square per value that a law leaves from which the loudest level may have hidden it."""


def lost(found: NonlinearAnswer) -> bool:
    """Whether what was found leaves so much that the loudest level may have misled the search."""
    return found.misfit > LOST and found.lying is None


def quieter_than(observations: Sequence[Observation]) -> float:
    """Level below which are all but the loudest ones; 0 where fewer than two levels are left."""
    known = [o.level for o in observations if np.isfinite(o.level)]
    most = max(known, default=0.0) / LEVELS
    below = [level for level in known if level < most]
    return most if below and max(below) > LEVELS * min(below) else 0.0


def under(observations: Sequence[Observation], most: float) -> list[Observation]:
    """Those whose level is below `most`."""
    return [o for o in observations if o.level < most]
