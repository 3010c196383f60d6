"""Laws that make nearly the same force, races that end early, and stretches of noise that are looked at in part."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from labnnum.diagnosis.nonlinear.explore import LAWS, engine_start, looked
from labnnum.diagnosis.nonlinear.fitting import fit
from labnnum.diagnosis.nonlinear.force import N_P
from labnnum.diagnosis.nonlinear.leads import named_like, unnamed_like
from labnnum.diagnosis.nonlinear.locate import Lead, Spot
from labnnum.diagnosis.nonlinear.orbit import Orbit
from labnnum.diagnosis.nonlinear.problem import Joint
from labnnum.diagnosis.nonlinear.run import hann_of, shortened
from labnnum.diagnosis.nonlinear.tempered import contest
from labnnum.diagnosis.observe import observe_all
from labnnum.mechanisms.base import Place
from labnnum.nonlinear import Element
from tests.diagnosis.test_nearby import bench_with, lead_at
from tests.diagnosis.test_nonlinear import joint_23
from tests.diagnosis.test_stuck import bench_of
from tests.diagnosis.test_tempered import LIMIT, recorded

SPOT = Spot(Place("ground", "3"), "x", np.array([0.0, 0.0, 1.0]))


def along_a_sine(law):
    t = 2 * np.pi * np.arange(400) / 400
    motion = np.stack([2e-3 * np.sin(t), 0.1 * np.cos(t)], axis=1)
    force = law(*motion.T)
    still = np.zeros((2, 0))
    return Orbit(still, force[-1:], still, still, -force[:, None], motion[:, None])


def lead_of(mechanism, spot=SPOT):
    return Lead(spot, mechanism, np.zeros(N_P), 1.0)


@pytest.mark.parametrize(
    ("law", "name", "values"),
    [
        (lambda z, v: 7e6 * z**3, "cubic-stiffness", [7e6]),
        (lambda z, v: 30.0 * v * abs(v), "quadratic-damping", [30.0]),
        (lambda z, v: 5e3 * (z - np.clip(z, -1e-3, 1e-3)), "clearance", [5e3, 1e-3]),
        (lambda z, v: 4e3 * np.maximum(z - 7e-4, 0.0), "one-sided-gap", [4e3, 7e-4]),
    ],
)
def test_the_law_that_makes_a_force_is_the_one_most_like_it(law, name, values):
    orbit = along_a_sine(law)
    best = named_like(lead_of("stick-slip"), orbit, LAWS)[0]
    assert best.mechanism == name
    assert best.p[: len(values)] == pytest.approx(values, rel=0.1)


def test_a_stop_on_the_other_side_is_told_by_its_axis():
    orbit = along_a_sine(lambda z, v: -4e3 * np.maximum(-z - 7e-4, 0.0))
    assert named_like(lead_of("clearance"), orbit, LAWS)[0].spot.axis == "-x"
    turned = replace(SPOT, axis="-x")
    assert named_like(lead_of("clearance", turned), orbit, LAWS)[0].spot.axis == "x"


def test_a_law_is_not_like_itself_nor_like_what_it_opposes():
    orbit = along_a_sine(lambda z, v: 5e3 * z**3)
    assert "cubic-stiffness" not in [q.mechanism for q in named_like(lead_of("cubic-stiffness"), orbit, LAWS)]
    assert [q.mechanism for q in named_like(lead_of("stick-slip"), replace(orbit, time=-orbit.time), LAWS)] == [
        "cubic-stiffness"
    ]
    assert named_like(lead_of("cubic-stiffness"), replace(orbit, time=0 * orbit.time), LAWS) == []


def test_a_law_without_a_name_is_like_one_that_has_one():
    orbit = along_a_sine(lambda z, v: 9e3 * z * abs(z))
    best = unnamed_like(lead_of("cubic-stiffness"), orbit)[0]
    assert (best.mechanism, best.p[0]) == ("general", pytest.approx(9e3))
    drag = along_a_sine(lambda z, v: 20.0 * v * abs(v))
    strict, loose = (unnamed_like(lead_of("quadratic-damping"), drag, least) for least in (0.9, 0.4))
    assert len(strict) < len(loose)


@pytest.fixture(scope="module")
def dry():
    return bench_with(Element("coulomb", joint_23(), (LIMIT,)))


def test_a_fit_that_stays_behind_its_rival_ends_early(dry, monkeypatch):
    bench, _, every = dry
    x = engine_start(bench.joint([]))
    made = []
    real = Joint.slopes
    monkeypatch.setattr(Joint, "slopes", lambda self, x, orbits: (made.append(1), real(self, x, orbits))[1])

    def steps(joint, begin):
        made.clear()
        one = fit(joint, begin, [None] * len(bench.runs), steps=12)
        return len(made), one.objective

    joint = bench.joint([lead_at(every, "ground 1", "cubic-stiffness", 1e3)])
    begin = joint.start(x)
    long, least = steps(joint, begin)
    joint.limit = 1e-6 * least / joint.values
    short, _ = steps(joint, begin)
    assert 2 <= short < long
    joint.limit = 2 * least / joint.values
    assert steps(joint, begin) == (long, least)  # one that comes below the limit goes its way


def noise(n=4000, rate=400.0):
    rng = np.random.default_rng(4)
    x = rng.standard_normal((4, n))
    x = np.apply_along_axis(lambda r: np.convolve(r, np.ones(5) / 5, "same"), 1, x)
    return np.fft.rfft(x, axis=1) * (2 / n), x, rate


def test_the_middle_of_a_stretch_is_a_run_of_its_own(dry):
    bench, _, _ = dry
    spectra, x, rate = noise()
    on = np.arange(spectra.shape[1]) < 600
    run = replace(
        bench.runs[0], rate=rate, period=4000, u=spectra[0], y=spectra[1:], noise=np.full(spectra[1:].shape, 4e-6),
        excited=on, open=True, use=None, telling=None,
    )  # fmt: skip
    part = shortened(run, 0.25)
    n = part.period
    assert 0.2 < n / 4000 <= 0.26
    first = (4000 - n) // 2
    middle = x[:, first : first + n]
    middle = middle - np.average(middle, axis=1, weights=np.hanning(n + 1)[:-1])[:, None]
    same = hann_of(np.fft.rfft(middle, axis=1) * (2 / n))
    assert np.allclose(part.seen(np.vstack([part.u, part.y])), same, atol=1e-12)
    top = np.flatnonzero(part.excited)[-1] * part.rate / n
    assert top == pytest.approx(600 * rate / 4000, abs=rate / n)
    assert part.noise[0, 5] == pytest.approx(4e-6 * 4000 / n)  # a mean over fewer samples is as much less sure
    assert shortened(bench.runs[0], 0.25) is bench.runs[0]  # a period is one
    assert shortened(run, 1.0) is run
    t = np.arange(4000) / rate
    sweep = np.fft.rfft(np.sin(2 * np.pi * (1.0 * t + 2.9 * t**2))) * (2 / 4000)  # from 1 to 59 Hz
    swept = replace(run, u=sweep)
    assert shortened(swept, 0.25) is swept


def test_a_strong_law_without_a_name_wins_the_contest():
    """A spring of force 2e5 z|z| that acts at every level, made of stops one behind the other."""
    step = 6e-4
    stops = [Element("clearance", joint_23(), (2 * 2e5 * step, (i + 0.5) * step)) for i in range(24)]
    bench, _, every = bench_of(observe_all([recorded(stops, level, 16) for level in (4.0, 16.0)]))
    plain = bench.joint([])
    nominal = engine_start(plain)
    found, leads = looked(plain, nominal, every)
    near = contest(bench, nominal, found, LAWS, leads, look=partial(looked, plain, spots=every)).near
    assert (near[0].mechanism, str(near[0].spot.place)) == ("general", "joint 2-3")
    assert near[0].made.whole(0)[0] == pytest.approx(2e5, rel=0.05)
    assert any(t.named for t in near)
