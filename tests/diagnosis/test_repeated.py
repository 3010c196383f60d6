"""One signal at two levels: a linear structure answers it in proportion, whatever leaks."""

import numpy as np
import pytest

from labnnum.diagnosis.nonlinear.bounds import linear_least, one_signal
from labnnum.diagnosis.nonlinear.lines import choose_lines
from labnnum.diagnosis.nonlinear.records import changed, split, stretch_of
from labnnum.diagnosis.nonlinear.repeated import APART, answers_apart, difference
from labnnum.diagnosis.observe import observe_all
from labnnum.diagnosis.scatter import Scatter
from labnnum.nonlinear import Element
from labnnum.recording import Recording
from tests.diagnosis.test_nonlinear_records import RATE, chain, joint_23, noise, recorded, sweep


def two(elements, structure=None, other_seed=1, gain=4.0, added=2e-4):
    """A stretch of noise, begun in motion, at two levels."""
    rng = np.random.default_rng(8)
    out = []
    for level, seed in ((5.0, 1), (5.0 * gain, other_seed)):
        recording = recorded(noise(level, seed=seed), elements, structure)
        x = recording.data[:, 1500:7500]
        x = x + added * 5.0 * x.std(axis=1, keepdims=True) / level * rng.standard_normal(x.shape)
        out.append(Recording(recording.channels, x, RATE, label=f"level {level:g}"))
    return out


@pytest.mark.parametrize("damping", [4.0, 0.4, 0.1])
def test_a_linear_structure_answers_in_proportion_however_long_it_rings(damping):
    low, high = two([], chain(damping))
    found = difference(low, high)
    assert found is not None
    assert np.all(found.largest < APART / 1.5)
    assert np.mean(found.telling(found.frequency)) < 0.01
    assert not answers_apart(low, high, 2)


def test_a_law_that_no_frf_shows_is_seen():
    low, high = two([Element("cubic", joint_23(), (300.0,))])
    found = difference(low, high)
    assert found is not None
    assert np.all(found.largest > APART)
    assert answers_apart(low, high, 2)
    assert changed(observe_all([low, high]))


def test_two_signals_tell_nothing():
    low, high = two([Element("cubic", joint_23(), (3e4,))], other_seed=2)
    assert difference(low, high) is None
    assert not answers_apart(low, high, 2)


def test_what_one_channel_alone_does_is_no_sign():
    low, high = two([])
    x = high.data.copy()
    x[1] = np.clip(x[1], -1.5 * x[1].std(), 1.5 * x[1].std())
    assert not answers_apart(low, Recording(high.channels, x, RATE), 2)


K2 = 50.0
"""Quadratic stiffness that adds some thousandths of an element's own at the loudest sweep's first resonance."""


def swept(elements, added=2e-4):
    """A sweep from rest at two levels: 0.5 to 12 Hz, past four modes at 1.7, 5.0, 7.7 and 9.5 Hz, cut in motion."""
    rng = np.random.default_rng(3)
    out = []
    for level in (1.0, 4.0):
        x = recorded(np.append(sweep(level), np.zeros(2048)), elements, chain(1.0))
        data = x.data[:, :8192]
        data = data + added * data.std(axis=1, keepdims=True) / level * rng.standard_normal(data.shape)
        out.append(Recording(x.channels, data, RATE, label=f"level {level:g}"))
    return out


def test_a_harmonic_of_a_sweeps_first_mode_is_seen_where_it_falls():
    found = difference(*swept([Element("quadratic", joint_23(), (K2,))]))
    assert found is not None
    assert np.count_nonzero(found.largest > APART) >= 2
    assert found.telling(np.linspace(3.45, 3.52, 9)).all()  # about twice the first mode's
    assert not found.telling(np.linspace(0.6, 1.4, 99)).any()
    assert np.mean(found.telling(found.frequency)) < 0.2


def test_a_linear_sweep_shows_nothing_though_its_ends_leak():
    found = difference(*swept([]))
    assert found is not None
    assert np.all(found.largest < APART / 1.5)
    assert not found.telling(found.frequency).any()


def test_lines_that_tell_are_compared_and_held_out():
    observations = observe_all(swept([Element("quadratic", joint_23(), (K2,))]))
    parts = split(observations, decay_time=1.0)
    for o in (*parts.train, *parts.test):
        assert o.run is not None
        assert o.run.telling is not None
        telling = o.run.telling & o.run.compared
        assert np.count_nonzero(telling) > 10
        at = choose_lines(o.run, 20).at
        assert np.count_nonzero(telling[at]) >= min(np.count_nonzero(telling), at.size // 2) - 2  # at the ends
    plain = split(observe_all(swept([])), decay_time=1.0)
    assert all(o.run is not None and o.run.telling is None for o in plain.train)


def test_one_signal_at_two_levels_bounds_every_linear_model():
    for elements, some in (([], False), ([Element("quadratic", joint_23(), (40 * K2,))], True)):
        runs = [stretch_of(r, 0, r.n_samples) for r in swept(elements)]
        assert one_signal(runs)
        assert (linear_least(runs, Scatter(floor=1e-4)) > 3) == some
    assert not one_signal([stretch_of(r, 0, r.n_samples) for r in two([], other_seed=2)])
