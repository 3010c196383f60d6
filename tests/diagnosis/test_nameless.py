"""What has no name is not given one: laws outside the catalogue, change by chance, distortion beside drift, scales."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from labnnum.diagnosis import diagnose
from labnnum.diagnosis.gates import bent_channel, beyond, drifted
from labnnum.diagnosis.nonlinear.decision import NAMELESS, _foretells
from labnnum.diagnosis.nonlinear.force import N_P
from labnnum.diagnosis.nonlinear.further import acts
from labnnum.diagnosis.nonlinear.laws import SHAPES, TERMS, force_along
from labnnum.diagnosis.nonlinear.moved import moved
from labnnum.diagnosis.nonlinear.prescribed import along
from labnnum.diagnosis.nonlinear.run import Run
from labnnum.diagnosis.nonlinear.scales import common, powers, scale_std
from labnnum.diagnosis.observe import Observation
from labnnum.diagnosis.race import no_peak
from labnnum.diagnosis.scatter import Scatter
from labnnum.diagnosis.verdict import Limits
from labnnum.frf import Frf
from labnnum.nonlinear import Element
from tests.diagnosis.test_nonlinear import FORCE, OUTPUTS, chain, joint_23, runs


def test_a_law_outside_the_catalogue_is_located_and_not_named():
    """A spring of force 5000 z|z|, made of stops one behind the other."""
    step = 0.004
    stops = [Element("clearance", joint_23(), (2 * 5000.0 * step, (i + 0.5) * step)) for i in range(40)]
    structure = chain()
    found = diagnose(structure, runs(stops, structure, levels=(2.0, 9.0), fine=16))
    assert found.verdict == "unexplained", found.summary
    assert str(found.place) == "joint 2-3"
    assert found.detail["reason"] == NAMELESS
    assert not found.named


def _resonance(frequency, f0, zeta, seed, noise):
    rng = np.random.default_rng(seed)
    shapes = np.array([[1.0, 0.4], [-0.7, 0.9], [0.5, -1.2]])
    h = shapes @ np.array([1 / (f**2 - frequency**2 + 2j * zeta * f * frequency) for f in (f0, 2.3 * f0)])
    return h + noise * (rng.standard_normal(h.shape) + 1j * rng.standard_normal(h.shape))


def test_chance_moves_peaks_as_seldom_as_it_says():
    frequency = np.linspace(5.0, 30.0, 400)
    p = []
    for seed in range(150):
        a, b = (_resonance(frequency, 10.0, 0.02, 2 * seed + i, 2e-3) for i in range(2))
        p.append(moved(frequency, a, b, np.full(a.shape, 3 * 2e-3**2)))  # variances that are too small by 4/3
    p = np.array(p)
    assert 0.02 < np.mean(p < 0.05) < 0.09
    assert np.mean(np.sort(p, axis=1)[:, 1] < 2 * 0.01 / 3) < 0.03


def test_a_peak_that_moves_by_a_thousandth_is_seen():
    frequency = np.linspace(5.0, 30.0, 400)
    a, b = _resonance(frequency, 10.0, 0.02, 1, 2e-3), _resonance(frequency, 10.01, 0.02, 2, 2e-3)
    size = np.mean(np.abs(a - b) ** 2) / (4 * 2e-3**2)
    assert size < 1.8  # the mean power of the change alone would not tell
    assert (moved(frequency, a, b, np.full(a.shape, 4 * 2e-3**2)) < 1e-3).sum() >= 2


def _drifting(distortion_db):
    frequency = np.linspace(1.0, 12.0, 60)
    h = np.ones((3, 1, 60), complex)
    frf = Frf(frequency, h, OUTPUTS, (FORCE,), None, np.full(h.shape, 1e-10), 8.0, "periodic", {})
    slope = Frf(frequency, 0.01 * h, OUTPUTS, (FORCE,))
    distortion = {"odd": np.full(3, distortion_db), "odd_over_noise": np.full(3, 30.0)}
    return Observation(frf, 1.0, "run", "periodic", distortion, 5.0, slope)


def test_what_distorts_more_than_a_drift_can_is_no_drift():
    """A change of 2 % over 8 periods leaves 20 log10(0.02 / 8 / sqrt(12)) = -63 dB on other lines at most."""
    assert drifted([_drifting(-70.0)])[0] is not None
    assert drifted([_drifting(-30.0)])[0] is None


def test_common_scales_follow_from_units():
    """k3 goes with (1 + e)^-2 (1 + m)^3, a force with 1 + e; e and m as sensors leave them, by Bayes' rule."""
    assert [powers(u) for u in ("N/m^3", "N*s^2/m^2", "m", "1")] == [(1, -3), (1, -2), (0, 1), (0, 0)]
    covariance = common(Scatter(gain=0.01, residue=0.02), 4)
    inverse = np.diag([1 / 0.01**2, 1 / 0.02**2]) + np.outer([1, -1], [1, -1]) * 4 / 0.01**2
    assert covariance == pytest.approx(np.linalg.inv(inverse))
    std = scale_std(("N/m^3", "N"), np.array([3.0, 2.0]), Scatter(gain=0.01, residue=0.02), 4)
    d = np.array([-2.0, 3.0])
    assert std[0] == pytest.approx(3.0 * np.sqrt(d @ covariance @ d))
    assert std[1] == pytest.approx(2.0 * np.sqrt(covariance[0, 0]))


