"""One case worked through: networks trained, thousands of sets verified, errors beside the bound."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from labnnum.parameters import nominal, truncated_samples
from labnnum.updating.many import ManyFrfs, bound_deviations, refine_from, refine_many
from labnnum.updating.training import Disturbance
from sessions.reproduce.cases import Case
from sessions.reproduce.networks import Say, Trained, Training

CHUNK = 250
FAILED = 8.0
"""Standard deviations of the bound beyond which a refined estimate counts as a failure."""

FIRST = 20_000_000
"""Number of the first verification set's noise stream, far from those of the training."""

TRIES = (1.0,) * 6 + (0.3, 3.0, 10.0) * 10
"""Further starts of a set that noise does not explain: distances in units of the networks' disagreement."""

NEAR = (0.5,) * 8 + (1.0,) * 8 + (2.0,) * 8
"""Starts before those: distances from the network trained with noise, in its stated standard deviations."""

NORMAL_90 = 1.6448536269514722


@dataclass(frozen=True)
class Effort:
    """How much is computed.

    Parameters
    ----------
    sets : int
        Verification sets, drawn from the prior.
    noises : tuple of float
        Standard deviations of the noise on the FRF, as shares of |H|.
    noisy_samples : int
        Training samples of the networks that are trained with noise, on at most `centres` centres.
    centres : int
    large : int
        Samples of a further clean network on `centres` centres; 0 leaves it out.
    nominal : int
        Sets that are refined from the nominal values too, to count failures; 0 leaves that out.
    seed : int
    lines : int
        Lines in each band; 0 takes the case's own.
    """

    sets: int = 5000
    noises: tuple[float, ...] = (0.0, 0.01, 0.03)
    noisy_samples: int = 30_000
    centres: int = 800
    large: int = 0
    nominal: int = 500
    seed: int = 0
    lines: int = 0


@dataclass(frozen=True, eq=False)
class Errors:
    """Errors of one method at one noise level, in percent of the truth.

    Parameters
    ----------
    method : str
    noise : float
    signed : ndarray, shape (n_sets, n_parameters)
    failures : int or None
        Sets that ended elsewhere, where that has a meaning.
    coverage : ndarray, shape (n_parameters,), or None
        Share of truths inside the stated 90 % intervals.
    """

    method: str
    noise: float
    signed: NDArray[np.float64]
    failures: int | None = None
    coverage: NDArray[np.float64] | None = None

    @property
    def mean(self) -> NDArray[np.float64]:
        """Mean absolute error of each parameter (equation 4.4, as a mean)."""
        return np.abs(self.signed).mean(axis=0)

    @property
    def most(self) -> NDArray[np.float64]:
        """Largest absolute error of each parameter (equation 4.5)."""
        return np.abs(self.signed).max(axis=0)


@dataclass(frozen=True, eq=False)
class Study:
    """Everything that a case's table and figures show.

    Parameters
    ----------
    case : Case
    effort : Effort
    truth : ndarray, shape (n_sets, n_parameters)
    errors : tuple of Errors
    gamma : float
        Of the network as printed.
    efficiency : dict of noise -> ndarray, shape (n_parameters,)
        RMS of the refined errors in standard deviations of the bound, set by set: 1 is on the bound.
    nominal_failures : dict of noise -> (failures by log H alone, failures approached on the sphere, sets)
    """

    case: Case
    effort: Effort
    truth: NDArray[np.float64]
    errors: tuple[Errors, ...]
    gamma: float
    efficiency: dict[float, NDArray[np.float64]]
    nominal_failures: dict[float, tuple[int, int, int]]

    def of(self, method: str, noise: float) -> Errors | None:
        """The errors of a method at a noise level, if it was worked out."""
        return next((e for e in self.errors if e.method == method and e.noise == noise), None)

    @property
    def names(self) -> tuple[str, ...]:
        """Parameter names."""
        return tuple(self.case.published)


