"""A channel that clips in one loud run beside a nonlinear structure: no other run ends there, all channels distort."""

from dataclasses import replace

import numpy as np
import pytest

from labnnum.diagnosis import diagnose, observe_all
from labnnum.diagnosis.gates import pass_gates
from labnnum.diagnosis.nonlinear.overloaded import overloaded
from labnnum.nonlinear import Element
from tests.diagnosis.test_nonlinear import chain, joint_23, runs

CUBIC = Element("cubic", joint_23(), (2e4,))


def recorded(part: float = 1.0):
    """The recordings of a chain with a cubic spring, and a rail at which one channel's readings end, `part` of the way
    from the lower to the higher peak of the two loudest runs.
    """
    every = [r for o in runs([CUBIC], chain()) for r in o.recordings]
    low, high = sorted(np.abs(r.data[3]).max() for r in every[-2:])
    assert high > 1.1 * low
    rail = low + part * (high - low)
    cut = [np.vstack([r.data[:3], np.clip(r.data[3:], -rail, rail)]) for r in every]
    return [replace(r, data=data) for r, data in zip(every, cut, strict=True)], rail


@pytest.fixture(scope="module")
def cut():
    return recorded(0.15)


def test_a_channel_that_clips_in_one_run_is_named_beside_the_law(cut):
    recordings, rail = cut
    observations = observe_all(recordings)
    assert not pass_gates(observations).named  # no other run ends there
    found = diagnose(chain(), observations)
    assert [n.term.mechanism.id for n in found.named] == ["cubic-stiffness", "channel-clipping"]
    law, clip = found.named
    assert (law.place.id, law.place.to) == ("2", "3")
    assert law.value[0] == pytest.approx(2e4, rel=0.05)
    assert clip.place.id == recordings[0].channels[3].name
    assert clip.value[0] == pytest.approx(rail, rel=0.03)
    assert abs(clip.value[0] - rail) < 4 * clip.std[0]


@pytest.fixture(scope="module")
def whole():
    observations = observe_all(recorded()[0])
    return observations, diagnose(chain(), observations)


def test_no_channel_is_said_to_clip_that_does_not(whole):
    observations, found = whole
    assert [n.term.mechanism.id for n in found.named] == ["cubic-stiffness"]
    assert overloaded(found.detail["nonlinear"], observations) is None


def test_what_was_cut_off_is_put_back(cut, whole):
    observations, free_of_it = observe_all(cut[0]), whole[0]
    one = overloaded(whole[1].detail["nonlinear"], observations)
    assert one is not None
    assert one.output == 2
    spared = 0
    for o, free in zip(observations, free_of_it, strict=True):
        made = one.restored(o)
        assert o.run is not None
        assert free.run is not None
        assert made.run is not None
        before = np.linalg.norm(o.run.y[2] - free.run.y[2])
        after = np.linalg.norm(made.run.y[2] - free.run.y[2])
        assert np.array_equal(made.run.y[:2], o.run.y[:2])
        if before > 0.01 * np.linalg.norm(free.run.y[2]):
            assert after < 0.4 * before
            assert np.linalg.norm(made.frf.value[2] - free.frf.value[2]) < 0.4 * np.linalg.norm(
                o.frf.value[2] - free.frf.value[2]
            )
        else:
            assert made is o
            spared += 1
    assert 0 < spared < len(free_of_it)
