"""Welch: against scipy, across breaks, in streams, and what it refuses."""

import numpy as np
import pytest
from scipy.signal import csd

from labnnum.errors import ChannelError, EstimationError
from labnnum.recording import Channel, Recording
from labnnum.spectra import Welch

FORCE = Channel("f", "force", "reference")
RATE = 512.0


def channels(count: int) -> tuple[Channel, ...]:
    return (FORCE, *(Channel(f"a{k}") for k in range(count - 1)))


def noise(count: int, n: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal((count, n)) + np.arange(count)[:, None]


@pytest.mark.parametrize("window", ["hann", "boxcar", "flattop"])
@pytest.mark.parametrize("detrend", ["constant", "linear", "none"])
@pytest.mark.parametrize(("n", "overlap"), [(128, 0.5), (101, 0.25), (64, 0.0), (100, 0.8)])
def test_densities_equal_those_of_scipy(window, detrend, n, overlap):
    data = noise(3, 1500)
    spectra = Welch(n, window, overlap, detrend, pairs="all")(Recording(channels(3), data, RATE))
    kept = n - Welch(n, window, overlap).hop
    for i in range(3):
        for j in range(3):
            f, s = csd(
                data[i], data[j], RATE, window, n, kept, detrend=False if detrend == "none" else detrend
            )  # fmt: skip
            # rounding only: sums of some tens of segments in another order
            np.testing.assert_allclose(spectra.cross[i, j], s, atol=1e-13 * np.abs(s).max())
    np.testing.assert_array_equal(spectra.frequency, f)


def test_only_pairs_with_inputs_are_averaged_unless_all_are_asked_for():
    recording = Recording(channels(3), noise(3, 2000), RATE)
    some, all_ = Welch(128)(recording), Welch(128, pairs="all")(recording)
    assert np.isnan(some.cross[1, 2]).all()
    mask = ~np.isnan(some.cross)
    np.testing.assert_allclose(some.cross[mask], all_.cross[mask], rtol=1e-12)
    responses = Recording(channels(3)[1:], noise(2, 2000), RATE)
    assert np.isfinite(Welch(128)(responses).cross).all()


def test_no_segment_spans_a_break_or_an_excluded_range():
    data = noise(2, 4000)
    whole = Recording(channels(2), data, RATE, breaks=(1000, 2500), excluded=((1500, 1700),))
    parts = [
        Recording(channels(2), data[:, a:b], RATE) for a, b in ((0, 1000), (1000, 1500), (1700, 2500), (2500, 4000))
    ]
    one, pooled = Welch(256)(whole), Welch(256)(parts)
    np.testing.assert_array_equal(one.cross, pooled.cross)
    assert one.n_segments == pooled.n_segments == 6 + 2 + 5 + 10
    assert one.n_averages == pooled.n_averages


def test_segments_of_bursts_wait_for_the_start_of_one_after_a_gap():
    data = noise(2, 4000)
    told = {"burst": 500, "bursts": (0, 500, 1000, 1500, 2170, 2670, 3170, 3670)}
    whole = Recording(channels(2), data, RATE, breaks=(1720,), excluded=((400, 450),), **told)
    starts = (500, 1000, 2170, 2670, 3170)
    parts = [Recording(channels(2), data[:, a : a + 500], RATE) for a in starts]
    welch = Welch(500, "boxcar", 0.0)
    found = welch(whole)
    np.testing.assert_allclose(found.cross, welch(parts).cross, rtol=1e-12)
    assert (found.n_segments, found.settings["burst"]) == (5, True)
    assert "burst" not in Welch(300, "boxcar", 0.0)(whole).settings
    assert "burst" not in Welch(500, "hann", 0.0)(whole).settings
    nowhere = Recording(channels(2), data, RATE, burst=500)
    with pytest.raises(EstimationError, match="no span holds a segment of 500 samples from the start of a burst"):
        welch(nowhere)


def test_whole_periods_lose_their_transient_and_are_marked():
    data = noise(2, 4000)
    repeated = Recording(channels(2), data, RATE, period=250, drop_periods=2)
    found = Welch(500, "boxcar", 0.0)(repeated)
    later = Welch(500, "boxcar", 0.0)(Recording(channels(2), data[:, 500:], RATE))
    np.testing.assert_array_equal(found.cross, later.cross)
    assert found.settings["periodic"]
    assert "periodic" not in later.settings
    assert "periodic" not in Welch(400, "boxcar", 0.0)(repeated).settings
    assert "periodic" not in Welch(500, "hann", 0.0)(repeated).settings
    with pytest.raises(EstimationError, match="no span holds a segment of 3750 samples after its 2 transient periods"):
        Welch(3750, "boxcar", 0.0)(repeated)


def test_a_break_that_is_ignored_would_show():
    data = noise(2, 4000)
    data[:, 2000:] += 50
    clean = Recording(channels(2), data, RATE, breaks=(2000,))
    joined = Recording(channels(2), data, RATE)
    assert Welch(256)(joined).auto("f")[2] > 100 * Welch(256)(clean).auto("f")[2]


@pytest.mark.parametrize("block", [1, 63, 64, 65, 1000, 5000])
@pytest.mark.parametrize("overlap", [0.0, 0.5, 0.8])
def test_any_block_size_gives_the_bits_of_one_pass(block, overlap):
    welch = Welch(64, overlap=overlap)
    data = noise(3, 5000)
    once = welch(Recording(channels(3), data, RATE, breaks=(1777,)))
    running = welch.start(channels(3), RATE)
    for part in (data[:, :1777], data[:, 1777:]):
        for at in range(0, part.shape[1], block):
            running.add(part[:, at : at + block])
        running.gap()
    streamed = running.spectra()
    assert np.array_equal(streamed.cross, once.cross, equal_nan=True)
    assert (streamed.n_segments, streamed.n_averages) == (once.n_segments, once.n_averages)


def test_a_look_at_the_running_average_leaves_no_trace():
    data = noise(2, 3000)
    welch = Welch(128)
    running, quiet = welch.start(channels(2), RATE), welch.start(channels(2), RATE)
    for at in range(0, 3000, 500):
        running.add(data[:, at : at + 500])
        quiet.add(data[:, at : at + 500])
        seen = running.spectra()
    assert np.array_equal(seen.cross, quiet.spectra().cross, equal_nan=True)


def test_every_whole_segment_counts_at_once_and_is_averaged():
    running = Welch(128, overlap=0.5).start(channels(2), RATE)
    data = noise(2, 1000)
    for whole, (a, b) in ((0, (0, 127)), (1, (127, 128)), (1, (128, 191)), (2, (191, 192)), (5, (192, 400))):
        running.add(data[:, a:b])
        assert running.n_segments == whole
        if whole:
            assert running.spectra().n_segments == whole


def test_monitors_enter_no_estimate():
    listed = (*channels(2), Channel("t", "temperature", "monitor"))
    data = np.vstack([noise(2, 2000), np.full((1, 2000), 293.0)])
    spectra = Welch(128)(Recording(listed, data, RATE))
    assert [c.name for c in spectra.channels] == ["f", "a0"]
    np.testing.assert_array_equal(spectra.cross, Welch(128)(Recording(channels(2), data[:2], RATE)).cross)


def test_a_segment_longer_than_the_data_is_refused_with_the_remedy():
    with pytest.raises(EstimationError, match=r"n_segment 4096 is longer than .* 2000 samples; lower n_segment"):
        Welch(4096)(Recording(channels(2), noise(2, 2000), RATE))
    with pytest.raises(EstimationError, match="longest unbroken stretch of 1000"):
        Welch(1500)(Recording(channels(2), noise(2, 2000), RATE, breaks=(1000,)))


def test_a_single_tapered_segment_is_refused():
    with pytest.raises(EstimationError, match="one average has no coherence"):
        Welch(1500)(Recording(channels(2), noise(2, 2000), RATE))


def test_dead_channels_and_gaps_are_named():
    data = noise(2, 2000)
    data[1] = 3.0
    with pytest.raises(ChannelError, match="'a0' is constant"):
        Welch(128)(Recording(channels(2), data, RATE))
    data = noise(2, 2000)
    data[1, 700] = np.nan
    with pytest.raises(ChannelError, match="'a0' is not finite at sample 700"):
        Welch(128)(Recording(channels(2), data, RATE))
    cut = Recording(channels(2), data, RATE, excluded=((700, 701),))
    assert np.isfinite(Welch(128)(cut).auto("a0")).all()
    running = Welch(128).start(channels(2), RATE)
    running.add(data)
    with pytest.raises(ChannelError, match="a0"):
        running.spectra()


def test_recordings_that_differ_are_not_pooled():
    a = Recording(channels(2), noise(2, 2000), RATE)
    with pytest.raises(EstimationError, match="rate"):
        Welch(128)([a, Recording(channels(2), noise(2, 2000), 2 * RATE)])
    with pytest.raises(ChannelError, match="channels differ"):
        Welch(128)([a, Recording((FORCE, Channel("other")), noise(2, 2000), RATE)])
    with pytest.raises(EstimationError, match="no recording"):
        Welch(128)([])


@pytest.mark.parametrize(
    "options", [{"n_segment": 1}, {"n_segment": 12.5}, {"overlap": 1.0}, {"overlap": -0.1}, {"window": "hanning"},
                {"detrend": "mean"}, {"pairs": "some"}]
)  # fmt: skip
def test_impossible_settings_are_refused_at_once(options):
    with pytest.raises(EstimationError):
        Welch(**({"n_segment": 64} | options))


def test_an_unknown_channel_is_named_with_those_there_are():
    spectra = Welch(128)(Recording(channels(2), noise(2, 2000), RATE))
    with pytest.raises(ChannelError, match="no channel 'x'; there are f, a0"):
        spectra.auto("x")
