"""Laws fitted along the motion that the measurement shows, before anything is marched.

The motion at a law's place follows from the base model and the measured responses (`locate.recover`), and with it the
force of the law: the response to that force and to the input is compared with the measured one (the equation error
of Ljung 1999, chapter 7.4). No steady state is sought, nothing can fail to settle, and the objective is smooth in the
law's parameters and in the base model's, which are free beside them. A fit by simulation that begins here begins near
its end, and on the branch of the response on which the structure was.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.fft import rfft

from labnnum.diagnosis.engine import Engine, Point
from labnnum.diagnosis.nonlinear.force import N_P
from labnnum.diagnosis.nonlinear.laws import force_along
from labnnum.diagnosis.nonlinear.lines import Lines
from labnnum.diagnosis.nonlinear.locate import motion_of, motions_of, window_of
from labnnum.diagnosis.nonlinear.orbit import Orbit
from labnnum.diagnosis.nonlinear.problem import Acting, Joint
from labnnum.diagnosis.nonlinear.receptance import Base, Receptance
from labnnum.diagnosis.nonlinear.run import Run
from labnnum.diagnosis.nonlinear.tie import dashpots, tie_of
from labnnum.diagnosis.scatter import Scatter
from labnnum.threads import each

SLOW = 0.05
"""Speed, of its RMS in the fastest run, below which a dry contact may be at rest."""
NUDGE = 1e-4
"""Relative change of a law's parameter for its slope."""


