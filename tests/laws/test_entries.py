"""What a model file's [[mechanism]] entries may say: names, their order, places, and what is refused."""

import numpy as np
import pytest

from labnnum.errors import ConfigError, ModelError
from labnnum.mechanisms import extend
from labnnum.recording import Channel
from labnnum.response import frf, modes
from labnnum.structures.chain import Chain, Link
from labnnum.structures.modal import ModalStructure, Mode

PAIR = Chain(masses={"1": 2.0, "2": 1.0}, links=(Link("1", "ground", 8e5, 60.0), Link("1", "2", 5e5, 40.0)))
FORCE = Channel("f", "force", "reference", "1", "x")
TIP = Channel("a", "acceleration", "response", "2", "x")
LINES = np.linspace(5.0, 400.0, 30)
ALL = {"kind": "channel", "id": "all"}
AT_TIP = {"kind": "channel", "id": "a"}


def entry(name, place, **parameters):
    return {"id": name, "place": place, "parameters": parameters}


def factor(structure):
    return structure.chain(TIP, LINES, structure.nominal)


def test_a_filter_is_told_by_its_names_in_any_order():
    a, b = 1e-4, 1e-8
    s = 2j * np.pi * LINES
    for told in ({"a1": a, "b1": b}, {"b1": b, "a1": a}):
        made = extend(PAIR, [entry("recording-filter", ALL, **told)])
        np.testing.assert_allclose(factor(made), 1 / (1 + a * s + b * s**2))
    mixed = {"b2": 4 * b, "a1": a, "a2": 2 * a, "b1": b}
    made = extend(PAIR, [entry("recording-filter", ALL, **mixed)])
    two = 1 / (1 + a * s + b * s**2) / (1 + 2 * a * s + 4 * b * s**2)
    np.testing.assert_allclose(factor(made), two)


@pytest.mark.parametrize(
    ("told", "said"),
    [
        (entry("recording-filter", ALL), "'recording-filter': parameter 'a1' is missing"),
        (entry("recording-filter", ALL, a1=1e-4), "'recording-filter': parameter 'b1' is missing"),
        (entry("recording-filter", ALL, a2=1e-4, b2=1e-8), "'recording-filter': parameter 'a1' is missing"),
        (entry("recording-filter", ALL, a1=1e-4, b1=1e-8, c1=1.0), "no parameter 'c1'; it has a1, b1"),
        (entry("channel-gain", AT_TIP, gian=-0.1), "'channel-gain' at channel a: there is no parameter 'gian'"),
        (entry("channel-gain", AT_TIP), "'channel-gain': parameter 'gain_error' is missing"),
        (entry("channel-gain", {"kind": "node", "id": "2"}, gain_error=0.1), "'channel-gain' cannot act at node 2"),
        (entry("channel-swap", AT_TIP, gain=1.0) | {"variant": "inverted"}, "no parameter 'gain'; it has none"),
        (
            entry("added-mass", {"kind": "node", "id": "2"}, mass=0.1, inertia=1.0),
            "no parameter 'inertia'; it has mass",
        ),
        (
            entry("cubic-stiffness", {"kind": "ground", "id": "2"}, k3=1.0, k2=1.0) | {"variant": "x"},
            "no parameter 'k2'; it has k3",
        ),
        (
            entry("out-of-plane-mode", {}, frequency=9.0, damping_ratio=0.01, residue_a=0.1) | {"dofs": ["1:x", "2:x"]},
            r"'out-of-plane-mode': its dofs are \['1:x', '2:x'\] and its other parameters \['residue_a'\]",
        ),
        (entry("out-of-plane-mode", {}, frequency=9.0), "'out-of-plane-mode': parameter 'damping_ratio' is missing"),
    ],
)
def test_names_that_are_missing_or_unknown_are_named(told, said):
    with pytest.raises(ConfigError, match=said):
        extend(PAIR, [told])


