"""Stops, friction, sliders and loops against an integrator that stops at each of their events: errors and orders.

The oracle integrates from event to event with scipy's DOP853, whose events are roots of its dense output; it shares no
code with the march.
"""

from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from labnnum.nonlinear import Element, NonlinearSimulation
from labnnum.simulation import Simulation
from labnnum.system import System

END, RATES = 1.2, (250, 500, 1000)
JOINT, GROUND = np.array([-1.0, 1.0]), np.array([0.0, 1.0])
LAWS = {
    "gap": ("one-sided-gap", JOINT, (2e4, 2e-3)),
    "clearance": ("clearance", JOINT, (2e4, 2e-3)),
    "friction": ("coulomb", JOINT, (12.0,)),
    "friction on the ground": ("coulomb", GROUND, (25.0,)),
    "slider": ("jenkins", JOINT, (1.5e4, 20.0)),
    "loop": ("bouc-wen", JOINT, (1.5e4, 300.0, 200.0, 1.0)),
}


def pair() -> System:
    """Two masses in a row, pushed at the first; both displacements are sensed."""
    c, k = np.array([[9.0, -4.0], [-4.0, 4.0]]), np.array([[2e4, -1.1e4], [-1.1e4, 1.1e4]])
    none = np.zeros((2, 2))
    return System(np.diag([2.0, 1.0]), c, k, np.array([[1.0], [0.0]]), np.eye(2), none, none, np.zeros((2, 1)))


def push(t):
    """Three tones that begin smoothly."""
    tones = ((60, 7.0, 0), (40, 11.3, 1), (20, 16.1, 2))
    return sum(a * np.sin(2 * np.pi * f * t + p) for a, f, p in tones) * (1 - np.exp(-((t / 0.1) ** 8)))


class Located:
    """One law on the pair in one mode at a time: its slopes, where the mode ends and what follows."""

    def __init__(self, law, column, p):
        self.law, self.c, self.p, self.place = law, column, p, 0.0
        self.made, self.start = pair(), 0

    def motion(self, x):
        return self.c @ x[:2], self.c @ x[2:4]

    def without(self, t, x):
        made = self.made
        return np.linalg.solve(made.M, made.load[:, 0] * push(t) - made.C @ x[2:4] - made.K @ x[:2])

    def needed(self, t, x):
        """The force that lets a sticking place accelerate no more."""
        return -(self.c @ self.without(t, x)) / (self.c @ np.linalg.solve(self.made.M, self.c))

    def force(self, mode, t, x):
        z, _ = self.motion(x)
        if self.law in ("one-sided-gap", "clearance"):
            return -self.p[0] * (z - mode * self.p[1]) if mode else 0.0
        if self.law == "coulomb":
            return -self.p[0] * mode if mode else self.needed(t, x)
        if self.law == "jenkins":
            return -self.p[1] * mode if mode else -self.p[0] * (z - self.place)
        return -self.p[0] * x[4]

    def slopes(self, mode):
        def slope(t, x):
            pushed = np.linalg.solve(self.made.M, self.c) * self.force(mode, t, x)
            out = [*x[2:4], *(self.without(t, x) + pushed)]
            if self.law == "bouc-wen":
                v, h = self.motion(x)[1], x[4]
                _, beta, gamma, n = self.p
                out.append(v - beta * abs(v) * h * abs(h) ** (n - 1) - gamma * v * abs(h) ** n)
            return out

        return slope

    def ends(self, mode):
        """Functions that pass zero where the mode ends, one a way out."""
        z, v = (lambda x: self.motion(x)[0]), (lambda x: self.motion(x)[1])
        if self.law == "bouc-wen":
            return []
        if self.law == "one-sided-gap":
            return [lambda t, x: z(x) - self.p[1]]
        if self.law == "clearance":
            return [lambda t, x: z(x) - self.p[1], lambda t, x: z(x) + self.p[1]]
        if mode:
            return [lambda t, x: v(x)]
        if self.law == "coulomb":
            return [lambda t, x: self.p[0] - self.needed(t, x), lambda t, x: self.p[0] + self.needed(t, x)]
        return [lambda t, x, s=s: self.p[0] * (z(x) - self.place) - s * self.p[1] for s in (1, -1)]

    def after(self, mode, way, t, x):
        """The next mode."""
        if self.law == "one-sided-gap":
            return 1 - mode
        if self.law == "clearance":
            return 0 if mode else (1, -1)[way]
        if self.law == "coulomb":
            needed = self.needed(t, x)
            return (-1, 1)[way] if not mode else 0 if abs(needed) <= self.p[0] else -np.sign(needed)
        if mode:
            self.place = self.motion(x)[0] - mode * self.p[1] / self.p[0]
            return 0
        return (1, -1)[way]

    def response(self, times):
        """Both displacements, and how many events there were."""
        known = {"method": "DOP853", "rtol": 1e-11, "atol": 1e-14}
        out, t, mode, count = np.zeros((2, times.size)), 0.0, 0, 0
        x = np.zeros(5 if self.law == "bouc-wen" else 4)
        while t < times[-1]:
            begun = solve_ivp(self.slopes(mode), (t, min(t + 1e-9, times[-1])), x, **known)  # off the last event
            t, x = begun.t[-1], begun.y[:, -1]
            ends = self.ends(mode)
            for end in ends:
                end.terminal = True
            most = 2e-3 if ends else 5e-4
            run = solve_ivp(
                self.slopes(mode), (t, times[-1]), x, events=ends, dense_output=True, max_step=most, **known
            )
            here = (times >= begun.t[0]) & (times <= run.t[-1])
            if here.any():
                out[:, here] = run.sol(np.maximum(times[here], t))[:2]
            t, x = run.t[-1], run.y[:, -1]
            if run.status != 1:
                break
            way = next(i for i, found in enumerate(run.t_events) if found.size)
            mode, count = self.after(mode, way, t, x), count + 1
        return out, count


