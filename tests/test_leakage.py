"""The model seen through a window: exact through the lag window, and what simulated measurements scatter about."""

import numpy as np
import pytest
from scipy.signal import freqz, lfilter

from labnnum.errors import EstimationError
from labnnum.estimators import H1, Hits, Welch
from labnnum.leakage import WindowView, lag_transform, modal_frf, refine_for, seen_through, view_of
from labnnum.recording import Channel, Recording
from labnnum.windows import WINDOWS

RATE, N, F0 = 512.0, 512, 60.0
CHANNELS = (Channel("f", "force", "reference"), Channel("x", "displacement"))


def oscillator(damping: float):
    pole = 2 * np.pi * F0 * complex(-damping, np.sqrt(1 - damping**2)) / RATE
    a = np.real(np.poly(np.exp([pole, np.conj(pole)])))
    b = [0.0, np.exp(pole.real) * np.sin(pole.imag)]

    def model(f):
        return freqz(b, a, 2 * np.pi * np.asarray(f) / RATE)[1]

    return b, a, model


@pytest.mark.parametrize("name", WINDOWS)
def test_white_input_is_exact_through_the_lag_window(name):
    b, a, model = oscillator(0.01)
    impulse = lfilter(b, a, np.r_[1.0, np.zeros(8191)])
    view = WindowView(name, N, RATE, refine=8)
    exact = lag_transform(impulse, name, N)
    # banded windows leave out a millionth of their power
    assert np.abs(view.apply(model(view.frequency)) - exact).max() < 3e-6 * np.abs(exact).max()


def test_lines_are_a_choice_of_all_lines():
    _, _, model = oscillator(0.01)
    wanted = np.array([50.0, 60.0, 61.0])
    some, all_ = WindowView("hann", N, RATE, lines=wanted), WindowView("hann", N, RATE)
    assert some.frequency.size < all_.frequency.size
    np.testing.assert_allclose(
        some.apply(model(some.frequency)), all_.apply(model(all_.frequency))[[50, 60, 61]], rtol=1e-12
    )


def test_a_banded_boxcar_comes_close_to_the_whole():
    _, _, model = oscillator(0.01)
    whole, banded = WindowView("boxcar", N, RATE), WindowView("boxcar", N, RATE, reach=60)
    gap = whole.apply(model(whole.frequency)) - banded.apply(model(banded.frequency))
    assert np.abs(gap).max() < 2e-3 * np.abs(model([F0])).max()


def test_the_view_is_linear_so_derivatives_pass_through():
    _, _, model = oscillator(0.02)
    view = WindowView("hann", N, RATE, lines=np.arange(1.0, 100.0))
    h = model(view.frequency)
    stack = np.stack([h, 2j * h, h + 1])
    seen = view.apply(stack)
    np.testing.assert_allclose(seen[2], seen[0] + 1, rtol=1e-10)
    step = 1e-6

    def curve(f0):
        pole = 2 * np.pi * f0 * complex(-0.02, 1)
        return seen_through(([pole], [1.0]), settings, view.lines, refine=8)

    settings = {"window": "hann", "n_segment": N, "rate": RATE}
    numeric = (curve(F0 + step) - curve(F0 - step)) / (2 * step)

    def modal(f0):
        return modal_frf(np.array([2 * np.pi * f0 * complex(-0.02, 1)]), np.array([1.0]))

    fine = view.frequency
    derivative = view.apply((modal(F0 + step)(fine) - modal(F0 - step)(fine)) / (2 * step))
    np.testing.assert_allclose(derivative, numeric, rtol=1e-6, atol=1e-9 * np.abs(numeric).max())


@pytest.mark.parametrize(("window", "overlap"), [("hann", 0.5), ("boxcar", 0.0), ("blackmanharris", 0.75)])
def test_the_bias_of_h1_is_explained_within_its_random_error(window, overlap):
    b, a, model = oscillator(0.005)
    rng = np.random.default_rng(1)
    f = rng.standard_normal(N * 500 + 4000)
    recording = Recording(CHANNELS, np.stack([f, lfilter(b, a, f)])[:, 4000:], RATE)
    frf = H1(Welch(N, window, overlap, "none"))(recording).lines(50, 70)
    view = WindowView.on_lines(frf.settings, frf.frequency)
    plain = frf.value[0, 0] - model(frf.frequency)
    explained = frf.value[0, 0] - view.apply(model(view.frequency))
    peak = np.abs(model([F0]))[0]
    assert np.abs(plain).max() > 0.4 * peak
    assert np.abs(explained).max() < 0.04 * peak
    spread = np.sqrt(np.mean(np.abs(explained) ** 2 / frf.variance[0, 0]))
    assert 0.4 < spread < 1.6


