"""A structure with mechanisms added: a first-class structure, whose mechanisms' parameters update like any others."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import combinations, pairwise
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from labnnum.errors import ConfigError, ModelError
from labnnum.mechanisms.attached import in_structure
from labnnum.mechanisms.base import ChannelMechanism, Group, Mechanism, Place, Site, Term
from labnnum.mechanisms.geometry import held_motions, touching
from labnnum.mechanisms.laws import Release
from labnnum.mechanisms.nonlinear_law import NonlinearMechanism
from labnnum.nonlinear import Element
from labnnum.parameters import Parameter
from labnnum.recording import Channel
from labnnum.structures.base import Matrices, Structure


@dataclass(frozen=True, eq=False)
class Added:
    """A term with the values that its parameters start from."""

    term: Term
    parameters: tuple[Parameter, ...]


@final
@dataclass(frozen=True, eq=False)
class ExtendedStructure(Structure):
    """`inner` with `added` mechanisms; theta is the inner structure's, then each mechanism's.

    Coordinates are the inner ones, then one for each internal motion of a mechanism. `trim` shifts the natural
    frequencies by relative amounts, mode by mode about the nominal modes: those of the inner structure with what the
    diagnosis takes for a part of it (supports that were let go, what acts everywhere). By `losses` times as much as the
    inner structure says these modes damp, and what two of them share follows: dashpots at places. `laws` are nonlinear:
    they act in time simulation (`law_elements`) and as nothing in anything linear, so their parameters are not updated.
    Nor are those of `common`, what the recorder does to all channels alike: it is in each channel's `chain` and cancels
    in every FRF.
    """

    inner: Structure
    added: tuple[Added, ...]
    trim: tuple[float, ...] = ()
    outputs: tuple[str, ...] = field(default=())
    laws: tuple[Added, ...] = ()
    common: tuple[Added, ...] = ()
    losses: tuple[float, ...] = ()

    @cached_property
    def _own(self) -> tuple[Parameter, ...]:
        return tuple(p for a in self.added for p in a.parameters)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The inner structure's parameters, then the mechanisms'."""
        return self.inner.parameters + self._own

    @property
    def dofs(self) -> tuple[str, ...]:
        """The inner structure's: internal motions cannot be measured."""
        return self.inner.dofs

    @property
    def nodes(self) -> Mapping[str, tuple[float, float, float]]:
        """The inner structure's."""
        return self.inner.nodes

    @property
    def elements(self) -> tuple[tuple[str, str], ...]:
        """The inner structure's."""
        return self.inner.elements

    @property
    def supports(self) -> tuple[str, ...]:
        """The inner structure's."""
        return self.inner.supports

    @property
    def base(self) -> str:
        """The inner structure's."""
        return self.inner.base

    def _split(self, theta: NDArray) -> tuple[NDArray, list[NDArray]]:
        n = len(self.inner.parameters)
        cuts = n + np.cumsum([0, *(a.term.n for a in self.added)])
        return theta[:n], [theta[a:b] for a, b in pairwise(cuts)]

    def law_elements(self) -> tuple[Element, ...]:
        """The nonlinear laws as the time simulation takes them, at the values that the model file holds."""
        made = (a.term.mechanism.elements(a.term, [p.nominal for p in a.parameters]) for a in self.laws)  # ty: ignore[missing-attribute]
        return tuple(e for several in made for e in several)

    @cached_property
    def _nominal_modes(self) -> tuple[NDArray, NDArray, NDArray, NDArray]:
        """Frequencies, shapes, M times these, and the coordinates that they are over: of what `trim` shifts."""
        from scipy.linalg import eigh

        own = [a for a in self.added if a.term.whole is not None or a.term.fitted is not a.term]
        core = replace(self, added=tuple(own), trim=(), laws=(), common=(), losses=())
        m = core.matrices(core.nominal)
        value, shape = eigh(np.real(m.K), np.real(m.M))
        index = list(range(len(self.inner.matrices(self.inner.nominal).M)))
        at = len(index)
        for added, n in self._internal():
            if added in own:
                index += range(at, at + n)
            at += n
        return np.sqrt(np.maximum(value, 0)), shape, np.real(m.M) @ shape, np.array(index)

    def matrices(self, theta: NDArray) -> Matrices:
        """The inner matrices with every mechanism's share, internal coordinates appended."""
        own, parts = self._split(np.asarray(theta))
        base = self.inner.matrices(own)
        blocks = [np.array(a, dtype=np.result_type(a, theta)) for a in (base.M, base.C, base.K, base.D)]
        freed: list[tuple[Place, Group, int]] = []
        for added, p in zip(self.added, parts, strict=True):
            if added.term.whole is not None:
                mass, stiffness = added.term.whole.matrices(p, own - self.inner.nominal)
                blocks[0][: len(mass), : len(mass)] += mass
                blocks[2][: len(mass), : len(mass)] += stiffness
            elif added.term.data.get("extra_mode"):
                blocks = self._extra_mode(blocks, p)
            for group in added.term.groups:
                q = p[group.first : group.first + len(group.law.names)]
                law = group.law_at(own - self.inner.nominal)
                if isinstance(group.law, Release):
                    freed.append((added.term.place, group, len(blocks[0])))
                blocks = _attach(blocks, law.local(q), group.columns, law.n_internal, joint=group.law.joint)
        for (one, a, at), (other, b, to) in combinations(freed, 2):
            if one != other:
                self._tie(blocks, base, (a, at), (b, to))
        if any(self.trim):
            self._trimmed(blocks)
        if any(v != 1.0 for v in self.losses):
            self._damped(blocks, base)
        return Matrices(*blocks)

    def _tie(self, blocks: list[NDArray], base: Matrices, a: tuple[Group, int], b: tuple[Group, int]) -> None:
        """What couples the motions of two supports that were let go, each with shapes for which the other holds."""
        (one, at), (other, to) = a, b
        assert one.carried is not None and other.carried is not None  # noqa: PT018
        mass = one.carried.T @ other.columns + one.columns.T @ other.carried
        mass = mass - one.carried.T @ np.real(self._nominal_mass) @ other.carried
        stiffness = -one.carried.T @ base.K @ other.carried
        rows, columns = slice(at, at + len(mass)), slice(to, to + mass.shape[1])
        for block, tie in ((blocks[0], mass), (blocks[2], stiffness)):
            block[rows, columns] += tie
            block[columns, rows] += tie.T

    @cached_property
    def _nominal_mass(self) -> NDArray:
        return self.inner.matrices(self.inner.nominal).M

    def _trimmed(self, blocks: list[NDArray]) -> None:
        omega, _, loads, index = self._nominal_modes
        n = len(self.trim)
        change = omega[:n] ** 2 * ((1 + np.array(self.trim)) ** 2 - 1)
        blocks[2][np.ix_(index, index)] += (loads[:, :n] * change) @ loads[:, :n].T

    def _damped(self, blocks: list[NDArray], base: Matrices) -> None:
        _, shape, loads, index = self._nominal_modes
        n, root = len(base.M), np.sqrt(np.pad(self.losses, (0, shape.shape[1] - len(self.losses)), constant_values=1.0))
        more = np.outer(root, root) - 1.0
        for block, loss in ((blocks[1], base.C), (blocks[3], base.D)):
            block[np.ix_(index, index)] += loads @ (more * (shape[:n].T @ loss @ shape[:n])) @ loads.T

    def _extra_mode(self, blocks: list[NDArray], p: NDArray) -> list[NDArray]:
        w = 2 * np.pi * p[0]
        zero = np.zeros((blocks[0].shape[0], 1))
        values = (1.0, 2 * p[1] * w, w**2, 0.0)
        return [np.block([[b, zero], [zero.T, np.array([[v]])]]) for b, v in zip(blocks, values, strict=True)]

    def _internal(self) -> list[tuple[Added, int]]:
        """Each mechanism with the number of coordinates that it appends."""
        out = []
        for a in self.added:
            n = sum(g.law.n_internal * (1 if g.law.joint else g.columns.shape[1]) for g in a.term.groups)
            out.append((a, n + (1 if a.term.data.get("extra_mode") else 0)))
        return out

    def participation(self, dof: str, theta: NDArray) -> NDArray:
        """The inner row; internal coordinates are not seen, save the residue of an added mode at a sensor."""
        own, parts = self._split(np.asarray(theta))
        row = [np.asarray(self.inner.participation(dof, own))]
        for (added, n), p in zip(self._internal(), parts, strict=True):
            tail = np.zeros(n, np.result_type(p))
            if added.term.data.get("extra_mode"):
                tail[-1] = self._residue(added, p, dof)
            elif any(g.carried is not None for g in added.term.groups):
                moved = [row[0][: g.carried.shape[0]] @ g.carried for g in added.term.groups if g.carried is not None]
                tail = np.concatenate(moved)
            row.append(tail)
        return np.concatenate(row)

    def _residue(self, added: Added, p: NDArray, dof: str) -> Any:
        places = added.term.data.get("dofs", ())
        if dof in places:
            return p[2 + places.index(dof)]
        return 1.0 if dof in added.term.data.get("driven", ()) else 0.0

    def rigid(self, theta: NDArray) -> NDArray:
        """The inner structure's; internal motions follow their attachment."""
        own, _ = self._split(np.asarray(theta))
        inner = np.asarray(self.inner.rigid(own))
        tail: list[Any] = []
        for added, _n in self._internal():
            for g in added.term.groups:
                if g.law.joint:
                    tail += [0.0] * g.law.n_internal
                    continue
                carried = g.columns.T @ inner[: g.columns.shape[0]] if g.law.inertial else np.zeros(g.columns.shape[1])
                tail += [v for v in carried for _ in range(g.law.n_internal)]
            if added.term.data.get("extra_mode"):
                tail.append(-1.0)
        return np.concatenate([inner, np.array(tail, dtype=inner.dtype)]) if tail else inner

    def base_load(self, theta: NDArray) -> NDArray:
        """Mass by which base motion loads each coordinate, what the supports' own coordinates carry included."""
        out = np.array(self.matrices(theta).M @ self.rigid(theta))
        n = len(self._held_load)
        out[:n] += self._held_load
        at = n
        for added, count in self._internal():
            for g in added.term.groups:
                if g.load is not None:
                    out[at : at + len(g.load)] += g.load
            at += count
        return out

    @cached_property
    def _held_load(self) -> NDArray[np.float64]:
        held = held_motions(self.inner)
        return sum((h.free_load for h in held.values()), np.zeros(len(self.inner.matrices(self.inner.nominal).M)))

    def chain(self, channel: Channel, frequency: NDArray, theta: NDArray) -> NDArray[np.complex128]:
        """Product of the channel faults on this channel, and of what is common to all."""
        own, parts = self._split(np.asarray(theta))
        out = self.inner.chain(channel, frequency, own)
        for added in self.common:
            out = out * _factor(added, channel, frequency, np.array([p.nominal for p in added.parameters]))
        for added, p in zip(self.added, parts, strict=True):
            out = out * _factor(added, channel, frequency, p)
        return out

    def chain_derivatives(self, channel: Channel, frequency: NDArray, theta: NDArray) -> NDArray[np.complex128]:
        """Derivative of `chain` to each parameter, shape (n_parameters, n_f)."""
        own, parts = self._split(np.asarray(theta))
        out = np.zeros((len(self.parameters), frequency.size), complex)
        whole = self.chain(channel, frequency, theta)
        n = len(self.inner.parameters)
        out[:n] = self.inner.chain_derivatives(channel, frequency, own)
        s = 2j * np.pi * np.asarray(frequency, float)
        for added, p in zip(self.added, parts, strict=True):
            mechanism = added.term.mechanism
            if isinstance(mechanism, ChannelMechanism) and added.term.place.id == channel.name:
                ratio = mechanism.factor_derivative(s, p) / mechanism.factor(s, p)
                out[n : n + added.term.n] = whole * ratio
            n += added.term.n
        return out


