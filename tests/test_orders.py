"""Harmonics of a sweep: exact levels of memoryless laws, steady ones through a filter, and a floor that is honest."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.signal import lfilter

from labnnum.errors import ChannelError, EstimationError
from labnnum.excitation import chirp, random
from labnnum.orders import is_sweep, orders
from labnnum.recording import Channel, Recording

RATE = 2048.0
CHANNELS = (Channel("f", "force", "reference"), Channel("x", "displacement"))


def swept(law, down, respond, noise=0.0, n=2**16, fade=0.01, band=(10.0, 300.0)):
    f = chirp(RATE, n, band, law=law, down=down, fade=fade).samples * np.sqrt(2)
    rng = np.random.default_rng(5)
    return Recording(CHANNELS, np.stack([f, respond(f) + noise * rng.standard_normal(n)]), RATE)


@pytest.mark.parametrize("law", ["linear", "log"])
@pytest.mark.parametrize("down", [False, True])
def test_a_memoryless_law_has_the_harmonics_that_it_must(law, down):
    c2, c3 = 0.02, 0.05
    recording = swept(law, down, lambda f: f + c2 * f**2 + c3 * f**3)
    found = orders(recording)
    assert np.all(np.diff(found.frequency) > 0)
    assert found.frequency[0] < 25
    assert found.frequency[-1] > 270
    a = found.amplitude[0, 0]  # of the sine
    inside = (found.frequency > 15) & (found.frequency < 280)
    np.testing.assert_allclose(a[inside], np.median(a), rtol=2e-3)
    first = a + 0.75 * c3 * a**3
    np.testing.assert_allclose(found.amplitude[1, 0], first, rtol=2e-3)
    for order, wanted in ((2, c2 * a**2 / 2), (3, c3 * a**3 / 4)):
        told = found.decibels(1)[order - 2]
        np.testing.assert_allclose(told[inside], 20 * np.log10(wanted / first)[inside], atol=0.1)
    rows = {(r["channel"], r["order"]): r for r in found.table()}
    assert rows["x", 2]["power_db"] == pytest.approx(20 * np.log10(np.median(c2 * a**2 / 2 / first)), abs=0.2)
    assert rows["x", 3]["power_db"] == pytest.approx(20 * np.log10(np.median(c3 * a**3 / 4 / first)), abs=0.2)
    assert rows["x", 4]["power_db"] is None or rows["x", 4]["power_db"] < -90
    assert rows["f", 3]["power_db"] is None or rows["f", 3]["power_db"] < -90


def test_the_floor_is_what_noise_leaves():
    ratios = []
    for law in ("linear", "log"):
        found = orders(swept(law, False, lambda f: f, noise=0.1))
        known = np.isfinite(found.noise[1, 1:])
        ratios.append((found.amplitude[1, 1:][known] / found.noise[1, 1:][known]) ** 2)
        assert all(r["power_db"] is None for r in found.table() if r["channel"] == "x")
    assert np.mean(np.concatenate(ratios)) == pytest.approx(1.0, abs=0.1)


def test_a_harmonic_above_half_the_rate_is_not_told():
    found = orders(swept("linear", False, lambda f: f + 0.05 * f**3, band=(20.0, 600.0)))
    assert np.isnan(found.amplitude[1, 2][found.frequency > 360]).all()
    assert np.isfinite(found.amplitude[1, 2][found.frequency < 300]).all()


def test_a_filter_behind_the_law_weighs_each_order():
    def h(f):
        return 1 / np.abs(1 - 0.9 * np.exp(-2j * np.pi * f / RATE))

    found = orders(swept("log", False, lambda f: lfilter([1.0], [1.0, -0.9], f + 0.05 * f**3)))
    inside = (found.frequency > 15) & (found.frequency < 250)
    f = found.frequency[inside]
    a2 = np.median(found.amplitude[0, 0]) ** 2
    wanted = 20 * np.log10(0.05 * a2 / 4 / (1 + 0.75 * 0.05 * a2) * h(3 * f) / h(f))
    np.testing.assert_allclose(found.decibels(1)[1][inside], wanted, atol=0.3)


def test_a_hardening_spring_has_the_third_harmonic_of_a_steady_sine():
    """Below resonance a slow sweep is a row of steady states; one of them by solve_ivp."""
    w0, ratio, c3, level, at = 2 * np.pi * 60.0, 0.05, 3e5, 400.0, 15.0

    def slope(t, s, force):
        return [s[1], force(t) - 2 * ratio * w0 * s[1] - w0**2 * s[0] - c3 * w0**2 * s[0] ** 3]

    time, low, high = 24.0, 8.0, 25.0

    def sweep(t):
        return level * np.sin(2 * np.pi * (low * t + (high - low) * t**2 / 2 / time))

    t = np.arange(int(time * 512)) / 512
    x = solve_ivp(slope, (0, t[-1]), [0, 0], t_eval=t, args=(sweep,), rtol=1e-6, atol=1e-9).y[0]
    found = orders(Recording(CHANNELS, np.stack([sweep(t), x]), 512.0), highest=3)
    t = np.arange(12 * 512) / 512
    tone = solve_ivp(
        slope, (0, t[-1]), [0, 0], t_eval=t, args=(lambda s: level * np.sin(2 * np.pi * at * s),), rtol=1e-6,
        atol=1e-9,
    ).y[0][-512 * 8 :]  # fmt: skip
    spectrum = np.abs(np.fft.rfft(tone)) * 2 / tone.size
    wanted = 20 * np.log10(spectrum[int(3 * at * 8)] / spectrum[int(at * 8)])
    told = np.interp(at, found.frequency, found.decibels(1)[1])
    assert wanted > -60
    assert told == pytest.approx(wanted, abs=0.5)


def test_periods_of_a_sweep_are_averaged():
    drive = chirp(RATE, 2**15, (10.0, 300.0), fade=0.02, n_periods=6)
    f = drive.samples
    noise = 0.05 * np.random.default_rng(2).standard_normal(f.size)
    one = Recording(CHANNELS, np.stack([f, f + noise])[:, : 2**15], RATE)
    six = Recording(CHANNELS, np.stack([f, f + noise]), RATE, period=2**15, drop_periods=1)
    ratio = np.nanmedian(orders(six).noise[1]) / np.nanmedian(orders(one).noise[1])
    assert ratio == pytest.approx(1 / np.sqrt(5), rel=0.1)


def test_what_is_no_sweep_is_refused():
    f = random(RATE, 2**14, (10.0, 300.0), seed=1).samples
    assert not is_sweep(f)
    with pytest.raises(EstimationError, match="no sine that sweeps"):
        orders(Recording(CHANNELS, np.stack([f, f]), RATE))
    with pytest.raises(ChannelError, match="one input"):
        orders(Recording(CHANNELS[1:], f[None], RATE))
    with pytest.raises(EstimationError, match="highest order is 1"):
        orders(swept("log", False, lambda f: f), highest=1)
