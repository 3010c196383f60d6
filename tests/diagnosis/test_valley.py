"""Fits of a law go on where it and the base trade with each other, and end where nothing is to be had."""

from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from labnnum.diagnosis.engine import Engine
from labnnum.diagnosis.nonlinear import valley
from labnnum.diagnosis.nonlinear.bench import Study, tried_fit
from labnnum.diagnosis.nonlinear.decision import MECHANISMS
from labnnum.diagnosis.nonlinear.fitting import promised
from labnnum.diagnosis.nonlinear.force import N_P
from labnnum.diagnosis.nonlinear.laws import NAMES, SHAPES
from labnnum.diagnosis.nonlinear.linearise import linearised
from labnnum.diagnosis.nonlinear.locate import Lead, recover
from labnnum.diagnosis.nonlinear.orbit import scaled
from labnnum.diagnosis.nonlinear.receptance import Base, per_place
from labnnum.diagnosis.nonlinear.scales import powers
from labnnum.diagnosis.nonlinear.shown import curves
from labnnum.diagnosis.nonlinear.study import FINE
from labnnum.diagnosis.nonlinear.valley import PROMISE, deepened
from labnnum.diagnosis.observe import observe_all
from labnnum.nonlinear import Element
from tests.diagnosis.test_nonlinear import FORCE, OUTPUTS, chain, joint_23
from tests.diagnosis.test_stuck import bench_of
from tests.diagnosis.test_tempered import recorded

STRENGTH = 3e4


@pytest.fixture(scope="module")
def cubic():
    """Bench, objective and fit of a cubic spring, begun at the truth."""
    element = Element("cubic", joint_23(), (STRENGTH,))
    bench, _, every = bench_of(observe_all([recorded([element], level) for level in (2.0, 8.0, 25.0)]))
    spot = next(s for s in every if {s.place.id, s.place.to} == {"2", "3"})
    p = np.zeros(N_P)
    p[0] = STRENGTH
    lead, bench = Lead(spot, "cubic-stiffness", p, 0.0), bench.on(FINE)
    joint = bench.joint_of([replace(lead.acting(), last=True)])
    made = tried_fit(joint, joint.start(), [None] * len(bench.runs), lead, 25)
    assert made is not None
    assert made.made.law(0)[0][0] == pytest.approx(STRENGTH, rel=0.02)
    return bench, joint, made


def study_of(bench, **more):
    return cast(Study, SimpleNamespace(engine=bench.engine, point=bench.point, runs=bench.runs, **more))


def test_at_the_bottom_nothing_is_promised(cubic):
    bench, joint, one = cubic
    value, promise, _ = promised(joint, one.made)
    assert value == pytest.approx(one.made.objective, rel=1e-3)
    assert promise < PROMISE * one.made.data_part / one.made.count
    assert deepened(study_of(bench), one, bench.scatter) is one


@pytest.mark.parametrize(("gains", "taken"), [((50.0, 40.0, 0.0), 2), ((50.0, 4.0, 50.0), 2), ((4.0, 50.0), 1)])
def test_what_is_promised_at_the_bottom_is_roughness(cubic, monkeypatch, gains, taken):
    """A round that gains less than is asked of a promise is the last; one that finds nothing gives nothing."""
    bench, _, one = cubic
    made = [one]
    for gain in gains:
        last = made[-1]
        made.append(replace(last, made=replace(last.made, objective=last.made.objective - gain)))
    left = iter([t if gain else None for t, gain in zip(made[1:], gains, strict=True)])
    monkeypatch.setattr(valley, "_stepped", lambda bench, one: next(left))
    assert deepened(study_of(bench), one, bench.scatter) is made[taken]


def motions_of(joint, factor):
    """Motions at the place, `factor` times the model's, as entries of the vector."""
    e, base = joint.engine, next(iter(joint.bases.values()))
    plain = base.columns[:, 0] @ e.state(e.theta0).shape[:, e.band_modes] / base.w_typical[0]
    return (factor - 1.0) * np.append(plain, 1.0)


