"""A strong law moves on to its place, takes the form that its motion asks for, and stands on a clamp that gives."""

from dataclasses import replace
from functools import partial
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest

from labnnum.diagnosis.nonlinear import nearby
from labnnum.diagnosis.nonlinear.bench import tried_fit
from labnnum.diagnosis.nonlinear.beside import left_alone
from labnnum.diagnosis.nonlinear.clamps import giving, nearer_to
from labnnum.diagnosis.nonlinear.explore import LAWS, engine_start, looked
from labnnum.diagnosis.nonlinear.force import N_P
from labnnum.diagnosis.nonlinear.locate import Lead
from labnnum.diagnosis.nonlinear.nearby import SOUND, heard, moved
from labnnum.diagnosis.nonlinear.slack import BRIEF, SETTLED, slackened
from labnnum.diagnosis.nonlinear.tempered import _unbent, contest
from labnnum.diagnosis.nonlinear.weighed import clear
from labnnum.diagnosis.observe import observe_all
from labnnum.diagnosis.places import places_of
from labnnum.nonlinear import Element
from tests.diagnosis.test_engine import FORCE, beam, engine
from tests.diagnosis.test_nonlinear import joint_23
from tests.diagnosis.test_stuck import bench_of
from tests.diagnosis.test_tempered import LIMIT, recorded

STOP = 4000.0, 2e-3
"""Stiffness (N/m) and gap (m) of stops on both sides."""


def bench_with(*elements, levels=(1.0, 4.0, 16.0)):
    return bench_of(observe_all([recorded(elements, level) for level in levels]))


@pytest.fixture(scope="module")
def dry():
    return bench_with(Element("coulomb", joint_23(), (LIMIT,)))


def lead_at(every, place, mechanism, *values):
    p = np.zeros(N_P)
    p[: len(values)] = values
    return Lead(next(s for s in every if str(s.place) == place), mechanism, p, 0.0)


def test_noise_leaves_less_the_wider_the_tolerance(dry):
    bench = dry[0]
    left = [heard(bench, slackened(bench, slack)) for slack in (0.0, 0.01, 0.1, 0.3)]
    assert left[0] == pytest.approx(SOUND)
    assert all(a > b > 0 for a, b in pairwise(left))


def test_a_law_beside_its_place_moves_on_to_it(dry):
    bench, _, every = dry
    wide = slackened(bench, 0.3)
    x = engine_start(bench.joint([]))
    beside = wide.carry_on(
        wide.direct((x,), lead_at(every, "ground 3", "coulomb-friction", 1.0), BRIEF), SETTLED, last=False
    )
    on = moved(wide, x, [beside], every, heard(bench, wide))
    assert str(on[-1].spot.place) == "joint 2-3"
    assert on[-1].cost < 0.5 * beside.cost
    assert on[-1].made.law(0)[0][0] == pytest.approx(LIMIT, rel=0.2)


def test_a_law_at_its_place_stays(dry):
    bench, _, every = dry
    wide = slackened(bench, 0.3)
    x = engine_start(bench.joint([]))
    right = wide.carry_on(wide.direct((x,), lead_at(every, "joint 2-3", "coulomb-friction", 1.0), BRIEF), SETTLED)
    assert moved(wide, x, [right], every, 0.0) == []
    assert moved(wide, x, [], every, 0.0) == []


def test_stops_on_both_sides_are_found_by_the_one_on_either():
    """Stops that are promised too far apart are never touched, and no descent brings them nearer."""
    bench, _, every = bench_with(Element("clearance", joint_23(), STOP))
    plain = bench.joint([])
    nominal = engine_start(plain)
    found, leads = looked(plain, nominal, every)
    some = [law for law in LAWS if law != "clearance"]
    best = contest(bench, nominal, found, some, leads, look=partial(looked, plain, spots=every)).near[0]
    assert (best.mechanism, str(best.spot.place)) == ("clearance", "joint 2-3")
    assert best.made.law(0)[0] == pytest.approx(STOP, rel=0.05)


def test_a_clamp_that_gives_is_a_parameter_of_the_model():
    """Of the size that, to first order, moves a squared frequency by itself: the exact frequencies fall by a third."""
    plain = engine(beam(supports={"1": "clamped"}), inputs=(replace(FORCE[0], node="4"),))
    (wider,) = giving(plain, places_of(plain))
    more = wider.structure.parameters[len(plain.structure.parameters) :]
    assert [p.name.split(".")[-1] for p in more] == ["compliance", "compliance_turn"]
    assert all(0 == p.lower < p.nominal < p.upper and p.spread > p.nominal for p in more)
    first = [e.state(e.theta0).omega[0] for e in (plain, wider)]
    assert 0.4 < first[1] / first[0] < 0.8
    stiff = np.append(plain.theta0, 1e-4 * wider.theta0[-2:])
    (nearer,) = [nearer_to(plain, wider, stiff)]
    assert nearer.state(nearer.theta0).omega[:3] == pytest.approx(plain.state(plain.theta0).omega[:3], rel=1e-3)
    assert wider.state(stiff).omega[0] > 1.03 * first[0]  # the modes of one clamp are a poor basis for another


