"""Linear physics under a nonlinear law: what the quietest level shows is put right before the law is sought."""

from dataclasses import replace

import numpy as np
import pytest

from labnnum.diagnosis import diagnose, observe_all
from labnnum.diagnosis.engine import Engine
from labnnum.diagnosis.nonlinear.bench import Bench
from labnnum.diagnosis.nonlinear.explore import calmed
from labnnum.diagnosis.nonlinear.force import N_P
from labnnum.diagnosis.nonlinear.locate import Lead, Spot
from labnnum.diagnosis.nonlinear.mended import Fault, mended
from labnnum.diagnosis.nonlinear.study import from_calm
from labnnum.diagnosis.scatter import Scatter
from labnnum.mechanisms.base import Place, Term
from labnnum.mechanisms.channel_delay import ChannelDelay
from labnnum.mechanisms.channel_gain import ChannelGain
from labnnum.mechanisms.channel_highpass import ChannelHighpass
from labnnum.mechanisms.channel_swap import ChannelSwap
from labnnum.nonlinear import Element
from labnnum.structures import Chain
from labnnum.structures.chain import Link
from tests.diagnosis.test_nonlinear import FORCE, OUTPUTS, chain, joint_23, runs

CLEARANCE = Element("clearance", joint_23(), (500.0, 0.004))
CUBIC = Element("cubic", joint_23(), (2e4,))


def fault(mechanism, value=(), **data):
    """A fault of a channel, and its parameters."""
    return Fault(Term(mechanism, Place("channel", "a1"), (), np.zeros((0, 1)), data=data), np.array(value, float))


FAULTS = {
    "gain": fault(ChannelGain(), (0.3,), channel=0),
    "delay": fault(ChannelDelay(), (0.01,), channel=1),
    "high-pass": fault(ChannelHighpass(), (0.5,), channel=2),
    "exchanged": fault(ChannelSwap(), (), swap=(0, 2)),
    "inverted": fault(ChannelSwap(), (), invert=1),
    "gain of the input": fault(ChannelGain(), (-0.2,), channel=3),
    "inverted input": fault(ChannelSwap(), (), invert=3),
}


@pytest.mark.parametrize("which", FAULTS)
def test_a_fault_that_is_put_on_and_taken_off_leaves_what_was(which):
    plain = runs([], chain(), levels=(1.0,))[0]
    wrong = mended(plain, [FAULTS[which]], back=True)
    again = mended(wrong, [FAULTS[which]])
    for made in (wrong, again):
        change = np.linalg.norm(made.frf.value - plain.frf.value) / np.linalg.norm(plain.frf.value)
        assert bool(change > 0.01) == (made is wrong)
        change = np.linalg.norm(made.run.y * plain.run.u.max() - plain.run.y * made.run.u.max())
        assert bool(change > 0.01 * np.linalg.norm(plain.run.y * plain.run.u.max())) == (made is wrong)
    assert again.run.noise == pytest.approx(plain.run.noise, nan_ok=True)
    assert again.frf.variance == pytest.approx(plain.frf.variance)


@pytest.mark.parametrize("which", ["gain", "delay", "exchanged", "inverted", "gain of the input", "inverted input"])
def test_samples_of_a_faulty_channel_are_mended_like_its_spectrum(which):
    plain = runs([], chain(), levels=(1.0,))[0]
    x = plain.recordings[0].data
    wrong = mended(plain, [FAULTS[which]], back=True)
    assert not np.allclose(wrong.recordings[0].data, x, atol=1e-3)
    assert mended(wrong, [FAULTS[which]]).recordings[0].data == pytest.approx(x, abs=1e-4 * np.abs(x).max())
    seen = observe_all([wrong.recordings[0]])[0]
    assert seen.frf.value == pytest.approx(wrong.frf.value, abs=1e-3 * np.abs(wrong.frf.value).max())


@pytest.mark.parametrize(("mechanism", "value", "lost"), [
    (ChannelGain(), -0.9999, True), (ChannelGain(), -0.5, False), (ChannelHighpass(), 1e3, False),
])  # fmt: skip
def test_a_channel_is_lost_where_it_lets_nothing_through_at_any_frequency(mechanism, value, lost):
    assert fault(mechanism, (value,), channel=1).lost is lost


