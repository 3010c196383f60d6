"""Fits of a law go on where it and the base trade with each other, and end where nothing is to be had."""

from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from labnnum.diagnosis.engine import Engine
from labnnum.diagnosis.nonlinear.bench import Study, tried_fit
from labnnum.diagnosis.nonlinear.fitting import promised
from labnnum.diagnosis.nonlinear.locate import Lead
from labnnum.diagnosis.nonlinear.march import N_P
from labnnum.diagnosis.nonlinear.receptance import Base, per_place
from labnnum.diagnosis.nonlinear.study import FINE
from labnnum.diagnosis.nonlinear.valley import PROMISE, _units, deepened
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
    bench, _, every = bench_of(observe_all([recorded(element, level) for level in (2.0, 8.0, 25.0)]))
    spot = next(s for s in every if {s.place.id, s.place.to} == {"2", "3"})
    p = np.zeros(N_P)
    p[0] = STRENGTH
    lead, bench = Lead(spot, "cubic-stiffness", p, 0.0), bench.on(FINE)
    joint = bench.joint_of([replace(lead.acting(), last=True)])
    made = tried_fit(joint, joint.start(), [None] * len(bench.runs), lead, 25)
    assert made is not None
    assert made.made.law(0)[0][0] == pytest.approx(STRENGTH, rel=0.02)
    return bench, joint, made


def study_of(bench):
    return cast(Study, SimpleNamespace(engine=bench.engine, point=bench.point, runs=bench.runs))


def test_at_the_bottom_nothing_is_promised(cubic):
    bench, joint, one = cubic
    value, promise, _ = promised(joint, one.made)
    assert value == pytest.approx(one.made.objective, rel=1e-3)
    assert promise < PROMISE * one.made.data_part / one.made.count
    assert deepened(study_of(bench), one, bench.scatter) is one


def test_a_law_whose_scale_the_motions_hold_is_given_it_back(cubic):
    bench, joint, one = cubic
    m, x = joint.engine.band_modes.size, one.made.x.copy()
    motions = slice(joint.n_base - m - 1, joint.n_base)
    x[motions] = 1.12 * (1.0 + x[motions]) - 1.0
    x[joint.n_base] /= 1.12**4
    bent = replace(one, made=replace(one.made, x=x))
    straight = deepened(study_of(bench), bent, bench.scatter)
    assert straight.made.objective < one.made.objective + 3.0
    assert straight.made.law(0)[0] == pytest.approx(one.made.law(0)[0], rel=0.02)


def test_units_of_rotations_are_left_alone():
    assert _units("sliders")[:2] == ("N/m", "N")
    assert _units("hysteresis")[:2] == ("N/m", "m")
    assert _units("general") == ()


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
