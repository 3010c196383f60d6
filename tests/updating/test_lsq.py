import numpy as np
import pytest
from scipy.optimize import least_squares as oracle

from labnnum.updating.lsq import least_squares

T = np.linspace(0, 3, 40)
DATA = 2.0 * np.exp(-1.3 * T) + 0.5 + 0.01 * np.cos(9 * T)


def decay(x):
    e = np.exp(-x[1] * T)
    return x[0] * e + x[2] - DATA, np.column_stack([e, -x[0] * T * e, np.ones_like(T)])


@pytest.mark.parametrize("top", [9.0, 1.1])
def test_the_minimum_is_scipys_free_and_at_a_bound(top):
    low, high = np.zeros(3), np.array([9.0, top, 9.0])
    found = least_squares(decay, np.array([1.0, 0.3, 0.1]), low, high)
    best = oracle(lambda x: decay(x)[0], [1.0, 0.3, 0.1], jac=lambda x: decay(x)[1], bounds=(low, high), xtol=1e-15)
    assert found.converged
    assert np.allclose(found.x, best.x, atol=1e-6)
    assert found.cost == pytest.approx(best.cost, rel=1e-9)


def test_it_says_when_it_gave_up():
    found = least_squares(decay, np.array([9.0, 8.0, 0.0]), np.zeros(3), np.full(3, 9.0), max_steps=2)
    assert not found.converged


def test_a_direction_without_slope_stays():
    found = least_squares(
        lambda x: (np.array([x[0] - 1]), np.array([[1.0, 0.0]])), np.array([0.0, 0.3]), -np.ones(2), np.ones(2)
    )
    assert found.x.tolist() == [1.0, 0.3]
