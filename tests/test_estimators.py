"""H1, H2, Hv and coherence: exact systems, known noise, several inputs, real hammer hits, and other programs."""

import numpy as np
import pytest
from scipy.signal import coherence as scipy_coherence
from scipy.signal import csd, find_peaks, lfilter, welch

from labnnum.errors import ChannelError, EstimationError, QualityError
from labnnum.estimators import H1, H2, Hits, Hv, Welch, coherence
from labnnum.recording import Channel, Recording

RATE = 1000.0
FORCES = (Channel("f1", "force", "reference"), Channel("f2", "force", "reference"))
MOTIONS = (Channel("x1", "displacement"), Channel("x2", "displacement"))


def fir(f: np.ndarray, taps: np.ndarray) -> np.ndarray:
    return np.exp(-2j * np.pi * np.outer(f / RATE, np.arange(taps.size))) @ taps


def siso(n: int, seed: int, noise_out: float = 0.0, noise_in: float = 0.0) -> Recording:
    rng = np.random.default_rng(seed)
    f = rng.standard_normal(n)
    x = lfilter([1.0, -0.5], [1.0], f)
    data = np.stack([f + noise_in * rng.standard_normal(n), x + noise_out * rng.standard_normal(n)])
    return Recording((FORCES[0], MOTIONS[0]), data, RATE)


@pytest.mark.parametrize("estimator", [H1, H2, Hv])
def test_a_circular_system_without_noise_is_exact(estimator):
    rng = np.random.default_rng(0)
    f = np.tile(rng.standard_normal(64), 12)
    x = lfilter([1.0, -0.5], [1.0], f)
    recording = Recording((FORCES[0], MOTIONS[0]), np.stack([f, x])[:, 128:], RATE)
    frf = estimator(Welch(64, "boxcar", 0.0, "none"))(recording)
    np.testing.assert_allclose(frf.value[0, 0], fir(frf.frequency, np.array([1.0, -0.5])), rtol=1e-10)
    np.testing.assert_allclose(frf.coherence, 1.0, atol=1e-10)


def test_h1_bears_noise_on_the_response_and_h2_on_the_input():
    out, in_ = siso(400_000, 1, noise_out=1.0), siso(400_000, 2, noise_in=1.0)
    processor = Welch(64)
    for good, bad, recording in ((H1, H2, out), (H2, H1, in_)):
        truth = fir(good(processor)(recording).frequency, np.array([1.0, -0.5]))
        assert np.abs(good(processor)(recording).value[0, 0] / truth - 1)[1:-1].max() < 0.05
        assert np.abs(bad(processor)(recording).value[0, 0] / truth - 1).mean() > 0.3


def test_hv_is_the_geometric_mean_of_h1_and_h2_with_one_input():
    recording = siso(20_000, 3, 0.5, 0.5)
    one, two, mean = (e(Welch(128))(recording).value for e in (H1, H2, Hv))
    np.testing.assert_allclose(np.abs(mean), np.sqrt(np.abs(one) * np.abs(two)), rtol=1e-9)
    np.testing.assert_allclose(np.angle(mean), np.angle(one), atol=1e-9)


def mimo(n: int, seed: int, noise: float) -> tuple[Recording, np.ndarray]:
    rng = np.random.default_rng(seed)
    f = rng.standard_normal((2, n))
    f[1] = 0.6 * f[0] + 0.8 * f[1]
    taps = np.array([[[1.0, 0.5], [0.3, -0.2]], [[-0.4, 0.1], [2.0, 1.0]]])
    x = np.stack([sum(lfilter(taps[o, i], [1.0], f[i]) for i in range(2)) for o in range(2)])
    x += noise * rng.standard_normal(x.shape)
    return Recording(FORCES + MOTIONS, np.vstack([f, x]), RATE), taps


@pytest.mark.parametrize("estimator", [H1, Hv])
def test_two_correlated_inputs_are_separated(estimator):
    recording, taps = mimo(300_000, 4, 0.05)
    frf = estimator(Welch(64))(recording)
    for o in range(2):
        for i in range(2):
            truth = fir(frf.frequency, taps[o, i])
            assert np.abs(frf.value[o, i] - truth)[1:-1].max() < 0.03
    assert frf.coherence.min() > 0.98
    # two unit signals of correlation 0.6 have eigenvalues 1.6 and 0.4
    np.testing.assert_allclose(frf.input_condition[2:-2], 4.0, rtol=0.15)


def test_multiple_coherence_is_the_share_that_both_inputs_explain():
    recording, _ = mimo(400_000, 5, 1.0)
    frf = H1(Welch(64))(recording)
    sxx = Welch(64)(recording).auto("x2")
    np.testing.assert_allclose(frf.coherence[1][2:-2], (1 - 2 / RATE / sxx)[2:-2], atol=0.02)


