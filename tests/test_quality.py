"""Verdicts on FRFs and recordings: each names the channel, the cause and the remedy."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import butter, lfilter, sosfilt

from labnnum.bands import Band
from labnnum.errors import BandError, QualityError
from labnnum.estimators import H1, Welch
from labnnum.quality import coherence_verdicts, leakage_verdicts, recording_verdicts, resonances
from labnnum.recording import Channel, Recording

RATE, N = 512.0, 1024
CHANNELS = (Channel("f", "force", "reference"), Channel("x", "displacement"), Channel("y", "displacement"))


def mode(f0: float, damping: float, signal: np.ndarray) -> np.ndarray:
    pole = 2 * np.pi * f0 * complex(-damping, np.sqrt(1 - damping**2)) / RATE
    a = np.real(np.poly(np.exp([pole, np.conj(pole)])))
    return lfilter([0.0, np.sin(pole.imag) * np.exp(pole.real)], a, signal)


def measure(damping=0.05, noise=(0.0, 0.0), force=None, extra=None, seed=0, n=N * 60):
    rng = np.random.default_rng(seed)
    f = rng.standard_normal(n) if force is None else force
    x, y = mode(60.0, damping, f), mode(90.0, damping, f)
    if extra is not None:
        x, y = x + mode(60.0, damping, extra), y + mode(90.0, damping, extra)
    x = x + noise[0] * x.std() * rng.standard_normal(n)
    y = y + noise[1] * y.std() * rng.standard_normal(n)
    return Recording(CHANNELS, np.stack([f, x, y]), RATE)


BAND = Band(50.0, 100.0)


def bad(frf, threshold=0.9, bands=(BAND,)):
    return {v.channel: v for v in coherence_verdicts(frf, threshold, bands) if not v.ok}


def test_a_clean_measurement_passes_and_says_by_how_much():
    verdicts = coherence_verdicts(H1(Welch(N))(measure()), 0.9, [BAND])
    assert [v.ok for v in verdicts] == [True, True]
    assert [v.channel for v in verdicts] == ["x", "y"]
    assert all(v.value > 0.95 and v.limit == 0.9 and "50 to 100 Hz" in v.reason for v in verdicts)
    assert all(verdicts)


def test_noise_of_one_channel_is_called_that():
    found = bad(H1(Welch(N))(measure(noise=(0.0, 3.0))))
    assert list(found) == ["y"]
    assert "noise of this channel" in found["y"].reason


def test_what_all_responses_share_is_called_that():
    rng = np.random.default_rng(5)
    found = bad(H1(Welch(N))(measure(extra=rng.standard_normal(N * 60))))
    assert sorted(found) == ["x", "y"]
    assert all("every response shares it" in v.reason for v in found.values())


def test_a_band_without_excitation_is_called_that():
    rng = np.random.default_rng(6)
    force = sosfilt(butter(8, 30.0, fs=RATE, output="sos"), rng.standard_normal(N * 60))
    found = bad(H1(Welch(N))(measure(force=force, noise=(0.01, 0.01))))
    assert "low excitation: 'f' lies" in found["x"].reason
    assert "dB" in found["x"].reason


def test_leakage_is_called_that_with_the_segment_that_cures_it():
    frf = H1(Welch(N))(measure(damping=0.002))
    found = bad(frf, 0.97, [Band(55.0, 65.0)])
    assert "leakage at a resonance" in found["x"].reason
    needed = resonances(frf, 0)[0].needed
    assert f"raise n_segment from {N} to {needed} or more" in found["x"].reason
    cured = H1(Welch(needed))(measure(damping=0.002, n=needed * 20))
    assert not [v for v in leakage_verdicts(cured) if not v.ok]
    shorter = H1(Welch(needed // 4))(measure(damping=0.002, n=needed * 10))
    assert [v for v in leakage_verdicts(shorter) if not v.ok]


@pytest.mark.parametrize("window", ["hann", "boxcar"])
@pytest.mark.parametrize(("damping", "within"), [(0.002, 0.45), (0.005, 0.2), (0.02, 0.15)])
def test_the_true_bandwidth_is_seen_behind_the_window(window, damping, within):
    frf = H1(Welch(N, window))(measure(damping, n=N * 300))
    found = min(resonances(frf, 0), key=lambda r: abs(r.frequency - 60))
    lines = 2 * damping * 60 * N / RATE
    assert found.bandwidth == pytest.approx(lines, rel=within)


def test_leakage_is_not_asked_where_nothing_leaks():
    frf = H1(Welch(N))(measure(damping=0.002))
    for settings in ({}, frf.settings | {"periodic": True}, frf.settings | {"transient": True}):
        assert leakage_verdicts(replace(frf, settings=settings)) == []
    assert leakage_verdicts(frf, [Band(200.0, 250.0)]) == []


def test_coherence_that_says_nothing_is_refused():
    frf = H1(Welch(N))(measure())
    for changed, why in (
        (replace(frf, n_averages=1.0), "single average"),
        (replace(frf, coherence=None), "carries no coherence"),
        (replace(frf, coherence=np.full_like(frf.coherence, np.nan)), "not finite"),
    ):
        with pytest.raises(QualityError, match=why):
            changed.require_coherence(0.0)
    imported = replace(frf, n_averages=float("nan"), estimator="imported")
    assert imported.require_coherence(0.5) is imported


def test_a_band_outside_the_lines_is_refused():
    with pytest.raises(BandError, match="holds no line"):
        coherence_verdicts(H1(Welch(N))(measure()), 0.9, [Band(300.0, 400.0)])


def test_the_error_names_channel_band_and_cause():
    with pytest.raises(QualityError, match=r"coherence of 'y' from 50 to 100 Hz is 0\.\d+ < 0\.9: .*noise of this"):
        H1(Welch(N))(measure(noise=(0.0, 3.0))).require_coherence(0.9, [BAND])


def test_dead_and_overloaded_channels_of_a_recording_are_named():
    data = np.random.default_rng(1).standard_normal((3, 2000))
    data[1] = 2.0
    data[2] = np.clip(data[2], -1.5, 1.5)
    verdicts = {(v.name, v.channel): v for v in recording_verdicts(Recording(CHANNELS, data, RATE))}
    assert not verdicts["signal", "x"].ok
    assert not verdicts["overload", "y"].ok
    assert verdicts["overload", "f"].ok
    assert ("overload", "x") not in verdicts


def test_reported_overloads_count_unless_excluded():
    data = np.random.default_rng(1).standard_normal((3, 2000))
    for excluded, ok in (((), False), (((90, 200),), True)):
        recording = Recording(CHANNELS, data, RATE, excluded=excluded, overloads=((1, 100, 120),))
        found = next(v for v in recording_verdicts(recording) if (v.name, v.channel) == ("overload", "x"))
        assert found.ok is ok
    known = recording_verdicts(Recording(CHANNELS, data, RATE), {"f": 2.0})
    assert not next(v for v in known if (v.name, v.channel) == ("overload", "f")).ok
    empty = recording_verdicts(Recording(CHANNELS, data, RATE, excluded=((0, 2000),)))
    assert not any(empty)