def _factor(added: Added, channel: Channel, frequency: NDArray, p: NDArray) -> NDArray[np.complex128]:
    mechanism, place = added.term.mechanism, added.term.place
    one = np.ones(np.shape(frequency), complex)
    common = isinstance(mechanism, ChannelMechanism) and mechanism.common
    if place.kind != "channel" or not (common or place.id == channel.name):
        return one
    if isinstance(mechanism, ChannelMechanism):
        return mechanism.factor(2j * np.pi * np.asarray(frequency, float), p)
    return -one if added.term.variant == "inverted" else one


def _attach(
    blocks: list[NDArray], local: Sequence[NDArray], columns: NDArray, n_internal: int, *, joint: bool = False
) -> list[NDArray]:
    """Add a law's local matrices at each of its columns, with its own internal coordinates a column, or at all."""
    if joint:
        n, k = blocks[0].shape[0], columns.shape[1]
        spread = np.zeros((n + n_internal, k + n_internal))
        spread[: columns.shape[0], :k] = columns
        spread[n:, k:] = np.eye(n_internal)
        return [np.pad(b, (0, n_internal)) + spread @ m @ spread.T for b, m in zip(blocks, local, strict=True)]
    for k in range(columns.shape[1]):
        n = blocks[0].shape[0]
        spread = np.zeros((n + n_internal, 1 + n_internal))
        spread[: columns.shape[0], 0] = columns[:, k]
        spread[n:, 1:] = np.eye(n_internal)
        blocks = [np.pad(b, (0, n_internal)) + spread @ m @ spread.T for b, m in zip(blocks, local, strict=True)]
    return blocks


