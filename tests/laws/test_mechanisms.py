"""Laws of every mechanism: exact response, exact derivatives, nothing at zero, the same physics in matrices."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import eigh

from labnnum.diagnosis.engine import Engine
from labnnum.diagnosis.nonlinear.receptance import Base
from labnnum.diagnosis.places import all_terms, places_of
from labnnum.diagnosis.sweep import sweep
from labnnum.errors import ConfigError
from labnnum.mechanisms import CATALOGUE, extend
from labnnum.mechanisms.shear_rotary import coarse_mass, rotary_mass, sideways_mass
from labnnum.recording import Channel
from labnnum.response import frf, frf_sensitivity, modes
from labnnum.structures import Beam
from sessions.model import parse_model

BEAM = """
[structure]
kind = "beam"
length = 0.4
E = "E"
rho = 2700.0
width = 0.03
height = 0.004
elements = 6
{base}
[[structure.support]]
node = "1"
[damping]
kind = "modal"
ratio = 0.008
[[parameter]]
name = "E"
nominal = 70e9
lower = 60e9
upper = 80e9
std = 3e9
"""
FREQUENCY = np.linspace(10.0, 900.0, 60)
S = 2j * np.pi * FREQUENCY


def bench(base, tmp_path_factory):
    """Structure, sensors, input and engine of a cantilever, shaken at its base or by a force."""
    text = BEAM.format(base='base = "z"' if base else "")
    structure = parse_model(text, tmp_path_factory.mktemp("model") / "model.toml").structure
    assert isinstance(structure, Beam)
    outputs = [Channel(f"a{i}", "acceleration", "response", str(i), "z") for i in (3, 5, 7)]
    role = Channel("b", "acceleration", "base", "1", "z") if base else Channel("f", "force", "reference", "4", "z")
    engine = Engine(structure, outputs, [role], (2 * np.pi * 10, 2 * np.pi * 900))
    return structure, outputs, [role], engine


@pytest.fixture(scope="module", params=[True, False], ids=["base", "force"])
def cantilever(request, tmp_path_factory):
    return bench(request.param, tmp_path_factory)


def some_terms(engine):
    """One term of each mechanism and variant kind."""
    _, terms = all_terms(engine, places_of(engine), CATALOGUE)
    seen, out = set(), []
    for t in terms:
        key = (t.mechanism.id, t.place.kind, t.variant.split(" ")[0])
        if key not in seen:
            seen.add(key)
            out.append(t)
    return out


def values_of(term):
    p = term.starts[len(term.starts) // 2].copy()
    if term.data.get("extra_mode"):
        p[2:] = [0.3, 0.2, 0.1]
    return p


def entry_of(term, p, outputs, inputs):
    place = {k: v for k, v in term.place.as_dict().items() if v is not None}
    values = {q.name: {"value": float(v), "unit": q.unit} for q, v in zip(term.parameters, p, strict=True)}
    entry = {"id": term.mechanism.id, "place": place, "variant": term.variant, "parameters": values}
    if term.data.get("extra_mode"):
        entry |= {"dofs": [c.dof for c in outputs], "driven": [c.dof for c in inputs if c.role != "base"]}
    return entry


def test_engine_equals_the_structure_room(cantilever):
    structure, outputs, inputs, engine = cantilever
    ours = engine.response(engine.start(), (), S).value
    plain = extend(structure, [])  # with the load that the held rows put on the free ones
    theirs = frf(plain, plain.nominal, FREQUENCY, outputs, inputs)
    np.testing.assert_allclose(ours, theirs, rtol=1e-6, atol=1e-9 * np.abs(theirs).max())


def test_zero_parameters_exert_nothing(cantilever):
    _, _, _, engine = cantilever
    plain = engine.response(engine.start(), (), S).value
    for term in some_terms(engine):
        if not term.n:
            continue
        p = np.zeros(term.n) if not term.data.get("extra_mode") else np.array([100.0, 0.01, 0, 0, 0])
        if term.mechanism.id in ("viscoelastic", "attached-oscillator"):
            p = np.r_[0.0, term.starts[0, 1:]]
        point = engine.start([term], p)
        same = engine.response(point, [term], S).value
        np.testing.assert_allclose(same, plain, rtol=1e-10, atol=1e-12 * np.abs(plain).max(), err_msg=term.mechanism.id)


def test_extended_structure_is_the_same_physics(cantilever):
    structure, outputs, inputs, engine = cantilever
    for term in some_terms(engine):
        # a modal loss over the modes in band only, and exchanged channels, are no matrices
        if term.data.get("swap") or term.variant == "structure":
            continue
        p = values_of(term)
        extended = extend(structure, [entry_of(term, p, outputs, inputs)])
        if term.whole is not None:  # there modal damping follows the changed modes, in matrices it stays as it was
            ours = engine.state(engine.theta0, [(term.whole, p)]).omega / (2 * np.pi)
            np.testing.assert_allclose(ours, modes(extended, extended.nominal).frequency, rtol=1e-7)
            continue
        if term.fitted is not term:
            changed = engine.state(engine.theta0, [(term.fitted.whole, p)]).omega / (2 * np.pi)
            exact = modes(extended, extended.nominal).frequency[: changed.size]
            np.testing.assert_allclose(changed, exact, rtol=2e-5)  # a mass of 1e-9 stands for one that a model lacks
        theirs, slope = frf_sensitivity(extended, extended.nominal, FREQUENCY, outputs, inputs)
        ours = engine.response(engine.start([term], p), [term], S).value
        np.testing.assert_allclose(
            ours, theirs, rtol=1e-6, atol=1e-7 * np.abs(theirs).max(), err_msg=f"{term.mechanism.id} {term.variant}"
        )
        assert slope.shape[0] == 1 + term.n


def test_derivatives_are_exact(cantilever):
    _, _, _, engine = cantilever
    every = some_terms(engine)
    for term in [*every, *(t.fitted for t in every if t.fitted is not t)]:
        point = replace(engine.start([term], values_of(term)), law=np.array([0.4]))
        made = engine.response(point, [term], S, jacobian=True)
        x = point.vector()
        for j in range(x.size):
            step = 1e-6 * max(abs(x[j]), 1e-3 if not 1 <= j <= term.n else abs(x[j]))
            up, down = x.copy(), x.copy()
            up[j] += step
            down[j] -= step
            ends = [engine.response(point.with_vector(v), [term], S).value for v in (up, down)]
            slope = (ends[0] - ends[1]) / (2 * step)
            np.testing.assert_allclose(
                made.jacobian[j], slope, rtol=2e-3, atol=2e-4 * np.abs(slope).max(), err_msg=f"{term.mechanism.id} {j}"
            )


def test_sweep_equals_one_by_one_with_terms_held(cantilever):
    _, _, _, engine = cantilever
    terms = some_terms(engine)
    held = [terms[0]]
    point = engine.start(held, values_of(held[0]))
    for term in terms[1::2]:
        starts = term.starts[:3]
        fast = sweep(engine, point, term, starts, S, held)
        for value, p in zip(fast, starts, strict=True):
            both = engine.start([*held, term], np.r_[values_of(held[0]), p])
            one = engine.response(both, [*held, term], S).value
            np.testing.assert_allclose(value, one, rtol=1e-7, atol=1e-10 * np.abs(one).max(), err_msg=term.mechanism.id)


def test_passive_laws_dissipate(cantilever):
    _, _, _, engine = cantilever
    for term in some_terms(engine):
        if term.mechanism.id in ("local-dashpot", "hysteretic-damping", "viscoelastic", "attached-oscillator"):
            g = term.stiffness(S, values_of(term))
            assert (np.imag(np.einsum("kkf->kf", g)) >= -1e-12 * np.abs(g).max()).all(), term.mechanism.id


def test_every_mechanism_explains_itself():
    assert len({m.id for m in CATALOGUE}) == len(CATALOGUE)
    for m in CATALOGUE:
        for text in (m.title, m.equation, m.shows, m.told_apart, m.symbol, m.reference):
            assert text.strip(), m.id


def test_mistakes_in_a_model_are_named(cantilever):
    structure, *_ = cantilever
    with pytest.raises(ConfigError, match="flubber"):
        extend(structure, [{"id": "flubber"}])
    with pytest.raises(ConfigError, match="no such place"):
        extend(structure, [{"id": "added-mass", "place": {"kind": "node", "id": "99"}, "parameters": {}}])
    with pytest.raises(ConfigError, match="'mass' is missing"):
        extend(structure, [{"id": "added-mass", "place": {"kind": "node", "id": "3"}, "parameters": {}}])


def free_of(structure, node="1", turn=1e9, push=1e9):
    """The structure on springs to the ground where its clamp was."""
    free = structure.released(node)
    m = free.matrices(free.nominal)
    stiffness = m.K.copy()
    stiffness[0, 0] += push
    stiffness[1, 1] += turn
    return m.M, stiffness


def test_a_compliant_clamp_is_the_free_structure_on_springs(cantilever):
    structure, _, inputs, engine = cantilever
    _, terms = all_terms(engine, places_of(engine), CATALOGUE)
    term = next(t for t in terms if t.mechanism.id == "support-compliance" and t.variant == "z and ry")
    for turn, push in ((200.0, 4e5), (20.0, 2e4)):
        mass, stiffness = free_of(structure, turn=turn, push=push)
        rigid = np.tile([1.0, 0.0], len(mass) // 2)
        based = inputs[0].role == "base"
        load = -mass @ rigid if based else np.eye(len(mass))[6]
        lines = S[:8].imag
        exact = [np.linalg.solve(stiffness - w**2 * mass, load) - (rigid / w**2 if based else 0) for w in lines]
        exact = -(lines**2) * np.array(exact)[:, [4, 8, 12]].T
        point = engine.start([term], [1 / push, 1 / turn, 0.0])
        point = replace(point, log_zeta=np.full_like(point.log_zeta, -20.0))
        ours = engine.response(point, [term], 1j * lines).value[:, 0]
        np.testing.assert_allclose(ours, exact, rtol=2e-3, atol=2e-3 * np.abs(exact).max())
        p = point.terms[: term.n]
        wide = Engine(extend(structure, [entry_of(term, p, [], inputs)]), engine.outputs, inputs, engine.band)
        at = wide.start()
        at = replace(at, log_zeta=np.full_like(at.log_zeta, -20.0), theta=np.append(at.theta[:1], p))
        in_model = wide.response(at, [], 1j * lines).value[:, 0]
        np.testing.assert_allclose(in_model, exact, rtol=2e-3, atol=2e-3 * np.abs(exact).max())
        below = Base(wide, at, np.zeros((wide.basis.shape[0], 0)), lines)
        made = below.at(below.start())
        np.testing.assert_allclose(made.lift * made.plain * made.gain, in_model, atol=1e-7 * np.abs(exact).max())


def test_shear_and_rotary_inertia_make_a_timoshenko_beam(tmp_path):
    text = BEAM.format(base="").replace("height = 0.004", "height = 0.03").replace("elements = 6", "elements = 12")
    slender = parse_model(text, tmp_path / "model.toml").structure
    thick = parse_model(text.replace("[[structure.support]]", 'theory = "timoshenko"\nnu = 0.3\n[[structure.support]]'),
                        tmp_path / "model.toml").structure  # fmt: skip
    channels = [Channel("a", "acceleration", "response", "7", "z")], [Channel("f", "force", "reference", "4", "z")]
    engine = Engine(slender, *channels, (10.0, 2e5))
    _, terms = all_terms(engine, places_of(engine), CATALOGUE)
    term = next(t for t in terms if t.mechanism.id == "shear-rotary")
    radius2, wave = 0.03**2 / 12, term.whole.wave
    assert wave == pytest.approx(np.sqrt(70e9 * 0.03**2 / 12 / 2700), rel=1e-6)
    p = np.array([radius2 * (1 + 3.12) / (2 * wave)])
    ours = engine.state(engine.theta0, [(term.whole, p)]).omega[:4] / (2 * np.pi)
    exact = modes(thick, thick.nominal).frequency[:4]
    bare = modes(slender, slender.nominal).frequency[:4]
    assert np.abs(bare / exact - 1).max() > 0.1
    np.testing.assert_allclose(ours, exact, rtol=6e-3)


CLAMPED = BEAM.replace('{base}\n[[structure.support]]\nnode = "1"\n', "{ends}\n").replace(
    "elements = 6", "elements = 8"
)


def test_two_clamps_that_give_are_the_beam_on_springs(tmp_path):
    """Both ends let go at once: the beam on springs in place of its clamps, in the engine and in matrices."""
    clamps = "".join(f'[[structure.support]]\nnode = "{n}"\n' for n in (1, 9))
    k, turn = 3e5, 400.0
    free = "".join(f'[[structure.spring]]\nnode = "{n}"\nstiffness = {k}\nrotational = {turn}\n' for n in (1, 9))
    held, loose = (parse_model(CLAMPED.format(ends=ends), tmp_path / "model.toml").structure for ends in (clamps, free))
    role = Channel("f", "force", "reference", "4", "z")
    engine = Engine(held, [Channel("a", "acceleration", "response", "5", "z")], [role], (60.0, 12000.0))
    _, terms = all_terms(engine, places_of(engine), CATALOGUE)
    both = [t for t in terms if t.mechanism.id == "support-compliance" and t.variant == "z and ry"]
    assert [t.place.id for t in both] == ["1", "9"]
    p = np.array([1 / k, 1 / turn])
    theta = np.array([73e9])
    ours = engine.state(theta, [(t.fitted.whole, p) for t in both]).omega / (2 * np.pi)
    exact = modes(loose, theta).frequency[: ours.size]
    np.testing.assert_allclose(ours, exact, rtol=2e-5)
    extended = extend(held, [entry_of(t, p, [], [role]) for t in both])
    at = np.array([73e9, *p, *p])
    np.testing.assert_allclose(modes(extended, at).frequency[: ours.size], exact, rtol=2e-5)


def test_thick_elements_are_those_of_timoshenko(tmp_path):
    """Elements as long as they are high: Euler's with the mechanism are Timoshenko's, mass and all, but for what those
    of two nodes have wrong beside finer ones.
    """
    text = CLAMPED.replace("height = 0.004", "height = 0.04").format(ends="").replace("rho", "{theory}rho", 1)
    thin = parse_model(text.format(theory=""), tmp_path / "model.toml").structure
    thick = parse_model(text.format(theory='theory = "timoshenko"\nnu = 0.3\n'), tmp_path / "model.toml").structure
    finer = modes(thick, np.array([66e9])).frequency
    thick = replace(thick, interior=0)
    role = Channel("f", "force", "reference", "4", "z")
    engine = Engine(thin, [Channel("a", "acceleration", "response", "5", "z")], [role], (2000.0, 60000.0))
    _, terms = all_terms(engine, places_of(engine), CATALOGUE)
    term = next(t for t in terms if t.mechanism.id == "shear-rotary")
    theta = np.array([66e9])
    wave = np.sqrt(70e9 / 2700 * 0.04**2 / 12)  # the mechanism's time is over the nominal wave
    time = 0.04**2 / 12 * (1 + 2.6 * 6 / 5) / (2 * wave)
    bare = replace(term.whole, coarse=0 * term.whole.coarse)
    ours, plain = (engine.state(theta, [(w, np.array([time]))]).omega / (2 * np.pi) for w in (term.whole, bare))
    exact = modes(thick, theta).frequency[: ours.size]
    np.testing.assert_allclose(plain[2:], exact[2:], rtol=1e-6)
    wrong, left = plain[2:6] / finer[2:6] - 1, ours[2:6] / finer[2:6] - 1
    assert np.all(np.abs(left) < 0.4 * wrong)


@pytest.mark.parametrize("thick", [0.05, 0.1, 0.2])
@pytest.mark.parametrize("wave", [0.5, 1.0, 1.5])
def test_a_coarse_mesh_of_sheared_elements_is_no_stiffer_than_one_without_shear(thick, wave):
    """Waves on an endless row of elements of length 1 against Timoshenko's beam, EI = rho A = 1; r in lengths."""
    ratio, r2 = 3.12, thick**2
    phi = 12 * r2 * ratio

    def square(phi, mass):
        stiff = np.array([[12, 6, -12, 6], [6, 4 + phi, -6, 2 - phi], [-12, -6, 12, -6], [6, 2 - phi, -6, 4 + phi]])
        ends = np.exp(1j * wave)
        row = np.array([[1, 0], [0, 1], [ends, 0], [0, ends]])
        return eigh(row.conj().T @ stiff @ row / (1 + phi), row.conj().T @ mass @ row, eigvals_only=True)[0]

    powers = np.array([1, phi, phi**2]) / (1 + phi) ** 2
    sheared = np.tensordot(powers, sideways_mass(1.0) + r2 * rotary_mass(1.0), 1)
    slender = square(0.0, sideways_mass(1.0)[0]) / wave**4
    b, c = 1 + r2 * (1 + ratio) * wave**2, ratio * r2**2
    exact = (b - np.sqrt(b**2 - 4 * c * wave**4)) / (2 * c)
    shear = 1 - exact / wave**4
    plain = square(phi, sheared) / exact / slender - 1
    mended = square(phi, sheared + phi * coarse_mass(1.0)[0]) / exact / slender - 1
    assert plain > 0.01 * shear  # what shear would be overrated by
    assert abs(mended) < 0.2 * plain
