"""FRFs from stored recordings: right grouping, right choices, raw data untouched."""

import hashlib
import json
import sys

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy import signal

from drivers.block import Block
from labnnum.errors import ChannelError, EstimationError
from labnnum.estimators import H1, Welch
from labnnum.recording import Channel, Recording
from sessions import cli
from sessions.reprocess import FrfSettings, are_hits, chosen, groups, reprocess
from sessions.store import create_session, open_session

PAIR = (Channel("f", "force", "reference"), Channel("a"))
RATE = 1000.0


def answer(force):
    """A damped resonance near 100 Hz."""
    b, a = signal.zpk2tf([0], [0.9 * np.exp(2j * np.pi * 0.1), 0.9 * np.exp(-2j * np.pi * 0.1)], 1.0)
    return signal.lfilter(b, a, force)


def noise(n=40000, seed=0):
    force = np.random.default_rng(seed).normal(size=n)
    return np.array([force, answer(force)])


def hit(n=2000):
    force = np.zeros(n)
    force[20:30] = signal.windows.hann(10)
    return np.array([force, answer(force)])


def periodic_noise(n=512, periods=10):
    force = np.tile(np.random.default_rng(4).normal(size=n), periods)
    return np.array([force, answer(force)])


@pytest.fixture
def session(tmp_path):
    with create_session(tmp_path / "s.h5") as made:
        yield made


def add(session, data, **how):
    run = session.start_run(PAIR, RATE, unit="SI", **how)
    for start in range(0, data.shape[1], 1000):
        run.append(Block(data[:, start : start + 1000], start, 0.0))
    return run


def raw_digest(session):
    digest = hashlib.sha256()
    for run in session.runs:
        digest.update(run.raw().tobytes() + run.blocks.tobytes())
    return digest.hexdigest()


def test_each_estimate_is_stored_beside_the_untouched_raw_data(session):
    add(session, noise())
    before = raw_digest(session)
    first = reprocess(session, FrfSettings(segment=1024))
    second = reprocess(session, FrfSettings(window="boxcar", segment=2048, overlap=0.25, estimator="H2"))
    assert [p for p, _ in first + second] == ["results/frf/0001", "results/frf/0002"]
    session.close()
    with open_session(session.path) as read:
        assert raw_digest(read) == before
        one, two = read.frfs()
    assert_array_equal(one.value, first[0][1].value)
    assert (one.estimator, one.settings["window"], one.settings["n_segment"]) == ("H1", "hann", 1024)
    assert (two.estimator, two.settings["window"], two.settings["overlap"]) == ("H2", "boxcar", 0.25)
    assert two.settings["runs"] == [1]
    assert two.settings["requested"]["estimator"] == "H2"


def test_scipy_agrees(session):
    data = noise()
    add(session, data)
    ((_, frf),) = reprocess(session, FrfSettings(segment=1024))
    kwargs = {"fs": RATE, "window": "hann", "nperseg": 1024, "noverlap": 512, "detrend": "constant"}
    _, cross = signal.csd(*data, **kwargs)
    _, auto = signal.welch(data[0], **kwargs)
    assert_allclose(frf.value[0, 0], cross / auto, rtol=1e-9, atol=1e-12)
    assert_allclose(frf.coherence[0], signal.coherence(*data, **kwargs)[1], rtol=1e-9)


def test_levels_and_rates_stay_apart(session):
    for level in (1.0, 2.0, 1.0):
        add(session, noise(), level=level)
    done = reprocess(session, FrfSettings(segment=1024))
    assert [frf.settings["runs"] for _, frf in session_frfs(session)] == [[1, 3], [2]]
    assert [frf.settings.get("level") for frf in session.frfs()] == [1.0, 2.0]
    assert len(done) == 2
    only = reprocess(session, FrfSettings(segment=1024), runs=[2])
    assert_array_equal(only[0][1].value, done[1][1].value)
    with pytest.raises(EstimationError, match="there is no run 9; there are 1 to 3"):
        reprocess(session, FrfSettings(), runs=[9])


def session_frfs(session):
    return [(f.settings["stored"], f) for f in session.frfs()]


def test_what_is_left_open_is_decided_from_the_recordings():
    def one(data, **how):
        return [Recording(PAIR, data, RATE, **how)]

    assert are_hits(one(hit()))
    assert not are_hits(one(noise()))
    assert not are_hits(one(periodic_noise(), period=512))
    decided = chosen(one(noise()), FrfSettings())
    assert (decided.estimator, decided.window, decided.overlap, decided.segment) == ("H1", "hann", 0.5, 2048)
    decided = chosen(one(hit()), FrfSettings())
    assert (decided.hits, decided.window, decided.overlap) == (True, "boxcar", 0.0)
    decided = chosen(one(periodic_noise(), period=512), FrfSettings())
    assert decided.estimator == "periodic"
    decided = chosen(one(periodic_noise(), period=512), FrfSettings(estimator="H1"))
    assert (decided.segment, decided.window, decided.overlap) == (512, "boxcar", 0.0)
    decided = chosen(one(hit()), FrfSettings(window="hann", segment=256))
    assert not decided.hits


