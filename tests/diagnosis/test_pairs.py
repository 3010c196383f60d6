"""Two nonlinear laws at once: forces told apart, laws found together, and limits of sliders that are spread."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from labnnum.diagnosis import diagnose
from labnnum.diagnosis.engine import Engine
from labnnum.diagnosis.nonlinear.answer import _Search
from labnnum.diagnosis.nonlinear.bench import Bench, Study, Tried, of_fits
from labnnum.diagnosis.nonlinear.company import beside_others
from labnnum.diagnosis.nonlinear.decision import _stands_out
from labnnum.diagnosis.nonlinear.fitting import fit
from labnnum.diagnosis.nonlinear.further import _distinct, asked
from labnnum.diagnosis.nonlinear.lines import choose_lines
from labnnum.diagnosis.nonlinear.locate import Background, Lead, Spot, motion_of, motions_of, spots
from labnnum.diagnosis.nonlinear.pairs import _from_calm, _places, combined, pair_shares
from labnnum.diagnosis.nonlinear.problem import Acting, Joint, steps_of
from labnnum.diagnosis.nonlinear.receptance import Base
from labnnum.diagnosis.scatter import Scatter
from labnnum.diagnosis.verdict import Limits
from labnnum.mechanisms.base import Place
from labnnum.nonlinear import Element
from tests.diagnosis.test_nonlinear import FORCE, OUTPUTS, chain, joint_23, runs, spread_sliders

LEVELS = (2.0, 8.0, 25.0)


def ground(i):
    return np.eye(4)[i - 1]


def bench(elements):
    """Runs, engine and places of a chain with these laws."""
    structure = chain()
    made = [o.run for o in runs(elements, structure)]
    engine = Engine(structure, OUTPUTS, (FORCE,), (2 * np.pi * 0.5, 2 * np.pi * 12))
    every = spots(engine, engine.site(("1", "2", "3", "4"), (("1", "2"), ("2", "3"), ("3", "4")), ()))
    return made, engine, every


TWO = [Element("cubic", joint_23(), (2e4,)), Element("quadratic-damping", ground(1), (10.0,))]


def test_what_two_places_explain_alike_they_share():
    """A place given twice has the motion that it has alone, and each time half the force."""
    made, engine, _ = bench([TWO[0]])
    run = max(made, key=lambda r: r.level)
    omega = 2 * np.pi * run.frequency
    twice = Base(engine, engine.start(), np.array([joint_23(), joint_23()]).T, omega)
    seen = motions_of(run, twice.at(twice.start()))
    np.testing.assert_allclose(seen[:, 0], seen[:, 1], rtol=1e-6, atol=1e-9)
    once = Base(engine, engine.start(), joint_23()[:, None], omega)
    z, _, f = motion_of(run, once.at(once.start()))[:3]
    assert np.linalg.norm(seen[:, 0, 0] - z) < 0.02 * np.linalg.norm(z)
    assert np.linalg.norm(2 * seen[:, 0, 2] - f) < 0.2 * np.linalg.norm(f)


def test_the_places_of_two_forces_explain_most_of_the_distortion():
    made, engine, every = bench(TWO)
    loud = [r for r in made if r.level > 0.5 * max(r.level for r in made)]
    plain = Joint(engine, engine.start(), loud, (), Scatter(), [choose_lines(r, 100) for r in loud])
    shares = pair_shares(plain, plain.start(), every)
    names = [str(s.place) for s in every]
    a, b = names.index("joint 2-3"), names.index("ground 1")
    own = max(shares[a, b], shares[b, a])
    assert own > 0.9
    assert np.count_nonzero(np.triu(np.maximum(shares, shares.T), 1) > own) <= 2


def test_two_laws_of_which_either_alone_explains_little_are_named_together():
    found = diagnose(chain(), runs(TWO, chain()))
    named = {(n.term.mechanism.id, str(n.place)): n.value for n in found.named}
    assert set(named) == {("cubic-stiffness", "joint 2-3"), ("quadratic-damping", "ground 1")}, found.summary
    assert named["cubic-stiffness", "joint 2-3"] == pytest.approx([2e4], rel=0.1)
    assert named["quadratic-damping", "ground 1"] == pytest.approx([10.0], rel=0.1)


def test_with_two_sensors_laws_tell_where_the_second_acts():
    """Any two forces explain all there, so that every place is asked, and the laws come nearest at the right one."""
    two = [Element("cubic", ground(2), (2e4,)), Element("quadratic-damping", joint_23(), (40.0,))]
    structure = chain()
    made = [o.run for o in runs(two, structure, levels=(2.0, 9.0), sensors=(0, 2))]
    engine = Engine(structure, (OUTPUTS[0], OUTPUTS[2]), (FORCE,), (2 * np.pi * 0.5, 2 * np.pi * 12))
    every = spots(engine, engine.site(("1", "2", "3", "4"), (("1", "2"), ("2", "3"), ("3", "4")), ()))
    plain = Joint(engine, engine.start(), made, (), Scatter(), [choose_lines(r, 100) for r in made])
    first = next(s for s in every if str(s.place) == "ground 2")
    asked_at = _places(plain, plain.start(), every, [first])
    beside = {str(p.place) for pair in asked_at for p in pair}
    assert beside == {str(s.place) for s in every}
    background = Background(plain, plain.start())
    best = min((row for pair in asked_at for row in combined(background, plain.start(), *pair)), key=lambda row: row[0])
    assert {(lead.mechanism, str(lead.spot.place)) for lead in best[2]} == {
        ("cubic-stiffness", "ground 2"), ("quadratic-damping", "joint 2-3"),
    }  # fmt: skip


@pytest.mark.parametrize(("samples", "places"), [(10_000, 16), (200_000, 5), (5_000_000, 3)])
def test_places_are_asked_as_far_as_runs_are_short(samples, places):
    assert asked([SimpleNamespace(period=samples // 2), SimpleNamespace(period=samples // 2)]) == places


def test_laws_of_one_kind_at_one_place_are_one_lead():
    def lead(mechanism, place):
        return Lead(Spot(Place("ground", place), "x", np.zeros(4)), mechanism, np.zeros(10), 0.0)

    some = [lead("stick-slip", "1"), lead("hysteresis", "1"), lead("cubic-stiffness", "1"), lead("hysteresis", "2")]
    assert _distinct(some) == [some[0], some[2], some[3]]


def test_sliders_that_let_go_one_after_the_other_are_stick_slip_with_a_spread():
    found = diagnose(chain(), runs(spread_sliders(400.0, 9.0, 0.8), chain(), LEVELS))
    assert [(n.term.mechanism.id, str(n.place)) for n in found.named] == [("stick-slip", "joint 2-3")], found.summary
    told = found.as_dict()["mechanism"]["parameters"]
    assert told["k_t"]["value"] == pytest.approx(400.0, rel=0.15)
    assert told["F_s"]["value"] == pytest.approx(9.0, rel=0.15)
    assert told["spread"]["value"] == pytest.approx(0.8, abs=0.15)


def test_one_slider_has_no_spread():
    found = diagnose(chain(), runs([Element("jenkins", joint_23(), (400.0, 6.0))], chain(), LEVELS)[::2])
    assert list(found.as_dict()["mechanism"]["parameters"]) == ["k_t", "F_s"], found.summary


def test_steps_are_those_of_the_law_that_needs_most():
    contact = Acting("clearance", joint_23(), np.array([1.0, 1.0]), last=True)
    dry = Acting("coulomb-friction", joint_23(), np.array([1.0]), last=True)
    assert steps_of([contact]) < steps_of([contact, dry]) == steps_of([dry])


def _tried(cost, mechanism="cubic-stiffness", place="1", prior=0.0):
    """A candidate that leaves this much a value."""
    made = SimpleNamespace(objective=1000.0 * cost, data_part=1000.0 * cost, prior_part=prior, n_base=10, count=1000)
    spot = Spot(Place("ground", place), "x", np.zeros(4))
    return Tried(Lead(spot, mechanism, np.zeros(10), 0.0), made, 1000.0 * cost)


@pytest.mark.parametrize(
    ("cost", "other", "prior", "error", "named"),
    [
        (10.0, 500.0, 0.0, 0.05, True),  # nearly all, and nothing else comes near
        (10.0, 15.0, 0.0, 0.05, False),  # another place explains as much but for a half
        (90.0, 500.0, 0.0, 0.05, False),  # too much is left
        (10.0, 500.0, 1e4, 0.05, False),  # the base beside it is another structure
        (10.0, 500.0, 0.0, 0.4, False),  # it foretells nothing
    ],
)
def test_a_law_that_stands_out_is_named_though_more_is_missing(cost, other, prior, error, named):
    best, rival = _tried(cost, prior=prior), _tried(other, place="3")
    found = SimpleNamespace(tried=(best, rival), general=None, base=SimpleNamespace(objective=1e6, count=1000))
    assert _stands_out(found, best, best, (0.5, 0.5), (error, error)) is named


def two_laws():
    """The fits of a chain with two laws: each of two first laws alone, and with the second, the right one first."""
    made, engine, every = bench(TWO)
    spot = {str(s.place): s for s in every}
    plain = Bench(engine, engine.start(), tuple(made), Scatter(), ()).on(250)

    def lead(place, mechanism, value):
        return Lead(spot[place], mechanism, np.eye(10)[0] * value, 0.0)

    cubic, drag = lead("joint 2-3", "cubic-stiffness", 2e4), lead("ground 1", "quadratic-damping", 10.0)
    other = lead("joint 2-3", "quadratic-stiffness", 100.0)
    x = plain.joint([]).start()
    alone = [plain.both(x, [one], 4) for one in (cubic, other)]
    both = [plain.both(x, [one, drag], 6) for one in (cubic, other)]
    whole = [replace(t, lead=drag, more=()) for t in both]
    cost = alone[0].cost * alone[1].made.count / alone[0].made.count
    alone[1] = replace(alone[1], cost=1.01 * cost)
    base = fit(plain.joint([]), x, [None] * len(made), steps=6)
    study = Study(engine, engine.start(), tuple(made), base, base, tuple(alone), None, ())
    return study, plain, alone, both, whole


def test_rivals_of_one_law_are_told_beside_the_other():
    """Alone two laws at one place may differ by little while a second law is missing; beside it they do not."""
    study, _, alone, both, whole = two_laws()
    company = beside_others(study, [alone[0], whole[0]], Scatter())
    assert [t.mechanism for t in company] == ["quadratic-stiffness"]
    assert company[0].made.objective > 3 * both[0].made.objective
    assert beside_others(study, [alone[0]], Scatter()) == ()


def test_a_rival_of_the_first_law_takes_its_place_where_it_leaves_far_less_beside_the_second():
    study, _, alone, both, whole = two_laws()
    one = SimpleNamespace(scatter=Scatter(), limits=Limits())
    study = replace(study, tried=(alone[1], replace(alone[0], cost=1.01 * alone[1].cost)))
    found, laws = _Search._in_company(one, study, [alone[1], whole[1]])
    assert {(t.name, str(t.spot.place)) for t in laws} == {
        ("cubic-stiffness", "joint 2-3"), ("quadratic-damping", "ground 1"),
    }  # fmt: skip
    assert laws[-1].made.objective < 1.1 * both[0].made.objective
    assert found.tried[0].mechanism == "cubic-stiffness"
    assert found.company == (whole[1],)  # what it is told from
    same, kept = _Search._in_company(one, replace(study, tried=tuple(alone)), [alone[0], whole[0]])
    assert kept == [alone[0], whole[0]]
    assert same.tried == tuple(alone)


def test_two_laws_that_hold_a_wrong_state_are_fitted_again_next_to_their_parameters():
    study, plain, _, both, _ = two_laws()
    cubic, drag = (replace(lead, p=lead.p * by) for lead, by in zip(of_fits(both[0]), (0.3, 1.0), strict=True))
    calm = study.quiet.x
    stuck = plain.both(plain.joint([]).start(), [cubic, drag], 1)
    assert stuck is not None
    assert stuck.made.data_part > 3 * stuck.made.count
    found = _from_calm(plain, calm, stuck)
    assert found.made.data_part < 1.2 * both[0].made.data_part
    assert found.made.law(0)[0] == pytest.approx([2e4], rel=0.1)
    assert _from_calm(plain, calm, both[0]) is both[0]  # what explains the data stays
