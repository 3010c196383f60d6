"""The force within a step against the law that it is solved from, and the march's three ways against each other."""

import numpy as np
import pytest
from scipy.linalg import expm

from labnnum.diagnosis.nonlinear.force import CODES, HELD, N_P, SLIDERS, law
from labnnum.diagnosis.nonlinear.march import march
from labnnum.diagnosis.nonlinear.within import solved

LAWS = [
    ("cubic", (3e6,)),
    ("cubic", (-2e4,)),
    ("quadratic", (2e4,)),
    ("one-sided-gap", (900.0, 3e-3)),
    ("clearance", (900.0, 3e-3)),
    ("quadratic-damping", (40.0,)),
    ("stick-slip", (800.0, 2.0)),
    ("hysteresis", (800.0, 2e-3, 1.3, 0.6)),
    ("hysteresis", (800.0, 2e-3, 1.0, 1.6)),
    ("general", (3e4, 2e3, 1e6, 1e9, 3.0, 2.0, 2e4, 90.0, 30.0, 5.0)),
    ("sliders", (800.0, 2.0, 0.7)),
]
GZ, GV = 2e-4, 3e-2
"""What a force does to motion and speed within its own step, m/N and m/s/N."""


def parameters(values, held=0.0):
    p = np.zeros((1, N_P))
    p[0, : len(values)] = values
    if held:
        p[0, HELD] = held
    return p


@pytest.mark.parametrize(("name", "values"), LAWS)
@pytest.mark.parametrize("scale", [1e-3, 0.1, 1.0, 20.0])
def test_a_force_is_that_of_the_motion_which_it_leaves(name, values, scale):
    rng, p, size = np.random.default_rng(3), parameters(values), SLIDERS if name == "sliders" else 2
    for _ in range(40):
        z, v = 5e-3 * scale * rng.standard_normal(), 0.3 * scale * rng.standard_normal()
        memory = 2e-3 * min(scale, 1.0) * rng.standard_normal((1, size))
        if name == "cubic" and values[0] < 0 and abs(z) > 0.1:
            continue  # beyond the fold of a spring that softens there is no force
        if name == "quadratic" and 1 + 4 * GZ * values[0] * z < 0.05:
            continue
        if values[3:] == (1.6,) and abs(z - memory[0, 0]) > values[1]:
            continue  # nor one way on for a loop that stiffens within a step of many limits
        f = solved(CODES[name], 0, z, v, GZ, GV, False, p, memory, 0.0, 0.1, 1e-3)
        back, dz, dv = law(
            CODES[name], z + GZ * f, v + GV * f, p[0], memory[0], np.empty(10), np.empty(6)
        )  # fmt: skip
        assert abs(f + back) <= 1e-9 * (abs(f) + abs(dz * z) + abs(dv * v))


@pytest.mark.parametrize("name", ["stick-slip", "hysteresis", "sliders"])
def test_so_is_one_whose_spring_the_structure_holds(name):
    values = next(v for n, v in LAWS if n == name)
    rng, p, size = np.random.default_rng(4), parameters(values, 1.0), SLIDERS if name == "sliders" else 2
    for _ in range(40):
        z, memory = 8e-3 * rng.standard_normal(), 2e-3 * rng.standard_normal((1, size))
        f = solved(CODES[name], 0, z, 0.0, GZ, GV, False, p, memory, 0.0, 0.0, 1e-3)
        back, dz, _ = law(CODES[name], z + GZ * f, 0.0, p[0], memory[0], np.empty(10), np.empty(6))
        assert abs(f + back) <= 1e-9 * (abs(f) + abs(dz * z) + values[0] * abs(z))


MARCHED = [(*row, False) for row in LAWS] + [("coulomb", (0.6,), False), ("coulomb", (0.6,), True)]


@pytest.mark.parametrize(("name", "values", "sits"), MARCHED)
def test_a_march_is_the_same_with_tangents_and_beside_a_law_that_does_nothing(name, values, sits):
    alone, (bare, end) = marched(name, values, sits, 0, 1), marched(name, values, sits, 3, 1)[:2]
    np.testing.assert_allclose(bare, alone[0], atol=1e-9 * np.abs(alone[0]).max())
    np.testing.assert_allclose(end, alone[1], atol=1e-9 * np.abs(end).max())
    for tangents in (0, 3):
        beside = marched(name, values, sits, tangents, 2)[0]
        np.testing.assert_allclose(beside[:, :1], bare, atol=1e-7 * np.abs(bare).max())
        assert not np.any(beside[:, 1])


def test_tangents_beside_a_law_that_does_nothing_are_the_same():
    for name, values, sits in MARCHED:
        one, two = marched(name, values, sits, 3, 1)[2], marched(name, values, sits, 3, 2)[2]
        np.testing.assert_allclose(two[:, 0], one[:, 0], atol=1e-4 * np.abs(one).max() + 1e-12)


def marched(name, values, sits, tangents, k):
    """Forces, state at the end and tangents of the forces of 600 steps of two modes; a second law has no strength."""
    n, h, omega = 600, 1e-3, 2 * np.pi * np.array([17.0, 60.0])
    T = np.array([expm(np.array([[0, 1], [-(w**2), -0.02 * w]]) * h).ravel() for w in omega]).T
    W0, W1 = np.array([[h * h / 3] * 2, [h / 2] * 2]), np.array([[h * h / 6] * 2, [h / 2] * 2])
    w = np.array([[0.7, 0.5], [0.4, -0.6]])[:k]
    gz, gv = (w * W1[0]) @ w.T, (w * W1[1]) @ w.T
    if sits:
        gv = gz / h
    t = np.arange(n) * h
    source = np.zeros((n, k, 2))
    source[:, :, 0] = (8e-3 * np.sin(2 * np.pi * 5 * t) + 2e-3 * np.sin(2 * np.pi * 31 * t))[:, None]
    source[:, :, 1] = np.gradient(source[:, 0, 0], h)[:, None]
    codes = np.full(k, CODES[name])
    p = np.zeros((k, N_P))
    p[0, : len(values)] = values
    room = SLIDERS if name == "sliders" else 2
    x, f, memory = np.zeros((2, 2)), np.zeros(k), np.zeros((k, room))
    forces, motion = np.empty((n, k)), np.empty((n, k, 2))
    X, df, dmem = np.zeros((2, 2, tangents)), np.zeros((k, tangents)), np.zeros((k, room, tangents))
    dp, ds = np.zeros((k, N_P, tangents)), np.zeros((n, k, 2, min(tangents, 1)), np.float32)
    if tangents:
        dp[0, 0, 1] = values[0]
        X[0, 1, 2] = 1e-3
        ds[:, 0, :, 0] = source[:, 0]
    slopes, free = np.empty((n, k, tangents), np.float32), np.zeros((0, 0))
    bad = march(
        T, W0, W1, w, gz, gv, np.zeros((k, k)), np.full(k, sits), h, source, codes, p, x, f, memory, forces, motion, X,
        df, dmem, dp, ds, slopes, f, df, free, free,
    )  # fmt: skip
    assert bad == 0
    return forces, x, slopes
