"""What coherence mixes, told apart: shares that add up to what it lacks, and that are the ones that were put in."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.signal import lfilter

from labnnum.errors import ChannelError, EstimationError
from labnnum.estimators import H1, Hits, Welch
from labnnum.excitation import chirp, multisine, random
from labnnum.recording import Channel, Recording
from labnnum.split import split_hits, split_periods, split_record
from labnnum.split.base import ALL, BOTH, DISTORTION, ENDS, EVEN, LEAKAGE, NOISE, ODD, RINGING, SCATTER, TRANSIENT

RATE, N = 512.0, 1024
CHANNELS = (Channel("f", "force", "reference"), Channel("x", "displacement"))


def poles(frequency, ratio):
    """Denominator of a resonance."""
    p = np.exp(2 * np.pi * frequency / RATE * (-ratio + 1j * np.sqrt(1 - ratio**2)))
    return np.real(np.poly([p, np.conj(p)]))


A = poles(60.0, 0.01)


def respond(f, cubic=0.0, square=0.0):
    return lfilter([1.0], A, f + cubic * f**3 + square * f**2)


# -------------------------------------------------------------------- periods


def played(seed, periods=6, noise=0.0, cubic=0.0, square=0.0, settled=False, drop=1):
    """A recording that begins at rest (or long after it began), what is noise free of it, and the drive."""
    before = 40 if settled else 0
    drive = multisine(RATE, N, (5.0, 200.0), seed=seed, n_periods=periods + before, detection=4, grid_seed=7)
    f = drive.samples
    clean = respond(f, cubic, square)[before * N :]
    data = np.stack([f[before * N :], clean + noise * np.random.default_rng(900 + seed).standard_normal(clean.size)])
    return Recording(CHANNELS, data, RATE, period=N, drop_periods=drop), clean, drive


def amplitudes(x):
    return np.fft.rfft(x.reshape(-1, N), axis=1) * 2 / N


def adds_up(split):
    np.testing.assert_allclose(sum(split.parts.values()), 1 - split.coherence, atol=1e-12)


def test_shares_of_periods_add_up_to_what_ordinary_coherence_lacks():
    runs = [played(s, noise=0.3, cubic=0.1) for s in (1, 2, 3)]
    lines = runs[0][2].lines
    split = split_periods([r for r, _, _ in runs], lines)
    adds_up(split)
    plain = [Recording(CHANNELS, r.data, RATE) for r, _, _ in runs]
    frf = H1(Welch(N, "boxcar", 0.0, "none"))(plain)
    at = np.searchsorted(frf.frequency, split.frequency)
    np.testing.assert_allclose(frf.frequency[at], split.frequency)
    np.testing.assert_allclose(split.coherence, frf.coherence[:, at], atol=1e-9)


def test_noise_of_periods_is_the_noise_that_was_put_in():
    noise = 0.5
    split = split_periods([played(s, noise=noise, settled=True)[0] for s in (1, 2)])
    _, clean, drive = played(1, settled=True)
    power = np.abs(amplitudes(clean)[0, drive.lines]) ** 2 + 4 * noise**2 / N
    wanted = (1 - 1 / 12) * 4 * noise**2 / N / power
    found = split.shares(0, 5.0, 200.0)
    assert found[NOISE].value == pytest.approx(wanted.mean(), rel=0.1)
    assert found[NOISE].seen
    assert not found[DISTORTION].seen
    assert not found[TRANSIENT].seen
    assert not found[ODD].seen


def test_distortion_of_realisations_is_what_the_cubic_spreads():
    cubic, count = 0.1, 8
    runs = [played(s, cubic=cubic, noise=0.02, settled=True) for s in range(count)]
    split = split_periods([r for r, _, _ in runs])
    lines = runs[0][2].lines
    u = np.array([amplitudes(r.data[0])[0, lines] for r, _, _ in runs])
    y = np.array([amplitudes(clean)[0, lines] for _, clean, _ in runs])
    h = np.sum(u.conj() * y, axis=0) / np.sum(np.abs(u) ** 2, axis=0)
    wanted = np.sum(np.abs(y - h * u) ** 2, axis=0) / np.sum(np.abs(y) ** 2, axis=0)  # without noise nothing else is
    found = split.shares(0, 5.0, 200.0)
    assert found[DISTORTION].value == pytest.approx(wanted.mean(), rel=0.03)
    assert found[DISTORTION].seen
    assert abs(found[NOISE].value) < 0.05 * found[DISTORTION].value
    assert not found[TRANSIENT].seen


def test_detection_lines_tell_odd_from_even_distortion():
    odd = split_periods(played(3, cubic=0.1, noise=0.02, settled=True)[0])
    even = split_periods(played(3, square=0.1, noise=0.02, settled=True)[0])
    assert DISTORTION not in odd.parts
    assert "another realisation" in odd.remarks[0]
    found, other = odd.shares(0, 20.0, 180.0), even.shares(0, 20.0, 180.0)
    assert found[ODD].seen
    assert found[ODD].value > 100 * abs(found[EVEN].value)
    assert other[EVEN].seen
    assert other[EVEN].value > 100 * abs(other[ODD].value)
    # with many realisations both ways tell the same cubic
    many = split_periods([played(s, cubic=0.1, noise=0.02, settled=True)[0] for s in range(8)])
    told = many.shares(0, 20.0, 180.0)
    assert told[ODD].value == pytest.approx(told[DISTORTION].value, rel=0.25)


def test_the_transient_is_what_the_first_period_holds_beyond_the_later_ones():
    recording, clean, drive = played(4, noise=0.001, periods=8)
    steady = played(4, settled=True)[1]
    lines = drive.lines
    power = np.sum(np.abs(amplitudes(clean)[:, lines]) ** 2, axis=0)
    first = amplitudes(clean)[0, lines] - amplitudes(steady)[0, lines]
    wanted = np.abs(first) ** 2 * (1 - 1 / 8) / power  # an eighth of it in the mean of the periods passes for H
    found = split_periods(recording, lines)
    adds_up(found)
    np.testing.assert_allclose(found.parts[TRANSIENT][0], wanted, atol=0.03 * wanted.max())
    assert found.shares(0, 5.0, 200.0)[TRANSIENT].seen
    late = split_periods(played(4, noise=0.01, periods=8, settled=True)[0], lines)
    assert not late.shares(0, 5.0, 200.0)[TRANSIENT].seen


def test_a_signal_that_is_played_twice_is_one_realisation():
    one, _, drive = played(5, noise=0.1, cubic=0.1, settled=True)
    f = np.roll(drive.samples, 137)
    later = np.stack([f, respond(f, 0.1) + 0.1 * np.random.default_rng(3).standard_normal(f.size)])[:, -6 * N :]
    other = Recording(CHANNELS, later, RATE, period=N, drop_periods=1)
    both = split_periods([one, other], drive.lines)
    assert DISTORTION not in both.parts
    assert both.shares(0, 5.0, 200.0)[NOISE].value == pytest.approx(
        split_periods(one, drive.lines).shares(0, 5.0, 200.0)[NOISE].value, rel=0.15
    )


def test_two_inputs_at_once():
    channels = (CHANNELS[0], Channel("g", "force", "reference"), CHANNELS[1])

    def both(seed):
        a, b = (multisine(RATE, N, (5.0, 200.0), seed=s, detection=0, n_periods=30).samples for s in (seed, seed + 50))
        x = respond(a) + respond(b, cubic=0.1) + 0.2 * np.random.default_rng(seed).standard_normal(a.size)
        return Recording(channels, np.stack([a, b, x])[:, -5 * N :], RATE, period=N, drop_periods=1)

    split = split_periods([both(s) for s in range(6)])
    adds_up(split)
    found = split.shares(0, 5.0, 200.0)
    assert found[NOISE].seen
    assert found[DISTORTION].seen
    assert not found[TRANSIENT].seen


def test_what_no_split_can_be_made_of_is_refused():
    recording, _, _ = played(1)
    with pytest.raises(EstimationError, match="period is 0"):
        split_periods(Recording(CHANNELS, recording.data, RATE))
    with pytest.raises(EstimationError, match="no two steady periods"):
        split_periods(Recording(CHANNELS, recording.data[:, :N], RATE, period=N))
    with pytest.raises(ChannelError, match="no channel is an input"):
        split_periods(Recording(CHANNELS[1:], recording.data[1:], RATE, period=N))
    with pytest.raises(ChannelError, match="one input"):
        split_record(Recording(CHANNELS[1:], recording.data[1:], RATE), Welch(512))
    with pytest.raises(EstimationError, match="two are needed"):
        split_hits(blows(1, 0.0)[0], Hits())


# -------------------------------------------------------------------- noise that is played


def shaken(n=2**17, noise=0.0, cubic=0.0, seed=1, played_as=11):
    f = random(RATE, n + 4096, (5.0, 220.0), seed=played_as).samples
    clean = respond(f, cubic)[4096:]
    data = np.stack([f[4096:], clean + noise * np.random.default_rng(seed).standard_normal(n)])
    return Recording(CHANNELS, data, RATE), clean


def test_shares_of_a_record_add_up_to_what_the_estimate_lacks():
    recording, _ = shaken(n=2**15, noise=0.5, cubic=0.02)
    welch = Welch(1024)
    split = split_record(recording, welch)
    adds_up(split)
    frf = H1(welch)(recording)
    at = np.searchsorted(frf.frequency, split.frequency)
    np.testing.assert_allclose(split.coherence, frf.coherence[:, at], atol=1e-9)
    assert set(split.parts) == {BOTH, LEAKAGE}
    assert "once more" in split.remarks[0]


def test_leakage_is_told_from_noise():
    noise = 0.5
    loud, clean = shaken(noise=noise)
    welch = Welch(512)  # two lines a half-power bandwidth: it leaks
    split, quiet = split_record(loud, welch), split_record(shaken()[0], welch)
    band = 50.0, 70.0
    # leakage alone: all that coherence lacks without noise
    assert quiet.shares(0, *band)[LEAKAGE].value == pytest.approx(quiet.lost(0, *band), rel=0.01)
    assert split.shares(0, *band)[LEAKAGE].value == pytest.approx(quiet.lost(0, *band), rel=0.1)
    frf = H1(welch)(Recording(CHANNELS, np.stack([loud.data[0], clean]), RATE))
    at = np.searchsorted(frf.frequency, split.frequency)
    power = np.abs(frf.value[0, 0, at]) ** 2 * np.real(frf.input_spectrum[0, 0, at]) / frf.coherence[0, at]
    density = 2 * noise**2 / RATE
    wanted = density / (power + density)
    inside = (split.frequency > 20) & (split.frequency < 200)
    found = split.shares(0, 20.0, 200.0)
    assert found[BOTH].value == pytest.approx(wanted[inside].mean(), rel=0.05)
    assert found[BOTH].seen
    longer = split_record(loud, Welch(8192))
    assert longer.shares(0, *band)[LEAKAGE].value < 0.05 * split.shares(0, *band)[LEAKAGE].value
    assert abs(split.shares(0, *band)[ENDS].value) < 0.01


def test_a_repeat_of_the_signal_tells_noise_from_distortion():
    noise, cubic = 0.2, 0.05
    one = shaken(noise=noise, cubic=cubic, seed=1)[0]
    two = shaken(noise=noise, cubic=cubic, seed=2)[0]
    lagging = Recording(CHANNELS, np.roll(two.data, 300, axis=1)[:, 300:], RATE)
    welch = Welch(2048)
    alone, pair, late = split_record(one, welch), split_record([one, two], welch), split_record([one, lagging], welch)
    adds_up(pair)
    linear = split_record(shaken(noise=noise)[0], welch).shares(0, 20.0, 200.0)[BOTH]
    quiet = split_record(shaken(cubic=cubic)[0], welch).shares(0, 20.0, 200.0)[BOTH]
    for split in (pair, late):
        found = split.shares(0, 20.0, 200.0)
        assert set(split.parts) == {NOISE, DISTORTION, LEAKAGE}
        total = found[NOISE].value + found[DISTORTION].value
        assert total == pytest.approx(alone.shares(0, 20.0, 200.0)[BOTH].value, rel=0.05)
        assert found[DISTORTION].seen
    # exact: the noise's density over the response's, line by line
    y = shaken(cubic=cubic)[1]
    frf = H1(welch)(Recording(CHANNELS, np.stack([one.data[0], y]), RATE))
    power = np.abs(frf.value[0, 0]) ** 2 * np.real(frf.input_spectrum[0, 0]) / frf.coherence[0]
    inside = (frf.frequency >= 20) & (frf.frequency <= 200)
    density = 2 * noise**2 / RATE
    wanted = (density / (power + density))[inside].mean()
    assert pair.shares(0, 20.0, 200.0)[NOISE].value == pytest.approx(wanted, rel=0.05)
    assert linear.seen
    assert quiet.seen
    other = shaken(noise=noise, cubic=cubic, seed=2, played_as=12)[0]
    assert set(split_record([one, other], welch).parts) == {BOTH, LEAKAGE}


# -------------------------------------------------------------------- hits


def blows(count, noise, ratio=0.02, n=2048, before=64, spread=0.0, decay_seed=5):
    rng = np.random.default_rng(decay_seed)
    clean, noisy = [], []
    for _ in range(count):
        f = np.zeros(n)
        f[before : before + 9] = rng.uniform(0.7, 1.3) * np.hanning(11)[1:-1]
        x = lfilter([1.0], poles(60.0 * (1 + spread * rng.standard_normal()), ratio), f)
        clean.append(np.stack([f, x]))
        noisy.append(clean[-1] + np.array([[0.0], [noise]]) * rng.standard_normal((2, n)))
    starts = tuple(n * k for k in range(1, count))
    return Recording(CHANNELS, np.concatenate(noisy, axis=1), RATE, breaks=starts), np.array(clean)


def test_hits_tell_noise_from_scatter():
    noise = 0.05
    recording, clean = blows(40, noise)
    split = split_hits(recording, Hits())
    adds_up(split)
    frf = H1(Hits())(recording)
    at = np.searchsorted(frf.frequency, split.frequency)
    np.testing.assert_allclose(split.coherence, frf.coherence[:, at], atol=1e-9)
    power = np.mean(
        np.abs(np.fft.rfft(clean[:, 1], axis=1)[:, np.searchsorted(frf.frequency, split.frequency)]) ** 2, axis=0
    )
    wanted = (1 - 1 / 40) * noise**2 * clean.shape[2] / (power + noise**2 * clean.shape[2])
    found = split.shares(0, 0.0, 256.0)
    assert found[NOISE].value == pytest.approx(wanted.mean(), rel=0.05)
    assert not found[SCATTER].seen
    moved = split_hits(blows(40, 0.1 * noise, spread=0.02)[0], Hits()).shares(0, 40.0, 80.0)
    assert moved[SCATTER].seen
    assert moved[SCATTER].value > 10 * moved[NOISE].value
    short = split_hits(blows(4, noise, before=6)[0], Hits())
    assert set(short.parts) == {ALL}
    assert "before the trigger" in short.remarks[0]
    adds_up(short)


@pytest.mark.parametrize("ratio", [0.001, 0.002])
def test_what_rings_on_past_the_end_is_told(ratio):
    recording, _ = blows(4, 1e-4, ratio=ratio)
    long = blows(4, 0.0, ratio=ratio, n=20 * 2048)[1][:, 1]
    cut = np.mean([np.sum(x[2048:] ** 2) / np.sum(x[:2048] ** 2) for x in long])
    found = split_hits(recording, Hits()).shares(0, 59.6, 60.4)[RINGING]
    assert found.seen
    assert found.value == pytest.approx(cut, rel=0.2)


def test_nothing_rings_on_where_a_response_has_died_away():
    assert not split_hits(blows(4, 1e-3, ratio=0.02)[0], Hits()).shares(0, 55.0, 65.0)[RINGING].seen


def test_a_window_on_the_hits_takes_off_what_rings_on():
    recording, _ = blows(4, 1e-4, ratio=0.002)
    plain, windowed = (split_hits(recording, Hits(decay=d)).shares(0, 55.0, 65.0)[RINGING].value for d in (0.0, 1.0))
    assert windowed < 0.1 * plain


# -------------------------------------------------------------------- tables


def test_a_table_has_a_row_for_each_response_and_band():
    split = split_periods([played(s, noise=0.3, cubic=0.1)[0] for s in (1, 2, 3)])
    rows = split.table()
    edges = [(r["low"], r["high"]) for r in rows]
    assert edges[-1][1] == split.frequency[-1]
    assert edges[0][0] == split.frequency[0]
    assert all(a[1] == b[0] for a, b in pairwise(edges))
    for r in rows:
        assert sum(p["share"] for p in r["parts"].values()) == pytest.approx(r["lost"], abs=1e-9)
    assert [r["low"] for r in split.table([(50.0, 70.0), (300.0, 400.0)])] == [50.0]


def test_the_harmonics_of_a_sweep_count_as_distortion_at_most_so_many_times():
    f = chirp(RATE, 2**15, (5.0, 100.0), law="log", fade=0.01).samples
    linear = (f @ f**3) / (f @ f)
    bent = lfilter([1.0], [1, -0.9], 0.05 * (f**3 - linear * f))
    y = lfilter([1.0], [1, -0.9], f * (1 + 0.05 * linear)) + bent
    welch = Welch(2048)
    split = split_record(Recording(CHANNELS, np.stack([f, y]), RATE), welch)
    adds_up(split)
    own = welch(Recording(CHANNELS, np.stack([f, bent]), RATE)).auto("x")
    power = welch(Recording(CHANNELS, np.stack([f, y]), RATE)).auto("x")
    at = np.round(split.frequency * 2048 / RATE).astype(int)
    inside = (split.frequency > 20) & (split.frequency < 90)
    ratio = split.parts[BOTH][0, inside].mean() / (own / power)[at][inside].mean()
    assert 0.9 < ratio < 17 / 9
    assert any("1.9 times" in text for text in split.remarks)
