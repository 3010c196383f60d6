"""What a model that was identified with the sensors it is judged by has wrong."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from labnnum.diagnosis.engine import Engine
from labnnum.diagnosis.nonlinear.fitting import Made
from labnnum.diagnosis.observe import Observation
from labnnum.diagnosis.scatter import Scatter
from labnnum.structures.modal import ModalStructure

OWN = Scatter(
    frequency=0.01, damping=1.0, residue=0.2, shape=1e-4, gain=1e-5, phase=1e-5, complexity=1e-5, remainder=1e-3,
    floor=3e-4, stiffness=0.0, mass=0.0,
)  # fmt: skip
"""Ordinary errors of such a model."""
NEARLY = 1 / 3
"""Part of the base's held-out error, to which a law must bring it down, for what is left to be no objection where the
base was identified and misses its own data: it has no physics that the law could contradict."""
LEAST = 1e-3
"""What any identified base misses at least, RMS over the lines of a response, relative: errors then weigh as they do in
a simulated response, and not line by line."""


def own_scatter(error: float) -> Scatter:
    """Errors of a model that was identified with the sensors it is judged by, and missed its own data by `error`."""
    return replace(
        OWN, shape=max(OWN.shape, error / 2), remainder=max(OWN.remainder, 2 * error), floor=max(OWN.floor, error / 2)
    )


def settled(engine: Engine, made: Made) -> ModalStructure | None:
    """The identified structure with its modes where a law's fit has put them: at the quietest level, where they were
    identified, the law moved and damped them already. None where a parameter of the model says where a mode lies.
    """
    base = engine.structure
    assert isinstance(base, ModalStructure)
    if any(isinstance(q, str) for mode in base.modes for q in (mode.frequency, mode.damping_ratio)):
        return None
    n, m = engine.theta0.size, engine.band_modes.size
    order = np.argsort([float(mode.frequency) for mode in base.modes], kind="stable")
    modes = list(base.modes)
    for i, shift, log_zeta in zip(order[engine.band_modes], made.x[n : n + m], made.x[n + m : n + 2 * m], strict=True):
        frequency = float(modes[i].frequency) * (1.0 + float(shift))
        modes[i] = replace(modes[i], frequency=frequency, damping_ratio=float(np.exp(log_zeta)))
    return replace(base, modes=tuple(modes))


def missing(o: Observation, error: float) -> Observation:
    """The observation with what an identified base is known to miss."""
    return o if o.run is None else replace(o, run=replace(o.run, miss=error))
