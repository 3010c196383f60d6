"""Signs level by level: they grow with level as the law that makes them says."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.signal import lfilter

from labnnum.diagnosis import observe_all, observe_frf
from labnnum.estimators import H1, Welch
from labnnum.excitation import chirp, multisine
from labnnum.recording import Channel, Recording
from sessions.levels import per_level
from sessions.report.nonlinear import nonlinear_section, signs_by_level

RATE, N = 512.0, 1024
CHANNELS = (Channel("f", "force", "reference", "1", "x"), Channel("x", "displacement", "response", "1", "x"))


def respond(f, square, cubic):
    return lfilter([0.1], [1, -0.9], f + square * f**2 + cubic * f**3)


def played(level, square=0.0, cubic=0.0, seed=1):
    f = multisine(RATE, N, (5.0, 200.0), rms=level, seed=seed, n_periods=8, grid_seed=3).samples
    x = respond(f, square, cubic) + 1e-5 * np.random.default_rng(seed).standard_normal(f.size)
    return Recording(CHANNELS, np.stack([f, x])[:, 3 * N :], RATE, period=N, label=f"{level}")


@pytest.mark.parametrize(
    ("law", "name", "other", "growth"), [("cubic", "odd", "even", 12.04), ("square", "even", "odd", 6.02)]
)
def test_distortion_grows_with_level_as_its_law_says(law, name, other, growth):
    rows = per_level(observe_all([played(level, **{law: 0.01}) for level in (2.0, 0.5, 1.0)]))
    assert [r["level"] for r in rows] == pytest.approx([0.5, 1.0, 2.0])
    own, rest = ([r[f"{kind}_db"] for r in rows] for kind in (name, other))
    np.testing.assert_allclose(np.diff(own), growth, atol=1.0)
    assert all(r[f"{name}_over_noise_db"] > 20 for r in rows)
    assert all(b < a - 20 for a, b in zip(own, rest, strict=True))
    assert rows[0]["change"] is None
    if law == "cubic":  # what it puts on the played lines goes with the square of the level, from line to line alike
        assert rows[1]["change"] / rows[2]["change"] == pytest.approx((1 - 0.25) / (4 - 0.25), rel=0.05)
        assert rows[2]["change"] > 0.9 * 0.03 * (4 - 0.25)  # 1 + 3 c rms^2 in the mean, with many lines
    assert all(r["harmonics"] is None for r in rows)
    assert all(r["shares"]["noise"] < 1e-3 for r in rows)


def test_realisations_of_a_level_are_one_row():
    rows = per_level(observe_all([played(1.0, cubic=0.05, seed=s) for s in (1, 2, 3)]))
    assert len(rows) == 1
    assert rows[0]["runs"] == 3
    assert rows[0]["shares"]["nonlinear distortion"] > 10 * rows[0]["shares"]["noise"]


def test_harmonics_of_a_sweep_grow_with_level():
    def swept(level):
        f = chirp(RATE, 2**14, (5.0, 60.0), rms=level, law="log", fade=0.01).samples
        x = respond(f, 0.0, 0.01) + 1e-6 * np.random.default_rng(2).standard_normal(f.size)
        return Recording(CHANNELS, np.stack([f, x]), RATE)

    rows = per_level(observe_all([swept(level) for level in (0.5, 1.0)]))
    assert rows[1]["harmonics"]["3"] - rows[0]["harmonics"]["3"] == pytest.approx(12.04, abs=0.5)
    assert rows[0]["odd_db"] is None
    table = str(signs_by_level(rows))
    assert "order 3" in table
    assert "noise or sweep" in table


def test_frfs_alone_tell_no_level():
    recording = played(1.0)
    frf = H1(Welch(N))(Recording(CHANNELS, recording.data, RATE))
    (row,) = per_level([observe_frf(frf)])
    assert (row["kind"], row["level"], row["shares"], row["odd_db"]) == ("frf", None, None, None)
    assert signs_by_level([]) == ""


def test_a_linear_diagnosis_shows_its_signs_too():
    rows = per_level(observe_all([played(level, cubic=0.01) for level in (0.5, 1.0)]))
    signs = {"level_dependence": 0.02, "odd_distortion_db": rows[1]["odd_db"], "even_distortion_db": None}
    section = nonlinear_section(SimpleNamespace(detail={}, nonlinear={**signs, "per_level": rows}))
    assert section.title == "Signs of nonlinear physics"
    for row in rows:
        assert f"{row['odd_db']:.1f} dB ({row['odd_over_noise_db']:+.1f})" in section.body
    assert f"{rows[1]['odd_db']:.1f} dB relative to the excited lines" in section.body
    assert "no detection lines" in section.body
    assert nonlinear_section(SimpleNamespace(detail={}, nonlinear=signs)) is None
