"""Dry friction in harmonic balance: Den Hartog's exact motion, sticking, and how the error falls with the harmonics."""

import numpy as np
import pytest

from labnnum.harmonic import HarmonicBalance
from labnnum.harmonic.dry import held_back
from labnnum.nonlinear import Element
from labnnum.structures.chain import Chain, Link
from tests.steady import Truth

TURN = 2 * np.pi


def balance(friction, harmonics=15, damping=0.0):
    one = Chain({"1": 1.0}, (Link("1", "ground", 1.0, damping),))
    return HarmonicBalance(one, "1:x", 0.1, elements=[Element("coulomb", np.ones(1), (friction,))], harmonics=harmonics)


def peak(orbit):
    t = np.arange(4096) / 4096
    x = orbit.harmonics[0]
    return np.real(x @ np.exp(2j * np.pi * np.outer(np.arange(x.size), t))).max()


@pytest.mark.parametrize("ratio", [0.6, 0.8, 1.3])
@pytest.mark.parametrize("share", [0.2, 0.4])
def test_a_motion_that_never_stops_is_den_hartogs(ratio, share):
    """x_max / (F / k) = sqrt(V^2 - (share U)^2), V = 1 / (1 - r^2), U = sin(pi/r) / (r (1 + cos(pi/r))) (1931)."""
    v = 1 / (1 - ratio**2)
    u = np.sin(np.pi / ratio) / (ratio * (1 + np.cos(np.pi / ratio)))
    assert share < np.sqrt(v**2 / (u**2 + ratio**-4))  # where it never stops
    exact = 0.1 * np.sqrt(v**2 - (share * u) ** 2)
    found = balance(share * 0.1).solve(ratio / TURN)
    assert peak(found) == pytest.approx(exact, rel=5e-3)
    assert found.work == pytest.approx(4 * share * 0.1 * exact, rel=5e-3)  # what rubs, 4 F x_max, is all that is lost
    assert found.stable


def test_the_error_falls_as_harmonics_are_added():
    """Slowly, for a jump has many: like the first power of their number."""
    exact = 0.1 * np.sqrt((1 / 0.36) ** 2 - (0.5 * np.sin(np.pi / 0.8) / (0.8 * (1 + np.cos(np.pi / 0.8)))) ** 2)
    away = [abs(peak(balance(0.05, h).solve(0.8 / TURN)) / exact - 1) for h in (5, 15, 45)]
    assert away[0] < 0.02
    assert away[1] < 0.5 * away[0]
    assert away[2] < 0.5 * away[1]


@pytest.mark.parametrize(("friction", "omega"), [(0.05, 0.3), (0.06, 0.8)])
def test_a_motion_with_stops_is_that_of_time_integration(friction, omega):
    found = balance(friction, 31, damping=0.1).solve(omega / TURN)
    one = np.ones((1, 1))
    spectrum, _ = Truth(one, 0.1 * one, one, np.array([0.1]), [("coulomb", np.ones(1), (friction,))], omega).steady(12)
    assert abs(found.harmonics[0, 1] - spectrum[0, 1]) < 1e-2 * abs(spectrum[0, 1])
    assert abs(found.harmonics[0, 3] - spectrum[0, 3]) < 1e-2 * abs(spectrum[0, 1])


def test_what_friction_holds_does_not_move():
    """A drive below the limit: no motion, and the friction is the drive."""
    found = balance(0.11, damping=0.1).solve(0.8 / TURN)
    assert np.abs(found.harmonics[0]).max() < 1e-6
    np.testing.assert_allclose(found.force[0, :2], [0.0, 0.1], atol=1e-8)


def test_a_joint_that_sticks_is_a_rigid_one():
    """Friction between two masses that it holds together: the response is that of one mass."""
    pair = Chain({"1": 1.0, "2": 2.0}, (Link("1", "ground", 100.0, 1.0), Link("1", "2", 50.0)))
    law = Element("coulomb", np.array([-1.0, 1.0]), (50.0,))
    found = HarmonicBalance(pair, "1:x", 3.0, ("1:x", "2:x"), elements=[law]).solve(0.7)
    w = 0.7 * TURN
    np.testing.assert_allclose(found.harmonics[:, 1], 3.0 / (100.0 - 3.0 * w**2 + 1j * w), rtol=1e-6)


def test_a_curve_over_the_resonance_is_followed():
    """Two dry joints in a chain; each point keeps its balance of energy."""
    links = (Link("1", "ground", 1000.0, 6.0), Link("1", "2", 800.0, 6.0))
    structure = Chain({"1": 1.0, "2": 1.2}, links)
    laws = [Element("coulomb", np.array(c), (f,)) for c, f in (((-1.0, 1.0), 1.0), ((0.0, 1.0), 1.5))]
    curve = HarmonicBalance(structure, "1:x", 10.0, ("1:x", "2:x"), elements=laws, harmonics=7).curve(
        1.5, 3.5, step=0.2
    )
    assert curve.frequency[-1] >= 3.5
    assert curve.stable.all()
    n = np.arange(8)
    x = curve.harmonics
    stretch = np.stack([x[:, 0], x[:, 1] - x[:, 0]], axis=1)
    dashpots = 6.0 * np.pi * TURN * curve.frequency * np.sum(n**2 * np.abs(stretch) ** 2, axis=(1, 2))
    np.testing.assert_allclose(curve.work, dashpots + curve.lost.sum(axis=1), rtol=1e-6)
    assert (curve.lost > 0).all()


def test_means_of_what_is_held_within_limits():
    """Over each step, straight within it, beside sums over many parts of it; and the slopes."""
    rng = np.random.default_rng(5)
    asked = rng.standard_normal(64) * 3
    mean, to_a, to_b = held_back(asked, 1.0)
    t = (np.arange(20000) + 0.5) / 20000
    after = np.roll(asked, -1)
    exact = np.clip(asked[:, None] * (1 - t) + after[:, None] * t, -1, 1).mean(axis=1)
    np.testing.assert_allclose(mean, exact, atol=1e-6)
    step = 1e-6 * (np.arange(64) % 2 == 0)
    up, down = held_back(asked + step, 1.0)[0], held_back(asked - step, 1.0)[0]
    np.testing.assert_allclose((up - down)[::2] / 2e-6, to_a[::2], atol=1e-5)
    np.testing.assert_allclose((up - down)[1::2] / 2e-6, to_b[1::2], atol=1e-5)
