"""Updater: a trained network with everything needed to use it on a measurement, and to refuse one that does not fit."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from typing import Any, final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from labnnum.bands import Band, band_mask, check_bands
from labnnum.errors import BandError, ConfigError, ModelError
from labnnum.frf import Frf
from labnnum.parameters import Estimate
from labnnum.recording import Channel
from labnnum.response import frf_sensitivity
from labnnum.structures.base import Structure
from labnnum.updating.features import BandIntegrals, Features
from labnnum.updating.fitting import fit_printed, fit_tuned
from labnnum.updating.kinds import make_features
from labnnum.updating.matching import matched
from labnnum.updating.network import RbfNetwork
from labnnum.updating.novelty import Novelty, feature_noise
from labnnum.updating.refine import refine
from labnnum.updating.seen import view_like, view_settings
from labnnum.updating.training import (
    Disturbance,
    Progress,
    Sampling,
    TrainingPlan,
    TrainingSet,
    draw,
    make_training_set,
)

LINES = 2000
"""Most lines of an FRF that a network is trained on; of more, every second, third, ... is taken."""

VALIDATION = 256
"""Parameter sets from the prior on which a new updater is checked."""


@final
@dataclass(frozen=True, eq=False)
class Updater:
    """A trained network, what it was trained for, and how well it does.

    Parameters
    ----------
    structure : Structure
    features : Features
        With the bands.
    outputs, inputs : sequence of Channel
        Channels that a measurement must have; names are free, places and quantities count.
    frequency : ndarray, shape (n_f,)
        Lines of the training FRFs, in Hz.
    network : RbfNetwork
    novelty : Novelty
        What tells a measurement outside the training range.
    validation : ndarray, shape (2, n_parameters)
        Mean and largest relative error of the network over sets from the prior, in percent (equations 4.4, 4.5).
    settings : mapping
        Samples, seed, sampling, margin, noise, network, and the window of the training FRFs.
    trained_variance : ndarray, shape (n_out, n_in, n_f), optional
        E|dH|^2 / |H|^2 put on the training FRFs where a measurement's random error was taken; None where none was,
        and in files that did not keep it.
    """

    structure: Structure
    features: Features
    outputs: tuple[Channel, ...]
    inputs: tuple[Channel, ...]
    frequency: NDArray[np.float64]
    network: RbfNetwork
    novelty: Novelty
    validation: NDArray[np.float64]
    settings: dict[str, Any]
    trained_variance: NDArray[np.float64] | None = None

    @property
    def bands(self) -> tuple[Band, ...]:
        """Bands that the features cover."""
        return self.features.bands

    @classmethod
    def train(
        cls,
        structure: Structure,
        bands: Sequence[Band],
        outputs: Sequence[Channel],
        inputs: Sequence[Channel],
        frequency: ArrayLike,
        *,
        samples: int = 1000,
        seed: int = 0,
        features: str = "log",
        network: str = "tuned",
        sampling: Sampling | None = None,
        margin: float = 0.05,
        centres: int | None = None,
        noise: float = 0.0,
        like: Frf | None = None,
        progress: Progress | None = None,
        resume: TrainingSet | None = None,
        save: Any = None,
        executor: Executor | None = None,
    ) -> Updater:
        """A new updater.

        Parameters
        ----------
        structure : Structure
            Its free parameters are what the updater will estimate.
        bands : sequence of Band
        outputs, inputs : sequence of Channel
        frequency : array_like, shape (n_f,)
            Lines of the measurements to come, in Hz.
        samples, seed, sampling, margin
            Of the training set, see `labnnum.updating.training.draw`; a tuned network takes Sobol points, the
            printed one draws from the prior.
        features : {"log", "integrals", "sphere", "score"}
            "score" for training with noise.
        network : {"tuned", "printed"}
            "printed" is the dissertation's own: integrals, exp(-d), every sample a centre.
        centres : int, optional
            Fewer centres than samples: least squares instead of interpolation.
        noise : float
            Standard deviation of the noise on training FRFs, as a share of |H| (section 6.2).
        like : Frf, optional
            A measurement: its window is put on the training FRFs, and its random error too unless `noise` is given.
        progress, resume, save, executor
            See `make_training_set`.

        Raises
        ------
        BandError, ModelError, ChannelError, EstimationError
            If bands, model and channels do not fit each other.
        """
        plan = training_plan(
            structure, bands, outputs, inputs, frequency, samples=samples, seed=seed, margin=margin, noise=noise,
            features="integrals" if network == "printed" else features, like=like,
            sampling=sampling or ("prior" if network == "printed" else "sobol"),
        )  # fmt: skip
        data = make_training_set(plan, progress=progress, resume=resume, save=save, executor=executor)
        return cls.from_training(plan, data, network=network, centres=centres, like=like)

    @classmethod
    def from_training(
        cls, plan: TrainingPlan, data: TrainingSet, *, network: str = "tuned", centres: int | None = None,
        like: Frf | None = None,
    ) -> Updater:  # fmt: skip
        """The updater that a complete training set gives."""
        if network not in ("tuned", "printed"):
            raise ConfigError(f"network {network!r}: expected tuned or printed")
        if network == "printed":
            trained = fit_printed(data.features, data.parameters, gamma=None, weights=_weights(plan))
        else:
            trained = fit_tuned(
                data.features, data.parameters, centres=centres, seed=plan.seed, most=plan.features.components
            )
        truth = draw(plan.structure.parameters, VALIDATION, "prior", plan.seed + 1_000_003, 0.0)
        validation, novelty = _validate(plan, trained, truth)
        settings = {
            "samples": plan.samples, "seed": plan.seed, "sampling": plan.sampling, "margin": plan.margin,
            "noise": plan.noise.relative, "noise_like_measured": plan.noise.variance is not None,
            "network": network, **({} if like is None else view_settings(like)),
        }  # fmt: skip
        return cls(
            plan.structure, plan.features, plan.outputs, plan.inputs, plan.frequency, trained, novelty, validation,
            settings, plan.noise.variance,
        )  # fmt: skip

    def network_estimate(self, frf: Frf) -> Estimate:
        """The network's answer alone, with its standard deviations and a flag for input outside its training."""
        return self._network(*self._taken(frf))

    def estimate(self, frf: Frf, *, refined: bool = True, prior: bool = False, floor: float | None = None) -> Estimate:
        """Parameters of the measured structure: the network's answer, then least squares on the FRF.

        Parameters
        ----------
        frf : Frf
            Must have the updater's channels and cover its bands.
        refined : bool
            False stops after the network.
        prior, floor
            See `labnnum.updating.refine.refine`.

        Raises
        ------
        ChannelError
            If a channel of the training is missing; it is named.
        BandError
            If the FRF does not cover a band.
        """
        mine, remarks = self._taken(frf)
        first = self._network(mine, remarks)
        if not refined:
            return first
        found = refine(self.structure, mine, first.value, bands=self.bands, prior=prior, floor=floor)
        outside = [w for w in first.warnings if w not in remarks]
        return replace(found, method="network + least squares", warnings=(*remarks, *outside, *found.warnings))

    def predict(self, features: ArrayLike) -> NDArray[np.float64]:
        """Parameters of feature vectors, (n_features,) or (n, n_features): the network and nothing else."""
        return self.network(np.asarray(features, float))

    def _taken(self, frf: Frf) -> tuple[Frf, tuple[str, ...]]:
        """The FRF in the updater's channels, and remarks on how it differs from the training."""
        mine = matched(frf, self.outputs, self.inputs)
        check_bands(self.bands, mine.frequency)
        for band in self.bands:
            if mine.frequency[0] > band.low or mine.frequency[-1] < band.high:
                raise BandError(
                    f"the updater's band [{band.low:g}, {band.high:g}] Hz reaches outside the FRF"
                    f" ({mine.frequency[0]:g} to {mine.frequency[-1]:g} Hz): measure it, or train with other bands"
                )
        remarks = []
        if common_lines(mine.frequency, self.frequency) is None:
            remarks.append("the FRF's lines differ from those of the training; the network sees it interpolated")
        theirs = view_settings(mine)
        ours = {k: self.settings.get(k) for k in theirs}
        if theirs and ours != theirs and any(v is not None for v in ours.values()):
            remarks.append("the FRF was made with another window than the training set: the network alone is biased")
        return mine, tuple(remarks)

    def _network(self, mine: Frf, remarks: tuple[str, ...]) -> Estimate:
        same = common_lines(mine.frequency, self.frequency)
        on_lines = resampled(mine, self.frequency) if same is None else mine.at(same)
        x = self.features(on_lines.frequency, on_lines.value)
        theta = self.network(x)
        scatter = feature_noise(on_lines, self.features)
        slope = self.network.jacobian(x)
        own = self._beyond_training(slope, scatter, on_lines)
        expected, forward = self._expected(np.clip(theta, *self._box()), on_lines)
        flags = self.novelty.verdict(x - expected, scatter - (scatter @ slope.T) @ forward)
        found = Estimate(self.structure.parameters, theta, self.network.residual + own, "network")
        return replace(found, warnings=(*remarks, *flags, *self._outside(found)))

    def _beyond_training(self, slope: NDArray, scatter: NDArray, frf: Frf) -> NDArray[np.float64]:
        """Covariance of the answer by the measurement's random error, less what the training noise already gave.

        Where the training noise is not known, nothing is taken off: the answer is then rather too modest.
        """
        spread = np.array([p.spread for p in self.structure.parameters])

        def of(errors: NDArray) -> NDArray[np.float64]:
            moved = (slope @ errors.T) / spread[:, None]
            return moved @ moved.T / errors.shape[0]

        trained = Disturbance(self.settings.get("noise") or 0.0, self._trained_variance(frf))
        if trained.is_none:
            return of(scatter) * np.outer(spread, spread)
        known = of(feature_noise(frf, self.features, trained.power * np.abs(frf.value) ** 2))
        power, vectors = np.linalg.eigh(of(scatter) - known)
        return (vectors * np.maximum(power, 0.0)) @ vectors.T * np.outer(spread, spread)

    def _trained_variance(self, frf: Frf) -> NDArray[np.float64] | None:
        """The variance of the training on the lines of an FRF, which are the training's or some of them."""
        if self.trained_variance is None:
            return None
        return self.trained_variance[..., common_lines(self.frequency, frf.frequency)]

    def _box(self) -> NDArray[np.float64]:
        """Range of the training parameters, shape (2, n_parameters)."""
        return self.novelty.box

    def _outside(self, found: Estimate) -> list[str]:
        low, high = self._box()
        reach = 3 * found.std + 0.01 * (high - low)
        return [
            f"outside the training range: {p.name} = {v:.4g} {p.unit}, trained from {p.lower:.4g} to {p.upper:.4g}"
            for p, v, a, b in zip(found.parameters, found.value, low - reach, high + reach, strict=True)
            if not a <= v <= b
        ]

    def _expected(self, theta: NDArray, frf: Frf) -> tuple[NDArray, NDArray]:
        """Features of the model's FRF at theta, (n_features,), and their derivatives, (n_parameters, n_features)."""
        view = view_like(self.settings, frf.frequency, self.structure, theta)
        grid = frf.frequency if view is None else view.frequency
        value, slope = frf_sensitivity(self.structure, theta, grid, self.outputs, self.inputs)
        if view is not None:
            value, slope = view.apply(value), view.apply(slope)
        step = 1e-4 * np.array([p.spread for p in self.structure.parameters])
        moved = slope * step[:, None, None, None]
        up, down = self.features(frf.frequency, value + moved), self.features(frf.frequency, value - moved)
        return self.features(frf.frequency, value), (up - down) / (2 * step[:, None])


