"""A structure with mechanisms added: a first-class structure, whose mechanisms' parameters update like any others."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import chain, count, pairwise
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from labnnum.eigen import moves_freely, natural_modes
from labnnum.errors import ConfigError, ModelError
from labnnum.mechanisms.attached import in_structure
from labnnum.mechanisms.base import ChannelMechanism, Mechanism, Place, Term
from labnnum.mechanisms.changes import Freed
from labnnum.mechanisms.laws import Release
from labnnum.mechanisms.let_go import LetGo
from labnnum.mechanisms.nonlinear_law import NonlinearMechanism
from labnnum.mechanisms.recording_filter import SECTIONS, RecordingFilter
from labnnum.mechanisms.site import site_of
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
        out = []
        for a in self.laws:
            made = a.term.mechanism.elements(a.term, [p.nominal for p in a.parameters])  # ty: ignore[missing-attribute]
            out += [replace(e, column=self._lifted(a.term.place, e.column[:, None])[:, 0]) for e in made]
        return tuple(out)

    @cached_property
    def _let_go(self) -> LetGo | None:
        whole = [a.term.fitted.whole for a in self.added]
        return LetGo.of(self.inner, [c for c in whole if isinstance(c, Freed)])

    @cached_property
    def _size(self) -> int:
        """Number of coordinates."""
        return len(self._nominal_mass) + sum(n for _, n in self._internal())

    @cached_property
    def _moved(self) -> NDArray[np.intp]:
        """The inner structure's coordinates, then those of supports that were let go."""
        out, at = list(range(len(self._nominal_mass))), len(self._nominal_mass)
        for added, n in self._internal():
            if any(isinstance(g.law, Release) for g in added.term.groups):
                out += range(at, at + n)
            at += n
        return np.array(out)

    def _lifted(self, place: Place, columns: NDArray) -> NDArray[np.float64]:
        """Columns over all coordinates, (size, k), of those over the inner structure's."""
        out = np.zeros((self._size, columns.shape[1]))
        if self._let_go is None:
            out[: len(columns)] = columns
        else:
            out[self._moved] = self._let_go.lifted(place, columns)
        return out

    @cached_property
    def _columns(self) -> list[list[NDArray[np.float64]]]:
        """Of each mechanism, the columns of its groups over all coordinates."""
        return [[self._lifted(a.term.place, g.columns) for g in a.term.groups] for a in self.added]

    @cached_property
    def _nominal_modes(self) -> tuple[NDArray, NDArray, NDArray, NDArray]:
        """Frequencies, shapes, M times these, and the coordinates that they are over: of what `trim` shifts."""
        own = [a for a in self.added if a.term.whole is not None or a.term.fitted is not a.term]
        core = replace(self, added=tuple(own), trim=(), laws=(), common=(), losses=())
        m = core.matrices(core.nominal)
        value, shape = natural_modes(np.real(m.M), np.real(m.K))
        index = list(range(len(self.inner.matrices(self.inner.nominal).M)))
        at = len(index)
        for added, n in self._internal():
            if added in own:
                index += range(at, at + n)
            at += n
        return np.sqrt(value), shape, np.real(m.M) @ shape, np.array(index)

    def matrices(self, theta: NDArray) -> Matrices:
        """The inner matrices with every mechanism's share, internal coordinates appended."""
        own, parts = self._split(np.asarray(theta))
        base = self.inner.matrices(own)
        n, change = len(base.M), own - self.inner.nominal
        inner = (base.M, base.C, base.K, base.D)
        blocks = [np.zeros((self._size, self._size), np.result_type(a, theta, float)) for a in inner]
        for block, a in zip(blocks, inner, strict=True):
            block[:n, :n] = a
        if self._let_go is not None:
            here = np.ix_(self._moved, self._moved)
            blocks[0][here], blocks[2][here] = self._let_go.matrices(own)
        at = n
        for added, columns, p in zip(self.added, self._columns, parts, strict=True):
            if added.term.whole is not None:
                self._whole(blocks, added.term, p, change)
            elif added.term.data.get("extra_mode"):
                at = _extra_mode(blocks, p, at)
            for group, column in zip(added.term.groups, columns, strict=True):
                q = p[group.first : group.first + len(group.law.names)]
                if isinstance(group.law, Release):
                    end = at + group.law.n_internal
                    blocks[2][range(at, end), range(at, end)] += group.law.held(q)[0]
                    at = end
                    continue
                law = group.law_at(change)
                at = _attach(blocks, law.local(q), column, law.n_internal, at, joint=law.joint)
        if any(self.trim):
            self._trimmed(blocks)
        if any(v != 1.0 for v in self.losses):
            self._damped(blocks, base)
        return Matrices(*blocks)

    def _whole(self, blocks: list[NDArray], term: Term, p: NDArray, change: NDArray) -> None:
        """Add what changes the whole structure."""
        assert term.whole is not None
        one = term.whole if self._let_go is None else self._let_go.change(term.whole)
        made = one.matrices(p, change)
        here = np.ix_(self._moved, self._moved)
        blocks[0][here] += made[0]
        blocks[2][here] += made[1]

    @cached_property
    def _nominal_mass(self) -> NDArray:
        return self.inner.matrices(self.inner.nominal).M

    def _trimmed(self, blocks: list[NDArray]) -> None:
        omega, _, loads, index = self._nominal_modes
        n = min(len(self.trim), len(omega))
        change = omega[:n] ** 2 * ((1 + np.array(self.trim[:n])) ** 2 - 1)
        blocks[2][np.ix_(index, index)] += (loads[:, :n] * change) @ loads[:, :n].T

    def _damped(self, blocks: list[NDArray], base: Matrices) -> None:
        _, shape, loads, index = self._nominal_modes
        told = self.losses[: shape.shape[1]]
        n, root = len(base.M), np.sqrt(np.pad(told, (0, shape.shape[1] - len(told)), constant_values=1.0))
        more = np.outer(root, root) - 1.0
        for block, loss in ((blocks[1], base.C), (blocks[3], base.D)):
            block[np.ix_(index, index)] += loads @ (more * (shape[:n].T @ loss @ shape[:n])) @ loads.T

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
        return self.matrices(theta).M @ self.rigid(theta) + self.held_load(theta)

    def held_load(self, theta: NDArray) -> NDArray:
        """The inner structure's, and that of the supports that were let go."""
        own, _ = self._split(np.asarray(theta))
        load = (self.inner if self._let_go is None else self._let_go).held_load(own)
        out = np.zeros(self._size, np.result_type(load, float))
        out[self._moved] = load
        return out

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


