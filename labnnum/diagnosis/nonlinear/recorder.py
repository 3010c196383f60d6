"""The recorder's own low-pass, common to all channels, fitted with a nonlinear law's harmonics as its source.

With F the filter, the force that acts is u / F and the motion y / F. The model is marched under u / F, and what it
makes of it times F is compared with what was recorded, in the band and above it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.signal import cheb1ap

from labnnum.diagnosis.nonlinear.above import Above, above, lines_above
from labnnum.diagnosis.nonlinear.bench import Study, Tried
from labnnum.diagnosis.nonlinear.fitting import GROUPS
from labnnum.diagnosis.nonlinear.lines import choose_lines
from labnnum.diagnosis.nonlinear.mended import Fault, filtered_run
from labnnum.diagnosis.nonlinear.orbit import Orbit
from labnnum.diagnosis.nonlinear.problem import Joint
from labnnum.diagnosis.nonlinear.run import Run
from labnnum.diagnosis.scatter import Scatter
from labnnum.errors import EstimationError, ModelError
from labnnum.mechanisms.recording_filter import SECTIONS, RecordingFilter

CLOSE = 1e-5
"""Relative gap of a period at which a steady state counts as found: differences of two are taken."""
CORNERS, SHARPNESS = (0.3, 10.0), (0.3, 10.0)
"""Corner frequencies that a section may have, in units of the highest excited line, and quality factors."""
STARTS = ((1.0, 0.7), (1.3, 1.5), (2.0, 0.7))
"""The same, where a section begins."""
STEEP = (1.0, 1.1, 1.2, 1.35)
"""Corners, in the same units, of steep filters from which further sections begin."""
STEP = 3e-3
"""Relative step of the finite differences."""
SMALL, LAST = 1e-2, 1e-3
"""Relative gain of a step at which a fit ends, and the last one."""
EVALUATIONS = 20
"""Steps of a fit at most."""
CHANCE = 13.8
"""Gain in chi-square of two more parameters that chance gives one time in a thousand."""
WIDE = 5.0
"""Factor by which the strengths of laws may change beside the filter, up and down."""
FAILED = 1e3
"""What a parameter vector counts without a steady state, in units of what is left."""


@dataclass(frozen=True, eq=False)
class Recorder:
    """The filter that was found.

    Parameters
    ----------
    value, std : ndarray, shape (2 n,)
        a and b of each section.
    half_power_std : float
        Hz, of where the filter is 3 dB down.
    shape : ndarray, shape (2 n,)
        Logarithms of corner frequencies (Hz) and quality factors, as they are fitted.
    seen : Above
        Measured over predicted harmonics before the filter was in the model.
    shown : Above, optional
        Recorded harmonics over those of the motion itself as the model with the filter has it: the filter's own values.
    """

    value: NDArray[np.float64]
    std: NDArray[np.float64]
    half_power_std: float
    shape: NDArray[np.float64]
    seen: Above
    shown: Above | None = None

    @property
    def fault(self) -> Fault:
        """As runs are freed of it."""
        return Fault(RecordingFilter().term(self.value.size // 2, self.half_power_std), self.value)


def coefficients(shape: NDArray) -> NDArray[np.float64]:
    """Coefficients a, b (2 n,) from the logarithms of the sections' corner frequencies in Hz and quality factors."""
    corner, sharpness = np.exp(np.reshape(shape, (-1, 2))).T
    omega = 2 * np.pi * corner
    return np.stack([1 / (omega * sharpness), 1 / omega**2], axis=1).ravel()


def harmonics(found: Study, last: Tried, runs: Sequence[Run], scatter: Scatter) -> Above | None:
    """How the harmonics above the band that the laws make compare with those recorded."""
    try:
        return above(runs, _Loop(found, last, runs, scatter).plain)
    except (EstimationError, ModelError, np.linalg.LinAlgError):
        return None


def fitted(found: Study, last: Tried, runs: Sequence[Run], scatter: Scatter, seen: Above) -> Recorder | None:
    """The filter of one to four sections that explains the runs best with the laws of `last`; None where none does.

    The loudest run tells, whose harmonics stand out most, and lines above the band are weighed by what no factor
    explains there. One more section is taken where it gains far more than chance, lines of a neighbourhood counted
    together.

    Parameters
    ----------
    runs : sequence of Run
        As they were recorded.
    seen : Above
        Their harmonics over those that the laws make without a filter.
    """
    try:
        loop = _Loop(found, last, [max(runs, key=lambda r: r.level)], scatter)
        start = _rough(seen, loop.top, 1)
        loop.weigh(seen, start)
        best = loop.fit([start])
        while best is not None and best.n < SECTIONS:
            more = best.n + 1
            begun = [np.append(best.shape, _far(loop.top)), _rough(seen, loop.top, more)]
            other = loop.fit([*begun, *(_steep(c * loop.top, more) for c in STEEP)])
            if other is None or GROUPS * np.log(best.cost / other.cost) < CHANCE:
                break
            best = other
    except (EstimationError, ModelError, np.linalg.LinAlgError):
        return None
    return None if best is None else Recorder(*_sections(best), best.shape, seen)


