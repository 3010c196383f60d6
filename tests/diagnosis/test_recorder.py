"""The recorder's filter, common to all channels: concealed by other code, named, taken off and put on again."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import butter, freqs

from labnnum.diagnosis import diagnose, observe_all
from labnnum.diagnosis.nonlinear.above import above
from labnnum.diagnosis.nonlinear.begun import started
from labnnum.diagnosis.nonlinear.chain import restarted
from labnnum.diagnosis.nonlinear.further import further
from labnnum.diagnosis.nonlinear.mended import Fault, mended
from labnnum.diagnosis.nonlinear.predict import padded, response
from labnnum.errors import EstimationError
from labnnum.mechanisms import extend
from labnnum.mechanisms.recording_filter import RecordingFilter
from labnnum.recording import Channel, Recording
from labnnum.response import frf
from labnnum.structures.modal import ModalStructure, Mode
from sessions.diagnose import write_extended
from sessions.model import read_model
from sessions.prove.real_figures import filter_figure

RATE, PERIOD, FINE, TOP = 60.0, 512, 8, 171
F0, ZETA, K3, C2 = 5.0, 0.05, 4e5, 0.4
CORNER = 24.0
CHANNELS = (
    Channel("u", "force", "reference", "1", "x"),
    Channel("y", "displacement", "response", "1", "x"),
)


def march(force, state=(0.0, 0.0)):
    """Motion under a force on half steps, by Runge and Kutta's rule of fourth order; one sample a step."""
    h, w = 1 / (RATE * FINE), 2 * np.pi * F0
    z, v = state
    out = []

    def rate(z, v, f):
        return f - 2 * ZETA * w * v - w * w * z - K3 * z**3 - C2 * v * abs(v)

    for i in range(0, force.size - 2, 2):
        out.append(z)
        a, b, c = force[i : i + 3].tolist()
        k1 = rate(z, v, a)
        k2 = rate(z + h / 2 * v, v + h / 2 * k1, b)
        k3 = rate(z + h / 2 * (v + h / 2 * k1), v + h / 2 * k2, b)
        k4 = rate(z + h * (v + h / 2 * k2), v + h * k3, c)
        z, v = z + h * v + h * h / 6 * (k1 + k2 + k3), v + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return np.array(out)


def recorder(f):
    """A Butterworth low-pass of fourth order."""
    return freqs(*butter(4, 2 * np.pi * CORNER, analog=True), 2 * np.pi * f)[1]


