"""Irregularity that is all a sensor sees: motions against dense matrices, derivatives by differences, and a fit."""

from dataclasses import replace

import numpy as np
import pytest

from labnnum.diagnosis import objective
from labnnum.diagnosis.engine import Engine
from labnnum.diagnosis.evaluation import Evaluation
from labnnum.diagnosis.fit import fit
from labnnum.diagnosis.scatter import Data, Scatter
from labnnum.mechanisms import GroundStiffness
from labnnum.parameters import Parameter
from labnnum.recording import Channel
from labnnum.structures.frame import Frame, Member, Profile
from labnnum.structures.quantities import modal

SHAKER = (Channel("force", "force", "reference", node="9", direction="y"),)
OUTPUTS = (
    Channel("a1", "acceleration", "response", node="7", direction="x"),  # stands still where a drive is symmetric
    Channel("a2", "acceleration", "response", node="5", direction="x"),
    Channel("a3", "acceleration", "response", node="9", direction="y"),
)
BAND = (2 * np.pi * 12, 2 * np.pi * 200)
LINES = 2j * np.pi * np.linspace(12.0, 200.0, 160)
OFF = 0.004 * np.array([1.0, -0.6, 0.8, -0.4, 0.7, -1.1, 0.3, -0.8, 0.6, -0.5])


def portal(off=None, ratio=0.01):
    """Two columns of three elements and a beam of four, clamped; shaken in the middle of the beam."""
    low = {str(3 * side + i): (0.5 * side, 0.13 * i, 0.0) for side in range(2) for i in range(3)}
    nodes = low | {"6": (0.0, 0.39, 0.0), "7": (0.5, 0.39, 0.0)}
    nodes |= {str(8 + i): (0.125 * (i + 1), 0.39, 0.0) for i in range(3)}
    pairs = ["01", "12", "26", "34", "45", "57", "68", "89"]
    ends = [*((p[0], p[1]) for p in pairs), ("9", "10"), ("10", "7")]
    named = ["E_columns"] * 6 + ["E_beams"] * 4
    free = dict.fromkeys(named if off is None else ())
    section = {"width": 0.006, "height": 0.04, "rho": 7800.0}
    return Frame(
        nodes,
        {f"p{i}": Profile(E=e if off is None else 2.1e11 * (1 + off[i]), **section) for i, e in enumerate(named)},
        tuple(Member(a, b, f"p{i}") for i, (a, b) in enumerate(ends)),
        fixed={"0": ("x", "y", "rz"), "3": ("x", "y", "rz")},
        plane="xy",
        parameters=tuple(Parameter(n, 2.1e11, 1.5e11, 2.6e11, "Pa", std=1e10) for n in free),
        damping=modal(ratio),
    )


@pytest.fixture(scope="module")
def engine():
    return Engine(portal(), OUTPUTS, SHAKER, BAND)


def parts_of(engine):
    kinds = np.array(engine.irregular.kinds)
    sizes = 0.01 * np.random.default_rng(2).standard_normal(kinds.size)
    return sizes * (kinds != "zone")


@pytest.mark.parametrize("grounded", [False, True])
def test_motions_are_those_of_the_whole_dynamic_stiffness(engine, grounded):
    site = engine.site(("5",), (), ())
    terms = [next(t for t in GroundStiffness().terms(site) if t.place.id == "5")] if grounded else []
    point = engine.start(terms, [2e4] if grounded else [])
    one = Evaluation(engine, point, terms, LINES)
    parts, (every, _) = parts_of(engine), engine.irregular.couplings(one)
    kinds = np.array(engine.irregular.kinds)
    q, _, p_out, _, _ = one._coupled
    bent = engine.irregular.bent(one, q, p_out, parts)
    middle = np.exp(np.mean(np.log(one.omega[engine.band_modes])))
    for f in (3, 60, 150):
        s = LINES[f]
        loss = 2 * np.exp(np.mean(point.log_zeta)) * s / middle
        factor = np.select([kinds == "stiffness", kinds == "loss", kinds == "mass"], [1.0, loss, s**2], 0.0)
        whole = np.diag(1 / one.d[:, f]) + np.tensordot(parts * factor, every, 1)
        load, out = one.load.astype(complex), one.state.out.astype(complex)
        if grounded:  # through the modes' own motion, and what those above the basis give way by
            h0, z0, gw, _ = (part[..., f] for part in one._receptances())
            w, d = one.w[0], one.d[:, f]
            spring = 1 / (1 / one.g[0, 0, f] + gw[0, 0] - np.sum(w**2 * d))
            load = load - spring * np.outer(w, z0[0] - w @ (d[:, None] * load))
            out = out - spring * np.outer(w, h0[:, 0] - w @ (d[:, None] * out))
            whole = whole + spring * np.outer(w, w)
        for told, forces in ((bent.q, load), (bent.p_out, out)):
            exact = np.linalg.solve(whole, forces)
            np.testing.assert_allclose(told[:, :, f], exact, atol=1e-9 * np.abs(exact).max())


