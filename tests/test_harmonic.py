"""Harmonic balance: the linear limit, the dissertation's Duffing oscillator, time integration, friction."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from labnnum.errors import ModelError
from labnnum.harmonic import HarmonicBalance, Oscillator
from labnnum.structures.duffing import Duffing

EPSILON = 0.1
DUFFING = Oscillator(1.0, 2 * EPSILON * 0.25, 1.0, EPSILON * 0.6, "cubic", (EPSILON * 1.5,))


@pytest.fixture(scope="module")
def curve():
    return HarmonicBalance(DUFFING, 5).curve(0.7, 1.4, step=0.05)


def test_without_a_law_it_is_the_linear_response():
    linear = Oscillator(2.0, 0.3, 50.0, 4.0, "cubic", (0.0,))
    for omega in (2.0, 5.0, 9.0):
        x = HarmonicBalance(linear, 3).solve(omega)
        z = 50.0 - 2.0 * omega**2 + 0.3j * omega
        assert np.hypot(x[1], x[2]) == pytest.approx(4.0 / abs(z), rel=1e-9)


def test_a_light_duffing_follows_multiple_scales():
    """Equation 5.8 is of first order in epsilon: near resonance both agree within 2.5 percent, in both directions."""
    epsilon = 0.02
    light = Oscillator(1.0, 2 * epsilon * 0.25, 1.0, epsilon * 0.6, "cubic", (epsilon * 1.5,))
    branch = HarmonicBalance(light, 3).curve(0.97, 1.05, step=0.03)
    duffing = Duffing(epsilon=epsilon)
    omega = np.linspace(0.975, 1.045, 29)
    for direction in ("forward", "backward"):
        ours = branch.swept(omega, direction)
        theirs = np.squeeze(duffing.amplitude(duffing.nominal, (omega - 1.0) / epsilon, direction))
        away = np.abs(np.log(ours / theirs))
        assert np.median(away) < 0.015
        assert np.quantile(away, 0.9) < 0.025


@pytest.mark.parametrize("epsilon", [0.004, 0.0008])
def test_the_upper_branch_of_a_lightly_damped_oscillator_is_stable(epsilon):
    """With a damping ratio of 1e-3 and 2e-4: the sweep upwards stays above until the fold, as equation 5.8 has it."""
    light = Oscillator(1.0, 2 * epsilon * 0.25, 1.0, epsilon * 0.6, "cubic", (epsilon * 1.5,))
    branch = HarmonicBalance(light, 3).curve(1 - 1.2 * epsilon, 1 + 2.7 * epsilon, step=0.01)
    duffing, sigma = Duffing(epsilon=epsilon), np.linspace(-1.0, 2.5, 61)
    for direction in ("forward", "backward"):
        theirs = np.squeeze(duffing.amplitude(duffing.nominal, sigma, direction))
        assert branch.swept(1 + epsilon * sigma, direction) == pytest.approx(theirs, rel=1.5 * epsilon + 2e-3)


@pytest.mark.parametrize(("omega", "direction"), [(0.9, "forward"), (1.1, "backward")])
def test_it_is_where_time_integration_ends(curve, omega, direction):
    c, k3, f = DUFFING.damping, DUFFING.parameters[0], DUFFING.force

    def rate(t, y):
        return [y[1], f * np.cos(omega * t) - c * y[1] - y[0] - k3 * y[0] ** 3]

    period = 2 * np.pi / omega
    end = solve_ivp(rate, (0, 120 * period), [0.0, 0.0], rtol=1e-8, atol=1e-10)
    again = solve_ivp(rate, (0, period), end.y[:, -1], t_eval=np.linspace(0, period, 128, endpoint=False), rtol=1e-8)
    amplitude = np.abs(np.fft.fft(again.y[0])[1]) * 2 / 128
    found = curve._at(omega)
    assert min(abs(a - amplitude) for a in found) < 1e-2 * amplitude
    assert curve.swept(np.linspace(0.75, 1.35, 61), direction).max() > 0


def test_a_strong_duffing_folds_and_its_middle_branch_is_unstable():
    strong = Oscillator(1.0, 0.05, 1.0, 0.1, "cubic", (1.0,))
    branch = HarmonicBalance(strong, 5).curve(0.6, 2.2, step=0.05)
    assert (np.diff(branch.omega) < 0).any()
    back = np.flatnonzero(np.diff(branch.omega) < 0)[2:-2]
    assert not branch.stable[back].any()
    omega = np.linspace(0.8, 2.0, 121)
    up, down = branch.swept(omega, "forward"), branch.swept(omega, "backward")
    assert up.max() > 1.5 * down.max()


def test_quadratic_drag_lowers_a_peak_as_its_describing_function_says():
    free = Oscillator(1.0, 0.05, 1.0, 0.1, "quadratic-damping", (0.0,))
    dragged = Oscillator(1.0, 0.05, 1.0, 0.1, "quadratic-damping", (0.2,))
    high = HarmonicBalance(free, 3).curve(0.8, 1.2, step=0.05).amplitude.max()
    low = HarmonicBalance(dragged, 3).curve(0.8, 1.2, step=0.05).amplitude.max()
    # at resonance the force is spent on both dampers: c A + (8 / 3 pi) c2 A^2 = F, describing function
    a = (-0.05 + np.sqrt(0.05**2 + 4 * 8 / (3 * np.pi) * 0.2 * 0.1)) / (2 * 8 / (3 * np.pi) * 0.2)
    assert high == pytest.approx(2.0, rel=1e-2)
    assert low == pytest.approx(a, rel=2e-2)


def test_an_unknown_law_is_refused():
    with pytest.raises(ModelError, match="flubber"):
        Oscillator(1.0, 0.1, 1.0, 1.0, "flubber", ())
