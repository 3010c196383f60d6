"""Every law in harmonic balance, and its stability, beside time integration that is brought to its steady state.

The integration (`tests.steady`) shares nothing with the package.
"""

import numpy as np
import pytest

from labnnum.harmonic import HarmonicBalance
from labnnum.nonlinear import Element
from labnnum.structures.chain import Chain, Link
from sessions.model import read_model
from tests.steady import Truth

TURN = 2 * np.pi
ALONE = {  # on an oscillator of 1 kg, 1 N/m and 0.1 N s/m under 0.1 N
    "cubic": (1.0,), "quadratic": (0.3,), "one-sided-gap": (5.0, 0.05), "clearance": (5.0, 0.2), "coulomb": (0.03,),
    "quadratic-damping": (0.3,), "jenkins": (1.0, 0.05), "bouc-wen": (1.0, 8.0, 4.0, 1.5),
}  # fmt: skip
IN_CHAIN = {  # in a chain of three masses, driven at the second
    "cubic": (4e5,), "quadratic": (2e3,), "one-sided-gap": (900.0, 0.01), "clearance": (900.0, 0.008),
    "coulomb": (2.0,), "quadratic-damping": (40.0,), "jenkins": (500.0, 3.0), "bouc-wen": (500.0, 80.0, 60.0, 1.0),
}  # fmt: skip
MISS = {"coulomb": 2e-3}
"""Largest difference of the first harmonic over the motion: harmonics beyond the fifteenth move jumps a little;"""
KINKED = 5e-5
"""and of laws with corners, or less: the rest of the integration's transient, and corners between samples."""
JOINT, GROUND = np.array([0.0, -1.0, 1.0]), np.array([0.0, 0.0, 1.0])
OUTPUTS = ("1:x", "2:x", "3:x")


def single():
    return Chain({"1": 1.0}, (Link("1", "ground", 1.0, 0.1),))


def chain():
    links = (Link("1", "ground", 1000.0, 12.0), Link("1", "2", 800.0, 9.0), Link("2", "3", 600.0, 9.0))
    return Chain({"1": 1.0, "2": 1.2, "3": 0.8}, links)


def truth(structure, load, laws, frequency):
    m = structure.matrices(structure.nominal)
    return Truth(m.M, m.C, m.K, np.asarray(load, float), laws, TURN * frequency)


def apart(found, spectrum):
    """Largest differences of mean, first and third harmonic, over the largest motion."""
    return np.abs(found.harmonics[:, [0, 1, 3]] - spectrum[:, [0, 1, 3]]).max(axis=0) / np.abs(spectrum[:, 1]).max()


@pytest.mark.parametrize("law", sorted(ALONE))
def test_on_an_oscillator(law):
    element = Element(law, np.ones(1), ALONE[law])
    found = HarmonicBalance(single(), "1:x", 0.1, elements=[element]).solve(0.8 / TURN)
    model = truth(single(), [0.1], [(law, np.ones(1), ALONE[law])], 0.8 / TURN)
    spectrum, state = model.steady(30)
    assert np.abs(spectrum[0, 3]) > 1e-4 * np.abs(spectrum[0, 1])
    assert apart(found, spectrum).max() < MISS.get(law, KINKED)
    assert found.multiplier == pytest.approx(np.abs(np.linalg.eigvals(monodromy(model, state))).max(), rel=0.04)


def monodromy(model, state):
    """By differences: what small disturbances of the state have become after a period of time integration."""
    mode, period = list(model.mode), TURN / model.omega
    out = []
    for k in range(state.size):
        ends = []
        for sign in (1.0, -1.0):
            model.mode, y = list(mode), state.copy()
            y[k] += sign * 1e-6
            ends.append(model.run(y, 0.0, period)[0])
        out.append((ends[0] - ends[1]) / 2e-6)
    model.mode = mode
    return np.array(out).T