def test_coloured_input_weighs_the_window():
    b, a, model = oscillator(0.005)
    shape = np.array([1.0, -1.6, 0.9])

    def density(f):
        return 1 / np.abs(freqz(shape, [1.0], 2 * np.pi * np.asarray(f) / RATE)[1]) ** 2

    rng = np.random.default_rng(2)
    f = lfilter([1.0], shape, rng.standard_normal(N * 800 + 4000))
    recording = Recording(CHANNELS, np.stack([f, lfilter(b, a, f)])[:, 4000:], RATE)
    for window in ("hann", "boxcar"):
        frf = H1(Welch(N, window, 0.0, "none"))(recording).lines(40, 80)
        white = WindowView.on_lines(frf.settings, frf.frequency)
        colour = WindowView.on_lines(frf.settings, frf.frequency, input_psd=density)
        left = [np.abs(frf.value[0, 0] - v.apply(model(v.frequency))).max() for v in (white, colour)]
        assert left[1] < 0.06 * np.abs(model([F0]))[0]
        assert left[1] < left[0]


def test_hits_are_cut_and_decayed_not_tapered():
    b, a, model = oscillator(0.003)
    t = np.arange(N)
    force = np.exp(-0.5 * ((t - 30) / 1.5) ** 2)
    recording = Recording(CHANNELS, np.stack([force, lfilter(b, a, force)]), RATE)
    for decay in (0.0, 2.0):
        frf = H1(Hits(decay=decay))(recording).lines(40, 80)
        view = WindowView.on_lines(frf.settings, frf.frequency, refine=16)
        seen = view.apply(model(view.frequency))
        peak = np.abs(frf.value).max()
        assert np.abs(frf.value[0, 0] - model(frf.frequency)).max() > 0.15 * peak
        assert np.abs(frf.value[0, 0] - seen).max() < 0.01 * peak


def test_a_long_segment_sees_the_model_itself():
    _, _, model = oscillator(0.05)
    view = WindowView("hann", 8192, RATE, refine=4, lines=np.arange(40, 80) * 1.0)
    np.testing.assert_allclose(view.apply(model(view.frequency)), model(view.lines), rtol=2e-3)


def test_refinement_follows_the_slowest_pole():
    settings = {"window": "hann", "n_segment": N, "rate": RATE}
    assert refine_for([complex(-0.5, 300)], settings) == 20
    assert refine_for([complex(-100, 300)], settings) == 4
    assert refine_for([complex(0, 300)], settings) == 64


def test_settings_that_do_not_smear_give_the_model():
    assert view_of({}) is None
    assert view_of({"window": "boxcar", "n_segment": 8, "rate": 1.0, "periodic": True}) is None
    np.testing.assert_array_equal(seen_through(lambda f: f + 0j, {}, [1.0, 2.0]), [1, 2])
    with pytest.raises(EstimationError, match="lines must be given"):
        seen_through(lambda f: f, {})


@pytest.mark.parametrize(
    "call",
    [
        lambda: WindowView("hann", N, RATE, refine=1),
        lambda: WindowView("hann", N, RATE, lines=[1.5]),
        lambda: WindowView("hann", N, RATE, lines=[RATE]),
        lambda: WindowView("hann", N, RATE, lines=[]),
        lambda: WindowView("hann", N, RATE, decay=1.0),
        lambda: WindowView("hann", N, RATE, reach=0),
        lambda: WindowView("hann", N, RATE, transient=True, pretrigger=N),
        lambda: WindowView("hann", N, RATE, input_psd=lambda f: -f),
        lambda: WindowView("hann", N, RATE).apply(np.ones(3)),
        lambda: WindowView("hann", N, RATE).apply(np.full(N // 2 * 8 + 1, np.inf)),
    ],
)
def test_impossible_views_are_refused(call):
    with pytest.raises(EstimationError):
        call()
