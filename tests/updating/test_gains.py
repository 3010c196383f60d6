"""The second stage: polynomials, their slopes, and less noise than the first."""

import numpy as np
import pytest

from labnnum.updating.compiled import compiled
from labnnum.updating.fitting import fit_tuned
from labnnum.updating.gains import affordable_powers, n_polynomials, polynomials, powers_of, slopes
from labnnum.updating.network import RbfNetwork

NOISE = 0.01
TURN = np.linalg.qr(np.random.default_rng(8).standard_normal((8, 8)))[0]


def measurements(n: int, seed: int, noise: float = NOISE):
    """Two parameters in eight features; where each shows most depends on the other."""
    rng = np.random.default_rng(seed)
    theta = rng.uniform(-1, 1, (n, 2))
    a, b = theta.T
    seen = np.column_stack(
        [a, b, a * np.cos(3 * b), a * np.sin(3 * b), b * np.cos(3 * a), b * np.sin(3 * a), a * b, b**2]
    )
    return (seen + noise * rng.standard_normal(seen.shape)) @ TURN, theta


@pytest.fixture(scope="module")
def network():
    return fit_tuned(*measurements(6000, 0), centres=100)


def test_polynomials_are_chebyshev_and_products():
    p = np.random.default_rng(0).uniform(-1, 1, (5, 3))
    t = polynomials(p.T, 4).T
    assert t.shape == (5, n_polynomials(3, 4))
    angle = np.arccos(p)
    expected = np.hstack([np.ones((5, 1)), *(np.cos(k * angle) for k in range(1, 5))])
    products = np.column_stack([p[:, 0] * p[:, 1], p[:, 0] * p[:, 2], p[:, 1] * p[:, 2]])
    assert np.allclose(t, np.hstack([expected, products]), atol=1e-12)
    step = 1e-6
    up, down = (polynomials((p[0] + sign * step * np.eye(3)).T, 4).T for sign in (1, -1))
    numeric = (up - down) / (2 * step)
    assert np.allclose(slopes(p[0], 4), numeric.T, atol=1e-7)


def test_a_second_stage_needs_many_samples():
    assert affordable_powers(30_000, 30, 5) == 6
    assert affordable_powers(30_000, 35, 7) == 2
    assert affordable_powers(1000, 30, 5) == 0
    x, theta = measurements(300, 1)
    assert fit_tuned(x, theta, centres=100).gains.size == 0


def test_it_comes_closer_to_the_bound_than_the_first_stage(network):
    x, theta = measurements(3000, 2)
    assert powers_of(network.gains, 2) == 6
    first = RbfNetwork(**(network.arrays() | {"gains": np.empty((0, 0, 0)), "reach": np.empty(0)}))
    a, b = theta.T
    one, none = np.ones_like(a), np.zeros_like(a)
    by_a = [one, none, np.cos(3 * b), np.sin(3 * b), -3 * b * np.sin(3 * a), 3 * b * np.cos(3 * a), b, none]
    by_b = [none, one, -3 * a * np.sin(3 * b), 3 * a * np.cos(3 * b), np.cos(3 * a), np.sin(3 * a), a, 2 * b]
    slope = np.stack([np.column_stack(by_a), np.column_stack(by_b)], axis=-1)
    bound = NOISE * np.sqrt(np.linalg.inv(slope.transpose(0, 2, 1) @ slope)[:, [0, 1], [0, 1]])
    over = [np.sqrt((((net(x) - theta) / bound) ** 2).mean(axis=0)) for net in (first, network)]
    assert (over[1] < over[0]).all()
    assert (over[1] < 1.2).all()
    residual = np.sqrt(np.diag(network.residual))
    assert np.allclose(residual, np.sqrt(((network(x) - theta) ** 2).mean(axis=0)), rtol=0.08)


def test_its_jacobian_is_exact_and_its_arrays_recreate_it(network):
    x, _ = measurements(4, 3)
    step = 1e-6
    for at in x:
        numeric = np.array([(network(at + step * e) - network(at - step * e)) / (2 * step) for e in np.eye(8)]).T
        assert np.allclose(network.jacobian(at), numeric, rtol=1e-4, atol=1e-6)
    assert np.array_equal(RbfNetwork(**network.arrays())(x), network(x))


def test_compiled_it_answers_the_same(network):
    x, _ = measurements(20, 4)
    answer = compiled(network)
    assert np.allclose([answer(row) for row in x], network(x), rtol=1e-8, atol=1e-10)


def test_far_outside_it_stays_finite(network):
    assert np.isfinite(network(1e3 * measurements(5, 5)[0])).all()
