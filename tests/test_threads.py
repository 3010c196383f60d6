"""Pieces on several threads: in their order, all of them, and the same to the bit as one after the other."""

import os
import threading
import time
from contextvars import ContextVar

import pytest

from labnnum import threads
from labnnum.diagnosis import diagnose
from labnnum.diagnosis.nonlinear.effort import counted, marched, spent
from labnnum.nonlinear import Element
from labnnum.threads import each
from sessions.prove.jobs import THREAD_SETTINGS
from tests.diagnosis.test_nonlinear import chain, joint_23, runs


@pytest.fixture(params=["1", "3"])
def number(request, monkeypatch):
    """On one thread, and on several."""
    monkeypatch.setenv(threads.VARIABLE, request.param)
    monkeypatch.setattr(threads, "_pool", None)
    return int(request.param)


def test_results_come_in_the_order_of_the_items(number):
    def late(i):
        time.sleep(0.02 * (3 - i))
        return i * i

    assert each(late, range(4)) == [0, 1, 4, 9]
    assert each(late, []) == []
    assert each(late, [2]) == [4]


def test_several_are_computed_at_a_time_only_where_that_is_asked_for(number):
    met = threading.Barrier(2)

    def together(_):
        try:
            met.wait(timeout=2.0 if number > 1 else 0.05)
        except threading.BrokenBarrierError:
            return False
        return True

    assert each(together, [0, 1]) == [number > 1] * 2


def test_all_are_computed_and_the_first_error_is_raised(number):
    done = []

    def one(i):
        if i in (1, 3):
            raise ValueError(f"piece {i}")
        done.append(i)

    with pytest.raises(ValueError, match="piece 1"):
        each(one, range(5))
    assert sorted(done) == [0, 2, 4]


def test_pieces_within_pieces_end(number):
    assert each(lambda i: sum(each(lambda j: i * j, range(5))), range(8)) == [10 * i for i in range(8)]


def test_pieces_see_the_context_that_they_were_asked_in(number):
    kept = ContextVar("kept", default="nothing")
    kept.set("something")
    assert each(lambda _: kept.get(), range(3)) == ["something"] * 3


def test_processes_side_by_side_take_one_thread_each():
    assert threads.VARIABLE in THREAD_SETTINGS


def test_a_number_that_is_none_is_not_taken(monkeypatch):
    monkeypatch.setenv(threads.VARIABLE, "many")
    assert threads.threads() >= 1
    monkeypatch.delenv(threads.VARIABLE)
    assert 1 <= threads.threads() <= (os.cpu_count() or 1)


def test_what_is_counted_on_several_threads_is_the_same(number):
    with counted():
        each(lambda i: [marched(100 + i, 7, 2, 3) for _ in range(200)], range(6))
        assert spent() == pytest.approx(200 * sum((100 + i) * 2 * (2e-7 * 2 + 6e-10 * 21) for i in range(6)), rel=1e-12)


def test_a_diagnosis_is_the_same_to_the_bit(monkeypatch):
    def told(number):
        monkeypatch.setenv(threads.VARIABLE, number)
        monkeypatch.setattr(threads, "_pool", None)
        found = diagnose(chain(), runs([Element("cubic", joint_23(), (2e4,))], chain(), levels=(2.0, 8.0)))
        last = found.detail["nonlinear"].laws[-1].made
        return found.summary, last.x.tobytes(), last.covariance.tobytes(), last.objective

    assert told("1") == told("3")
