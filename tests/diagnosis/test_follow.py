"""Laws followed along the recovered motion, beside a channel that lies, and on bodies that nothing else holds."""

from dataclasses import replace

import numpy as np
import pytest

from labnnum.diagnosis import diagnose
from labnnum.diagnosis.engine import Engine
from labnnum.diagnosis.nonlinear.explore import explore
from labnnum.diagnosis.nonlinear.force import CODES
from labnnum.diagnosis.nonlinear.locate import spots
from labnnum.diagnosis.nonlinear.receptance import Base
from labnnum.diagnosis.nonlinear.run import Run
from labnnum.diagnosis.nonlinear.start import base_point, quietest
from labnnum.diagnosis.nonlinear.steady import Steady
from labnnum.diagnosis.observe import observe_all
from labnnum.diagnosis.scatter import Scatter
from labnnum.nonlinear import Element
from labnnum.parameters import Parameter
from labnnum.structures import Chain
from labnnum.structures.chain import Link
from tests.diagnosis.test_nonlinear import FORCE, OUTPUTS, PERIOD, RATE, chain, joint_23, marched, multisine, runs

SLIDER = Element("jenkins", joint_23(), (400.0, 6.0))
LEVELS = (2.0, 8.0, 25.0)


def test_a_slider_is_measured_before_anything_is_simulated():
    structure = chain()
    observations = [o for i, o in enumerate(runs([SLIDER], structure, LEVELS)) if i % 2 == 0]
    some = sorted(observations, key=lambda o: o.level)
    band = (0.5, 12.0)
    engine = Engine(structure, OUTPUTS, (FORCE,), (2 * np.pi * band[0], 2 * np.pi * band[1]))
    every = spots(engine, engine.site(("1", "2", "3", "4"), (("1", "2"), ("2", "3"), ("3", "4")), ()))
    made = [o.run for o in some if o.run is not None]
    i = quietest(made)
    seen = explore(engine, base_point(engine, some[i], Scatter(), band), made, i, every, Scatter())
    assert seen is not None
    best = seen.near[0]
    assert (best.name, best.spot.place.id, best.spot.place.to) == ("stick-slip", "2", "3")
    stiffness, limit = best.made.law(0)[0][:2]
    assert stiffness == pytest.approx(400.0, rel=0.1)
    assert limit == pytest.approx(6.0, rel=0.15)


def test_what_lies_beside_a_law_is_named_too():
    structure = chain()
    recordings = [r for o in runs([Element("cubic", joint_23(), (2e4,))], structure) for r in o.recordings]
    wrong = [replace(r, data=r.data * np.array([1.0, 1.0, 1.5, 1.0])[:, None]) for r in recordings]
    found = diagnose(structure, observe_all(wrong))
    named = {(n.term.mechanism.id, str(n.place)): n.value for n in found.named}
    assert set(named) == {("cubic-stiffness", "joint 2-3"), ("channel-gain", "channel a2")}, found.summary
    assert named["channel-gain", "channel a2"][0] == pytest.approx(0.5, abs=0.03)
    assert named["cubic-stiffness", "joint 2-3"][0] == pytest.approx(2e4, rel=0.1)


def test_a_free_body_held_by_its_law_alone_settles():
    """The steady state of a chain that hangs on a slider only, where the rigid body has no stiffness of its own."""
    p = (400.0, 25.0)
    links = [Link(str(i), str(i + 1), 1000.0, 4.0) for i in range(1, 4)]
    structure = Chain(
        {"1": "m", "2": 1.0, "3": 1.0, "4": 1.0}, tuple(links), (Parameter("m", 1.0, 0.5, 2.0, "kg", std=0.1),)
    )
    engine = Engine(structure, OUTPUTS, (FORCE,), (2 * np.pi * 0.5, 2 * np.pi * 12))
    column = np.array([0.0, 1.0, 0.0, 0.0])
    base = Base(engine, engine.start(), column[:, None], 2 * np.pi * np.arange(PERIOD // 2 + 1) * RATE / PERIOD)
    spectrum = multisine(5.0, 3)
    none = np.zeros((3, PERIOD // 2 + 1))
    run = Run(RATE, PERIOD, spectrum, none.astype(complex), none, spectrum != 0, 1.0, "run", OUTPUTS, FORCE, 1)
    solver = Steady(run, np.array([CODES["stick-slip"]]), 4)
    parameters = np.zeros((1, 10))
    parameters[0, : len(p)] = p
    r = base.at(base.start())
    orbit = solver.settle(r, parameters, solver.guess(r, np.zeros((solver.n, 1))), 40, 1e-6, warm=10)
    assert orbit.closing < 1e-4
    tied = replace(structure, links=(*links, Link("1", "ground", 1e-3, 0.0)))  # the other march wants poles apart
    y = marched(spectrum, [Element("jenkins", column, p)], tied, fine=16, periods=60)
    linear = r.lift * (r.plain * spectrum)
    own = linear + r.lift * (r.h * orbit.force).sum(axis=1)
    other = np.fft.rfft(y, axis=1)[:, : PERIOD // 2 + 1] * 2 / y.shape[1]
    at = np.flatnonzero(spectrum)
    assert np.linalg.norm(own[:, at] - other[:, at]) < 0.02 * np.linalg.norm(other[:, at])


def test_friction_that_holds_on_a_flexible_body_settles():
    """Beyond the modes that are marched the body gives under the friction at once, and with a speed."""
    links = [Link("ground", "1", 800.0, 4.0), *(Link(str(i), str(i + 1), 1000.0, 4.0) for i in (1, 2))]
    parameter = Parameter("m", 1.0, 0.5, 2.0, "kg", std=0.1)
    structure = Chain({"1": "m", "2": 1.0, "3": 1.0, "4": 0.02}, (*links, Link("3", "4", 5e3, 0.5)), (parameter,))
    engine = Engine(structure, OUTPUTS, (FORCE,), (2 * np.pi * 0.5, 2 * np.pi * 12))
    column = np.array([0.0, 0.0, 0.0, 1.0])
    base = Base(engine, engine.start(), column[:, None], 2 * np.pi * np.arange(PERIOD // 2 + 1) * RATE / PERIOD)
    none = np.zeros((3, PERIOD // 2 + 1))
    limit = 6.0
    for level in (1.0, 5.0, 20.0):
        spectrum = multisine(level, 3)
        run = Run(RATE, PERIOD, spectrum, none.astype(complex), none, spectrum != 0, 1.0, "run", OUTPUTS, FORCE, 1)
        solver = Steady(run, np.array([CODES["coulomb"]]), 16)
        parameters = np.zeros((1, 10))
        parameters[0, 0] = limit
        r = base.at(base.start())
        orbit = solver.settle(r, parameters, solver.guess(r, np.zeros((solver.n, 1))), 14, warm=3)
        assert orbit.closing < 1e-3
        y = marched(spectrum, [Element("coulomb", column, (limit,))], structure, fine=64, periods=9)
        own = r.lift * (r.plain * spectrum + (r.h * orbit.force).sum(axis=1))
        other = np.fft.rfft(y, axis=1)[:, : PERIOD // 2 + 1] * 2 / y.shape[1]
        at = np.flatnonzero(spectrum)
        assert np.linalg.norm(own[:, at] - other[:, at]) < 0.05 * np.linalg.norm(other[:, at])
