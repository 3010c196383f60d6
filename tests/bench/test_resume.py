"""Interrupted plans: lost devices, another day, the same bits as without an interruption."""

from dataclasses import replace

import numpy as np
import pytest

from labnnum.errors import ConfigError, DeviceLostError, EstimationError, FileError
from labnnum.response import frf
from sessions import bench
from sessions.bench import measure
from sessions.calibration import Calibration, InputEntry
from sessions.display import Quiet
from sessions.exchange import load_recordings
from sessions.exporting import chosen_recordings
from sessions.items import items
from sessions.model import read_model
from sessions.reprocess import FrfSettings, reprocess
from sessions.store import open_session

from .rigs import HAMMER, hammer_rig, replay_of, rig_of, shaker_rig


def test_a_lost_device_leaves_what_was_recorded_and_the_plan_goes_on(tmp_path, monkeypatch):
    rig = hammer_rig(tmp_path)
    broken = replace(rig, toml=rig.toml.model_copy(update={"simulated": _vanishing(rig)}))
    with pytest.raises(DeviceLostError, match="unplugged"):
        measure(broken, tmp_path / "out.h5")
    with open_session(tmp_path / "out.h5") as session:
        assert session.runs[0].finished.startswith("abort: the simulated device was unplugged")
        before = [(h.start, h.accepted) for h in session.runs[0].hits]
    assert before
    outcome = measure(rig, tmp_path / "out.h5")
    assert outcome.complete
    with open_session(tmp_path / "out.h5") as session:
        first = [r for r in session.runs if r.info["item"] == "hammer 1:x"]
        assert [(h.start, h.accepted) for h in first[0].hits] == before
        assert sum(h.accepted for r in first for h in r.hits) == 3


def _vanishing(rig, after=2.2):
    s = rig.toml.simulated
    return s.model_copy(update={"faults": s.faults.model_copy(update={"vanish": after})})


@pytest.mark.parametrize(
    ("make", "after", "why"),
    [
        (hammer_rig, 0.6, r"run 1 ended before it counted \(abort: the simulated device was unplugged after 0.6 s\)"),
        (shaker_rig, 1.5, r"run 1 ended before it counted \(abort: the simulated device was unplugged after 1.5 s\)"),
    ],
)
def test_a_run_that_ended_before_it_counted_enters_no_estimate(tmp_path, make, after, why):
    rig, path = make(tmp_path), tmp_path / "out.h5"
    broken = replace(rig, toml=rig.toml.model_copy(update={"simulated": _vanishing(rig, after)}))
    with pytest.raises(DeviceLostError, match="unplugged"):
        measure(broken, path)
    assert len(chosen_recordings(path)) == 1
    with pytest.raises(FileError, match=f"no run of it can be used: {why}"):
        load_recordings(path)
    with open_session(path, "a") as session, pytest.raises(EstimationError, match=f"cannot be used: {why}"):
        reprocess(session, FrfSettings())
    measured = list(measure(rig, path).frfs.values())
    assert len(load_recordings(path)) == 2
    assert len(chosen_recordings(path)) == 3
    with open_session(path, "a") as session:
        found = [frf for _, frf in reprocess(session, FrfSettings(hits=make is hammer_rig))]
        assert [f.settings["left_out"].keys() for f in session.frfs()[-2:]] == [{"1"}, {"1"}]
        with pytest.raises(EstimationError, match=why):
            reprocess(session, FrfSettings(), runs=[1, 2])
    for one, other in zip(found, measured, strict=False):
        np.testing.assert_array_equal(one.value, other.value)


def test_a_run_whose_hits_are_all_rejected_enters_no_estimate(tmp_path):
    rig, path = hammer_rig(tmp_path, ('points = ["1:x", "2:x"]', 'points = ["1:x"]')), tmp_path / "out.h5"
    measure(rig, path)
    with open_session(path, "a") as session:
        (run,) = session.runs
        for hit in run.hits:
            run.judge_hit(hit.index, False, "rejected by the user")
        with pytest.raises(EstimationError, match="cannot be used: run 1 none of its 3 hits is accepted"):
            reprocess(session, FrfSettings())
        assert session.recordings() == []


@pytest.mark.parametrize("make", [hammer_rig, shaker_rig])
def test_a_plan_resumed_between_items_gives_the_same_bits(tmp_path, make):
    rig = make(tmp_path)
    whole = measure(rig, tmp_path / "whole.h5")

    class Evening(Quiet):
        """Stops when the second item begins."""

        def commands(self):
            current = [p.key for p in self.last.progress if p.current] if self.last else []
            return ["stop"] if current == [items(rig)[1].key] else []

        def wants(self):
            return True

    one = measure(rig, tmp_path / "parts.h5", Evening())
    assert not one.complete
    parts = measure(rig, tmp_path / "parts.h5")
    assert parts.complete
    assert list(parts.frfs) == list(whole.frfs)
    for name, found in whole.frfs.items():
        if make is shaker_rig or name == "hammer 1:x":
            np.testing.assert_array_equal(parts.frfs[name].value, found.value)


