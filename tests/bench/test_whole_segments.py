"""Bursts and periods on the simulated bench: nothing leaks, whatever was lost in between, and updating knows it."""

from dataclasses import replace

import numpy as np
import pytest

from labnnum.bands import Band
from labnnum.parameters import Parameter
from labnnum.structures.chain import Chain, Link
from labnnum.updating.refine import refine
from labnnum.updating.seen import view_of
from sessions.bench import measure
from sessions.reprocess import FrfSettings, reprocess
from sessions.store import open_session

from .rigs import agreement, shaker_rig

LEVEL = ("levels = [0.5, 2.0]", "levels = [1.0]")
BURSTS = (LEVEL, ('kind = "multisine"', 'kind = "burst random"\nburst = 0.4\nduration = 60'))
PERIODS = (LEVEL, ("periods = 4", "periods = 16"), ("[safety]", '[processing]\nestimator = "H1"\n[safety]'))
TRUTH = np.array([8e5, 5e5, 80.0, 50.0])


def unknown_chain():
    """The two masses of the rigs with stiffnesses and dashpots to be found, all begun at half or less."""
    bounds = [Parameter(name, 0.5 * v, 0.2 * v, 4 * v) for name, v in zip(("k1", "k2", "c1", "c2"), TRUTH, strict=True)]
    return Chain({"1": 2.0, "2": 1.0}, (Link("1", "ground", "k1", "c1"), Link("1", "2", "k2", "c2")), tuple(bounds))


@pytest.mark.parametrize(("changes", "mark"), [(BURSTS, "burst"), (PERIODS, "periodic")], ids=["bursts", "periods"])
def test_damping_updated_from_what_does_not_leak_is_right_within_its_error(tmp_path, changes, mark):
    (found,) = measure(shaker_rig(tmp_path, *changes), tmp_path / "out.h5").frfs.values()
    assert (found.estimator, found.settings["window"], found.settings[mark]) == ("H1", "boxcar", True)
    assert view_of(found) is None
    estimate = refine(unknown_chain(), found, bands=[Band(20.0, 340.0)])
    assert np.abs((estimate.value - TRUTH) / estimate.std).max() < 3
    assert (estimate.std[2:] / TRUTH[2:]).max() < 1e-3
    assert 0.7 < estimate.chi2 < 1.4
    with open_session(tmp_path / "out.h5") as session:
        assert session.frfs()[0].settings[mark] is True


def test_bursts_after_a_gap_are_taken_from_their_start(tmp_path):
    """Lost frames cost the bursts that they touch, and no coherence of the others."""
    whole = measure(shaker_rig(tmp_path, *BURSTS), tmp_path / "whole.h5").frfs["burst-random 1"]
    lossy = ("[simulated.channel", "[simulated.faults]\ndropouts = 0.15\ndropout_frames = 300\n[simulated.channel")
    rig = shaker_rig(tmp_path, *BURSTS, lossy)
    found = measure(rig, tmp_path / "gaps.h5").frfs["burst-random 1"]
    with open_session(tmp_path / "gaps.h5", "a") as session:
        (run,) = session.runs
        lost = [at for at in run.gaps() if run.hits[0].start < at < run.hits[0].stop]
        ((_, again),) = reprocess(session, FrfSettings())
    assert len(lost) > 3
    assert 50 < found.n_averages < 58
    np.testing.assert_array_equal(again.value, found.value)
    assert 0.5 < agreement(rig, found) < 1.6
    for one in (found, whole):
        assert one.coherence is not None
        assert one.coherence[0, (one.frequency > 8) & (one.frequency < 340)].mean() == pytest.approx(0.98, abs=3e-3)
    assert found.variance is not None
    assert whole.variance is not None
    peak = int(np.argmax(np.abs(whole.value[0, 0])))
    error = np.sqrt(found.variance[0, 0, peak] + whole.variance[0, 0, peak])
    assert abs(found.value[0, 0, peak] - whole.value[0, 0, peak]) < 3 * error


def test_after_an_uncounted_loss_no_burst_is_guessed(tmp_path):
    silent = ("[simulated.channel", "[simulated.faults]\ndropouts = 0.04\nsilent = true\n[simulated.channel")
    rig = shaker_rig(tmp_path, *BURSTS, silent)
    outcome = measure(rig, tmp_path / "out.h5")
    with open_session(tmp_path / "out.h5") as session:
        (run,) = session.runs
        recording, (hit,) = run.recording(), run.hits
        first = min(at for at in run.gaps() if at > hit.start)
    assert first < hit.stop - 4096
    assert recording.bursts == tuple(range(hit.start, first, 1024))
    (told,) = [m for m in outcome.messages if "left out: it is not known where bursts begin" in m]
    assert told.startswith("burst-random 1: ")
    found = outcome.frfs["burst-random 1"]
    assert found.n_averages == (first - hit.start) // 1024
    assert 0.5 < agreement(rig, found) < 1.6


def test_an_frf_that_an_earlier_version_stored_without_its_mark_is_stored_again_with_it(tmp_path):
    rig, path = shaker_rig(tmp_path, LEVEL, BURSTS[1]), tmp_path / "out.h5"
    (found,) = measure(rig, path).frfs.values()
    unmarked = {k: v for k, v in found.settings.items() if k != "burst"}
    with open_session(path, "a") as session:
        del session.node("results")["frf"]
        session.add_frf(replace(found, settings=unmarked), name="burst-random 1")
    for _ in range(2):
        measure(rig, path)
        with open_session(path) as session:
            assert [f.settings.get("burst") for f in session.frfs()] == [None, True]
