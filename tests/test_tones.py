"""Stepped sines: exact tones, harmonics, honest variance, both directions."""

import numpy as np
import pytest
from scipy.signal import lfilter

from labnnum.errors import ChannelError, EstimationError
from labnnum.excitation import stepped_sine
from labnnum.recording import Channel, Recording
from labnnum.sine import tone_frf
from labnnum.tones import stepped, tones

RATE = 1000.0
CHANNELS = (Channel("f", "force", "reference"), Channel("x", "displacement"))


def run(noise=0.0, cubic=0.0, direction="up-down", seed=0, **options):
    plan = stepped_sine(RATE, (10.0, 90.0), 9, direction=direction, settle=0.2, **options)
    f = plan.drive().samples
    x = lfilter([1.0], [1, -0.8], f + cubic * f**3) + 0.5
    data = np.stack([f, x + noise * np.random.default_rng(seed).standard_normal(f.size)])
    return Recording(CHANNELS, data, RATE), plan


def truth(f):
    return 1 / (1 - 0.8 * np.exp(-2j * np.pi * f / RATE))


def test_both_directions_are_exact():
    recording, plan = run()
    up, down = stepped(recording, plan)
    assert (up.settings["direction"], down.settings["direction"]) == ("up", "down")
    for frf in (up, down):
        assert frf.frequency.size == 9
        np.testing.assert_allclose(frf.value[0, 0], truth(frf.frequency), rtol=1e-9)


@pytest.mark.parametrize("direction", ["up", "down"])
def test_one_direction_gives_one_frf(direction):
    (frf,) = stepped(*run(direction=direction))
    assert frf.settings["direction"] == direction
    np.testing.assert_allclose(np.diff(frf.frequency), 10.0)


def test_the_third_harmonic_of_a_cubic_is_found():
    recording, plan = run(cubic=0.1)
    found = tones(recording, plan)
    amplitude = np.sqrt(2)
    f = plan.frequency
    want = 0.1 * amplitude**3 / 4 * np.abs(truth(3 * f))
    np.testing.assert_allclose(np.abs(found.harmonics[1, 1]), want, rtol=1e-6)
    assert np.abs(found.harmonics[1, 0]).max() < 1e-9


def test_the_variance_is_honest():
    errors = []
    for seed in range(40):
        for frf in stepped(*run(noise=0.3, seed=seed)):
            errors.append(np.abs(frf.value[0, 0] - truth(frf.frequency)) ** 2 / frf.variance[0, 0])
    assert np.mean(errors) == pytest.approx(1.0, rel=0.12)


def test_what_does_not_fit_is_refused():
    recording, plan = run()
    with pytest.raises(EstimationError, match="across a gap; record that step again"):
        stepped(Recording(CHANNELS, recording.data, RATE, breaks=(int(plan.start[2] + plan.settle[2]) + 5,)), plan)
    with pytest.raises(EstimationError, match="rate"):
        stepped(Recording(CHANNELS, recording.data, 2 * RATE), plan)
    with pytest.raises(EstimationError, match="outside the recording"):
        stepped(recording, plan, start=100)
    with pytest.raises(ChannelError, match="one input"):
        stepped(recording.select(["x"]), plan)
    short, brief = run(cycles=1)
    brief_plan = stepped_sine(RATE, (300.0, 400.0), 2, settle=0.0, cycles=1)
    with pytest.raises(EstimationError, match="too few"):
        tones(short, brief_plan)
    assert brief.frequency.size == 18
    silent = Recording(CHANNELS, recording.data * np.array([[0.0], [1.0]]), RATE)
    with pytest.raises(EstimationError, match="silent"):
        stepped(silent, plan)


def test_a_gap_inside_a_tone_is_not_averaged_across():
    t = np.arange(1000) / RATE
    pieces = [np.stack([np.sin(2 * np.pi * f * t), 3 * np.sin(2 * np.pi * f * t + 0.5)]) for f in (20.0, 47.0)]
    data = np.hstack([np.delete(p, np.s_[300:337], axis=1) for p in pieces])
    stretches = [(0, 963), (963, 1926)]
    found = tone_frf(Recording(CHANNELS, data, RATE, breaks=(300, 1263)), stretches, [20.0, 47.0])
    np.testing.assert_allclose(found.value[0, 0], 3 * np.exp(0.5j), rtol=1e-9)
    hidden = tone_frf(Recording(CHANNELS, data, RATE), stretches, [20.0, 47.0])
    assert np.max(hidden.variance) > 1e-6 > 1e6 * np.max(found.variance)
    torn = Recording(CHANNELS, data, RATE, breaks=(300, *range(963, 1926, 9)))
    assert tone_frf(torn, stretches, [20.0, 47.0]).frequency.tolist() == [20.0]
    with pytest.raises(EstimationError, match="no tone lasts for a cycle without a break"):
        tone_frf(torn, stretches[1:], [47.0])
