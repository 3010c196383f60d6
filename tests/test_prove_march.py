"""The referee's time marching against an adaptive integrator, energy and closed forms."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from sessions.prove.truth import march as m
from sessions.prove.truth.nonlinear import coarser

W, ZETA, RATE = 2 * np.pi * 5.0, 0.02, 2000.0


def one(kind, *constants, w=W, zeta=ZETA, u=None, n=4000, rate=RATE):
    coupling = m.Coupling(
        np.array([w**2]), np.array([2 * zeta * w]), np.ones((1, 1)), np.ones(1), np.zeros((1, 1)), np.zeros(1)
    )
    c = np.zeros((1, 8))
    c[0, : len(constants)] = constants
    t = np.arange(n) / rate
    u = force(t) if u is None else u
    z, v, f = m.march(coupling, m.Laws(np.array([kind]), c), u, 1 / rate)
    return t, z[0], v[0], f[0]


def force(t):
    return 800 * np.sin(2 * np.pi * 4.0 * t) * np.minimum(1, t / 0.3)


def adaptive(t, law, w=W, zeta=ZETA):
    def slope(time, y):
        return [y[1], force(time) - 2 * zeta * w * y[1] - w**2 * y[0] - law(y[0], y[1])]

    found = solve_ivp(slope, (0, t[-1]), [0, 0], t_eval=t, rtol=1e-9, atol=1e-10, max_step=1e-3)
    return found.y


def beyond(z, limit):
    return np.sign(z) * max(abs(z) - limit, 0)


@pytest.mark.parametrize(
    ("kind", "constants", "law"),
    [
        (m.CUBIC, (800.0,), lambda z, v: 800 * z**3),
        (m.QUADRATIC, (40.0,), lambda z, v: 40 * z**2),
        (m.CUBIC, (-300.0, 0.4), lambda z, v: -300 * (min(max(z, -0.4), 0.4) ** 3 + 0.48 * beyond(z, 0.4))),
        (m.QUADRATIC, (300.0, 0.4), lambda z, v: 300 * (max(z, -0.4) ** 2 - 0.8 * min(z + 0.4, 0))),
        (m.GAP, (3000.0, 0.3), lambda z, v: 3000 * max(z - 0.3, 0)),
        (m.CLEARANCE, (3000.0, 0.3), lambda z, v: 3000 * (max(z - 0.3, 0) + min(z + 0.3, 0))),
        (m.DRAG, (0.5,), lambda z, v: 0.5 * v * abs(v)),
        (m.VAN_DER_POL, (8.0,), lambda z, v: 8 * z**2 * v),
        (m.SIGNED_SQUARE, (500.0,), lambda z, v: 500 * z * abs(z)),
    ],
)
def test_laws_without_memory_agree_with_an_adaptive_integrator(kind, constants, law):
    t, z, v, f = one(kind, *constants)
    exact = adaptive(t, law)
    assert np.max(np.abs(z - exact[0])) < 2e-3 * np.max(np.abs(exact[0]))
    assert f == pytest.approx([law(a, b) for a, b in zip(z, v, strict=True)], abs=1e-8 * np.max(np.abs(f)))


def test_the_error_falls_with_the_square_of_the_step():
    exact = adaptive(np.arange(1000) / 500.0, lambda z, v: 800 * z**3)[0]
    errors = [np.max(np.abs(one(m.CUBIC, 800.0, n=1000 * k, rate=500.0 * k)[1][::k] - exact)) for k in (1, 2)]
    assert errors[0] / errors[1] == pytest.approx(4, rel=0.25)


def test_friction_stops_a_free_mass_where_it_must():
    # v(0) by a short blow; m v' = -F, so it stops after v0^2 / (2 F)
    t = np.arange(8000) / RATE
    blow = np.where(t < 0.1, 20.0, 0.0)
    _, z, v, f = one(m.COULOMB, 2.0, w=1e-6, zeta=0.0, u=blow, n=8000)
    speed = (20.0 - 2.0) * 0.1
    assert z[-1] == pytest.approx(0.5 * 18 * 0.01 + speed**2 / 4, rel=0.02)
    assert np.max(np.abs(v[-1000:])) < 1e-9
    assert np.max(np.abs(f)) <= 2.0


def test_friction_takes_four_limits_times_amplitude_a_cycle():
    _t, z, v, f = one(m.COULOMB, 60.0, n=12000)
    cycle = int(RATE / 4)
    lost = np.sum(f[-cycle:] * v[-cycle:]) / RATE
    assert lost == pytest.approx(4 * 60.0 * np.max(np.abs(z[-cycle:])), rel=0.02)


def test_a_slider_never_passes_its_limit_and_its_loop_is_that_of_masing():
    _t, z, v, f = one(m.SLIDERS, 2000.0, 150.0, 1, n=12000)
    assert np.max(np.abs(f)) == pytest.approx(150.0)
    cycle = int(RATE / 4)
    lost = np.sum(f[-cycle:] * v[-cycle:]) / RATE
    top = np.max(np.abs(z[-cycle:]))
    assert lost == pytest.approx(4 * 150.0 * (top - 150.0 / 2000.0), rel=0.02)


def test_many_sliders_begin_stiff_and_end_at_their_sum():
    _, z, _, f = one(m.SLIDERS, 2000.0, 150.0, 5, n=6000)
    assert np.max(np.abs(f)) <= 150.0 + 1e-9
    early = np.abs(z) < 1e-3
    first = np.flatnonzero(~early)[0]
    assert f[1:first] == pytest.approx(2000 * z[1:first], rel=1e-6)


def test_bouc_wen_agrees_with_an_adaptive_integrator():
    k, limit, power, share = 1500.0, 0.1, 1.0, 0.5
    t, z, _, _ = one(m.BOUC_WEN, k, limit, power, share)

    def slope(time, y):
        size = (abs(y[2]) / limit) ** power
        dw = y[1] * (1 - size * (share * np.sign(y[2] * y[1]) + 1 - share))
        return [y[1], force(time) - 2 * ZETA * W * y[1] - W**2 * y[0] - k * y[2], dw]

    found = solve_ivp(slope, (0, t[-1]), [0, 0, 0], t_eval=t, rtol=1e-8, atol=1e-10, max_step=1e-3)
    assert np.max(np.abs(z - found.y[0])) < 1e-3 * np.max(np.abs(z))


def test_a_delayed_spring_is_late():
    _, z, v, f = one(m.DELAY, 50.0, 0.02, 1.5)
    late = int(0.02 * RATE)
    assert f[late + 5 : 2000] == pytest.approx(50 * z[5 : 2000 - late] + 1.5 * v[late + 5 : 2000], rel=1e-6, abs=1e-6)


def test_modes_left_out_act_by_their_flexibility():
    stiff = (2 * np.pi * 400.0) ** 2
    full = m.Coupling(
        np.array([W**2, stiff]), np.array([1.0, 300.0]), np.ones((1, 2)), np.ones(2), np.zeros((1, 1)), np.zeros(1)
    )
    short = m.Coupling(
        np.array([W**2]),
        np.array([1.0]),
        np.ones((1, 1)),
        np.ones(1),
        np.full((1, 1), 1 / stiff),
        np.full(1, 1 / stiff),
    )
    laws = m.Laws(np.array([m.CLEARANCE]), np.array([[4000.0, 0.2, 0, 0, 0, 0, 0, 0]]))
    t = np.arange(4000) / RATE
    a, b = (m.march(c, laws, force(t), 1 / RATE)[0][0] for c in (full, short))
    assert np.max(np.abs(a - b)) < 0.001 * np.max(np.abs(a))


def test_two_laws_hold_at_once():
    coupling = m.Coupling(
        np.array([W**2, (3 * W) ** 2]),
        np.array([1.0, 3.0]),
        np.array([[1.0, 0.6], [0.5, -1.0]]),
        np.array([1.0, 0.3]),
        np.zeros((2, 2)),
        np.zeros(2),
    )
    c = np.zeros((2, 8))
    c[0, 0], c[1, :2] = 800.0, (3000.0, 0.1)
    t = np.arange(4000) / RATE
    z, _v, f = m.march(coupling, m.Laws(np.array([m.CUBIC, m.CLEARANCE]), c), force(t), 1 / RATE)
    assert f[0] == pytest.approx(800 * z[0] ** 3, rel=1e-6, abs=1e-6)

    def slope(time, y):
        x = coupling.shape @ y[:2]
        g = np.array([800 * x[0] ** 3, 3000 * (max(x[1] - 0.1, 0) + min(x[1] + 0.1, 0))])
        load = coupling.load * force(time) - coupling.shape.T @ g
        return np.concatenate([y[2:], load - coupling.square * y[:2] - coupling.viscous * y[2:]])

    found = solve_ivp(slope, (0, t[-1]), np.zeros(4), t_eval=t, rtol=1e-9, atol=1e-10, max_step=1e-3)
    exact = coupling.shape @ found.y[:2]
    assert np.max(np.abs(z - exact)) < 2e-3 * np.max(np.abs(exact))


@pytest.mark.parametrize("give", [0.0, 1e-6])
@pytest.mark.parametrize("limit", [0.2, 1.0])
def test_friction_of_many_modes_converges_whether_what_is_left_out_gives_way_or_not(limit, give):
    w = 2 * np.pi * np.array([10, 27, 55, 90, 140, 200, 280, 380.0])
    shape = np.array([[1, -0.8, 0.9, -0.7, 0.8, 0.9, -0.6, 0.7]])
    load = np.array([1, 0.7, -0.8, 0.9, 0.5, -0.6, 0.7, 0.4])
    coupling = m.Coupling(w**2, 0.02 * w, shape, load, np.array([[give]]), np.zeros(1))
    rng, rate, n = np.random.default_rng(3), 400.0, 2000
    tones, phases = rng.uniform(5, 60, 40), rng.uniform(0, 2 * np.pi, 40)
    c = np.zeros((1, 8))
    c[0, 0] = limit

    def mean_force(over):
        t = np.arange(n * over) / (rate * over)
        u = np.cos(2 * np.pi * tones[:, None] * t + phases[:, None]).sum(axis=0) / 6
        return coarser(m.march(coupling, m.Laws(np.array([m.COULOMB]), c), u, 1 / (rate * over))[2][0], over, True)

    inside = slice(100, -400)
    exact = mean_force(128)[inside]
    errors = [np.std(mean_force(over)[inside] - exact) / np.std(exact) for over in (8, 32)]
    assert errors[1] < 2.5e-3
    assert errors[0] > 3 * errors[1]
