"""Sliders on a base that was identified while they stuck: they act as what their spring lacks once they slide."""

import numpy as np
import pytest

from labnnum.diagnosis import diagnose, observe_all
from labnnum.diagnosis.diagnose import _known as known_laws
from labnnum.diagnosis.nonlinear.force import HELD
from labnnum.diagnosis.nonlinear.locate import Lead
from labnnum.identification import identify
from labnnum.mechanisms import extend
from labnnum.nonlinear import Element
from labnnum.recording import Channel, Recording
from labnnum.structures.modal import ModalStructure, Mode

from .test_nonlinear import FORCE, PERIOD, RATE, chain, joint_23, lines_of, multisine, spread_sliders
from .test_nonlinear import marched as marched_at

SENSORS = tuple(Channel(f"a{i}", "acceleration", "response", str(i), "x") for i in (1, 2, 3, 4))
PLACES = {
    "nodes": list("1234"), "elements": [(a, b) for a in "1234" for b in "1234" if a < b], "supports": [],
}  # fmt: skip
MANY = list(spread_sliders(400.0, 6.0, 0.8))


def measured(elements, levels, noise, monkeypatch):
    """Two realisations of four periods at each level, with noise relative to the level."""
    monkeypatch.setattr("tests.diagnosis.test_nonlinear.OUTPUTS", SENSORS)
    rng, out = np.random.default_rng(3), []
    for level in levels:
        for realisation in range(2):
            spectrum = multisine(level, int(level * 100) + 7 * realisation)
            y = np.fft.irfft(lines_of(marched_at(spectrum, elements, chain(middle=(1000.0, 5.6)))) * PERIOD / 2, PERIOD)
            data = np.tile(np.vstack([np.fft.irfft(spectrum * PERIOD / 2, PERIOD), y]), 4)
            data[1:] += noise * level * rng.standard_normal((4, data.shape[1]))
            label = f"level {level:g} run {realisation}"
            out.append(Recording((FORCE, *SENSORS), data, RATE, period=PERIOD, label=label))
    return observe_all(out)


@pytest.mark.parametrize("held", [None, 0.0, 1.0])
def test_a_law_of_a_file_acts_as_the_file_says(held):
    """Beside a base that was identified, too: without the key it acts beside its spring."""
    base = ModalStructure((Mode(2.0, 0.01, {"2:x": 1.0, "3:x": -1.0}),), error=0.01)
    entry = {
        "id": "stick-slip", "place": {"kind": "joint", "id": "2", "to": "3"}, "variant": "x",
        "parameters": {"k_t": 400.0, "F_s": 6.0} | ({} if held is None else {"held": held}),
    }  # fmt: skip
    (known,) = known_laws(extend(base, [entry]))
    assert known.acting().stuck().held(np.array([400.0, 6.0]))[HELD] == (held or 0.0)
    sought = Lead(known.spot, "stick-slip", np.array([400.0, 6.0, *np.zeros(8)]), 0.0)
    assert sought.acting().stuck().held(np.array([400.0, 6.0]))[HELD] == 1.0


def test_sliders_are_named_and_measured_without_a_model(monkeypatch):
    observations = measured(MANY, (0.3, 3.0, 9.0, 25.0), 0.02, monkeypatch)
    known = {"k_t": (400.0, 0.03), "F_s": (6.0, 0.03), "spread": (0.8, 0.05)}
    base = identify(observations[0].frf, 40).structure
    assert base.error > 0
    found = diagnose(base, observations, places=PLACES)
    assert [(n.term.mechanism.id, str(n.place)) for n in found.named] == [("stick-slip", "joint 2-3")]
    told = found.as_dict()["mechanism"]["parameters"]
    assert told.pop("held") == {"value": 1.0, "std": 0.0, "unit": "1"}
    assert set(told) == set(known)
    for name, (value, close) in known.items():
        assert told[name]["value"] == pytest.approx(value, rel=close)
    assert found.extended_error[1] < 0.1 * found.base_error[1]
    assert "is taken to hold its spring" in found.summary
    assert "held" not in found.summary.split("(beside")[0].split("stick-slip")[1]
    entry = {
        "id": "stick-slip", "place": {"kind": "joint", "id": "2", "to": "3"}, "variant": found.named[0].term.variant,
        "parameters": {**{k: v["value"] for k, v in told.items()}, "held": 1.0},
    }  # fmt: skip
    again = diagnose(extend(base, [entry]), observations, places=PLACES)
    assert again.verdict in ("consistent", "parameters"), again.summary


@pytest.mark.parametrize("share", [1.58, 1.3])
def test_a_loop_whose_loading_yields_late_or_stiffens_is_named(monkeypatch, share):
    """No slider comes near it, and the base was identified while it acted: what it did to the modes goes back."""
    k, limit = 400.0, 0.02
    loop = Element("bouc-wen", joint_23(), (k, (2 - share) / limit, (1 - share) / limit, 1.0))
    observations = measured([loop], (0.3, 3.0, 9.0, 25.0), 0.02, monkeypatch)
    base = identify(observations[0].frf, 40).structure
    found = diagnose(base, observations, places=PLACES)
    assert [(n.term.mechanism.id, str(n.place)) for n in found.named] == [("hysteresis", "joint 2-3")], found.summary
    told = {p.name: v for p, v in zip(found.named[0].term.parameters, found.named[0].value, strict=True)}
    assert told["k"] == pytest.approx(k, rel=0.05)
    assert told["limit"] == pytest.approx(limit, rel=0.05)
    assert (told["n"], told["beta_share"]) == pytest.approx((1.0, share), abs=0.02)
    assert found.extended_error[1] < 0.1 * found.base_error[1]
    (again,) = found.named[0].term.mechanism.elements(found.named[0].term, [k, limit, 1.0, share, 0.0])
    assert again.parameters == pytest.approx(loop.parameters)
    entry = {
        "id": "hysteresis", "place": {"kind": "joint", "id": "2", "to": "3"}, "variant": found.named[0].term.variant,
        "parameters": {name: float(v) for name, v in told.items()},
    }  # fmt: skip
    (known,) = known_laws(extend(base, [entry]))
    assert known.mechanism == "stiffening"
