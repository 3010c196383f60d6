"""A named law fitted once more to periodic runs and to records that are not periodic, and judged sensor by sensor."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from labnnum.diagnosis.nonlinear.bench import Study, Tried, cost
from labnnum.diagnosis.nonlinear.fitting import fit
from labnnum.diagnosis.nonlinear.force import N_P
from labnnum.diagnosis.nonlinear.further import with_one_more
from labnnum.diagnosis.nonlinear.lines import choose_lines
from labnnum.diagnosis.nonlinear.locate import Lead
from labnnum.diagnosis.nonlinear.mended import filtered_run
from labnnum.diagnosis.nonlinear.problem import Joint
from labnnum.diagnosis.nonlinear.records import stretch_of
from labnnum.diagnosis.nonlinear.run import Run, resampled
from labnnum.diagnosis.scatter import Scatter
from labnnum.errors import EstimationError

if TYPE_CHECKING:
    from labnnum.diagnosis.nonlinear.decision import NonlinearAnswer
    from labnnum.diagnosis.observe import Observation

ROOM = 1.2
"""Frequency up to which a record is kept, of the highest that is compared."""


def records(observations: Sequence[Observation], span: tuple[float, float], miss: float) -> list[Run]:
    """Runs of the whole of each record that is neither periodic nor a hammer's, compared inside `span` Hz."""
    out = []
    for o in observations:
        if o.run is not None or o.kind == "hammer" or not o.recordings:
            continue
        run = stretch_of(o.recordings[0], 0, o.recordings[0].n_samples)
        on = run.excited & (run.frequency <= ROOM * span[1])
        if not (on & (run.frequency >= span[0])).any():
            continue
        run = resampled(replace(run, excited=on, miss=miss))
        inside = (run.frequency >= span[0]) & (run.frequency <= span[1])
        out.append(replace(run, use=inside))
    return out


def joined(found: Study, last: Tried, more: Sequence[Run], scatter: Scatter, lines: int = 300) -> Tried:
    """The laws of `last` fitted to the study's runs and to `more`; unchanged where that fit does not settle."""
    runs = [*found.runs, *more]
    chosen = [choose_lines(r, lines, scatter.floor) for r in runs]
    joint = Joint(found.engine, found.point, runs, last.made.terms, scatter, chosen)
    start = [*last.made.orbits[: len(found.runs)], *([None] * len(more))]
    try:
        made = fit(joint, last.made.x, start, steps=12, always=True)
    except (EstimationError, np.linalg.LinAlgError):
        return last
    made = replace(made, orbits=made.orbits[: len(found.runs)])
    return Tried(last.lead, made, cost(made, last.mechanism))


SHARE, PAYS, ENOUGH = 0.2, 0.3, 1.3
"""Part of a slider's limit from which dry friction beside it is fitted; part of what the slider leaves beyond noise
that it must remove; chi-square per value below which the slider leaves nothing for it."""


def with_friction(found: Study, last: Tried, more: Sequence[Run], scatter: Scatter, lines: int = 300) -> Tried | None:
    """Dry friction beside a slider on a spring, at its place, both fitted to the study's runs and to `more`; None where
    the last law is no such slider or that removes little.

    A joint slides in a part of its face at any load, while the rest sticks to a limit (Iwan 1966).
    """
    if last.mechanism != "stick-slip" or len(last.made.terms) > 1:
        return None
    p = np.zeros(N_P)
    p[0] = SHARE * last.made.law(0)[0][1]
    dry = Lead(last.spot, "coulomb-friction", p, 0.0)
    runs = [*found.runs, *more]
    chosen = [choose_lines(r, lines, scatter.floor) for r in runs]
    alone = Joint(found.engine, found.point, runs, last.made.terms, scatter, chosen)
    joint = Joint(found.engine, found.point, runs, [*last.made.terms, dry.acting()], scatter, chosen)
    start = with_one_more(last.made, dry, found.engine)
    try:
        before = fit(alone, last.made.x, [None] * len(runs), steps=14)
        if before.data_part < ENOUGH * before.count:
            return None
        made = fit(joint, start, [None] * len(runs), steps=14, always=True)
    except (EstimationError, np.linalg.LinAlgError):
        return None
    if before.objective - made.objective < PAYS * (before.objective - before.count):
        return None
    made = replace(made, orbits=made.orbits[: len(found.runs)])
    return Tried(dry, made, cost(made, dry.mechanism))


