"""Public recordings come in by the channels.toml files of examples/recordings, with the figures known of them."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy import signal

from labnnum.estimators import H1, Hits
from sessions.importing import import_files
from sessions.reprocess import FrfSettings, reprocess
from sessions.store import open_session

EXAMPLES = "examples/recordings"


@pytest.fixture
def bring_in(recordings, tmp_path, request):
    def bring(folder, pattern, toml="channels.toml"):
        files = sorted((recordings / folder).glob(pattern))
        assert files
        told = request.config.rootpath / EXAMPLES / folder / toml
        notes = import_files(files, tmp_path / "s.h5", told)
        assert notes == []
        return open_session(tmp_path / "s.h5", "a")

    return bring


def peaks_near(frf, row, expected, reach):
    """Frequencies of the largest |H| within `reach` of each expected one."""
    size = np.abs(frf.value[row, 0])
    out = []
    for f in expected:
        near = np.flatnonzero(np.abs(frf.frequency - f) <= reach)
        out.append(frf.frequency[near[np.argmax(size[near])]])
    return out


def test_hammer_hits(bring_in):
    with bring_in("hammer_hits", "measurements_*.npy") as session:
        assert [run.n_samples for run in session.runs] == [25600] * 5
        ((_, frf),) = reprocess(session, FrfSettings())
    assert (frf.n_averages, frf.settings["n_segment"]) == (5, 25600)
    inside = (frf.frequency >= 50) & (frf.frequency <= 2000)
    assert frf.coherence[0, inside].mean() == pytest.approx(0.999, abs=5e-4)
    known = [810, 851, 900, 2640, 3008, 3035, 3669, 3690, 4128, 4164]
    assert_allclose(peaks_near(frf, 0, known, 6), known, atol=1)


def test_hammer_hits_by_scipy_and_pyfrf(bring_in):
    """The same averages by two other programs; 1e-9 leaves room for another order of summation, nothing else."""
    with bring_in("hammer_hits", "measurements_*.npy") as session:
        ((_, frf),) = reprocess(session, FrfSettings(hits=True))
        force, answer = np.stack([r.data for r in session.recordings()], axis=1)
    how = {"fs": 25600, "window": "boxcar", "nperseg": 25600, "noverlap": 0, "detrend": False}
    x, y = force.reshape(-1), answer.reshape(-1)
    assert_allclose(frf.value[0, 0], signal.csd(x, y, **how)[1] / signal.welch(x, **how)[1], rtol=1e-9)
    assert_allclose(frf.coherence[0], signal.coherence(x, y, **how)[1], rtol=1e-9)
    pyfrf = pytest.importorskip("pyFRF")
    peer = pyfrf.FRF(25600, exc=force[:, None], resp=answer[:, None], exc_type="f", resp_type="a", window="none")
    accelerance = -(frf.omega**2) * peer.get_H1()[0, 0]  # it answers with receptance, which has no line at 0 Hz
    assert_allclose(frf.value[0, 0, 1:], accelerance[1:], rtol=1e-9)
    assert_allclose(frf.coherence[0, 1:], peer.get_coherence()[0, 1:], rtol=1e-9)


def test_milling_tool(bring_in):
    with bring_in("milling_tool", "FRF_Point_*.txt", "frf.channels.toml") as session:
        (given,) = session.frfs()
    assert given.value.shape == (1, 5, 5001)
    assert [c.node for c in given.inputs] == ["tip", "55 mm", "90 mm", "130 mm", "165 mm"]
    session.path.unlink()
    with bring_in("milling_tool", "impact_time_*.txt") as session:
        (recording,) = session.recordings()
    assert recording.rate == 51200
    receptance = H1(Hits())(recording).convert("displacement")
    for mode in (1074, 1961, 2617):
        here = np.argmin(np.abs(receptance.frequency - mode))
        there = np.argmin(np.abs(given.frequency - mode))
        assert abs(receptance.value[0, 0, here] / given.value[0, 0, there] - 1) < 0.03


def test_freefree_beam(bring_in):
    with bring_in("freefree_beam", "*.npz") as session:
        (frf,) = session.frfs()
    assert frf.value.shape == (1, 9, 51201)
    assert [c.dof for c in frf.inputs] == [f"{z}:x" for z in (0.1, 0.25, 0.375, 0.5, 0.65, 0.8, 0.925, 1.05, 1.2)]
    assert frf.outputs[0].sign == -1
    known = [111.992, 306.855, 596.37, 974.13]
    assert_allclose(peaks_near(frf, 0, known, 3), known, atol=0.05)


def test_silverbox(bring_in):
    with bring_in("silverbox", "SNLS80mV.mat") as session:
        arrow, *multisines = session.recordings()
    assert arrow.n_samples == 40500
    assert len(multisines) == 10
    for one in multisines:
        spectrum = np.abs(np.fft.rfft(one.data[0]))
        assert one.n_samples == one.period == 8192
        assert spectrum[2:1000:2].sum() < 2e-3 * spectrum[1:1000:2].sum()  # odd lines only
        assert_allclose(one.data.mean(axis=1), 0, atol=1e-12)


def test_silverbox_schroeder(bring_in):
    with bring_in("silverbox", "Schroeder80mV.mat", "schroeder.channels.toml") as session:
        (one,) = session.recordings()
    first, later = one.data[0, 1024:2048], one.data[0, 4096:5120]
    assert (one.period, one.drop_periods) == (1024, 1)
    assert np.abs(first - later).max() < 0.02 * np.abs(later).max()
    spectrum = np.abs(np.fft.rfft(later))
    assert spectrum[2:300:2].sum() < 5e-3 * spectrum[1:300:2].sum()  # odd lines only


def test_f16(bring_in):
    with bring_in("f16", "F16Data_FullMSine_*.mat") as session:
        found = session.recordings()
    assert [r.level for r in found] == [12.4, 36.8, 73.6, 97.8]
    for r in found:
        assert (r.rate, r.period, r.n_samples) == (400, 8192, 9 * 8192)
        assert np.sqrt(np.mean(r.data[0] ** 2)) == pytest.approx(r.level, rel=0.01)
        assert [c.role for c in r.channels] == ["reference", "monitor", "response", "response", "response"]


def test_f16_sweeps(bring_in):
    with bring_in("f16", "F16Data_SineSw_*.mat", "sweep.channels.toml") as session:
        assert [r.level for r in session.recordings()] == [4.8, 28.8, 67.0, 95.6]


def test_friction_damper(bring_in):
    """Kips and inches become joules: near the published energy of a cycle at half an inch, the third to fifth."""
    with bring_in("friction_damper", "ds2_*0.5amplitude.json") as session:
        found = session.recordings()
    for r, hertz, energy in zip(found, (0.5, 1.0, 2.0), (337, 329, 299), strict=True):
        cycle = round(r.rate / hertz)
        x, f = r.data[0, 2 * cycle : 5 * cycle + 1], r.data[1, 2 * cycle : 5 * cycle + 1]
        assert np.ptp(x) / 2 == pytest.approx(0.0127, rel=0.02)
        work = np.sum((f[1:] + f[:-1]) / 2 * np.diff(x)) / 3
        assert abs(work) == pytest.approx(energy, rel=0.05)
        assert r.level == 0.0127
