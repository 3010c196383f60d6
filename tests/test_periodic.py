"""Period averaging: exact periods, honest noise, realisations, gaps, and a real ground vibration test."""

import numpy as np
import pytest
from scipy.io import loadmat
from scipy.signal import lfilter

from labnnum.errors import ChannelError, EstimationError, QualityError
from labnnum.estimators import periodic, periodic_spectra, robust
from labnnum.excitation import multisine
from labnnum.periodic import excited_lines
from labnnum.recording import Channel, Recording

RATE, N = 512.0, 512
CHANNELS = (Channel("f", "force", "reference"), Channel("x", "displacement"))


def truth(f):
    return 1 / (1 - 0.9 * np.exp(-2j * np.pi * f / RATE))


def run(seed: int, periods: int = 6, noise: float = 0.1, noise_in: float = 0.0, cubic: float = 0.0, **options):
    rng = np.random.default_rng(1000 + seed)
    drive = multisine(RATE, N, (5.0, 200.0), rms=1.0, seed=seed, n_periods=periods + 2, **options)
    f = drive.samples
    x = lfilter([1.0], [1, -0.9], f + cubic * f**3)
    data = np.stack([f + noise_in * rng.standard_normal(f.size), x + noise * rng.standard_normal(f.size)])
    return Recording(CHANNELS, data, RATE, period=N, drop_periods=2, level=1.0, label=f"run {seed}"), drive


def test_the_mean_period_is_exact_without_noise():
    recording, drive = run(1, noise=0.0)
    s = periodic_spectra(recording)
    wanted = np.fft.rfft(drive.samples[:N]) * 2 / N
    np.testing.assert_allclose(s.spectrum[0, drive.lines], wanted[drive.lines], rtol=1e-10)
    np.testing.assert_allclose(s.mean_period()[0], drive.samples[:N], atol=1e-12)
    assert s.n_periods == 6
    frf = periodic(recording)
    np.testing.assert_allclose(frf.frequency, drive.frequency)
    np.testing.assert_allclose(frf.value[0, 0], truth(frf.frequency), rtol=1e-8)


def test_the_noise_of_the_mean_is_that_of_repeats():
    told = periodic_spectra(run(1)[0]).noise_variance[1].mean()
    # white noise of variance s^2 has E|amplitude|^2 = 4 s^2 / N in a line, over 6 periods a sixth of it
    assert told == pytest.approx(4 * 0.1**2 / N / 6, rel=0.15)


def test_detection_lines_are_told_from_excited_ones():
    recording, drive = run(3, noise=0.01, cubic=0.02)
    found = np.flatnonzero(periodic_spectra(recording).excited())
    np.testing.assert_array_equal(found, drive.lines)


def test_a_notch_in_the_force_stays_excited():
    line = np.arange(1, 200)
    size = np.abs(1 - 0.97 / (1 + ((line - 100) / 10.0) ** 2))[None]
    assert excited_lines(np.concatenate([[[0.0]], size], axis=1), np.zeros((1, 200)))[1:].all()


def test_the_variance_of_one_realisation_is_honest():
    errors = []
    for seed in range(60):
        frf = periodic(run(seed, noise=0.2, noise_in=0.1, periods=8)[0])
        errors.append(np.abs(frf.value[0, 0] - truth(frf.frequency)) ** 2 / frf.variance[0, 0])
    # with 8 periods the ratio has the mean of an F(2, 14) variable, 7/6
    assert np.concatenate(errors).mean() == pytest.approx(7 / 6, rel=0.08)


def test_realisations_tell_noise_from_distortion():
    options = {"detection": 0}
    quiet = robust([run(s, noise=0.2, **options)[0] for s in range(10)])
    bent = robust([run(s, noise=0.02, cubic=0.1, **options)[0] for s in range(10)])
    ratio = (quiet.frf.variance / quiet.noise_variance).mean()
    assert ratio == pytest.approx(1.0, abs=0.15)
    assert np.median(bent.frf.variance / bent.noise_variance) > 30
    assert np.median(quiet.distortion_variance) < 0.3 * np.median(10 * quiet.noise_variance)
    # of one realisation: M times the total less the noise
    np.testing.assert_allclose(
        bent.distortion_variance, np.maximum(10 * (bent.frf.variance - bent.noise_variance), 0), rtol=1e-12
    )
    assert bent.frf.settings["n_realisations"] == 10
    assert len(bent.realisations) == 10


def test_the_linearised_gain_of_a_cubic_is_that_of_gaussian_input():
    # best linear approximation of f + c f^3 at unit RMS: 1 + 3c (many lines are nearly Gaussian)
    bent = periodic([run(s, noise=0.01, cubic=0.1, detection=0)[0] for s in range(20)])
    gain = np.mean(bent.value[0, 0] / truth(bent.frequency))
    assert gain.real == pytest.approx(1.3, rel=0.02)


