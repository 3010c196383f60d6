"""Shaker plans on the simulated bench: levels, waveforms, stepped sines, and recordings without excitation."""

import numpy as np
import pytest

from labnnum.response import frf
from labnnum.sine import tone_frf
from sessions.bench import measure
from sessions.display import Display, Quiet
from sessions.items import waveform
from sessions.model import read_model
from sessions.reprocess import FrfSettings, reprocess
from sessions.store import open_session

from .rigs import BASE, FORCE, agreement, shaker_rig


@pytest.mark.parametrize("place", [FORCE, BASE], ids=["force", "base"])
@pytest.mark.parametrize("shaker", ["", "[simulated.shaker]\nmass = 0.4\n"], ids=["ideal", "electrodynamic"])
def test_levels_are_held_and_the_frf_is_the_structures(tmp_path, place, shaker):
    rig = shaker_rig(tmp_path, ("[simulated.channel", f"{shaker}[simulated.channel"), place=place)
    outcome = measure(rig, tmp_path / "out.h5")
    assert outcome.complete
    for name, level in (("multisine 0.5", 0.5), ("multisine 2", 2.0)):
        assert 0.5 < agreement(rig, outcome.frfs[name]) < 1.6
        with open_session(tmp_path / "out.h5") as session:
            run = next(r for r in session.runs if r.level == level)
            held = run.hits[0]
            rms = run.read(held.start, held.stop)[0].std()
        assert rms == pytest.approx(level, rel=0.05)
        assert held.stop - held.start == 5 * 1024


def test_realisations_share_their_lines_and_all_of_them_are_estimated(tmp_path):
    """Lines are known from what was played: none is lost where the force sinks into the noise at a resonance."""
    rig = shaker_rig(tmp_path, ("levels = [0.5, 2.0]", "levels = [1.0]\nrealisations = 3\nodd = true\ndetection = 4"))
    path = tmp_path / "s.h5"
    frf = measure(rig, path).frfs["multisine 1"]
    played = [waveform(rig.toml.excitation, rig.rate, r) for r in range(3)]
    for drive in played:
        np.testing.assert_array_equal(drive.lines, played[0].lines)
    assert not np.array_equal(played[0].samples, played[1].samples)
    step = rig.rate / rig.toml.excitation.period
    np.testing.assert_allclose(frf.frequency, played[0].lines * step)
    with open_session(path, "a") as session:
        ((_, again),) = reprocess(session, FrfSettings())
    np.testing.assert_array_equal(again.value, frf.value)


@pytest.mark.parametrize("kind", ["random", "burst random", "periodic random", "chirp"])
def test_other_excitations(tmp_path, kind):
    changes = [('kind = "multisine"', f'kind = "{kind}"\nduration = 30'), ("levels = [0.5, 2.0]", "levels = [1.0]")]
    rig = shaker_rig(tmp_path, *changes)
    outcome = measure(rig, tmp_path / "out.h5")
    found = outcome.frfs[f"{kind.replace(' ', '-')} 1"]
    # a Hann window leaks a little where the structure is lightly damped; what fits the block does not leak
    assert 0.5 < agreement(rig, found) < (2.5 if kind == "random" else 1.6)


def test_a_response_short_of_the_coherence_asked_for_is_told_with_its_cause(tmp_path):
    """Nothing is said where the coherence is good, or where no limit is set; a noisy channel is named in its band."""
    random = ('kind = "multisine"', 'kind = "random"\nduration = 20'), ("levels = [0.5, 2.0]", "levels = [1.0]")
    noisy = ("noise = 0.01", "noise = 2.0")
    unasked = ("[safety]", "[processing]\ncoherence = 0.0\n[safety]")
    told = {}
    for name, changes in {"good": (), "noisy": (noisy,), "unasked": (noisy, unasked)}.items():
        rig = shaker_rig(tmp_path, *random, *changes)
        messages = measure(rig, tmp_path / f"{name}.h5").messages
        told[name] = [m for m in messages if "coherence" in m]
    assert told["good"] == told["unasked"] == []
    assert len(told["noisy"]) == 1
    assert told["noisy"][0].startswith("random 1: coherence of 'a2' from 5 to 350 Hz is 0.")


def test_stepped_sine_up_and_down(tmp_path):
    changes = [
        ('kind = "multisine"', 'kind = "stepped sine"\nlines = 12\ndirections = ["up", "down"]'),
        ("levels = [0.5, 2.0]", "levels = [1.0]"),
    ]
    rig = shaker_rig(tmp_path, *changes)
    outcome = measure(rig, tmp_path / "out.h5")
    up, down = outcome.frfs["stepped-sine 1 up"], outcome.frfs["stepped-sine 1 down"]
    model = read_model(rig.beside("model.toml"))
    for found in (up, down):
        exact = frf(model.structure, [], found.frequency, found.outputs, found.inputs)
        z = np.abs(found.value - exact) / np.sqrt(found.variance)
        assert 0.5 < np.sqrt(np.mean(z**2)) < 1.6
    with open_session(tmp_path / "out.h5") as session:
        hits = session.runs[0].hits
    assert [h.info["direction"] for h in hits] == ["up"] * 12 + ["down"] * 12
    assert max(abs(h.info["off"]) for h in hits) <= 0.05


