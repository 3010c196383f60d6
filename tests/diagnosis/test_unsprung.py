"""What a structure holds as a spring becomes part of the law there; laws that bent the base begin anew without it."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from labnnum.diagnosis.engine import Engine
from labnnum.diagnosis.nonlinear.bases import nominal, without
from labnnum.diagnosis.nonlinear.force import N_P
from labnnum.diagnosis.nonlinear.further import LESS, _outstanding
from labnnum.diagnosis.nonlinear.locate import Lead, spots
from labnnum.diagnosis.nonlinear.stuck import held_by, unsprung
from labnnum.mechanisms.attached_oscillator import AttachedOscillator
from labnnum.mechanisms.base import Group, Place, Term
from labnnum.mechanisms.extended import Added, ExtendedStructure
from labnnum.mechanisms.ground_stiffness import GroundStiffness
from labnnum.mechanisms.laws import Maxwell, Oscillator, Spring
from labnnum.mechanisms.viscoelastic import Viscoelastic
from labnnum.parameters import Parameter
from tests.diagnosis.test_nonlinear import FORCE, OUTPUTS, chain

BAND = (2 * np.pi * 2.0, 2 * np.pi * 12.0)


@pytest.fixture(scope="module")
def engine():
    return Engine(chain(), OUTPUTS, (FORCE,), BAND)


@pytest.fixture(scope="module")
def every(engine):
    return spots(engine, engine.site(("1", "2", "3", "4"), (("1", "2"), ("2", "3"), ("3", "4")), ()))


def on(node):
    column = np.zeros((4, 1))
    column[int(node) - 1] = 1.0
    return column


def term(mechanism, law, values, node="4"):
    """A mechanism under a node."""
    some = tuple(Parameter(n, v, 0.1 * v, 10 * v, u) for n, u, v in zip(law.names, law.units, values, strict=True))
    return Term(mechanism, Place("ground", node), some, np.array([values]), (Group(law, on(node), 0),))


def spring(node="4"):
    some = (Parameter("stiffness", 500.0, 5.0, 5e4, "N/m"),)
    return Term(GroundStiffness(), Place("ground", node), some, np.array([[500.0]]), (Group(Spring(), on(node), 0),))


def under(every, node):
    return next(s for s in every if s.place == Place("ground", node))


def test_what_hardly_moves_above_its_own_frequency_is_the_spring_that_it_hangs_on(every):
    one = term(AttachedOscillator(), Oscillator(), (3.0, 1.0, 0.01))
    k = 3.0 * (2 * np.pi) ** 2
    values = np.array([3.0, 1.0, 0.01])
    assert held_by([one], values, under(every, "4"), BAND[0]) == pytest.approx(k)
    assert held_by([one], values, under(every, "4"), 0.9 * 2 * np.pi) == 0.0  # it moves in the band
    assert held_by([one], values, under(every, "3"), BAND[0]) == 0.0


def test_what_gives_slowly_is_a_spring_to_what_is_fast(every):
    one = term(Viscoelastic(), Maxwell(), (700.0, 0.5))
    assert held_by([one], np.array([700.0, 0.5]), under(every, "4"), BAND[0]) == pytest.approx(700.0)
    assert held_by([one], np.array([700.0, 0.01]), under(every, "4"), BAND[0]) == 0.0


def test_stiffness_of_all_that_is_held_at_a_place_adds_up(every):
    held = [spring("4"), spring("3"), term(Viscoelastic(), Maxwell(), (700.0, 0.5))]
    assert held_by(held, np.array([500.0, 90.0, 700.0, 0.5]), under(every, "4"), BAND[0]) == pytest.approx(1200.0)


def test_a_law_takes_the_stiffness_of_an_oscillator_at_its_place(engine, every):
    """An oscillator has a motion of its own, so that the law's place is another column there."""
    one = term(AttachedOscillator(), Oscillator(), (3.0, 1.0, 0.01))
    wide = Engine(ExtendedStructure(chain(), (Added(one.sought, one.parameters),)), OUTPUTS, (FORCE,), BAND)
    assert without(engine, wide, np.zeros(40)) is None
    assert nominal(engine, engine.theta0)[: engine.theta0.size] == pytest.approx(engine.theta0)
    there = spots(wide, wide.site(("1", "2", "3", "4"), (("1", "2"), ("2", "3"), ("3", "4")), ()))
    p = np.zeros(N_P)
    p[:4] = 200.0, 0.01, 1.0, 0.5
    lead = Lead(replace(under(there, "4"), axis="-" + under(there, "4").axis), "hysteresis", p, 0.0)
    made = SimpleNamespace(whole=lambda i: p)
    values = np.array([3.0, 1.0, 0.01])
    plain, stiffer = unsprung([SimpleNamespace(lead=lead, made=made)], [one], values, every, BAND[0])
    assert plain[0].p == pytest.approx(p)
    assert stiffer[0].p[0] == pytest.approx(200.0 + 3.0 * (2 * np.pi) ** 2)
    assert stiffer[0].p[1:] == pytest.approx(p[1:])
    elsewhere = [s for s in every if s.place != lead.spot.place]
    assert unsprung([SimpleNamespace(lead=lead, made=made)], [one], values, elsewhere, BAND[0]) == ()
    for q in (plain[0], stiffer[0]):
        assert q.spot.axis == lead.spot.axis
        assert q.spot.column.size == 4


def lead_at(every, node, gain):
    return Lead(under(every, node), "clearance", np.zeros(N_P), gain)


@pytest.mark.parametrize(
    ("first", "second", "least", "stands_out"),
    [(100.0, 40.0, 90.0, True), (100.0, 60.0, 90.0, False), (100.0, 40.0, 110.0, False)],
)
def test_a_lead_that_stands_out_may_promise_less(every, first, second, least, stands_out):
    leads = [lead_at(every, "2", first), lead_at(every, "4", second)]
    assert _outstanding(leads, least) == (leads[:1] if stands_out else [])
    assert 0 < LESS < 1


def test_other_laws_at_its_own_place_are_no_rivals_to_a_lead_that_stands_out(every):
    leads = [lead_at(every, "2", 100.0), lead_at(every, "2", 95.0)]
    assert _outstanding(leads, 90.0) == leads[:1]
    assert _outstanding([], 1.0) == []
