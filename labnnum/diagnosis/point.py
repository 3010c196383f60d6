"""What a fit varies, the structure's modes at one value of it, and the responses there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class State:
    """The structure's modes at one parameter value.

    `omega` (m,) in rad/s; `out` (m, n_out), `load` (m, n_in) modal participations of sensors and inputs; `span` (n, m)
    shapes; per parameter the derivatives of log frequency `d_log` (n_par, m), of the shapes as a mix of the shapes
    `mix` (n_par, m, m), of the loads `d_load` (n_par, m, n_in) and of the sensors `d_out` (n_par, m, n_out).
    `high_out` (n_out, h) and `high_in` (n_in, h): shares of the modes above the basis. With base motion `rigid` (n,)
    is its influence and `rigid_out` (n_out,) what the sensors move with it; `sensors` (n_out, n) and `drives`
    (n_in, n) are the participations.
    """

    theta: NDArray
    omega: NDArray
    shape: NDArray
    out: NDArray
    load: NDArray
    d_log: NDArray
    mix: NDArray
    d_load: NDArray
    d_out: NDArray
    high_out: NDArray
    high_in: NDArray
    rigid: NDArray
    rigid_out: NDArray
    sensors: NDArray
    drives: NDArray


@dataclass(frozen=True, eq=False)
class Point:
    """Everything that may vary in a fit: parameters of the structure, of the terms, and of each band mode."""

    theta: NDArray
    terms: NDArray
    shift: NDArray
    """Relative offset of each band mode's frequency, (m_b,)."""
    log_zeta: NDArray
    """Logarithm of each band mode's damping ratio, (m_b,)."""
    size: NDArray
    """Offset of each band mode's load, relative to a typical one, (m_b,)."""
    law: NDArray
    """Share of the modal damping that is hysteretic rather than viscous, 0 to 1; of a free structure also how quickly
    its rigid-body motions die out, over the first elastic frequency: (1,) or (2,)."""

    def vector(self) -> NDArray:
        """All in one vector, in the order above."""
        return np.concatenate([self.theta, self.terms, self.shift, self.log_zeta, self.size, self.law])

    def with_vector(self, x: NDArray) -> Point:
        """The point that `x` describes, lengths as here."""
        a = self.theta.size
        b = a + self.terms.size
        c = b + self.shift.size
        d = c + self.log_zeta.size
        e = d + self.size.size
        return Point(x[:a], x[a:b], x[b:c], x[c:d], x[d:e], x[e:])


@dataclass(frozen=True, eq=False)
class Response:
    """FRFs (n_out, n_in, n_f) with, where asked for, derivatives and the modal motions that shape errors scale."""

    value: NDArray
    jacobian: NDArray | None = None
    """(n_x, n_out, n_in, n_f), in the order of `Point.vector`."""
    modal: NDArray | None = None
    """(m_b, n_in, n_f): response of each band mode."""
    modal_out: NDArray | None = None
    """(m_b, n_out, n_f)."""
    lift: NDArray | None = None
    """(n_out, n_in, n_f): factor from displacement to what each channel reads."""
    rest: NDArray | None = None
    """(n_out, n_in, n_f): displacement that modes outside the band contribute."""
    rigid: NDArray | None = None
    """(n_out, n_in, n_f): displacement of the rigid-body modes; None where the structure has none."""
    other_modal: NDArray | None = None
    """(m_o, n_in, n_f): response of each mode outside the band, as if it moved by its largest participation."""
    common: NDArray | None = None
    """(k, n_out, n_in, n_f): change of the FRFs along each direction of the structure's own irregularity."""
    moved: NDArray | None = None
    """(k, m_b): relative changes of the band modes' frequencies along each of them."""
