"""Calibration: values within their errors, and signals that are no calibration refused with a reason."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.simulated import Drive, Input, Player, SimulatedBench, plant
from labnnum.bands import Band
from labnnum.calibration import (
    STANDARD_GRAVITY,
    InputResponse,
    corrected,
    find_tone,
    from_common_signal,
    from_mass,
    from_tone,
)
from labnnum.errors import EstimationError
from labnnum.estimators import H1, Welch
from labnnum.frf import Frf
from labnnum.recording import Channel, Recording
from labnnum.structures.chain import Chain, Link

RATE = 8192.0
ACC = Channel("a", sensitivity=0.01)
FORCE = Channel("f", "force", "reference", sensitivity=0.002)


def sine(frequency, rms, seconds=5.0, noise=0.0, seed=0, phase=0.4):
    t = np.arange(round(seconds * RATE)) / RATE
    clean = rms * np.sqrt(2) * np.sin(2 * np.pi * frequency * t + phase)
    return clean + noise * np.random.default_rng(seed).standard_normal(t.size)


@settings(max_examples=25, deadline=None)
@given(
    frequency=st.floats(155.5, 163.0),
    sensitivity=st.floats(1e-4, 1.0),
    noise=st.floats(0.0, 0.05),
    phase=st.floats(0, 6),
    seed=st.integers(0, 99),
)
def test_a_calibrators_tone_gives_the_sensitivity_within_its_error(frequency, sensitivity, noise, phase, seed):
    rms = sensitivity * STANDARD_GRAVITY
    found = from_tone(sine(frequency, rms, noise=noise * rms, seed=seed, phase=phase), RATE, STANDARD_GRAVITY)
    assert abs(found.value / sensitivity - 1) < 6 * found.error / sensitivity + 1e-6
    assert found.error < 0.05 * noise * sensitivity + 1e-6 * sensitivity
    assert abs(found.frequency / frequency - 1) < 1e-4
    assert found.impurity == pytest.approx(noise / np.sqrt(1 + noise**2), abs=1e-3)


def test_the_error_of_a_tone_is_that_of_repeated_recordings():
    found = [from_tone(sine(159.2, 0.1, noise=0.005, seed=k), RATE, STANDARD_GRAVITY) for k in range(40)]
    spread = np.std([f.value for f in found], ddof=1)
    assert 0.7 < spread / np.mean([f.error for f in found]) < 1.4


def test_constant_and_harmonics_are_left_out():
    x = sine(159.2, 0.1) + 0.7 + 0.004 * np.cos(2 * np.pi * 318.4 * np.arange(round(5 * RATE)) / RATE)
    assert from_tone(x, RATE, 1.0).value == pytest.approx(0.1, rel=1e-5)
    assert find_tone(sine(40.013, 0.1), RATE, 40.0) == pytest.approx(40.013, abs=1e-4)


@pytest.mark.parametrize(
    ("signal", "said"),
    [
        (sine(50.0, 0.1), "no tone at 159.155 Hz: the strongest line is at 50 Hz"),
        (np.zeros(40000), "no tone at 159.155 Hz"),
        (sine(159.2, 0.1, seconds=0.05), "fewer than 20 cycles of 159.155 Hz"),
        (sine(159.2, 0.1) * np.linspace(1, 1.5, round(5 * RATE)), "not steady: its RMS goes from 0.10"),
        (sine(159.2, 0.1, noise=0.05), "of the signal's RMS is something else than the tone"),
    ],
)
def test_what_is_no_calibrator_is_refused(signal, said):
    with pytest.raises(EstimationError, match=said):
        from_tone(signal, RATE, STANDARD_GRAVITY)


def test_a_level_must_be_positive():
    with pytest.raises(EstimationError, match="must be positive, not 0"):
        from_tone(sine(159.2, 0.1), RATE, 0.0)


def mass_frf(mass=1.25, true=0.0021, stated=0.002, noise=0.0, seed=0, factor=1.0):
    f = np.arange(20.0, 200.0, 2.0)
    random = np.random.default_rng(seed)
    value = stated / (true * mass) * factor * np.ones(f.size, complex)
    value = value + noise * (random.standard_normal(f.size) + 1j * random.standard_normal(f.size))
    variance = np.full((1, 1, f.size), 2 * noise**2)
    return Frf(f, value[None, None], (ACC,), (FORCE,), variance=variance)


@settings(max_examples=20, deadline=None)
@given(mass=st.floats(0.1, 20), true=st.floats(1e-4, 0.1), seed=st.integers(0, 99), inverted=st.booleans())
def test_a_known_mass_gives_the_force_channels_sensitivity(mass, true, seed, inverted):
    sign = -1.0 if inverted else 1.0
    stated = 1.1 * true
    noise = 0.01 * stated / (true * mass)
    found = from_mass(mass_frf(mass, true, stated, noise, seed, sign), mass, stated, Band(30, 150))
    assert found.inverted == inverted
    assert abs(found.value - true) < 5 * found.error
    assert found.error < 0.003 * true


def test_a_delay_between_force_and_acceleration_does_not_matter():
    frf = mass_frf()
    late = replace(frf, value=frf.value * np.exp(-2j * np.pi * frf.frequency * 3e-4))
    assert from_mass(late, 1.25, 0.002, Band(30, 150)).value == pytest.approx(0.0021, rel=1e-9)


def test_what_is_no_rigid_mass_is_refused():
    frf = mass_frf()
    resonant = replace(frf, value=frf.value / (1 - (frf.frequency / 160) ** 2 + 0.02j))
    with pytest.raises(EstimationError, match="no rigid mass; choose a band"):
        from_mass(resonant, 1.25, 0.002, Band(30, 190))
    with pytest.raises(EstimationError, match="no line from 300 to 400 Hz"):
        from_mass(frf, 1.25, 0.002, Band(300, 400))
    two = Frf(frf.frequency, np.repeat(frf.value, 2, axis=0), (ACC, replace(ACC, name="b")), (FORCE,))
    with pytest.raises(EstimationError, match="one acceleration over one force"):
        from_mass(two, 1.25, 0.002, Band(30, 150))


@settings(max_examples=20, deadline=None)
@given(
    delay=st.floats(-2e-4, 2e-4),
    highpass=st.floats(0.05, 5.0),
    gain=st.floats(0.8, 1.2),
    reference=st.sampled_from([0.0, 0.7]),
    seed=st.integers(0, 99),
)
def test_delay_high_pass_and_gain_come_back_within_their_errors(delay, highpass, gain, reference, seed):
    f = np.arange(1.0, 400.0)
    exact = gain * InputResponse(delay, highpass).at(f) / InputResponse(highpass=reference).at(f)
    random = np.random.default_rng(seed)
    value = exact + 1e-3 * (random.standard_normal(f.size) + 1j * random.standard_normal(f.size))
    frf = Frf(f, value[None, None], (ACC,), (FORCE,), variance=np.full((1, 1, f.size), 2e-6))
    found = from_common_signal(frf, reference)["a"]
    assert abs(found.delay - delay) < 5 * found.delay_error
    assert abs(found.highpass - highpass) < 5 * found.highpass_error
    assert abs(found.gain - gain) < 5 * found.gain_error
    assert found.delay_error < 1e-6
    assert found.highpass_error < 0.02


def test_a_common_signal_needs_enough_lines_and_must_be_common():
    f = np.arange(1.0, 200.0)
    random = np.random.default_rng(1)
    noise = Frf(f, np.exp(2j * np.pi * random.random((1, 1, f.size))), (ACC,), (FORCE,))
    with pytest.raises(EstimationError, match="unexplained; is the same signal on both inputs"):
        from_common_signal(noise)
    with pytest.raises(EstimationError, match="at least 8 lines"):
        from_common_signal(noise.at(slice(0, 4)))


@pytest.mark.parametrize("highpass", [0.0, 3.0])
def test_a_corrected_frf_is_the_one_without_its_inputs(highpass):
    f = np.arange(0.0, 100.0)
    random = np.random.default_rng(0)
    value = random.standard_normal((2, 1, f.size)) + 1j * random.standard_normal((2, 1, f.size))
    outputs = (ACC, replace(ACC, name="b"))
    inputs = {"a": InputResponse(1e-3, highpass), "f": InputResponse(-2e-3)}
    a, force = inputs["a"].at(f), inputs["f"].at(f)
    seen = value * np.stack([a, np.ones(f.size)])[:, None] / force
    variance = np.abs(seen) ** 2
    back = corrected(Frf(f, seen, outputs, (FORCE,), variance=variance), inputs)
    kept = f >= 0 if not highpass else f > 0
    np.testing.assert_allclose(back.value, value[..., kept], rtol=1e-12)
    np.testing.assert_allclose(back.variance, np.abs(value[..., kept]) ** 2, rtol=1e-12)
    assert back.settings["inputs"]["a"] == {"delay": 1e-3, "highpass": highpass}
    with pytest.raises(EstimationError, match="corrected before"):
        corrected(back, inputs)
    assert corrected(back, {"other": InputResponse(1.0)}) is back


def test_what_a_common_signal_tells_of_two_high_passes_takes_both_out():
    f = np.arange(1.0, 400.0)
    tip, force = InputResponse(1e-4, 1.6), InputResponse(highpass=1.6)
    ratio = (tip.at(f) / force.at(f))[None, None]
    found = from_common_signal(Frf(f, ratio, (ACC,), (FORCE,)), reference_highpass=1.6)
    assert found["f"] == force
    truth = 1 / (100.0 - f**2 + 2j * f)
    back = corrected(Frf(f, truth * ratio, (ACC,), (FORCE,)), found)
    np.testing.assert_allclose(back.value[0, 0], truth, rtol=1e-6)


def test_inputs_of_the_simulated_bench_are_found_and_taken_out_of_its_frf():
    """A shaker run with a late and an AC-coupled channel: calibrated on a common voltage, corrected, exact again."""
    chain = Chain(masses={"1": 2.0}, links=(Link("1", "ground", 8e4, 60.0),))
    force = Channel("f", "force", "reference", "1", "x", sensitivity=0.01)
    tip = Channel("a", node="1", direction="x", sensitivity=0.01)
    faults = {"delay": 2.3e-4, "highpass": 1.5}
    volt = Channel("v", "voltage", "reference")
    noise = np.random.default_rng(3).standard_normal(2**17)

    def record(channels, drive, **more):
        inputs = [Input(channels[0], input_noise=1e-5), Input(channels[1], input_noise=1e-5, **more)]
        player = Player()
        bench = SimulatedBench(plant(chain, [], inputs, [drive]), inputs, [player], 2048.0, oversample=4)
        bench.start()
        player.play(noise)
        volts = np.hstack([bench.read().data for _ in range(100)])
        return H1(Welch(2048, "hann"))(Recording(channels, volts, 2048.0))

    same = replace(volt, name="a", role="response")
    monitors = [Channel("v", "voltage", "monitor"), Channel("a", "voltage", "monitor")]
    inputs = [Input(monitors[0], input_noise=1e-5), Input(monitors[1], input_noise=1e-5, **faults)]
    player = Player()
    bench = SimulatedBench(plant(chain, [], inputs, [Drive(force)]), inputs, [player], 2048.0, oversample=4)
    bench.start()
    player.play(noise)
    volts = np.hstack([bench.read().data for _ in range(100)])
    common = H1(Welch(2048, "hann"))(Recording((volt, same), volts, 2048.0)).lines(1.0, 800.0)
    found = from_common_signal(common)
    assert found["a"].delay == pytest.approx(2.3e-4, abs=2e-6)
    assert found["a"].highpass == pytest.approx(1.5, rel=0.02)

    plain = record((force, tip), Drive(force, gain=10.0)).lines(6.0, 300.0)
    marred = record((force, tip), Drive(force, gain=10.0), **faults).lines(6.0, 300.0)
    mended = corrected(marred, found)
    assert np.abs(marred.value / plain.value - 1).max() > 0.2
    np.testing.assert_allclose(mended.value / plain.value, 1.0, atol=0.01)