def test_a_law_whose_scale_the_motions_hold_is_given_it_back(cubic):
    bench, joint, one = cubic
    m, x = joint.engine.band_modes.size, one.made.x.copy()
    x[joint.n_base - m - 1 : joint.n_base] += motions_of(joint, 1.3)
    x[joint.n_base] /= 1.3**4
    straight = tried_fit(joint, x, [None] * len(bench.runs), one.lead, 2)
    assert straight is not None
    assert straight.made.objective < one.made.objective + 3.0
    assert straight.made.law(0)[0] == pytest.approx(one.made.law(0)[0], rel=0.02)


def test_powers_of_a_law_s_parameters_are_those_of_their_units():
    """N^a m^b grows by b - a where motions grow and forces fall."""
    for law, shape in SHAPES.items():
        if law != "general":
            units = MECHANISMS[NAMES.get(law, law)].units
            dimensions = [powers(u) for u in units[: len(shape.names)]]
            assert shape.grows == tuple(motion - force for force, motion in dimensions)


@pytest.mark.parametrize("top", [3.0, 12.0])
def test_derivatives_to_all_that_a_fit_moves_at_a_place(top: float):
    """Against central differences, with modes above the band that move more at two places than they should."""
    engine = Engine(chain(), OUTPUTS, (FORCE,), (2 * np.pi * 0.5, 2 * np.pi * top))
    omega = 2 * np.pi * np.linspace(0.1, 20.0, 40)
    base = Base(engine, engine.start(), np.array([joint_23(), np.eye(4)[1]]).T, omega)
    x, m = base.start(), per_place(engine)
    x[-m - 1], x[-1], x[-2] = 0.1, -0.2, 0.05
    assert base.above.size + engine.high.shape[1] == (0 if top > 10 else 4 - engine.band_modes.size)
    exact = base.derivatives(x, base.at(x))
    for i in range(x.size - 2 * m, x.size):
        step = 1e-6 * np.eye(x.size)[i] * max(abs(x[i]), 1.0)
        up, down = base.at(x + step), base.at(x - step)
        for a, b, slope in zip((up.plain, up.h, up.z, up.g), (down.plain, down.h, down.z, down.g), exact, strict=True):
            finite = (a - b) / (2 * step[i])
            size = np.linalg.norm(finite) + 1e-6 * np.linalg.norm(a) / max(abs(x[i]), 1.0)
            assert np.linalg.norm(slope[i] - finite) < 1e-4 * size


@pytest.mark.parametrize(
    ("law", "p"),
    [
        ("cubic-stiffness", [STRENGTH]), ("quadratic-stiffness", [100.0]), ("one-sided-gap", [300.0, 0.002]),
        ("clearance", [300.0, 0.002]), ("coulomb-friction", [1.0]), ("quadratic-damping", [50.0]),
        ("stick-slip", [300.0, 2.0]), ("hysteresis", [300.0, 0.02, 1.2, 0.6]), ("sliders", [300.0, 2.0, 0.5]),
        ("general", [100.0, 50.0, 1e3, 10.0, 5.0, 2.0, 3.0, 2.0, 1.0, 1.0]),
    ],
)  # fmt: skip
def test_a_place_that_moves_more_against_less_force_does_the_same(cubic, law, p):
    """To rounding, whatever the law: an evened vector leaves the responses as they were, and costs less."""
    bench, _, one = cubic
    lead = Lead(one.spot, law, np.append(p, np.zeros(N_P - len(p))), 0.0)
    joint = bench.joint([lead])
    m, x = joint.engine.band_modes.size, joint.start()
    x[joint.n_base - m - 1 : joint.n_base] = motions_of(joint, 1.2)
    x[joint.n_base - 2] += 0.01
    even, factor = joint.evened(x)
    assert factor[0] == pytest.approx(1 / 1.2, rel=0.02)
    assert joint.price(even) < 0.1 * joint.price(x)
    assert joint.evened(even)[1] == pytest.approx(1.0, abs=1e-9)
    orbits = joint.settle(x, [None] * len(bench.runs), 6)
    before, after = joint.predict(x, orbits), joint.predict(even, [scaled(o, factor) for o in orbits])
    for a, b in zip(before, after, strict=True):
        assert np.linalg.norm(a - b) < 1e-9 * np.linalg.norm(a)
    settled = joint.settle(x, orbits, 1), joint.settle(even, [scaled(o, factor) for o in orbits], 1)
    for o, s in zip(*settled, strict=True):
        assert o is not None
        assert s is not None
        assert np.linalg.norm(o.force) > 0
        assert np.linalg.norm(o.force - s.force * factor[0]) < 1e-6 * np.linalg.norm(o.force)


