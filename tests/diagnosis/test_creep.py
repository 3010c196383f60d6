"""Structures that creep while they are measured: seen, followed, taken back, and faults found beside it."""

from dataclasses import replace

import numpy as np
import pytest

from labnnum.diagnosis import observe_all
from labnnum.diagnosis.creep import Local, take_back
from labnnum.recording import Channel, Recording
from sessions.diagnose import diagnose_files, observations_of
from sessions.prove.cases import make_case, write_case

PERIOD = 1024
RATE = 256.0
CHANNELS = (Channel("f", "force", "reference", "1", "x"), Channel("a", "acceleration", "response", "2", "x"),
            Channel("v", "velocity", "response", "2", "x"))  # fmt: skip


def response(omega, stiffer):
    """Acceleration and velocity over force of two modes without damping that changes; exact."""
    s = 1j * np.asarray(omega)
    moved = 0
    for pole, size in ((2 * np.pi * 21.0, 1.0), (2 * np.pi * 43.0, -0.6)):
        moved = moved + size / (s**2 + stiffer * pole**2 * (1 + 0.02j))
    return np.array([s**2 * moved, s * moved])


def session(change, runs=3, periods=4, noise=1e-4, seed=0):
    """Runs of a multisine on odd lines; within each period the response fades from one moment's to the next's."""
    rng = np.random.default_rng(seed)
    lines = np.arange(21, 300, 2)
    moments = np.linspace(0, 1, runs * periods + 1)
    ramp = np.arange(PERIOD) / PERIOD
    out = []
    for run in range(runs):
        u = np.zeros(PERIOD // 2 + 1, complex)
        u[lines] = np.exp(2j * np.pi * rng.random(lines.size))
        blocks = []
        for p in range(periods):
            ends = []
            for moment in moments[run * periods + p : run * periods + p + 2]:
                h = response(2 * np.pi * np.arange(u.size) * RATE / PERIOD, (1 + change * moment) ** 2)
                ends.append(np.fft.irfft(np.vstack([u, h * u]), PERIOD, axis=1))
            blocks.append((1 - ramp) * ends[0] + ramp * ends[1])
        data = np.concatenate(blocks, axis=1)
        data += noise * np.std(data, axis=1, keepdims=True) * rng.standard_normal(data.shape)
        out.append(Recording(CHANNELS, data, RATE, period=PERIOD, label=f"run {run}"))
    return observe_all(out)


def test_local_functions_hold_between_the_lines_and_beside_the_axis():
    omega = 2 * np.pi * np.arange(10, 60, 0.25)
    s = 3.0 + 1j * omega

    def exact(s):
        return np.array([(1 + 0.01 * s) / (s**2 + 8 * s + 200.0**2), s**2 / (s**2 + 8 * s + 200.0**2)])

    made = Local(s, s, exact(s), np.ones(s.size), 1)
    at = s[20:-20] * 1.0013
    assert made(at) == pytest.approx(exact(at), rel=1e-6)


@pytest.mark.parametrize("change", [-0.02, 0.004])
def test_a_creep_is_followed_and_taken_back(change):
    seen = session(change)
    creep, still, _ = take_back(seen)
    assert creep is not None
    assert creep.change == pytest.approx(np.log1p(change) * 11 / 12, rel=0.01)  # from the middle of the first period
    middle = np.log1p(change * (np.arange(12) + 0.5) / 12).mean()
    frf = still[1].frf
    exact = response(frf.omega, np.exp(2 * middle))
    before = np.linalg.norm(seen[0].frf.value[:, 0] - exact, axis=1)
    after = np.linalg.norm(still[0].frf.value[:, 0] - exact, axis=1)
    assert (after < 0.1 * before).all()
    assert (after < 0.01 * np.linalg.norm(exact, axis=1)).all()


def test_a_sound_session_stays_as_it_is():
    for seed in range(5):
        seen = session(0.0, seed=seed)
        creep, still, _ = take_back(seen)
        assert creep is None
        assert all(a is b for a, b in zip(seen, still, strict=True))


def test_what_changes_from_run_to_run_only_is_no_creep():
    """A level or a remount changes the runs; within each, nothing moves."""
    runs = [replace(session(0.0, runs=1, seed=i)[0], order=(i,)) for i in range(3)]
    other = [session(c, runs=1, periods=4, seed=i)[0] for i, c in enumerate((0.0, 0.0))]
    assert take_back([*runs, *[replace(o, order=(3 + i,)) for i, o in enumerate(other)]])[0] is None


def test_runs_held_out_are_taken_back_too():
    seen = session(-0.02)
    _, still, later = take_back(seen[:2], [replace(seen[2], order=(0,))])
    assert len(later) == 1
    apart = np.linalg.norm(seen[2].frf.value - seen[0].frf.value)
    assert np.linalg.norm(later[0].frf.value - still[0].frf.value) < 0.15 * apart


@pytest.mark.parametrize("excitation", ["multisine", "hammer"])
def test_the_change_of_a_concealed_drift(tmp_path, excitation):
    case = make_case(3, "chain", "drift", 0.6, excitation=excitation)
    paths = write_case(case, tmp_path)
    creep, _, _ = take_back(observations_of(paths, tmp_path / "channels.toml"))
    assert creep is not None
    true = 0.5 * case.truth["faults"][0]["parameters"]["dk"]["value"]
    assert creep.change == pytest.approx(true, rel=0.08)


def test_a_drift_beside_another_fault(tmp_path):
    case = make_case(4, "free-beam", ("drift", "added-mass"), (0.8, 0.7), excitation="hammer")
    paths = write_case(case, tmp_path / "case")
    content = diagnose_files(paths, tmp_path / "case" / "model.toml", tmp_path / "out")
    assert content["mechanism"]["id"] == "drift"
    assert [f["mechanism"]["id"] for f in content["further"]] == ["added-mass"]
    fit = content["fit"]
    assert fit["base"]["held_out"] > 3 * fit["extended"]["held_out"]
    assert "Natural frequencies during the session" in (tmp_path / "out" / "diagnosis.html").read_text()
