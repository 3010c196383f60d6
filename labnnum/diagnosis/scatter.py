"""Ordinary errors: what a sound model and bench differ by, and the data that they belong to."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class Scatter:
    """Standard deviations of the errors that a sound model and bench have.

    `frequency`, `residue`, `shape`, `gain`: relative; `damping`: of the logarithm; `phase`: of a channel, in rad, both
    constant and growing to that much at the top of the band; `complexity`: imaginary part of a shape; `remainder`:
    relative, of what modes outside the band contribute; `floor`: relative residual that nothing explains;
    `suspension`: relative change of a free structure's rigid-body response at the lowest line; `offset`: what a
    channel's offset leaves of a hit at the lowest line, of its row's median; `cords`: rate at which a free body's
    motions die out, over its first elastic frequency; `stiffness`, `mass`, `loss`, `zone`: relative, of each
    element, of each node's mass, of each element's loss, and of the loss of what one parameter scales.
    """

    frequency: float = 0.003
    damping: float = 0.5
    residue: float = 0.02
    shape: float = 0.015
    gain: float = 0.015
    phase: float = 0.01
    complexity: float = 0.01
    remainder: float = 0.1
    floor: float = 0.003
    suspension: float = 0.1
    offset: float = 0.1
    cords: float = 0.02
    stiffness: float = 0.01
    mass: float = 0.02
    loss: float = 0.1
    zone: float = 0.4
    common: NDArray[np.float64] | None = field(default=None, compare=False, repr=False)
    """Directions (n_parts, k) of the structure's own irregularity marginalised (`irregular`); None for none."""
    rows: NDArray[np.float64] | None = field(default=None, compare=False, repr=False)
    """The floor of each response (n_out, n_in), where they differ; None for `floor` everywhere."""
    trim: float = 0.0
    """Where positive, frequencies and loads are free within so many standard deviations and nothing is marginalised:
    a model as it would be used, trimmed within what a sound one needs."""


@dataclass(frozen=True, eq=False)
class Data:
    """Measured FRFs `value` (n_out, n_in, n_f) at complex frequencies `s` (n_f,) with standard deviation `sigma`.

    `sigma`, the shape of `value`, is the root of E|error|^2 over real and imaginary part together.
    """

    s: NDArray[np.complex128]
    value: NDArray[np.complex128]
    sigma: NDArray[np.float64]
    lead: float = 0.0
    """How many seconds before the blow the records of hits begin: there an offset begins that was not taken off."""

    def with_floor(self, floor: float | NDArray) -> Data:
        """The same with a relative error, one or (n_out, n_in), added to `sigma`: of values and of rows' medians."""
        floor = np.asarray(floor, float)[..., None]
        size = np.abs(self.value)
        typical = np.median(size, axis=2, keepdims=True)
        sigma = np.sqrt(self.sigma**2 + (floor * size) ** 2 + (0.3 * floor * typical) ** 2)
        return replace(self, sigma=sigma)
