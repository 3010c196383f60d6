"""Duffing's oscillator against its own equation 5.8, time integration and slow sweeps."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from labnnum.errors import ConfigError, ModelError
from labnnum.structures.duffing import Duffing

NOMINAL = np.array([0.25, 1.5])


@given(mu=st.floats(0.05, 1.0), alpha=st.floats(-3.0, 3.0), sigma=st.floats(-3.0, 3.0), forward=st.booleans())
@settings(max_examples=80, deadline=None)
def test_amplitudes_solve_equation_5_8(mu, alpha, sigma, forward):
    d = Duffing()
    a = d.amplitude([mu, alpha], [sigma], "forward" if forward else "backward")[0]
    y = a**2
    power = 0.6**2 / 4
    left = (mu**2 + (sigma - 3 / 8 * alpha * y) ** 2) * y
    assert left == pytest.approx(power, rel=1e-6)


@pytest.mark.parametrize(("alpha", "high"), [(1.5, "forward"), (-1.5, "backward")])
def test_the_branches_are_the_extreme_roots(alpha, high):
    d, low = Duffing(), {"forward": "backward", "backward": "forward"}[high]
    bend, several = 3 * alpha / 8, 0
    for sigma in np.sign(alpha) * np.linspace(-0.5, 1.5, 60):
        roots = np.roots([bend**2, -2 * bend * sigma, 0.25**2 + sigma**2, -(0.6**2) / 4])
        real = np.sqrt(np.sort(roots[np.abs(roots.imag) < 1e-9].real))
        several += real.size == 3
        assert d.amplitude([0.25, alpha], [sigma], high)[0] == pytest.approx(real[-1])
        assert d.amplitude([0.25, alpha], [sigma], low)[0] == pytest.approx(real[0])
    assert several > 3


def test_components_are_those_of_equation_5_9():
    """Squared and added they give the force: |component|^2 = F^2 / 4 omega0^2 (eq. 5.7)."""
    d = Duffing()
    sigma = np.linspace(-1, 2, 30)
    z = d.components(d.nominal, sigma)
    np.testing.assert_allclose(np.abs(z), 0.3, rtol=1e-9)
    np.testing.assert_allclose(z.imag, 0.25 * d.amplitude(d.nominal, sigma))


def steady_state(d, theta, omega, start, cycles=None, tolerance=1e-9):
    """First harmonic of the response after it has settled, by Runge and Kutta's eighth order."""
    mu, alpha = theta
    e = d.epsilon
    period = 2 * np.pi / omega
    n = cycles or int(45 / (e * mu) / period)

    def equation(t, y):
        force = e * d.force * np.cos(omega * t)
        return [y[1], force - 2 * e * mu * y[1] - d.omega0**2 * y[0] - e * alpha * y[0] ** 3]

    at = (n - 1 + np.arange(64) / 64) * period
    s = solve_ivp(equation, (0, n * period), start, method="DOP853", rtol=tolerance, atol=tolerance / 100, t_eval=at)
    return 2 / 64 * (s.y[0] * np.exp(-1j * omega * at)).sum(), s.y[:, 0]


@pytest.mark.parametrize("epsilon", [0.1, 0.5])
@pytest.mark.parametrize("sweep", ["forward", "backward"])
def test_harmonic_balance_is_the_settled_motion(epsilon, sweep):
    d = Duffing(epsilon=epsilon)
    for sigma in (-0.5, 0.62):
        omega = 1 + epsilon * sigma
        c = d.harmonics(NOMINAL, [omega], sweep, 4)[0]
        k = 2 * np.arange(4) + 1
        start = [c.real.sum(), -(c.imag * k * omega).sum()]
        settled, _ = steady_state(d, NOMINAL, omega, start)
        assert abs(settled - c[0]) < 1e-7


@pytest.mark.parametrize("sweep", ["forward", "backward"])
def test_a_slow_sweep_arrives_on_the_same_branch(sweep):
    d = Duffing(epsilon=0.5)
    line = 1 + 0.5 * np.linspace(0.3, 1.1, 9)
    found = np.abs(d.harmonics(NOMINAL, line, sweep)[:, 0])
    order = range(9) if sweep == "forward" else range(8, -1, -1)
    state, swept = [0.0, 0.0], np.zeros(9)
    for i in order:
        z, state = steady_state(d, NOMINAL, line[i], state, 110, 1e-6)
        swept[i] = abs(z)
    np.testing.assert_allclose(found, swept, rtol=2e-3)


