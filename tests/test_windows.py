"""Windows: against scipy, and what they do to damping and averages."""

import numpy as np
import pytest
from scipy.signal import get_window

from labnnum.errors import EstimationError
from labnnum.windows import (
    WINDOWS,
    added_damping,
    effective_averages,
    exponential_window,
    force_window,
    lag_window,
    noise_bandwidth,
    overlap_correlation,
    window,
)


@pytest.mark.parametrize("name", WINDOWS)
@pytest.mark.parametrize("n", [2, 7, 64, 1001])
def test_periodic_windows_equal_those_of_scipy(name, n):
    wanted = ("kaiser", 9.0) if name == "kaiser" else name
    np.testing.assert_allclose(window(name, n), get_window(wanted, n, fftbins=True), rtol=0, atol=2e-12)


def test_kaiser_takes_its_shape_from_the_name():
    np.testing.assert_allclose(window("kaiser:12", 65), get_window(("kaiser", 12.0), 65, fftbins=True), atol=1e-14)


@pytest.mark.parametrize(
    ("name", "lines"),
    [("boxcar", 1.0), ("hann", 1.5), ("blackmanharris", 2.0044), ("flattop", 3.7702), ("hamming", 1.3628)],
)
def test_noise_bandwidths_are_the_published_ones(name, lines):
    assert noise_bandwidth(window(name, 4096)) == pytest.approx(lines, abs=5e-4)


@pytest.mark.parametrize("bad", ["hanning", "Hann", "", "kaiser:x", "kaiser:-1", "hann:3"])
def test_an_unknown_window_is_named_with_those_that_exist(bad):
    with pytest.raises(EstimationError, match=r"window|kaiser"):
        window(bad, 8)


@pytest.mark.parametrize("name", ["boxcar", "hann", "flattop"])
def test_lag_window_is_the_normalised_autocorrelation(name):
    w = window(name, 33)
    direct = np.correlate(w, w, "full")[32:] / (w @ w)
    np.testing.assert_allclose(lag_window(name, 33), direct, atol=1e-14)


def test_half_overlapped_hann_segments_correlate_by_a_thirty_sixth():
    # closed form for Hann at half overlap: (1/6)^2
    np.testing.assert_allclose(overlap_correlation(window("hann", 512), 256), [1, 1 / 36], atol=1e-12)


def test_effective_averages_explain_the_variance_of_a_spectrum():
    rng = np.random.default_rng(2)
    n, count = 64, 40
    w = window("hann", n)
    for hop in (16, 32, 64):
        data = rng.standard_normal((3000, n + (count - 1) * hop))
        view = np.lib.stride_tricks.sliding_window_view(data, n, axis=-1)[:, ::hop]
        power = (np.abs(np.fft.rfft(view * w, axis=-1)[..., 10]) ** 2).mean(axis=1)
        seen = power.mean() ** 2 / power.var()
        assert effective_averages(w, hop, [count]) == pytest.approx(seen, rel=0.1)


def test_runs_are_independent_of_each_other():
    w = window("hann", 64)
    assert effective_averages(w, 32, [10, 10]) == pytest.approx(2 * effective_averages(w, 32, [10]))


def test_an_exponential_window_moves_the_pole_and_nothing_else():
    rate, sigma, pole = 1000.0, 7.0, complex(-3.0, 2 * np.pi * 40)
    t = np.arange(4000) / rate
    h = np.exp(pole * t)
    windowed = h * exponential_window(t.size, rate, sigma)
    np.testing.assert_allclose(windowed, np.exp((pole - sigma) * t), rtol=1e-12)
    ratio = -pole.real / abs(pole)
    moved = -(pole - sigma).real / abs(pole)
    assert moved - ratio == pytest.approx(added_damping(sigma, abs(pole) / (2 * np.pi)))


def test_a_decay_below_zero_is_refused():
    with pytest.raises(EstimationError, match="decay"):
        exponential_window(8, 1.0, -1.0)


def test_force_window_keeps_the_pulse_and_fades_outside():
    w = force_window(20, 5, 9, taper=3)
    assert (w[5:9] == 1).all()
    assert (w[:2] == 0).all()
    assert (w[12:] == 0).all()
    assert (np.diff(w[8:13]) < 0).all()
    with pytest.raises(EstimationError, match="force window"):
        force_window(20, 9, 5)
