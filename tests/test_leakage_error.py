"""The random error that leakage makes: predicted by the model, found in simulated measurements."""

import numpy as np
import pytest

from labnnum.errors import EstimationError
from labnnum.estimators import H1, Welch
from labnnum.leakage import seen_through
from labnnum.leakage_error import leakage_error, noise_share
from labnnum.recording import Channel, Recording

RATE, N, SAMPLES, RUNS = 256.0, 512, 512 * 24, 400
FORCE = Channel("f", "force", "reference", "1", "x")
OUTPUTS = (Channel("a", "displacement", "response", "1", "x"), Channel("b", "displacement", "response", "2", "x"))
POLES = 2j * np.pi * np.array([30.2, 41.7]) * np.sqrt(1 - 0.006**2) - 0.006 * 2 * np.pi * np.array([30.2, 41.7])
SHAPES = np.array([[1.0, 0.6], [-0.5, 0.8]]) * -1j


def model(frequency):
    s = 2j * np.pi * np.asarray(frequency)
    direct = SHAPES @ (1 / (s - POLES[:, None]))
    return direct + SHAPES.conj() @ (1 / (s - POLES.conj()[:, None]))


def measured(window: str, overlap: float, noise: float, runs: int = RUNS):
    """H1 on lines around both resonances, from periodic random signals much longer than a segment."""
    lines = np.fft.rfftfreq(SAMPLES, 1 / RATE)
    response, frfs = model(lines), []
    for run in range(runs):
        rng = np.random.default_rng(run)
        force = rng.standard_normal(SAMPLES)
        motion = np.fft.irfft(response * np.fft.rfft(force), SAMPLES)
        motion += noise * motion.std(axis=1, keepdims=True) * rng.standard_normal(motion.shape)
        recording = Recording((FORCE, *OUTPUTS), np.vstack([force, motion]), RATE)
        frf = H1(Welch(N, window=window, overlap=overlap))(recording)
        frfs.append(frf.lines(25.0, 47.0))
    return frfs


def predicted(frf, window, overlap, **how):
    return leakage_error(
        model, frf.frequency, window=window, n_segment=N, rate=RATE, overlap=overlap, n_averages=frf.n_averages, **how
    )


@pytest.mark.parametrize(("window", "overlap"), [("hann", 0.5), ("hann", 0.0), ("boxcar", 0.0)])
def test_covariance_between_lines_and_responses(window, overlap):
    frfs = measured(window, overlap, 0.0)
    first = frfs[0]
    expected = seen_through(model, first.settings, first.frequency)
    error = np.array([f.value[:, 0] for f in frfs]) - expected
    theory = predicted(first, window, overlap, lags=2)
    for lag in range(3):
        shape = error.shape[-1] - lag
        a, b = error[..., :shape], error[..., lag:]
        proper = np.einsum("rof,rpf->opf", a, b.conj()) / len(frfs)
        pseudo = np.einsum("rof,rpf->opf", a, b) / len(frfs)
        size = np.sqrt(np.einsum("oof->of", theory.covariance[0]).real)
        scale = size[:, None, :shape] * size[None, :, lag:]
        limit = 6 / np.sqrt(len(frfs))
        assert np.abs((proper - theory.covariance[lag][..., :shape]) / scale).max() < limit
        assert np.abs((pseudo - theory.pseudo[lag][..., :shape]) / scale).max() < limit
        assert abs(np.mean((proper - theory.covariance[lag][..., :shape]) / scale)) < 0.03


def test_overlapping_segments_leak_less_than_their_coherence_says():
    frfs = measured("hann", 0.5, 0.0, 60)
    theory = predicted(frfs[0], "hann", 0.5)
    from_coherence = np.mean([f.variance[:, 0] for f in frfs], axis=0)
    naive = theory.power / (frfs[0].n_averages - 1)
    assert np.median(naive / from_coherence) == pytest.approx(1.0, abs=0.06)
    real = np.einsum("oof->of", theory.covariance[0]).real
    assert 0.7 < np.median(real / from_coherence) < 0.9


def test_noise_is_told_from_leakage():
    noise = 0.05
    frfs = measured("hann", 0.5, noise, 40)
    position = np.round(frfs[0].frequency * N / RATE).astype(int)
    power = np.array([np.mean(np.abs(model(np.fft.rfftfreq(SAMPLES, 1 / RATE)))[i] ** 2) for i in range(2)])
    expected = noise**2 * power / (frfs[0].n_averages - 1)
    found, shares = [], []
    for frf in frfs:
        level, share = noise_share(frf.variance[:, 0], predicted(frf, "hann", 0.5), frf.n_averages, position)
        found.append(np.median(level, axis=-1))
        shares.append(share[:, 0])
    assert np.mean(found, axis=0) == pytest.approx(expected, rel=0.1)
    assert np.mean(shares) > 0.9


def test_no_leakage_is_found_where_there_is_none():
    frf = measured("hann", 0.5, 0.0, 1)[0]
    theory = predicted(frf, "hann", 0.5)
    position = np.arange(frf.frequency.size)
    even = np.full((2, frf.frequency.size), 0.02 * theory.power.min() / frf.n_averages)
    noise, share = noise_share(even, theory, frf.n_averages, position)
    assert share.max() < 0.1
    total = noise + share * theory.power / frf.n_averages
    assert np.median(total / even) == pytest.approx(1.0, abs=0.3)


def test_an_imported_frf_without_averages_is_refused():
    frf = measured("hann", 0.5, 0.0, 1)[0]
    with pytest.raises(EstimationError, match="effective averages"):
        leakage_error(model, frf.frequency, window="hann", n_segment=N, rate=RATE, overlap=0.5, n_averages=float("nan"))
