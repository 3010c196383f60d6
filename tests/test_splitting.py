"""What lowers the coherence, as a user sees it: stored beside the FRF, printed, in JSON and on the page."""

import json
import sys

import numpy as np
import pytest
from scipy.signal import lfilter

from drivers.block import Block
from labnnum.estimators import Welch
from labnnum.excitation import chirp, multisine, random
from labnnum.recording import Channel, Recording
from sessions import cli
from sessions.report.content import gather
from sessions.report.page import render
from sessions.reprocess import FrfSettings, reprocess
from sessions.splitting import KIND, in_words, read_told, store_told, tell_apart, told_of
from sessions.store import create_session, open_session

RATE, N = 512.0, 1024
CHANNELS = (Channel("f", "force", "reference"), Channel("x", "displacement"))


def respond(f, cubic, noise, seed):
    return lfilter([1.0], [1, -0.9], f + cubic * f**3) + noise * np.random.default_rng(seed).standard_normal(f.size)


def multisines(seed, noise=0.1, cubic=0.1):
    f = multisine(RATE, N, (5.0, 200.0), seed=seed, n_periods=5, grid_seed=3).samples
    return np.stack([f, respond(f, cubic, noise, seed)])


def session_of(path, records, **how):
    with create_session(path) as session:
        for data in records:
            run = session.start_run(CHANNELS, RATE, unit="SI", level=1.0, **how)
            run.append(Block(data, 0, 0.0))
            run.finish()
    return path


def frf_command(monkeypatch, capsys, *arguments):
    monkeypatch.setattr(sys, "argv", ["labnnum", "frf", *map(str, arguments)])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    assert ended.value.code == 0
    return capsys.readouterr().out


def test_it_is_kept_beside_its_frf_as_it_was_made(tmp_path):
    recordings = [Recording(CHANNELS, multisines(s), RATE, period=N, drop_periods=1) for s in (1, 2)]
    made = tell_apart(recordings, Welch(N), frf="results/frf/0007")
    with create_session(tmp_path / "s.h5") as session:
        store_told(session, made, "runs 1, 2")
        (result,) = session.results(KIND)
        read = told_of(session.results(), "results/frf/0007")
        assert told_of(session.results(), "results/frf/0001") is None
    for one in (read, read_told(result)):
        assert one.split.outputs == made.split.outputs
        assert one.split.remarks == made.split.remarks
        for group in ("parts", "beside", "chance"):
            assert set(getattr(one.split, group)) == set(getattr(made.split, group))
            for name, part in getattr(made.split, group).items():
                np.testing.assert_array_equal(getattr(one.split, group)[name], part)
        assert one.split.table() == made.split.table()


def test_the_command_tells_shares_that_add_up(tmp_path, monkeypatch, capsys):
    path = session_of(tmp_path / "s.h5", [multisines(s) for s in (1, 2, 3)], period=N, drop_periods=1)
    said = json.loads(frf_command(monkeypatch, capsys, path, "--band", "20:100", "--json"))
    (row,) = said["frfs"][0]["split"]["bands"]
    assert (row["response"], row["low"], row["high"]) == ("x", 20.0, 100.0)
    assert set(row["parts"]) == {"noise", "nonlinear distortion", "transient"}
    assert sum(p["share"] for p in row["parts"].values()) == pytest.approx(row["lost"])
    assert row["parts"]["nonlinear distortion"]["seen"]
    text = frf_command(monkeypatch, capsys, path)
    assert "coherence over all periods lacks" in text
    assert "nonlinear distortion" in text


def test_the_page_holds_table_and_figure(tmp_path):
    path = session_of(tmp_path / "s.h5", [multisines(1)], period=N, drop_periods=1)
    assert "What lowers the coherence" not in render(gather(path))
    with open_session(path, "a") as session:
        reprocess(session, FrfSettings())
    page = render(gather(path))
    assert "What lowers the coherence" in page
    assert "odd distortion on detection lines" in page
    assert "another realisation at the same level" in page
    assert page.count("<svg") == 2


def test_a_sweep_has_its_harmonics_told(tmp_path, monkeypatch, capsys):
    f = chirp(RATE, 2**15, (5.0, 100.0), law="log", fade=0.01).samples
    path = session_of(tmp_path / "s.h5", [np.stack([f, respond(f, 0.05, 0.001, 1)])])
    (frf,) = json.loads(frf_command(monkeypatch, capsys, path, "--json"))["frfs"]
    rows = {(r["channel"], r["order"]): r for r in frf["split"]["harmonics"]}
    assert rows["x", 3]["power_db"] > rows["x", 3]["floor_db"] + 20
    assert rows["x", 2]["power_db"] is None or rows["x", 2]["power_db"] < rows["x", 3]["power_db"] - 40
    assert "order 3" in frf_command(monkeypatch, capsys, path)
    page = render(gather(path))
    assert "Harmonics of the sweep" in page


def test_what_cannot_be_told_apart_says_why(tmp_path):
    a, b = (random(RATE, 2**14, (5.0, 200.0), seed=s).samples for s in (1, 2))
    channels = (CHANNELS[0], Channel("g", "force", "reference"), CHANNELS[1])
    recording = Recording(channels, np.stack([a, b, a + b]), RATE)
    made = tell_apart([recording], Welch(512), frf="results/frf/0001")
    assert made.split is None
    assert "one input" in in_words(made)[0]
    with create_session(tmp_path / "s.h5") as session:
        store_told(session, made, "run 1")
        assert read_told(session.results(KIND)[0]).untold == made.untold
    assert "one input" in made.as_dict()["untold"]
