"""A channel at its rail beside a structure that distorts them all."""

from types import SimpleNamespace

import numpy as np
import pytest

from labnnum.diagnosis.railed import railed
from labnnum.diagnosis.rails import Clip


def run(level, peaks, clipped=(), kind="periodic", recordings=()):
    return SimpleNamespace(
        level=level, peaks=peaks, clipped={n: Clip(0.01, peaks[n], s) for n, s in clipped}, kind=kind,
        recordings=recordings,
    )  # fmt: skip


LOW = run(1.0, {"a": 3.0, "b": 4.0})


@pytest.mark.parametrize(
    ("score", "other", "found"),
    [
        (5.0, 10.01, True),
        (5.0, 10.3, False),  # the other loud run reads higher
        (2.0, 10.01, False),  # few samples pile up
    ],
)
def test_two_runs_that_end_at_one_reading_where_samples_pile_up(score, other, found):
    loud = [run(10.0, {"a": 10.0, "b": 41.0}, [("a", score)]), run(9.9, {"a": other, "b": 44.0})]
    assert railed([LOW, *loud]) == (["", "a", "a"] if found else ["", "", ""])


def hits(sizes, rail=np.inf, kind="hammer"):
    """Hits of these sizes at one level, channel b ending at `rail`."""
    shape = np.concatenate([np.zeros(50), np.hanning(9), np.zeros(50)])
    recordings = [
        SimpleNamespace(
            data=np.array([s * shape, np.minimum(2 * s * shape, rail), 3 * s * shape]),
            spans=lambda: [(0, shape.size)],
            channels=tuple(SimpleNamespace(name=n, role="response") for n in ("force", "b", "c")),
        )
        for s in sizes
    ]
    top = max(sizes)
    peaks = {"force": top, "b": min(2 * top, rail), "c": 3 * top}
    return run(top, peaks, kind=kind, recordings=tuple(recordings))


def test_hits_of_unlike_force_that_one_channel_reads_alike():
    low = hits([1.0, 1.1, 1.2])
    assert railed([low, hits([5.0, 6.0, 6.5, 7.0], rail=10.0)]) == ["", "b"]
    assert railed([low, hits([5.0, 6.0, 6.5, 7.0])]) == ["", ""]
    assert railed([low, hits([6.99, 7.0, 7.01], rail=10.0)]) == ["", ""], "hits that are alike say nothing"