@dataclass(eq=False)
class Progress:
    """What a study has found so far; chunks of sets are appended in order.

    Parameters
    ----------
    done : int
        Sets verified.
    rows : dict of str -> list of ndarray
        Answers ("method|noise"), bound ("bound|noise") and stated deviations ("std|noise"), chunk by chunk.
    """

    done: int = 0
    rows: dict[str, list[NDArray]] = field(default_factory=dict)

    def add(self, name: str, value: NDArray) -> None:
        """Append a chunk's rows."""
        self.rows.setdefault(name, []).append(value)

    def arrays(self) -> dict[str, NDArray]:
        """One array for each name."""
        return {name: np.vstack(rows) for name, rows in self.rows.items()}

    @classmethod
    def of(cls, arrays: dict[str, NDArray], done: int) -> Progress:
        """From stored arrays."""
        return cls(done, {name: [value] for name, value in arrays.items()})


def study(
    case: Case,
    effort: Effort,
    say: Say = lambda *_: None,
    resume: Progress | None = None,
    save: Callable[[Progress], None] = lambda _: None,
) -> Study:
    """Work a case through; `save` is called after each chunk with what `resume` takes."""
    solver = case.solver()
    free = solver.parameters
    unit = np.random.default_rng(effort.seed + 1).random((effort.sets, len(free)))
    truth = truncated_samples(free, unit)
    networks = train(case, solver, effort, say)
    found = resume or Progress()
    say("verifying", found.done, effort.sets)
    while found.done < effort.sets:
        theta = truth[found.done : found.done + CHUNK]
        clean = solver.frf(theta)
        for noise in effort.noises:
            _verify(found, networks, case, solver, theta, Disturbance(noise).on(clean, effort.seed, FIRST + found.done),
                    noise)  # fmt: skip
        found.done += len(theta)
        save(found)
        say("verifying", found.done, effort.sets)
    failures = _from_nominal(solver, truth, effort, say)
    return _summed(case, effort, truth, found.arrays(), networks, failures)


def train(case: Case, solver: ManyFrfs, effort: Effort, say: Say) -> dict[str, Trained]:
    """Every network that the effort asks for."""
    training = Training(case, solver, effort.seed, say)
    out = {"printed": training.printed(), "network": training.clean(case.samples)}
    if effort.large:
        out["large network"] = training.clean(effort.large, effort.centres)
    for noise in effort.noises:
        if noise > 0 and effort.noisy_samples:
            out[noisy_name(noise)] = training.noisy(effort.noisy_samples, effort.centres, noise)
    return out


def noisy_name(noise: float) -> str:
    """What the network trained with noise is called."""
    return f"network, {100 * noise:g} %"


def _verify(
    found: Progress, networks: dict[str, Trained], case: Case, solver: ManyFrfs, theta: NDArray, value: NDArray,
    noise: float,
) -> None:  # fmt: skip
    """One chunk at one noise level: networks, refinement, bound."""
    answers = {}
    for name, network in networks.items():
        if network.noise in (0.0, noise):
            answers[name] = network(case.frequency, value)
            found.add(f"{name}|{noise:g}", answers[name])
    own = networks.get(noisy_name(noise))
    stated = None if own is None else np.sqrt(np.diag(own.network.residual))
    refined = refine_from(
        solver, value, starts(answers, noise, stated), explained(solver, noise), approach=True, reach=2.0
    )
    found.add(f"refined|{noise:g}", refined.value)
    found.add(f"bound|{noise:g}", bound_deviations(solver, theta, max(noise, 1e-9)))
    found.add(f"std|{noise:g}", bound_deviations(solver, refined.value, max(noise, 1e-9)))