def training_plan(
    structure: Structure,
    bands: Sequence[Band],
    outputs: Sequence[Channel],
    inputs: Sequence[Channel],
    frequency: ArrayLike,
    *,
    samples: int = 1000,
    seed: int = 0,
    features: str = "log",
    sampling: Sampling = "sobol",
    margin: float = 0.05,
    noise: float = 0.0,
    like: Frf | None = None,
) -> TrainingPlan:
    """The plan of a training set, checked: bands against lines, channels against the structure; features fitted."""
    if not structure.parameters:
        raise ModelError("the model has no free parameter: add a [[parameter]] entry to its file")
    lines = np.asarray(frequency, float)
    ordered = check_bands(bands, lines)
    keep = _needed(lines, ordered)
    keep = _thinned(np.flatnonzero(keep), LINES)
    lines = lines[keep]
    check_bands(ordered, lines)
    disturbance = Disturbance(noise)
    if like is not None and noise == 0.0 and like.variance is not None:
        cut = matched(like, outputs, inputs).at(keep)
        relative = np.asarray(cut.variance) / np.maximum(np.abs(cut.value) ** 2, 1e-300)
        disturbance = Disturbance(variance=np.minimum(relative, 1.0))
    plan = TrainingPlan(
        structure, make_features(features, ordered), tuple(outputs), tuple(inputs), lines, samples, seed, sampling,
        margin, disturbance, None if like is None else view_like(view_settings(like), lines, structure),
    )  # fmt: skip
    return plan.with_fitted_features()