# -------------------------------------------------------------------- from a model file


def site_of(
    structure: Structure, channels: Sequence[Channel] = (), n_outputs: int = 0, drive: Sequence[str] = ()
) -> Site:
    """The site of a structure with every elastic mode in its band and all places open."""
    from scipy.linalg import eigh

    theta = structure.nominal
    m = structure.matrices(theta)
    mass, stiffness = np.real(m.M), np.real(m.K)
    value, shape = eigh(stiffness, mass)
    elastic = value > 1e-10 * value.max()
    dofs = {d: np.real(structure.participation(d, theta)) for d in structure.dofs}
    nodes = tuple(dict.fromkeys(d.split(":")[0] for d in structure.dofs))
    rigid = np.real(structure.rigid(theta)) if structure.base else None
    site = Site(
        mass, stiffness, dofs, dict(structure.nodes), nodes, structure.elements, structure.supports, tuple(channels),
        n_outputs, np.sqrt(value[elastic]), shape[:, elastic], rigid, tuple(drive),
        tuple(np.real(d.K) for d in structure.derivatives(theta)), held_motions(structure),
    )  # fmt: skip
    mesh = structure.elements or touching(site)
    return replace(site, elements=mesh, mesh=mesh)


def extend(
    structure: Structure, entries: Sequence[Mapping[str, Any]], catalogue: Sequence[Mechanism] | None = None
) -> Structure:
    """The structure with the mechanisms of a model file's [[mechanism]] entries.

    Each entry has `id`, `place` (kind, id, to), `variant` where the mechanism has several, and `parameters`, name ->
    value or {value, std}; ids are those of `catalogue`, by default labnnum's. The id "modal-trim" holds `shift`,
    relative changes of the natural frequencies by mode, and may hold `damping`, by which factor each mode damps more
    than the structure says.

    Raises
    ------
    ConfigError
        If an id, place, variant or parameter is unknown; the message names it.
    """
    from labnnum.mechanisms import CATALOGUE

    trim: tuple[float, ...] = ()
    losses: tuple[float, ...] = ()
    known = {m.id: m for m in catalogue or CATALOGUE}
    added, laws, common = [], [], []
    for entry in entries:
        name = str(entry.get("id", ""))
        if name == "modal-trim":
            trim = tuple(float(v) for v in entry.get("shift", ()))
            losses = tuple(float(v) for v in entry.get("damping", ()))
            if min(losses, default=1.0) < 0:
                raise ConfigError(
                    f"mechanism.damping of modal-trim: {min(losses):g}; factors of 0 or more were expected"
                )
            continue
        if name not in known:
            raise ConfigError(f"mechanism.id: {name!r} is not in the catalogue: {', '.join(known)}")
        mechanism = known[name]
        shared = isinstance(mechanism, ChannelMechanism) and mechanism.common
        where = laws if isinstance(mechanism, NonlinearMechanism) else common if shared else added
        where.append(_added(structure, mechanism, entry))
    return ExtendedStructure(structure, tuple(added), trim, laws=tuple(laws), common=tuple(common), losses=losses)


