"""What a diagnosis takes a recording for: hits by their input, noise and sweeps by their longest stretch."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.signal import lfilter

from labnnum.diagnosis.observe import observe, observe_all
from labnnum.diagnosis.pool import pool
from labnnum.errors import ChannelError, EstimationError
from labnnum.recording import Channel, Recording
from labnnum.simulation import simulate
from labnnum.structures.chain import Chain, Link
from labnnum.system import system

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


def test_a_light_blow_in_a_long_noisy_record_is_a_hit():
    """Noise holds more of the energy than the blow does, and is coarse: most of its samples are one step or none."""
    u = np.zeros(60_000)
    u[6_000:6_010] = np.sin(np.pi * np.arange(1, 11) / 11)
    coarse = np.round(np.random.default_rng(3).standard_normal(u.size) * 0.7) * 0.02
    assert observe_all([Recording(CHANNELS, answered(u + coarse), RATE)])[0].kind == "hammer"
    assert observe_all([Recording(CHANNELS, answered(coarse), RATE)])[0].kind == "random"
    assert (coarse**2).sum() > (u**2).sum()


ENDS = ("ground", "1", "2", "3")
CHAIN = Chain(dict.fromkeys("123", 1.0), tuple(Link(a, b, 3e4, 8.0) for a, b in pairwise(ENDS)))


def struck_at(*points):
    """Hits at points of a chain, seen by two sensors: a recording a point, as a roving plan stores them."""
    out = []
    for point in points:
        channels = (
            Channel("force", "force", "reference", point, "x"),
            Channel("a1", "acceleration", "response", "1", "x"),
            Channel("a3", "acceleration", "response", "3", "x"),
        )
        u = np.tile(np.r_[np.zeros(20), np.hanning(9), np.zeros(3067)], 3)
        y = simulate(system(CHAIN, [], channels[1:], channels[:1]), u, 1 / RATE)[:, -u.size :]
        out.append(Recording(channels, np.vstack([u, y]), RATE, breaks=(3096, 2 * 3096), label=point))
    return out


def test_hits_at_several_points_are_several_inputs():
    (seen,) = observe_all(struck_at("1", "2", "3"))
    assert (seen.kind, [c.name for c in seen.frf.inputs]) == ("hammer", ["force 1:x", "force 2:x", "force 3:x"])
    made = system(CHAIN, [], seen.frf.outputs, seen.frf.inputs)
    s = seen.frf.settings["window_decay"] + 1j * seen.frf.omega
    moved = np.linalg.solve(made.M * s[:, None, None] ** 2 + made.C * s[:, None, None] + made.K, made.load + 0j)
    exact = np.moveaxis(s[:, None, None] ** 2 * (made.acceleration @ moved), 0, 2)
    np.testing.assert_allclose(seen.frf.value, exact, atol=0.02 * np.abs(exact).max())


def test_recordings_of_sensors_that_moved_are_refused_with_their_places():
    first, second = struck_at("1", "1")
    moved = replace(second, channels=(*second.channels[:2], replace(second.channels[2], node="4")), label="second")
    with pytest.raises(ChannelError, match="second: its channels, or their places, differ"):
        pool(observe_all([first, replace(moved, data=10 * moved.data)]))


def test_nothing_left_to_use_is_said():
    with pytest.raises(EstimationError, match="all of it is excluded"):
        observe_all([noise(5_000, excluded=((0, 5_000),))])
