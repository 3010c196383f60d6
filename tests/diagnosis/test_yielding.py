"""Hysteresis over a step: against its own differential equation, against dry friction, and its slopes."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from labnnum.diagnosis.nonlinear import yielding
from labnnum.diagnosis.nonlinear.force import HELD
from labnnum.diagnosis.nonlinear.within import solved
from labnnum.diagnosis.nonlinear.yielding import yielded, yields

LIMIT, N, SHARE = 0.3, 1.7, 0.6


def along(motion, give=0.0, limit=LIMIT, n=N, share=SHARE):
    h, out = 0.0, []
    for a, b in pairwise(motion):
        h = yielded(b - a, give, h, limit, n, share)
        out.append(h)
    return np.array(out)


@pytest.mark.parametrize(("share", "of_sign"), [(SHARE, SHARE), (1.0, 1.0), (1.2, 0.8), (1.6, 0.4), (1.9, 0.1)])
def test_it_follows_its_differential_equation(share, of_sign):
    t, size = np.linspace(0, 2, 2001), 1.0 if share < 1.5 else 0.3

    def rate(at, h):
        v = 2 * np.pi * size * np.cos(2 * np.pi * at)
        return v * (1 - (of_sign * np.sign(v * h) + 1 - share) * abs(h / LIMIT) ** N)

    exact = solve_ivp(rate, (0, 2), [0.0], t_eval=t, rtol=1e-10, atol=1e-12, max_step=1e-3).y[0]
    made = along(size * np.sin(2 * np.pi * t), share=share)
    np.testing.assert_allclose(made, exact[1:], atol=2e-4 * np.abs(exact).max())


def test_loading_stiffens_beyond_a_share_of_one_and_a_half():
    z = np.linspace(0, LIMIT, 2001)
    for share in (1.2, 1.5, 1.8):
        a = (3 - 2 * share) / LIMIT  # dh/dz = 1 - a h while it loads
        exact = -np.expm1(-a * z) / a if a else z
        np.testing.assert_allclose(along(z, n=1.0, share=share), exact[1:], rtol=1e-6)


@pytest.mark.parametrize("n", [0.7, 1.0, 3.0, 6.0])
def test_a_step_of_many_limits_ends_at_the_limit_and_does_not_ring(n):
    h = along([0, 100 * LIMIT, 0, 100 * LIMIT, 200 * LIMIT, 150 * LIMIT], n=n)
    np.testing.assert_allclose(h / LIMIT, [1, -1, 1, 1, -1], atol=0.06)


def test_a_step_of_a_few_limits_hardly_goes_beyond_them():
    for step in np.linspace(0.05, 30, 300) * LIMIT:
        assert np.abs(along(step * np.array([0, 1, 0, 1, 2, 3, 2, 1, 0]), share=1.0)).max() < 1.2 * LIMIT


def test_what_stiffens_without_end_stays_a_number():
    h = along(100 * LIMIT * np.sin(np.linspace(0, 20, 2000)), share=1.9, n=6.0)
    assert np.isfinite(h).all()
    assert np.abs(h).max() <= yielding.RUNAWAY * LIMIT


@pytest.mark.parametrize(
    ("step", "share"), [*((s, SHARE) for s in (0.02, -0.1, 0.6, -3.0, 40.0)), (0.02, 1.6), (-0.1, 1.3), (0.2, 1.8)]
)
@pytest.mark.parametrize("h0", [0.0, 0.21, -0.29])
def test_slopes(step, h0, share):
    def h(**changed):
        own = {"step": step, "h0": h0, "limit": LIMIT, "n": N, "share": share, **changed}
        return yielded(own["step"], 0.0, own["h0"], own["limit"], own["n"], own["share"])

    d = np.empty(5)
    yields(step, h0, h(), LIMIT, N, share, d)
    for i, (name, at) in enumerate({"step": step, "h0": h0, "limit": LIMIT, "n": N, "share": share}.items()):
        e = 1e-6 * max(abs(at), 0.1)
        np.testing.assert_allclose(d[i], (h(**{name: at + e}) - h(**{name: at - e})) / (2 * e), rtol=1e-4, atol=1e-8)


@pytest.mark.parametrize("k", [1.0, 1e3, 1e9])
def test_a_force_agrees_with_the_motion_that_it_leaves(k):
    gz, z = 1e-3, 0.4
    p, memory = np.zeros(10), np.array([0.1, 0.2])
    p[:4] = k, LIMIT, N, SHARE
    f = solved(7, 0, z, 0.0, gz, 0.0, False, p[None], memory[None], 0.0, 0.0, 1.0)
    h = yielded(z + gz * f - memory[0], 0.0, memory[1], LIMIT, N, SHARE)
    np.testing.assert_allclose(-f / k, h, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("k", [1.0, 100.0, 800.0])
def test_so_does_one_whose_spring_the_structure_holds(k):
    gz, z = 1e-3, 0.4
    p, memory = np.zeros(10), np.array([0.1, 0.2])
    p[:4], p[HELD] = (k, LIMIT, N, SHARE), 1.0
    f = solved(7, 0, z, 0.0, gz, 0.0, False, p[None], memory[None], 0.0, 0.0, 1.0)
    h = yielded(z + gz * f - memory[0], 0.0, memory[1], LIMIT, N, SHARE)
    np.testing.assert_allclose(-f / k, h - (z + gz * f), rtol=1e-6, atol=1e-9)


def test_a_stiff_law_is_found_to_the_last_digit_of_the_motion():
    """Newton's method alone goes in circles: the force takes back all of the motion that numbers tell."""
    gz, z, k3 = 1e-3, 0.7, 1e30
    p = np.zeros(10)
    p[0] = k3
    f = solved(0, 0, z, 0.0, gz, 0.0, False, p[None], np.zeros((1, 2)), 0.0, 0.0, 1.0)
    np.testing.assert_allclose(f, -z / gz, rtol=1e-8)


@pytest.mark.parametrize("give", [0.0, 0.3, 100.0])
@pytest.mark.parametrize("top", [0.1, 1.0, 10.0])
def test_a_step_takes_few_rounds(monkeypatch, give, top):
    """A step of Newton's method that ends on a bound, to the last digit, has arrived: it is not to be halved."""
    asked, rate = [], yielding._rate
    monkeypatch.setattr(yielding, "_rate", lambda *a: asked.append(a) or rate(*a))
    h = moved = 0.0
    for z in top * LIMIT * np.sin(np.linspace(0, 40, 500)):
        h = yielded.py_func(z - moved, give, h, LIMIT, N, SHARE)
        moved = z - give * h
    assert len(asked) < 5.5 * 500