def test_groups_keep_the_order_of_the_runs():
    made = [Recording(PAIR, noise(100), RATE, level=level) for level in (3, np.nan, 3, np.nan, 1)]
    assert [[r.level for r in g if r.level == r.level] for g in groups(made)] == [[3, 3], [], [1]]


def test_only_accepted_hits_enter(session):
    good, other = hit(), hit() * np.array([[1.0], [3.0]])
    run = add(session, np.hstack([good, other, good]))
    for k, accepted in enumerate((True, False, True)):
        run.add_hit(2000 * k, 2000 * (k + 1), accepted, "" if accepted else "double hit")
    ((_, frf),) = reprocess(session, FrfSettings())
    assert frf.n_averages == 2
    assert_allclose(frf.coherence[0], 1.0, atol=1e-9)
    run.judge_hit(1, True, "accepted by hand")
    ((_, all_three),) = reprocess(session, FrfSettings())
    assert all_three.n_averages == 3
    assert all_three.coherence[0].mean() < 0.95
    assert [f.settings["basis"] for f in session.frfs()] == [{"1": [0, 2]}, {"1": [0, 1, 2]}]  # back to the hit


def test_overloaded_stretches_are_left_out(session):
    data = noise()
    run = session.start_run(PAIR, RATE, unit="SI")
    spoilt = data.copy()
    spoilt[1, 5000:6000] = np.minimum(data[1, 5000:6000], 0.5)
    for start in range(0, 40000, 1000):
        flags = np.array([False, start == 5000])
        run.append(Block(spoilt[:, start : start + 1000], start, 0.0, overload=flags))
    ((_, frf),) = reprocess(session, FrfSettings(segment=512))
    assert session.frfs()[0].settings["overloaded_seconds"] == 1.0
    clean = [Recording(PAIR, data, RATE, excluded=((5000, 6000),))]
    assert_array_equal(frf.value, H1(Welch(512))(clean).value)


def test_an_overloaded_hit_is_left_out_whole(session):
    run = session.start_run(PAIR, RATE, unit="SI")
    for k in range(3):
        run.append(Block(hit() * (1 + k), 2000 * k, 0.0, overload=np.array([k == 1, False])))
        run.add_hit(2000 * k, 2000 * (k + 1))
    ((_, frf),) = reprocess(session, FrfSettings())
    assert frf.n_averages == 2
    told = session.frfs()[0].settings
    assert (told["basis"], told["hits_left_out"]) == ({"1": [0, 2]}, {"1": [1]})


def test_a_sensor_that_was_recalibrated_between_runs_stays_one_channel(session):
    for sensitivity in (0.1, 0.2):
        pair = [Channel(c.name, c.quantity, c.role, sensitivity=sensitivity) for c in PAIR]
        run = session.start_run(pair, RATE)
        run.append(Block(noise() * sensitivity, 0, 0.0))
    ((_, frf),) = reprocess(session, FrfSettings(segment=1024))
    assert_allclose(frf.value, H1(Welch(1024))(Recording(PAIR, noise(), RATE)).value, rtol=1e-9)
    assert session.frfs()[0].settings["runs"] == [1, 2]


@pytest.mark.parametrize("kind", ["hits", "noise", "periods"])
def test_inputs_that_were_calibrated_anew_between_runs_are_each_divided_out(session, kind):
    """The second run's answer came three samples late and is known to: the mean is that of runs that did not."""
    data = {"hits": hit(), "noise": noise(), "periods": periodic_noise()}[kind]
    how: dict = {"period": 512, "drop_periods": 1} if kind == "periods" else {}
    late = np.array([data[0], np.r_[np.zeros(3), data[1, :-3]]])
    settings = FrfSettings(segment=1024) if kind == "noise" else FrfSettings()
    add(session, data, **how)
    ((_, expected),) = reprocess(session, settings)
    delay = {"a": {"delay": 3 / RATE, "highpass": 0.0}}
    add(session, late, info={"inputs": delay}, **how)
    ((_, frf),) = reprocess(session, settings)
    assert session.frfs()[-1].settings["inputs"] == {"1": {}, "2": delay}
    lines = expected.frequency < 150  # beyond, the pulse of the hits has its first zero
    assert_array_equal(frf.frequency, expected.frequency)
    assert frf.n_averages == pytest.approx(2 * expected.n_averages)
    assert frf.coherence is not None
    assert frf.coherence[0, lines].mean() > 0.999
    atol = 5e-3 * np.abs(expected.value[0, 0, lines]).max()
    assert_allclose(frf.value[0, 0, lines], expected.value[0, 0, lines], atol=atol)
    one = {"a": {"delay": 0.0, "highpass": 2.0}}
    add(session, data, info={"inputs": one}, **how)
    ((_, third),) = reprocess(session, settings)
    assert third.frequency[0] > 0