def test_a_stop_that_doubles_the_period_is_called_unstable():
    """The multiplier that says so is beyond -1: time integration comes back after two periods, not after one."""
    p = (5.0, 0.2)
    found = HarmonicBalance(single(), "1:x", 0.1, elements=[Element("one-sided-gap", np.ones(1), p)]).solve(0.8 / TURN)
    model = truth(single(), [0.1], [("one-sided-gap", np.ones(1), p)], 0.8 / TURN)
    first, state = model.steady(40)
    second, state = model.steady(0, state)
    third, _ = model.steady(0, state)
    assert abs(second[0, 1] - first[0, 1]) > 0.05 * abs(first[0, 1])
    assert abs(third[0, 1] - first[0, 1]) < 1e-3 * abs(first[0, 1])
    assert not found.stable


@pytest.mark.parametrize("place", ["joint", "ground"])
@pytest.mark.parametrize("law", sorted(IN_CHAIN))
def test_in_a_chain(law, place):
    column = {"joint": JOINT, "ground": GROUND}[place]
    found = HarmonicBalance(chain(), "2:x", 10.0, OUTPUTS, elements=[Element(law, column, IN_CHAIN[law])]).solve(2.4)
    spectrum, _ = truth(chain(), [0.0, 10.0, 0.0], [(law, column, IN_CHAIN[law])], 2.4).steady(30)
    assert np.abs(spectrum[:, 3]).max() > 5e-4 * np.abs(spectrum[:, 1]).max()
    assert apart(found, spectrum).max() < MISS.get(law, KINKED)
    assert found.stable


def test_several_laws_at_once():
    """A slider behind a spring and a cubic spring at one joint, a stop at another node, drag between two."""
    near = np.array([-1.0, 1.0, 0.0])
    laws = [
        ("jenkins", JOINT, (500.0, 3.0)), ("cubic", JOINT, (2e5,)), ("one-sided-gap", GROUND, (900.0, 0.02)),
        ("quadratic-damping", near, (40.0,)),
    ]  # fmt: skip
    made = HarmonicBalance(chain(), "2:x", 20.0, OUTPUTS, elements=[Element(n, c, p) for n, c, p in laws])
    found = made.solve(2.4)
    assert [s.name for s in made.laws] == ["jenkins + cubic", "one-sided-gap", "quadratic-damping"]
    spectrum, _ = truth(chain(), [0.0, 20.0, 0.0], laws, 2.4).steady(30)
    assert apart(found, spectrum).max() < KINKED


ENTRIES = {
    "cubic-stiffness": "k3 = 4e5", "quadratic-stiffness": "k2 = 2e3", "one-sided-gap": "k = 900.0, g = 0.01",
    "clearance": "k = 900.0, g = 0.008", "coulomb-friction": "F = 2.0", "quadratic-damping": "c2 = 40.0",
    "stick-slip": "k_t = 500.0, F_s = 3.0, spread = 0.6, sliders = 4, held = 1",
    "hysteresis": "k = 500.0, limit = 0.01, n = 1.5, beta_share = 0.6, held = 1",
}  # fmt: skip
MODEL = """
[structure]
kind = "chain"
mass = [{ node = "1", mass = 1.0 }, { node = "2", mass = 1.2 }, { node = "3", mass = 0.8 }]
link = [
  { between = ["1", "ground"], stiffness = 1000.0, damping = 12.0 },
  { between = ["1", "2"], stiffness = 800.0, damping = 9.0 },
  { between = ["2", "3"], stiffness = "k", damping = 9.0 },
]
[[parameter]]
name = "k"
nominal = 1100.0
lower = 500.0
upper = 2000.0
"""


@pytest.mark.parametrize("name", sorted(ENTRIES))
def test_laws_of_a_model_file(name, tmp_path):
    """As the file says: sliders with spread limits too, and what the model's spring holds already."""
    place = 'place = { kind = "joint", id = "2", to = "3" }'
    entry = f'[[mechanism]]\nid = "{name}"\nvariant = "x"\n{place}\nparameters = {{ {ENTRIES[name]} }}\n'
    (tmp_path / "model.toml").write_text(MODEL + entry)
    structure = read_model(tmp_path / "model.toml").structure
    found = HarmonicBalance(structure, "2:x", 10.0, OUTPUTS).solve(2.4)
    laws = [(e.law, e.column, e.parameters) for e in structure.law_elements()]
    spectrum, _ = truth(structure, [0.0, 10.0, 0.0], laws, 2.4).steady(30)
    assert apart(found, spectrum).max() < MISS.get(laws[0][0], KINKED)
    assert found.stable
