"""One case worked through: networks trained, thousands of sets verified, errors beside the bound."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from labnnum.parameters import truncated_samples
from labnnum.updating.batch import FrfBatch
from labnnum.updating.features import Features
from labnnum.updating.many import bound_deviations, refine_many
from labnnum.updating.network import RbfNetwork
from labnnum.updating.training import Disturbance, TrainingPlan, TrainingSet, make_training_set
from labnnum.updating.updater import Updater, training_plan
from sessions.reproduce.cases import Case

CHUNK = 250
FAILED = 8.0
"""Standard deviations of the bound beyond which a refined estimate counts as a failure."""

Say = Callable[[str, int, int], None]


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
        Samples of a further clean network on the same number of centres as the dissertation's; 0 leaves it out.
    nominal : int
        Sets that are refined from the nominal values too, to count failures; 0 leaves that out.
    seed : int
    """

    sets: int = 1000
    noises: tuple[float, ...] = (0.0, 0.01, 0.03)
    noisy_samples: int = 8000
    centres: int = 800
    large: int = 0
    nominal: int = 200
    seed: int = 0


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
    """

    method: str
    noise: float
    signed: NDArray[np.float64]
    failures: int | None = None

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
    worst : mapping-like tuple of (method, set number)
        The set with the largest summed error, clean FRF, of each network.
    nominal_failures : mapping of noise -> (plain, on the sphere)
        Failures among `effort.nominal` sets from the nominal start, by log H alone and approached on the sphere.
    """

    case: Case
    effort: Effort
    truth: NDArray[np.float64]
    errors: tuple[Errors, ...]
    gamma: float
    nominal_failures: dict[float, tuple[int, int]]

    def of(self, method: str, noise: float) -> Errors | None:
        """The errors of a method at a noise level, if it was worked out."""
        return next((e for e in self.errors if e.method == method and e.noise == noise), None)

    @property
    def names(self) -> tuple[str, ...]:
        """Parameter names."""
        return tuple(p.name for p in self.case.example.structure.parameters)


def study(case: Case, effort: Effort, say: Say = lambda *_: None) -> Study:
    """Work a case through."""
    e = case.example
    batch = FrfBatch.of(e.structure, case.lines, e.outputs, e.inputs)
    unit = np.random.default_rng(effort.seed + 1).random((effort.sets, len(e.structure.parameters)))
    truth = truncated_samples(e.structure.parameters, unit)
    networks, gamma = _networks(case, effort, say)
    found: dict[tuple[str, float], list[NDArray]] = {}
    failures: dict[float, int] = dict.fromkeys(effort.noises, 0)
    bounds: dict[float, NDArray] = {}
    for start in range(0, effort.sets, CHUNK):
        theta = truth[start : start + CHUNK]
        clean = batch.frf(theta)
        for noise in effort.noises:
            value = Disturbance(noise).on(clean, effort.seed, 20_000_000 + start)
            first = None
            for name, (features, network) in networks.items():
                if _applies(name, noise):
                    answer = network(features(case.lines, value))
                    found.setdefault((name, noise), []).append(answer)
                    first = answer if first is None or name.startswith("network") else first
            assert first is not None
            refined = refine_many(batch, value, first, approach=True, reach=2.0)
            deviation = bound_deviations(batch, theta, max(noise, 1e-9))
            bounds[noise] = np.vstack([bounds.get(noise, np.empty((0, theta.shape[1]))), deviation])
            failures[noise] += int(_failed(refined.value, theta, deviation).sum())
            found.setdefault(("refined", noise), []).append(refined.value)
        say("verifying", min(start + CHUNK, effort.sets), effort.sets)
    errors = _errors(found, truth, failures)
    errors += [_bound(noise, deviation, truth) for noise, deviation in bounds.items() if noise > 0]
    return Study(case, effort, truth, tuple(errors), gamma, _nominal(batch, truth, effort))


def _applies(name: str, noise: float) -> bool:
    """Clean networks answer at every level, one trained with noise at its own."""
    return "%" not in name or name.endswith(f" {100 * noise:g} %")


