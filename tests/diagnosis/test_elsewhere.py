"""Where the force of a law that was found at a wrong place would do better, and what the law is there."""

import numpy as np
import pytest

from labnnum.diagnosis.engine import Engine
from labnnum.diagnosis.nonlinear.bench import Bench, Study
from labnnum.diagnosis.nonlinear.elsewhere import as_well, moved_to
from labnnum.diagnosis.nonlinear.fitting import fit
from labnnum.diagnosis.nonlinear.laws import SHAPES, force_along
from labnnum.diagnosis.nonlinear.locate import Lead, spots
from labnnum.diagnosis.nonlinear.records import stretch_of
from labnnum.diagnosis.scatter import Scatter
from labnnum.nonlinear import Element
from tests.diagnosis.test_nonlinear_records import FORCE, OUTPUTS, chain, joint_23
from tests.diagnosis.test_repeated import swept

K2 = 500.0


def study(place, p):
    """The study of a sweep past a chain's modes, the first of which feels a quadratic spring in joint 2-3, in which the
    law was fitted at a place.
    """
    made = [stretch_of(r, 0, r.n_samples) for r in swept([Element("quadratic", joint_23(), (K2,))])]
    engine = Engine(chain(1.0), OUTPUTS, (FORCE,), (2 * np.pi * 0.5, 2 * np.pi * 12))
    every = spots(engine, engine.site(("1", "2", "3", "4"), (("1", "2"), ("2", "3"), ("3", "4")), ()))
    desk = Bench(engine, engine.start(), tuple(made), Scatter(), ()).on(100)
    plain = desk.joint([])
    quiet = fit(plain, plain.start(), [None, None], steps=6)
    spot = next(s for s in every if str(s.place) == place)
    best = desk.direct((quiet.x,), Lead(spot, "quadratic-stiffness", np.append(p, np.zeros(9)), 0.0), 12)
    assert best is not None
    return Study(engine, engine.start(), tuple(made), quiet, quiet, (best,), None, ()), every


@pytest.mark.parametrize("wrong", ["ground 1", "ground 2", "joint 1-2", "joint 3-4"])
def test_the_force_of_a_law_at_a_wrong_place_tells_where_it_acts(wrong):
    found, every = study(wrong, 50.0)
    leads = as_well(found, found.best, every, Scatter())
    gain, first = leads[0]
    assert str(first.spot.place) == "joint 2-3"
    assert gain > 1
    assert first.p[0] > 0  # the descent to its size is the fit's


def test_at_the_right_place_no_other_does_better():
    found, every = study("joint 2-3", K2)
    assert all(gain < 1 for gain, _ in as_well(found, found.best, every, Scatter()))


@pytest.mark.parametrize("mechanism", [m for m in SHAPES if m != "general"])
@pytest.mark.parametrize("size", [0.3, 5.0, -2.0])
def test_a_law_at_another_place_makes_the_same_force_of_the_motion_there(mechanism, size):
    """Where the motion is smaller by the factor by which the force is larger, and turned with it."""
    found, every = study("joint 2-3", K2)
    p = np.array([3.0, 0.2, 0.5 if mechanism == "sliders" else 1.5, 0.5])
    n = len(SHAPES[mechanism].names)
    lead = Lead(found.best.lead.spot, mechanism, np.append(p[:n], np.zeros(10 - n)), 0.0)
    moved = moved_to(lead, every[0], size)
    t = np.linspace(0, 4 * np.pi, 4000)
    z, v = np.sin(t) + 0.4 * np.sin(2 * t), np.cos(t) + 0.8 * np.cos(2 * t)

    def force(one, z, v):
        sign = -1.0 if one.spot.axis.startswith("-") else 1.0
        return sign * force_along(SHAPES[mechanism], sign * z, sign * v, one.p)

    np.testing.assert_allclose(force(moved, z / size, v / size), size * force(lead, z, v), rtol=1e-9, atol=1e-9)
