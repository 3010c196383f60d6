"""Excitation: bands, RMS, seeds, lines, and what is refused."""

import numpy as np
import pytest

from labnnum import excitation as ex
from labnnum.errors import EstimationError

RATE, N, BAND = 1000.0, 4096, (20.0, 200.0)

SIGNALS = {
    "random": lambda seed: ex.random(RATE, N, BAND, 0.7, seed),
    "burst": lambda seed: ex.burst_random(RATE, N, BAND, 0.7, seed, burst=0.5, n_bursts=3),
    "periodic": lambda seed: ex.periodic_random(RATE, N, BAND, 0.7, seed, n_periods=3),
    "multisine": lambda seed: ex.multisine(RATE, N, BAND, 0.7, seed, n_periods=2),
}


@pytest.mark.parametrize("kind", SIGNALS)
def test_rms_is_exact_and_seeds_repeat(kind):
    one, same, other = SIGNALS[kind](3), SIGNALS[kind](3), SIGNALS[kind](4)
    assert one.rms == pytest.approx(0.7, rel=1e-12)
    np.testing.assert_array_equal(one.samples, same.samples)
    assert not np.array_equal(one.samples, other.samples)
    assert 1 < one.crest_factor == np.abs(one.samples).max() / one.rms


@pytest.mark.parametrize("kind", ["random", "periodic", "multisine"])
def test_nothing_lies_outside_the_band(kind):
    drive = SIGNALS[kind](1)
    power = np.abs(np.fft.rfft(drive.samples)) ** 2
    f = np.fft.rfftfreq(drive.samples.size, 1 / RATE)
    outside = (f < BAND[0]) | (f > BAND[1])
    assert power[outside].sum() < 1e-20 * power.sum()


def test_random_is_gaussian_and_flat():
    drive = ex.random(RATE, 1 << 17, BAND, seed=5)
    assert np.mean(drive.samples**4) == pytest.approx(3.0, rel=0.05)
    power = np.abs(np.fft.rfft(drive.samples)) ** 2
    inside = power[power > 1e-12 * power.max()]
    quarters = [q.mean() for q in np.array_split(inside, 4)]
    assert max(quarters) / min(quarters) < 1.1


def test_each_burst_is_new_and_ends_in_silence():
    drive = ex.burst_random(RATE, 1000, BAND, burst=0.6, n_bursts=4, seed=2)
    rows = drive.samples.reshape(4, 1000)
    assert (rows[:, 600:] == 0).all()
    assert np.abs(np.corrcoef(rows[:, :600])[0, 1]) < 0.3


def test_periods_repeat():
    for drive in (SIGNALS["periodic"](1), SIGNALS["multisine"](1)):
        rows = drive.samples.reshape(-1, N)
        np.testing.assert_array_equal(rows[0], rows[1])
        assert drive.period == N


