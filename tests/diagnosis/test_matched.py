"""What the search for a law keeps to: the band, the sensors of the fit, places that move, limits of what yields."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from labnnum.diagnosis import diagnose, observe_all
from labnnum.diagnosis.engine import Engine
from labnnum.diagnosis.nonlinear.alike import distinct
from labnnum.diagnosis.nonlinear.answer import parts_of
from labnnum.diagnosis.nonlinear.decision import strays
from labnnum.diagnosis.nonlinear.detect import signs
from labnnum.diagnosis.nonlinear.explore import engine_start
from labnnum.diagnosis.nonlinear.laws import SHAPES, force_along
from labnnum.diagnosis.nonlinear.locate import spots
from labnnum.diagnosis.nonlinear.matched import matched, within
from labnnum.diagnosis.nonlinear.overloaded import overloaded
from labnnum.diagnosis.nonlinear.problem import reduced
from labnnum.diagnosis.places import places_of
from labnnum.nonlinear import Element
from labnnum.recording import Channel
from labnnum.structures.frame import Frame, Member, Profile
from labnnum.structures.quantities import modal
from tests.diagnosis.test_nonlinear import FORCE, OUTPUTS, chain, joint_23, runs
from tests.diagnosis.test_overloaded import recorded
from tests.diagnosis.test_stuck import bench_of

CUBIC = Element("cubic", joint_23(), (2e4,))


@pytest.fixture(scope="module")
def hardening():
    return runs([CUBIC], chain())


def test_periodic_runs_are_compared_in_the_models_band(hardening):
    """And one that has no line there is left out."""
    engine = Engine(chain(), OUTPUTS, (FORCE,), (2 * np.pi, 2 * np.pi * 12))
    found = diagnose(chain(), hardening, span=(2.0, 8.0)).detail["nonlinear"]
    assert found.named
    for run in found.study.runs:
        o = SimpleNamespace(run=run)
        f = o.run.frequency[o.run.compared]
        assert 2.0 <= f.min() < 2.5
        assert 7.5 < f.max() <= 8.0
    above = [within(o, (30.0, 40.0)) for o in hardening]
    assert parts_of(engine, above, (), above, (30.0, 40.0)) is None


def test_levels_of_which_one_was_driven_less_far_show_their_change(hardening):
    """The loud run's upper lines were not played: what both hold is compared."""
    low, high = (o.run for o in (hardening[0], hardening[-1]))
    cut = high.excited & (np.arange(high.u.size) < 0.8 * np.flatnonzero(high.excited)[-1])
    n = np.flatnonzero(cut)[-1] + 1
    narrow = replace(
        high, period=high.period // 2, rate=high.rate / 2, u=high.u[:n], y=high.y[:, :n], noise=high.noise[:, :n],
        excited=cut[:n],
    )  # fmt: skip
    whole, less = (signs([replace(low, u=low.u), other]) for other in (high, narrow))
    assert np.isfinite(less.change).all()
    np.testing.assert_allclose(less.change, whole.change, rtol=0.4)


@pytest.mark.parametrize("power", [1.0, 1.5, 6.0])
@pytest.mark.parametrize("size", [3.0, 30.0, 300.0])
def test_what_yields_keeps_to_its_limit_along_any_motion(power, size):
    """Few samples to a swing that goes far beyond the limit."""
    z = size * np.sin(2 * np.pi * 5 * np.arange(200) / 200)
    force = force_along(SHAPES["hysteresis"], z, np.gradient(z), np.array([2.0, 1.0, power, 0.5, 0, 0, 0, 0]))
    assert np.isfinite(force).all()
    assert 1.8 < np.abs(force).max() < 2.2


def rod():
    """A clamped straight beam as a plane frame, driven and heard across."""
    nodes = {str(i): (0.1 * i, 0.0, 0.0) for i in range(7)}
    section = Profile(E=7e10, rho=2700.0, width=0.03, height=0.008)
    members = tuple(Member(str(i), str(i + 1), "p") for i in range(6))
    fixed = {"0": ("x", "y", "rz")}
    return Frame(nodes, {"p": section}, members, fixed=fixed, plane="xy", damping=modal(0.01))


def test_places_that_move_only_by_rounding_are_no_places():
    outputs = tuple(Channel(f"a{n}", "acceleration", "response", n, "y") for n in ("3", "6"))
    engine = Engine(rod(), outputs, (Channel("f", "force", "reference", "2", "y"),), (30.0, 3000.0))
    where = places_of(engine)
    every = spots(engine, engine.site(where.nodes, where.elements, where.supports))
    kept, _ = distinct(engine, every)
    assert {s.axis for s in kept} == {"y", "rz"}
    assert {s.place.id for s in kept if s.place.kind == "ground"} == set("123456")


def test_a_run_held_out_is_taken_with_the_sensors_of_the_fit(hardening):
    one = hardening[-1]
    (recording,) = one.recordings
    names = [c.name for c in recording.channels]
    more = Channel("a9", "acceleration", "response", "3", "x")
    other = replace(
        recording.select([names[0], *names[:0:-1]]),
        channels=(*recording.select([names[0], *names[:0:-1]]).channels, more),
        data=np.vstack([recording.select([names[0], *names[:0:-1]]).data, recording.data[-1:]]),
    )
    (seen,) = observe_all([other])
    same = matched(seen, one)
    assert same.frf.outputs == one.frf.outputs
    np.testing.assert_allclose(same.run.y, one.run.y, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(same.frf.value, one.frf.value, rtol=1e-6)
    assert [c.name for c in same.recordings[0].channels] == names
    assert matched(one, one) is one
    assert matched(observe_all([other.select([*names[:3], "a9"])])[0], one) is None
    found = diagnose(chain(), hardening[:-1], [seen])
    assert [n.term.mechanism.id for n in found.named] == ["cubic-stiffness"]
    assert found.extended_error[1] < 0.2 * found.base_error[1]


def test_an_offset_of_a_sensor_hides_no_rail():
    recordings, rail = recorded(0.15)
    off = [replace(r, data=r.data + np.array([[0], [0], [0], [0.03 * r.data[3].std()]])) for r in recordings]
    observations = observe_all(off)
    found = diagnose(chain(), observations).detail["nonlinear"]
    one = overloaded(found, observations)
    assert one is not None
    assert one.named.value[0] == pytest.approx(rail, rel=0.05)


def test_a_trial_step_is_worth_what_all_parts_say(hardening):
    bench, _, _ = bench_of(hardening)
    joint = bench.joint([])
    x, orbits = engine_start(joint), [None] * len(bench.runs)
    r, b = joint.parts(x, orbits)
    _, gram, _ = reduced(r, b)
    exact = reduced(r, b)[0] + joint.price(x)
    np.testing.assert_array_equal(joint.left(x, orbits), r)
    assert joint.value(x, orbits, b) == exact
    assert joint.value(x, orbits, b, gram) == exact


@pytest.mark.parametrize("noise", [np.nan, 0.0])
def test_noise_that_nobody_knows_excuses_no_other_steady_state(noise):
    found = SimpleNamespace(misfit=1.0, shown=0.01, extended_error=(0.01, 0.5), noise=noise)
    assert strays(found)
