"""Local rational FRFs against closed forms: noise and sweeps, transients at both ends, honest variances."""

import numpy as np
import pytest

from labnnum.errors import ChannelError, EstimationError
from labnnum.estimators import H1
from labnnum.local import local_frf
from labnnum.recording import Channel, Recording
from labnnum.spectra import Welch

RATE, N = 1000.0, 40000
CHANNELS = (Channel("f", "force", "reference"), Channel("a", "acceleration", "response"))
OMEGA = 2 * np.pi * np.array([50.0, 53.0, 120.0, 300.0])
ZETA, SHARE = np.array([0.01, 0.008, 0.01, 0.005]), np.array([1.0, -0.7, 0.5, 1.0])


def exact(frequency):
    s = 2j * np.pi * frequency
    return sum(a * s**2 / (s**2 + 2 * z * w * s + w**2) for a, z, w in zip(SHARE, ZETA, OMEGA, strict=True))


def record(kind, noise=1e-3, seed=1):
    """Response to a stretch of noise that began long before, or to a sweep from rest, still ringing at its end."""
    rng = np.random.default_rng(seed)
    total = 4 * N
    line = np.fft.rfftfreq(total, 1 / RATE)
    if kind == "noise":
        force = np.fft.irfft(np.where(line < 420, np.fft.rfft(rng.standard_normal(total)), 0))
        at = slice(total // 2, total // 2 + N)
    else:
        t = np.arange(N) / RATE
        force = np.zeros(total)
        force[:N] = np.sin(2 * np.pi * (10 * t + 390 * t**2 / 2 / t[-1]))
        at = slice(0, N)
    answer = np.fft.irfft(np.fft.rfft(force) * exact(line))[at]
    answer = answer + noise * answer.std() * rng.standard_normal(N)
    return Recording(CHANNELS, np.vstack([force[at], answer]), RATE)


def errors(frf):
    inside = (frf.frequency > 20) & (frf.frequency < 390)
    truth = exact(frf.frequency[inside])
    return frf.value[0, 0, inside] - truth, truth, None if frf.variance is None else frf.variance[0, 0, inside]


@pytest.mark.parametrize("kind", ["noise", "sweep"])
def test_resonances_are_seen_without_leakage(kind):
    recording = record(kind)
    wrong, truth, _ = errors(local_frf(recording))
    welch, seen, _ = errors(H1(Welch(2048, window="hann", overlap=0.5))(recording))
    ours = np.median((np.abs(wrong) / np.abs(truth))[np.abs(truth) > 10])
    theirs = np.median((np.abs(welch) / np.abs(seen))[np.abs(seen) > 10])
    assert ours < 2e-3
    assert ours < 0.1 * theirs


@pytest.mark.parametrize("kind", ["noise", "sweep"])
def test_stated_variance_is_the_error_s(kind):
    wrong, _, variance = errors(local_frf(record(kind, noise=0.03, seed=3)))
    assert variance is not None
    assert 0.85 < np.median(np.abs(wrong) / np.sqrt(variance)) / np.sqrt(np.log(2)) < 1.15
    assert np.mean(np.abs(wrong) ** 2 / variance) < 1.45


def test_no_noise_leaves_rounding_only_where_a_polynomial_is_exact():
    rng = np.random.default_rng(0)
    force = rng.standard_normal(N)
    frf = local_frf(Recording(CHANNELS, np.vstack([force, 2.5 * force]), RATE))
    np.testing.assert_allclose(frf.value, 2.5, rtol=1e-9)


def test_estimates_share_no_line_unless_asked():
    recording = record("noise")
    assert np.diff(local_frf(recording).frequency).min() == pytest.approx(17 * RATE / N)
    assert np.diff(local_frf(recording, step=1).frequency).min() == pytest.approx(RATE / N)


def test_bad_input_is_named():
    recording = record("noise")
    two = Recording((CHANNELS[0], Channel("g", "force", "reference")), recording.data, RATE, label="two.h5")
    with pytest.raises(ChannelError, match=r"two\.h5: local FRFs need one input, not 2"):
        local_frf(two)
    with pytest.raises(EstimationError, match="half is 3"):
        local_frf(recording, half=3)
    with pytest.raises(EstimationError, match="too few"):
        local_frf(Recording(CHANNELS, recording.data[:, :20], RATE))


def test_several_records_are_averaged_and_must_be_alike():
    one, other = record("noise", noise=0.1, seed=5), record("noise", noise=0.1, seed=6)
    both, alone = local_frf([one, other]), local_frf(one)
    ratio = np.asarray(both.variance) / np.asarray(alone.variance)
    assert np.median(ratio) == pytest.approx(0.5, abs=0.1)
    assert both.n_averages == 2 * alone.n_averages
    with pytest.raises(EstimationError, match=r"short\.h5: has 30000 samples at 1000 Hz, expected 40000"):
        local_frf([one, Recording(CHANNELS, other.data[:, :30000], RATE, label="short.h5")])


def test_coherence_falls_where_noise_is():
    frf = local_frf(record("noise", noise=0.3))
    near = np.abs(frf.frequency - 50.0) < 1.0
    assert frf.coherence is not None
    assert frf.coherence[0, near].min() > 0.9
    assert np.median(frf.coherence) < 0.7


def test_a_sweep_from_rest_is_seen_from_its_first_lines_on():
    """What drives the first mode lies at the very beginning, where its phase turns no more than what the ends leave."""
    omega, total = 2 * np.pi * 9.0, 4 * N
    t = np.arange(N) / RATE
    force = np.zeros(total)
    force[:N] = np.sin(2 * np.pi * (6 * t + 394 * t**2 / 2 / t[-1]))
    force[:64] *= np.linspace(0, 1, 64)
    s = 2j * np.pi * np.fft.rfftfreq(total, 1 / RATE)
    answer = np.fft.irfft(np.fft.rfft(force) * s**2 / (s**2 + 0.02 * omega * s + omega**2))[:N]
    answer = answer + 1e-3 * answer.std() * np.random.default_rng(5).standard_normal(N)
    recording = Recording(CHANNELS, np.vstack([force[:N], answer]), RATE)
    frf, plain = local_frf(recording), local_frf(recording, lead=0)
    assert frf.settings["lead"] == N // 3

    def wrong(one):
        at = (one.frequency > 6.5) & (one.frequency < 14)
        s = 2j * np.pi * one.frequency[at]
        exact = s**2 / (s**2 + 0.02 * omega * s + omega**2)
        return np.median(np.abs(one.value[0, 0, at] - exact) / np.abs(exact))

    assert wrong(frf) < 0.02
    assert wrong(frf) < 0.2 * wrong(plain)
