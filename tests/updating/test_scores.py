import numpy as np
import pytest

from labnnum.bands import Band
from labnnum.errors import ConfigError
from labnnum.structures.examples import EXAMPLES
from labnnum.updating import Updater
from labnnum.updating.batch import FrfBatch
from labnnum.updating.kinds import make_features
from labnnum.updating.many import bound_deviations
from labnnum.updating.scores import ScoreBands, references
from labnnum.updating.training import Disturbance
from labnnum.updating.updater import training_plan

from .cases import LINES, measured, truck, truths

STRUCTURE, OUTPUTS, INPUTS, BANDS = truck(outputs=2)
SPREAD = np.array([p.spread for p in STRUCTURE.parameters])


@pytest.fixture(scope="module")
def plan():
    return training_plan(STRUCTURE, BANDS, OUTPUTS, INPUTS, LINES, samples=100, features="score")


@pytest.fixture(scope="module")
def scores(plan):
    """Scores at three references, and these."""
    at = references(STRUCTURE.parameters, 3)
    value, slope = plan.batch().sensitivity(at)
    return ScoreBands.at_references(BANDS, plan.frequency, value, slope, SPREAD), at


def test_near_a_reference_the_scores_are_the_parameters(plan, scores):
    features, at = scores
    n = len(SPREAD)
    assert features.weights.shape[0] == n * len(at)
    for r, theta in enumerate(at):
        for j in range(n):
            step = np.eye(n)[j] * 1e-4 * SPREAD
            moved = features(plan.frequency, plan.frfs(np.array([theta + step, theta - step])))
            found = (moved[0] - moved[1])[r * n : (r + 1) * n] / 2e-4
            assert np.allclose(found, np.eye(n)[j], atol=1e-3)


def test_directions_are_orthonormal_and_hold_the_scores(scores, plan):
    features, _ = scores
    every = features.spanned(most=100, kept=1.0)
    rows = every.weights
    assert np.allclose(rows @ rows.T, np.eye(len(rows)), atol=1e-8)
    unit = features.weights / np.linalg.norm(features.weights, axis=1)[:, None]
    assert np.allclose(np.linalg.norm(unit @ rows.T, axis=1), 1, atol=1e-8)
    few = features.spanned(most=100, kept=0.9).weights
    held = (np.linalg.norm(unit @ few.T, axis=1) ** 2).mean()
    less = (np.linalg.norm(unit @ few[:-1].T, axis=1) ** 2).mean()
    assert less < 0.9 <= held
    assert len(plan.features.weights) <= 36


def test_lines_outside_the_bands_count_nothing(plan):
    value = plan.frfs(STRUCTURE.nominal[None])
    outside = ~np.any([(plan.frequency >= b.low) & (plan.frequency <= b.high) for b in BANDS], axis=0)
    assert outside.any()
    other = value.copy()
    other[..., outside] *= 3
    assert np.array_equal(plan.features(plan.frequency, other), plan.features(plan.frequency, value))


def test_a_band_without_imaginary_part_ignores_the_phase():
    bands = [Band(b.low, b.high, 1.0, 0.0) for b in BANDS]
    plan = training_plan(STRUCTURE, bands, OUTPUTS, INPUTS, LINES, samples=100, features="score")
    value = plan.frfs(STRUCTURE.nominal[None])
    assert np.allclose(plan.features(plan.frequency, value * 1j), plan.features(plan.frequency, value), rtol=1e-12)


def test_trained_with_noise_the_network_alone_comes_near_the_bound():
    example = EXAMPLES["truck"]()
    updater = Updater.train(
        STRUCTURE, BANDS, OUTPUTS, INPUTS, LINES, samples=4000, centres=300, features="score", noise=0.03
    )
    batch = FrfBatch.of(STRUCTURE, updater.frequency, OUTPUTS, example.inputs)
    theta = truths(STRUCTURE, 300, seed=3)
    noisy = Disturbance(0.03).on(batch.frf(theta), 9, 0)
    error = updater.predict(updater.features(updater.frequency, noisy)) - theta
    inside = np.any([(b.low <= LINES) & (b.high >= LINES) for b in BANDS], axis=0)
    bound = bound_deviations(FrfBatch.of(STRUCTURE, LINES[inside], OUTPUTS, example.inputs), theta, 0.03)
    ratio = np.abs(error).mean(axis=0) / (np.sqrt(2 / np.pi) * bound.mean(axis=0))
    assert (ratio > 0.9).all()
    assert (np.delete(ratio, 1) < 1.25).all()
    assert ratio[1] < 2.0


def test_it_is_of_use_on_a_measurement():
    updater = Updater.train(
        STRUCTURE, BANDS, OUTPUTS, INPUTS, LINES, samples=600, centres=200, features="score", noise=0.01
    )
    theta = truths(STRUCTURE, 1)[0]
    estimate = updater.estimate(measured(STRUCTURE, theta, LINES, OUTPUTS, INPUTS, relative=0.01))
    assert (np.abs(estimate.value - theta) < 5 * estimate.std).all()
    assert estimate.warnings == ()


def test_scores_belong_to_their_lines(plan):
    with pytest.raises(ConfigError, match="other lines or channels"):
        plan.features(plan.frequency[:-1], plan.frfs(STRUCTURE.nominal[None])[..., :-1])
    with pytest.raises(ConfigError, match="other lines or channels"):
        make_features("score", BANDS)(plan.frequency, plan.frfs(STRUCTURE.nominal[None]))
    assert isinstance(make_features("score", BANDS, **plan.features.settings()), ScoreBands)
