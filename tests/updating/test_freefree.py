"""The free-free beam of the ModeLAB repository: length, wave constant and mass from nine FRFs."""

import numpy as np
import pytest

from labnnum.bands import Band
from labnnum.frf import Frf
from labnnum.parameters import Parameter
from labnnum.recording import Channel
from labnnum.response import modes
from labnnum.structures.beam import Beam
from labnnum.structures.quantities import structural
from labnnum.structures.section import Section
from labnnum.updating import refine

REFERENCE = {"length": 1.298, "wave": 53.06, "mass": 5.95}
PEAKS = np.array([111.992, 306.855, 596.37, 974.13])
BANDS = (Band(60, 200), Band(200, 450), Band(450, 780), Band(780, 990))
PARAMETERS = (
    Parameter("length", 1.30, 1.20, 1.40, "m"),
    Parameter("wave", 53.0, 48.0, 58.0, "m^2/s"),
    Parameter("mass", 6.0, 5.0, 7.0, "kg"),
    Parameter("eta", 1e-3, 1e-5, 5e-3),
)


def beam(theory, z):
    section = Section(E=200e9, G=77e9, kappa=0.85, rho=7850.0, wave="wave", mass="mass")
    points = {f"p{i}": float(x) for i, x in enumerate(z, 1)}
    return Beam(
        "length", section, n_elements=8, theory=theory, points=points, parameters=PARAMETERS,
        damping=structural("eta"), axis="z", direction="x",
    )  # fmt: skip


@pytest.fixture(scope="module")
def measured(recordings):
    data = np.load(recordings / "freefree_beam" / "frf_9pts.npz")
    chosen = np.arange(data["f"].size) % 24 == 0
    inputs = tuple(Channel(f"f{i}", "force", "reference", f"p{i}", "x") for i in range(1, 10))
    output = Channel("a4", "acceleration", "response", "p4", "-x")
    return Frf(data["f"][chosen], data["H"][None][..., chosen], (output,), inputs), data["z"]


def test_a_timoshenko_beam_gives_the_reference(measured):
    frf, z = measured
    estimate = refine(beam("timoshenko", z), frf, bands=BANDS)
    for name, value in REFERENCE.items():
        assert estimate[name] == pytest.approx(value, rel=0.01)
    found = modes(beam("timoshenko", z), estimate.value).frequency[2:6]
    assert np.abs(found / PEAKS - 1).max() < 0.003
    assert any("estimated from its roughness" in w for w in estimate.warnings)
    assert not any("resonance near" in w for w in estimate.warnings)


def test_without_shear_the_misfit_is_visible_and_reported(measured):
    frf, z = measured
    estimate = refine(beam("euler-bernoulli", z), frf, bands=BANDS)
    found = modes(beam("euler-bernoulli", z), estimate.value).frequency[2:6]
    assert np.abs(found / PEAKS - 1).max() > 0.01
    assert any("the model's resonance near" in w for w in estimate.warnings)
    assert estimate.chi2 > 100