def polished(
    found: Study, last: Tried, runs: Sequence[Run], scatter: Scatter, before: Recorder
) -> Recorder | None:  # fmt: skip
    """A filter fitted on with other laws, all lines alike: what is left in the unit of the responses is least."""
    try:
        loop = _Loop(found, last, runs, scatter)
        loop.weigh(before.seen, before.shape, even=True)
        best = loop.fit([before.shape], LAST)
    except (EstimationError, ModelError, np.linalg.LinAlgError):
        return None
    return None if best is None else Recorder(*_sections(best), best.shape, before.seen)


@dataclass(frozen=True, eq=False)
class _End:
    """Where a fit ended: the filter's part of its vector, what is left, derivatives, and each value's group."""

    shape: NDArray[np.float64]
    cost: float
    left: NDArray[np.float64]
    slope: NDArray[np.float64]
    group: NDArray[np.intp]

    @property
    def n(self) -> int:
        """Sections."""
        return self.shape.size // 2


class _Loop:
    """The model with its laws under the input as the filter lets one see it; the base is held."""

    def __init__(self, found: Study, last: Tried, runs: Sequence[Run], scatter: Scatter) -> None:
        self.runs, self.x = list(runs), last.made.x
        terms = [replace(t, last=False, steps=0.0) for t in last.made.terms]
        lines = [choose_lines(r, 2, scatter.floor) for r in runs]
        self.joint = Joint(found.engine, found.point, runs, terms, scatter, lines, whole=True, closing=CLOSE)
        self.top = max(float(r.frequency[r.excited].max()) for r in runs)
        self.orbits: list[Orbit | None] = [None] * len(runs)
        first = last.made.n_base
        cuts = first + np.cumsum([0, *(t.n for t in last.made.terms)])
        self.strengths = [
            np.arange(a, b if t.mechanism == "general" else a + 1)
            for t, a, b in zip(last.made.terms, cuts[:-1], cuts[1:], strict=True)
        ]
        self.plain = self.recorded(None, self.x)

    def recorded(self, shape: NDArray | None, x: NDArray) -> list[NDArray[np.complex128]]:
        """What would be recorded through the filter, spectra (n_out, n_lines) a run."""
        if shape is None:
            driven, fault = self.joint.driven(self.runs), None
        else:
            fault = Fault(RecordingFilter().term(shape.size // 2), coefficients(shape))
            driven = self.joint.driven([filtered_run(r, fault) for r in self.runs])
        self.orbits = driven.settle(x, self.orbits, 14)
        if not all(o is not None and np.isfinite(o.closing) for o in self.orbits):
            raise EstimationError("the steady response does not settle")
        made = driven.predict(x, self.orbits)
        if fault is None:
            return made
        return [m * fault.factor(2j * np.pi * r.frequency, back=True) for m, r in zip(made, self.runs, strict=True)]

    def weigh(self, seen: Above, start: NDArray, *, even: bool = False) -> None:
        """Deviations by what is left in the band, with the filter or without, and above it by what no factor explains,
        or as in the band.
        """
        both = [self.plain]
        try:
            both.append(self.recorded(start, self.x))
        except EstimationError:
            self.orbits = [None] * len(self.runs)
        self.at, self.weight, groups = [], [], []
        share = np.clip(seen.left / seen.power, 1e-3, 1.0)
        for i, run in enumerate(self.runs):
            inside, over = np.flatnonzero(run.compared), lines_above(run)
            left = min(np.mean(np.abs(m[i][:, inside] - run.y[:, inside]) ** 2, axis=1).sum() for m in both)
            level = np.interp(run.frequency[over], seen.frequency, share)
            own = np.mean(np.abs(run.y[:, over]) ** 2, axis=1, keepdims=True) * level
            within = np.full((len(run.y), inside.size), left / len(run.y))
            self.at.append(np.concatenate([inside, over]))
            self.weight.append(1 / np.sqrt(np.maximum(np.hstack([within, own + even * within[:, :1]]), 1e-300)))
            groups.append(np.tile(run.frequency[self.at[-1]], 2 * len(run.y)))
        every = np.concatenate(groups)
        self.group = np.searchsorted(np.quantile(every, np.linspace(0, 1, GROUPS + 1)[1:-1]), every)

    def residual(self, made: Sequence[NDArray]) -> NDArray[np.float64]:
        """Whitened (n,)."""
        out = []
        for own, run, at, weight in zip(made, self.runs, self.at, self.weight, strict=True):
            left = ((own - run.y)[:, at] * weight).ravel()
            out += [left.real, left.imag]
        return np.concatenate(out)

    def values(self, vector: NDArray) -> NDArray[np.float64]:
        """Whitened residual (n,) of the filter's vector with the laws' strengths behind it."""
        x, n = self.x.copy(), vector.size - len(self.strengths)
        for at, size in zip(self.strengths, vector[n:], strict=True):
            x[at] *= size
        try:
            return self.residual(self.recorded(vector[:n], x))
        except (EstimationError, ModelError):
            self.orbits = [None] * len(self.runs)
            return np.full(self.group.size, FAILED)

    def fit(self, starts: Sequence[NDArray], small: float = SMALL) -> _End | None:
        """Least squares over the filter's vector and the laws' strengths, from what leaves least of `starts`."""
        n, k = starts[0].size, len(self.strengths)
        low, high = (np.log([CORNERS[i] * self.top, SHARPNESS[i]] * (n // 2)) for i in (0, 1))
        begin = [np.concatenate([np.clip(s, low + 1e-3, high - 1e-3), np.ones(k)]) for s in starts]
        if len(begin) > 1:
            begin.sort(key=lambda vector: float(np.sum(self.values(vector) ** 2)))
        bounds = (np.append(low, [1 / WIDE] * k), np.append(high, [WIDE] * k))
        made = least_squares(
            self.values, begin[0], bounds=bounds, diff_step=STEP, x_scale=0.1, ftol=small, max_nfev=EVALUATIONS
        )
        if 2 * made.cost >= FAILED**2 * self.group.size:
            return None
        return _End(made.x[:n], 2 * float(made.cost), made.fun, made.jac, self.group)


def _sections(end: _End) -> tuple[NDArray[np.float64], NDArray[np.float64], float]:
    """Coefficients of each section and their standard deviations, lines of a neighbourhood counted together; and that
    of where the filter is 3 dB down.
    """
    inverse = np.linalg.pinv(end.slope.T @ end.slope, rcond=1e-10)
    each = end.slope * end.left[:, None]
    sums = np.array([each[end.group == g].sum(axis=0) for g in range(GROUPS)])
    plain = np.diag(inverse) * end.cost / end.left.size
    spread = np.maximum(plain, np.diag(inverse @ (sums.T @ sums) @ inverse))
    covariance = inverse * np.sqrt(np.outer(spread, spread) / np.outer(np.diag(inverse), np.diag(inverse)))
    value = coefficients(end.shape)
    slope = np.zeros((value.size, end.shape.size))
    for i in range(end.n):
        a, b = value[2 * i : 2 * i + 2]
        slope[2 * i, 2 * i : 2 * i + 2] = -a, -a
        slope[2 * i + 1, 2 * i] = -2 * b
    own = covariance[: end.shape.size, : end.shape.size]
    std = np.sqrt(np.maximum(np.diag(slope @ own @ slope.T), 0.0))
    steps = [end.shape + sign * STEP * row for row in np.eye(end.shape.size) for sign in (1, -1)]
    down = np.array([RecordingFilter().half_power(coefficients(x)) for x in steps]).reshape(-1, 2)
    along = (down[:, 0] - down[:, 1]) / (2 * STEP)
    return value, std, float(np.sqrt(max(along @ own @ along, 0.0)))


def _far(top: float) -> NDArray[np.float64]:
    """A section that does little yet."""
    return np.log([4.0 * top, 0.7])


def _steep(corner: float, n: int) -> NDArray[np.float64]:
    """The sections of a Chebyshev filter of order 2 n with a ripple of 0.1 dB: as flat in the band and as steep beyond
    it as anti-alias filters are made.
    """
    poles = cheb1ap(2 * n, 0.1)[1]
    upper = poles[poles.imag > 0]
    size = np.abs(upper)
    return np.log(np.stack([corner * size, size / (-2 * upper.real)], axis=1)).ravel()


def _rough(seen: Above, top: float, n: int) -> NDArray[np.float64]:
    """Sections whose product is nearest to the factors that were seen, but for a delay, which cancels in the band."""
    weight = np.sqrt(seen.power / np.maximum(seen.left, 1e-3 * seen.power))
    s = 2j * np.pi * seen.frequency

    def values(vector: NDArray) -> NDArray[np.float64]:
        f = RecordingFilter().factor(s, coefficients(vector[:-1])) * np.exp(s * vector[-1] / (2 * np.pi * top))
        left = weight * (f - seen.ratio)
        return np.concatenate([left.real, left.imag])

    low, high = (np.log([CORNERS[i] * top, SHARPNESS[i]] * n) for i in (0, 1))
    bounds = (np.append(low, 0.0), np.append(high, 4 * np.pi))
    made = []
    for corner, sharpness in STARTS:
        begin = np.append(np.log([corner * top, sharpness] * n) + 0.1 * np.arange(2 * n), 1.0)
        made.append(least_squares(values, np.clip(begin, bounds[0] + 1e-3, bounds[1] - 1e-3), bounds=bounds))
    return min(made, key=lambda m: m.cost).x[:-1]
