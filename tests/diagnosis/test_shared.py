"""Noise of the measured input stands in all FRFs at once, and must not count as often as there are sensors."""

from __future__ import annotations

import numpy as np
import pytest

from labnnum.diagnosis.observe import observe
from labnnum.diagnosis.shared import covering, input_noise
from labnnum.diagnosis.task import choose_lines
from labnnum.frf import Frf
from labnnum.recording import Channel, Recording

RATE, N, ROWS = 400.0, 4096, 6
CHANNELS = (
    Channel("f", "force", "reference"),
    *(Channel(f"a{i}", "acceleration", "response") for i in range(ROWS)),
)


def test_covering_is_above_the_covariance_in_every_direction():
    rng = np.random.default_rng(1)
    h = rng.standard_normal((ROWS, 50)) + 1j * rng.standard_normal((ROWS, 50))
    own, noise = np.exp(rng.normal(0, 2, (ROWS, 50))), np.exp(rng.normal(0, 2, 50))
    got = covering(h, own + noise * np.abs(h) ** 2, noise)
    for f in range(50):
        whole = np.diag(own[:, f]) + noise[f] * np.outer(h[:, f], h[:, f].conj())
        assert np.linalg.eigvalsh(np.diag(got[:, f]) - whole)[0] >= -1e-3 * np.trace(whole)
        # and it is no larger than a fair share for every row would make it
        assert np.sum(np.log(got[:, f])) <= np.sum(np.log(own[:, f] + ROWS * noise[f] * np.abs(h[:, f]) ** 2)) + 0.5


def test_covering_leaves_alone_what_shares_nothing():
    v = np.random.default_rng(2).uniform(1, 2, (ROWS, 20))
    assert covering(np.ones((ROWS, 20), complex), v, np.zeros(20)) == pytest.approx(v)
    assert covering(np.ones((1, 20), complex), v[:1], np.full(20, 0.3)) == pytest.approx(v[:1])


def measured(kind: str, seed: int, noise: float = 0.01) -> tuple[Recording, np.ndarray]:
    """Responses that follow the force by flat factors, the force measured with `noise` of its own; and the factors."""
    rng = np.random.default_rng(seed)
    factor = rng.uniform(0.5, 2, ROWS)
    if kind == "multisine":
        spectrum = np.zeros(N // 8 // 2 + 1, complex)
        spectrum[5:200] = np.exp(2j * np.pi * rng.random(195))
        force = np.tile(np.fft.irfft(spectrum) * N / 8 / 20, 8)
    else:
        force = rng.standard_normal(8 * N)
    force = force / force.std()
    clean = np.vstack([force, factor[:, None] * force])
    wrong = noise * np.vstack([np.ones(1), 0.1 * factor[:, None]])
    data = clean + wrong * rng.standard_normal(clean.shape)
    period = N // 8 if kind == "multisine" else None
    return Recording(CHANNELS, data, RATE, period=period), factor


@pytest.mark.parametrize("kind", ["multisine", "random"])
def test_a_common_factor_is_as_uncertain_as_it_is(kind: str):
    common, single, alone = [], [], []
    for seed in range(6):
        recording, factor = measured(kind, seed)
        frf = observe(recording).frf
        assert frf.variance is not None
        assert frf.covering_variance is not None
        wrong, v = frf.value[:, 0] / factor[:, None] - 1, frf.covering_variance[:, 0] / factor[:, None] ** 2
        alone.append(np.mean(np.abs(wrong) ** 2 / frf.variance[:, 0] * factor[:, None] ** 2))
        mean = np.sum(wrong / v, axis=0) / np.sum(1 / v, axis=0)
        common.append(np.mean(np.abs(mean) ** 2 * np.sum(1 / v, axis=0)))
        single.append(np.mean(np.abs(wrong) ** 2 / v))
    assert np.mean(common) < 1.6  # six where rows count as independent
    assert 1 / ROWS / 1.3 < np.mean(single) < 0.5
    assert 0.7 < np.mean(alone) < 1.6


def test_the_noise_of_the_input_is_found_from_the_residuals():
    rng = np.random.default_rng(5)
    h = rng.uniform(0.5, 2, (ROWS, 200)) * np.exp(2j * np.pi * rng.random((ROWS, 200)))
    power = np.linspace(1, 4, 200)
    own = 0.05 * rng.uniform(0.5, 1.5, (ROWS, 1))
    shared = 0.1 / np.sqrt(power)

    def draw(*shape: int) -> np.ndarray:
        return (rng.standard_normal(shape) + 1j * rng.standard_normal(shape)) / np.sqrt(2)

    residual = own * draw(11, ROWS, 200) - h * shared * draw(11, 1, 200)
    variance = np.broadcast_to(own**2 + shared**2 * np.abs(h) ** 2, h.shape)
    assert input_noise(h, residual, variance, power) == pytest.approx(shared**2, rel=0.35)
    quiet = input_noise(h, own * draw(11, ROWS, 200), np.broadcast_to(own**2, h.shape), power)
    assert np.median(quiet / np.min(own**2 / np.abs(h) ** 2, axis=0)) < 0.1


def test_lines_are_not_chosen_for_their_noise():
    rng = np.random.default_rng(6)
    f = np.linspace(10, 100, 1500)
    wrong = (rng.standard_normal((2, 1, 1500)) + 1j * rng.standard_normal((2, 1, 1500))) / np.sqrt(2)
    frf = Frf(f, 1 + 0.1 * wrong, CHANNELS[1:3], CHANNELS[:1], None, np.full((2, 1, 1500), 0.01), 10.0)
    chosen = choose_lines(frf, 200)
    assert chosen.frequency.size > 100
    assert np.mean(np.abs(chosen.value - 1) ** 2) / 0.01 == pytest.approx(1.0, abs=0.2)


def test_where_noise_is_not_measured_lines_still_follow_a_peak():
    f = np.linspace(10, 100, 1500)
    h = 1 / (1 - (f / 40) ** 2 + 2j * 0.004 * f / 40)
    rough = np.full((1, 1, 1500), 1.0)  # differences take a sharp peak for noise
    frf = Frf(f, h[None, None], CHANNELS[1:2], CHANNELS[:1], None, rough)
    near = np.abs(f - 40) < 0.5
    known = choose_lines(Frf(f, h[None, None], CHANNELS[1:2], CHANNELS[:1], None, rough, 10.0), 100)
    assert np.isin(f[near], choose_lines(frf, 100).frequency).sum() > np.isin(f[near], known.frequency).sum()
