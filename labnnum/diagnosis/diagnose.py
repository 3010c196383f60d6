"""Diagnosis: what did the model leave out? From observations and a structure to a verdict that can be checked."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from labnnum.diagnosis.decide import decide
from labnnum.diagnosis.engine import Engine
from labnnum.diagnosis.gates import drifted, pass_gates
from labnnum.diagnosis.linear import select
from labnnum.diagnosis.observe import Observation
from labnnum.diagnosis.places import all_terms, places_of
from labnnum.diagnosis.runs import split_runs
from labnnum.diagnosis.scatter import Scatter
from labnnum.diagnosis.verdict import Diagnosis, Limits
from labnnum.errors import EstimationError
from labnnum.frf import Frf
from labnnum.mechanisms import CATALOGUE
from labnnum.mechanisms.base import Mechanism, Term
from labnnum.mechanisms.extended import ExtendedStructure
from labnnum.mechanisms.local_law import FreeLaw, LocalLaw, PairLaw
from labnnum.mechanisms.loose import LooseChannel, LooseSupport
from labnnum.parameters import Parameter
from labnnum.structures.base import Structure

if TYPE_CHECKING:
    from labnnum.diagnosis.nonlinear.locate import Lead
    from labnnum.diagnosis.nonlinear.mended import Fault

UNNAMED: tuple[Mechanism, ...] = (LocalLaw(), PairLaw(), LooseChannel(), LooseSupport())
"""What may be missing without having a name."""


def diagnose(
    structure: Structure,
    observations: Sequence[Observation],
    held_out: Sequence[Observation] = (),
    *,
    places: Mapping[str, Sequence] | None = None,
    span: tuple[float, float] | None = None,
    scatter: Scatter | None = None,
    limits: Limits | None = None,
    catalogue: Sequence[Mechanism] = CATALOGUE,
    progress: Callable[[str], None] = lambda text: None,
    nonlinear: bool = True,
    beside: bool = False,
    depth: int = 3,
    hint: bool = False,
) -> Diagnosis:
    """Verdict on whether `structure` explains the observations, and if not, what is missing and where.

    Parameters
    ----------
    structure : Structure
        The nominal model; its parameters are updated with their priors.
    observations : sequence of Observation
        Training runs, see `labnnum.diagnosis.observe`.
    held_out : sequence of Observation
        Runs that no fit sees; where there are none, one run of several, or every fourth stretch of lines.
    places : mapping, optional
        The model's [places]: nodes, elements, supports.
    span : (low, high), optional
        Lines outside it, in Hz, are left out: where the model is not meant to hold.
    scatter : Scatter, optional
        Ordinary errors of a sound model and bench.
    limits : Limits, optional
        Thresholds of the decision.
    nonlinear : bool
        Whether nonlinear signs are looked for (periodic runs), and their law taken out before the linear search.
    beside : bool
        Whether such a law was taken out of these observations: where the model explains the rest, nothing is sought.
    depth : int
        Linear mechanisms that are sought, at most.
    hint : bool
        Whether the answer only says where to go on: the search ends where one mechanism leaves far more than noise.

    Returns
    -------
    Diagnosis

    Raises
    ------
    ModelError
        If the structure lacks a measured degree of freedom.
    """
    scatter, limits = scatter or Scatter(), limits or Limits()
    gate = pass_gates(observations)
    progress("estimating")
    moving, usable, later = drifted(gate.usable, held_out)
    train, test = _split(usable, later, span)
    band = (float(train.omega[0]), float(train.omega[-1]))
    if len(train.inputs) > len(train.outputs):
        scatter = by_hand(scatter)
    inner, initial = _taken_apart(structure, train)
    engine = Engine(inner, train.outputs, train.inputs, band)
    engine.couple()
    where = places_of(engine, places)
    if nonlinear and not initial and moving is None:  # a change within the run stands on quiet lines as well
        from labnnum.diagnosis.nonlinear.first import nonlinear_first

        def again(*runs: Sequence[Observation], on: Structure = structure, **kind: Any) -> Diagnosis:
            same = {"scatter": scatter, "limits": limits, "catalogue": catalogue, "progress": progress}
            more: dict[str, Any] = same | kind
            return diagnose(on, *runs, places=places, span=span, nonlinear=False, **more)

        whole = nonlinear_first(
            engine, gate, observations, held_out, where, scatter, limits, span, again, progress, _known(structure),
            _held(structure),
        )  # fmt: skip
        if whole is not None:
            return whole
    _, terms = all_terms(engine, where, catalogue)
    _, general = all_terms(engine, where, UNNAMED if catalogue else ())
    _, free = all_terms(engine, where, (FreeLaw(),) if catalogue and not hint else ())
    measured = all(o.kind != "frf" for o in observations)
    selection = select(
        engine,
        train,
        terms,
        general,
        scatter,
        limits,
        measured_noise=measured,
        initial=initial,
        beside=beside,
        depth=depth,
        hint=hint,
        free=free,
        progress=progress,
    )
    progress("weighing the answer")
    gated = (*gate.named, *((moving,) if moving else ()))
    raw = None
    if moving is not None:
        raw = _split(gate.usable, held_out, span)
    return decide(engine, train, test, selection, scatter, limits, observations, general, gated, raw)


def _split(
    usable: Sequence[Observation], later: Sequence[Observation], span: tuple[float, float] | None
) -> tuple[Frf, Frf]:
    """FRFs to fit and held out on the lines of `span`, all of them if None."""
    fitted, foretold = (_within(some, span) for some in (usable, later))
    if not fitted:
        raise EstimationError(_too_few(0, usable, span))
    if later and not foretold:
        labels, (low, high) = ", ".join(o.label for o in later), span or (0.0, np.inf)
        raise EstimationError(f"{labels}: held out, and no line between {low:.4g} and {high:.4g} Hz is left of it")
    train, test = split_runs(fitted, foretold)
    if train.frequency.size < 8:
        raise EstimationError(_too_few(train.frequency.size, usable, span))
    return train, test


def _within(some: Sequence[Observation], span: tuple[float, float] | None) -> list[Observation]:
    """Those of which lines lie inside the span, on these alone."""
    if span is None:
        return list(some)
    cut = (replace(o, frf=o.frf.lines(*span)) for o in some)
    return [o for o in cut if o.frf.frequency.size]


def _too_few(n: int, observations: Sequence[Observation], span: tuple[float, float] | None) -> str:
    """Why there are too few lines, and what to look at."""
    labels = ", ".join(o.label for o in observations)
    band = "" if span is None else f" between {span[0]:.4g} and {span[1]:.4g} Hz"
    said = f"{labels}: only {n} lines{band} are left to compare the model with, and 8 are needed"
    if any(o.kind == "periodic" for o in observations):
        said += "; if the force does not repeat after `period` samples, channels.toml has the wrong period"
    return said


def by_hand(scatter: Scatter) -> Scatter:
    """Scatter of a roving hammer: each input is a hit by hand, some millimetres off and not quite along its axis."""
    return replace(
        scatter, gain=max(scatter.gain, 0.1), shape=max(scatter.shape, 0.05), residue=max(scatter.residue, 0.05)
    )


def _taken_apart(structure: Structure, train: Frf) -> tuple[Structure, list[tuple[Term, NDArray]]]:
    """An extended structure as its inner one and the terms that it holds; any other as it is."""
    if not isinstance(structure, ExtendedStructure):
        return structure, []
    names = [c.name for c in (*train.outputs, *train.inputs)]
    initial = []
    for added in structure.added:
        term = added.term
        if term.place.kind == "channel":
            if term.place.id not in names:
                continue
            at = names.index(term.place.id)
            if term.variant == "inverted":
                term = replace(term, data={"invert": at})
            elif term.place.to in names:
                term = replace(term, data={"swap": (at, names.index(term.place.to))})
            else:
                term = replace(term, data={"channel": at})
        values = np.array([p.nominal for p in added.parameters])
        if term.data.get("extra_mode"):
            term, values = _seen_by(term, values, train)
        initial.append((term.fitted, values))
    return structure.inner, initial


def _seen_by(term: Term, values: NDArray, train: Frf) -> tuple[Term, NDArray]:
    """A mode that the model does not have, and its values, as these responses see it; nothing where no sensor was."""
    known = dict(zip(term.data.get("dofs", ()), zip(term.parameters[2:], values[2:], strict=True), strict=True))
    rows = [known.get(c.dof, (Parameter("", 0.0, -np.inf, np.inf), 0.0)) for c in train.outputs]
    names = [f"residue_{c.name}" for c in train.outputs]
    shape = tuple(replace(p, name=name) for name, (p, _) in zip(names, rows, strict=True))
    parameters = (*term.parameters[:2], *shape)
    seen = replace(term, parameters=parameters, starts=np.zeros((0, len(parameters))), data={"extra_mode": True})
    return seen, np.array([*values[:2], *(value for _, value in rows)])


def _held(structure: Structure) -> list[Fault]:
    """What the structure says that the recorder does to all channels."""
    from labnnum.diagnosis.nonlinear.mended import Fault

    common = structure.common if isinstance(structure, ExtendedStructure) else ()
    return [Fault(a.term, np.array([p.nominal for p in a.parameters])) for a in common]


def _known(structure: Structure) -> list[Lead]:
    """Nonlinear laws that the structure holds."""
    from labnnum.diagnosis.nonlinear.force import N_P, TOLD, YIELDING
    from labnnum.diagnosis.nonlinear.laws import form_of
    from labnnum.diagnosis.nonlinear.locate import Lead, Spot

    out = []
    for law in structure.laws if isinstance(structure, ExtendedStructure) else ():
        p = np.zeros(N_P)
        p[: len(law.parameters)] = [q.nominal for q in law.parameters]
        p[TOLD] = float(law.term.mechanism.id in YIELDING)
        term, column = law.term, np.asarray(law.term.data["column"], float)
        reverse = term.variant.startswith("-")
        spot = Spot(term.place, term.variant, -column if reverse else column)
        out.append(Lead(spot, form_of(term.mechanism.id, p), p, 0.0))
    return out