def recorded(spectra, n, filtered):
    """Samples of the lines below half the rate, through the filter or not."""
    f = np.arange(n // 2 + 1) * RATE / n
    value = spectra[: n // 2 + 1] * (recorder(f) if filtered else 1.0)
    return np.fft.irfft(value * n / 2, n)


def run(level, seed, filtered):
    """Three periods of a multisine of odd lines, one in four left out, at rest in between."""
    rng = np.random.default_rng(seed)
    lines = np.arange(5, TOP + 1, 2)
    on = lines[np.arange(lines.size) % 4 != 2]
    u = np.zeros(PERIOD // 2 + 1, complex)
    u[on] = level * np.sqrt(2 / on.size) * np.exp(2j * np.pi * rng.random(on.size))
    n = 2 * FINE * PERIOD
    force = np.fft.irfft(np.pad(u, (0, n // 2 - PERIOD // 2)) * n / 2, n)
    y = march(np.concatenate([np.tile(force, 2), force[:2]]))[-FINE * PERIOD :]
    y = np.fft.rfft(y) * 2 / y.size
    data = np.tile(np.vstack([recorded(a, PERIOD, filtered) for a in (u, y)]), 3)
    data += np.array([[1e-5 * level], [1e-5 * y.std()]]) * rng.standard_normal(data.shape)
    return Recording(CHANNELS, data, RATE, period=PERIOD, label=f"level {level:g} seed {seed}")


def base():
    return ModalStructure((Mode(F0, ZETA, {"1:x": 1.0}),), error=1e-3)


def diagnosed(filtered):
    return diagnose(base(), observe_all([run(*o, filtered) for o in ((1.5, 1), (4.5, 2), (4.5, 3))]))


@pytest.fixture(scope="module")
def behind():
    return diagnosed(filtered=True)


def test_the_filter_is_named_last_with_its_corner(behind):
    names = [n.term.mechanism.id for n in behind.named]
    assert behind.verdict == "missing-physics"
    assert names[0] == "cubic-stiffness", behind.summary
    assert names[-1] == "recording-filter", behind.summary
    told = behind.as_dict()["further"][-1]
    assert told["place"] == {"kind": "channel", "id": "all", "to": None}
    down = told["mechanism"]["parameters"]["half_power"]
    assert down["value"] == pytest.approx(CORNER, rel=0.03)
    assert 0 < down["std"] < 0.1 * CORNER
    assert behind.named[0].value[0] == pytest.approx(K3, rel=0.03)
    assert "recording-filter at channel all" in behind.summary


def test_recorded_harmonics_over_those_of_the_motion_are_the_filter(behind, tmp_path):
    shown = behind.detail["nonlinear"].recorder.shown
    assert shown.coherence > 0.99
    np.testing.assert_allclose(shown.ratio, recorder(shown.frequency), rtol=0.05)
    filter_figure(tmp_path / "filter.svg", behind.detail["nonlinear"].recorder)
    assert "<svg" in (tmp_path / "filter.svg").read_text()


@pytest.fixture(scope="module")
def plain():
    return diagnosed(filtered=False)


def test_a_recorder_without_a_filter_has_none(plain):
    found = plain
    names = [n.term.mechanism.id for n in found.named]
    assert names[0] == "cubic-stiffness", found.summary
    assert "recording-filter" not in names


def test_prediction_goes_through_the_filter_and_begins_where_the_record_does(behind):
    rng = np.random.default_rng(9)
    n, f = 2048, np.fft.rfftfreq(2048 * 2 * FINE, 1 / (RATE * 2 * FINE))
    force = np.fft.irfft(np.where((f > 0.5) & (f < 20), np.fft.rfft(rng.standard_normal(2 * (f.size - 1))), 0.0))
    force *= 4.5 / force.std()
    y = march(np.append(force, force[:2]), (0.004, -0.1))
    spectra = [np.fft.rfft(x)[: n // 2 + 1] * 2 / x.size for x in (force, y)]
    data = np.vstack([recorded(x, n, True) for x in spectra])
    one = Recording(CHANNELS, data, RATE, label="noise")
    answer = behind.detail["nonlinear"]
    rest, begun = response(answer, padded(one, 20.0))[0, :n], started(answer, one, 20.0, 40)[0]

    def error(made, part):
        return np.linalg.norm((made - data[1])[part]) / np.linalg.norm(data[1])

    late, first = slice(100, 1900), slice(5, 100)  # the ends of a record that is filtered as if it came around
    assert error(rest, late) < 0.01
    assert error(begun, late) < 0.01
    assert error(begun, first) < 0.3 * error(rest, first)


def test_a_model_file_holds_the_filter(behind, tmp_path):
    (tmp_path / "base.toml").write_text(
        '[structure]\nkind = "modal"\nerror = 1e-3\n[[structure.mode]]\nfrequency = 5.0\ndamping_ratio = 0.05\n'
        'shape = {"1:x" = 1.0}\n'
    )
    write_extended(tmp_path / "extended.toml", read_model(tmp_path / "base.toml"), behind)
    structure = read_model(tmp_path / "extended.toml").structure
    f = np.array([3.0, 15.0, 24.0])
    own = structure.chain(CHANNELS[0], f, structure.nominal)
    np.testing.assert_allclose(own, structure.chain(CHANNELS[1], f, structure.nominal))
    np.testing.assert_allclose(own, behind.detail["nonlinear"].recorder.fault.factor(2j * np.pi * f, back=True))
    assert abs(own[2]) == pytest.approx(np.sqrt(0.5), rel=0.05)
    again = diagnose(structure, observe_all([run(*o, True) for o in ((1.5, 1), (4.5, 2), (4.5, 3))]))
    assert "recording-filter" not in [n.term.mechanism.id for n in again.named]
    assert again.verdict in ("consistent", "parameters"), again.summary


def test_a_chain_begins_anew_with_the_law_that_is_missed_most(plain):
    found = plain.detail["nonlinear"]
    cubic, study = found.laws[0], found.study
    assert restarted(study, found.laws, found.scatter) is None
    worse = replace(next(t for t in study.tried if not t.same(cubic)), cost=10 * cubic.cost)
    others = [t for t in study.tried if t is not worse and not t.same(worse)]
    again = restarted(replace(study, tried=(worse, *others)), found.laws, found.scatter)
    assert again is not None
    assert again.best.same(cubic)
    assert again.best.cost <= worse.cost
    assert again.tried[1] is worse
    assert sum(t.same(cubic) for t in again.tried) == 1
    cheap = replace(worse, cost=0.1 * cubic.cost)
    assert restarted(replace(study, tried=(cheap, *others)), found.laws, found.scatter) is None


def test_a_term_of_the_general_law_that_has_a_name_is_offered_by_it(plain):
    found = plain.detail["nonlinear"]
    spots = [q.spot for q in found.study.recovered]
    more = further(found.study, found.laws[0], spots, found.scatter, 40.0, general=True, own=True)
    assert more is not None
    assert more.mechanism == "quadratic-damping"


P = np.array([2e-3, 4e-5, 1e-3, 2e-5])


def test_a_steady_state_that_is_lost_on_other_lines_ends_no_diagnosis(plain, monkeypatch):
    found = plain.detail["nonlinear"]

    def lost(*args, **options):
        raise EstimationError("the steady response does not settle at the start of the fit")

    monkeypatch.setattr("labnnum.diagnosis.nonlinear.further.fit", lost)
    spots = [q.spot for q in found.study.recovered]
    assert further(found.study, found.laws[0], spots, found.scatter, 40.0) is None


def test_the_factor_is_one_at_zero_and_its_derivatives_are_exact():
    one, s = RecordingFilter(), 2j * np.pi * np.linspace(0.0, 60.0, 20)
    np.testing.assert_array_equal(one.factor(s, np.zeros(6)), 1.0)
    made = one.factor_derivative(s, P)
    for row, step in zip(made, np.diag(1e-5 * P), strict=True):
        slope = (one.factor(s, P + step) - one.factor(s, P - step)) / (2 * step.sum())
        np.testing.assert_allclose(row, slope, rtol=1e-6, atol=1e-9 * np.abs(row).max())
    told = one.derived(one.term(2), P, 0.01 * P)
    assert told["corner1"][0] == pytest.approx(1 / (2 * np.pi * np.sqrt(4e-5)))
    assert abs(one.factor(np.array([2j * np.pi * told["half_power"][0]]), P)[0]) == pytest.approx(0.5**0.5, rel=1e-3)


def test_what_is_common_cancels_in_every_frf():
    values = {n: {"value": v} for n, v in zip(("a1", "b1", "a2", "b2"), P, strict=True)}
    entry = {"id": "recording-filter", "place": {"kind": "channel", "id": "all"}, "parameters": values}
    plain, f = base(), np.linspace(1.0, 20.0, 9)
    behind = extend(plain, [entry])
    assert not behind.parameters
    sides = [frf(s, s.nominal, f, CHANNELS[1:], CHANNELS[:1]) for s in (plain, behind)]
    np.testing.assert_allclose(*sides, rtol=1e-10)


def test_runs_are_freed_of_it_and_back():
    o = observe_all([run(1.0, 1, True)])[0]
    fault = Fault(RecordingFilter().term(2), P)
    there = mended(o, [fault])
    back = mended(there, [fault], back=True)
    assert there.frf is o.frf
    np.testing.assert_allclose(there.run.y[0, 9] / there.run.u[9], o.run.y[0, 9] / o.run.u[9])
    np.testing.assert_allclose(back.run.y, o.run.y, rtol=1e-9, atol=1e-12)


def test_harmonics_that_are_not_those_predicted_show_no_filter():
    rng = np.random.default_rng(3)
    o = observe_all([run(1.0, 1, False)])[0].run
    y = rng.standard_normal(o.y.shape) + 1j * rng.standard_normal(o.y.shape)
    other = rng.standard_normal(o.y.shape) + 1j * rng.standard_normal(o.y.shape)
    factor = 1 / (1 + 1j * o.frequency / 25.0)
    assert above([replace(o, y=y * factor)], [y]).filtered
    assert not above([replace(o, y=y)], [y]).filtered
    assert not above([replace(o, y=y)], [y + 0.1 * other]).filtered
    assert not above([replace(o, y=y)], [other]).filtered