@pytest.mark.parametrize("finer", [None, True])
def test_derivatives_are_differences(engine, finer):
    engine.refine(finer)
    try:
        parts = parts_of(engine) * (np.array(engine.irregular.kinds) != "loss")  # it follows the damping: left out
        point = replace(engine.start(), size=np.full(engine.band_modes.size, 0.01))
        scale = np.array([1e5] * 2 + [1e-6] * (3 * engine.band_modes.size + 1))
        x = point.vector()

        def value(x):
            return Evaluation(engine, point.with_vector(x), (), LINES).run(False, False, parts=parts).value

        told = Evaluation(engine, point, (), LINES).run(True, False, parts=parts).jacobian
        for j in range(x.size - 1):  # the share of hysteretic damping is at its bound
            step = np.zeros_like(x)
            step[j] = scale[j]
            real = (value(x + step) - value(x - step)) / (2 * scale[j])
            # what a finer mesh does is taken to first order, and so is what turning shapes make of the parts
            near = 4e-2 if finer else 5e-3 if j < point.theta.size else 2e-5
            np.testing.assert_allclose(told[j], real, atol=near * np.abs(real).max())
    finally:
        engine.refine(None)


def sound():
    """A base fit's problem: a portal whose elements differ by half a percent, with other damping than the model's."""
    truth = Engine(portal(OFF, 0.016), OUTPUTS, SHAKER, BAND)
    value = truth.response(truth.start(), (), LINES).value
    noise = 3e-4 * np.abs(value)
    rng = np.random.default_rng(3)
    value = value + noise * (rng.standard_normal(value.shape) + 1j * rng.standard_normal(value.shape)) / np.sqrt(2)
    made = Engine(portal(), OUTPUTS, SHAKER, BAND)
    kinds = np.array(made.irregular.kinds)
    sizes = np.select([kinds == "stiffness", kinds == "loss"], [0.005, 0.01], 0.002)
    small = Scatter(frequency=0.002, residue=0.005, shape=0.002, gain=0.001, phase=0.0005, complexity=0.0005,
                    remainder=0.02, common=np.diag(sizes)[:, kinds != "zone"])  # fmt: skip
    return truth, made, Data(LINES, value, noise), small


def fitted(made, data, scatter, *, follow=True):
    """From the nominal model, with errors that are told to be smaller and smaller."""
    x = made.start().vector()
    for floor in (0.3, 0.03, 0.003, 0.0):
        last = fit(made, data.with_floor(floor), (), scatter, x, steps=40, follow=follow)
        x = last.point.vector()
    return last


def test_a_sensor_that_stands_still_tells_the_modes_it_sees_by_irregularity(monkeypatch):
    """Those that a symmetric drive leaves out: their frequencies and damping, from a fit that explains all rows."""
    truth, made, data, scatter = sound()
    found = fitted(made, data, scatter)
    real = truth.state(truth.theta0).omega[truth.band_modes]
    at = Evaluation(made, found.point, (), LINES)
    seen = made.seen_modes
    np.testing.assert_allclose(at.omega[seen], real[: seen.size], rtol=2e-4)
    np.testing.assert_allclose(np.exp(found.point.log_zeta[: seen.size]), 0.016, rtol=0.02)
    assert found.objective < 1.3 * 2 * data.value.size
    monkeypatch.setattr(objective, "BENT", np.inf)
    held = fitted(made, data, scatter, follow=False)
    assert held.objective > 2 * found.objective
    followed = fitted(made, data, scatter)  # at a higher cost this finds its way as well
    assert followed.objective < 1.02 * found.objective