def test_realisations_of_stepped_sines_are_averaged(tmp_path):
    changes = [
        ('kind = "multisine"', 'kind = "stepped sine"\nlines = 12\nrealisations = 3\ndirections = ["up", "down"]'),
        ("levels = [0.5, 2.0]", "levels = [1.0]"),
    ]
    rig = shaker_rig(tmp_path, *changes)
    found = measure(rig, tmp_path / "out.h5").frfs
    assert list(found) == ["stepped-sine 1 up", "stepped-sine 1 down"]
    up = found["stepped-sine 1 up"]
    assert up.settings["basis"] == {str(run): list(range(12)) for run in (1, 2, 3)}
    assert found["stepped-sine 1 down"].settings["basis"] == {str(run): list(range(12, 24)) for run in (1, 2, 3)}
    assert 0.5 < agreement(rig, up) < 1.6
    each = []
    with open_session(tmp_path / "out.h5") as session:
        for run in session.runs:
            hits = run.hits[:12]
            each.append(
                tone_frf(run.recording(), [(h.start, h.stop) for h in hits], [h.info["frequency"] for h in hits])
            )
    assert up.variance is not None
    weight = 1 / np.array([one.variance for one in each], float)
    expected = np.sum(weight * np.array([one.value for one in each]), axis=0) / weight.sum(axis=0)
    np.testing.assert_allclose(up.value, expected, rtol=1e-9)
    np.testing.assert_allclose(up.variance, 1 / weight.sum(axis=0), rtol=1e-9)


def test_tones_are_measured_again_where_frames_were_lost(tmp_path):
    changes = [
        ('kind = "multisine"', 'kind = "stepped sine"\nlines = 8'),
        ("levels = [0.5, 2.0]", "levels = [1.0]"),
        ("[simulated.channel", "[simulated.faults]\ndropouts = 0.4\ndropout_frames = 77\n[simulated.channel"),
    ]
    rig = shaker_rig(tmp_path, *changes)
    outcome = measure(rig, tmp_path / "out.h5")
    with open_session(tmp_path / "out.h5") as session:
        run = session.runs[0]
        assert len(run.gaps()) > 5
        assert not any(h.start < at < h.stop for h in run.hits for at in run.gaps())
    found = outcome.frfs["stepped-sine 1 up"]
    assert found.frequency.size == 8
    assert agreement(rig, found) < 1.6


def test_a_recording_without_excitation(tmp_path):
    rig = shaker_rig(tmp_path, ('kind = "multisine"', 'kind = "none"\nduration = 3.0'))
    outcome = measure(rig, tmp_path / "out.h5")
    assert outcome.items == {"record": "complete"}
    with open_session(tmp_path / "out.h5") as session:
        recording = session.recordings()[0]
    assert recording.duration >= 3.0
    assert recording.data[1].std() == pytest.approx(0.01, rel=0.1)


class Eager(Quiet):
    """Asks for a picture after every block."""

    def wants(self):
        return True


RANDOM = (
    ('kind = "multisine"', 'kind = "random"\nduration = 10\ncontrol = "force"'),
    ("levels = [0.5, 2.0]", "levels = [1.0]"),
    ("[safety]", "[processing]\nsegment = 1024\n[safety]"),
)


def test_two_inputs_are_shown_once_enough_is_recorded_and_never_end_the_run(tmp_path):
    second = '[[channel]]\nname = "foot"\nrole = "reference"\nquantity = "acceleration"\nsensitivity = 0.1\nnode = "1"'
    rig = shaker_rig(tmp_path, *RANDOM, ("[generator]", f'{second}\ndirection = "x"\n[generator]'))
    display = Eager()
    outcome = measure(rig, tmp_path / "out.h5", display)
    assert outcome.items == {"random 1 #1": "complete"}
    assert display.last is not None
    assert display.last.curves is not None
    assert display.last.curves.names == ("a2 / force", "a2 / foot")


def test_a_dead_response_is_recorded_and_told(tmp_path):
    rig = shaker_rig(tmp_path, *RANDOM, ("noise = 0.01", "gain = 0"))
    display = Eager()
    outcome = measure(rig, tmp_path / "out.h5", display)
    assert outcome.items == {"random 1 #1": "complete"}
    assert display.last is not None
    assert display.last.curves is None
    assert any("no FRF of random 1" in m and "'a2' is constant" in m for m in outcome.messages)
    with open_session(tmp_path / "out.h5") as session:
        held = session.runs[0].hits[0]
        assert held.stop - held.start == 10 * 1024


def test_the_item_that_is_measured_is_marked_while_its_level_is_raised(tmp_path):
    class Watching(Display):
        def __init__(self):
            super().__init__()
            self.seen = []

        def wants(self):
            return not self.seen

        def show(self, snapshot):
            self.seen.append((snapshot.state, [p.key for p in snapshot.progress if p.current]))

    watching = Watching()
    measure(shaker_rig(tmp_path), tmp_path / "out.h5", watching)
    assert watching.seen[0] == ("raising to 0.5 N RMS", ["multisine 0.5 #1"])
    assert watching.seen[-1][1] == ["multisine 2 #1"]
