"""What a coarse mesh is too stiff by, against the same frame cut finer."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import eigh

from labnnum.diagnosis.engine import Engine
from labnnum.diagnosis.fit import fit
from labnnum.diagnosis.linear import LADDER, base_fit, settle_mesh
from labnnum.diagnosis.scatter import Scatter
from labnnum.diagnosis.search import broaden
from labnnum.diagnosis.task import Task, choose_lines, data_of
from labnnum.diagnosis.verdict import Limits
from labnnum.frf import Frf
from labnnum.recording import Channel
from labnnum.structures.beam import Beam
from labnnum.structures.frame import Frame, Member, Profile
from labnnum.structures.quantities import modal
from labnnum.structures.section import Section

HIGH = 620.0
"""Upper end of the band, Hz."""


def portal(parts: int) -> Frame:
    """A clamped portal, each of whose eight bars has so many elements."""
    bar = Profile(E=2e11, rho=7800.0, width=0.01, height=0.01)
    corners = [(0, 0), (0, 0.09), (0, 0.18), (0, 0.27), (0.17, 0.27), (0.34, 0.27), (0.5, 0.27), (0.5, 0.13), (0.5, 0)]
    nodes, members = {}, []
    for i, (a, b) in enumerate(itertools.pairwise(corners)):
        names = [str(i), *(f"{i}_{j}" for j in range(1, parts)), str(i + 1)]
        for j, name in enumerate(names):
            x, y = np.array(a) + (np.array(b) - np.array(a)) * j / parts
            nodes[name] = (float(x), float(y), 0.0)
        members += [Member(p, q, "bar") for p, q in itertools.pairwise(names)]
    held = ("x", "y", "rz")
    return Frame(nodes, {"bar": bar}, tuple(members), fixed={"0": held, "8": held}, plane="xy", damping=modal(0.01))


def channels() -> tuple[list[Channel], list[Channel]]:
    """Three accelerations and a force."""
    out = [Channel(d, "acceleration", "response", node=d[0], direction=d[2]) for d in ("2:x", "4:y", "7:x")]
    return out, [Channel("force", "force", "reference", node="5", direction="y")]


def engine(structure, high: float = HIGH) -> Engine:
    out, drive = channels()
    return Engine(structure, out, drive, (2 * np.pi * 20.0, 2 * np.pi * high))


def test_frequencies_fall_as_those_of_a_finer_mesh() -> None:
    coarse, fine = engine(portal(1)), engine(portal(6))
    b = coarse.band_modes
    exact = fine.state(fine.theta0).omega[b] / coarse.state(coarse.theta0).omega[b] - 1
    inside = coarse.state(coarse.theta0).omega[b] < 2 * np.pi * HIGH
    assert exact[inside].min() < -0.01
    assert np.allclose(coarse.mesh_shift[inside], exact[inside], rtol=0.05, atol=2e-5)


def test_a_refined_engine_answers_as_a_finer_mesh_does() -> None:
    coarse, fine = engine(portal(1)), engine(portal(6))
    s = 2j * np.pi * np.linspace(25.0, 400.0, 160)
    exact = fine.response(fine.start(), (), s).value
    plain = coarse.response(coarse.start(), (), s).value
    coarse.refine(finer=True)
    refined = coarse.response(coarse.start(), (), s).value

    def error(value: np.ndarray) -> float:
        return float(np.sqrt(np.sum(np.abs(value - exact) ** 2) / np.sum(np.abs(exact) ** 2)))

    assert error(refined) < 0.1 * error(plain)


def test_derivatives_of_a_refined_engine() -> None:
    made = engine(portal(1), 400.0)
    made.refine(finer=True)
    s, point = 2j * np.pi * np.linspace(25.0, 380.0, 60), made.start()
    x = point.vector()
    slopes = made.response(point, (), s, jacobian=True).jacobian
    assert slopes is not None
    for i in range(x.size):
        step = np.zeros(x.size)
        step[i] = 1e-6
        ahead, behind = (made.response(point.with_vector(x + f * step), (), s).value for f in (1, -1))
        numeric = (ahead - behind) / 2e-6
        assert np.linalg.norm(slopes[i] - numeric) <= 0.03 * np.linalg.norm(numeric), i


def test_a_fine_mesh_is_left_as_it_is() -> None:
    steel = Section(E=2e11, rho=7800.0, width=0.03, height=0.005)
    beam = Beam(length=0.5, section=steel, n_elements=12, supports_at={"1": "clamped"})
    out = [Channel("a", "acceleration", "response", node="7", direction="z")]
    drive = [Channel("force", "force", "reference", node="13", direction="z")]
    made = Engine(beam, out, drive, (2 * np.pi * 5.0, 2 * np.pi * 300.0))
    made.refine(finer=True)
    assert made.finer is False
    assert not made.mesh_shift.any()


@pytest.mark.parametrize("mesh", [2, 3])
def test_a_beam_of_few_elements(mesh: int) -> None:
    steel = Section(E=2e11, rho=7800.0, width=0.03, height=0.005)
    beam = Beam(length=0.5, section=steel, n_elements=mesh, supports_at={"1": "clamped"})
    fine = replace(beam, n_elements=12 * mesh)
    out = [Channel("a", "acceleration", "response", node="2", direction="z")]
    drive = [Channel("force", "force", "reference", node=str(mesh + 1), direction="z")]
    made = Engine(beam, out, drive, (2 * np.pi * 5.0, 2 * np.pi * 150.0))
    m = fine.matrices(fine.nominal)
    exact = np.sqrt(eigh(m.K, m.M, eigvals_only=True))[: made.band_modes.size]
    own = made.state(made.theta0).omega[made.band_modes]
    seen = own < 2 * np.pi * 150.0
    assert np.allclose(own[seen] * (1 + made.mesh_shift[seen]), exact[seen], rtol=2e-3)


def test_the_data_choose_the_finer_mesh() -> None:
    """Hits of a portal of many elements, diagnosed with one element a bar."""
    rng = np.random.default_rng(3)
    out, drive = channels()
    fine = engine(portal(6))
    frequency = np.arange(20.0, 500.0, 0.4)
    exact = fine.response(fine.start(), (), 2j * np.pi * frequency).value
    sigma = 2e-4 * np.median(np.abs(exact), axis=2, keepdims=True) * np.ones_like(exact.real)
    noise = (rng.normal(size=exact.shape) + 1j * rng.normal(size=exact.shape)) * sigma / np.sqrt(2)
    frf = Frf(frequency, exact + noise, tuple(out), tuple(drive), variance=sigma**2)
    made = engine(portal(1), 500.0)
    data = data_of(choose_lines(frf), Scatter())
    ladder = tuple(broaden(made, data, made.start(), (), k) for k in LADDER)
    task = Task(made, data, data, (*ladder, data), Scatter(), Scatter(), Limits())
    base = base_fit(task, (), made.start())
    better = settle_mesh(task, base)
    assert made.finer
    made.refine(finer=False)
    assert better.objective < 0.8 * fit(made, data, (), Scatter(), base.point.vector(), steps=60).objective
