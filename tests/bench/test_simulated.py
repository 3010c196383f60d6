"""The simulated bench: its recordings have the FRF of the structure, and its faults are the ones asked for."""

import time
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.simulated import (
    TIPS,
    Drive,
    Faults,
    FunctionWave,
    Hammer,
    Input,
    Operator,
    Player,
    Shaker,
    Silence,
    SimulatedBench,
    blow,
    plant,
    with_chain,
)
from drivers.simulated.filters import HALF, Decimator, Interpolator
from labnnum.errors import ChannelError, DeviceLostError, DeviceTimeoutError, DriverError, InputError
from labnnum.recording import Channel
from labnnum.response import frf
from labnnum.structures import Beam
from labnnum.structures.chain import Chain, Link
from labnnum.structures.section import Section

CHAIN = Chain(masses={"1": 2.0, "2": 1.0}, links=(Link("1", "ground", 8e5, 60.0), Link("1", "2", 5e5, 40.0)))
BASED = replace(CHAIN, base="x")
FORCE = Channel("f", "force", "reference", "1", "x")
TIP = Channel("a", "acceleration", node="2", direction="x")
BASE = Channel("b", "acceleration", "base", direction="x")
RATE = 512.0
IDEAL = {"bits": 0, "full_scale": 1e9}


