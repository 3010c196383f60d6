"""What a diagnosis takes a recording for: hits by their input, noise and sweeps by their longest stretch."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from labnnum.diagnosis.observe import observe, observe_all
from labnnum.errors import EstimationError
from labnnum.recording import Channel, Recording

RATE = 512.0
CHANNELS = (Channel("f", "force", "reference", "1", "z"), Channel("a", "acceleration", "response", "2", "z"))


def answered(u):
    """What a resonance at 60 Hz makes of an input, with a little noise."""
    pole = np.exp((-2.0 + 2j * np.pi * 60.0) / RATE)
    y = lfilter([1.0, -1.0], np.real(np.poly([pole, np.conj(pole)])), u)
    return np.stack([u, y + 1e-3 * np.std(y) * np.random.default_rng(1).standard_normal(u.size)])


def noise(n, **more):
    return Recording(CHANNELS, answered(np.random.default_rng(0).standard_normal(n)), RATE, **more)


def blows(lengths, width):
    """Pieces of these lengths, a blow of `width` samples a tenth into each."""
    pulse = np.sin(np.pi * np.arange(1, width + 1) / (width + 1))
    pieces = []
    for n in lengths:
        u = np.zeros(n)
        u[n // 10 : n // 10 + width] = pulse
        pieces.append(answered(u))
    return Recording(CHANNELS, np.hstack(pieces), RATE, breaks=tuple(np.cumsum(lengths)[:-1]))


def test_a_shaker_run_of_the_bench_is_no_hammer_session():
    """The bench marks where the level was reached by a break, and what came before and after as not to be used."""
    n, first, last = 40_000, 3_000, 39_500
    whole = noise(n, breaks=(first,), excluded=((0, first), (last, n)))
    alone = replace(whole, data=whole.data[:, first:last], breaks=(), excluded=())
    seen, wanted = observe_all([whole])[0], observe_all([alone])[0]
    assert seen.kind == wanted.kind == "random"
    np.testing.assert_array_equal(seen.frf.value, wanted.frf.value)
    np.testing.assert_array_equal(seen.recordings[0].data, alone.data)
    assert (seen.level, seen.peaks) == (wanted.level, wanted.peaks)
    assert observe(whole).kind == "random"


def test_noise_with_a_gap_is_its_longest_stretch():
    cut = noise(40_000, breaks=(9_000,), overloads=((1, 8_990, 9_010),))
    seen = observe_all([cut])[0]
    assert (seen.kind, seen.recordings[0].n_samples) == ("random", 31_000)
    assert seen.recordings[0].overloads == ((1, 0, 10),)


def test_a_sine_that_sweeps_with_a_gap_is_no_hammer_session():
    t = np.arange(30_000) / RATE
    u = np.sin(2 * np.pi * (5 * t + 1.5 * t**2))
    assert observe_all([Recording(CHANNELS, answered(u), RATE, breaks=(700,))])[0].kind == "random"


@pytest.mark.parametrize("width", [3, 30])
def test_pieces_with_a_blow_in_each_are_hits(width):
    seen = observe_all([blows([1024] * 4, width)])[0]
    assert (seen.kind, seen.frf.n_averages) == ("hammer", 4)


def test_one_accepted_hit_among_rejected_ones_is_a_hit():
    three = blows([1024] * 3, 10)
    assert observe_all([replace(three, excluded=((0, 1024), (2048, 3072)))])[0].kind == "hammer"


def test_nothing_left_to_use_is_said():
    with pytest.raises(EstimationError, match="all of it is excluded"):
        observe_all([noise(5_000, excluded=((0, 5_000),))])
