"""Sweeps that begin at rest are told from those cut out of a longer record, and from all else."""

import numpy as np
import pytest

from labnnum.recording import Channel, Recording
from labnnum.rest import begins_at_rest, goes_up, lead_of

RATE, N = 400.0, 16000
CHANNELS = (Channel("f", "force", "reference"), Channel("a", "acceleration", "response"))


def sweep(low, high, start=0, noise=0.0, ramp=32, n=N):
    """A sine that goes from `low` to `high` Hz and the answer of one resonance at 20 Hz, from sample `start` on."""
    t = np.arange(n) / RATE
    u = np.sin(2 * np.pi * (low * t + (high - low) * t**2 / 2 / t[-1]))
    u[:ramp] *= np.linspace(0, 1, ramp)
    s = 0.5 + 2j * np.pi * np.fft.rfftfreq(4 * n, 1 / RATE)
    fade = np.exp(-0.5 * np.arange(4 * n) / RATE)
    w = 2 * np.pi * 20
    spectrum = np.fft.rfft(np.append(u, np.zeros(3 * n)) * fade) * s**2 / (s**2 + 0.02 * w * s + w**2)
    y = np.fft.irfft(spectrum)[:n] / fade[:n]
    rng = np.random.default_rng(4)
    x = np.vstack([u, y])[:, start:]
    x = x + noise * x.std(axis=1, keepdims=True) * rng.standard_normal(x.shape)
    return Recording(CHANNELS, x, RATE, label="sweep")


@pytest.mark.parametrize("noise", [0.0, 0.01])
@pytest.mark.parametrize("low", [2.0, 5.0, 15.0])
def test_a_sweep_that_begins_softly_and_goes_up_has_a_lead(low, noise):
    assert lead_of([sweep(low, 150.0, noise=noise)]) == N // 3


@pytest.mark.parametrize("start", [400, 1111, 2500, 5003])
def test_one_cut_out_of_a_longer_record_has_none(start):
    recording = sweep(5.0, 150.0, start)
    assert not begins_at_rest(recording.data, 0)
    assert lead_of([recording]) == 0


def test_one_that_goes_down_has_none():
    assert lead_of([sweep(150.0, 5.0)]) == 0


def test_one_that_begins_in_the_middle_of_a_sine_has_none():
    assert lead_of([sweep(5.0, 150.0, ramp=1)]) == 0


def test_noise_goes_nowhere():
    rng = np.random.default_rng(2)
    assert not any(goes_up(rng.standard_normal(8000)) for _ in range(20))


def test_records_that_would_not_share_their_lines_have_none():
    up, cut = sweep(5.0, 150.0), sweep(5.0, 150.0, 3000, n=N + 3000)
    assert cut.n_samples == N
    assert lead_of([up, up]) == N // 3
    assert lead_of([up, cut]) == 0
    assert lead_of([up, sweep(5.0, 150.0, n=12000)]) == 0