def test_an_added_mode_is_told_in_any_order():
    place, dofs = {"kind": "global", "id": "structure"}, {"dofs": ["2:x"], "driven": ["1:x"]}
    ordered = entry("out-of-plane-mode", place, frequency=50.0, damping_ratio=0.02, residue_a=0.3) | dofs
    other = entry("out-of-plane-mode", place, residue_a=0.3, damping_ratio=0.02, frequency=50.0) | dofs
    one, two = (extend(PAIR, [e]) for e in (ordered, other))
    value, again = (frf(s, s.nominal, LINES, [TIP], [FORCE]) for s in (one, two))
    np.testing.assert_array_equal(value, again)


def test_each_parameter_has_a_name_of_its_own():
    beam = {"kind": "node", "id": "2"}
    oscillator = entry("attached-oscillator", beam, mass=0.1, frequency=40.0, damping_ratio=0.02) | {"variant": "x"}
    made = extend(PAIR, [entry("added-mass", beam, mass=0.2), oscillator, entry("added-mass", beam, mass=0.3)])
    names = [p.name for p in made.parameters]
    assert names[:4] == ["mass@2", "mass@2:attached-oscillator", "frequency@2", "damping_ratio@2"]
    assert len(set(names)) == len(names) == 5
    assert [float(v) for v in made.nominal] == [0.2, 0.1, 40.0, 0.02, 0.3]


def residual(massless=True):
    """Two modes, with what those above add at one place."""
    pair = (Mode(50.0, 0.01, {"1:x": 1.0, "2:x": -0.8}), Mode(120.0, 0.01, {"1:x": 0.8, "2:x": 1.0}))
    return ModalStructure(pair, {"1:x": 1e-7} if massless else {})


def test_mechanisms_on_modes_with_a_residual_flexibility():
    law = entry("clearance", {"kind": "joint", "id": "1", "to": "2"}, k=4e3, g=8e-4) | {"variant": "x"}
    made = extend(residual(), [law])
    np.testing.assert_allclose(modes(made, made.nominal).frequency, [50.0, 120.0])
    (element,) = made.law_elements()
    np.testing.assert_allclose(element.column, [-1.8, 0.2, -1e-7])
    heavy = extend(residual(), [entry("added-mass", {"kind": "node", "id": "2"}, mass=0.1)])
    bare = extend(residual(massless=False), [entry("added-mass", {"kind": "node", "id": "2"}, mass=0.1)])
    np.testing.assert_allclose(modes(heavy, heavy.nominal).frequency, modes(bare, bare.nominal).frequency)
    trimmed = extend(residual(), [{"id": "modal-trim", "shift": [0.01, 0.0], "damping": [2.0, 1.0]}])
    found = modes(trimmed, trimmed.nominal)
    np.testing.assert_allclose(found.frequency, [50.5, 120.0])
    np.testing.assert_allclose(found.damping_ratio, [2 * 0.01 / 1.01, 0.01], rtol=1e-6)


def test_a_law_on_a_chain_with_a_coordinate_without_mass():
    chain = Chain(
        masses={"1": 2.0, "2": 0.0, "3": 1.0},
        links=(Link("1", "ground", 8e5), Link("1", "2", 5e5), Link("2", "3", 5e5)),
    )
    law = entry("cubic-stiffness", {"kind": "joint", "id": "1", "to": "2"}, k3=1e9) | {"variant": "x"}
    made = extend(chain, [law])
    assert modes(made, made.nominal).frequency.size == 2
    np.testing.assert_array_equal(made.law_elements()[0].column, [-1.0, 1.0, 0.0])


def test_a_coordinate_with_neither_mass_nor_stiffness_is_said():
    chain = Chain(masses={"1": 2.0, "2": 0.0}, links=(Link("1", "ground", 8e5), Link("2", "1", 0.0)))
    law = entry("cubic-stiffness", {"kind": "ground", "id": "1"}, k3=1e9) | {"variant": "x"}
    with pytest.raises(ModelError, match="neither mass nor stiffness"):
        extend(chain, [law])