def test_clipping_that_nobody_reported_stops_the_estimate(session):
    t = np.arange(4000) / RATE
    add(session, np.array([noise(4000)[0], np.minimum(np.sin(20 * t), 0.8)]))
    with pytest.raises(ChannelError, match=r"run 1: channel 'a' is clipped at 0.8 m/s\^2 .*--keep-clipped"):
        reprocess(session, FrfSettings(segment=512))
    assert session.frfs() == []
    reprocess(session, FrfSettings(segment=512, keep_clipped=True))


def test_periods_are_averaged(session):
    data = periodic_noise()
    add(session, data, period=512, drop_periods=1)
    ((_, frf),) = reprocess(session, FrfSettings())
    assert frf.estimator == "periodic"
    exact = np.fft.rfft(data[:, -512:])
    lines = np.searchsorted(np.fft.rfftfreq(512, 1 / RATE), frf.frequency)
    assert_allclose(frf.value[0, 0], exact[1][lines] / exact[0][lines], rtol=1e-9)


class TestCommand:
    def run(self, monkeypatch, capsys, *line):
        monkeypatch.setattr(sys, "argv", ["labnnum", *map(str, line)])
        with pytest.raises(SystemExit) as end:
            cli.main()
        shown = capsys.readouterr()
        return end.value.code or 0, shown.out, shown.err

    def test_json_holds_all_that_was_said(self, session, monkeypatch, capsys):
        add(session, noise())
        session.close()
        status, out, _ = self.run(
            monkeypatch, capsys, "frf", session.path, "--segment", 1024, "--band", "20:400", "--json"
        )
        assert status == 0
        (frf,) = json.loads(out)["frfs"]
        assert frf["stored"] == "results/frf/0001"
        assert frf["mean_coherence"]["a"] > 0.99
        assert any(abs(peak - 100) < 10 for peak in frf["peaks"]["a"])
        assert all(v["ok"] for v in frf["verdicts"])

    def test_the_gate_keeps_the_whole_pulse(self, session, monkeypatch, capsys):
        """What is gated away is noise: the FRF is that of the system, and of the same settings given by hand."""
        data = np.hstack([hit() for _ in range(3)])
        data[0] += np.tile(np.r_[np.zeros(200), np.full(1800, 1e-3)], 3)
        run = add(session, data)
        for k in range(3):
            run.add_hit(2000 * k, 2000 * (k + 1))
        session.close()
        status, _, _ = self.run(monkeypatch, capsys, "frf", session.path, "--hits", "--gate", 0.02)
        assert status == 0
        with open_session(session.path, "a") as again:
            (told,) = again.frfs()
            ((_, by_hand),) = reprocess(again, FrfSettings(hits=True, gate=0.02))
        assert told.settings["force_gate"] == [0.02, 0.02]
        assert_array_equal(told.value, by_hand.value)
        force, answered = np.fft.rfft(hit())[:, 1:300]
        assert_allclose(told.value[0, 0, 1:300], answered / force, rtol=1e-9)

    def test_clipped_channels_are_used_if_asked(self, session, monkeypatch, capsys):
        t = np.arange(4000) / RATE
        add(session, np.array([noise(4000)[0], np.minimum(np.sin(20 * t), 0.8)]))
        session.close()
        line = ("frf", session.path, "--segment", 512)
        status, _, err = self.run(monkeypatch, capsys, *line)
        assert (status, "--keep-clipped" in err) == (2, True)
        status, out, _ = self.run(monkeypatch, capsys, *line, "--keep-clipped")
        assert (status, "results/frf/0001" in out) == (0, True)
        with open_session(session.path) as read:
            assert [f.settings["requested"]["keep_clipped"] for f in read.frfs()] == [True]

    def test_a_low_coherence_is_named_and_fails_only_if_asked(self, session, monkeypatch, capsys):
        data = noise()
        data[1] += 3 * np.random.default_rng(9).normal(size=data.shape[1])
        add(session, data)
        session.close()
        status, out, _ = self.run(monkeypatch, capsys, "frf", session.path, "--segment", 1024)
        assert status == 0
        assert "warning:" in out
        status, out, err = self.run(monkeypatch, capsys, "frf", session.path, "--segment", 1024, "--strict")
        assert status == 1
        assert "a" in err
        with open_session(session.path) as read:
            assert len(read.frfs()) == 2

    def test_info_tells_runs_hits_and_results(self, session, monkeypatch, capsys):
        run = add(session, np.hstack([hit(), hit()]), level=2.5, label="point 3")
        run.add_hit(0, 2000)
        run.add_hit(2000, 4000, False, "double hit")
        run.finish()
        reprocess(session, FrfSettings())
        session.add_result("estimate", "first", {})
        session.close()
        status, out, _ = self.run(monkeypatch, capsys, "info", session.path)
        assert status == 0
        for words in (
            "run 1  point 3",
            "1 of 2 hits accepted",
            "level 2.5",
            "complete",
            "results/frf/0001  H1 of run 1",
        ):
            assert words in out
        status, out, _ = self.run(monkeypatch, capsys, "info", session.path, "--json")
        said = json.loads(out)
        assert said["runs"][0]["hits"] == {"accepted": 1, "all": 2}
        assert said["results"][0]["stored"] == "results/estimate/0001"