def _added(structure: Structure, mechanism: Mechanism, entry: Mapping[str, Any]) -> Added:
    where: dict[str, Any] = {"kind": "global", "id": "structure", "to": None, **entry.get("place", {})}
    place = Place(**where)
    told = {**getattr(mechanism, "defaults", {}), **entry.get("parameters", {})}
    values = {k: (v if isinstance(v, Mapping) else {"value": v}) for k, v in told.items()}
    variant = str(entry.get("variant", ""))
    term = _find(structure, mechanism, place, variant, entry, values)
    parameters = []
    for p in term.parameters:
        if p.name not in values:
            raise ConfigError(f"mechanism {mechanism.id!r}: parameter {p.name!r} is missing; give its value")
        v = float(values[p.name]["value"])
        least, most = getattr(mechanism, "whole", {}).get(p.name, (-np.inf, np.inf))
        if np.isfinite(most) and not (v.is_integer() and least <= v <= most):
            raise ConfigError(
                f"mechanism {mechanism.id!r}: {p.name!r} is {v:g}; give a whole number, {least} to {most}"
            )
        reach = max(0.3 * abs(v), 6 * float(values[p.name].get("std", 0.0)), 1e-12)
        low, high = max(p.lower, v - reach), min(p.upper, v + reach)
        suffix = place.id if place.to is None else f"{place.id}-{place.to}"
        parameters.append(Parameter(f"{p.name}@{suffix}", v, min(low, v - 1e-12), max(high, v + 1e-12), p.unit))
    return Added(term, tuple(parameters))


