"""Errors over runs held out: simulated from where they were, and along the motion that they show."""

from dataclasses import replace

import numpy as np
import pytest

from labnnum.diagnosis.engine import Engine
from labnnum.diagnosis.nonlinear.errors import errors_of, shown_error
from labnnum.diagnosis.nonlinear.force import N_P
from labnnum.diagnosis.nonlinear.lines import choose_lines
from labnnum.diagnosis.nonlinear.locate import Lead, Spot
from labnnum.diagnosis.nonlinear.problem import Joint
from labnnum.diagnosis.scatter import Scatter
from labnnum.mechanisms.base import Place
from labnnum.nonlinear import Element
from tests.diagnosis.test_nonlinear import FORCE, OUTPUTS, chain, joint_23, runs


@pytest.fixture(scope="module")
def settled():
    """Objective of a cubic spring that is known, its vector and steady states; the last run is held out."""
    made = [o.run for o in runs([Element("cubic", joint_23(), (2e4,))], chain(), levels=(1.0, 9.0))]
    engine = Engine(chain(), OUTPUTS, (FORCE,), (2 * np.pi * 0.5, 2 * np.pi * 12))
    p = np.zeros(N_P)
    p[0] = 2e4
    lead = Lead(Spot(Place("joint", "2", "3"), "x", joint_23()), "cubic-stiffness", p, 0.0)
    lines = [choose_lines(r, 120) for r in made]
    joint = Joint(engine, engine.start(), made, [lead.acting()], Scatter(), lines)
    x = joint.start()
    return joint, x, joint.settle(x, [None] * len(made), 20)


def test_a_right_law_leaves_little_either_way(settled):
    joint, x, orbits = settled
    assert errors_of(joint, x, orbits, 3)[1] < 0.01
    assert shown_error(joint, x, orbits, 3) < 0.01


def test_where_a_simulation_ends_elsewhere_the_motion_still_tells(settled):
    joint, x, orbits = settled
    elsewhere = replace(orbits[3], force=-orbits[3].force)
    assert errors_of(joint, x, [*orbits[:3], elsewhere], 3)[1] > 3 * errors_of(joint, x, orbits, 3)[1]
    assert shown_error(joint, x, [*orbits[:3], elsewhere], 3) == shown_error(joint, x, orbits, 3)


def test_a_wrong_law_is_wrong_along_the_motion_too(settled):
    joint, x, orbits = settled
    stiffer = x.copy()
    stiffer[joint.n_base] *= 3
    assert shown_error(joint, stiffer, orbits, 3) > 3 * shown_error(joint, x, orbits, 3)


def test_without_runs_held_out_nothing_is_known(settled):
    joint, x, orbits = settled
    assert np.isnan(shown_error(joint, x, orbits, 4))
