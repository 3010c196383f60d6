"""Two strong laws from far away: the second is sought beside the first while the tolerance is wide."""

import numpy as np
import pytest

from labnnum.diagnosis.nonlinear.bench import of_fits
from labnnum.diagnosis.nonlinear.explore import LAWS, calmed, engine_start, looked
from labnnum.diagnosis.nonlinear.tempered import contest
from labnnum.diagnosis.observe import observe_all
from labnnum.nonlinear import Element
from tests.diagnosis.test_nonlinear import joint_23
from tests.diagnosis.test_stuck import bench_of
from tests.diagnosis.test_tempered import recorded


def ground(node):
    return np.eye(4)[node - 1]


SLIDER_AND_DRAG = [
    Element("jenkins", joint_23(), (500.0, 1.0)),
    Element("quadratic-damping", ground(4), (10.0,)),
]
DRAG_AND_SLIDER = [
    Element("quadratic-damping", joint_23(), (300.0,)),
    Element("jenkins", ground(1), (500.0, 2.0)),
]


@pytest.mark.parametrize("elements", [SLIDER_AND_DRAG, DRAG_AND_SLIDER], ids=["ground 4", "ground 1"])
def test_two_strong_laws_are_found_where_the_best_law_alone_bends_the_base(elements):
    """Either alone leaves a thousand times the noise and a base that is nobody's; of the first, another law alone comes
    nearer than either of the two.
    """
    bench, i, every = bench_of(observe_all([recorded(elements, level) for level in (1.0, 4.0, 16.0)]))
    calm = calmed(bench.engine, bench.point, bench.runs[i], bench.scatter)
    assert calm.data_part > 100 * calm.count
    nominal = engine_start(bench.joint([]))
    found, leads = looked(bench.joint([]), nominal, every)
    best = contest(bench, nominal, found, LAWS, leads).pairs[0]
    assert best.made.data_part < 1.2 * best.made.count
    assert best.made.prior_part < best.made.n_base
    truth = {
        "stick-slip": next(e for e in elements if e.law == "jenkins"),
        "quadratic-damping": next(e for e in elements if e.law == "quadratic-damping"),
    }
    for lead in of_fits(best):
        element = truth.pop(lead.mechanism)
        assert np.array_equal(np.abs(lead.spot.column), np.abs(element.column))
        assert lead.p[: len(element.parameters)] == pytest.approx(element.parameters, rel=0.02)
    assert not truth
