"""Laws in noise that are marched in step with the measured motion: what a tie does, and when it is asked for."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from labnnum.diagnosis.engine import Engine
from labnnum.diagnosis.nonlinear import study
from labnnum.diagnosis.nonlinear.bench import Bench
from labnnum.diagnosis.nonlinear.effort import LONG, STEP, UNIT, counted, marched, spent
from labnnum.diagnosis.nonlinear.fitting import calmed, fit
from labnnum.diagnosis.nonlinear.follow import along, marched_from
from labnnum.diagnosis.nonlinear.force import N_P
from labnnum.diagnosis.nonlinear.locate import Lead, spots
from labnnum.diagnosis.nonlinear.loosen import _astray, in_step
from labnnum.diagnosis.nonlinear.orbit import Tie, scaled
from labnnum.diagnosis.nonlinear.problem import reduced
from labnnum.diagnosis.nonlinear.records import stretch_of
from labnnum.diagnosis.nonlinear.tie import HIDDEN, resampled, tightness
from labnnum.diagnosis.scatter import Scatter
from labnnum.nonlinear import Element
from tests.diagnosis.test_nonlinear_records import FORCE, OUTPUTS, chain, joint_23, noise, recorded

PLAY = (1000.0, 0.02)
LIGHT = 1.5
"""Dashpots of the chain, N s/m: ratios of 1 to 4 %."""


@pytest.fixture(scope="module")
def rattling():
    """Objective of play in a stretch of noise, its vector at the truth, and its free march."""
    run = stretch_of(recorded(noise(25.0), [Element("clearance", joint_23(), PLAY)], chain(LIGHT)), 1000, 7144)
    engine = Engine(chain(LIGHT), OUTPUTS, (FORCE,), (2 * np.pi * 0.3, 2 * np.pi * 12))
    every = spots(engine, engine.site(("1", "2", "3", "4"), (("1", "2"), ("2", "3"), ("3", "4")), ()))
    spot = next(s for s in every if {s.place.id, s.place.to} == {"2", "3"})
    bench = Bench(engine, engine.start(), (run,), Scatter(), ()).on(350)
    lead = Lead(spot, "clearance", np.array([*PLAY, *np.zeros(N_P - 2)]), 0.0)
    joint = bench.joint_of([replace(lead.acting(), last=True)])
    x = joint.start()
    return joint, x, joint.settle(x, [None], 12)[0]


def test_a_tie_does_nothing_where_the_march_goes_as_it_is_tied(rattling):
    joint, x, free = rattling
    tied = replace(free, tie=Tie(free.motion, np.array([200.0]), 1.0))
    again = joint.settle(x, [tied], 4)[0]
    known = slice(int(HIDDEN * free.time.size), None)
    assert np.linalg.norm(again.time[known] - free.time[known]) < 1e-3 * np.linalg.norm(free.time)
    assert tightness([None, again]) == 1.0
    assert tightness([None, free]) is None


def test_a_tied_march_counts_like_any_other(rattling):
    """What a search over long records leaves out once it has taken long must see it."""
    joint, x, free = rattling

    def spent_on(orbit):
        with counted():
            joint.settle(x, [orbit], 4)
            return spent()

    tied = spent_on(replace(free, tie=Tie(free.motion, np.array([200.0]), 1.0), closing=np.inf))
    assert tied >= spent_on(replace(free, tie=None)) > 0


def test_a_tie_brings_a_march_into_step_that_began_elsewhere(rattling):
    """From a beginning that is wrong by far, with and without the motion that the sensors show."""
    joint, x, free = rattling
    own = replace(free, tie=Tie(free.motion, np.array([40.0])))
    wrong = replace(free, x=free.x + 0.3 * np.sqrt(np.mean(free.motion**2)), tie=None)
    steady, made = joint.steady[0], next(iter(joint.receptances(x).values()))
    pieces = steady.prepare(made)
    source = steady.source(made, pieces, free.source)
    part = slice(int(0.2 * free.time.size), int(0.3 * free.time.size))
    off = [
        np.linalg.norm((steady._march(pieces, source, joint.laws(x), o).time - free.time)[part])
        for o in (wrong, replace(wrong, tie=own.tie))
    ]
    assert off[0] > 0.02 * np.linalg.norm(free.time[part])
    assert off[1] < 0.3 * off[0]


def test_what_a_tie_has_to_do_is_no_force_of_the_law(rattling):
    """A law of no strength explains nothing, however tightly its place is led along the measured motion."""
    joint, x, _ = rattling
    none = x.copy()
    none[joint.n_base] = 0.0
    begun = marched_from(joint, none, along(joint, none), 1.0)
    assert np.abs(joint.settle(none, begun, 4)[0].time).max() == 0.0
    full = marched_from(joint, x, along(joint, x), 1.0)
    left = [reduced(*joint.parts(y, joint.settle(y, o, 4)))[0] for y, o in ((none, begun), (x, full))]
    assert left[1] < 0.02 * left[0]


def test_ties_go_with_the_steps_and_the_scale_of_a_place(rattling):
    _, _, free = rattling
    tie = Tie(free.motion, np.array([40.0]), 0.3)
    finer = resampled(tie, 2 * free.motion.shape[0])
    inside = slice(200, -200)
    np.testing.assert_allclose(finer.motion[::2][inside], tie.motion[inside], rtol=1e-9, atol=1e-12)
    moved = scaled(replace(free, tie=tie), np.array([2.0])).tie
    assert moved is not None
    np.testing.assert_allclose(moved.motion, 2 * free.motion)
    assert (moved.dashpot[0], moved.tight) == (10.0, 0.3)  # half the force at twice the speed


@pytest.mark.parametrize(("long", "tied"), [(False, True), (True, False)])
def test_nothing_is_tied_after_a_long_search(monkeypatch, long, tied):
    def tried(cost, simulated):
        made = SimpleNamespace(data_part=cost, prior_part=0.0, n_base=20, count=100)
        return SimpleNamespace(made=made, simulated=simulated, cost=cost)

    free, fitted = tried(1e5, True), tried(100.0, True)
    monkeypatch.setattr("labnnum.diagnosis.nonlinear.loosen.loosened", lambda bench, one: [fitted])
    bench = SimpleNamespace(runs=[SimpleNamespace(open=True)], simulate=lambda one, steps: free)
    with counted():
        marched(int(1.1 * LONG / (STEP * UNIT)) if long else 1, 5, 1, 0)
        assert in_step(bench, tried(200.0, False), 4) is (fitted if tied else free)


@pytest.mark.parametrize(
    ("kind", "left", "price", "followed", "astray"),
    [
        ("open", 2.0, 1.0, (5.0, 1.0), False),  # less than along the motion, as usual
        ("open", 50.0, 1.0, (5.0, 1.0), True),  # it went elsewhere
        ("open", 2.0, 300.0, (5.0, 1.0), True),  # and took the base along
        ("open", 2.0, 300.0, (5.0, 400.0), False),  # which bends along the motion too
        ("open", None, 0.0, (5.0, 1.0), True),  # no march at all
        ("open", 1.4, 1.0, (1.2, 1.0), False),  # too little to go after
        ("open", 1.6, 1.0, (1.2, 1.0), True),
        ("periodic", 50.0, 1.0, (5.0, 1.0), False),
    ],
)
def test_a_march_is_astray_that_leaves_more_than_the_law_along_the_motion(kind, left, price, followed, astray):
    def tried(data, prior, simulated):
        made = SimpleNamespace(data_part=100 * data, prior_part=prior, n_base=20, count=100)
        return SimpleNamespace(made=made, simulated=simulated)

    bench = SimpleNamespace(runs=(SimpleNamespace(open=kind == "open"),))
    free = None if left is None else tried(left, price, True)
    assert _astray(bench, tried(*followed, False), free) is astray


@pytest.mark.parametrize(("rival", "again"), [(0.3, True), (0.0, False)])
def test_places_are_compared_in_step_where_any_that_comes_near_is(monkeypatch, rival, again):
    """One place is simulated freely, its neighbour in step with the motion or freely too."""

    def tried(place, cost, simulated=False, tight=0.0):
        tie = SimpleNamespace(tie=SimpleNamespace(tight=tight) if tight else None)
        made = SimpleNamespace(data_part=cost, count=100, orbits=(tie,))
        return SimpleNamespace(
            mechanism="cubic-stiffness", named=True, simulated=simulated, cost=cost, made=made,
            spot=SimpleNamespace(place=place),
        )  # fmt: skip

    shown = {"here": tried("here", 116.0, True), "next": tried("next", 110.0, True, rival)}
    asked = []

    def in_step_too(bench, followed, free):
        asked.append(free.spot.place)
        return tried("here", 107.0, True, 0.3)

    monkeypatch.setattr(study, "in_step", lambda bench, one, steps: shown[one.spot.place])
    monkeypatch.setattr(study, "tied", in_step_too)
    with counted():
        bench = SimpleNamespace(against=lambda *tried: None)
        found = study.simulated(bench, [tried("here", 180.0), tried("next", 190.0)])
    assert asked == (["here"] if again else [])
    assert found[0].spot.place == ("here" if again else "next")


def test_a_march_whose_correction_grows_is_marched_more_finely(monkeypatch):
    """Hysteresis four times as stiff as the chain in noise: with the usual steps the forces change by more from march
    to march, and what they leave is no objective.
    """
    loop = Element("bouc-wen", joint_23(), (4000.0, 25.0, 25.0, 1.0))
    run = stretch_of(recorded(noise(25.0), [loop], chain(LIGHT)), 1000, 7144)
    engine = Engine(chain(LIGHT), OUTPUTS, (FORCE,), (2 * np.pi * 0.3, 2 * np.pi * 12))
    every = spots(engine, engine.site(("1", "2", "3", "4"), (("1", "2"), ("2", "3"), ("3", "4")), ()))
    spot = next(s for s in every if {s.place.id, s.place.to} == {"2", "3"})
    lead = Lead(spot, "hysteresis", np.array([4000.0, 0.02, 1.0, 0.5, *np.zeros(N_P - 4)]), 0.0)
    bench = Bench(engine, engine.start(), (run,), Scatter(), ()).on(350)
    joint = bench.joint([lead])
    x, fine = joint.start(), joint.steady[0].fine
    usual = joint.settle(x, [None], 8)
    assert joint.restless(usual)
    assert joint.settle(x, usual, 8)[0].closing > usual[0].closing
    settled = calmed(joint, x, usual)
    assert joint.steady[0].fine == 2 * fine
    assert not joint.restless(settled)
    assert settled[0].closing < 0.05 * usual[0].closing
    assert [t.steps > 0 for t in joint.terms] == [True]  # what is fitted on from here takes as many
    while joint.refine():
        pass
    assert joint.steady[0].fine < 16 * fine
    again, told = bench.joint([lead]), iter((False, True))
    monkeypatch.setattr(again, "restless", lambda orbits: next(told, False))
    x[again.n_base] *= 0.8
    assert fit(again, x, usual, steps=1).count > 0  # marched more finely after its last step a fit takes another
    assert again.steady[0].fine == 2 * fine