def marched(law, column, p, rate):
    u = push(np.arange(round(END * rate)) / rate)[None]
    return NonlinearSimulation(pair(), [Element(law, column, p)], 1 / rate).run(u)


@pytest.mark.parametrize("name", LAWS)
def test_events_are_found_within_the_step(name):
    """Fourth order; where forces jump or bend at an event, the step alone would leave the first or the second."""
    law, column, p = LAWS[name]
    exact, events = Located(law, column, p).response(np.arange(round(END * RATES[-1])) / RATES[-1])
    assert events > 15 or law == "bouc-wen"
    error = {}
    for rate in RATES:
        y = marched(law, column, p, rate)
        there = exact[:, :: RATES[-1] // rate][:, : y.shape[1]]
        error[rate] = np.linalg.norm(y - there) / np.linalg.norm(there)
    u = push(np.arange(round(END * 1000)) / 1000)[None]
    linear = Simulation(pair(), 1 / 1000).run(u)
    assert np.linalg.norm(linear - exact[:, : linear.shape[1]]) > 0.03 * np.linalg.norm(exact)
    assert error[1000] < 2e-6
    assert error[250] > 50 * error[1000]  # 256 of the fourth order, 16 of the second


def test_sticking_keeps_its_place():
    """While dry friction holds, neither creep nor chatter."""
    law, column, p = LAWS["friction"]
    z = np.diff(marched(law, column, p, 500), axis=0)[0]
    held = np.abs(np.diff(z)) < 1e-12
    assert 20 < held.sum() < held.size - 20


@pytest.mark.parametrize("name", LAWS)
def test_pieces_of_any_size_give_the_same(name):
    law, column, p = LAWS[name]
    u = push(np.arange(400) / 400)[None]
    whole = NonlinearSimulation(pair(), [Element(law, column, p)], 1 / 400).run(u)
    parts = NonlinearSimulation(pair(), [Element(law, column, p)], 1 / 400)
    joined = np.hstack([parts.run(u[:, a:b]) for a, b in pairwise((0, 1, 2, 9, 150, 151, 400))])
    np.testing.assert_allclose(joined, whole, rtol=1e-14, atol=1e-17)
    parts.reset()
    np.testing.assert_array_equal(parts.run(u), whole)


def test_several_laws_at_once_converge_to_one_answer():
    """Two sliders in a joint, dry friction and a stop at the ground: events of one while the others stick or slide."""
    elements = [
        Element("jenkins", JOINT, (8e3, 8.0)), Element("jenkins", JOINT, (4e3, 14.0)),
        Element("coulomb", GROUND, (6.0,)), Element("one-sided-gap", GROUND, (3e4, 4e-3)),
    ]  # fmt: skip
    out = {}
    for rate in (250, 500, 1000, 8000):
        u = push(np.arange(round(END * rate)) / rate)[None]
        out[rate] = NonlinearSimulation(pair(), elements, 1 / rate).run(u)[:, :: rate // 250][:, :290]
    error = {r: np.linalg.norm(out[r] - out[8000]) / np.linalg.norm(out[8000]) for r in (250, 500, 1000)}
    assert error[1000] < 2e-6
    assert error[250] > 50 * error[1000]


def test_a_stop_that_is_touched_within_one_step_is_not_missed():
    """A free mass thrown at a stop and back: contact for half a period of the stop, 0.7 of a step."""
    one, zero = np.ones((1, 1)), np.zeros((1, 1))
    rows = np.eye(2)[:, :, None]
    free = System(one, zero, zero, one, rows[0], rows[1], np.zeros((2, 1)), np.zeros((2, 1)))
    step = 0.01
    k = (np.pi / (0.7 * step)) ** 2
    u = np.zeros((1, 200))
    u[0, 10:30] = 5.0 * np.sin(np.pi * np.arange(20) / 20) ** 4
    freely = Simulation(free, step).run(u)
    speed = freely[1, -1]
    march = NonlinearSimulation(free, [Element("one-sided-gap", np.ones(1), (k, 0.6 * freely[0, -1]))], step)
    assert march.run(u)[1, -1] == pytest.approx(-speed, rel=0.05)
