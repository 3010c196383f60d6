"""On what footing candidates are compared, and what becomes of one that cannot be carried on."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from labnnum.diagnosis.engine import Engine
from labnnum.diagnosis.nonlinear import bench as benches
from labnnum.diagnosis.nonlinear import pairs
from labnnum.diagnosis.nonlinear.alike import distinct
from labnnum.diagnosis.nonlinear.below import quieter_than
from labnnum.diagnosis.nonlinear.beside import added_to, supposed, widened
from labnnum.diagnosis.nonlinear.clamps import giving
from labnnum.diagnosis.nonlinear.explore import engine_start
from labnnum.diagnosis.nonlinear.fitting import fit
from labnnum.diagnosis.nonlinear.nearby import FIRM, SOUND, heard
from labnnum.diagnosis.nonlinear.slack import slackened
from labnnum.diagnosis.nonlinear.study import raised
from labnnum.diagnosis.nonlinear.whole import Whole
from labnnum.diagnosis.places import places_of
from labnnum.errors import EstimationError
from labnnum.mechanisms import JointStiffness
from labnnum.mechanisms.base import Place
from labnnum.nonlinear import Element
from tests.diagnosis.test_alike import BAND, every_spot, rod
from tests.diagnosis.test_engine import FORCE, beam, engine
from tests.diagnosis.test_nearby import lead_at
from tests.diagnosis.test_nonlinear import FORCE as PUSH
from tests.diagnosis.test_nonlinear import OUTPUTS, chain, joint_23, runs
from tests.diagnosis.test_stuck import bench_of


@pytest.fixture(scope="module")
def hardening():
    """A cubic spring in the chain: its bench over few lines, and the law fitted there."""
    bench, _, every = bench_of(runs([Element("cubic", joint_23(), (2e4,))], chain()))
    few = bench.on(20)
    one = few.direct((engine_start(few.joint([])),), lead_at(every, "joint 2-3", "cubic-stiffness", 2e4), 4)
    assert one is not None
    return bench, one


def test_what_a_fit_leaves_a_value_stays_when_it_is_raised_to_more_lines(hardening):
    _, one = hardening
    more = raised(one, 2.5)
    assert more.cost == pytest.approx(2.5 * one.cost)
    for part in ("data_part", "objective"):
        before, after = (getattr(t.made, part) / t.made.count for t in (one, more))
        assert after == pytest.approx(before, rel=1 / one.made.count)
    assert more.made.prior_part == one.made.prior_part


def test_a_fit_that_does_not_go_on_is_told_by_what_it_leaves_of_the_lines_asked_for(hardening, monkeypatch):
    bench, one = hardening
    monkeypatch.setattr(benches, "tried_fit", lambda *args, **more: None)
    every = bench.on(10_000)
    kept = every.carry_on(one, 3, last=False)
    joint = every.joint_of(one.made.terms)
    monkeypatch.undo()
    again = fit(joint, one.made.x, one.made.orbits, steps=1)
    assert kept.made.count == again.count > one.made.count
    assert kept.made.objective == pytest.approx(again.objective, rel=0.2)
    assert kept.cost - kept.made.objective == pytest.approx(one.cost - one.made.objective)

    def nowhere(self, x, orbits, most):
        raise EstimationError("it does not settle")

    monkeypatch.setattr(benches, "tried_fit", lambda *args, **more: None)
    monkeypatch.setattr(benches.Joint, "settle", nowhere)
    assert every.carry_on(one, 3, last=False).cost == np.inf


def test_a_last_fit_says_whether_its_deviations_are_whole(hardening):
    bench, one = hardening
    assert not one.made.sure
    sure = bench.on(20).carry_on(one, 2, always=True, last=False).made
    assert sure.sure
    assert (np.diag(sure.covariance)[sure.n_base :] > 0).all()


def test_runs_without_a_tolerance_leave_noise_where_a_law_explains_all(hardening):
    bench, _ = hardening
    wide = slackened(replace(bench, firm=(0,)), 0.3)
    sizes = np.array([a.sigma.size for a in bench.lines])
    loud = np.mean(
        np.concatenate(
            [np.ravel((a.sigma / b.sigma) ** 2) for a, b in zip(bench.lines[1:], wide.lines[1:], strict=True)]
        )
    )
    expected = (FIRM * sizes[0] + SOUND * loud * sizes[1:].sum()) / sizes.sum()
    assert heard(bench, wide) == pytest.approx(expected)
    assert heard(bench, slackened(bench, 0.3)) < heard(bench, wide)


def test_a_place_for_which_another_stands_is_passed_over(monkeypatch):
    """A law that was found elsewhere may act there: it has no number among the places that are looked at."""
    made = Engine(rod(1e5), OUTPUTS, (PUSH,), BAND)
    every = every_spot(made)
    kept, _ = distinct(made, every)
    third = next(s for s in every if s.place == Place("ground", "3"))
    assert pairs.number_of(kept, third) is None
    assert [pairs.number_of(kept, s) for s in kept] == list(range(len(kept)))
    monkeypatch.setattr(pairs, "pair_shares", lambda plain, x, some: np.eye(len(some)))
    monkeypatch.setattr(pairs, "asked", lambda some: 2)
    plain = SimpleNamespace(runs=[SimpleNamespace(y=np.zeros((2, 8)))])
    found = pairs._places(plain, np.zeros(3), kept, [third, kept[0]])
    assert (third.place, third.place) in [(a.place, b.place) for a, b in found]
    assert any(kept[0].place in (a.place, b.place) and a.place != b.place for a, b in found)


def found_on(wider, *terms):
    """What a linear search says that begins from the structure of an engine and finds terms besides."""
    held = [a.term for a in wider.structure.added]
    values = np.array([p.nominal for a in wider.structure.added for p in a.parameters])
    more = np.concatenate([values, *(np.full(t.n, 0.7 * t.parameters[0].upper) for t in terms)])
    models = [(held, values, 100.0), ([*held, *terms], more, 10.0)]
    steps = [
        SimpleNamespace(terms=tuple(t), fit=SimpleNamespace(point=SimpleNamespace(terms=v)), cost=c)
        for t, v, c in models
    ]
    return SimpleNamespace(named=(), detail={"selection": SimpleNamespace(chain=tuple(steps), scatter=None)})


def test_a_mechanism_joins_those_that_the_structure_holds():
    """After a clamp that gives a soft joint: one structure with both, and the search begins from the clamp."""
    plain = engine(beam(supports={"1": "clamped"}), inputs=(replace(FORCE[0], node="4"),))
    (wider,) = giving(plain, places_of(plain))
    site = plain.site(*(getattr(places_of(plain), k) for k in ("nodes", "elements", "supports")))
    joint = next(iter(JointStiffness().terms(site)))
    nothing, something = found_on(wider), found_on(wider, joint)
    nothing.detail["selection"].chain = nothing.detail["selection"].chain[:1]
    assert added_to(wider, nothing) is None
    assert supposed(wider, nothing) is None
    both = added_to(wider, something)
    under = supposed(wider, something)
    for made in (both, under.engines[0]):
        assert made.structure.inner is plain.structure
        assert [a.term.mechanism.id for a in made.structure.added] == ["support-compliance", joint.mechanism.id]
        assert made.theta0.size == wider.theta0.size + joint.n
        assert np.isfinite(made.state(made.theta0).omega).all()
    assert widened(both, both.structure.added[-1:]).theta0.size == both.theta0.size + joint.n


def test_of_the_quieter_levels_one_is_held_out_only_where_they_repeat():
    seen = [SimpleNamespace(level=level, distortion={}) for level in (1.0, 4.0, 16.0)]
    one = SimpleNamespace(train=[seen[0], seen[2]], test=[seen[1]], usable=seen, held_out=())
    most = quieter_than(seen)
    assert Whole._under(one, most) == (seen[:2], [], seen[:2])
    one.held_out = (seen[1],)
    assert Whole._under(one, most) == (seen[:1], seen[1:2], seen[:2])
    twice = [SimpleNamespace(level=level, distortion={}) for level in (1.0, 4.0, 16.0) for _ in range(2)]
    one = SimpleNamespace(train=twice[::2], test=twice[1::2], usable=twice, held_out=())
    assert Whole._under(one, quieter_than(twice)) == ([twice[0], twice[2]], [twice[1], twice[3]], twice[:4])
