"""FRFs without what a nonlinear law adds to them, so that the linear search sees what remains."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labnnum.diagnosis.nonlinear.bench import Study
from labnnum.diagnosis.nonlinear.fitting import Made
from labnnum.diagnosis.nonlinear.follow import along, marched_from
from labnnum.diagnosis.nonlinear.lines import choose_lines
from labnnum.diagnosis.nonlinear.orbit import Orbit
from labnnum.diagnosis.nonlinear.problem import Joint, reduced
from labnnum.diagnosis.nonlinear.receptance import Receptance
from labnnum.diagnosis.nonlinear.records import hits_of, stretch_of
from labnnum.diagnosis.nonlinear.run import Run
from labnnum.diagnosis.nonlinear.tie import tightness
from labnnum.diagnosis.observe import Observation
from labnnum.diagnosis.scatter import Scatter
from labnnum.recording import Recording

LINES = 400
"""Lines of a run that tell the ordinary errors of its sensors beside a law."""
LED = 0.1
"""How tightly a march that would leave the structure's own way is tied to the measured motion over a whole record."""


def linearised(
    found: Study, last: Made, orbits: Sequence[Any], observations: Sequence[Observation], scatter: Scatter,
    lying: int | None = None, known: int | None = None,
) -> list[Observation]:  # fmt: skip
    """Observations whose FRFs lack what the nonlinear force adds, with what its model may have wrong as variance.

    What it adds is what the sensors read of it, with the gain and the shapes that the first `known` runs (all, if None)
    show them to have. A channel that lies (`lying`) lies about that share too: there the factor goes by which the force
    changes the FRF.
    """
    runs = [o.run for o in observations if o.run is not None]
    some = [choose_lines(r, LINES, scatter.floor) for r in runs]
    joint = Joint(found.engine, found.point, runs, last.terms, scatter, some, whole=True)
    made = joint.receptances(last.x)
    errors = errors_of_sensors(joint, last.x, orbits, range(len(runs))[:known])
    if lying is not None:
        errors[lying] = 0.0
    out = []
    for o, run, orbit in zip(observations, joint.runs, orbits, strict=True):
        r = made[run.key]
        share = share_read(joint, r, run, orbit, errors)
        at = np.searchsorted(run.frequency, o.frf.frequency - 1e-9)
        change = share[:, at] / run.u[at]
        made_less = _less(o, change)
        if lying is not None:
            plain = (r.lift * r.plain)[lying, at] * r.gain[at]
            made_less = _scaled(o, made_less, lying, plain / (plain + change[lying]))
        out.append(made_less)
    return out


def errors_of_sensors(
    joint: Joint, x: NDArray, orbits: Sequence[Orbit | None], runs: Sequence[int]
) -> NDArray[np.float64]:  # fmt: skip
    """Ordinary errors (n_out, n) of gains and shapes that some of the runs show, in standard deviations."""
    return reduced(*joint.over(runs).parts(x, [orbits[i] for i in runs]))[2]


def share_read(joint: Joint, r: Receptance, run: Run, orbit: Orbit, errors: NDArray) -> NDArray[np.complex128]:
    """What a run's channels read (n_out, n_f) of the nonlinear force, gains and shapes having their errors."""
    share = r.lift * (r.h * orbit.force).sum(axis=1)
    return share + joint.misread(r, run, orbit, share, errors)


def _scaled(o: Observation, less: Observation, row: int, factor: NDArray) -> Observation:
    """`less` with one response of `o` times `factor` (n_f,)."""
    assert o.frf.variance is not None
    assert less.frf.variance is not None
    value, variance = less.frf.value.copy(), less.frf.variance.copy()
    value[row] = o.frf.value[row] * factor
    wrong = (0.02 * np.abs(1 - factor) * np.abs(value[row])) ** 2
    variance[row] = o.frf.variance[row] * np.abs(factor) ** 2 + wrong
    return replace(less, frf=replace(less.frf, value=value, variance=variance))


def _less(o: Observation, change: NDArray) -> Observation:
    """The observation with `change` (n_out, n_f) taken off its FRF."""
    assert o.frf.variance is not None
    variance = o.frf.variance + (0.02 * np.abs(change))[:, None] ** 2
    frf = replace(o.frf, value=o.frf.value - change[:, None], variance=variance)
    return replace(o, frf=frf, distortion={}, peaks={}, run=None, recordings=(), drift=0.0, drift_slope=None)


def linearised_records(
    found: Study, last: Made, whole: Sequence[Observation], scatter: Scatter
) -> list[Observation]:  # fmt: skip
    """The same for hits and random data: the share of the simulated responses in each FRF, estimated alike."""
    from labnnum.local import local_frf

    out = []
    for o in whole:
        lead = int(o.frf.settings.get("lead", 0))
        runs = hits_of(o) if o.kind == "hammer" else [stretch_of(o.recordings[0], 0, o.recordings[0].n_samples, lead)]
        some = [choose_lines(r, LINES, scatter.floor) for r in runs]
        joint = Joint(found.engine, found.point, runs, last.terms, scatter, some, whole=True)
        made = joint.receptances(last.x)
        begun: list[Orbit | None] = [None] * len(runs)
        tight = tightness(last.orbits)
        if tight is not None:
            begun = marched_from(joint, last.x, along(joint, last.x), max(tight, LED))
        orbits = joint.settle(last.x, begun, 12)
        errors = errors_of_sensors(joint, last.x, orbits, range(len(runs)))
        shares = []
        for run, orbit in zip(runs, orbits, strict=True):
            assert orbit is not None
            shares.append(share_read(joint, made[run.key], run, orbit, errors))
        if o.kind == "hammer":
            n = min(r.u.size for r in runs)
            top, power = np.zeros((len(runs[0].outputs), n), complex), np.zeros(n)
            for part, run in zip(shares, runs, strict=True):
                top += part[:, :n] * np.conj(run.u[:n])
                power += np.abs(run.u[:n]) ** 2
            at = np.minimum(np.searchsorted(runs[0].frequency, o.frf.frequency - 1e-9), n - 1)
            change = top[:, at] / np.maximum(power[at], 1e-300)
        else:
            recording, run = o.recordings[0], runs[0]
            n = run.period
            time = np.fft.irfft(shares[0] * (n / 2), n, axis=1)
            data = np.vstack([np.fft.irfft(run.u * (n / 2), n)[None], time])
            channels = (recording.channels[recording.inputs[0]], *run.outputs)
            simulated = local_frf(Recording(channels, data, run.rate, label=o.label), lead=0)
            same = round(n * recording.rate / run.rate) - lead
            measured = local_frf(replace(recording, data=recording.data[:, :same], breaks=()), lead=lead)
            _, here, there = np.intersect1d(
                np.round(measured.frequency, 6), np.round(simulated.frequency, 6), return_indices=True
            )
            o, change = replace(o, frf=measured.at(here)), simulated.value[:, 0, there]
        out.append(_less(o, change))
    return out
