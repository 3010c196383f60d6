"""Structures known by their modes only: frequencies, damping ratios and shapes, or poles and residues."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import final

import numpy as np
from numpy.typing import NDArray

from labnnum.errors import ConfigError, ModelError
from labnnum.parameters import Parameter
from labnnum.structures.base import Matrices, Structure
from labnnum.structures.quantities import Quantity, Values, check_names


@dataclass(frozen=True, slots=True)
class Mode:
    """One mode.

    Parameters
    ----------
    frequency : float or str
        Hz, or the name of a parameter; 0 for a rigid-body mode.
    damping_ratio : float or str
        1, or the name of a parameter.
    shape : mapping
        "node:direction" -> mass-normalised shape there, 1/sqrt(kg) (or its rotation), or the name of a parameter.
    """

    frequency: Quantity
    damping_ratio: Quantity
    shape: Mapping[str, Quantity]


@final
@dataclass(frozen=True, eq=False)
class ModalStructure(Structure):
    r"""Sum of modes: the receptance between two places is sum phi_i phi_j / (omega^2 - w^2 + 2i zeta omega w).

    Coordinates are the modal ones (M = 1). Modes below and above the band enter as `flexibility`, the residual
    receptance that a massless spring adds, and as a rigid-body mode (frequency 0).

    Parameters
    ----------
    modes : sequence of Mode
    flexibility : mapping
        "node:direction" -> residual receptance of that place with itself, m/N and positive, or a parameter's name.
    parameters : sequence of Parameter
    positions : mapping
        Node -> x, y, z in m; optional.
    error : float
        What modes that were identified miss of their own FRFs beyond noise, relative; 0 if they were not.

    Examples
    --------
    >>> one = ModalStructure((Mode(10.0, 0.01, {"1:x": 2.0}),))
    >>> one.dofs
    ('1:x',)
    """

    modes: tuple[Mode, ...]
    flexibility: Mapping[str, Quantity] = field(default_factory=dict)
    parameters: tuple[Parameter, ...] = ()
    positions: Mapping[str, tuple[float, float, float]] = field(default_factory=dict)
    error: float = 0.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "modes", tuple(self.modes))
        object.__setattr__(self, "parameters", tuple(self.parameters))
        if not self.modes:
            raise ConfigError("a modal structure needs at least one mode")
        known = set(self.modes[0].shape)
        for i, mode in enumerate(self.modes, 1):
            if set(mode.shape) != known:
                odd = ", ".join(sorted(set(mode.shape) ^ known))
                raise ConfigError(f"mode {i}: its shape must name the same places as mode 1's; it differs at {odd}")
        for dof in self.flexibility:
            if dof not in known:
                raise ConfigError(f"flexibility at {dof!r}: no mode shape has this place")
        quantities = [q for m in self.modes for q in (m.frequency, m.damping_ratio, *m.shape.values())]
        check_names("modal structure", self.parameters, [*quantities, *self.flexibility.values()])

    @property
    def dofs(self) -> tuple[str, ...]:
        """Places that the shapes name."""
        return tuple(self.modes[0].shape)

    @property
    def nodes(self) -> Mapping[str, tuple[float, float, float]]:
        """Positions if they were given."""
        return self.positions

    def matrices(self, theta: NDArray) -> Matrices:
        """Modal M = 1, C and K, then a massless coordinate for each residual flexibility."""
        values = Values(self.parameters, theta)
        omega = 2 * np.pi * values.array([m.frequency for m in self.modes])
        damping = 2 * omega * values.array([m.damping_ratio for m in self.modes])
        spare = self._residual(values)
        mass = np.diag(np.r_[np.ones(omega.size), np.zeros(spare.size)])
        stiffness = np.diag(np.r_[omega**2, spare])
        viscous = np.diag(np.r_[damping, np.zeros(spare.size)])
        return Matrices(mass, viscous, stiffness, np.zeros_like(stiffness))

    def participation(self, dof: str, theta: NDArray) -> NDArray:
        """The shapes at `dof`, then its flexibility: a coordinate of stiffness q that moves the place by q."""
        self.require_dof(dof)
        values = Values(self.parameters, theta)
        shapes = values.array([m.shape[dof] for m in self.modes])
        return np.r_[shapes, self._residual(values) * [d == dof for d in self.flexibility]]

    def _residual(self, values: Values) -> NDArray:
        found = values.array(list(self.flexibility.values()))
        if not (np.real(found) > 0).all():
            raise ModelError("a residual flexibility must be positive: leave it out where there is none")
        return found


def from_residues(
    poles: Sequence[complex], residues: Mapping[str, Sequence[complex]], drive: str, tolerance: float = 0.1
) -> ModalStructure:
    """Modal structure of poles and residues of one driven place.

    Parameters
    ----------
    poles : sequence of complex, length n
        With positive imaginary part, 1/s.
    residues : mapping
        Place -> residues of its receptance to a force at `drive`, H = sum r/(s - p) + conj; `drive` must be among them.
    tolerance : float
        Largest share of a residue that may be out of phase with a real mode before the modes are called complex.

    Raises
    ------
    ConfigError
        If a pole does not decay, or the residues belong to complex modes.
    """
    p = np.asarray(poles, complex)
    decay, speed = -np.real(p), np.imag(p)
    if not ((decay > 0) & (speed > 0)).all():
        raise ConfigError("each pole needs a negative real and a positive imaginary part")
    if drive not in residues:
        raise ConfigError(f"the residues lack the driven place {drive!r}")
    scaled = {d: 2j * speed * np.asarray(r, complex) for d, r in residues.items()}
    own = scaled[drive]
    if (np.real(own) <= 0).any():
        raise ConfigError(f"a residue of the driven place {drive!r} has the wrong sign: check the force's direction")
    for dof, r in scaled.items():
        if (np.abs(np.imag(r)) > tolerance * np.maximum(np.abs(r), 1e-3 * np.abs(own))).any():
            raise ConfigError(f"the residues at {dof!r} belong to complex modes; a modal structure has real ones")
    root = np.sqrt(np.real(own))
    modes = tuple(
        Mode(
            float(abs(p[k]) / (2 * np.pi)),
            float(decay[k] / abs(p[k])),
            {d: float(np.real(r[k]) / root[k]) for d, r in scaled.items()},
        )
        for k in range(p.size)
    )
    return ModalStructure(modes)
