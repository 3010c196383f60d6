"""Mechanism: a term of missing physics; Place: where it may act; Term: one mechanism bound to one place.

A linear mechanism says which motions it acts on (columns) and by which scalar law; a channel mechanism by which
factor it changes a channel; a modal mechanism how it changes or adds a mode. With its parameters at zero each
exerts exactly nothing, so models nest and before and after compare fairly.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from labnnum.mechanisms.changes import Change
from labnnum.mechanisms.laws import Law
from labnnum.parameters import Parameter

PlaceKind = Literal["node", "element", "joint", "ground", "support", "channel", "global", "system"]


@dataclass(frozen=True, slots=True)
class Place:
    """Where something acts: a node, the element or joint between two nodes, a support, a channel, or all of it."""

    kind: PlaceKind
    id: str
    to: str | None = None

    def as_dict(self) -> dict[str, str | None]:
        """As `diagnosis.json` holds it."""
        return {"kind": self.kind, "id": self.id, "to": self.to}

    def touches(self, other: Place) -> bool:
        """Whether the two are one place, whatever acts there: the same node or channel, or the same two nodes."""
        mine, theirs = {self.id, self.to} - {None}, {other.id, other.to} - {None}
        return mine == theirs and (self.kind == "channel") == (other.kind == "channel")

    def __str__(self) -> str:
        if self.kind in ("global", "system"):
            return "the whole structure"
        return f"{self.kind} {self.id}" + (f"-{self.to}" if self.to is not None else "")


@dataclass(frozen=True, eq=False)
class Group:
    """Columns of motion that share one law and its parameters."""

    law: Law
    columns: NDArray[np.float64]
    """Shape (n, k): the motions wᵀu that the law acts on."""

    first: int
    """Number of the law's first parameter among the term's."""

    gain: NDArray[np.float64] | None = None
    """Relative change of the model's stiffness there with each parameter of the structure, (n_theta,)."""

    carried: NDArray[np.float64] | None = None
    """Static motion R (n, k) of the structure with the law's own coordinates: the columns then are masses, act
    through s^2, and motions are seen and driven through R besides (see `laws.Release`)."""

    load: NDArray[np.float64] | None = None
    """Load of base motion on the law's own coordinates beyond what the columns carry, (k,), in kg."""

    def law_at(self, change: NDArray | None) -> Law:
        """The law where the structure's parameters are `change` away from nominal."""
        if self.gain is None or change is None or not len(self.gain):
            return self.law
        return self.law.at(1.0 + self.gain @ change)


@dataclass(frozen=True, eq=False)
class Term:
    """One mechanism at one place of one structure, with its parameters' priors.

    `starts`, shape (n_starts, n_parameters), is where a search over the parameters begins: from barely visible to
    gross.
    """

    mechanism: Mechanism
    place: Place
    parameters: tuple[Parameter, ...]
    starts: NDArray[np.float64]
    groups: tuple[Group, ...] = ()
    variant: str = ""
    data: dict[str, Any] = field(default_factory=dict)

    @property
    def whole(self) -> Change | None:
        """The change of the whole structure's matrices that the term makes, if it is of that kind."""
        return self.data.get("change")

    @property
    def fitted(self) -> Term:
        """The term as a fit takes it: one that changes the structure so far that ordinary errors are those of the
        changed one, not of the structure without it. Itself where there is no such difference.
        """
        return self.data.get("fitted", self)

    @property
    def sought(self) -> Term:
        """The term as a search takes it, whose `fitted` this one is: what acts on few motions, by a law."""
        return self.data.get("sought", self)

    @property
    def n(self) -> int:
        """Number of parameters."""
        return len(self.parameters)

    @property
    def columns(self) -> NDArray[np.float64]:
        """All groups' columns side by side, shape (n_coordinates, k)."""
        return np.hstack([g.columns for g in self.groups])

    def stiffness(self, s: NDArray, p: NDArray, change: NDArray | None = None) -> NDArray[np.complex128]:
        """Dynamic stiffness between the columns, shape (k, k, n_f), `change` of the structure's parameters given."""
        if len(self.groups) == 1:
            law = self.groups[0].law_at(change)
            first = self.groups[0].first
            return _spread(np.asarray(law.value(s, p[first : first + len(law.names)]), complex), self.width)
        out = np.zeros((self.width, self.width, s.size), complex)
        at = 0
        for g in self.groups:
            width = g.columns.shape[1]
            law = g.law_at(change)
            out[at : at + width, at : at + width] = _spread(law.value(s, p[g.first : g.first + len(law.names)]), width)
            at += width
        return out

    def stiffness_derivative(self, s: NDArray, p: NDArray, change: NDArray | None = None) -> NDArray[np.complex128]:
        """Derivative of `stiffness` to each parameter, shape (n_parameters, k, k, n_f)."""
        out = np.zeros((self.n, self.width, self.width, s.size), complex)
        at = 0
        for g in self.groups:
            width = g.columns.shape[1]
            d = g.law_at(change).derivative(s, p[g.first : g.first + len(g.law.names)])
            for i in range(d.shape[0]):
                out[g.first + i, at : at + width, at : at + width] += _spread(d[i], width)
            at += width
        return out

    def stiffness_slope(self, s: NDArray, p: NDArray, change: NDArray, j: int) -> NDArray[np.complex128] | None:
        """Derivative of `stiffness` to the structure's parameter j, (k, k, n_f); None where it is zero."""
        if not any(g.gain is not None and len(g.gain) and g.gain[j] for g in self.groups):
            return None
        reach = 1e-5 / max(abs(g.gain[j]) for g in self.groups if g.gain is not None)
        step = reach * np.eye(len(change))[j]
        return (self.stiffness(s, p, change + step) - self.stiffness(s, p, change - step)) / (2 * reach)

    @property
    def width(self) -> int:
        """Number of columns, k."""
        return sum(g.columns.shape[1] for g in self.groups)

    @property
    def inertial(self) -> NDArray[np.bool_]:
        """Columns that act on absolute motion, shape (k,)."""
        return np.array([g.law.inertial for g in self.groups for _ in range(g.columns.shape[1])], bool)