@pytest.mark.parametrize("name", ["cubic-stiffness", "quadratic-stiffness", "one-sided-gap", "clearance",
                                  "quadratic-damping", "general"])  # fmt: skip
def test_laws_without_memory_are_the_marched_ones(name):
    rng = np.random.default_rng(0)
    z, v = rng.standard_normal((2, 50))
    p = np.zeros(N_P)
    p[:2] = 2.0, 0.5
    if name == "general":
        p = rng.standard_normal(N_P)
    assert len(TERMS) == N_P
    shape = SHAPES[name]
    assert force_along(shape, z, v, p) == pytest.approx(along(shape.code, z, v, p, 1))


def _with_mode(frequency, ratio):
    mode = SimpleNamespace(data={"extra_mode": True}, n=4, parameters=(None, SimpleNamespace(lower=1e-4, upper=0.1)))
    point = SimpleNamespace(theta=np.zeros(1), shift=np.zeros(2), terms=np.array([frequency, ratio, 0.1, 0.2]))
    made = SimpleNamespace(point=point, terms=(), n_theta=1)
    state = SimpleNamespace(omega=2 * np.pi * np.array([20.0, 50.0]))
    engine = SimpleNamespace(band_modes=np.arange(2), state=lambda theta, changes: state)
    task = SimpleNamespace(engine=engine, data=SimpleNamespace(s=2j * np.pi * np.linspace(5.0, 100.0, 50)))
    return no_peak(task, SimpleNamespace(last=mode, fit=made))


@pytest.mark.parametrize(
    ("frequency", "ratio", "none"),
    [
        (30.0, 0.01, False),
        (4.0, 0.01, True),  # below the lines: a flank
        (130.0, 0.01, True),  # above them
        (30.0, 1e-4, True),  # a single line
        (30.0, 0.1, True),  # no peak
        (50.2, 0.01, True),  # one that the structure has
    ],
)
def test_an_added_mode_is_a_peak_that_is_seen(frequency, ratio, none):
    assert _with_mode(frequency, ratio) is none


@pytest.mark.parametrize(
    ("base", "law", "believed"), [(2400.0, 800.0, True), (1100.0, 800.0, False), (2400.0, 1500.0, False)]
)
def test_a_law_counts_that_foretells_distortion_alone(base, law, believed):
    assert _foretells(((base, 1000), (law, 1000)), Limits()) is believed


def _read(level, rows, peak, kind="hammer"):
    frequency = np.linspace(1.0, 12.0, 60)
    value = np.ones((3, 1, 60), complex) * np.asarray(rows, float)[:, None, None]
    frf = Frf(frequency, value, OUTPUTS[:3], (FORCE,), None, np.full((3, 1, 60), 1e-8), 5.0)
    return Observation(frf, level, "run", kind, peaks={OUTPUTS[1].name: peak})


@pytest.mark.parametrize(
    ("rows", "kind", "found"),
    [
        ((1.0, 0.9, 1.0), "hammer", True),
        ((0.95, 0.9, 1.02), "hammer", False),  # the structure changes with level
        ((1.0, 0.99, 1.0), "hammer", False),  # too little
        ((1.0, 0.9, 1.0), "periodic", False),
    ],
)
def test_a_channel_that_alone_reads_less_at_the_higher_level_clips(rows, kind, found):
    runs = [_read(1.0, (1, 1, 1), 1.0, kind), _read(3.0, rows, 2.0, kind)]
    assert bent_channel(runs) == ["", OUTPUTS[1].name if found else ""]


