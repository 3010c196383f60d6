"""Clipping from samples alone: found where it is, not where a peak is merely smooth."""

import numpy as np
import pytest

from labnnum.clipping import _both_rails, clipped_runs, noise_level, resolution, returns, runs

T = np.arange(20000) / 20000


@pytest.mark.parametrize("cycles", [1, 3, 10, 50, 500])
@pytest.mark.parametrize("bits", [0, 8, 12, 16])
def test_an_unclipped_sine_is_not_clipped(cycles, bits):
    x = np.sin(2 * np.pi * cycles * T)
    assert clipped_runs(_digitised(x, bits)) == []


@pytest.mark.parametrize("cycles", [1, 10, 500])
@pytest.mark.parametrize("bits", [0, 12, 16])
@pytest.mark.parametrize("noise", [0.0, 1e-4, 1e-2])
def test_a_clipped_sine_is(cycles, bits, noise):
    rng = np.random.default_rng(0)
    x = np.sin(2 * np.pi * cycles * T) + noise * rng.standard_normal(T.size)
    found = clipped_runs(_digitised(np.clip(x, -0.8, 0.8), bits))
    assert len(found) >= 2 * cycles


def test_clipping_on_one_side_is_found_there():
    x = np.sin(2 * np.pi * 10 * T)
    found = clipped_runs(np.minimum(x, 0.9))
    assert len(found) == 10
    assert all(x[a:b].min() >= 0.9 for a, b in found)


def test_an_amplifier_that_clips_before_the_noise_is_found():
    rng = np.random.default_rng(1)
    x = np.clip(np.sin(2 * np.pi * 3 * T), -0.8, 0.8) + 1e-3 * rng.standard_normal(T.size)
    assert clipped_runs(x)
    assert clipped_runs(np.sin(2 * np.pi * 3 * T) + 1e-3 * rng.standard_normal(T.size)) == []


def test_rest_is_not_a_rail():
    gated = np.where((T > 0.1) & (T < 0.12), np.sin(np.pi * (T - 0.1) / 0.02), 0.0)
    assert clipped_runs(gated) == []
    assert clipped_runs(np.zeros(100)) == []
    assert clipped_runs(np.array([0.0, 1.0])) == []


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("bits", [0, 8, 16])
def test_noise_is_not_clipped(seed, bits):
    x = np.random.default_rng(seed).standard_normal(20000)
    assert clipped_runs(_digitised(x / 5, bits)) == []


def test_a_known_rail_needs_no_plateau():
    x = np.sin(2 * np.pi * 5 * T)
    assert clipped_runs(x, full_scale=2.0) == []
    assert len(clipped_runs(x, full_scale=1.0)) == 10


def test_resolution_and_noise_are_measured():
    rng = np.random.default_rng(2)
    x = _digitised(0.5 * np.sin(2 * np.pi * 5 * T) + 0.01 * rng.standard_normal(T.size), 12)
    assert resolution(x) == pytest.approx(1 / 2048)
    assert noise_level(x) == pytest.approx(0.01, rel=0.15)
    assert noise_level(np.zeros(10)) == 0
    assert runs(np.zeros(3)) == []


def _digitised(x, bits):
    return np.round(x * 2 ** (bits - 1)) / 2 ** (bits - 1) if bits else x


def test_a_fast_signal_that_swings_between_both_rails_is_found():
    t = np.arange(4000)
    ringing = np.exp(-t / 300) * np.sin(2 * np.pi * 0.24 * t + 0.4)
    for bits in (0, 12):
        x = np.clip(ringing, -0.6, 0.6)
        x = np.round(x * 2048) / 2048 if bits else x
        assert clipped_runs(x), bits
    assert clipped_runs(ringing) == []
    assert clipped_runs(np.round(ringing * 2048) / 2048) == []


@pytest.mark.parametrize("period", [3, 4, 5, 6, 8, 12])
def test_a_sine_in_step_with_the_rate_swings_between_no_rails(period):
    t = np.arange(4000)
    assert clipped_runs(np.sin(2 * np.pi * t / period + np.pi / 4) + 1e-4 * np.sin(0.377 * t**1.1)) == []
    few = np.random.default_rng(0).integers(-2, 3, 4000).astype(float)
    assert not [r for r in _both_rails(few, 1.0)]


@pytest.mark.parametrize("steps", [1, 2, 5])
def test_a_signal_of_a_few_of_the_converters_steps_is_coarse_and_not_clipped(steps):
    rng = np.random.default_rng(3)
    x = np.round(np.clip(0.4 * steps * rng.standard_normal(20000), -steps, steps)) * 0.0479
    assert clipped_runs(x) == []
    assert clipped_runs(x, full_scale=0.0479 * steps)


def _noise(n=20000, over=1.0):
    return over * np.random.default_rng(5).standard_normal(n)


def test_single_samples_that_return_to_one_value_are_at_a_rail():
    """White noise stays at a rail for one sample at a time."""
    x = _noise()
    top = np.sort(x)[-40]
    held = clipped_runs(np.minimum(x, top))
    assert sum(b - a for a, b in held) == 40
    assert clipped_runs(x) == []


@pytest.mark.parametrize("bits", [0, 8, 12, 16])
@pytest.mark.parametrize("what", ["noise", "sine", "repeated", "swelling"])
def test_a_signal_that_returns_to_every_value_alike_is_at_no_rail(what, bits):
    t = np.arange(20000)
    x = {
        "noise": _noise(), "sine": np.sin(2 * np.pi * t / 100), "repeated": np.tile(_noise(500), 40),
        "swelling": np.sin(1e-5 * t**2) * np.sin(np.pi * t / t.size),
    }[what]  # fmt: skip
    x = _digitised(x / np.abs(x).max() * 0.9, bits)
    assert not returns(x)
    assert not returns(-x)
