"""Recorder: the disk first, the guard before it, and nothing lost when nobody listens."""

import threading
import time
from contextlib import nullcontext

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.block import Block
from drivers.digitiser import Digitiser
from drivers.replay import Replay
from labnnum.errors import DeviceLostError, SafetyError, StoreError
from sessions.recorder import LIVE, Recorder, Tail


def blocks(n=20, frames=64, lost=()):
    at = 0
    for k in range(n):
        gap = 10 if k in lost else 0
        at += gap
        yield Block(np.full((2, frames), float(k)), at, float(at), gap)
        at += frames


class Sink:
    def __init__(self, log=None, fail_at=None):
        self.blocks, self.log, self.fail_at = [], log if log is not None else [], fail_at

    def append(self, block):
        if len(self.blocks) == self.fail_at:
            raise StoreError("the disk is full")
        self.blocks.append(block)
        self.log.append("stored")
        return sum(b.n_frames for b in self.blocks)


class Fast(Digitiser):
    """Delivers as fast as it is read, from a thread of the recorder."""

    def __init__(self, source, error=None):
        self._source, self._error = list(source), error
        self.stopped = False

    n_channels = 2
    rate = 1000.0

    def open(self): ...

    def start(self):
        self._left = iter(self._source)

    def read(self, timeout=5.0):
        block = next(self._left, None)
        if block is None and self._error is not None:
            raise self._error
        return block

    def stop(self):
        self.stopped = True


@pytest.mark.parametrize("make", [lambda b: Replay(lambda: b, 1e3, 2), Fast])
def test_every_block_is_stored_and_handed_over_in_order(make):
    source = list(blocks(lost=(3, 7)))
    sink = Sink()
    with Recorder(make(source), sink) as recorder:
        got = list(recorder)
    assert [g.block.start for g in got] == [b.start for b in source]
    assert [g.at for g in got] == [64 * k for k in range(20)]
    assert [k for k, g in enumerate(got) if g.broken] == [3, 7]
    assert [b.start for b in sink.blocks] == [b.start for b in source]
    assert (recorder.lost, recorder.stored) == (20, 1280)


@pytest.mark.parametrize(
    ("error", "fail_at", "kept", "fails"),
    [(DeviceLostError("unplugged"), None, 9, True), (None, 4, 4, True), (None, None, 9, False)],
)
def test_when_recording_ends_by_itself_silence_comes_before_the_blocks_that_wait_are_taken(error, fail_at, kept, fails):
    off = threading.Event()
    recorder = Recorder(Fast(blocks(9), error), Sink(fail_at=fail_at))
    recorder.silence = off.set
    got = []
    with recorder, pytest.raises((DeviceLostError, StoreError)) if fails else nullcontext():
        assert off.wait(60)
        while (one := recorder.take()) is not None:
            got.append(one)
    assert len(got) == kept


def test_a_recording_that_is_ended_by_others_is_not_theirs_to_silence():
    off = threading.Event()
    device = Fast(())
    device._source = blocks(10**9)  # it delivers for as long as it is read
    recorder = Recorder(device, Sink())
    recorder.silence = off.set
    with recorder:
        recorder.take()
    assert not off.is_set()


def test_guard_acts_before_the_disk_and_its_block_is_kept():
    log = []

    def guard(block):
        log.append("guarded")
        if block.start == 128:
            raise SafetyError("too much")

    sink = Sink(log)
    with Recorder(Replay(blocks, 1e3, 2), sink, guard) as recorder, pytest.raises(SafetyError):
        list(recorder)
    assert log == ["guarded", "stored"] * 3
    assert len(sink.blocks) == 3


@pytest.mark.parametrize("error", [DeviceLostError("gone"), None])
def test_a_lost_device_comes_up_after_what_it_delivered(error):
    device = Fast(blocks(5), error)
    sink = Sink()
    got = []
    with Recorder(device, sink) as recorder:
        if error is None:
            got = list(recorder)
        else:
            with pytest.raises(DeviceLostError):
                got.extend(recorder)
    assert len(sink.blocks) == 5
    assert device.stopped


def test_a_full_disk_comes_up():
    with Recorder(Fast(blocks(9)), Sink(fail_at=4)) as recorder, pytest.raises(StoreError, match="full"):
        list(recorder)


def test_a_reader_that_hangs_costs_nothing_on_the_disk():
    frames = LIVE // 16 // 8  # of two channels: an eighth of the live buffer
    source = list(blocks(24, frames))
    sink = Sink()
    with Recorder(Fast(source), sink) as recorder:
        first = [g for g in [recorder.take()] if g is not None]
        deadline = time.monotonic() + 20
        while len(sink.blocks) < 24 and time.monotonic() < deadline:
            time.sleep(0.005)
        got = first + list(recorder)
    assert len(sink.blocks) == 24
    assert any(g.skipped for g in got)
    assert all(g.broken for g in got if g.skipped)
    assert sum(g.skipped + g.block.n_frames for g in got) == 24 * frames


def test_the_thread_ends():
    before = threading.active_count()
    with Recorder(Fast(blocks(3)), Sink()) as recorder:
        recorder.take()
    assert threading.active_count() == before


@settings(max_examples=40, deadline=None)
@given(sizes=st.lists(st.integers(1, 30), min_size=1, max_size=20), length=st.integers(1, 20))
def test_tail_holds_the_last_samples(sizes, length):
    tail = Tail(2, length)
    whole = np.arange(2.0 * sum(sizes)).reshape(2, -1)
    at = 0
    for n in sizes:
        tail.add(at, whole[:, at : at + n])
        at += n
        low = max(at - n - length, 0)
        if at - low > length:
            low = max(at - length, 0)
        np.testing.assert_array_equal(tail.cut(low, at), whole[:, low:at])
    count = min(3, length)  # what is held for certain
    np.testing.assert_array_equal(tail.latest(count), whole[:, max(at - count, 0) :])
    tail.add(at + 5, whole[:, :1])
    with pytest.raises(IndexError):
        tail.cut(at - 1, at + 6)