def test_frfs_from_which_a_law_was_taken_make_no_channel_clip():
    """They hold no readings any more, and what the law has wrong at one sensor is left in its row."""
    runs = [replace(_read(level, rows, 1.0), peaks={}) for level, rows in ((1.0, (1, 1, 1)), (3.0, (1, 0.9, 1)))]
    assert bent_channel(runs) == ["", ""]


@pytest.mark.parametrize(("peak", "held"), [(2.4, True), (3.0, False)])
def test_hits_on_a_rail_are_held_back(peak, held):
    """Of a channel whose peaks grow as all others' do only a structure can say less in proportion."""
    name = OUTPUTS[1].name
    others = {OUTPUTS[0].name: 1.0, OUTPUTS[2].name: 2.0, "f": 5.0}
    low = replace(_read(1.0, (1, 1, 1), 1.0), peaks={**others, name: 1.0})
    high = replace(_read(3.0, (1, 0.9, 1), 1.0), peaks={**{k: 3 * v for k, v in others.items()}, name: peak})
    assert bool(bent_channel([low, high])[1]) is held
    assert bool(beyond(["", name], [low, high])[1]) is held


@pytest.mark.parametrize(("peak", "held"), [(2.4, True), (3.0, True), (4.0, False)])
def test_noise_on_a_rail_grows_no_more_than_the_others(peak, held):
    """A law next to a sensor may change that channel's FRF alone, and make it read more than in proportion."""
    name = OUTPUTS[1].name
    others = {OUTPUTS[0].name: 1.0, OUTPUTS[2].name: 2.0, "f": 5.0}
    low = replace(_read(1.0, (1, 1, 1), 1.0, "random"), peaks={**others, name: 1.0})
    high = replace(_read(3.0, (1, 1.1, 1), 1.0, "random"), peaks={**{k: 3 * v for k, v in others.items()}, name: peak})
    assert bool(bent_channel([low, high])[1]) is held


@pytest.mark.parametrize(("peak", "same", "held"), [(2.9, True, True), (3.0, True, False), (3.0, False, True)])
def test_a_period_on_a_rail_grows_less_than_the_others(peak, same, held):
    """Of one input, larger by three; of another one peaks say nothing."""
    name, rng = OUTPUTS[1].name, np.random.default_rng(4)
    others = {OUTPUTS[0].name: 1.0, OUTPUTS[2].name: 2.0, "f": 5.0}
    a, b = (np.exp(2j * np.pi * rng.random(40)) for _ in range(2))
    none = np.zeros((3, 40))
    kept = (OUTPUTS[:3], FORCE, 1)
    runs = [Run(40.0, 78, u, none + 0j, none, u != 0, 1.0, "run", *kept) for u in (a, 3 * a if same else b)]
    low = replace(_read(1.0, (1, 1, 1), 1.0, "periodic"), peaks={**others, name: 1.0}, run=runs[0])
    high = replace(
        _read(3.0, (1, 1, 1), 1.0, "periodic"), peaks={**{k: 3 * v for k, v in others.items()}, name: peak}, run=runs[1]
    )
    assert bool(beyond(["", name], [low, high])[1]) is held


def test_a_rail_is_where_all_loud_runs_end():
    name = OUTPUTS[1].name
    runs = [_read(level, (1, 1, 1), peak) for level, peak in ((1, 1.0), (3, 2.5), (9, 2.5), (9, 2.5))]
    assert beyond(["", name, name, name], runs) == ["", name, name, name]
    louder = [*runs, _read(9, (1, 1, 1), 4.0)]
    assert not any(beyond(["", name, name, name, ""], louder))
    apart = [*runs[:3], _read(9, (1, 1, 1), 2.6)]
    assert not any(beyond(["", "", name, name], apart))


def test_a_general_law_acts_by_any_of_its_terms_and_a_named_one_by_its_first():
    """A law of z^3 alone begins with zeros; a clearance of no stiffness does nothing, whatever its gap."""
    terms = [SimpleNamespace(mechanism=m) for m in ("general", "general", "clearance", "clearance")]
    p = [np.array([0.0, 0.0, 3.0]), np.zeros(3), np.array([0.0, 0.1]), np.array([5.0, 0.0])]
    made = SimpleNamespace(terms=terms, law=lambda i: (p[i], None))
    assert [acts(made, i) for i in range(4)] == [True, False, False, True]