def _weights(plan: TrainingPlan) -> NDArray[np.float64] | None:
    """Weights of normalised inputs, where the features are integrals."""
    pairs = len(plan.outputs) * len(plan.inputs)
    return plan.features.weights(pairs) if isinstance(plan.features, BandIntegrals) else None


def _needed(lines: NDArray, bands: Sequence[Band]) -> NDArray[np.bool_]:
    """Lines inside the bands and the ones next to their edges."""
    inside = band_mask(bands, lines)
    wide = inside.copy()
    wide[:-1] |= inside[1:]
    wide[1:] |= inside[:-1]
    return wide


def common_lines(have: NDArray, want: NDArray) -> NDArray[np.intp] | None:
    """Numbers of the lines `want` among those that a measurement has; None if one is missing."""
    at = np.clip(np.searchsorted(have, want), 1, have.size - 1)
    at = np.where(np.abs(have[at - 1] - want) < np.abs(have[at] - want), at - 1, at)
    return at if np.allclose(have[at], want, rtol=1e-7, atol=0) else None


def _thinned(numbers: NDArray, most: int) -> NDArray[np.intp]:
    """Every second, third, ... of the line numbers, about `most`, with both ends of every unbroken run."""
    keep = np.zeros(numbers.size, bool)
    keep[:: max(1, -(-numbers.size // most))] = True
    gaps = np.flatnonzero(np.diff(numbers) > 1)
    keep[[0, -1, *gaps, *(gaps + 1)]] = True
    return numbers[keep]


def resampled(frf: Frf, frequency: NDArray) -> Frf:
    """The FRF on other lines, magnitude and unwrapped phase interpolated."""
    grid = frequency[(frequency >= frf.frequency[0]) & (frequency <= frf.frequency[-1])]
    log = np.log(np.maximum(np.abs(frf.value), 1e-300)) + 1j * np.unwrap(np.angle(frf.value), axis=-1)
    rows = log.reshape(-1, log.shape[-1])
    value = np.array([np.exp(np.interp(grid, frf.frequency, row)) for row in rows])
    variance = None
    if frf.variance is not None:
        flat = np.asarray(frf.variance).reshape(rows.shape)
        variance = np.array([np.interp(grid, frf.frequency, v) for v in flat]).reshape(*log.shape[:-1], -1)
    return Frf(
        grid, value.reshape(*log.shape[:-1], -1), frf.outputs, frf.inputs, variance=variance,
        n_averages=frf.n_averages, estimator=frf.estimator, settings=frf.settings,
    )  # fmt: skip


def relative_error(estimate: NDArray, truth: NDArray, spread: NDArray) -> NDArray[np.float64]:
    """|estimate - truth| in percent of |truth|, or of the spread where that is larger than |truth|."""
    return 100 * np.abs(estimate - truth) / np.where(np.abs(truth) > spread, np.abs(truth), spread)


def _validate(plan: TrainingPlan, network: RbfNetwork, truth: NDArray) -> tuple[NDArray, Novelty]:
    batch = plan.batch()
    x = plan.features(plan.frequency, plan.noise.on(plan.frfs(truth, batch), plan.seed, 10_000_000))
    found = network(x)
    spread = np.array([p.spread for p in plan.structure.parameters])
    error = relative_error(found, truth, spread)
    widened = draw(plan.structure.parameters, 512, "random", plan.seed, plan.margin)
    box = np.array([widened.min(axis=0), widened.max(axis=0)])
    expected = plan.features(plan.frequency, plan.frfs(np.clip(found, *box), batch))
    return np.array([error.mean(axis=0), error.max(axis=0)]), Novelty(x - expected, box)