def starts(answers: dict[str, NDArray], noise: float, stated: NDArray | None = None) -> list[NDArray]:
    """Starts of the refinement, most trusted first: the networks, then points scattered about them.

    Parameters
    ----------
    answers : dict of method -> ndarray, shape (n, n_parameters)
    noise : float
    stated : ndarray, shape (n_parameters,), optional
        Standard deviations that the network trained with this noise states: points about its answer are as far apart.
        Further points stand as far from the network without noise as the networks disagree.
    """
    own = noisy_name(noise)
    first = [answers[k] for k in ([own] if own in answers else []) + ["large network", "network"] if k in answers]
    rng, n = np.random.default_rng(17), first[0].shape[1]
    near = [] if stated is None else [first[0] + stated * d * rng.standard_normal(n) for d in NEAR]
    apart = np.maximum(np.abs(first[0] - first[-1]), 1e-4 * np.abs(first[-1]))
    return [*first, *near, *(first[-1] + apart * d * rng.standard_normal(n) for d in TRIES)]


def explained(solver: ManyFrfs, noise: float) -> float:
    """Cost of log H that noise alone stays below in all but one of a million sets."""
    residuals = 2 * int(np.prod(solver.shape))
    if noise == 0.0:
        return 1e-14 * residuals
    return float(chi2.isf(1e-6, residuals - len(solver.parameters))) * (1 + 2 * noise) * noise**2 / 4


def _failed(value: NDArray, theta: NDArray, deviation: NDArray) -> NDArray[np.bool_]:
    return np.any(np.abs(value - theta) > FAILED * deviation + 1e-8 * np.abs(theta), axis=1)


def _summed(
    case: Case, effort: Effort, truth: NDArray, rows: dict[str, NDArray], networks: dict[str, Trained],
    nominal_failures: dict[float, tuple[int, int, int]],
) -> Study:  # fmt: skip
    errors, efficiency = [], {}
    for noise in effort.noises:
        bound, std = rows[f"bound|{noise:g}"], rows[f"std|{noise:g}"]
        for name, network in networks.items():
            answer = rows.get(f"{name}|{noise:g}")
            if answer is not None:
                stated = np.sqrt(np.diag(network.network.residual))
                within = _coverage(answer, truth, stated) if network.noise == noise else None
                errors.append(Errors(name, noise, 100 * (answer / truth - 1), coverage=within))
        refined = rows[f"refined|{noise:g}"]
        failures = int(_failed(refined, truth, bound).sum())
        within = _coverage(refined, truth, std) if noise > 0 else None
        errors.append(Errors("refined", noise, 100 * (refined / truth - 1), failures, within))
        if noise > 0:
            # an unbiased normal estimate at the bound has a mean absolute error of sqrt(2 / pi) deviations
            errors.append(Errors("bound", noise, 100 * np.sqrt(2 / np.pi) * bound / truth))
            efficiency[noise] = np.sqrt((((refined - truth) / bound) ** 2).mean(axis=0))
    gamma = networks["printed"].network.gamma
    return Study(case, effort, truth, tuple(errors), gamma, efficiency, nominal_failures)


def _coverage(answer: NDArray, truth: NDArray, std: NDArray) -> NDArray[np.float64]:
    return (np.abs(answer - truth) <= NORMAL_90 * std).mean(axis=0)


def _from_nominal(solver: ManyFrfs, truth: NDArray, effort: Effort, say: Say) -> dict[float, tuple[int, int, int]]:
    theta = truth[: effort.nominal]
    if not len(theta):
        return {}
    clean = solver.frf(theta)
    begin = np.repeat(nominal(solver.parameters)[None], len(theta), axis=0)
    out = {}
    for number, noise in enumerate(effort.noises):
        value = Disturbance(noise).on(clean, effort.seed, FIRST)
        deviation = bound_deviations(solver, theta, max(noise, 1e-9))
        plain, sphere = (
            int(_failed(refine_many(solver, value, begin, approach=a, reach=2.0).value, theta, deviation).sum())
            for a in (False, True)
        )
        out[noise] = (plain, sphere, len(theta))
        say("from nominal values", number + 1, len(effort.noises))
    return out
