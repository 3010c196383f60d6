"""Laws that every estimate obeys, whatever the data."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labnnum.estimators import H1, H2, Hv, Welch, periodic
from labnnum.leakage import WindowView
from labnnum.recording import Channel, Recording
from labnnum.windows import WINDOWS, lag_window

RATE = 200.0
F, X, Y = Channel("f", "force", "reference"), Channel("x", "displacement"), Channel("y", "displacement")
quick = settings(max_examples=20, deadline=None)
seeds = st.integers(0, 2**31)
segments = st.integers(8, 90)
names = st.sampled_from(WINDOWS)


def recording(seed: int, n: int = 900, breaks=()) -> Recording:
    rng = np.random.default_rng(seed)
    f = rng.standard_normal(n)
    x = np.convolve(f, rng.standard_normal(5))[:n] + 0.3 * rng.standard_normal(n)
    y = np.convolve(f, rng.standard_normal(5))[:n] + 0.3 * rng.standard_normal(n)
    return Recording((F, X, Y), np.stack([f, x, y]), RATE, breaks)


@quick
@given(seeds, segments)
def test_parseval(seed, n):
    """The density integrates to the mean square of the samples that were averaged."""
    data = recording(seed)
    spectra = Welch(n, "boxcar", 0.0, "none")(data)
    used = data.data[:, : spectra.n_segments * n]
    total = np.einsum("iif->i", np.where(np.isnan(spectra.cross), 0, spectra.cross)).real * RATE / n
    np.testing.assert_allclose(total, np.mean(used**2, axis=1), rtol=1e-10)


@quick
@given(seeds, segments, names)
def test_white_noise_keeps_its_density_under_any_window(seed, n, name):
    """2 s^2 / rate, whatever the window: the scaling takes its power out."""
    noise = np.random.default_rng(seed).standard_normal((1, 40_000))
    density = Welch(n, name, 0.5, "none")(Recording((F,), noise, RATE)).auto(0)[2:-2]
    assert density.size == 0 or np.mean(density) == pytest.approx(2 / RATE, rel=0.15)


@quick
@given(seeds, segments, st.floats(0, 0.9), st.lists(st.integers(1, 400), min_size=1, max_size=12), st.integers(1, 899))
def test_streaming_gives_the_bits_of_one_pass(seed, n, overlap, sizes, cut):
    data = recording(seed, breaks=(cut,))
    welch = Welch(n, overlap=overlap)
    running = welch.start(data.channels, RATE)
    for start, stop in data.spans():
        at, k = start, 0
        while at < stop:
            size = sizes[k % len(sizes)]
            running.add(data.data[:, at : min(stop, at + size)])
            at, k = at + size, k + 1
        running.gap()
    assert np.array_equal(running.spectra().cross, welch(data).cross, equal_nan=True)


@quick
@given(seeds, segments, names, st.floats(1e-6, 1e6), st.floats(1e-6, 1e6))
def test_units_scale_the_frf_and_leave_coherence(seed, n, name, a, b):
    data = recording(seed)
    other = Recording(data.channels, data.data * np.array([[a], [b], [1.0]]), RATE)
    for estimator in (H1, H2, Hv):
        one, two = estimator(Welch(n, name))(data), estimator(Welch(n, name))(other)
        np.testing.assert_allclose(two.value[0] * (a / b), one.value[0], rtol=1e-6)
        np.testing.assert_allclose(two.coherence, one.coherence, rtol=1e-6, atol=1e-9)
        np.testing.assert_allclose(two.variance[0] * (a / b) ** 2, one.variance[0], rtol=1e-5)


@quick
@given(seeds, segments, names)
def test_h1_hv_h2_stand_in_order_and_coherence_is_their_ratio(seed, n, name):
    data = recording(seed)
    one, mean, two = (np.abs(e(Welch(n, name))(data).value[:, 0]) for e in (H1, Hv, H2))
    gamma = H1(Welch(n, name))(data).coherence
    assert ((gamma >= 0) & (gamma <= 1)).all()
    assert (one <= mean * (1 + 1e-9)).all()
    assert (mean <= two * (1 + 1e-9)).all()
    np.testing.assert_allclose(one, gamma * two, rtol=1e-9)


@quick
@given(seeds, segments)
def test_order_of_channels_and_of_recordings_does_not_matter(seed, n):
    a, b = recording(seed), recording(seed + 1)
    swapped = [r.select(["y", "f", "x"]) for r in (b, a)]
    one, two = H1(Welch(n))([a, b]), H1(Welch(n))(swapped)
    np.testing.assert_allclose(one.value[0], two.value[1], rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(one.coherence[1], two.coherence[0], rtol=1e-9, atol=1e-12)


@quick
@given(seeds, st.integers(16, 60), st.integers(0, 15))
def test_a_delay_turns_the_phase_and_nothing_else(seed, n, delay):
    rng = np.random.default_rng(seed)
    one = rng.standard_normal(n)
    f = np.tile(one, 5)
    data = Recording((F, X), np.stack([f, np.tile(np.roll(one, delay), 5)]), RATE, period=n)
    frf = periodic(data, lines=np.arange(1, n // 2))
    np.testing.assert_allclose(frf.value[0, 0], np.exp(-1j * frf.omega * delay / RATE), atol=1e-6)
    circular = H1(Welch(n, "boxcar", 0.0, "none"))(data).at(slice(1, n // 2))
    np.testing.assert_allclose(circular.value[0, 0], frf.value[0, 0], atol=1e-6)


@quick
@given(names, st.integers(16, 120), st.complex_numbers(max_magnitude=1e3, allow_nan=False))
def test_a_flat_frf_looks_flat_through_any_window(name, n, level):
    view = WindowView(name, n, RATE, refine=4)
    seen = view.apply(np.full(view.frequency.size, level.real))
    np.testing.assert_allclose(seen, level.real, atol=1e-9 * (1 + abs(level)))


@quick
@given(names, st.integers(2, 200))
def test_a_lag_window_starts_at_one_and_never_exceeds_it(name, n):
    lags = lag_window(name, n)
    assert lags[0] == pytest.approx(1.0)
    assert (np.abs(lags) <= 1 + 1e-12).all()
