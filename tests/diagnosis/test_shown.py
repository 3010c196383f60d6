"""The page draws the force of every named law at its own place."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from labnnum.diagnosis.nonlinear.bench import Tried
from labnnum.diagnosis.nonlinear.fitting import Made
from labnnum.diagnosis.nonlinear.force import N_P
from labnnum.diagnosis.nonlinear.locate import Lead, motions_of, recover
from labnnum.diagnosis.nonlinear.orbit import Orbit
from labnnum.diagnosis.nonlinear.receptance import Base, per_place
from labnnum.diagnosis.nonlinear.shown import curves, of_each
from labnnum.diagnosis.observe import observe_all
from labnnum.nonlinear import Element
from sessions.report.nonlinear import nonlinear_section
from tests.diagnosis.test_nonlinear import joint_23
from tests.diagnosis.test_stuck import bench_of
from tests.diagnosis.test_tempered import recorded

CUBIC, DRAG = 2e4, 10.0


def orbits_of(bench, leads):
    """What a fit at the truth would have marched to: the forces at both places as the runs show them together."""
    out = []
    for run in bench.runs:
        columns = np.array([lead.spot.column for lead in leads]).T
        base = Base(bench.engine, bench.point, columns, 2 * np.pi * run.frequency, run.decay)
        made = motions_of(run, base.at(base.start()))
        force = np.fft.rfft(made[:, :, 2], axis=0).T[:, : run.u.size] * (2 / made.shape[0])
        none = np.zeros(0)
        out.append(Orbit(none, none, none, force, made[:, :, 2], made[:, :, :2]))
    return tuple(out)


@pytest.fixture(scope="module")
def answer():
    """What a search hands over that named a cubic spring between two masses and drag on another."""
    elements = [Element("cubic", joint_23(), (CUBIC,)), Element("quadratic-damping", np.eye(4)[0], (DRAG,))]
    bench, _, every = bench_of(observe_all([recorded(elements, level) for level in (8.0, 25.0)]))
    bench = replace(bench, point=bench.engine.start())  # the true base, not one that was fitted to the quieter run
    leads = [
        Lead(next(s for s in every if str(s.place) == place), name, np.append(p, np.zeros(N_P - 1)), 0.0)
        for place, name, p in (("joint 2-3", "cubic-stiffness", CUBIC), ("ground 1", "quadratic-damping", DRAG))
    ]
    joint = bench.joint_of([lead.acting() for lead in leads])
    bare = joint.n_base - 2 * per_place(bench.engine)
    orbits, terms = orbits_of(bench, leads), tuple(lead.acting() for lead in leads)
    made = Made(joint.start(), 1.0, 1.0, 0.0, np.zeros((0, 0)), orbits, terms, joint.n_base, bare, 1, True)
    laws = tuple(Tried(lead, made, 1.0) for lead in leads)
    seen = recover(bench.joint([]), made.x[:bare], bench.point, leads[0].spot)
    study = SimpleNamespace(
        engine=bench.engine, point=bench.point, runs=bench.runs, recovered=(seen,), tried=laws[:1], base=made
    )
    named = tuple(
        SimpleNamespace(place=t.spot.place, term=SimpleNamespace(mechanism=SimpleNamespace(id=t.name))) for t in laws
    )
    first = curves(study, laws[0], made, bench.scatter)
    return SimpleNamespace(study=study, laws=laws, named=named, curves=first, scatter=bench.scatter, misfit=1.0)


def test_each_law_is_recovered_at_its_own_place(answer):
    drawn = of_each(answer)
    assert [(d.name, str(d.spot.place)) for d in drawn] == [
        ("cubic-stiffness", "joint 2-3"), ("quadratic-damping", "ground 1"),
    ]  # fmt: skip
    cubic, drag = (max(d.curves, key=lambda c: c.level) for d in drawn)
    np.testing.assert_allclose(cubic.law, CUBIC * cubic.z**3, atol=1e-9 * np.abs(cubic.law).max())
    np.testing.assert_allclose(drag.law, DRAG * drag.v * np.abs(drag.v), atol=1e-9 * np.abs(drag.law).max())
    assert np.corrcoef(drag.force, drag.law)[0, 1] > 0.95


def test_the_other_laws_force_is_known(answer):
    """Without that the force at one place has to stand for both."""
    cubic = answer.curves[-1]
    alone = curves(answer.study, answer.laws[0])[-1]
    assert np.linalg.norm(cubic.force - cubic.law) < 0.5 * np.linalg.norm(alone.force - alone.law)


def test_a_law_that_has_no_name_is_not_drawn_at_a_further_place(answer):
    answer = SimpleNamespace(**{**vars(answer), "named": answer.named[:1]})
    assert [d.name for d in of_each(answer)] == ["cubic-stiffness"]


def test_the_page_holds_a_figure_for_each(answer):
    d = SimpleNamespace(detail={"nonlinear": answer}, nonlinear={"odd_distortion_db": -25.0})
    page = str(nonlinear_section(d).body)
    assert page.count("<svg") == 2
    assert "cubic-stiffness at joint 2-3" in page
    assert "quadratic-damping at ground 1" in page
    assert "-25.0 dB relative to the excited lines" in page
