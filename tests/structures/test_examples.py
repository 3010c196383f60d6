"""The dissertation's structures against the figures that its text prints or implies."""

from dataclasses import replace

import numpy as np
import pytest

from labnnum.errors import ConfigError
from labnnum.response import frf, modes
from labnnum.structures.examples import EXAMPLES, dissertation_beam, dissertation_frame, kabe, truck, yang_brown

OMEGA = {
    "truck": (12.9, 20.8, 32.8),
    "kabe": (30.59, 31.42, 31.73, 31.78, 32.53, 34.27, 35.58, 38.79),
    "yang-brown-low": (100.5, 194, 221, 274, 277, 336, 340, 375, 392, 427),
}


@pytest.mark.parametrize(("name", "omega"), OMEGA.items(), ids=OMEGA)
def test_natural_frequencies(name, omega):
    s = EXAMPLES[name]().structure
    found = 2 * np.pi * modes(s, s.nominal, len(omega)).frequency
    last_digits = np.array([10.0 ** -len(str(w).partition(".")[2]) for w in omega])
    assert (np.abs(found - omega) < 0.6 * last_digits).all()


def test_kabe_is_as_dense_as_the_text_says():
    f = modes(kabe(), kabe().nominal).frequency
    assert f[-1] / f[0] - 1 == pytest.approx(0.27, abs=0.01)
    assert f[3] / f[0] - 1 < 0.05


def test_yang_brown_reaches_its_highest_frequency():
    s = yang_brown()
    assert 2 * np.pi * modes(s, s.nominal).frequency[-1] == pytest.approx(1260, abs=0.5)
    low, high = yang_brown(False).matrices(s.nominal), yang_brown(True).matrices(s.nominal)
    np.testing.assert_allclose(high.C, 7 * low.C)


def test_beam_resonances_lie_in_their_bands():
    s = dissertation_beam()
    assert s.matrices(s.nominal).M.shape == (12, 12)
    omega = 2 * np.pi * modes(s, s.nominal, 4).frequency
    for found, (low, high) in zip(omega, ((86.4, 141), (636, 699), (1932, 2058), (3770, 4131)), strict=True):
        assert low < found < high


def test_beam_frf_is_equation_5_10():
    s = dissertation_beam()
    m = s.matrices(s.nominal)
    w = np.array([100.0, 660.0, 1990.0, 3900.0])
    whole = replace(s, supports_at={}).matrices(s.nominal).M  # of the clamped end too, which the base moves
    pushed = (whole @ np.tile([1.0, 0.0], 7))[2:]
    relative = np.linalg.solve(m.dynamic_stiffness(w), np.broadcast_to(pushed[:, None], (4, 12, 1)))[:, 2, 0]
    example = EXAMPLES["beam"]()
    found = frf(s, s.nominal, w / (2 * np.pi), example.outputs, example.inputs)[0, 0]
    np.testing.assert_allclose(found, w**2 * relative + 1, rtol=1e-8)


def test_frame_has_96_coordinates_and_modes_in_its_bands():
    s = dissertation_frame()
    assert s.matrices(s.nominal).M.shape == (96, 96)
    omega = 2 * np.pi * modes(s, s.nominal, 8).frequency
    for low, high in ((65, 86), (190, 260)):
        assert ((omega > low) & (omega < high)).any()


def test_truck_with_fewer_parameters():
    s = truck(("m3",))
    assert [p.name for p in s.parameters] == ["m3"]
    np.testing.assert_allclose(s.matrices(s.nominal).K, truck().matrices(truck().nominal).K)
    with pytest.raises(ConfigError, match="no parameter 'm9'"):
        truck(("m9",))


@pytest.mark.parametrize("name", EXAMPLES)
def test_examples_respond(name):
    e = EXAMPLES[name]()
    f = np.concatenate([np.linspace(b.low, b.high, 3) for b in e.bands])
    assert np.isfinite(frf(e.structure, e.structure.nominal, f, e.outputs, e.inputs)).all()
