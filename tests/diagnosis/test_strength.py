"""A law promised far too strong is tried weaker where nothing settles; one whose strength is not told has no name."""

from types import SimpleNamespace

import numpy as np
import pytest

from labnnum.diagnosis.engine import Engine
from labnnum.diagnosis.nonlinear import decision
from labnnum.diagnosis.nonlinear.bench import Bench
from labnnum.diagnosis.nonlinear.force import N_P
from labnnum.diagnosis.nonlinear.locate import Lead, Spot
from labnnum.diagnosis.scatter import Scatter
from labnnum.mechanisms.base import Place
from labnnum.nonlinear import Element
from tests.diagnosis.test_nonlinear import FORCE, OUTPUTS, chain, joint_23, runs


@pytest.mark.parametrize("times", [1.0, 10.0])
def test_a_law_that_carries_the_structure_off_is_tried_weaker(times):
    made = [o.run for o in runs([Element("quadratic", joint_23(), (-2e3,))], chain(), levels=(1.0, 9.0))]
    engine = Engine(chain(), OUTPUTS, (FORCE,), (2 * np.pi * 0.5, 2 * np.pi * 12))
    bench = Bench(engine, engine.start(), tuple(made), Scatter(), ()).on(120)
    p = np.zeros(N_P)
    p[0] = -2e3 * times
    lead = Lead(Spot(Place("joint", "2", "3"), "x", joint_23()), "quadratic-stiffness", p, 0.0)
    start = bench.joint([lead]).start()
    assert (bench._direct([start[: bench.joint([lead]).n_base]], lead, 10) is None) is (times > 1)
    found = bench.direct([start[: bench.joint([lead]).n_base]], lead, 10)
    assert found.made.law(0)[0] == pytest.approx([-2e3], rel=0.05)


@pytest.mark.parametrize(
    ("value", "std", "untold"),
    [((9e13,), (1e16,), True), ((-2.0,), (3.0,), True), ((9e13,), (2e13,), False), ((1e9, 2e-3), (4e9, 1e-5), False)],
)
def test_a_law_whose_strength_may_be_anything_has_no_name(value, std, untold):
    """Stops may be as hard as they like, if their gap is told."""
    made = SimpleNamespace(law=lambda i: (np.array(value), np.array(std)))
    assert decision._untold(made, 0) is untold
