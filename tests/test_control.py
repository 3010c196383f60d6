import numpy as np
import pytest
from scipy.integrate import solve_ivp

from labnnum.control import (
    StateSpace,
    cost_to_go,
    decay,
    free_response,
    kalman,
    lqr,
    mean_cost,
    modulus_margin,
    observer_feedback,
    settling_time,
    state_feedback,
    state_space,
)
from labnnum.errors import ModelError
from labnnum.structures.chain import Chain, Link
from labnnum.structures.examples import truck
from labnnum.structures.quantities import structural

TRUCK = truck()
ACTUATOR, WHEEL, SEAT = np.array([0.0, -1.0, 1.0]), np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])


@pytest.fixture(scope="module")
def plant():
    return state_space(TRUCK, TRUCK.nominal, ACTUATOR, WHEEL, SEAT)


@pytest.fixture(scope="module")
def weights():
    return np.eye(6) * 1e6, np.array([[1e-4]])


def test_the_static_response_is_that_of_the_structure(plant):
    x = -np.linalg.solve(plant.A, plant.G)[:3, 0]
    assert np.allclose(x, np.linalg.solve(TRUCK.matrices(TRUCK.nominal).K, WHEEL))


def test_poles_are_those_of_the_structure(plant):
    omega = np.sort(np.abs(np.linalg.eigvals(plant.A)))[::2]
    assert np.allclose(omega, [12.9, 20.8, 32.8], rtol=0.01)
    assert decay(plant.A) > 0


def test_no_gain_costs_less_than_the_optimal_one(plant, weights):
    q, r = weights
    k = lqr(plant, q, r)
    start = plant.G[:, 0]
    costs = [cost_to_go(state_feedback(plant, g), q + g.T @ r @ g, start) for g in (k, 1.05 * k, 0.95 * k, 0 * k)]
    assert costs[0] == min(costs)
    assert costs[3] > 1.01 * costs[0]


def test_the_cost_is_the_integral(plant, weights):
    q, r = weights
    k = lqr(plant, q, r)
    closed, weight, start = state_feedback(plant, k), q + k.T @ r @ k, plant.G[:, 0]
    found = solve_ivp(lambda t, x: np.append(closed @ x[:-1], x[:-1] @ weight @ x[:-1]), (0, 40), np.append(start, 0),
                      rtol=1e-9, atol=1e-14)  # fmt: skip
    assert np.isclose(found.y[-1, -1], cost_to_go(closed, weight, start), rtol=1e-5)


def test_the_observer_error_separates_where_the_model_is_true(plant, weights):
    q, r = weights
    k, gain = lqr(plant, q, r), kalman(plant, [[1.0]], [[1e-12]])
    both = np.linalg.eigvals(observer_feedback(plant, plant, k, gain))
    apart = np.concatenate([np.linalg.eigvals(plant.A - plant.B @ k), np.linalg.eigvals(plant.A - gain @ plant.C)])
    assert np.allclose(np.sort_complex(both), np.sort_complex(apart), rtol=1e-5)


def test_the_observer_gain_is_the_dual_of_the_regulator(plant):
    gain = kalman(plant, [[2.0]], [[1e-10]])
    density = 2.0 * plant.G @ plant.G.T

    def error(scale):
        g = scale * gain
        return mean_cost(plant.A - g @ plant.C, np.eye(6), density + g @ g.T * 1e-10)

    assert error(1.0) < min(error(0.9), error(1.1))


def test_free_response_and_settling_time_of_one_decaying_exponential():
    time = np.linspace(0, 10, 1001)
    response = free_response(np.array([[-1.0]]), np.array([2.0]), np.array([1.0]), time)
    assert np.allclose(response, 2 * np.exp(-time))
    assert settling_time(time, response) == pytest.approx(np.log(50), abs=0.02)
    assert np.isnan(settling_time(time, np.ones(1001)))


def test_an_unstable_loop_costs_infinitely_much():
    assert cost_to_go(np.array([[0.1]]), np.eye(1), np.ones(1)) == np.inf
    assert mean_cost(np.array([[0.1]]), np.eye(1), np.eye(1)) == np.inf


def test_the_margin_is_the_distance_of_the_loop_gain_from_minus_one():
    plain = StateSpace(np.array([[-1.0]]), np.eye(1), np.eye(1), np.eye(1))
    omega = np.geomspace(1e-3, 1e3, 4001)
    s = 1j * omega
    gain = 40.0 / ((s + 1) * (s + 1 + 8 + 5))  # K = 8, L = 5: the controller's pole is at -(1 + K + L)
    found = modulus_margin(plain, plain, np.array([[8.0]]), np.array([[5.0]]), omega)
    assert found == pytest.approx(np.abs(1 + gain).min())
    assert found < 1


def test_what_cannot_be_controlled_is_refused(plant):
    with pytest.raises(ModelError, match="no stabilising gain"):
        lqr(type(plant)(np.eye(2), np.zeros((2, 1)), np.zeros((2, 1)), np.eye(2)), np.eye(2), [[1.0]])
    massless = Chain({"1": 1.0, "2": 0.0}, (Link("1", "2", 1.0), Link("2", "ground", 1.0)))
    with pytest.raises(ModelError, match="no inverse"):
        state_space(massless, [], [1.0, 0.0], [1.0, 0.0], [1.0, 0.0])
    lossy = Chain({"1": 1.0}, (Link("1", "ground", 1.0),), damping=structural(0.1))
    with pytest.raises(ModelError, match="viscous"):
        state_space(lossy, [], [1.0], [1.0], [1.0])