def _find(
    structure: Structure, mechanism: Mechanism, place: Place, variant: str, entry: Mapping[str, Any], values: Mapping
) -> Term:
    if mechanism.domain == "channel":
        parameters = tuple(
            Parameter(k, float(v["value"]), -np.inf, np.inf, str(v.get("unit", "1"))) for k, v in values.items()
        )
        return Term(mechanism, place, parameters, np.zeros((0, len(parameters))), variant=variant)
    if mechanism.id == "out-of-plane-mode":
        parameters = tuple(
            Parameter(k, float(v["value"]), -np.inf, np.inf, str(v.get("unit", "1"))) for k, v in values.items()
        )
        data = {"extra_mode": True, "dofs": tuple(entry.get("dofs", ())), "driven": tuple(entry.get("driven", ()))}
        return Term(mechanism, place, parameters, np.zeros((0, len(parameters))), data=data)
    if mechanism.id == "drift":
        raise ConfigError(
            "mechanism 'drift' changes a structure in time and cannot be part of a linear model; leave it out"
        )
    if isinstance(mechanism, NonlinearMechanism):
        return mechanism.at(site_of(structure), place, variant)
    drive = (f"{place.id}:{variant}",) if mechanism.id == "exciter-coupling" else ()
    try:
        site = site_of(structure, drive=drive)
    except ValueError as error:
        raise ModelError(f"mechanisms cannot be added: {error}") from error
    floats = site.omega.size < len(site.mass)
    terms = [in_structure(t, floats=floats) for t in mechanism.terms(site) if t.place == place]
    for term in terms:
        if term.variant == variant:
            return term
    if not terms:
        raise ConfigError(f"mechanism {mechanism.id!r} cannot act at {place}: the structure has no such place for it")
    raise ConfigError(
        f"mechanism {mechanism.id!r} at {place}: variant {variant!r} is none of {[t.variant for t in terms]}"
    )