def read(bench: SimulatedBench, frames: int) -> np.ndarray:
    bench.start()
    blocks = [bench.read() for _ in range(-(-frames // bench.block))]
    return np.hstack([b.data for b in blocks])[:, :frames]


def multisine(n: int, top: int, seed: int = 0) -> np.ndarray:
    lines = np.zeros(n // 2 + 1, complex)
    lines[1:top] = np.exp(2j * np.pi * np.random.default_rng(seed).random(top - 1))
    return np.fft.irfft(lines) * n / 10


def periodic_frf(data: np.ndarray, n: int, top: int) -> np.ndarray:
    spectrum = np.fft.rfft(data[:, -n:])[:, 1:top]
    return spectrum[1:] / spectrum[0]


def bench_of(inputs, drives, sources, structure=CHAIN, rate=RATE, **more) -> SimulatedBench:
    return SimulatedBench(plant(structure, [], inputs, drives), inputs, sources, rate, **more)


@pytest.mark.parametrize("structure", [CHAIN, BASED])
def test_periodic_recording_has_the_exact_frf(structure):
    reference = BASE if structure.base else FORCE
    inputs = [Input(reference, **IDEAL), Input(TIP, **IDEAL)]
    player = Player()
    bench = bench_of(inputs, [Drive(reference, gain=3.0)], [player], structure)
    n, top = 1024, int(0.42 * 1024)
    bench.start()
    player.play(multisine(n, top), repeat=True)
    data = np.hstack([bench.read().data for _ in range(10)])
    f = np.arange(1, top) * RATE / n
    exact = frf(structure, [], f, [TIP], [reference])[:, 0]
    assert np.max(np.abs(periodic_frf(data, n, top) / exact - 1)) < 1e-6


def test_waveform_arrives_as_played():
    n = 1024
    wave = multisine(n, int(0.42 * n))
    player = Player()
    bench = bench_of([Input(FORCE, **IDEAL), Input(TIP, **IDEAL)], [Drive(FORCE, 2.0)], [player])
    bench.start()
    begin = player.play(wave)
    data = np.hstack([bench.read().data for _ in range(3)])
    # far from the waveform's sudden ends, whose spectrum the filters cannot pass
    inner = slice(begin + 300, begin + 700)
    np.testing.assert_allclose(data[0, inner], 2 * wave[300:700], atol=2e-3 * np.abs(wave).max())


def test_delay_and_highpass_are_the_textbook_ones():
    delay, corner, n = 0.7e-3, 2.0, 1024
    inputs = [Input(FORCE, **IDEAL), Input(FORCE_2, delay=delay, highpass=corner, **IDEAL)]
    player = Player()
    bench = bench_of(inputs, [Drive(FORCE)], [player])
    bench.start()
    player.play(multisine(n, 430), repeat=True)
    data = np.hstack([bench.read().data for _ in range(12)])
    f = np.arange(1, 430) * RATE / n
    exact = np.exp(-2j * np.pi * f * delay) * 1j * f / (corner + 1j * f)
    # the high-pass takes its input as straight between the eight points of a frame
    assert np.max(np.abs(periodic_frf(data, n, 430)[0] / exact - 1)) < 2e-4


FORCE_2 = replace(FORCE, name="f2", role="response")


def test_channel_factors_of_an_extended_structure():
    class Faulty(Chain):
        def chain(self, channel, frequency, theta):
            f = np.asarray(frequency)
            fault = 0.9 * np.exp(-2j * np.pi * f * 1.3e-3) * 1j * f / (1.5 + 1j * f)
            return fault if channel.name == "a" else np.ones(f.shape, complex)

    structure = Faulty(masses=CHAIN.masses, links=CHAIN.links)
    inputs = with_chain(structure, [], [Input(FORCE, **IDEAL), Input(TIP, **IDEAL)])
    assert inputs[0].factor is None
    player = Player()
    bench = bench_of(inputs, [Drive(FORCE)], [player], structure)
    n, top = 1024, 430
    bench.start()
    player.play(multisine(n, top), repeat=True)
    data = np.hstack([bench.read().data for _ in range(20)])
    f = np.arange(1, top) * RATE / n
    exact = frf(structure, [], f, [TIP], [FORCE])[0, 0]
    assert np.max(np.abs(periodic_frf(data, n, top)[0] / exact - 1)) < 1e-4


def test_sensor_mass_and_cross_axis():
    heavy = Chain(masses={"1": 2.0, "2": 1.1}, links=CHAIN.links)
    loaded = plant(CHAIN, [], [Input(FORCE), Input(TIP, mass=0.1)], [Drive(FORCE)])
    plain = plant(heavy, [], [Input(FORCE), Input(TIP)], [Drive(FORCE)])
    f = [10.0, 60.0, 200.0]
    np.testing.assert_allclose(loaded.frf(f), plain.frf(f), rtol=1e-12)
    crossed = plant(CHAIN, [], [Input(FORCE), Input(TIP, cross={"x": 0.05})], [Drive(FORCE)])
    ideal = plant(CHAIN, [], [Input(FORCE), Input(TIP)], [Drive(FORCE)])
    np.testing.assert_allclose(crossed.frf(f)[1], 1.05 * ideal.frf(f)[1], rtol=1e-12)


def test_shaker_pulls_the_force_down_at_resonance_but_not_the_frf():
    inputs = [Input(FORCE), Input(TIP)]
    light = replace(CHAIN, links=(Link("1", "ground", 8e5, 6.0), Link("1", "2", 5e5, 4.0)))
    driven = plant(light, [], inputs, [Drive(FORCE, 10.0, Shaker())])
    f = np.linspace(5, 200, 2000)
    response = driven.frf(f)
    exact = frf(light, [], f, [TIP], [FORCE])[0, 0]
    np.testing.assert_allclose(response[1, 0] / response[0, 0], exact, rtol=1e-9)
    peak = np.argmax(np.abs(exact))
    force = np.abs(response[0, 0])
    assert force[peak] < 0.3 * np.median(force)


def test_shaker_table_feels_the_structure():
    inputs = [Input(BASE), Input(TIP)]
    driven = plant(BASED, [], inputs, [Drive(BASE, 10.0, Shaker(mass=5.0))])
    f = np.linspace(5, 200, 500)
    response = driven.frf(f)
    exact = frf(BASED, [], f, [TIP], [BASE])[0, 0]
    np.testing.assert_allclose(response[1, 0] / response[0, 0], exact, rtol=1e-9)
    # at low frequency the force moves table, armature suspension and the whole structure as one mass
    low = driven.frf([40.0])[0, 0, 0]
    omega = 2 * np.pi * 40
    assert 5.0 < (10.0 / abs(low)) / (1 - (20 / 40) ** 2) < 5.0 + 3 * 3.0
    assert omega > 0


@pytest.mark.parametrize("shaker", [None, Shaker(mass=0.5)])
def test_what_a_support_holds_pushes_also_with_a_sensor_on_the_beam(shaker):
    """Of coarse beams the mass that the clamp holds loads what is free, whether a table or an ideal base moves it."""
    beam = Beam(0.4, Section(EI=11.2, rhoA=0.324), 3, supports_at={"1": "clamped"}, base="z")
    base, tip = replace(BASE, direction="z"), Channel("a", "acceleration", node="4", direction="z")
    f = np.linspace(5, 400, 200)
    exact = frf(beam, [], f, [tip], [base])[0, 0]
    made = plant(beam, [], [Input(base), Input(tip, mass=1e-9)], [Drive(base, 1.0, shaker)]).frf(f)
    np.testing.assert_allclose(made[1, 0] / made[0, 0], exact, rtol=1e-5)
    if shaker is not None:  # slowly, the table carries the beam as one mass, but for what the clamp has of its end
        free = Shaker(mass=0.5, frequency=1e-3)
        slow = plant(beam, [], [Input(base)], [Drive(base, 1.0, free)]).frf(np.array([0.2]))[0, 0, 0]
        density, length = 0.324, 0.4
        assert 1 / abs(slow) == pytest.approx(0.5 + density * (length - 156 / 420 * length / 3), rel=1e-3)


def test_roving_hammer_moves_one_force_sensor():
    points = [replace(FORCE, node="1"), replace(FORCE, node="2")]
    inputs = [Input(Channel("f", "force", "reference"), **IDEAL), Input(TIP, **IDEAL)]
    drives = [Drive(p) for p in points]
    sources = [Silence(), Hammer([blow("rubber", 0.5, 100.0)])]
    data = read(bench_of(inputs, drives, sources, rate=8192.0), 16384)
    spectrum = np.fft.rfft(data)
    f = np.fft.rfftfreq(16384, 1 / 8192.0)
    lines = (f > 20) & (f < 250)
    exact = frf(CHAIN, [], f[lines], [TIP], [points[1]])[0, 0]
    assert np.max(np.abs(spectrum[1, lines] / spectrum[0, lines] / exact - 1)) < 1e-4
    assert data[0].max() == pytest.approx(100, rel=0.01)


def test_force_needs_a_drive_there():
    with pytest.raises(ChannelError, match="where nothing drives"):
        plant(CHAIN, [], [Input(replace(FORCE, node="2"))], [Drive(FORCE)])
    with pytest.raises(ChannelError, match="excites"):
        plant(CHAIN, [], [Input(FORCE)], [])


@pytest.mark.parametrize("tip", sorted(TIPS))
def test_tips(tip):
    hit = blow(tip, 0.1, 50.0, again=0.5, after=0.02)
    t = np.linspace(0.09, 0.14, 50001)
    force = hit.force(t)
    assert force.max() == pytest.approx(50.0, rel=1e-6)
    assert force[t > 0.119].max() == pytest.approx(25.0, rel=1e-6)
    assert np.ptp(t[force > 0][force[force > 0] > 0][:1]) == 0
    with pytest.raises(InputError, match="tip"):
        blow("chalk", 0, 1)


def test_operator_is_uneven_but_repeatable():
    def strike():
        person = Operator(interval=0.5, double=0.5, overload=0.2, seed=4)
        person.render(0, 10240, 1, 1024.0)
        return person.hits

    assert strike() == strike()
    hits = strike()
    assert 17 <= len(hits) <= 22
    assert {h.again > 0 for h in hits} == {True, False}


def test_bits_rails_and_noise():
    inputs = [Input(FORCE, bits=12, full_scale=1.0), Input(TIP, noise=0.5, bits=0, full_scale=1e6)]
    generator = FunctionWave()
    generator.on, generator.amplitude, generator.frequency = True, 2.0, 10.0
    bench = bench_of(inputs, [Drive(FORCE)], [generator])
    bench.start()
    block = bench.read()
    codes = block.data[0] * 2048
    np.testing.assert_allclose(codes, np.round(codes), atol=1e-9)
    assert block.data[0].max() == pytest.approx(2047 / 2048)
    assert block.data[0].min() == -1.0
    np.testing.assert_array_equal(block.overload, [True, False])
    quiet = bench_of([Input(FORCE), Input(TIP, noise=0.5, bits=0)], [Drive(FORCE)], [Silence()])
    assert read(quiet, 8192)[1].std() == pytest.approx(0.5, rel=0.05)


def test_same_seed_same_bits_other_seed_other_noise():
    def one(seed):
        player = Player()
        bench = bench_of([Input(FORCE, noise=0.1), Input(TIP, noise=0.1)], [Drive(FORCE)], [player], seed=seed)
        player.play(np.ones(100))
        return read(bench, 3072)

    np.testing.assert_array_equal(one(1), one(1))
    assert np.abs(one(1) - one(2)).max() > 0


def test_dropouts_are_counted_or_flagged():
    faults = Faults(dropouts=1.0, dropout_frames=100)
    bench = bench_of([Input(FORCE), Input(TIP)], [Drive(FORCE)], [Silence()], block=64, faults=faults)
    bench.start()
    blocks = [bench.read() for _ in range(200)]
    for before, after in pairwise(blocks):
        assert after.start == before.start + before.n_frames + after.lost
    assert sum(b.lost for b in blocks) > 0
    silent = replace(faults, silent=True)
    bench = bench_of([Input(FORCE), Input(TIP)], [Drive(FORCE)], [Silence()], block=64, faults=silent)
    bench.start()
    blocks = [bench.read() for _ in range(200)]
    assert sum(b.lost for b in blocks) == 0
    assert any(b.overflow for b in blocks)


def test_lost_frames_are_real_frames():
    wave = np.random.default_rng(0).standard_normal(64 * 400)

    def run(faults):
        player = Player()
        bench = bench_of(
            [Input(FORCE, bits=0), Input(TIP, noise=0.2, bits=0, full_scale=1e6)], [Drive(FORCE)], [player],
            block=64, faults=faults,
        )  # fmt: skip
        bench.start()
        player.play(wave)
        return [bench.read() for _ in range(150)]

    whole = np.hstack([b.data for b in run(None)])
    for block in run(Faults(dropouts=1.0, dropout_frames=100)):
        if block.start + 64 <= whole.shape[1]:
            np.testing.assert_allclose(block.data, whole[:, block.start : block.start + 64], atol=1e-9)


def test_drift_vanishing_and_order_of_calls():
    faults = Faults(drift_ppm=100.0, vanish=5.0)
    bench = bench_of([Input(FORCE), Input(TIP)], [Drive(FORCE)], [Silence()], faults=faults)
    with pytest.raises(DriverError, match="start it first"):
        bench.read()
    bench.start()
    first = bench.read()
    blocks = [bench.read(), bench.read()]
    assert blocks[1].time - first.time == pytest.approx(2 * 1024 / (RATE * 1.0001), abs=2e-6)
    with pytest.raises(DeviceLostError, match="unplugged after 5 s"):
        bench.read()


@pytest.mark.parametrize(("ppm", "said"), [(0.0, ()), (-300.0, "300 ± 0 ppm slow"), (20.0, ())])
def test_a_drifting_clock_is_noticed(ppm, said):
    faults = Faults(drift_ppm=ppm, dropouts=0.5, dropout_frames=50)
    bench = bench_of([Input(FORCE), Input(TIP)], [Drive(FORCE)], [Silence()], faults=faults)
    bench.start()
    while bench.time < 12.0:
        bench.read()
    assert said in bench.notes[0] if said else bench.notes == ()


def test_clock_drift_moves_a_generators_frequency():
    generator = FunctionWave()
    generator.on, generator.amplitude, generator.frequency = True, 1.0, 100.0
    faults = Faults(drift_ppm=2000.0)
    data = read(bench_of([Input(FORCE), Input(TIP)], [Drive(FORCE)], [generator], faults=faults), 8192)[0]
    turns = np.unwrap(np.angle(np.exp(-2j * np.pi * 100.0 / RATE * np.arange(8192)) * _analytic(data)))
    slope = np.polyfit(np.arange(1000, 7000), turns[1000:7000], 1)[0] * RATE / 2 / np.pi
    assert slope == pytest.approx(100 / 1.002 - 100, rel=0.01)


def _analytic(x):
    spectrum = np.fft.fft(x)
    spectrum[x.size // 2 :] = 0
    return np.fft.ifft(2 * spectrum)


def test_real_time_keeps_pace_and_counts_what_it_loses():
    bench = bench_of(
        [Input(FORCE), Input(TIP)], [Drive(FORCE)], [Silence()], rate=20480.0, block=512, real_time=True, buffer=0.1
    )
    with bench:
        bench.start()
        blocks = [bench.read(2.0) for _ in range(4)]
        time.sleep(0.4)
        blocks += [bench.read(2.0) for _ in range(10)]
    assert sum(b.lost for b in blocks) > 0
    for before, after in pairwise(blocks):
        assert after.start == before.start + before.n_frames + after.lost
    with pytest.raises(DriverError):
        bench.read()


def test_real_time_timeout():
    bench = bench_of([Input(FORCE), Input(TIP)], [Drive(FORCE)], [Silence()], rate=64.0, block=64, real_time=True)
    with bench:
        bench.start()
        with pytest.raises(DeviceTimeoutError, match=r"0\.01 s"):
            bench.read(0.01)


@settings(max_examples=20, deadline=None)
@given(cuts=st.lists(st.integers(0, 400), max_size=5), delay=st.floats(0, 3))
def test_decimator_streams(cuts, delay):
    x = np.random.default_rng(0).standard_normal((2, 400))
    delays = np.array([0.0, delay])
    whole = Decimator(4, delays).run(x)
    streaming = Decimator(4, delays)
    edges = [0, *sorted(cuts), 400]
    parts = np.hstack([streaming.run(x[:, a:b]) for a, b in pairwise(edges)])
    np.testing.assert_allclose(parts, whole, rtol=1e-12, atol=1e-12)


def test_interpolator_hits_the_samples():
    x = np.random.default_rng(0).standard_normal(200)
    fine = Interpolator(4).run(x)
    np.testing.assert_allclose(fine[::4], x[HALF - 1 : 200 - HALF], atol=1e-12)
    np.testing.assert_array_equal(Interpolator(1).run(x), x[HALF - 1 : 200 - HALF])


def test_gain_ramps_without_a_step():
    player = Player()
    bench = bench_of([Input(FORCE, **IDEAL), Input(TIP, **IDEAL)], [Drive(FORCE)], [player], block=128)
    bench.start()
    player.play(np.sin(2 * np.pi * np.arange(64) / 16), repeat=True, gain=0.1)
    before = np.hstack([bench.read().data[0] for _ in range(8)])
    reached = player.set_gain(1.0, ramp=200)
    after = np.hstack([bench.read().data[0] for _ in range(8)])
    assert np.abs(before[-300:]).max() == pytest.approx(0.1, rel=1e-3)
    assert np.abs(after[reached - 1024 + 40 :]).max() == pytest.approx(1.0, rel=1e-3)
    envelope = np.abs(np.concatenate([before[-128:], after]))
    assert np.all(np.diff([envelope[i : i + 16].max() for i in range(0, 900, 16)]) > -1e-3)
