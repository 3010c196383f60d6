"""Hammer plans on the simulated bench: what comes out, what the person decides, which hits stay."""

from dataclasses import replace

import numpy as np
import pytest

from labnnum.errors import DeviceLostError
from sessions import bench
from sessions.bench import measure
from sessions.display import Quiet
from sessions.store import open_session

from .rigs import HAMMER, agreement, hammer_rig, replay_of, rig_of


def test_hammer_plan_gives_the_frf_of_the_structure_at_every_point(tmp_path):
    rig = hammer_rig(tmp_path, ("hits = 3", "hits = 8"))
    display = Quiet()
    outcome = measure(rig, tmp_path / "out.h5", display)
    assert outcome.complete
    assert list(outcome.frfs) == ["hammer 1:x", "hammer 2:x", "all points"]
    whole = outcome.frfs["all points"]
    assert [c.dof for c in whole.inputs] == ["1:x", "2:x"]
    assert 0.7 < agreement(rig, whole) < 1.6
    last = display.last
    assert last is not None
    assert [p.done for p in last.progress] == [8, 8]
    assert last.curves is not None
    np.testing.assert_allclose(last.curves.magnitude, np.abs(outcome.frfs["hammer 2:x"].value[0]))


def test_what_is_stored_is_what_was_shown_with_a_gate_and_a_decay_too(tmp_path):
    rig = hammer_rig(
        tmp_path, ("[simulated]\n", "[processing]\ndecay = 4.0\nforce_gate = [0.005, 0.02]\n[simulated]\n")
    )
    display = Quiet()
    outcome = measure(rig, tmp_path / "out.h5", display)
    assert display.last is not None
    assert display.last.curves is not None
    stored = outcome.frfs["hammer 2:x"]
    np.testing.assert_allclose(display.last.curves.magnitude, np.abs(stored.value[0]), rtol=1e-9)
    assert stored.settings["window_decay"] == 4.0


def test_every_hit_is_kept_with_its_reason(tmp_path):
    rig = hammer_rig(
        tmp_path, ("peak = 150\n", "peak = 150\ndouble = 0.5\noverload = 0.2\n"), ("bits = 16", "bits = 12")
    )
    outcome = measure(rig, tmp_path / "out.h5")
    assert outcome.complete
    with open_session(tmp_path / "out.h5") as session:
        hits = [h for run in session.runs for h in run.hits]
        recording = session.runs[0].recording()
        accepted = [h for h in session.runs[0].hits if h.accepted]
    rejected = [h for h in hits if not h.accepted]
    assert rejected
    assert all("double hit" in h.reason or "clipped" in h.reason for h in rejected)
    assert all(h.verdicts for h in hits)
    assert [(h.start, h.stop) for h in accepted] == list(recording.spans())


def test_the_person_rejects_undoes_and_goes_on(tmp_path):
    rig = hammer_rig(tmp_path, ('points = ["1:x", "2:x"]', 'points = ["1:x"]\nauto = false'))
    keys = Quiet([(1, "reject 0"), (2, "reject 1"), (2, "undo"), (4, "reject 9"), (5, "next")])
    outcome = measure(rig, tmp_path / "out.h5", keys)
    with open_session(tmp_path / "out.h5") as session:
        hits = session.runs[0].hits
    assert [h.accepted for h in hits][:2] == [False, True]
    assert hits[0].reason == "rejected by the user"
    assert [j.reason for j in hits[1].history][1:] == ["rejected by the user", "undone by the user"]
    assert len(hits) == 5
    assert any("there is no hit 9" in m for m in outcome.messages)
    assert keys.last is not None
    assert outcome.complete


def test_what_is_said_of_a_hit_in_one_breath_with_stop_holds(tmp_path):
    outcome = measure(hammer_rig(tmp_path), tmp_path / "out.h5", Quiet([(1, "reject 0"), (1, "stop")]))
    assert outcome.items["hammer 1:x"] == "stopped by the user"
    with open_session(tmp_path / "out.h5") as session:
        (hit,) = session.runs[0].hits
    assert (hit.accepted, hit.reason) == (False, "rejected by the user")


def test_only_the_best_hits_stay(tmp_path):
    rig = hammer_rig(tmp_path, ("hits = 3", "hits = 5\nbest = 3"))
    outcome = measure(rig, tmp_path / "out.h5")
    assert outcome.complete
    with open_session(tmp_path / "out.h5") as session:
        hits = session.runs[0].hits
    assert sum(h.accepted for h in hits) == 3
    assert sum("agree best" in h.reason for h in hits) == 2
    assert outcome.frfs["hammer 1:x"].n_averages == 3