def test_two_inputs_take_two_realisations_each_with_its_own_phases():
    channels = (CHANNELS[0], Channel("g", "force", "reference"), CHANNELS[1])

    def both(seed):
        rng = np.random.default_rng(seed)
        a, b = (multisine(RATE, N, (5.0, 200.0), seed=s, detection=0, n_periods=6).samples for s in (seed, seed + 50))
        x = lfilter([1.0], [1, -0.9], a) + lfilter([0.5], [1, 0.5], b) + 0.05 * rng.standard_normal(a.size)
        return Recording(channels, np.stack([a, b, x]), RATE, period=N, drop_periods=2)

    with pytest.raises(EstimationError, match="2 inputs need at least 2 realisations"):
        periodic(both(0))
    frf = periodic([both(s) for s in range(5)])
    f = frf.frequency
    wanted = np.stack([truth(f), 0.5 / (1 + 0.5 * np.exp(-2j * np.pi * f / RATE))])
    error = np.abs(frf.value[0] - wanted) ** 2 / frf.variance[0]
    assert np.median(error) < 2
    assert np.abs(frf.value[0] / wanted - 1).max() < 0.1
    assert frf.input_condition.shape == f.shape


def test_spans_after_a_gap_are_aligned_by_their_input():
    recording, drive = run(5, noise=0.05, periods=8)
    lost = 137
    data = np.concatenate([recording.data[:, : 5 * N], recording.data[:, 5 * N + lost :]], axis=1)
    broken = Recording(CHANNELS, data, RATE, breaks=(5 * N,), period=N, drop_periods=1)
    s = periodic_spectra(broken)
    assert s.n_periods == 4 + 3
    whole = periodic_spectra(recording)
    np.testing.assert_allclose(s.spectrum[0, drive.lines], whole.spectrum[0, drive.lines], rtol=1e-9)
    other = multisine(RATE, N, (5.0, 200.0), seed=77, n_periods=5).samples
    mixed = np.concatenate([recording.data[:1, : 5 * N], other[None]], axis=1)
    with pytest.raises(EstimationError, match="different periodic signals"):
        periodic_spectra(Recording(CHANNELS[:1], mixed, RATE, breaks=(5 * N,), period=N))


def test_one_period_has_no_variance_and_no_coherence():
    recording, _ = run(6, periods=1)
    s = periodic_spectra(recording)
    assert np.isnan(s.noise_variance).all()
    frf = periodic(recording)
    assert frf.variance is None
    assert frf.coherence is None
    with pytest.raises(QualityError, match="single average"):
        frf.require_coherence(0.1)


def test_coherence_stands_for_the_noise_per_line():
    clear = periodic(run(7, noise=0.01)[0])
    assert clear.require_coherence(0.99) is clear
    with pytest.raises(QualityError, match="'x'"):
        periodic(run(7, noise=20.0)[0]).require_coherence(0.9)


def test_what_does_not_fit_is_refused():
    recording, _ = run(8)
    free = Recording(CHANNELS, recording.data, RATE)
    with pytest.raises(EstimationError, match="set the period"):
        periodic(free)
    with pytest.raises(EstimationError, match="lower drop_periods"):
        periodic(Recording(CHANNELS, recording.data, RATE, period=N, drop_periods=8))
    louder = Recording(CHANNELS, recording.data, RATE, period=N, level=2.0, label="loud")
    with pytest.raises(EstimationError, match="level"):
        periodic([recording, louder])
    longer = Recording(CHANNELS, recording.data, RATE, period=2 * N)
    with pytest.raises(EstimationError, match="period"):
        periodic([recording, longer])
    with pytest.raises(EstimationError, match="between 0 and"):
        periodic(recording, lines=np.array([N]))
    with pytest.raises(ChannelError, match="input"):
        periodic(Recording(CHANNELS[1:], recording.data[1:], RATE, period=N))
    wrong = np.random.default_rng(0).standard_normal((2, 8000))
    with pytest.raises(EstimationError, match="is the period"):
        periodic(Recording(CHANNELS, wrong, RATE, period=N - 37))


def test_an_aircraft_under_a_real_multisine(recordings):
    data = loadmat(recordings / "f16" / "F16Data_FullMSine_Level1.mat", squeeze_me=True)
    channels = (CHANNELS[0], *(Channel(f"acc{k}") for k in (1, 2, 3)))
    signal = np.vstack([data["Force"][None], np.atleast_2d(data["Acceleration"])])
    frf = periodic(Recording(channels, signal, 400.0, period=8192, drop_periods=1))
    assert frf.n_averages == 8
    assert 1.9 < frf.frequency[0] < frf.frequency[-1] < 15.1
    torsion = frf.lines(6.5, 8.0)
    size = np.abs(torsion.value[2, 0])
    # published for this level: the torsion peak at 7.32 Hz
    assert torsion.frequency[int(np.argmax(size))] == pytest.approx(7.32, abs=0.05)
    assert np.median(np.sqrt(frf.variance) / np.abs(frf.value)) < 0.05
