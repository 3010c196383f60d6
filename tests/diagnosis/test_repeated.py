"""One signal at two levels: a linear structure answers it in proportion, whatever leaks."""

import numpy as np
import pytest

from labnnum.diagnosis.nonlinear.records import changed
from labnnum.diagnosis.nonlinear.repeated import ALSO, APART, answers_apart, differences
from labnnum.diagnosis.observe import observe_all
from labnnum.nonlinear import Element
from labnnum.recording import Recording
from tests.diagnosis.test_nonlinear_records import RATE, chain, joint_23, noise, recorded


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
    largest = differences(low, high)
    assert largest is not None
    assert np.all(largest < ALSO)
    assert not answers_apart(low, high, 2)


def test_a_law_that_no_frf_shows_is_seen():
    low, high = two([Element("cubic", joint_23(), (300.0,))])
    largest = differences(low, high)
    assert largest is not None
    assert np.all(largest > APART)
    assert answers_apart(low, high, 2)
    assert changed(observe_all([low, high]))


def test_two_signals_tell_nothing():
    low, high = two([Element("cubic", joint_23(), (3e4,))], other_seed=2)
    assert differences(low, high) is None
    assert not answers_apart(low, high, 2)


def test_what_one_channel_alone_does_is_no_sign():
    low, high = two([])
    x = high.data.copy()
    x[1] = np.clip(x[1], -1.5 * x[1].std(), 1.5 * x[1].std())
    assert not answers_apart(low, Recording(high.channels, x, RATE), 2)