def test_roving_sensor(tmp_path):
    changes = [
        ("sensitivity = 0.02\n", 'sensitivity = 0.02\nnode = "1"\ndirection = "x"\n'),
        ('node = "2"\ndirection = "x"\n', ""),
        ("hits = 3", 'hits = 3\nrove = "sensor"'),
    ]
    rig = hammer_rig(tmp_path, *changes)
    outcome = measure(rig, tmp_path / "out.h5")
    whole = outcome.frfs["all points"]
    assert [c.dof for c in whole.outputs] == ["1:x", "2:x"]
    assert [c.dof for c in whole.inputs] == ["1:x"]
    assert whole.coherence is not None
    assert agreement(rig, whole) < 2.5


def test_a_point_that_gives_nothing_is_given_up(tmp_path):
    rig = hammer_rig(tmp_path, ("peak = 150\n", "peak = 150\ndouble = 1.0\n"), ("hits = 3", "hits = 3\nmost = 4"))
    outcome = measure(rig, tmp_path / "out.h5")
    assert not outcome.complete
    assert outcome.items == {"hammer 1:x": "gave up", "hammer 2:x": "gave up"}
    assert any("giving up" in m for m in outcome.messages)


def test_a_point_that_was_given_up_has_as_many_attempts_when_it_is_taken_up_again(tmp_path):
    changes = ("peak = 150\n", "peak = 150\ndouble = 1.0\n"), ("hits = 3", "hits = 3\nmost = 4")
    rig = hammer_rig(tmp_path, *changes, ('points = ["1:x", "2:x"]', 'points = ["1:x"]'))
    for attempt in (1, 2):
        outcome = measure(rig, tmp_path / "out.h5")
        assert outcome.items == {"hammer 1:x": "gave up"}
        with open_session(tmp_path / "out.h5") as session:
            assert [len(run.hits) for run in session.runs] == [4] * attempt
    assert any("4 hits, 4 before, and only 0 accepted; giving up" in m for m in outcome.messages)


@pytest.mark.parametrize("best", ["", "\nbest = 2"])
def test_accepted_hits_of_a_dead_response_end_no_run_and_the_point_can_be_taken_up_again(tmp_path, best):
    """The person's word stands for the checks': what it gives is another matter."""
    changes = (
        ('points = ["1:x", "2:x"]', 'points = ["1:x"]'),
        ("hits = 3", f"hits = 3{best}"),
        ("noise = 0.02", "gain = 0"),
    )
    rig = hammer_rig(tmp_path, *changes)
    outcome = measure(rig, tmp_path / "out.h5", Quiet([(1, "accept 0"), (2, "accept 1"), (3, "stop")]))
    assert outcome.items == {"hammer 1:x": "stopped by the user"}
    display = Quiet([(4, "accept 3")])
    outcome = measure(rig, tmp_path / "out.h5", display)
    assert outcome.items == {"hammer 1:x": "complete"}
    assert any("no FRF of hammer 1:x" in m and "'a2' is constant" in m for m in outcome.messages)
    assert display.last is not None
    assert display.last.curves is None
    with open_session(tmp_path / "out.h5") as session:
        assert next(h.reason for run in session.runs for h in run.hits if h.accepted) == "accepted by the user"


def test_a_hit_at_another_point_is_found(tmp_path):
    rig = hammer_rig(tmp_path)
    measure(rig, tmp_path / "whole.h5")
    with open_session(tmp_path / "whole.h5") as session:
        here, there = (list(run.replay()) for run in session.runs)
        cut = session.runs[0].hits[1].stop // 512 + 1
    last = here[cut - 1]
    moved = [replace(b, start=b.start + last.start + 512) for b in there]
    again = rig_of(tmp_path, HAMMER.replace('points = ["1:x", "2:x"]', 'points = ["1:x"]'))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(bench, "devices", replay_of(again, [here[:cut] + moved]))
        with pytest.raises(DeviceLostError):
            measure(again, tmp_path / "mixed.h5")
    with open_session(tmp_path / "mixed.h5") as session:
        hits = session.runs[0].hits
    assert [h.accepted for h in hits[:2]] == [True, True]
    assert not hits[2].accepted
    assert "disagrees with the others on a2" in hits[2].reason
