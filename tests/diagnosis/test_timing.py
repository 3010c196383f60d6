"""Places told by when distortion comes; what is no excitation and no drift."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from labnnum.diagnosis.gates import drifted
from labnnum.diagnosis.nonlinear.identified import own_scatter
from labnnum.diagnosis.nonlinear.joined import records
from labnnum.diagnosis.nonlinear.lines import choose_lines
from labnnum.diagnosis.nonlinear.locate import Spot
from labnnum.diagnosis.nonlinear.timing import Timed, timing, told
from labnnum.diagnosis.observe import excited_lines, observe
from labnnum.diagnosis.verdict import Limits
from labnnum.mechanisms.base import Place
from labnnum.recording import Channel, Recording

RATE, N, PERIODS = 400.0, 4096, 4


def spots():
    nodes = [Spot(Place("ground", n), "z", np.zeros(1)) for n in "123"]
    joints = [Spot(Place("joint", a, b), "z", np.zeros(1)) for a, b in ("12", "13", "23")]
    return [*nodes, *joints]


def rattling(where, seed=1, size=0.3):
    """Three accelerations, in the band at random, with a rattle above it whenever the motion `where` is large."""
    rng = np.random.default_rng(seed)
    f = np.fft.rfftfreq(N, 1 / RATE)
    on = (f >= 2) & (f <= 15)
    z = np.zeros((3, f.size), complex)
    z[:, on] = rng.normal(size=(3, on.sum())) + 1j * rng.normal(size=(3, on.sum()))
    motion = np.fft.irfft(z, N)
    acceleration = np.fft.irfft(z * (2j * np.pi * f) ** 2, N)
    felt = motion[where[0]] - (motion[where[1]] if len(where) > 1 else 0)
    hit = np.abs(felt) > np.quantile(np.abs(felt), 0.8)
    noise = np.fft.rfft(rng.normal(size=N))
    noise[f < 25] = 0
    rattle = size * np.fft.irfft(noise, N) * acceleration.std() * hit
    y = acceleration + np.array([0.3, 1.0, 0.8])[:, None] * rattle
    force = np.fft.irfft(np.where(on, np.exp(2j * np.pi * rng.random(f.size)), 0), N)
    data = np.tile(np.vstack([force / force.std(), y]), (1, PERIODS))
    data = data + 1e-4 * rng.normal(size=data.shape) * data.std(axis=1, keepdims=True)
    channels = [Channel("force", "force", "reference", "1", "z")]
    channels += [Channel(f"acc{n}", "acceleration", "response", n, "z") for n in "123"]
    return observe(Recording(tuple(channels), data, RATE, period=N, label="rattle"))


@pytest.mark.parametrize(("where", "place"), [((1, 2), Place("joint", "2", "3")), ((2,), Place("ground", "3"))])
def test_the_place_whose_motion_times_the_rattle_leads(where, place):
    timed = timing([rattling(where)], spots())
    assert timed[0].spot.place == place
    assert timed[0].share > 0.3 > timed[1].share
    assert told(timed, Limits())


def test_the_run_that_distorts_most_decides():
    faint = rattling((2,), seed=3, size=0.01)
    loud = rattling((1, 2), seed=4)
    assert timing([faint, loud], spots())[0].spot.place == Place("joint", "2", "3")


def test_a_place_is_told_by_twice_what_the_next_one_explains():
    """A smooth law's distortion, through the structure's own modes, follows every place a little."""
    first, second = spots()[:2]
    for share, clear in ((0.26, True), (0.18, False)):
        timed = [Timed(first, share, 90.0), Timed(second, 0.12, 40.0)]
        assert told(timed, Limits()) == clear


def test_without_distortion_nothing_is_told():
    timed = timing([rattling((1, 2), size=0.0)], spots())
    assert timed == []
    assert not told(timed, Limits())


def test_places_without_a_sensor_are_passed_over():
    far = Spot(Place("joint", "3", "9"), "z", np.zeros(1))
    assert far.place not in [t.spot.place for t in timing([rattling((1, 2))], [*spots(), far])]


def test_what_the_structure_puts_on_the_force_is_not_excited():
    size = np.full(400, 1e-6)
    size[40:120] = 1.0
    size[120:300] = 3e-3 * (1 + np.sin(np.arange(180)))
    on = excited_lines(size.copy(), np.full(400, 1e-7))
    assert on[40:120].all()
    assert not on[120:].any()
    coloured = np.geomspace(1.0, 2e-3, 400)
    assert excited_lines(coloured.copy(), np.full(400, 1e-7))[1:].all()


def test_a_creep_that_levels_dwarf_is_no_drift():
    rng = np.random.default_rng(2)
    one = rattling((2,), seed=3)
    stretch = -np.gradient(one.frf.value, one.frf.omega, axis=2) * one.frf.omega
    slope = replace(one.frf, value=2e-4 * stretch)
    low = replace(one, level=1.0, drift=3.0, drift_slope=slope)
    other = replace(low.frf, value=2.0 * low.frf.value)
    assert drifted([low, replace(low, level=3.0, frf=other)])[0] is None
    same = drifted([low, replace(low, level=3.0)])[0]
    assert same is not None
    assert same.term.mechanism.id == "drift"
    assert same.value == pytest.approx(8e-4)
    noise = replace(one.frf, value=1e-3 * one.frf.value * rng.normal(size=one.frf.value.shape))
    assert drifted([replace(low, drift=1.5, drift_slope=noise)])[0] is None  # its halves differ, and no frequency moves
    assert drifted([replace(low, drift_slope=noise)])[0] is not None
    small = replace(one.frf, value=2e-5 * stretch)
    assert drifted([replace(low, drift=1.5, drift_slope=small)])[0] is None
    assert drifted([replace(low, drift=1.5)])[0] is not None


def test_a_sweep_is_kept_in_the_band_only():
    rate, n = 400.0, 20000
    time = np.arange(n) / rate
    force = np.sin(2 * np.pi * (15 * time - 0.125 * time**2))
    y = np.vstack([force, np.roll(force, 3)])
    channels = (Channel("f", "force", "reference", "1", "z"), Channel("a", "acceleration", "response", "1", "z"))
    (run,) = records([observe(Recording(channels, y, rate, label="sweep"))], (2.5, 14.0), 0.1)
    assert run.rate < 60.0
    assert run.miss == 0.1
    compared = run.frequency[run.compared]
    assert compared[0] >= 2.5
    assert compared[-1] <= 14.0


def test_what_an_identified_base_misses_widens_its_errors():
    run = rattling((2,)).run
    assert run is not None
    plain, wide = choose_lines(run), choose_lines(replace(run, miss=0.1))
    row = np.sqrt(np.mean(np.abs(run.y[:, plain.at]) ** 2, axis=1, keepdims=True))
    assert np.allclose(wide.sigma**2, plain.sigma**2 + (0.1 * row) ** 2)
    assert own_scatter(0.0).floor < own_scatter(0.1).floor == 0.05


def test_the_f16_rattles_at_the_joint_between_acc2_and_acc3(recordings):
    from sessions.diagnose import observations_of

    folder = Path(__file__).resolve().parents[2] / "examples" / "recordings" / "f16"
    found = observations_of([recordings / "f16" / "F16Data_FullMSine_Level7.mat"], folder / "channels.toml")
    assert np.allclose(found[0].frf.frequency[[0, -1]], [2.0, 15.0], atol=0.06)
    timed = timing(found, spots())
    assert timed[0].spot.place == Place("joint", "2", "3")
    assert told(timed, Limits())