def _extra_mode(blocks: list[NDArray], p: NDArray, at: int) -> int:
    """Fill an added mode's coordinate `at`; the number of the next."""
    w = 2 * np.pi * p[0]
    for block, value in zip(blocks, (1.0, 2 * p[1] * w, w**2, 0.0), strict=True):
        block[at, at] = value
    return at + 1


def _attach(
    blocks: list[NDArray], local: Sequence[NDArray], columns: NDArray, n_internal: int, at: int, *, joint: bool = False
) -> int:
    """Add a law's local matrices at each of its columns, with its own internal coordinates a column, or at all.

    Internal coordinates begin with `at`; the number of the next is returned.
    """
    for part in [columns] if joint else [columns[:, k : k + 1] for k in range(columns.shape[1])]:
        spread = np.pad(part, ((0, 0), (0, n_internal)))
        spread[range(at, at + n_internal), range(part.shape[1], spread.shape[1])] = 1.0
        touched = np.flatnonzero(spread.any(axis=1))
        spread = spread[touched]
        for block, m in zip(blocks, local, strict=True):
            block[np.ix_(touched, touched)] += spread @ m @ spread.T
        at += n_internal
    return at


# -------------------------------------------------------------------- from a model file


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
    named = _apart(structure, added)
    return ExtendedStructure(structure, named, trim, laws=tuple(laws), common=tuple(common), losses=losses)


def _apart(structure: Structure, added: Sequence[Added]) -> tuple[Added, ...]:
    """The mechanisms with a name of its own for each parameter: the variant or the id follows one that is taken."""
    taken, out = dict.fromkeys((p.name for p in structure.parameters), ""), []
    for a in added:
        name, variant, parameters = a.term.mechanism.id, a.term.variant, []
        for p in a.parameters:
            more = [f":{variant}" if variant and taken.get(p.name) == name else f":{name}", f":{name}:{variant}"]
            ends = chain(("",), more, (f":{i}" for i in count(2)))
            free = next(full for end in ends if (full := p.name + end) not in taken)
            taken[free] = name
            parameters.append(replace(p, name=free))
        out.append(replace(a, parameters=tuple(parameters)))
    return tuple(out)