def _spread(g: NDArray, width: int) -> NDArray:
    """A scalar law (n_f,) on each of its columns; a matrix law (k, k, n_f) as it is."""
    if g.ndim == 3:
        return g
    return g[None, None] if width == 1 else np.eye(width)[:, :, None] * g


class Mechanism(ABC):
    """A kind of missing physics: its equation, where it can act, and how it shows."""

    id: str
    domain: Literal["linear", "channel", "modal", "nonlinear"] = "linear"
    title: str
    equation: str
    shows: str
    told_apart: str
    symbol: str
    reference: str

    @abstractmethod
    def terms(self, site: Site) -> Iterable[Term]:
        """Every way in which the mechanism can act on the structure of `site`, one Term each."""

    def derived(self, term: Term, p: NDArray, std: NDArray) -> dict[str, tuple[float, float, str]]:
        """What follows from the parameters, in the words of a data sheet: name -> (value, standard deviation, unit).

        Compliances are fitted, since a clamp's is zero where it holds; stiffnesses are what people quote.
        """
        out: dict[str, tuple[float, float, str]] = {}
        for q, c, s in zip(term.parameters, p, std, strict=True):
            if q.name in STIFFNESS_OF and c > 0:
                name, unit = STIFFNESS_OF[q.name]
                out[name] = (float(1 / c), float(s / c**2), unit)
        return out

    def sense(self, term: Term, p: NDArray) -> str | None:
        """A word for the sign of the parameters, such as "loss" or "hardening"; None where there is none."""
        return None


class ChannelMechanism(Mechanism):
    """A fault of the measurement chain: a factor on one channel."""

    domain = "channel"
    common: ClassVar[bool] = False
    """Whether it is on all channels alike, so that it cancels in every FRF."""

    @abstractmethod
    def factor(self, s: NDArray, p: NDArray) -> NDArray[np.complex128]:
        """Factor on the channel, shape (n_f,); 1 with all parameters zero."""

    @abstractmethod
    def factor_derivative(self, s: NDArray, p: NDArray) -> NDArray[np.complex128]:
        """Its derivative to each parameter, shape (n_parameters, n_f)."""