def test_a_plan_resumed_in_the_middle_of_a_point_gives_the_same_bits(tmp_path):
    """The same blows, recorded in one run or in two, on two days."""
    text = HAMMER.replace('points = ["1:x", "2:x"]', 'points = ["1:x"]').replace("hits = 3", "hits = 4")
    rig = rig_of(tmp_path, text)
    whole = measure(rig, tmp_path / "whole.h5")
    with open_session(tmp_path / "whole.h5") as session:
        blocks = list(session.runs[0].replay())
        cut = (session.runs[0].hits[1].stop + session.runs[0].hits[2].start) // 2 // 512

    played = replay_of(rig, [blocks[:cut], blocks[cut:]])
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(bench, "devices", played)
        with pytest.raises(DeviceLostError):
            measure(rig, tmp_path / "parts.h5")
        parts = measure(rig, tmp_path / "parts.h5")
    assert parts.complete
    found, expected = parts.frfs["hammer 1:x"], whole.frfs["hammer 1:x"]
    np.testing.assert_array_equal(found.value, expected.value)
    np.testing.assert_array_equal(found.coherence, expected.coherence)
    np.testing.assert_array_equal(found.variance, expected.variance)


@pytest.mark.parametrize("anew", ["a sensor", "an input"])
def test_a_point_goes_on_after_something_was_calibrated_anew(tmp_path, anew):
    rig = hammer_rig(tmp_path, ('points = ["1:x", "2:x"]', 'points = ["1:x"]'), ("hits = 3", "hits = 4"))
    broken = replace(rig, toml=rig.toml.model_copy(update={"simulated": _vanishing(rig, 3.3)}))
    with pytest.raises(DeviceLostError):
        measure(broken, tmp_path / "out.h5")
    if anew == "a sensor":
        answer = rig.stored[1]
        channel = replace(answer.channel, sensitivity=answer.channel.sensitivity * 1.01)
        later = replace(rig, stored=(rig.stored[0], replace(answer, channel=channel, scale=answer.scale / 1.01)))
    else:
        entry = InputEntry(channel="a2", date="", method="", reference="hammer", delay=1e-6)
        later = replace(rig, calibration=Calibration(input=(entry,)))
    outcome = measure(later, tmp_path / "out.h5")
    assert outcome.messages == ()
    found = outcome.frfs["hammer 1:x"]
    with open_session(tmp_path / "out.h5") as session:
        first, second = session.runs
        assert first.channels != second.channels or first.info.get("inputs") != second.info.get("inputs")
        assert min(sum(h.accepted for h in run.hits) for run in session.runs) > 0
    assert found.n_averages == 4
    assert set(found.settings["basis"]) == {"1", "2"}
    model = read_model(rig.beside("model.toml")).structure
    lines = (found.frequency > 20) & (found.frequency < 300)
    exact = frf(model, model.nominal, found.frequency[lines], found.outputs, found.inputs)
    assert np.linalg.norm(found.value[..., lines] - exact) < 0.02 * np.linalg.norm(exact)


def test_accepted_hits_that_touch_an_overload_are_told(tmp_path):
    rig = hammer_rig(tmp_path, ('points = ["1:x", "2:x"]', 'points = ["1:x"]'), ("hits = 3", "hits = 4"))
    measure(rig, tmp_path / "whole.h5")
    with open_session(tmp_path / "whole.h5") as session:
        (run,) = session.runs
        middle = (run.hits[1].start + run.hits[1].stop) // 2
        blocks = [
            replace(b, overload=np.array([False, b.start <= middle < b.start + b.n_frames])) for b in run.replay()
        ]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(bench, "devices", replay_of(rig, [blocks]))
        outcome = measure(rig, tmp_path / "out.h5")
    found = outcome.frfs["hammer 1:x"]
    assert found.n_averages == 3
    assert found.settings["basis"] == {"1": [0, 2, 3]}
    assert "hammer 1:x: 3 of 4 accepted hits are used: an overload touches hit 1 of run 1" in outcome.messages


def test_a_second_session_needs_the_same_rig(tmp_path):
    rig = hammer_rig(tmp_path)
    measure(rig, tmp_path / "out.h5")
    other = hammer_rig(tmp_path, ("hits = 3", "hits = 4"))
    with pytest.raises(ConfigError, match=r"begun with another rig\.toml"):
        measure(other, tmp_path / "out.h5")


def test_measuring_a_complete_plan_again_changes_nothing(tmp_path):
    rig = hammer_rig(tmp_path)
    measure(rig, tmp_path / "out.h5")
    with open_session(tmp_path / "out.h5") as session:
        before = len(session.frfs()), len(session.runs)
    again = measure(rig, tmp_path / "out.h5")
    assert again.complete
    with open_session(tmp_path / "out.h5") as session:
        assert (len(session.frfs()), len(session.runs)) == before