@pytest.mark.parametrize("overlap", [0.0, 0.5])
def test_the_variance_is_that_of_repeated_measurements(overlap):
    runs = [H1(Welch(32, overlap=overlap))(siso(600, seed, noise_out=1.0)) for seed in range(500)]
    values = np.array([r.value[0, 0] for r in runs])[:, 2:-2]
    told = np.mean([r.variance[0, 0] for r in runs], axis=0)[2:-2]
    seen = np.var(values, axis=0)
    # n averages are few here: E[1/S_ff] exceeds 1/E[S_ff], which the formula, built on the measured S_ff, follows
    assert np.mean(told) / np.mean(seen) == pytest.approx(1.0, abs=0.08)


def test_the_variance_with_two_inputs_is_that_of_repeated_measurements():
    runs = [H1(Welch(32, overlap=0.0))(mimo(800, seed, 1.0)[0]) for seed in range(250)]
    seen = np.var([r.value for r in runs], axis=0)[..., 2:-2].mean(axis=-1)
    told = np.mean([r.variance for r in runs], axis=0)[..., 2:-2].mean(axis=-1)
    np.testing.assert_allclose(told / seen, 1.0, atol=0.15)


@pytest.mark.parametrize("estimator", [H2, Hv])
def test_the_other_estimators_know_their_variance(estimator):
    runs = [estimator(Welch(32, overlap=0.0))(siso(3200, seed, 0.3, 0.3)) for seed in range(250)]
    seen = np.var([r.value[0, 0, 2:-2] for r in runs], axis=0).mean()
    told = np.mean([r.variance[0, 0, 2:-2] for r in runs])
    assert told / seen == pytest.approx(1.0, abs=0.15)


def test_a_single_hit_has_no_coherence_and_refuses_a_check():
    t = np.arange(512)
    force = np.exp(-0.5 * ((t - 20) / 2.0) ** 2)
    recording = Recording((FORCES[0], MOTIONS[0]), np.stack([force, lfilter([1.0], [1, -0.9], force)]), RATE)
    for processor in (Hits(), Welch(512, "boxcar", 0.0, "none")):
        frf = H1(processor)(recording)
        assert frf.coherence is None
        assert frf.variance is None
        assert frf.n_averages == 1
        assert frf.settings["transient"]
        assert frf.settings["pretrigger"] == 20
        with pytest.raises(QualityError, match="single average"):
            frf.require_coherence(0.0)


def test_lines_without_input_are_left_out():
    rng = np.random.default_rng(6)
    spectrum = np.zeros(33, complex)
    spectrum[3:20:2] = np.exp(2j * np.pi * rng.uniform(size=9))
    f = np.tile(np.fft.irfft(spectrum), 10)
    recording = Recording((FORCES[0], MOTIONS[0]), np.stack([f, 2 * f + 1e-9 * rng.standard_normal(640)]), RATE)
    frf = H1(Welch(64, "boxcar", 0.0))(recording)
    np.testing.assert_allclose(frf.frequency, np.arange(3, 20, 2) * RATE / 64)
    assert frf.settings["dropped_lines"] == 33 - 9


def test_inputs_that_move_together_are_refused():
    rng = np.random.default_rng(7)
    f = rng.standard_normal(4000)
    recording = Recording((*FORCES, MOTIONS[0]), np.stack([f, 2 * f, f + rng.standard_normal(4000)]), RATE)
    with pytest.raises(EstimationError, match="'f1', 'f2' are linearly dependent"):
        H1(Welch(64))(recording)


def test_what_cannot_be_estimated_is_said():
    recording = siso(4000, 8)
    with pytest.raises(ChannelError, match="no channel is an input"):
        H1(Welch(64))(recording.select(["x1"]))
    with pytest.raises(ChannelError, match="no channel is a response"):
        H1(Welch(64))(recording.select(["f1"]))
    both, _ = mimo(4000, 9, 0.1)
    with pytest.raises(EstimationError, match="H2 takes one input"):
        H2(Welch(64))(both)
    short = Recording(both.channels, both.data[:, :64], RATE)
    with pytest.raises(EstimationError, match="1 segments cannot separate 2 inputs"):
        H1(Welch(64, "boxcar", 0.0))(short)


def test_coherence_of_two_channels_equals_scipys_and_needs_two_averages():
    recording = siso(8000, 10, 0.7)
    _, gamma = scipy_coherence(*recording.data, RATE, "hann", 128)
    spectra = Welch(128)(recording)
    np.testing.assert_allclose(coherence(spectra, "f1", "x1"), gamma, rtol=1e-9)
    single = Welch(8000, "boxcar", 0.0)(recording)
    with pytest.raises(EstimationError, match="single average"):
        coherence(single, "f1", "x1")
    two, _ = mimo(4000, 11, 0.1)
    with pytest.raises(EstimationError, match="pairs='all'"):
        coherence(Welch(64)(two), "x1", "x2")


