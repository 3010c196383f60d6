"""Nonlinear elements against general-purpose integrators, closed forms and what each law must do."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from labnnum.errors import ModelError
from labnnum.nonlinear import LAWS, Element, NonlinearSimulation
from labnnum.simulation import Simulation
from labnnum.system import System

ONE, NONE = np.ones((1, 1)), np.zeros((1, 1))
M, C, K = 1.5, 4.0, 9e3


def mass(m=M, c=C, k=K) -> System:
    """Outputs: displacement, velocity, acceleration."""
    rows = np.eye(3)[:, :, None]
    return System(m * ONE, c * ONE, k * ONE, ONE, *(r.reshape(3, 1) for r in rows), np.zeros((3, 1)))


def pair() -> System:
    m, c = np.diag([2.0, 1.0]), np.array([[30.0, -10.0], [-10.0, 10.0]])
    k = np.array([[1.3e6, -5e5], [-5e5, 5e5]])
    load, row, none = np.array([[1.0], [0.0]]), np.eye(2), np.zeros((2, 2))
    return System(m, c, k, load, row, none, none, np.zeros((2, 1)))


def push(t):
    """Begins smoothly: a jump at 0 is no polynomial."""
    return (60 * np.sin(2 * np.pi * 9 * t) + 40 * np.sin(2 * np.pi * 14.3 * t + 1)) * np.tanh(t / 0.02) ** 4


SMOOTH = {
    "cubic": ((4e7,), lambda z, v: 4e7 * z**3),
    "quadratic": ((-1e5,), lambda z, v: -1e5 * z**2),
    "one-sided-gap": ((5e4, 2e-3), lambda z, v: 5e4 * np.maximum(z - 2e-3, 0)),
    "clearance": ((8e4, 3e-3), lambda z, v: 8e4 * (np.maximum(z - 3e-3, 0) + np.minimum(z + 3e-3, 0))),
    "quadratic-damping": ((60.0,), lambda z, v: 60.0 * v * abs(v)),
}


@pytest.mark.parametrize("law", sorted(SMOOTH))
def test_laws_without_memory_agree_with_a_general_integrator(law):
    parameters, force = SMOOTH[law]
    rate, n = 20000.0, 20000
    t = np.arange(n) / rate
    march = NonlinearSimulation(mass(), [Element(law, np.ones(1), parameters)], 1 / rate)
    y = march.run(push(t)[None])
    times = t[: y.shape[1]]

    def slope(s, x):
        return [x[1], (push(s) - C * x[1] - K * x[0] - force(x[0], x[1])) / M]

    exact = solve_ivp(slope, (0, times[-1]), [0, 0], t_eval=times, rtol=1e-10, atol=1e-13, max_step=1e-3).y
    linear = Simulation(mass(), 1 / rate).run(push(t)[None])
    # what the element changes is far larger than the error that is left (a kink costs the order of the step)
    assert np.abs(linear[0] - exact[0]).max() > 0.02 * np.abs(exact[0]).max()
    np.testing.assert_allclose(y[0], exact[0], atol=1e-3 * np.abs(exact[0]).max())
    np.testing.assert_allclose(y[1], exact[1], atol=1e-3 * np.abs(exact[1]).max())
    balance = push(times) - C * y[1] - K * y[0] - np.array([force(z, v) for z, v in zip(y[0], y[1], strict=True)])
    np.testing.assert_allclose(M * y[2], balance, atol=1e-6 * np.abs(M * y[2]).max())


def test_smooth_law_converges_at_fourth_order():
    errors = []
    for rate in (2000.0, 4000.0, 8000.0):
        t = np.arange(round(0.5 * rate)) / rate
        y = NonlinearSimulation(mass(), [Element("cubic", np.ones(1), (4e7,))], 1 / rate).run(push(t)[None])[0]
        fine = np.arange(round(0.5 * 64000)) / 64000
        truth = NonlinearSimulation(mass(), [Element("cubic", np.ones(1), (4e7,))], 1 / 64000).run(push(fine)[None])[0]
        errors.append(np.abs(y - truth[:: round(64000 / rate)][: y.size]).max())
    assert errors[0] / errors[1] == pytest.approx(16, rel=0.3)
    assert errors[1] / errors[2] == pytest.approx(16, rel=0.3)


@pytest.mark.parametrize("law", sorted(LAWS))
def test_zero_parameters_exert_exactly_nothing(law):
    u = push(np.arange(4000) / 4000.0)[None]
    none = NonlinearSimulation(mass(), [Element(law, np.ones(1), (0.0,) * len(LAWS[law]))], 1 / 4000)
    np.testing.assert_allclose(none.run(u), Simulation(mass(), 1 / 4000).run(u), rtol=1e-12, atol=1e-15)


def test_dry_friction_holds_until_the_force_exceeds_it():
    free = mass(1.0, 0.0, 0.0)
    rate = 4000.0
    t = np.arange(round(1.5 * rate)) / rate
    ramp = 10 * t  # passes the friction of 8 N at 0.8 s
    y = NonlinearSimulation(free, [Element("coulomb", np.ones(1), (8.0,))], 1 / rate).run(ramp[None])
    held = t[: y.shape[1]] < 0.79
    assert np.abs(y[0, held]).max() < 1e-10
    late = t[: y.shape[1]] > 0.9
    exact = 10 * (t[: y.shape[1]] - 0.8) ** 3 / 6
    np.testing.assert_allclose(y[0, late], exact[late], rtol=2e-3)


def test_dry_friction_lets_a_free_mass_decay_by_the_same_step_each_half_cycle():
    omega, friction, rate = np.sqrt(K / M), 30.0, 20000.0
    u = np.zeros((1, 30000))
    u[0, 0:20] = 1500.0
    y = NonlinearSimulation(mass(c=0.0), [Element("coulomb", np.ones(1), (friction,))], 1 / rate).run(u)[0]
    turns = np.flatnonzero(np.diff(np.sign(np.diff(y[20:]))) != 0) + 21
    peaks = np.abs(y[turns])
    steps = -np.diff(peaks[: int(peaks[0] / (2 * friction / K)) - 1])
    np.testing.assert_allclose(steps, 2 * friction / K, rtol=1e-2)
    assert np.ptp(y[-1000:]) < 1e-8  # it sticks in the end, away from zero
    assert omega > 0


def test_jenkins_loop_loses_the_energy_of_its_parallelogram():
    k, slip, stiff, rate = 2e4, 15.0, 1e9, 20000.0
    # a stiff spring driven slowly imposes the displacement
    t = np.arange(40000) / rate
    amplitude = 3e-3
    u = stiff * amplitude * np.sin(2 * np.pi * 1.0 * t)
    march = NonlinearSimulation(mass(1.0, 2e4, stiff), [Element("jenkins", np.ones(1), (k, slip))], 1 / rate)
    y = march.run(u[None])
    z = y[0]
    drive = u[: z.size] - 1.0 * y[2] - 2e4 * y[1] - stiff * z
    loop = slice(z.size - 20000, z.size)
    energy = np.sum(0.5 * (drive[loop][1:] + drive[loop][:-1]) * np.diff(z[loop]))
    expected = 4 * slip * (amplitude - slip / k)
    assert energy == pytest.approx(expected, rel=2e-3)


def test_bouc_wen_agrees_with_a_general_integrator():
    k, beta, gamma, n = 2e4, 400.0, 150.0, 1.0
    rate, count = 20000.0, 20000
    t = np.arange(count) / rate
    march = NonlinearSimulation(mass(), [Element("bouc-wen", np.ones(1), (k, beta, gamma, n))], 1 / rate)
    y = march.run(push(t)[None])

    def slope(s, x):
        h = x[2]
        dh = x[1] - beta * abs(x[1]) * abs(h) ** (n - 1) * h - gamma * x[1] * abs(h) ** n
        return [x[1], (push(s) - C * x[1] - K * x[0] - k * h) / M, dh]

    times = t[: y.shape[1]]
    exact = solve_ivp(slope, (0, times[-1]), [0, 0, 0], t_eval=times, rtol=1e-10, atol=1e-14, max_step=5e-4).y
    np.testing.assert_allclose(y[0], exact[0], atol=5e-4 * np.abs(exact[0]).max())


def test_two_elements_on_two_masses():
    rate, n = 20000.0, 8000
    t = np.arange(n) / rate
    u = 400 * np.sin(2 * np.pi * 70 * t)
    elements = [Element("cubic", np.array([-1.0, 1.0]), (5e11,)), Element("cubic", np.array([0.0, 1.0]), (1e11,))]
    made = pair()
    y = NonlinearSimulation(made, elements, 1 / rate).run(u[None])

    def slope(s, x):
        z, v = x[:2], x[2:]
        f = np.array([400 * np.sin(2 * np.pi * 70 * s), 0.0])
        f -= np.array([-1, 1]) * 5e11 * (z[1] - z[0]) ** 3 + np.array([0, 1]) * 1e11 * z[1] ** 3
        return [*v, *np.linalg.solve(made.M, f - made.C @ v - made.K @ z)]

    times = t[: y.shape[1]]
    exact = solve_ivp(slope, (0, times[-1]), np.zeros(4), t_eval=times, rtol=1e-9, atol=1e-14, max_step=5e-4).y
    np.testing.assert_allclose(y, exact[:2], atol=2e-3 * np.abs(exact[:2]).max())
    linear = Simulation(made, 1 / rate).run(u[None])
    assert np.abs(linear - exact[:2]).max() > 0.1 * np.abs(exact[:2]).max()


def test_streaming_gives_the_same():
    u = push(np.arange(3000) / 5000.0)[None]
    elements = [Element("jenkins", np.ones(1), (2e4, 15.0)), Element("coulomb", np.ones(1), (5.0,))]
    whole = NonlinearSimulation(mass(), elements, 1 / 5000).run(u)
    parts = NonlinearSimulation(mass(), elements, 1 / 5000)
    joined = np.hstack([parts.run(u[:, a:b]) for a, b in ((0, 2), (2, 700), (700, 3000))])
    np.testing.assert_allclose(joined, whole, rtol=1e-12, atol=1e-16)


def test_bad_elements():
    with pytest.raises(ModelError, match="not one of cubic"):
        Element("quartic", np.ones(1), (1.0,))
    with pytest.raises(ModelError, match="k, gap"):
        Element("clearance", np.ones(1), (1.0,))