def _networks(case: Case, effort: Effort, say: Say) -> tuple[dict[str, tuple[Features, RbfNetwork]], float]:
    """The network as printed, ours of the same size, and ours trained with each noise level."""
    out: dict[str, tuple[Features, RbfNetwork]] = {}
    n = case.example.samples
    printed = _plan(case, n, effort.seed, "integrals", "prior", 0.0)
    made = Updater.from_training(printed, _set(printed, "as printed", say), network="printed")
    out["printed"] = (made.features, made.network)
    gamma = made.network.gamma
    plan = _plan(case, n, effort.seed, case.features, "sobol", 0.0)
    made = Updater.from_training(plan, _set(plan, "ours", say))
    out["network"] = (made.features, made.network)
    if effort.large:
        plan = _plan(case, effort.large, effort.seed, case.features, "sobol", 0.0)
        made = Updater.from_training(plan, _set(plan, "large", say), centres=n)
        out["large network"] = (made.features, made.network)
    for noise in effort.noises:
        if noise > 0 and effort.noisy_samples:
            plan = _plan(case, effort.noisy_samples, effort.seed, case.features, "sobol", noise)
            made = Updater.from_training(plan, _set(plan, f"{100 * noise:g} % noise", say), centres=effort.centres)
            out[f"network, {100 * noise:g} %"] = (made.features, made.network)
    return out, gamma


def _plan(case: Case, samples: int, seed: int, features: str, sampling, noise: float) -> TrainingPlan:
    e = case.example
    return training_plan(
        e.structure, e.bands, e.outputs, e.inputs, case.lines, samples=samples, seed=seed, features=features,
        sampling=sampling, noise=noise,
    )  # fmt: skip


def _set(plan: TrainingPlan, what: str, say: Say) -> TrainingSet:
    return make_training_set(plan, progress=lambda done, total: say(f"training {what}", done, total))


def _failed(value: NDArray, theta: NDArray, deviation: NDArray) -> NDArray[np.bool_]:
    return (np.abs(value - theta) > FAILED * deviation + 1e-8 * np.abs(theta)).any(axis=1)


def _errors(found: dict, truth: NDArray, failures: dict[float, int]) -> list[Errors]:
    out = []
    for (name, noise), answers in found.items():
        signed = 100 * (np.vstack(answers) / truth - 1)
        out.append(Errors(name, noise, signed, failures[noise] if name == "refined" else None))
    return out


def _bound(noise: float, deviation: NDArray, truth: NDArray) -> Errors:
    """What an unbiased normal estimate at the bound would show: its mean absolute error is sqrt(2/pi) deviations."""
    return Errors("bound", noise, 100 * np.sqrt(2 / np.pi) * deviation / truth)


def _nominal(batch: FrfBatch, truth: NDArray, effort: Effort) -> dict[float, tuple[int, int]]:
    theta = truth[: effort.nominal]
    if not len(theta):
        return {}
    clean = batch.frf(theta)
    begin = np.repeat(batch.structure.nominal[None], len(theta), axis=0)
    out = {}
    for noise in effort.noises:
        value = Disturbance(noise).on(clean, effort.seed, 20_000_000)
        deviation = bound_deviations(batch, theta, max(noise, 1e-9))
        plain, sphere = (
            int(_failed(refine_many(batch, value, begin, approach=a, reach=2.0).value, theta, deviation).sum())
            for a in (False, True)
        )
        out[noise] = (plain, sphere)
    return out


def smaller(effort: Effort, sets: int) -> Effort:
    """The same effort on fewer sets."""
    return replace(effort, sets=min(effort.sets, sets))


def summary(done: Study) -> dict:
    """Figures of a study as plain numbers: noise -> parameter -> method -> mean and largest error."""
    out: dict = {"case": done.case.name, "where": done.case.where, "sets": len(done.truth), "gamma": done.gamma}
    out["published"] = {n: list(v) for n, v in done.case.published.items()}
    for noise in done.effort.noises:
        rows = {}
        for j, name in enumerate(done.names):
            rows[name] = {
                e.method: {"mean": float(e.mean[j]), "max": float(e.most[j])} for e in done.errors if e.noise == noise
            }
        refined = done.of("refined", noise)
        out[f"{100 * noise:g} %"] = {
            "parameters": rows,
            "failures": None if refined is None else refined.failures,
            "nominal_failures": list(done.nominal_failures.get(noise, ())),
        }
    return out


def methods(done: Study, noise: float) -> Sequence[str]:
    """Methods worked out at a noise level, in the order of the table."""
    order = ["printed", "network", "large network", f"network, {100 * noise:g} %", "refined", "bound"]
    return [m for m in order if done.of(m, noise) is not None]