def test_what_a_law_adds_to_an_frf_is_taken_off_as_its_sensor_reads_it():
    """A gain 2 % too large reads the law's share too large as well: without that share all levels show one FRF."""
    element = Element("cubic", joint_23(), (STRENGTH,))
    gain = np.array([1.0, 1.0, 1.02, 1.0])[:, None]
    made = [recorded([element], level) for level in (2.0, 8.0, 25.0)]
    observations = observe_all([replace(r, data=gain * r.data) for r in made])
    bench, _, every = bench_of(observations)
    spot = next(s for s in every if {s.place.id, s.place.to} == {"2", "3"})
    bench = bench.on(FINE)
    lead = Lead(spot, "cubic-stiffness", np.append(STRENGTH, np.zeros(N_P - 1)), 0.0)
    joint = bench.joint_of([replace(lead.acting(), last=True)])
    fitted = tried_fit(joint, joint.start(), [None] * len(bench.runs), lead, 12)
    assert fitted is not None
    last = fitted.made
    linear = linearised(study_of(bench), last, last.orbits, observations, bench.scatter)
    low, high = (linear[i].frf.value[1, 0] for i in (0, 2))
    before = [observations[i].frf.value[1, 0] for i in (0, 2)]
    changed = np.linalg.norm(before[1] - before[0])
    assert changed > 0.25 * np.linalg.norm(before[0])
    assert np.linalg.norm(high - low) < 0.004 * changed  # 2 % with the gain forgotten


def test_the_force_is_drawn_as_the_last_base_shows_it(cubic):
    """Through a base 1 % too stiff, as one that was fitted without the law may be, it is another force."""
    bench, _, one = cubic
    x, n = one.made.x[: one.made.bare].copy(), bench.engine.theta0.size
    x[n : n + bench.engine.band_modes.size] += 0.01
    seen = recover(bench.joint([]), x, bench.point, one.spot)
    study = study_of(bench, recovered=(seen,))
    wrong, right = curves(study, one)[-1], curves(study, one, one.made, bench.scatter)[-1]
    off, near = (np.linalg.norm(c.force - c.law) / np.linalg.norm(c.law) for c in (wrong, right))
    assert near < 0.3
    assert near < 0.5 * off


def test_the_force_of_an_even_law_is_drawn_with_the_mean_that_accelerometers_do_not_show():
    """A quadratic spring pushes one way on the average: recovered from accelerations alone its force has no mean."""
    bench, _, every = bench_of(observe_all([recorded([Element("quadratic", joint_23(), (5e2,))], 25.0)]))
    spot = next(s for s in every if {s.place.id, s.place.to} == {"2", "3"})
    bench = bench.on(FINE)
    lead = Lead(spot, "quadratic-stiffness", np.append(5e2, np.zeros(N_P - 1)), 0.0)
    joint = bench.joint_of([replace(lead.acting(), last=True)])
    one = tried_fit(joint, joint.start(), [None], lead, 12)
    assert one is not None
    seen = recover(bench.joint([]), one.made.x[: one.made.bare], bench.point, spot)
    assert abs(np.mean(seen.f[0])) < 1e-6 * np.ptp(seen.f[0])
    drawn = curves(study_of(bench, recovered=(seen,)), one, one.made, bench.scatter)[-1]
    assert np.mean(drawn.z) == pytest.approx(np.mean(one.made.orbits[0].motion[:, 0, 0]), rel=0.05)
    assert np.mean(drawn.law) > 0.2 * np.std(drawn.law)
    assert np.mean(drawn.force) == pytest.approx(np.mean(drawn.law), rel=0.02)
    assert np.corrcoef(drawn.force, drawn.law)[0, 1] > 0.8