@dataclass(frozen=True, eq=False)
class Held:
    """The motions that a support holds: directions, coupling to the free coordinates, own stiffness and mass.

    `static`, (n, d), is the shape R that each motion gives the structure; `load`, (n, d), the mass coupling
    M_ff R + M_fs; `stiffness` and `mass`, (d, d), what the structure opposes to the motions: K_red and M_red;
    `gain`, (n_theta,), the relative change of that stiffness with each parameter; `free_load`, (n,), the mass by
    which base motion of the held coordinates loads the free ones, M_fs r_s; `own_load`, (d,), what base motion loads
    the motions with, beyond L' r_f.
    """

    axes: tuple[str, ...]
    static: NDArray[np.float64]
    load: NDArray[np.float64]
    stiffness: NDArray[np.float64]
    mass: NDArray[np.float64]
    gain: NDArray[np.float64]
    free_load: NDArray[np.float64]
    own_load: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Site:
    """What mechanisms need to know of the structure: coordinates, stiffness, geometry, where they may act.

    Parameters
    ----------
    mass, stiffness : ndarray, shape (n, n)
        At the nominal parameters.
    dofs : dict
        "node:direction" -> row, shape (n,).
    nodes : dict
        Node -> xyz; may be empty.
    free_nodes : tuple of str
        Nodes where mechanisms may act.
    elements : tuple of (str, str)
        Node pairs where mechanisms may act.
    supports : tuple of str
    channels : tuple of Channel
        Outputs then inputs.
    omega : ndarray, shape (m,)
        Natural frequencies in the measured band, in rad/s (rigid-body modes left out).
    shape : ndarray, shape (n, m)
        Their mass-normalised shapes.
    rigid : ndarray, shape (n,), or None
        Influence of base motion.
    drive : tuple of str
        Degrees of freedom where force is put in.
    slopes : tuple of ndarray, shape (n, n)
        Derivatives of the stiffness to the structure's parameters.
    held : dict
        Support -> `Held`, the motions that it holds.
    mesh : tuple of (str, str)
        All elements, for mechanisms of the whole structure.
    """

    mass: NDArray
    stiffness: NDArray
    dofs: dict[str, NDArray]
    nodes: dict[str, tuple[float, float, float]]
    free_nodes: tuple[str, ...]
    elements: tuple[tuple[str, str], ...]
    supports: tuple[str, ...]
    channels: tuple[Any, ...]
    n_outputs: int
    omega: NDArray
    shape: NDArray
    rigid: NDArray | None
    drive: tuple[str, ...]
    slopes: tuple[NDArray, ...] = ()
    held: Mapping[str, Held] = field(default_factory=dict)
    mesh: tuple[tuple[str, str], ...] = ()

    def rows(self, node: str, directions: tuple[str, ...]) -> NDArray[np.float64]:
        """Columns (n, k) of the node's degrees of freedom in `directions` that exist."""
        found = [self.dofs[f"{node}:{d}"] for d in directions if f"{node}:{d}" in self.dofs]
        return np.array(found).T.reshape(self.mass.shape[0], -1)

    def scale(self, law: Law, columns: NDArray, p: NDArray, which: int) -> float:
        """Parameter step that changes some mode's squared frequency (or damping term) by 100 % at first order."""
        energy = ((columns.T @ self.shape) ** 2).sum(axis=0)
        slope = np.abs(law.derivative(1j * self.omega, p)[which])
        most = float(np.max(energy * slope / self.omega**2, initial=0.0))
        return 1.0 / most if most > 0 else np.inf


TRANSLATIONS = ("x", "y", "z")
ROTATIONS = ("rx", "ry", "rz")


STIFFNESS_OF = {"compliance": ("k", "N/m"), "compliance_turn": ("k_theta", "N*m/rad")}
"""Compliances by the names of the stiffnesses that they are the inverse of."""

SIZES = np.array([0.003, 0.01, 0.03, 0.1, 0.3, 1.0])
"""Relative changes of a mode's squared frequency that a search starts from."""


def signed(sizes: NDArray, *, positive: bool) -> NDArray[np.float64]:
    """`sizes`, and their negatives too unless `positive`."""
    return sizes if positive else np.concatenate([sizes, -sizes])


def amount(name: str, unit: str, scale: float, *, positive: bool = True, lower: float | None = None) -> Parameter:
    """A parameter that is zero where nothing is missing; `scale` of it changes a mode by its own size."""
    top = 30.0 * scale
    low = lower if lower is not None else (0.0 if positive else -top)
    return Parameter(name, 0.0, low, top, unit)


def scalar_term(
    mechanism: Mechanism,
    site: Site,
    place: Place,
    law: Law,
    columns: NDArray,
    *,
    positive: bool = True,
    lower: float | None = None,
    variant: str = "",
    gain: NDArray | None = None,
) -> Term | None:
    """Term of a law with one parameter acting on `columns`; None if no mode in the band moves there."""
    if columns.size == 0:
        return None
    scale = site.scale(law, columns, np.zeros(1), 0)
    if not np.isfinite(scale):
        return None
    parameter = amount(law.names[0], law.units[0], scale, positive=positive, lower=lower)
    starts = scale * signed(SIZES, positive=positive)[:, None]
    starts = starts[(starts[:, 0] > parameter.lower) | (parameter.lower == 0)]
    return Term(mechanism, place, (parameter,), starts, (Group(law, columns, 0, gain),), variant)
