"""Levels that hold the base, and those below the loudest one: a stop that touches at high levels only."""

from dataclasses import replace

import numpy as np
import pytest

from labnnum.diagnosis.nonlinear.below import quieter_than, under
from labnnum.diagnosis.nonlinear.explore import LAWS, calmed, looked
from labnnum.diagnosis.nonlinear.locate import Lead, Spot
from labnnum.diagnosis.nonlinear.slack import slackened
from labnnum.diagnosis.nonlinear.study import explained
from labnnum.diagnosis.nonlinear.tempered import contest
from labnnum.diagnosis.nonlinear.whole import on_structure
from labnnum.diagnosis.observe import observe_all
from labnnum.mechanisms.base import Place
from labnnum.nonlinear import Element
from tests.diagnosis.test_nonlinear import joint_23
from tests.diagnosis.test_stuck import bench_of
from tests.diagnosis.test_tempered import recorded

STOP = (4000.0, 2e-3)


@pytest.fixture(scope="module")
def stop():
    """Observations of a stop that the lowest level does not reach, and their bench."""
    element = Element("one-sided-gap", joint_23(), STOP)
    seen = observe_all([recorded([element], level) for level in (0.1, 4.0, 16.0)])
    return seen, *bench_of(seen)


def test_levels_below_the_loudest(stop):
    seen = stop[0]
    most = quieter_than(seen)
    assert [o.level for o in under(seen, most)] == [o.level for o in seen[:2]]
    assert quieter_than(seen[1:]) == 0.0  # one level alone tells no law from a linear structure
    assert quieter_than([replace(o, level=np.nan) for o in seen]) == 0.0
    assert quieter_than([*seen, replace(seen[2], level=1.1 * seen[2].level)]) == pytest.approx(most * 1.1)


def test_a_run_that_the_base_explains_is_given_no_tolerance(stop):
    _, bench, i, _ = stop
    calm = calmed(bench.engine, bench.point, bench.runs[i], bench.scatter)
    firm = explained(bench, calm.x)
    assert firm == (0,)
    wide = slackened(replace(bench, firm=firm), 0.3)
    assert wide.lines[0] is bench.lines[0]
    assert wide.closing == bench.closing
    for a, b in zip(bench.lines[1:], wide.lines[1:], strict=True):
        assert (b.sigma > a.sigma).all()


def test_the_quiet_level_holds_the_base_while_a_strong_law_is_sought(stop):
    _, bench, i, every = stop
    calm = calmed(bench.engine, bench.point, bench.runs[i], bench.scatter)
    found, leads = looked(bench.joint([]), calm.x, every)
    best = contest(replace(bench, firm=explained(bench, calm.x)), calm.x, found, LAWS, leads).near[0]
    assert (best.mechanism, best.spot.place.id, best.spot.place.to) == ("one-sided-gap", "2", "3")
    assert best.made.law(0)[0] == pytest.approx(STOP, rel=0.02)
    assert best.made.data_part < 1.3 * best.made.count


def test_a_law_goes_to_the_same_spot_of_a_structure_with_more_motions():
    here, there = (
        [Spot(Place("ground", str(i)), "z", np.eye(n)[i]) for i in range(3)] for n in (4, 5)
    )  # fmt: skip
    lead = Lead(replace(here[1], axis="-z"), "one-sided-gap", np.ones(10), 1.0)
    made = on_structure([lead], there)
    assert made is not None
    assert made[0].spot.axis == "-z"
    assert np.array_equal(made[0].spot.column, np.eye(5)[1])
    assert np.array_equal(made[0].p, lead.p)
    assert on_structure([lead], [there[0], there[2]]) is None
