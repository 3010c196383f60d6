"""Laws stiffer than the structure: their steady states close, and the search finds the structure that they hold."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from labnnum.diagnosis.engine import Engine
from labnnum.diagnosis.nonlinear.bench import Bench, Study, Tried, of_fit
from labnnum.diagnosis.nonlinear.bounds import frf_least, linear_least
from labnnum.diagnosis.nonlinear.decision import lead_over
from labnnum.diagnosis.nonlinear.discrete import feedback
from labnnum.diagnosis.nonlinear.explore import engine_start, looked
from labnnum.diagnosis.nonlinear.fitting import GROUPS
from labnnum.diagnosis.nonlinear.force import CODES, N_P
from labnnum.diagnosis.nonlinear.locate import Lead, Spot, spots
from labnnum.diagnosis.nonlinear.numbered import numbered
from labnnum.diagnosis.nonlinear.problem import Acting, _fine
from labnnum.diagnosis.nonlinear.run import Run
from labnnum.diagnosis.nonlinear.softened import softened
from labnnum.diagnosis.nonlinear.start import base_point, quietest
from labnnum.diagnosis.nonlinear.steady import Steady
from labnnum.diagnosis.nonlinear.stuck import beside_spring, own_stiffness, quiet_data, springs_along, sticking, stuck
from labnnum.diagnosis.nonlinear.study import kindred
from labnnum.diagnosis.scatter import Scatter
from labnnum.mechanisms.base import Group, Place, Term
from labnnum.mechanisms.joint_stiffness import JointStiffness
from labnnum.mechanisms.laws import Spring
from labnnum.nonlinear import Element
from labnnum.parameters import Parameter
from tests.diagnosis.test_nonlinear import (
    FORCE,
    OUTPUTS,
    PERIOD,
    RATE,
    chain,
    joint_23,
    lines_of,
    marched,
    multisine,
    runs,
    spread_sliders,
    steady,
)

STIFF = 4e3
"""Four times the links of the chain."""


def test_a_slider_that_sticks_is_a_linear_spring():
    """A slider that never yields, four times as stiff as the links, against the exact linear response."""
    structure, spectrum = chain(), multisine(1.0, 3)
    base, coarse, parameters = steady(structure, spectrum, "stick-slip", (STIFF, 1e9))
    solver = Steady(coarse.run, np.array([CODES["stick-slip"]]), 1)
    r = base.at(base.start())
    orbit = solver.settle(r, parameters, solver.guess(r, np.zeros((solver.n, 1))), 12)
    assert orbit.closing < 1e-3
    assert feedback(solver.prepare(r), r, orbit.motion, orbit.time) is not None
    exact = -STIFF * r.z[0] / (1 + STIFF * r.g[0, 0]) * spectrum
    on = spectrum != 0
    assert np.linalg.norm(orbit.force[0, on] - exact[on]) < 2e-3 * np.linalg.norm(exact[on])


def test_weak_laws_need_no_feedback():
    base, solver, parameters = steady(chain(), multisine(25.0, 1), "cubic", (3e4,))
    r = base.at(base.start())
    orbit = solver.settle(r, parameters, solver.guess(r, np.zeros((solver.n, 1))), 25)
    assert orbit.fed is None


def _observed(element, levels):
    return sorted(runs([element], chain(), levels), key=lambda o: o.level)[::2]


def _bench(element, levels):
    return bench_of(_observed(element, levels))


def bench_of(observations):
    structure, band = chain(), (0.5, 12.0)
    engine = Engine(structure, OUTPUTS, (FORCE,), (2 * np.pi * band[0], 2 * np.pi * band[1]))
    made = [o.run for o in observations if o.run is not None]
    i = quietest(made)
    point = base_point(engine, observations[i], Scatter(), band)
    every = spots(engine, engine.site(("1", "2", "3", "4"), (("1", "2"), ("2", "3"), ("3", "4")), ()))
    return Bench(engine, point, tuple(made), Scatter(), ()).on(160), i, every


def test_the_spring_of_a_slider_is_told_from_the_base():
    bench, i, every = _bench(Element("jenkins", joint_23(), (3000.0, 20.0)), (2.0, 8.0, 25.0))
    plain = bench.joint([])
    found, _ = looked(plain, engine_start(plain), every)
    here = next(q for q in found if q.spot.place.id == "2" and q.spot.place.to == "3")
    made = beside_spring(bench.engine, quiet_data(bench.runs[i], bench.scatter), here, 2000.0, bench.scatter)
    assert made.point.terms[0] == pytest.approx(3000.0, rel=0.05)
    assert made.point.theta[0] == pytest.approx(1000.0, rel=0.05)
    best = stuck(bench, i, [here], 1, 10)[0]  # where the search of every law begins
    stiffness, limit = best.made.law(0)[0][:2]
    assert stiffness == pytest.approx(3000.0, rel=0.25)
    assert limit * (stiffness if best.mechanism == "hysteresis" else 1.0) == pytest.approx(20.0, rel=0.25)


def test_a_limit_far_above_the_force_that_distorts_is_found():
    """A slider that yields at the highest level only: what is recovered of its force is far below its limit."""
    bench, i, every = _bench(Element("jenkins", joint_23(), (900.0, 40.0)), (2.0, 8.0, 40.0))
    found, _ = looked(bench.joint([]), engine_start(bench.joint([])), every)
    here = next(q for q in found if q.spot.place.id == "2" and q.spot.place.to == "3")
    best = stuck(bench, i, [here], 1, 10)[0]
    stiffness, limit = best.made.law(0)[0][:2]
    assert stiffness == pytest.approx(900.0, rel=0.25)
    assert limit * (stiffness if best.mechanism == "hysteresis" else 1.0) == pytest.approx(40.0, rel=0.25)


def test_the_stiffness_of_a_place_is_that_of_its_link():
    bench, _, every = _bench(Element("cubic", joint_23(), (1e-3,)), (1.0,))
    here = next(s for s in every if s.place.id == "2" and s.place.to == "3")
    k = np.linalg.pinv(np.real(bench.engine.structure.matrices(bench.engine.theta0).K))
    exact = 1 / (here.column @ k @ here.column)
    assert own_stiffness(bench.engine, here.column) == pytest.approx(exact, rel=0.5)


def test_no_linear_model_explains_what_changes_with_level():
    bench, _, _ = _bench(Element("cubic", joint_23(), (3e4,)), (1.0, 3.0, 9.0))
    assert linear_least(bench.runs, bench.scatter) > 10.0
    quiet, _, _ = _bench(Element("cubic", joint_23(), (1e-3,)), (1.0, 3.0, 9.0))
    assert linear_least(quiet.runs, quiet.scatter) < 1.5
    assert linear_least([replace(r, open=True) for r in bench.runs], bench.scatter) == 0.0


def test_a_run_of_its_own_says_nothing_of_levels():
    none = np.zeros((3, PERIOD // 2 + 1))
    spectrum = multisine(1.0, 1)
    run = Run(RATE, PERIOD, spectrum, none.astype(np.complex128), none, spectrum != 0, 1.0, "run", OUTPUTS, FORCE, 1)
    assert linear_least([run], Scatter()) == 0.0


def test_nor_of_frfs_that_do():
    chi, relative = frf_least(_observed(Element("cubic", joint_23(), (3e4,)), (1.0, 3.0, 9.0)), Scatter())
    assert chi > 10.0
    assert relative > 0.01
    quiet = _observed(Element("cubic", joint_23(), (1e-3,)), (1.0, 3.0, 9.0))
    chi, least = frf_least(quiet, Scatter())
    assert chi < 1.5
    assert least < 0.2 * relative
    assert frf_least(quiet[:1], Scatter()) == (0.0, 0.0)


@pytest.mark.parametrize(
    ("law", "p", "other", "q"),
    [
        ("clearance", (4000.0, 0.005), "clearance", (4000.0, 0.005)),
        ("hysteresis", (3000.0, 0.005, 1.0, 0.6), "bouc-wen", (3000.0, 0.6 / 0.005, 0.4 / 0.005, 1.0)),
    ],
)
def test_finer_steps_bring_strong_corners_near_the_truth(law, p, other, q):
    """Against the bench's own march: by a half at least, which is what the last fit's steps are finer by."""
    structure, spectrum = chain(), multisine(25.0, 1)
    truth = lines_of(marched(spectrum, [Element(other, joint_23(), q)], structure))
    base, coarse, parameters = steady(structure, spectrum, law, p)
    r = base.at(base.start())
    wrong = []
    for fine in (_fine(coarse.run, [_acting(law, last)]) for last in (False, True)):
        solver = Steady(coarse.run, coarse.codes, fine)
        orbit = solver.settle(r, parameters, solver.guess(r, np.zeros((solver.n, 1))), 40, 1e-6)
        made = r.lift * (r.plain * spectrum + (r.h * orbit.force).sum(axis=1))
        wrong.append(np.linalg.norm((made - truth)[:, 7:150]) / np.linalg.norm(truth[:, 7:150]))
    assert wrong[1] < 0.5 * wrong[0]


def _acting(law, last):
    return Acting(law, joint_23(), np.ones(10), last)


def test_leads_of_what_is_no_noise_count_groups_of_lines():
    assert lead_over(20000.0, 20600.0, 20.0, False) == pytest.approx(30.0)
    assert lead_over(20000.0, 20600.0, 20.0, True) == pytest.approx(GROUPS * np.log(1.03))
    assert lead_over(20000.0, 60000.0, 20.0, True) > 40.0
    assert lead_over(20000.0, np.inf, 20.0, True) == np.inf


def test_what_yields_bit_by_bit_is_asked_for_under_both_its_names():
    """Hysteresis, of which sliders with spread limits explain nearly all."""
    bench, _, every = _bench(Element("bouc-wen", joint_23(), (800.0, 0.5 / 0.004, 0.5 / 0.004, 1.0)), (0.3, 1.0, 3.0))
    spot = next(s for s in every if s.place.id == "2" and s.place.to == "3")
    p = np.zeros(N_P)
    p[:3] = 800.0, 3.2, 0.8
    sliders = bench.law_alone(engine_start(bench.joint([])), Lead(spot, "sliders", p, 0.0), 10)
    study = Study(bench.engine, bench.point, bench.runs, sliders.made, sliders.made, (sliders,), None, ())
    best, *others = kindred(study, (), sliders, Scatter())
    assert best.mechanism == "hysteresis"
    assert best.made.law(0)[0][0] == pytest.approx(800.0, rel=0.1)
    assert best.cost < 0.1 * min(t.cost for t in others)


def test_a_slider_beside_another_law_yields_bit_by_bit_where_that_leaves_far_less():
    """Hysteresis beside a cubic spring, found as one slider; where that leaves no more than noise it stays one."""
    cubic = Element("cubic", np.eye(4)[3], (3e5,))
    loop = Element("bouc-wen", joint_23(), (800.0, 0.5 / 0.004, 0.5 / 0.004, 1.0))
    bench, _, every = bench_of(runs([cubic, loop], chain(), (0.5, 3.0)))
    joint = next(s for s in every if s.place.id == "2" and s.place.to == "3")
    ground = next(s for s in every if s.place.kind == "ground" and s.place.id == "4")
    p = np.zeros((2, N_P))
    p[0, 0], p[1, :2] = 3e5, (700.0, 2.5)
    leads = [Lead(ground, "cubic-stiffness", p[0], 0.0), Lead(joint, "stick-slip", p[1], 0.0)]
    x = engine_start(bench.joint([]))
    alone, both = bench.both(x, leads[:1], 10), bench.both(x, leads, 10)
    study = Study(bench.engine, bench.point, bench.runs, alone.made, alone.made, (alone,), None, ())
    little = replace(both.made, data_part=float(both.made.count))
    as_it_is = [alone, Tried(leads[1], little, both.cost)]
    assert softened(study, as_it_is, Scatter(), 20.0) == as_it_is
    made = softened(study, [alone, Tried(leads[1], both.made, both.cost)], Scatter(), 20.0)
    assert {t.mechanism for t in made} == {"cubic-stiffness", "hysteresis"}
    assert made[-1].cost / made[-1].made.count < 0.2 * both.cost / both.made.count
    (k, *_), k3 = (
        made[-1].made.law([t.mechanism for t in made].index(m))[0] for m in ("hysteresis", "cubic-stiffness")
    )
    assert k == pytest.approx(800.0, rel=0.1)
    assert k3[0] == pytest.approx(3e5, rel=0.1)


def test_few_sliders_are_counted_and_many_are_left_as_many():
    for elements, told in ((spread_sliders(800.0, 3.2, 0.6, 3), 3), (spread_sliders(800.0, 3.2, 0.8), None)):
        bench, _, every = bench_of(runs(elements, chain(), (1.0, 4.0, 12.0)))
        spot = next(s for s in every if s.place.id == "2" and s.place.to == "3")
        p = np.zeros(N_P)
        p[:3] = 800.0, 3.2, 0.7
        many = bench.direct((engine_start(bench.joint([])),), Lead(spot, "sliders", p, 0.0), 10, soften=False)
        fewer = numbered(bench, many, 6)
        assert (None if fewer is None else fewer.made.whole(0)[3]) == told
        if fewer is not None:
            done = bench.carry_on(fewer, 20)
            assert of_fit(done).p[3] == told  # in every later fit too
            assert done.made.law(0)[0] == pytest.approx([800.0, 3.2, 0.6], rel=0.03)


def test_a_whole_element_is_a_spring_along_the_turn_of_its_ends_alone():
    """Opposite moments at its ends bend it with EI/L; opposite forces need moments of others."""
    stiff, length = 7.0, 0.5
    shear, slope = np.array([-1.0, length / 2, 1.0, length / 2]), np.array([0.0, -1.0, 0.0, 1.0])
    columns = np.stack([np.sqrt(12 * stiff / length**3) * shear, np.sqrt(stiff / length) * slope], axis=1)
    law = Spring(("relative_change",), ("1",))
    group = Group(law, np.pad(columns, ((2, 1), (0, 0))), 0)
    term = Term(JointStiffness(), Place("element", "a", "b"), (), np.zeros((0, 1)), (group,), "element")
    turn = Spot(Place("joint", "a", "b"), "ry", np.pad(slope, (2, 1)))
    lift = Spot(Place("joint", "a", "b"), "z", np.pad([-1.0, 0.0, 1.0, 0.0], (2, 1)))
    other = Spot(Place("joint", "b", "c"), "ry", turn.column)
    ((spot, unit),) = springs_along(term, [lift, other, turn])
    assert spot is turn
    assert unit == pytest.approx(stiff / length)
    hinge = replace(term, groups=(replace(group, columns=np.pad(3.0 * slope, (2, 1))[:, None]),))
    assert springs_along(hinge, [lift, turn]) == [(turn, pytest.approx(9.0))]


def test_what_changes_the_whole_structure_is_no_spring_that_slips():
    """An axial preload has one parameter, and acts along no motion of a place."""
    whole = Term(
        JointStiffness(), Place("global", "structure"), (Parameter("tension", 1.0, 0.0, 2.0),), np.ones((1, 1))
    )
    calm = SimpleNamespace(runs=[SimpleNamespace(level=1.0)])
    bench = SimpleNamespace(on=lambda rung: calm)
    assert sticking(bench, np.zeros(3), [], [whole], np.array([1.5])) == []  # ty: ignore[invalid-argument-type]
