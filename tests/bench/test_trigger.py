"""Trigger: what a slow, obvious search finds, at any size of block."""

import time
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.block import Block
from drivers.replay import Replay
from drivers.trigger import Event, Trigger
from labnnum.errors import ConfigError, DriverError


def obvious(x, trigger: Trigger) -> list[Event]:
    """Sample by sample."""
    out, armed, free = [], False, 0
    for k, v in enumerate(x):
        if k < free:
            continue
        armed = armed or v < (1 - trigger.hysteresis) * trigger.level
        if armed and v >= trigger.level:
            armed = False
            if k - trigger.pre >= 0:
                out.append(Event(k, k - trigger.pre, k - trigger.pre + trigger.length))
                free = out[-1].stop
    return [e for e in out if e.stop <= len(x)]


@settings(max_examples=150, deadline=None)
@given(
    x=st.lists(st.sampled_from([0.0, 0.4, 0.6, 1.0, 3.0]), max_size=60),
    cuts=st.lists(st.integers(0, 60), max_size=6),
    pre=st.integers(0, 3),
    more=st.integers(1, 9),
)
def test_any_blocks_give_what_the_obvious_search_gives(x, cuts, pre, more):
    trigger = Trigger(1.0, pre, pre + more)
    detector = trigger.start()
    edges = [0, *sorted(min(c, len(x)) for c in cuts), len(x)]
    found = [e for a, b in pairwise(edges) for e in detector.feed(x[a:b])]
    assert found == obvious(x, trigger)


def test_hysteresis_holds_off_until_the_signal_was_low():
    x = [0, 2, 2, 0.9, 2, 0.4, 2, 0, 0, 0]
    assert [e.at for e in Trigger(1.0, 0, 2).start().feed(x)] == [1, 6]
    assert [e.at for e in Trigger(1.0, 0, 2, hysteresis=0.05).start().feed(x)] == [1, 4]


@pytest.mark.parametrize(("slope", "at"), [("rising", [2]), ("falling", [6]), ("either", [2, 6])])
def test_slopes(slope, at):
    x = [0, 0, 3, 0, 0, 0, -3, 0, 0]
    assert [e.at for e in Trigger(1.0, 1, 2, slope=slope).start().feed(x)] == at


def test_a_hit_needs_its_whole_stretch():
    detector = Trigger(1.0, 2, 6).start()
    assert detector.feed([0, 5, 0, 0, 0, 0, 0]) == []
    assert detector.missed[0].at == 1
    assert "pre-trigger" in detector.missed[0].reason
    assert detector.feed([0, 5, 0]) == []
    detector.gap()
    assert detector.missed[1].reason == "samples were lost during the hit"
    assert detector.feed([0, 0, 5, 0, 0, 0, 0]) == [Event(12, 10, 16)]
    detector.feed([0, 0, 5])
    detector.finish()
    assert detector.missed[2].reason == "the run ended during the hit"


def test_a_stream_that_begins_high_waits():
    assert Trigger(1.0, 0, 2).start().feed([5, 5, 0, 0, 5, 0]) == [Event(4, 4, 6)]


@pytest.mark.parametrize(
    ("bad", "words"),
    [({"level": 0}, "positive"), ({"pre": 9}, "shorter"), ({"hysteresis": 0}, "hysteresis")],
)
def test_bad_settings(bad, words):
    with pytest.raises(ConfigError, match=words):
        Trigger(**({"level": 1.0, "pre": 1, "length": 4} | bad))


def blocks():
    return [Block(np.full((2, 8), float(k)), 8 * k + 5 * (k > 1), 100.0 + k, 5 * (k == 2), k == 3) for k in range(4)]


def test_replay_gives_the_blocks_as_they_came():
    replay = Replay(blocks, 100.0, 2)
    with pytest.raises(DriverError, match="start it first"):
        replay.read()
    with replay:
        replay.start()
        got = []
        while (block := replay.read()) is not None:
            got.append(block)
    for one, other in zip(got, blocks(), strict=True):
        np.testing.assert_array_equal(one.data, other.data)
        assert (one.start, one.time, one.lost, one.overflow) == (other.start, other.time, other.lost, other.overflow)
    assert not replay.paced


def test_replay_keeps_pace():
    replay = Replay(blocks, 370.0, 2, speed=1.0)
    replay.start()
    began = time.monotonic()
    for _ in range(4):
        replay.read()
    assert time.monotonic() - began >= 37 / 370.0 - 1e-3
    bad = Replay(blocks, 10.0, 3)
    bad.start()
    with pytest.raises(DriverError, match="channels"):
        bad.read()