def test_sweeps_differ_between_the_folds_only():
    d = Duffing(epsilon=0.1)
    line = 1 + 0.1 * np.linspace(-1, 3, 401)
    up, down = (np.abs(d.harmonics(d.nominal, line, s)[:, 0]) for s in ("forward", "backward"))
    apart = np.flatnonzero(np.abs(up - down) > 1e-6)
    assert apart.size > 5
    assert (np.diff(apart) == 1).all()
    assert (up[apart] > down[apart]).all()


def test_more_harmonics_converge():
    d = Duffing(epsilon=0.5)
    line = 1 + 0.5 * np.linspace(-1, 0.5, 7)
    best = d.harmonics(NOMINAL, line, count=7)[:, 0]
    errors = [np.abs(d.harmonics(NOMINAL, line, count=n)[:, 0] - best).max() for n in (1, 2, 3)]
    assert errors[0] > 10 * errors[1] > 100 * errors[2]


def test_multiple_scales_tends_to_harmonic_balance_with_epsilon():
    sigma = np.linspace(-1, 0.4, 8)
    errors = []
    for e in (0.1, 0.05, 0.025):
        d = Duffing(epsilon=e)
        c = d.harmonics(NOMINAL, 1 + e * sigma)[:, 0]
        errors.append(np.abs(np.abs(c) - d.amplitude(NOMINAL, sigma)).max())
    np.testing.assert_allclose(np.array(errors[:-1]) / errors[1:], 2.0, rtol=0.1)


def test_linear_oscillator():
    d = Duffing(epsilon=0.2)
    line = np.linspace(0.7, 1.3, 9)
    exact = 1 / (1 - line**2 + 2j * 0.2 * 0.25 * line)
    np.testing.assert_allclose(d.response([0.25, 0.0], line), exact, rtol=1e-9)


@pytest.mark.parametrize("sweep", ["forward", "backward"])
def test_sensitivities_are_those_of_differences(sweep):
    d = Duffing(epsilon=0.1)
    line = 1 + 0.1 * np.linspace(-1, 3, 21)
    value, slope = d.sensitivity(NOMINAL, line, sweep)
    np.testing.assert_allclose(value, d.response(NOMINAL, line, sweep))
    for j, h in enumerate((1e-6, 1e-6)):
        step = np.eye(2)[j] * h
        difference = (d.response(NOMINAL + step, line, sweep) - d.response(NOMINAL - step, line, sweep)) / (2 * h)
        np.testing.assert_allclose(slope[j], difference, rtol=1e-5, atol=1e-6 * np.abs(slope[j]).max())


def test_many_sets_at_once_are_the_same_as_one_by_one():
    d = Duffing(epsilon=0.1)
    line = 1 + 0.1 * np.linspace(-1, 3, 31)
    sets = np.random.default_rng(0).uniform([0.175, 1.05], [0.325, 1.95], (2, 3, 2))
    found = d.response(sets, line, "forward")
    assert found.shape == (2, 3, 31)
    for i in range(2):
        for j in range(3):
            np.testing.assert_allclose(found[i, j], d.response(sets[i, j], line, "forward"), rtol=1e-9)
    assert d.sensitivity(sets, line)[1].shape == (2, 2, 3, 31)


def test_what_has_no_response():
    d = Duffing()
    with pytest.raises(ModelError, match="mu must be positive"):
        d.response([0.0, 1.0], [1.0])
    with pytest.raises(ModelError, match="two parameters"):
        d.response([0.1], [1.0])
    with pytest.raises(ModelError, match="ascending"):
        d.response(NOMINAL, [1.0, 0.9])
    with pytest.raises(ConfigError, match="sweep 'up'"):
        d.response(NOMINAL, [1.0], "up")
    with pytest.raises(ConfigError, match="epsilon = -1"):
        Duffing(epsilon=-1)
    with pytest.raises(ConfigError, match="at least one harmonic"):
        d.harmonics(NOMINAL, [1.0], count=0)