class Followed(Joint):
    """The objective of `Joint`, the laws' forces taken along the recovered motions instead of simulated ones.

    Spectra of open runs are compared through their window. Orbits hold the force as it is compared in `force`, that
    without a window in `time`, and the recovered motion, speed and force in `motion`, on
    `locate.FINE` samples to one of the run.
    """

    def __init__(
        self, engine: Engine, point: Point, runs: Sequence[Run], terms: Sequence[Acting], scatter: Scatter,
        lines: Sequence[Lines],
    ) -> None:  # fmt: skip
        seen = [replace(r, u=r.seen(r.u), y=r.seen(r.y), open=False) if r.open else r for r in runs]
        super().__init__(engine, point, seen, terms, scatter, [Lines(a.at, a.sigma) for a in lines])
        self.measured = tuple(runs)
        self.slow = np.zeros(len(terms))
        columns = np.array([t.column for t in terms]).T
        self.all_lines: dict[Any, Base] = {}
        self.whole: dict[Any, Receptance] = {}
        for key in {r.key for r in runs}:
            period, rate, decay = key
            omega = 2 * np.pi * np.arange(period // 2 + 1) * rate / period
            self.all_lines[key] = Base(engine, point, columns, omega, decay)

    def receptances(self, x: NDArray) -> dict[Any, Receptance]:
        """One for each period length, on the lines compared; `whole` has them on all lines."""
        key = x[: self.n_base].tobytes()
        if self._last is None or self._last[0] != key:
            self.whole = {k: b.at(x[: self.n_base]) for k, b in self.all_lines.items()}
            self._last = (key, {k: _on(r, self.bases[k].lines) for k, r in self.whole.items()})
        return self._last[1]

    def settle(self, x: NDArray, orbits: Sequence[Orbit | None], steps: int) -> list[Orbit | None]:
        """The recovered motions at `x` and the laws' forces along them."""
        p = self.laws(x)
        self.receptances(x)
        seen = each(self._motions, self.measured)
        self.slow = SLOW * np.max([np.sqrt(np.mean(m[:, :, 1] ** 2, axis=0)) for m in seen], axis=0)
        return each(lambda of: self._orbit(*of, p), list(zip(self.measured, seen, strict=True)))

    def _motions(self, run: Run) -> NDArray[np.float64]:
        """Motion, speed and force (n, k, 3) at the laws' places."""
        r = self.whole[run.key]
        if self.k == 1:
            return np.stack(motion_of(run, r)[:3], axis=-1)[:, None]
        return motions_of(run, r)

    def _orbit(self, run: Run, seen: NDArray, p: NDArray) -> Orbit:
        force = np.stack([self._force(run, i, seen[:, i], p[i]) for i in range(self.k)], axis=1)
        none = np.zeros((2, 0)), np.zeros(self.k), np.zeros((self.k, 2))
        spectra = np.array([self._spectrum(run, f) for f in force.T])
        return Orbit(*none, spectra, force, seen, closing=0.0)

    def _force(self, run: Run, i: int, seen: NDArray, p: NDArray) -> NDArray[np.float64]:
        """Law i's force on the structure along motion, speed and force (n, 3); what holds a dry contact at rest is any
        force up to its limit.
        """
        z, v, f = (np.ascontiguousarray(column) for column in seen.T)
        if self.terms[i].shape.law == "coulomb":
            return np.where(np.abs(v) > self.slow[i], -p[0] * np.sign(v), np.clip(f, -p[0], p[0]))
        return -force_along(self.terms[i].shape, z, v, p, around=run.lasting)

    @staticmethod
    def _spectrum(run: Run, force: NDArray) -> NDArray[np.complex128]:
        size = np.max(np.abs(force)) or 1.0  # single precision
        whole = rfft((force * window_of(run, force.size) / size).astype(np.float32))[: run.u.size]
        return np.asarray(whole, np.complex128) * (2 * size / force.size)

    @np.errstate(over="ignore", invalid="ignore")  # a nudged parameter may push a force beyond all numbers
    def slopes(self, x: NDArray, orbits: Sequence[Orbit | None]) -> tuple[NDArray, list[Orbit | None]]:
        """Derivatives of the whitened responses, (n_out, n_x, N), the motions held."""
        made = self.receptances(x)
        derived = {key: b.at_sensors(x[: self.n_base], made[key]) for key, b in self.bases.items()}
        p = self.laws(x)

        def part(of: tuple[Run, Run, Lines, Orbit | None]) -> NDArray[np.float64]:
            shown, run, lines, orbit = of
            assert orbit is not None
            r, (dp, dh) = made[run.key], derived[run.key]
            here = r.index(lines.at)
            change = dp[:, :, here] * (r.gain * shown.u)[lines.at]
            for c in range(self.k):
                change = change + dh[:, :, c][..., here] * orbit.force[c, lines.at]
            through, at = [], 0
            for c, term in enumerate(self.terms):
                for i in range(term.n):
                    through.append(
                        self._slope(run, orbit, c, i, p[c], at)[lines.at] * r.h[:, c, here]
                        if self.used[at] else np.zeros_like(change[0])
                    )  # fmt: skip
                    at += 1
            change = np.concatenate([change, np.array(through)])
            return self._real(np.moveaxis(lines.seen(change * r.lift[:, here]), 0, 1))

        done = each(part, list(zip(self.runs, self.measured, self.lines, orbits, strict=True)))
        return np.concatenate(done, axis=-1), list(orbits)

    def _slope(self, run: Run, orbit: Orbit, c: int, i: int, p: NDArray, at: int) -> NDArray[np.complex128]:
        """Derivative of the force spectrum of law c to its parameter i, `at` among all laws', in its scale."""
        step = np.zeros(N_P)
        scale = self.scale[self.n_base + at]
        step[i] = NUDGE * max(abs(p[i]), 1e-3 * scale)
        moved = self._force(run, c, orbit.motion[:, c], p + step) - orbit.time[:, c]
        return self._spectrum(run, moved) * (scale / step[i])


def _on(r: Receptance, lines: NDArray) -> Receptance:
    """The receptance with its sensors on some of its lines."""
    return replace(r, plain=r.plain[:, lines], h=r.h[..., lines], lift=r.lift[:, lines], lines=lines, marches={})


def marched_from(
    joint: Joint, x: NDArray, orbits: Sequence[Orbit | None], tight: float | None = None
) -> list[Orbit | None]:  # fmt: skip
    """Where the march of `joint` begins: the steady states of the forces that were followed. With `tight` open runs are
    brought into step with the motions that were, and held so by so many dashpots.
    """
    made = joint.receptances(x)
    out: list[Orbit | None] = []
    pushed = [] if tight is None else [dashpots(o) for o in orbits if o is not None]
    for run, steady, orbit in zip(joint.runs, joint.steady, orbits, strict=True):
        if orbit is None:
            out.append(None)
            continue
        n = orbit.time.shape[0]
        spectrum = np.fft.rfft(orbit.time * window_of(run, n, ends=False)[:, None], axis=0)[: run.u.size] * (2 / n)
        time = np.moveaxis(steady.to_time(np.ascontiguousarray(spectrum.T)), -1, 0)
        begun = steady.guess(made[run.key], np.ascontiguousarray(time))
        if tight is not None and run.open:
            begun = replace(begun, tie=tie_of(orbit, steady.n, np.max(pushed, axis=0), tight))
        out.append(begun)
    return out


def along(joint: Joint, x: NDArray) -> list[Orbit | None]:
    """The laws of `joint` along the motions that its runs show through the base at `x`."""
    shown = Followed(joint.engine, joint.point, joint.runs, joint.terms, joint.scatter, joint.lines)
    return shown.settle(x, [None] * len(joint.runs), 0)