@dataclass(frozen=True, eq=False)
class Predicted:
    """Measured and predicted spectra (n_out, n) of a run on the lines `frequency` (n,) that are compared.

    Open runs are seen through their window, as `labnnum.diagnosis.nonlinear.run.Run.seen` does. `input` (n,) likewise.
    """

    run: Run
    frequency: NDArray[np.float64]
    input: NDArray[np.complex128]
    measured: NDArray[np.complex128]
    made: NDArray[np.complex128]

    @property
    def error(self) -> NDArray[np.float64]:
        """Relative RMS error of each response, (n_out,)."""
        missed = np.sum(np.abs(self.made - self.measured) ** 2, axis=1)
        return np.sqrt(missed / np.sum(np.abs(self.measured) ** 2, axis=1))

    def frf(self, made: bool = False, bins: int = 400) -> tuple[NDArray[np.float64], NDArray[np.complex128]]:
        """Frequencies (n,) and FRFs (n_out, n), measured or `made`.

        On excited lines of a period; of records that are not periodic H1 over neighbouring lines, in `bins` bins.
        """
        y, u = self.made if made else self.measured, self.input
        if self.run.lasting:
            at = np.round(self.frequency * self.run.period / self.run.rate).astype(int)
            on = self.run.excited[at]
            return self.frequency[on], y[:, on] / u[on]
        size = max(1, -(-u.size // bins))
        cuts = np.arange(0, u.size, size)
        power = np.add.reduceat(np.abs(u) ** 2, cuts)
        count = np.add.reduceat(np.ones(u.size), cuts)
        h = np.asarray(np.add.reduceat(y * u.conj(), cuts, axis=1) / power, complex)
        return np.add.reduceat(self.frequency, cuts) / count, h


def levels(found: NonlinearAnswer, *, linear: bool = False) -> list[Predicted]:
    """Every run of a nonlinear diagnosis, of training and then held out, as the model found predicts it.

    Parameters
    ----------
    linear : bool
        By the base model alone. Sensors' ordinary errors are fitted to the training runs either way.
    """
    runs, held = found.study.runs, found.held_out
    if found.recorder is not None:
        runs, held = ([filtered_run(r, found.recorder.fault, back=True) for r in some] for some in (runs, held))
    return predictions(
        found, runs, held, found.scatter, linear=linear, trimmed=True, start=() if linear else found.orbits
    )


def predictions(
    found: NonlinearAnswer, train: Sequence[Run], test: Sequence[Run], scatter: Scatter, *, linear: bool = False,
    trimmed: bool | None = None, start: Sequence[Any] = (),
) -> list[Predicted]:  # fmt: skip
    """Responses of the diagnosed model to `train` and `test`.

    The sensors' ordinary errors (of the shapes there, within `scatter`) are fitted to `train` once and held for all.

    Parameters
    ----------
    linear : bool
        Of the base model alone, as it was identified: its sensors' errors are not fitted unless `trimmed` says so.
    trimmed : bool, optional
        Whether sensors' errors are fitted; by default where `linear` is not.
    start : sequence of Orbit
        Steady states to begin from, a run each.

    Runs are as they were recorded, also where the recorder's filter was found.
    """
    trimmed = not linear if trimmed is None else trimmed
    study, last = found.study, found.laws[-1].made
    recorded = [*train, *test]
    fault = None if found.recorder is None else found.recorder.fault
    runs = recorded if fault is None else [filtered_run(r, fault) for r in recorded]
    lines = [choose_lines(r, 0, scatter.floor) for r in runs]
    joint = Joint(study.engine, study.point, runs, () if linear else last.terms, scatter, lines)
    x = found.base_x if linear else last.x
    begin = list(start) if len(start) == len(runs) else [None] * len(runs)
    left, b = joint.parts(x, joint.settle(x, begin, 15))
    cuts = np.cumsum([2 * one.at.size for one in lines])
    if train and trimmed:
        own = slice(0, cuts[len(train) - 1])
        gram = np.matmul(b[..., own], b[..., own].transpose(0, 2, 1)) + np.eye(b.shape[1])
        size = np.linalg.solve(gram, np.matmul(b[..., own], left[:, own, None]))
        left = left - np.matmul(b.transpose(0, 2, 1), size)[..., 0]
    out = []
    for run, one, part in zip(recorded, lines, np.split(left, cuts[:-1], axis=1), strict=True):
        real, imag = np.split(part, 2, axis=1)
        missed = (real + 1j * imag) * one.sigma / np.sqrt(2.0)
        if fault is not None:
            missed = missed * fault.factor(run.decay + 2j * np.pi * run.frequency[one.at], back=True)
        measured = run.seen(run.y)[:, one.at]
        out.append(Predicted(run, run.frequency[one.at], run.seen(run.u)[one.at], measured, measured - missed))
    return out