def test_one_odd_line_of_each_group_is_withheld():
    drive = ex.multisine(RATE, N, BAND, seed=9, detection=4)
    amplitude = np.abs(np.fft.rfft(drive.samples[:N]))
    excited = np.flatnonzero(amplitude > 1e-9 * amplitude.max())
    np.testing.assert_array_equal(excited, drive.lines)
    every = np.sort(np.concatenate([drive.lines, drive.detection]))
    assert (every % 2 == 1).all()
    assert (np.diff(every) == 2).all()
    groups = every[: every.size // 4 * 4].reshape(-1, 4)
    assert (np.isin(groups, drive.detection).sum(axis=1) == 1).all()
    np.testing.assert_allclose(amplitude[drive.lines], amplitude[drive.lines[0]], rtol=1e-9)
    assert len(set(np.flatnonzero(np.isin(groups, drive.detection)) % 4)) > 1


def test_full_multisine_and_shape():
    flat = ex.multisine(RATE, N, BAND, odd=False, detection=0)
    np.testing.assert_array_equal(np.diff(flat.lines), 1)
    assert flat.detection.size == 0
    sloped = ex.multisine(RATE, N, BAND, odd=False, detection=0, shape=lambda f: f)
    amplitude = np.abs(np.fft.rfft(sloped.samples))[sloped.lines]
    np.testing.assert_allclose(amplitude / amplitude[0], sloped.frequency / sloped.frequency[0], rtol=1e-9)


def test_schroeder_phases_lower_the_crest_factor():
    schroeder = ex.multisine(RATE, N, BAND, odd=False, detection=0, phase="schroeder")
    assert schroeder.crest_factor < 1.9 < ex.multisine(RATE, N, BAND, odd=False, detection=0).crest_factor


@pytest.mark.parametrize("law", ["linear", "log"])
@pytest.mark.parametrize("down", [False, True])
def test_a_chirp_sweeps_the_band_once(law, down):
    drive = ex.chirp(10 * RATE, 200000, BAND, 2.0, law=law, down=down, fade=0.0)
    assert drive.rms == pytest.approx(2.0)
    crossings = np.flatnonzero(np.diff(np.signbit(drive.samples)))
    frequency = 10 * RATE / 2 / np.diff(crossings)
    ends = (np.median(frequency[:5]), np.median(frequency[-9:]))
    np.testing.assert_allclose(ends, BAND[::-1] if down else BAND, rtol=0.06)
    middle = np.median(frequency[np.searchsorted(crossings[1:], 95000) : np.searchsorted(crossings[1:], 105000)])
    wanted = np.mean(BAND) if law == "linear" else np.sqrt(np.prod(BAND))
    assert middle == pytest.approx(wanted, rel=0.05)


def test_a_stepped_sine_plan_goes_up_and_down_with_continuous_phase():
    plan = ex.stepped_sine(RATE, (10.0, 100.0), 6, rms=3.0, direction="up-down", settle=0.1, cycles=10)
    np.testing.assert_allclose(plan.frequency, plan.frequency[::-1])
    drive = plan.drive()
    assert drive.samples.size == sum(plan.settle) + sum(plan.measure) == round(plan.duration * RATE)
    largest_step = 3 * np.sqrt(2) * 2 * np.pi * 100 / RATE
    assert np.abs(np.diff(drive.samples)).max() <= largest_step * (1 + 1e-9)
    for f, (a, b) in zip(plan.frequency, plan.windows, strict=True):
        assert (b - a) * f / RATE == pytest.approx(10, abs=0.06)
        assert np.sqrt(np.mean(drive.samples[a:b] ** 2)) == pytest.approx(3.0, rel=0.01)


@pytest.mark.parametrize(
    "call",
    [
        lambda: ex.random(RATE, N, (200.0, 100.0)),
        lambda: ex.random(RATE, N, (100.0, 600.0)),
        lambda: ex.random(RATE, 16, (1.0, 2.0)),
        lambda: ex.random(RATE, N, BAND, rms=-1.0),
        lambda: ex.random(0.0, N, BAND),
        lambda: ex.burst_random(RATE, N, BAND, burst=1.0),
        lambda: ex.multisine(RATE, N, BAND, detection=1),
        lambda: ex.multisine(RATE, 64, (16.0, 17.0), detection=0),
        lambda: ex.multisine(RATE, N, BAND, shape=lambda f: -f),
        lambda: ex.multisine(RATE, N, BAND, n_periods=0),
        lambda: ex.chirp(RATE, N, (0.0, 10.0), law="log"),
        lambda: ex.chirp(RATE, N, BAND, fade=0.7),
        lambda: ex.stepped_sine(RATE, (0.0, 10.0), 5),
        lambda: ex.stepped_sine(RATE, BAND, 0),
        lambda: ex.stepped_sine(RATE, BAND, 5, settle=-1),
    ],
)
def test_impossible_signals_are_refused(call):
    with pytest.raises(EstimationError):
        call()
