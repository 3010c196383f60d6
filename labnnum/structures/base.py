"""What every structure offers: matrices, where its coordinates move its points, and how they vary."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from labnnum.errors import ModelError
from labnnum.parameters import Parameter, nominal
from labnnum.recording import Channel

STEP = 1e-200
"""Complex step; small enough that its square vanishes."""


@dataclass(frozen=True, eq=False)
class Matrices:
    """M, C, K and the structural damping matrix D of Z(omega) = K + iD + i omega C - omega^2 M, each (n, n)."""

    M: NDArray
    C: NDArray
    K: NDArray
    D: NDArray

    def dynamic_stiffness(self, omega: NDArray) -> NDArray[np.complex128]:
        """Z(omega), shape (n_f, n, n)."""
        w = np.asarray(omega, float)[:, None, None]
        return (self.K + 1j * self.D) + 1j * w * self.C - w**2 * self.M


class Structure(ABC):
    """A linear structure with parameters: returns its equation's matrices and nothing else.

    Coordinates u (n) obey M u'' + C u' + (K + iD) u = sum_j participation(dof_j) f_j. The motion at a degree of
    freedom is participation(dof) @ u. Under base excitation u is relative to the base, the load is
    -base_load() a_base, M rigid() and held_load() unless overridden, and absolute motion adds that of the base.

    `matrices`, `participation` and `rigid` must be analytic in theta and accept complex theta: derivatives are
    taken by the complex step, exact to rounding (Squire and Trapp, 1998).
    """

    @property
    @abstractmethod
    def parameters(self) -> tuple[Parameter, ...]:
        """Parameters that may be updated, in the order of theta."""

    @property
    @abstractmethod
    def dofs(self) -> tuple[str, ...]:
        """Degrees of freedom that can be measured or driven, as "node:direction"."""

    @abstractmethod
    def matrices(self, theta: NDArray) -> Matrices:
        """M, C, K, D at parameter values theta, shape (n_parameters,)."""

    @abstractmethod
    def participation(self, dof: str, theta: NDArray) -> NDArray:
        """Row p, shape (n,): motion at `dof` is p @ u. ModelError if the structure has no such degree of freedom."""

    @property
    def nodes(self) -> Mapping[str, tuple[float, float, float]]:
        """Node name -> x, y, z in m; empty where there is no geometry."""
        return {}

    @property
    def elements(self) -> tuple[tuple[str, str], ...]:
        """Pairs of nodes that an element joins."""
        return ()

    @property
    def supports(self) -> tuple[str, ...]:
        """Nodes that are clamped or carried."""
        return ()

    def released(self, node: str) -> Structure | None:
        """The same structure with the support at `node` let go; None where nothing is held there."""
        return None

    @property
    def base(self) -> str:
        """Direction in which all supports move together under base excitation; empty for force excitation."""
        return ""

    def rigid(self, theta: NDArray) -> NDArray:
        """Coordinates u, shape (n,), when the structure follows a unit motion of the base."""
        raise ModelError(f"{type(self).__name__} has no base excitation")

    def base_load(self, theta: NDArray) -> NDArray:
        """Mass, shape (n,), by which a unit acceleration of the base loads the coordinates, with a minus sign."""
        return self.matrices(theta).M @ self.rigid(theta) + self.held_load(theta)

    def held_load(self, theta: NDArray) -> NDArray:
        """Mass, shape (n,), that joins the coordinates to what the supports hold, times how that moves with the base.

        M is of the coordinates that are free; a consistent mass matrix couples them to those that are not, and what
        moves with the base there pushes as well: of a beam of six elements 2 % of its second mode's load, 8 % of its
        third's. It goes to nothing as elements become small.
        """
        return np.zeros(len(self.rigid(theta)))

    def chain(self, channel: Channel, frequency: NDArray, theta: NDArray) -> NDArray[np.complex128]:
        """Factor of the measurement chain on a channel, shape (n_f,); 1 unless a channel fault is modelled."""
        return np.ones(frequency.shape, complex)

    def chain_derivatives(self, channel: Channel, frequency: NDArray, theta: NDArray) -> NDArray[np.complex128]:
        """Derivative of `chain` to each parameter, shape (n_parameters, n_f)."""
        return np.zeros((len(self.parameters), frequency.size), complex)

    @property
    def nominal(self) -> NDArray[np.float64]:
        """Nominal parameter values, shape (n_parameters,)."""
        return nominal(self.parameters)

    def derivatives(self, theta: NDArray) -> tuple[Matrices, ...]:
        """Exact derivatives of the matrices to each parameter (complex step)."""
        out = []
        for j in range(len(self.parameters)):
            m = self.matrices(_stepped(theta, j))
            out.append(Matrices(*(np.imag(a) / STEP for a in (m.M, m.C, m.K, m.D))))
        return tuple(out)

    def participation_derivatives(self, dof: str, theta: NDArray) -> NDArray[np.float64]:
        """Exact derivatives of `participation`, shape (n_parameters, n)."""
        rows = [np.imag(self.participation(dof, _stepped(theta, j))) / STEP for j in range(len(self.parameters))]
        return np.array(rows).reshape(len(rows), np.size(self.participation(dof, theta)))

    def rigid_derivatives(self, theta: NDArray) -> NDArray[np.float64]:
        """Exact derivatives of `rigid`, shape (n_parameters, n)."""
        rows = [np.imag(self.rigid(_stepped(theta, j))) / STEP for j in range(len(self.parameters))]
        return np.array(rows).reshape(len(rows), np.size(self.rigid(theta)))

    def base_load_derivatives(self, theta: NDArray) -> NDArray[np.float64]:
        """Exact derivatives of `base_load`, shape (n_parameters, n)."""
        rows = [np.imag(self.base_load(_stepped(theta, j))) / STEP for j in range(len(self.parameters))]
        return np.array(rows).reshape(len(rows), np.size(self.rigid(theta)))

    def require_dof(self, dof: str) -> int:
        """Number of `dof` among `dofs`; ModelError that lists what there is."""
        try:
            return self.dofs.index(dof)
        except ValueError:
            shown = ", ".join(self.dofs[:12]) + (", ..." if len(self.dofs) > 12 else "")
            raise ModelError(f"the model has no degree of freedom {dof!r}; it has {shown}") from None


def _stepped(theta: NDArray, j: int) -> NDArray[np.complex128]:
    out = np.array(theta, complex)
    out[j] += 1j * STEP
    return out
