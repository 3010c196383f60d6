"""Hits, noise and sweeps in the nonlinear diagnosis: simulated responses against another march, and their signs."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from labnnum.diagnosis import observe_all
from labnnum.diagnosis.engine import Engine
from labnnum.diagnosis.nonlinear.explore import engine_start
from labnnum.diagnosis.nonlinear.force import CODES
from labnnum.diagnosis.nonlinear.lines import choose_lines
from labnnum.diagnosis.nonlinear.problem import Joint, reduced
from labnnum.diagnosis.nonlinear.receptance import Base
from labnnum.diagnosis.nonlinear.records import changed, hits_of, split, stretch_of
from labnnum.diagnosis.nonlinear.run import hann_of
from labnnum.diagnosis.nonlinear.steady import Steady
from labnnum.diagnosis.scatter import Scatter
from labnnum.nonlinear import Element, NonlinearSimulation
from labnnum.recording import Channel, Recording
from labnnum.structures import Chain
from labnnum.structures.chain import Link
from labnnum.system import system

RATE, FINE = 40.0, 16
OUTPUTS = tuple(Channel(f"a{i}", "acceleration", "response", str(i), "x") for i in (1, 2, 4))
FORCE = Channel("f", "force", "reference", "3", "x")
CUBIC = (3e4,)


def chain(c=4.0):
    links = [Link("1", "ground", 1000.0, c)] + [Link(str(i), str(i + 1), 1000.0, c) for i in range(1, 4)]
    return Chain({str(i): 1.0 for i in range(1, 5)}, tuple(links), ())


def joint_23():
    column = np.zeros(4)
    column[1], column[2] = -1.0, 1.0
    return column


def recorded(force, elements, structure=None):
    """The recording of a force (n,) from rest, marched on `FINE` steps a sample."""
    structure = structure or chain()
    n = force.size
    fine = np.fft.irfft(np.fft.rfft(force), n * FINE) * FINE
    march = NonlinearSimulation(system(structure, structure.nominal, OUTPUTS, [FORCE]), elements, 1 / (RATE * FINE))
    y = march.run(np.append(fine, np.zeros(march.delay))[None])
    spectrum = np.fft.rfft(y, axis=1)[:, : n // 2 + 1]
    return Recording((FORCE, *OUTPUTS), np.vstack([force, np.fft.irfft(spectrum, n, axis=1) / FINE]), RATE, label="run")


def noise(level, n=8192, seed=1):
    """Noise from 0.3 to 12 Hz that begins and ends softly."""
    spectrum = np.fft.rfft(np.random.default_rng(seed).standard_normal(n))
    frequency = np.fft.rfftfreq(n, 1 / RATE)
    spectrum[(frequency < 0.3) | (frequency > 12)] = 0
    x = np.fft.irfft(spectrum, n)
    x[:64] *= np.linspace(0, 1, 64)
    x[-64:] *= np.linspace(1, 0, 64)
    return level * x / x.std()


def sweep(level, n=8192):
    """A sine from 0.5 to 12 Hz that begins softly and stops in motion."""
    t = np.arange(n) / RATE
    x = np.sin(2 * np.pi * (0.5 * t + 11.5 * t**2 / 2 / t[-1]))
    x[:16] *= np.linspace(0, 1, 16)
    return level * x


def blow(level, n=1024, sharp=0.05):
    return level * np.exp(-(((np.arange(n) / RATE - 1.0) / sharp) ** 2))


def simulated(run, law, p):
    """Responses to the run's input, linear and with the law, on the lines that are compared."""
    engine = Engine(chain(), OUTPUTS, (FORCE,), (2 * np.pi * 0.3, 2 * np.pi * 12))
    omega = 2 * np.pi * np.arange(run.period // 2 + 1) * run.rate / run.period
    base = Base(engine, engine.start(), joint_23()[:, None], omega, run.decay)
    r = base.at(base.start())
    solver = Steady(run, np.array([CODES[law]]), 4)
    parameters = np.zeros((1, 10))
    parameters[0, : len(p)] = p
    orbit = solver.settle(r, parameters, solver.guess(r, np.zeros((solver.n, 1))), 12)
    linear = r.lift * (r.plain * run.u)
    return run.seen(linear), run.seen(linear + r.lift * (r.h * orbit.force).sum(axis=1))


@pytest.mark.parametrize("kind", ["noise", "hit", "sweep"])
def test_what_is_simulated_of_a_record_is_what_another_march_records(kind):
    if kind == "noise":
        recording = recorded(noise(25.0), [Element("cubic", joint_23(), CUBIC)])
        run = stretch_of(recording, 2000, 6096)  # begins and ends in motion
    elif kind == "sweep":
        whole = recorded(np.append(sweep(15.0), np.zeros(2048)), [Element("cubic", joint_23(), CUBIC)])
        recording = Recording(whole.channels, whole.data[:, :8192], RATE, label="sweep")  # ends in motion
        run = split(observe_all([recording]), 10.0).train[0].run
        run = replace(run, use=None)
        driven = run.frequency[run.inside]
        assert driven[0] < 0.55
        assert driven[-1] > 11
    else:
        recording = recorded(blow(400.0), [Element("cubic", joint_23(), CUBIC)])
        run = hits_of(observe_all([recording])[0])[0]
    linear, made = simulated(run, "cubic", CUBIC)
    truth = run.seen(run.y)
    inside = (run.frequency > 0.5) & (run.frequency < 8)
    size = np.linalg.norm(truth[:, inside])
    assert np.linalg.norm((truth - linear)[:, inside]) > 0.05 * size  # the law matters
    assert np.linalg.norm((truth - made)[:, inside]) < 0.005 * size


@pytest.mark.parametrize(("elements", "told"), [([], False), ([Element("cubic", joint_23(), CUBIC)], True)])
def test_signs_are_changes_with_level(elements, told):
    rng = np.random.default_rng(3)
    rows = []
    for level, seed in ((5.0, 1), (25.0, 2)):
        recording = recorded(noise(level, seed=seed), elements)
        data = recording.data + 1e-3 * rng.standard_normal(recording.data.shape)
        rows.append(Recording(recording.channels, data, RATE, label=f"level {level:g}"))
    assert changed(observe_all(rows)) is told


def two_levels(elements, structure=None, seed=1):
    """Observations of noise at two levels, with other noise added to every channel."""
    rng = np.random.default_rng(100 + seed)
    rows = []
    for level, own in ((5.0, seed), (17.0, seed + 1)):
        recording = recorded(noise(level, seed=own), elements, structure)
        data = recording.data + 1e-3 * rng.standard_normal(recording.data.shape)
        rows.append(Recording(recording.channels, data, RATE, label=f"level {level:g}"))
    return observe_all(rows)


@pytest.mark.parametrize("seed", [1, 3])
def test_noise_that_grows_with_level_is_a_sign_though_no_frf_changes(seed):
    """An even law leaves FRFs as they are, and makes noise of their input."""
    made = two_levels([Element("quadratic", joint_23(), (300.0,))], seed=seed)
    low, high = (o.frf for o in made)
    _, i, j = np.intersect1d(low.frequency, high.frequency, return_indices=True)
    low, high = low.at(i), high.at(j)
    assert low.variance is not None
    assert high.variance is not None
    change = np.abs(low.value - high.value) ** 2 / (low.variance + high.variance)
    assert np.all(change.mean(axis=(1, 2)) < 1)
    assert changed(made)


@pytest.mark.parametrize("damping", [4.0, 0.4, 0.1])
@pytest.mark.parametrize("seed", [1, 3])
def test_noise_that_was_added_and_leakage_are_no_sign(damping, seed):
    assert not changed(two_levels([], chain(damping), seed))


@pytest.mark.parametrize("sharp", [0.08, 0.01])
def test_noise_of_a_hit_is_what_stands_before_the_blow(sharp):
    """A blow that reaches to the end of the spectrum leaves no line to noise alone."""
    force = blow(400.0, sharp=sharp)
    plain = np.vstack([force, *(lfilter([1.0], [1.0, a, 0.97], force) for a in (-1.6, -0.9, 0.5))])
    std = 1e-4 * np.abs(plain).max(axis=1)
    data = plain + std[:, None] * np.random.default_rng(3).standard_normal(plain.shape)
    observed = observe_all([Recording((FORCE, *OUTPUTS), data, RATE, label="run")])[0]
    run, n = hits_of(observed)[0], int(observed.frf.settings["n_segment"])
    window = np.exp(-run.decay * np.arange(n) / RATE)
    own = std[1:] ** 2 * np.sum(window**2) * (2 / n) ** 2
    least = run.noise.min(axis=1) / own
    assert least.min() > 0.1  # where the quietest lines are noise alone, they are its quietest
    assert least.max() < 3.0


@pytest.mark.parametrize("offset", [0.0, 3.0])
def test_a_line_of_noise_alone_counts_as_not_driven(offset):
    """A converter's noise at the lowest lines would be a motion of metres."""
    plain = recorded(noise(25.0), [])
    data = plain.data + 0.25 * np.random.default_rng(7).standard_normal(plain.data.shape) + offset
    run = stretch_of(Recording(plain.channels, data, RATE, label="run"), 1000, 6000)
    driven = run.frequency[run.inside]
    assert 0.2 < driven[0] < 0.5
    assert 11.5 < driven[-1] < 12.5


def test_spectra_under_a_window_are_those_of_the_signal_under_it():
    n = 64
    x = np.random.default_rng(1).standard_normal((2, n))
    window = 0.5 - 0.5 * np.cos(2 * np.pi * np.arange(n) / n)
    seen = hann_of(np.fft.rfft(x, axis=1))
    np.testing.assert_allclose(seen[:, :-1], np.fft.rfft(x * window, axis=1)[:, :-1], atol=1e-12)


def test_what_rings_from_before_a_stretch_is_no_misfit():
    """A linear structure at its own parameters, through a stretch of five decay times of its slowest mode."""
    structure = chain(4.0)
    recording = recorded(noise(25.0), [], structure)
    data = recording.data + 1e-4 * np.random.default_rng(3).standard_normal(recording.data.shape)
    run = stretch_of(Recording(recording.channels, data, RATE, label="run"), 3000, 3720)
    engine = Engine(structure, OUTPUTS, (FORCE,), (2 * np.pi * 0.3, 2 * np.pi * 12))
    scatter = Scatter()
    joint = Joint(engine, engine.start(), [run], (), scatter, [choose_lines(run, 0, 1e-4)])
    x = engine_start(joint)
    state = engine.state(engine.theta0)
    zeta = 4.0 * state.omega[engine.band_modes] / 2000.0
    at = engine.theta0.size + engine.band_modes.size
    x[at : at + zeta.size] = np.log(zeta)
    columns = joint.parts(x, [None])
    shared = columns[1].shape[1] - 2 * engine.band_modes.size
    with_ringing = reduced(*columns)[0] / columns[0].size
    without = reduced(columns[0], columns[1][:, :shared])[0] / columns[0].size
    assert with_ringing < 2
    assert without > 20 * with_ringing


def test_stretches_that_are_held_out_are_not_fitted():
    parts = split(observe_all([recorded(noise(5.0), [])]), decay_time=1.0)
    (own,), (held,) = ([o.run for o in side] for side in (parts.train, parts.test))
    assert own.period == held.period
    assert own.open
    assert not own.lasting
    assert not np.allclose(own.u, held.u)


def test_a_sweep_holds_out_lines():
    n = 8192
    time = np.arange(n) / RATE
    sweep = 5.0 * np.sin(2 * np.pi * (0.3 * time + (12 - 0.3) * time**2 / 2 / time[-1]))
    parts = split(observe_all([recorded(sweep, [])]), decay_time=1.0)
    (own,), (held,) = ([o.run for o in side] for side in (parts.train, parts.test))
    assert not (own.compared & held.compared).any()
    assert 0.2 < held.compared.sum() / own.inside.sum() < 0.3


def test_lines_of_a_sweep_are_compared_where_the_input_holds_their_neighbours():
    """Through a Hann window a line holds its neighbours, and what the input had outside its band is taken as none."""
    n = 8192
    t = np.arange(n) / RATE
    force = 5.0 * np.sin(2 * np.pi * (1.0 * t + 2.0 * t**2 / t[-1])) * np.hanning(n) ** 0.1
    run = stretch_of(recorded(force, []), 0, n)
    at = np.flatnonzero(run.compared)
    assert at.size > 100
    assert np.all(run.u[at - 1] != 0)
    assert np.all(run.u[at + 1] != 0)


def test_with_two_inputs_at_once_nothing_is_told():
    rows = []
    for level, seed in ((5.0, 1), (25.0, 2)):
        one = recorded(noise(level, seed=seed), [Element("cubic", joint_23(), CUBIC)])
        second = Channel("g", "force", "reference", "1", "x")
        data = np.vstack([one.data, noise(level, seed=seed + 10)])
        rows.append(Recording((*one.channels, second), data, RATE, label=f"level {level:g}"))
    observations = observe_all(rows)
    assert not changed(observations)
    assert not split(observations, decay_time=1.0).train