def test_channels_that_are_exchanged_are_not_lost():
    assert not FAULTS["exchanged"].lost


def exchanged(observation):
    """The run with the first two responses at each other's input of the converter."""
    order = [1, 0, 2]
    run, frf = observation.run, observation.frf
    return replace(
        observation, run=replace(run, y=run.y[order], noise=run.noise[order]),
        frf=replace(frf, value=frf.value[order], variance=frf.variance[order]),
    )  # fmt: skip


def test_channels_that_are_exchanged_do_not_hide_a_law():
    found = diagnose(chain(), [exchanged(o) for o in runs([CUBIC], chain(), levels=(1.0, 9.0))])
    assert [n.term.mechanism.id for n in found.named] == ["cubic-stiffness", "channel-swap"], found.summary
    assert found.named[0].value == pytest.approx([2e4], rel=0.05)
    assert str(found.named[1].place) == "channel a1-a2"


def test_a_softer_joint_does_not_hide_a_slider_that_sticks():
    """At the quietest level both are joints that differ; the slider is the one that the loudest level would change."""
    links = [Link("1", "ground", "k1", 4.0), Link("1", "2", 1000.0, 4.0), Link("2", "3", 1000.0, 4.0)]
    softer = Chain(chain().masses, (*links, Link("3", "4", 600.0, 2.4)), chain().parameters)
    found = diagnose(chain(), runs([Element("jenkins", joint_23(), (800.0, 3.0))], softer, levels=(1.0, 9.0)))
    named = {n.term.mechanism.id: n for n in found.named}
    assert set(named) == {"stick-slip", "joint-stiffness"}, found.summary
    assert named["stick-slip"].value[0] == pytest.approx(800.0, rel=0.03)
    assert named["joint-stiffness"].value[0] == pytest.approx(-0.4, abs=0.03)
    assert str(named["joint-stiffness"].place) == "element 3-4"


def test_what_is_linear_at_every_level_gets_no_law():
    """Exchanged channels alone: the signs are the converter's."""
    found = diagnose(chain(), [exchanged(o) for o in runs([], chain())])
    assert [n.term.mechanism.id for n in found.named] == ["channel-swap"], found.summary


def test_a_strong_law_that_bends_the_base_is_found_from_the_base_of_the_quietest_level():
    """From half its stiffness and a bent base a clearance does not find back along the way it came."""
    made = [o.run for o in runs([CLEARANCE], chain())]
    engine = Engine(chain(), OUTPUTS, (FORCE,), (2 * np.pi * 0.5, 2 * np.pi * 12))
    bench = Bench(engine, engine.start(), tuple(made), Scatter(), ()).on(120)
    calm = calmed(engine, engine.start(), made[0], Scatter())
    p = np.zeros(N_P)
    p[:2] = 250.0, 0.003
    lead = Lead(Spot(Place("joint", "2", "3"), "x", joint_23()), "clearance", p, 0.0)
    bent = calm.x.copy()
    bent[0] *= 0.9
    stuck = bench.direct([bent], lead, 4)
    again = from_calm(bench, calm.x, stuck)
    assert again.cost < 0.5 * stuck.cost
    assert again.made.law(0)[0] == pytest.approx([500.0, 0.004], rel=0.1)


def test_a_gain_that_the_errors_of_a_sound_model_excuse_is_named_beside_the_law():
    """A channel a sixth too low: the law is explained all the same."""
    low = fault(ChannelGain(), (-0.16,), channel=1)
    found = diagnose(chain(), [mended(o, [low], back=True) for o in runs([CUBIC], chain())])
    assert [n.term.mechanism.id for n in found.named] == ["cubic-stiffness", "channel-gain"], found.summary
    assert str(found.named[1].place) == "channel a2"
    assert found.named[1].value[0] == pytest.approx(-0.16, abs=0.03)


def test_a_dead_channel_does_not_hide_a_law():
    """Taking its fault off would leave no channel: it stays as it was recorded."""
    dead = fault(ChannelGain(), (-0.9999,), channel=1)
    found = diagnose(chain(), [mended(o, [dead], back=True) for o in runs([CUBIC], chain(), levels=(1.0, 9.0))])
    assert found.named, found.summary
    assert found.named[0].term.mechanism.id == "cubic-stiffness", found.summary
    assert found.named[0].value == pytest.approx([2e4], rel=0.1)
