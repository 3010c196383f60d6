"""Samples that pile up at the end of a channel's range, and runs that a channel which clips leaves fit for use."""

from dataclasses import replace

import numpy as np
import pytest

from labnnum.diagnosis.gates import OFTEN_PILED, PILED, TIMES, pass_gates
from labnnum.diagnosis.rails import clipping
from labnnum.nonlinear import Element
from tests.diagnosis.test_nonlinear import chain, joint_23, runs

N = 40_000


def noise(seed=0, smooth=1):
    x = np.random.default_rng(seed).standard_normal(N + smooth - 1)
    return np.convolve(x, np.ones(smooth) / np.sqrt(smooth), "valid")


@pytest.mark.parametrize("smooth", [1, 8])
def test_noise_that_the_amplifier_cuts_off_before_the_recorder_adds_its_own(smooth):
    """What is cut off lies within the recorder's noise around the rail and not at the very end of the range."""
    x = np.clip(noise(1, smooth), -1.8, 1.8) + 0.0025 * noise(2)
    found = clipping(x)
    assert found.score > OFTEN_PILED
    assert found.times > TIMES
    assert found.level == pytest.approx(1.8, rel=0.02)


def test_peaks_of_a_single_sample_at_the_rail():
    x = noise(3)
    assert clipping(np.clip(x, *np.sort(x)[[29, -30]])).score >= PILED / 2


@pytest.mark.parametrize("what", ["noise", "smooth", "sine", "sweep", "squares", "periods"])
def test_what_ends_by_itself_does_not_pile_up(what):
    t = np.arange(N)
    x = {
        "noise": noise(4), "smooth": noise(4, 30), "sine": np.sin(0.0123 * t), "squares": noise(4) ** 2,
        "sweep": np.sin(5e-6 * t**2) / (0.03 + (t / N - 0.5) ** 2), "periods": np.tile(noise(4)[:800], N // 800),
    }[what]  # fmt: skip
    assert clipping(x + 1e-4 * noise(5)).score == 0


@pytest.mark.parametrize("periods", [1, 12, 40])
@pytest.mark.parametrize("cut", [False, True])
def test_a_peak_that_every_period_repeats_is_no_rail(periods, cut):
    """Two samples beside its top, alike, and none just below: at forty periods eighty, on either side of nothing."""
    t = np.arange(1000) - 499.5
    x = np.cos(0.15 * t) * np.exp(-np.abs(t) / 200) - 0.1 * (t > 10)
    x = np.clip(x, -0.6, 0.6) if cut else x
    x = np.tile(x, periods) + 1e-5 * noise(6)[: periods * 1000]
    assert bool(clipping(x, periods).score > 0) is cut


def clipped_in_the_loudest(elements):
    """Runs of a chain at two levels, of which the louder one ends at the rail of channel a2 in noise."""
    every = runs(elements, chain(), levels=(1.0, 9.0))
    low, high = (replace(o, kind="random", distortion={}) for o in (every[0], every[-1]))
    clip = clipping(np.clip(noise(1), -1.8, 1.8) + 0.0025 * noise(2))
    peaks = {n: p * (0.5 if n == "a2" else 1.0) for n, p in high.peaks.items()}
    return low, replace(high, clipped={"a2": clip}, peaks=peaks)


def test_the_loud_run_is_kept_without_the_channel_where_others_change_with_level_too():
    bent = pass_gates(clipped_in_the_loudest([Element("cubic", joint_23(), (2e4,))]))
    straight = pass_gates(clipped_in_the_loudest([]))
    assert [n.place.id for n in (*bent.named, *straight.named)] == ["a2", "a2"]
    assert [[c.name for c in o.frf.outputs] for o in bent.usable] == [["a1", "a4"]] * 2
    assert [[c.name for c in o.frf.outputs] for o in straight.usable] == [["a1", "a2", "a4"]]