def test_nothing_gives_where_nothing_is_held():
    free = engine(beam())
    assert giving(free, places_of(free)) == []


@pytest.mark.parametrize(
    ("misfit", "plain", "told"), [(143.0, np.inf, True), (143.0, 100.0, False), (2.0, 100.0, True)]
)
def test_a_law_on_another_structure_must_be_clear_of_what_the_model_leaves_as_it_is(misfit, plain, told):
    """A clamp that gives too much leaves a hundred times as much, against which anything is clear."""
    base = SimpleNamespace(data_part=22800.0, count=1)
    last = SimpleNamespace(made=SimpleNamespace(prior_part=1.0, n_base=10))
    study = SimpleNamespace(base=base)
    found = SimpleNamespace(study=study, laws=[last], named=("a law",), reason="", lying=None, misfit=misfit)
    assert clear(found, plain) is told


def test_what_the_base_leaves_of_all_runs_by_itself():
    """Noise of a sound structure, and far more of one with stops."""
    stops = Element("clearance", joint_23(), STOP)
    left = []
    for elements in ((), (stops,)):
        observed = observe_all([recorded(elements, level) for level in (1.0, 16.0)])
        bench, _, _ = bench_of(observed)
        band = bench.engine.band[0] / (2 * np.pi), bench.engine.band[1] / (2 * np.pi)
        left.append(left_alone(bench.engine, SimpleNamespace(train=observed), bench.scatter, band))
    assert left[0] < 2.0 < 50.0 < left[1]


class Table:
    """A bench whose fits cost what a table says: place -> costs, one after the other."""

    def __init__(self, **costs):
        self.costs = {place: list(some) for place, some in costs.items()}
        self.asked = []

    def fit(self, place):
        made = SimpleNamespace(data_part=self.costs[place][0], count=1, bare=1, x=np.zeros(1))
        return SimpleNamespace(cost=self.costs[place].pop(0), made=made, spot=SimpleNamespace(where=place, place=place))

    def direct(self, bases, lead, steps, soften):
        self.asked.append(lead.spot.where)
        return self.fit(lead.spot.where)

    def carry_on(self, one, steps, last):
        return self.fit(one.spot.where) if self.costs[one.spot.where] else one


@pytest.mark.parametrize(
    ("a", "asked", "best"),
    [
        ((9.0, 3.0, 2.0, 1.0), ["b", "a"], "a"),  # it comes back, with what it learnt at b
        ((9.0, 5.0, 4.9, 4.9), ["b", "a"], "b"),  # there it does no better
        ((9.0, 8.0), ["b", "a"], "b"),  # and far worse
    ],
)
def test_a_law_may_come_back_with_what_it_learnt_elsewhere(monkeypatch, a, asked, best):
    wide = Table(a=a, b=(5.0, 4.5, 4.0))
    elsewhere = {"a": "b", "b": "a"}

    def answered(bench, x, one, every):
        return [(1.0, SimpleNamespace(spot=SimpleNamespace(where=elsewhere[one.spot.where])))]

    monkeypatch.setattr(nearby, "answered", answered)
    out = moved(wide, np.zeros(1), [wide.fit("a")], (), 0.0)
    assert wide.asked == asked
    assert min(out, key=lambda t: t.cost).spot.place == best


def test_a_law_that_its_base_keeps_from_fitting_begins_anew_from_the_nominal_one(dry):
    bench, _, every = dry
    narrow = slackened(bench, 0.1)
    nominal = engine_start(bench.joint([]))
    right = narrow.direct((nominal,), lead_at(every, "joint 2-3", "coulomb-friction", LIMIT), SETTLED, soften=False)
    assert _unbent(narrow, nominal, right, SETTLED) is right
    x = right.made.x.copy()
    x[1:3] += 0.3  # modes a third too high, where no descent finds back
    joint = narrow.joint([right.lead])
    bent = tried_fit(joint, x, [None] * len(bench.runs), right.lead, 1)
    assert bent.made.data_part > 3 * bent.made.count
    mended = _unbent(narrow, nominal, bent, SETTLED)
    assert mended.cost < 0.1 * bent.cost
    assert mended.made.law(0)[0][0] == pytest.approx(LIMIT, rel=0.2)
