"""Training sets: parameters drawn from their prior, and the features of the FRFs that they give.

Samples are computed in quanta of fixed size, so that the numbers are the same to the last bit whatever the block,
the number of workers, or the interruptions.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Executor, Future
from dataclasses import dataclass, replace
from typing import Literal
from uuid import uuid4

import numpy as np
from numpy.typing import NDArray
from scipy.stats import qmc

from labnnum.bands import Band
from labnnum.errors import EstimationError
from labnnum.parameters import Parameter, truncated_samples
from labnnum.recording import Channel
from labnnum.structures.base import Structure
from labnnum.updating.batch import FrfBatch
from labnnum.updating.features import Features
from labnnum.updating.scores import ScoreBands, references
from labnnum.updating.seen import View

Sampling = Literal["sobol", "random", "prior"]

QUANTUM = 32
"""Samples that are computed together."""

Progress = Callable[[int, int], None]


def draw(parameters: Sequence[Parameter], n: int, sampling: Sampling, seed: int, margin: float) -> NDArray[np.float64]:
    """Parameter sets, shape (n, n_parameters).

    Parameters
    ----------
    sampling : {"sobol", "random", "prior"}
        "sobol" and "random" fill the bounds evenly; "prior" draws from the priors (normal, cut at the bounds).
    margin : float
        Share of the range by which even sampling reaches beyond the bounds on either side; a lower bound of zero
        or more is never passed below zero.
    """
    if n < 1:
        raise EstimationError(f"{n} samples cannot train a network: ask for some hundreds")
    if sampling == "sobol":
        sobol = qmc.Sobol(len(parameters), seed=seed)
        unit = sobol.random_base2(int(np.ceil(np.log2(max(n, 2)))))[:n]
    else:
        unit = np.random.default_rng(seed).random((n, len(parameters)))
    if sampling == "prior":
        return truncated_samples(parameters, unit)
    even = [_widened(p, margin) for p in parameters]
    return truncated_samples(even, np.clip(unit, 1e-12, 1 - 1e-12))


def _widened(p: Parameter, margin: float) -> Parameter:
    reach = margin * (p.upper - p.lower)
    low = p.lower - reach if p.lower < 0 else max(p.lower - reach, 0.05 * p.lower)
    high = p.upper + reach if p.upper > 0 else min(p.upper + reach, 0.05 * p.upper)
    return replace(p, lower=low, upper=high, std=None)


@dataclass(frozen=True, eq=False)
class Disturbance:
    """Noise that is put on training FRFs: complex Gaussian, independent from line to line.

    Parameters
    ----------
    relative : float
        Standard deviation as a share of |H| at each line.
    variance : ndarray, shape (n_out, n_in, n_f), optional
        E|dH|^2 / |H|^2 of a measurement, on the lines of the training.
    """

    relative: float = 0.0
    variance: NDArray[np.float64] | None = None

    @property
    def is_none(self) -> bool:
        """Whether nothing is added."""
        return self.relative == 0.0 and self.variance is None

    @property
    def power(self) -> float | NDArray[np.float64]:
        """E|dH|^2 / |H|^2 of all that is added."""
        return self.relative**2 + (0.0 if self.variance is None else self.variance)

    def on(self, value: NDArray, seed: int, first: int) -> NDArray[np.complex128]:
        """FRFs (n, n_out, n_in, n_f) with noise; sample number first + i has its own random stream."""
        if self.is_none:
            return value
        out = np.array(value, complex)
        for i, one in enumerate(out):
            rng = np.random.default_rng([seed, first + i, 77])
            normal = rng.standard_normal((2, *one.shape))
            one *= 1 + np.sqrt(self.power / 2) * (normal[0] + 1j * normal[1])
        return out


@dataclass(frozen=True, eq=False)
class TrainingPlan:
    """Everything that determines a training set.

    Parameters
    ----------
    structure : Structure
    features : Features
    outputs, inputs : sequence of Channel
    frequency : ndarray, shape (n_f,)
        Lines of the measurement, in Hz.
    samples : int
    seed : int
    sampling : {"sobol", "random", "prior"}
    margin : float
        See `draw`.
    noise : Disturbance
    view : View, optional
        The window's view of the model; it answers on `frequency`.
    """

    structure: Structure
    features: Features
    outputs: tuple[Channel, ...]
    inputs: tuple[Channel, ...]
    frequency: NDArray[np.float64]
    samples: int = 1000
    seed: int = 0
    sampling: Sampling = "sobol"
    margin: float = 0.05
    noise: Disturbance = Disturbance()
    view: View | None = None

    def parameters(self) -> NDArray[np.float64]:
        """All parameter sets, shape (samples, n_parameters)."""
        return draw(self.structure.parameters, self.samples, self.sampling, self.seed, self.margin)

    def frfs(self, theta: NDArray, batch: FrfBatch | None = None) -> NDArray[np.complex128]:
        """FRFs of parameter sets as the measurement would show them, shape (n, n_out, n_in, n_f)."""
        if batch is None:
            batch = self.batch()
        value = batch.frf(theta)
        return value if self.view is None else self.view.apply(value)

    def batch(self) -> FrfBatch:
        """The solver for many parameter sets at once."""
        frequency = self.frequency if self.view is None else self.view.frequency
        return FrfBatch.of(self.structure, frequency, self.outputs, self.inputs)

    def with_fitted_features(self) -> TrainingPlan:
        """The same with the features' scales set from the first samples, or scores from the model's sensitivities."""
        if isinstance(self.features, ScoreBands):
            return replace(self, features=self._scores(self.features.bands))
        sample = self.frfs(self.parameters()[: min(self.samples, 64)])
        return replace(self, features=self.features.fitted(self.frequency, sample))

    def _scores(self, bands: Sequence[Band]) -> ScoreBands:
        free = self.structure.parameters
        value, slope = self.batch().sensitivity(references(free))
        if self.view is not None:
            value, slope = self.view.apply(value), self.view.apply(slope)
        spread = np.array([p.spread for p in free])
        return ScoreBands.at_references(bands, self.frequency, value, slope, spread).spanned()


@dataclass(frozen=True, eq=False)
class TrainingSet:
    """Pairs of parameters and features; the first `done` rows are computed.

    Parameters
    ----------
    parameters : ndarray, shape (samples, n_parameters)
    features : ndarray, shape (samples, n_features)
    done : int
    """

    parameters: NDArray[np.float64]
    features: NDArray[np.float64]
    done: int

    @property
    def is_complete(self) -> bool:
        """Whether every sample has its features."""
        return self.done == len(self.parameters)


def make_training_set(
    plan: TrainingPlan,
    *,
    progress: Progress | None = None,
    resume: TrainingSet | None = None,
    save: Callable[[TrainingSet], None] | None = None,
    block: int = 256,
    executor: Executor | None = None,
) -> TrainingSet:
    """The training set of a plan.

    Parameters
    ----------
    plan : TrainingPlan
    progress : callable, optional
        Called with (samples done, samples).
    resume : TrainingSet, optional
        What an interrupted run saved; it must stem from the same plan.
    save : callable, optional
        Called with the incomplete set after each block.
    block : int
        Samples per task, rounded up to whole quanta.
    executor : Executor, optional
        Where blocks are computed: a process pool, or `dask.distributed.Client.get_executor()`. A block whose worker
        died is computed again by the executor's own means, or here.

    Raises
    ------
    EstimationError
        If `resume` does not belong to the plan.
    """
    theta = plan.parameters()
    done, rows = _resumed(theta, resume)
    size = max(1, -(-block // QUANTUM)) * QUANTUM
    starts = range(done, plan.samples, size)
    if progress is not None:
        progress(done, plan.samples)
    for start, features in _results(plan, starts, size, executor):
        rows.append(features)
        done = start + len(features)
        if progress is not None:
            progress(done, plan.samples)
        if save is not None:
            save(_partial(theta, rows, done))
    return _partial(theta, rows, done)


def _partial(theta: NDArray, rows: list[NDArray], done: int) -> TrainingSet:
    filled = np.vstack(rows)
    out = np.full((len(theta), filled.shape[1]), np.nan)
    out[:done] = filled
    return TrainingSet(theta, out, done)


def _resumed(theta: NDArray, resume: TrainingSet | None) -> tuple[int, list[NDArray]]:
    if resume is None or resume.done == 0:
        return 0, []
    if resume.parameters.shape != theta.shape or not np.array_equal(resume.parameters, theta):
        raise EstimationError(
            "the interrupted training set belongs to another plan (model, samples or seed): start anew"
        )
    done = resume.done - resume.done % QUANTUM if resume.done < len(theta) else resume.done
    return done, [resume.features[:done]]


def _results(plan: TrainingPlan, starts: range, size: int, executor: Executor | None):
    """(start, features) of each block, in order."""
    if executor is None:
        batch = plan.batch()
        for start in starts:
            yield start, compute_block(plan, start, size, batch)
        return
    token = uuid4().hex
    waiting: list[tuple[int, Future]] = [(s, executor.submit(_block_elsewhere, token, plan, s, size)) for s in starts]
    for start, future in waiting:
        yield start, future.result()


_prepared: dict[str, FrfBatch] = {}
"""What a worker prepared for the training set that it works at: for a large structure that costs as much as a block."""


def _block_elsewhere(token: str, plan: TrainingPlan, start: int, size: int) -> NDArray[np.float64]:
    """`compute_block` in a worker; `token` is the training set's."""
    batch = _prepared.get(token)
    if batch is None:
        batch = plan.batch()
        _prepared.clear()
        _prepared[token] = batch
    return compute_block(plan, start, size, batch)


def compute_block(plan: TrainingPlan, start: int, size: int, batch: FrfBatch | None = None) -> NDArray[np.float64]:
    """Features of samples start to start + size, shape (n, n_features), computed in quanta."""
    batch = plan.batch() if batch is None else batch
    theta = plan.parameters()[start : start + size]
    rows = []
    for first in range(0, len(theta), QUANTUM):
        part = theta[first : first + QUANTUM]
        padded = np.vstack([part, np.repeat(part[-1:], QUANTUM - len(part), axis=0)])
        value = plan.noise.on(plan.frfs(padded, batch), plan.seed, start + first)
        rows.append(plan.features(plan.frequency, value)[: len(part)])
    return np.vstack(rows)