def _added(structure: Structure, mechanism: Mechanism, entry: Mapping[str, Any]) -> Added:
    where: dict[str, Any] = {"kind": "global", "id": "structure", "to": None, **entry.get("place", {})}
    place = Place(**where)
    told = {**getattr(mechanism, "defaults", {}), **entry.get("parameters", {})}
    values = {k: (v if isinstance(v, Mapping) else {"value": v}) for k, v in told.items()}
    variant = str(entry.get("variant", ""))
    term = _find(structure, mechanism, place, variant, entry, values)
    known = [p.name for p in term.parameters]
    odd = next((k for k in values if k not in known), None)
    if odd is not None:
        has = f"it has {', '.join(known)}" if known else "it has none"
        raise ConfigError(f"mechanism {mechanism.id!r} at {place}: there is no parameter {odd!r}; {has}")
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
    if mechanism.id == "drift":
        raise ConfigError(
            "mechanism 'drift' changes a structure in time and cannot be part of a linear model; leave it out"
        )
    if mechanism.id == "channel-clipping":  # known from recordings; in a linear model it is nothing
        parameters = (Parameter("rail", 0.0, -np.inf, np.inf),) if "rail" in values else ()
        return _open(Term(mechanism, place, parameters, np.zeros((0, 0)), variant=variant), values)
    if mechanism.id == "out-of-plane-mode":
        return _extra_term(mechanism, place, entry, values)
    if isinstance(mechanism, RecordingFilter):
        return replace(_open(mechanism.term(_sections(values)), values), place=place, variant=variant)
    drive = (f"{place.id}:{variant}",) if mechanism.id == "exciter-coupling" else ()
    channels = tuple(Channel(name, "acceleration") for name in (place.id, place.to) if name is not None)
    try:
        site = site_of(structure, channels if mechanism.domain == "channel" else (), len(channels), drive)
    except ValueError as error:
        raise ModelError(f"mechanisms cannot be added: {error}") from error
    if isinstance(mechanism, NonlinearMechanism):
        return mechanism.at(site, place, variant)
    floats = moves_freely(site.stiffness)
    terms = [in_structure(t, floats=floats) for t in mechanism.terms(site) if t.place == place]
    for term in terms:
        if term.variant == variant:
            return _open(term, values) if mechanism.domain == "channel" else term
    if not terms:
        raise ConfigError(f"mechanism {mechanism.id!r} cannot act at {place}: the structure has no such place for it")
    raise ConfigError(
        f"mechanism {mechanism.id!r} at {place}: variant {variant!r} is none of {[t.variant for t in terms]}"
    )


def _open(term: Term, values: Mapping) -> Term:
    """A fault of a channel, without the bounds of a search and with the units that the file gives."""
    parameters = tuple(
        Parameter(p.name, p.nominal, -np.inf, np.inf, str(values.get(p.name, {}).get("unit", p.unit)))
        for p in term.parameters
    )
    return Term(term.mechanism, term.place, parameters, np.zeros((0, len(parameters))), variant=term.variant)


def _sections(values: Mapping) -> int:
    """How many sections a filter has by the names of its parameters, one at least."""
    return max((i for i in range(1, SECTIONS + 1) if {f"a{i}", f"b{i}"} & set(values)), default=1)


def _extra_term(mechanism: Mechanism, place: Place, entry: Mapping[str, Any], values: Mapping) -> Term:
    """An added mode: frequency, damping ratio, and a residue at each of `dofs`, in their order."""
    dofs = tuple(entry.get("dofs", ()))
    residues = [name for name in values if name not in ("frequency", "damping_ratio")]
    if len(residues) != len(dofs) or not all(name.startswith("residue_") for name in residues):
        raise ConfigError(
            f"mechanism {mechanism.id!r}: its dofs are {list(dofs)} and its other parameters {residues}; expected one"
            " residue_NAME for each of dofs, in their order, beside frequency and damping_ratio"
        )
    names = ["frequency", "damping_ratio", *residues]
    units = {"frequency": "Hz"}
    parameters = tuple(
        Parameter(k, 0.0, -np.inf, np.inf, str(values.get(k, {}).get("unit", units.get(k, "1")))) for k in names
    )
    data = {"extra_mode": True, "dofs": dofs, "driven": tuple(entry.get("driven", ()))}
    return Term(mechanism, place, parameters, np.zeros((0, len(parameters))), data=data)
