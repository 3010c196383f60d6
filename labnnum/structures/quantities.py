"""Physical quantities that are numbers or named parameters, and the damping models that all structures share."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from labnnum.eigen import natural_modes
from labnnum.errors import ConfigError, ModelError
from labnnum.parameters import Parameter

Quantity = float | str
"""A number in SI units, or the name of a parameter that holds it."""

DampingKind = Literal["none", "proportional", "modal", "structural", "matrix"]
DAMPING_KINDS: tuple[DampingKind, ...] = ("none", "proportional", "modal", "structural", "matrix")


class Values(Mapping[str, Any]):
    """Parameter values by name; `at(quantity)` is the number that a quantity stands for (complex where theta is)."""

    def __init__(self, parameters: Sequence[Parameter], theta: NDArray) -> None:
        self._held = {p.name: theta[j] for j, p in enumerate(parameters)}

    def __getitem__(self, name: str) -> Any:
        return self._held[name]

    def __iter__(self) -> Any:
        return iter(self._held)

    def __len__(self) -> int:
        return len(self._held)

    def at(self, quantity: Quantity) -> Any:
        """The number itself, or the value of the parameter of that name."""
        return self._held[quantity] if isinstance(quantity, str) else quantity

    def array(self, quantities: Sequence[Quantity]) -> NDArray:
        """Numbers of several quantities, shape (n,)."""
        return np.array([self.at(q) for q in quantities])


@dataclass(frozen=True, slots=True)
class Damping:
    """How a structure loses energy, besides its dashpots.

    Parameters
    ----------
    kind : {"none", "proportional", "modal", "structural", "matrix"}
        "proportional": C = alpha M + beta K. "modal": C = M Phi diag(2 zeta omega) Phi^T M about the nominal modes.
        "structural": D = eta K. "matrix": the structure brings its own C, nothing is added.
    alpha, beta, eta : float or str
        1/s, s and 1; a name stands for a parameter.
    ratio : tuple of float or str
        Modal damping ratios; modes beyond the last take its value.
    """

    kind: DampingKind = "none"
    alpha: Quantity = 0.0
    beta: Quantity = 0.0
    eta: Quantity = 0.0
    ratio: tuple[Quantity, ...] = ()

    def __post_init__(self) -> None:
        if self.kind not in DAMPING_KINDS:
            raise ConfigError(f"damping kind {self.kind!r} is not one of {', '.join(DAMPING_KINDS)}")
        object.__setattr__(self, "ratio", tuple(self.ratio))
        if self.kind == "modal" and not self.ratio:
            raise ConfigError("modal damping needs ratio: one number, or one for each mode")
        for name in ("alpha", "beta", "eta"):
            _require_loss(name, getattr(self, name))
        for ratio in self.ratio:
            _require_loss("ratio", ratio)

    @property
    def quantities(self) -> tuple[Quantity, ...]:
        """Quantities that this kind uses."""
        used = {"proportional": (self.alpha, self.beta), "structural": (self.eta,), "modal": self.ratio}
        return used.get(self.kind, ())

    def viscous(self, values: Values, mass: NDArray, stiffness: NDArray, basis: NDArray | None) -> NDArray | float:
        """Contribution to C at these values; `basis` is `modal_basis` of the nominal structure for modal damping."""
        if self.kind == "proportional":
            return values.at(self.alpha) * mass + values.at(self.beta) * stiffness
        if self.kind == "modal":
            if basis is None:
                raise ModelError("modal damping needs the basis of the nominal modes")
            ratios = values.array(self.ratio)
            given = ratios[np.minimum(np.arange(basis.shape[1]), ratios.size - 1)]
            return (basis * (2 * given)) @ basis.T
        return 0.0

    def loss(self, values: Values, stiffness: NDArray) -> NDArray:
        """Contribution to D at these values."""
        return values.at(self.eta) * stiffness if self.kind == "structural" else np.zeros_like(stiffness)


def proportional(alpha: Quantity = 0.0, beta: Quantity = 0.0) -> Damping:
    """Damping with C = alpha M + beta K."""
    return Damping("proportional", alpha=alpha, beta=beta)


def modal(*ratio: Quantity) -> Damping:
    """Damping with these modal damping ratios about the nominal modes; the last one serves all further modes."""
    return Damping("modal", ratio=ratio)


def structural(eta: Quantity) -> Damping:
    """Damping with D = eta K."""
    return Damping("structural", eta=eta)


def modal_basis(mass: NDArray, stiffness: NDArray) -> NDArray[np.float64]:
    """M Phi diag(sqrt(omega)), shape (n, n_modes), so that basis diag(2 zeta) basis^T is the modal damping matrix."""
    omega2, phi = natural_modes(mass, stiffness)
    return (mass @ phi) * omega2**0.25


def check_names(owner: str, parameters: Sequence[Parameter], quantities: Iterable[Quantity]) -> None:
    """ConfigError if a quantity names no parameter, two parameters share a name, or one is used by nothing."""
    names = [p.name for p in parameters]
    if len(set(names)) < len(names):
        raise ConfigError(f"two parameters are named {next(n for n in names if names.count(n) > 1)!r}")
    used = {q for q in quantities if isinstance(q, str)}
    for name in sorted(used - set(names)):
        raise ConfigError(f"{owner} refers to parameter {name!r}, which is not declared: add a [[parameter]] entry")
    for name in names:
        if name not in used:
            raise ConfigError(f"parameter {name!r} is used by nothing in the {owner}: name it where it acts")


def _require_loss(name: str, quantity: Quantity) -> None:
    if not isinstance(quantity, str) and not (np.isfinite(quantity) and quantity >= 0):
        raise ConfigError(f"damping {name} = {quantity!r}: expected a number >= 0 or a parameter's name")
