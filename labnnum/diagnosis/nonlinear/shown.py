"""The recovered force against the motion with the law through it, for the page of a diagnosis."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from labnnum.diagnosis.nonlinear.bench import Bench, Study, Tried
from labnnum.diagnosis.nonlinear.fitting import Made
from labnnum.diagnosis.nonlinear.laws import LawShape, force_along
from labnnum.diagnosis.nonlinear.locate import Recovered, Spot, recover
from labnnum.diagnosis.scatter import Scatter

if TYPE_CHECKING:
    from labnnum.diagnosis.nonlinear.decision import NonlinearAnswer


@dataclass(frozen=True, eq=False)
class Curve:
    """Recovered force against the motion, and the law along it, for one run."""

    level: float
    z: NDArray[np.float64]
    v: NDArray[np.float64]
    force: NDArray[np.float64]
    law: NDArray[np.float64]


HEARD = 0.1
"""What is left of a hit's window where its drawing ends: further on errors are undone from it with the signal."""


def curves(found: Study, best: Tried, last: Made | None = None, scatter: Scatter | None = None) -> tuple[Curve, ...]:
    """Force recovered from the measurement and the law along the motion, at the best place, thinned for drawing.

    Recovered through the base of the `last` fit, beside its other laws, where one is given: a base that was fitted
    without the law may hold a part of it. Means, which no line of the band shows, are those of the simulated motion
    and of the law; after a hit, which has none that lasts, they stay as they are.
    """
    here = best.spot.where
    seen = next((q for q in found.recovered if (q.spot.place, q.spot.axis) == here), None)
    if seen is None:
        return ()
    sign = -1.0 if best.spot.axis.startswith("-") else 1.0
    term, p = best.made.terms[0], best.made.whole(0)
    same = [i for i, t in enumerate(() if last is None else last.terms) if t.mechanism == term.mechanism and
            abs(t.column @ term.column) > 0.999 * np.linalg.norm(t.column) * np.linalg.norm(term.column)]  # fmt: skip
    if last is not None and scatter is not None and same:
        p, seen = last.whole(same[0]), _beside(found, last, same[0], seen.spot, scatter)
    return _curves(found, seen, term.shape, p, sign, last, same[0] if same else None)


@dataclass(frozen=True, eq=False)
class Drawn:
    """A law at its place, and what is drawn of it."""

    name: str
    spot: Spot
    curves: tuple[Curve, ...]


def of_each(found: NonlinearAnswer) -> tuple[Drawn, ...]:
    """The curves of an answer, and those of every further law that it names, which acts at another place or beside the
    first one: recovered through the base of the last fit, the other laws' forces known.
    """
    named = next((t for t in found.study.tried if t.named and t.simulated), found.laws[0])
    best = named if found.laws[0].named else found.laws[0]  # as the decision has it
    out = [Drawn(best.name, best.spot, found.curves)] if found.curves else []
    names, last = {(n.term.mechanism.id, n.place) for n in found.named}, found.laws[-1].made
    for i, law in enumerate(found.laws):
        drawn = any(law.name == d.name and law.spot.where == d.spot.where for d in out)
        if drawn or (law.name, law.spot.place) not in names or i >= len(last.terms):
            continue
        spot = replace(law.spot, axis=law.spot.axis.lstrip("-"))
        seen = _beside(found.study, last, i, spot, found.scatter)
        sign = -1.0 if law.spot.axis.startswith("-") else 1.0
        made = _curves(found.study, seen, last.terms[i].shape, last.whole(i), sign, last, i)
        out.append(Drawn(law.name, law.spot, made))
    return tuple(out)


def _curves(
    found: Study, seen: Recovered, shape: LawShape, p: NDArray, sign: float, last: Made | None, own: int | None
) -> tuple[Curve, ...]:  # fmt: skip
    """Force and law run by run; `own` is the number of the law in the last fit."""
    out = []
    for i, (run, z, v, f) in enumerate(zip(found.runs, seen.z, seen.v, seen.f, strict=True)):
        rest = 0.0 if run.decay or last is None or own is None else _rest(last, own, i)
        z = z + np.where(z == 0.0, 0.0, sign * rest)
        law = force_along(shape, sign * z, sign * v, p, run.lasting) * sign
        if not run.decay:
            f = f - np.where(f == 0.0, 0.0, np.mean(law[f != 0.0]) if np.any(f) else 0.0)
        heard = z.size if not run.decay else int(z.size * min(1.0, -np.log(HEARD) * run.rate / run.decay / run.period))
        pick = slice(0, heard, max(heard // 3000, 1))
        out.append(Curve(run.level, z[pick], v[pick], -f[pick], law[pick]))
    return tuple(out)


def _rest(last: Made, own: int, i: int) -> float:
    """Mean of the simulated motion of law `own` over run `i`; zero where it was not simulated."""
    orbit = last.orbits[i] if i < len(last.orbits) else None
    return 0.0 if orbit is None else float(np.mean(orbit.motion[:, own, 0]))


def _beside(found: Study, last: Made, own: int, spot: Spot, scatter: Scatter) -> Recovered:
    """The force at the spot of law `own` as the base of the last fit shows it, the other laws' forces known."""
    others = [i for i in range(len(last.terms)) if i != own]
    motions = last.x[last.bare : last.n_base].reshape(len(last.terms), -1)
    x = np.concatenate([last.x[: last.bare], motions[others].ravel()])
    orbits = None
    if others:
        orbits = [None if o is None else replace(o, force=o.force[others]) for o in last.orbits[: len(found.runs)]]
    bench = Bench(found.engine, found.point, found.runs, scatter, ()).on(FEW)
    return recover(bench.joint_of([last.terms[i] for i in others]), x, found.point, spot, orbits)


FEW = 2
"""Lines of a run in an objective that only lends its base."""