# --- real recordings -------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def hits(recordings) -> Recording:
    """Five real hits as one recording."""
    data = [np.load(recordings / "hammer_hits" / f"measurements_{k}.npy")[1:] for k in range(1, 6)]
    breaks = tuple(25600 * k for k in range(1, 5))
    channels = (Channel("hammer", "force", "reference"), Channel("a", "acceleration"))
    return Recording(channels, np.concatenate(data, axis=1), 25600.0, breaks, label="hammer_hits")


def test_real_hits_show_the_stated_peaks_and_coherence(hits):
    frf = H1(Hits())(hits)
    band = frf.lines(50, 2000)
    assert band.coherence.mean() == pytest.approx(0.999, abs=5e-4)
    size = np.abs(frf.value[0, 0])
    peaks = frf.frequency[find_peaks(size)[0]]
    for wanted in (810, 851, 900, 2640, 3008, 3035, 3669, 3690, 4128, 4164):
        assert np.abs(peaks - wanted).min() <= 1.0, wanted


def test_real_hits_agree_with_scipy_to_rounding(hits):
    # same sums in another order: 1e-12 of the largest value
    frf = H1(Hits())(hits)
    rows = hits.data.reshape(2, 5, 25600)
    options = {"fs": 25600.0, "window": "boxcar", "nperseg": 25600, "detrend": False}
    cross = np.mean([csd(f, a, **options)[1] for f, a in zip(*rows, strict=True)], axis=0)
    power = np.mean([welch(f, **options)[1] for f in rows[0]], axis=0)
    assert np.abs(frf.value[0, 0] - cross / power).max() < 1e-12 * np.abs(frf.value).max()
    other = H1(Welch(25600, "boxcar", 0.0, "none"))(hits)
    np.testing.assert_allclose(other.value, frf.value, rtol=1e-9)
    assert other.settings["transient"]


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_real_hits_agree_with_pyfrf_to_rounding(hits):
    pyfrf = pytest.importorskip("pyFRF")
    peer = pyfrf.FRF(25600, exc_type="f", resp_type="a", window="none", fft_len=25600)
    for force, response in hits.data.reshape(2, 5, 25600).transpose(1, 0, 2):
        peer.add_data(force, response)
    frf = H1(Hits())(hits)
    theirs = np.squeeze(peer.get_FRF(frf_estimator="H1", frf_form="accelerance"))
    # it keeps the lines from 0 to half the sample rate as well; the mean of either signal is left in by both
    assert np.abs(frf.value[0, 0, 1:-1] - theirs[1:-1]).max() < 1e-9 * np.abs(frf.value).max()
    np.testing.assert_allclose(np.squeeze(peer.get_coherence())[1:-1], frf.coherence[0, 1:-1], atol=1e-9)


def test_a_receptance_from_a_real_hit_agrees_with_the_published_one(recordings):
    folder = recordings / "milling_tool"
    signal = np.loadtxt(folder / "impact_time_Point1_Channel1_CH1.txt")
    f, re, im = np.loadtxt(folder / "FRF_Point_1_Channel_1_CH1.txt").T
    channels = (Channel("hammer", "force", "reference"), Channel("tip", "acceleration"))
    frf = H1(Hits())(Recording(channels, signal[:, 1:].T, 51200.0)).convert("displacement")
    for mode in (1074, 1961, 2617):
        mine = frf.value[0, 0, int(np.argmin(np.abs(frf.frequency - mode)))]
        theirs = (re + 1j * im)[int(np.argmin(np.abs(f - mode)))]
        assert abs(mine / theirs - 1) < 0.03


def test_an_exponential_window_on_real_hits_adds_the_damping_it_says(hits):
    sharp, damped = H1(Hits())(hits), H1(Hits(decay=20.0))(hits)
    assert damped.settings["window_decay"] == 20.0

    def width(frf):
        size = np.abs(frf.value[0, 0])
        k = 2600 + int(np.argmax(size[2600:2680]))
        half = size > size[k] / np.sqrt(2)
        low, high = k, k
        while half[low]:
            low -= 1
        while half[high]:
            high += 1
        target = size[k] / np.sqrt(2)
        left = low + (target - size[low]) / (size[low + 1] - size[low])
        right = high - (target - size[high]) / (size[high - 1] - size[high])
        return right - left

    # the half-power bandwidth in Hz is decay / pi, so 20 1/s add 6.37 Hz
    assert width(damped) - width(sharp) == pytest.approx(20 / np.pi, rel=0.08)
