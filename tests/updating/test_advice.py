from dataclasses import replace

import numpy as np
import pytest

from labnnum.bands import Band
from labnnum.errors import ModelError
from labnnum.response import modes
from labnnum.structures.chain import GROUND, Chain, Link
from labnnum.structures.examples import EXAMPLES, force_at, motion_of
from labnnum.updating.advice import suggestions
from labnnum.updating.batch import FrfBatch
from labnnum.updating.many import bound_deviations

from .cases import truck

STRUCTURE, OUTPUTS, INPUTS, BANDS = truck()


def test_what_is_promised_is_what_the_bound_says():
    found = suggestions(STRUCTURE, STRUCTURE.nominal, BANDS, OUTPUTS, INPUTS)
    lines = np.unique(np.concatenate([np.linspace(b.low, b.high, 40) for b in BANDS]))
    sensor = next(s for s in found if s.kind == "sensor")
    both = (*OUTPUTS, motion_of(sensor.what.split(":")[0]))
    with_it, without = (
        bound_deviations(FrfBatch.of(STRUCTURE, lines, o, INPUTS), STRUCTURE.nominal, 0.01)[0] for o in (both, OUTPUTS)
    )
    assert np.allclose(sensor.deviation, with_it / without, rtol=1e-3)
    assert (sensor.deviation <= 1 + 1e-9).all()


def test_the_band_of_the_mode_that_shows_a_parameter_comes_first():
    links = (Link("1", GROUND, "k1", 1.0), Link("2", GROUND, "k2", 1.0), Link("1", "2", 10.0))
    parameters = tuple(replace(p, name=n) for p, n in zip(STRUCTURE.parameters[1:3], ("k1", "k2"), strict=True))
    parameters = tuple(replace(p, nominal=v, lower=0.5 * v, upper=1.5 * v, std=None)
                       for p, v in zip(parameters, (1e4, 2e4), strict=True))  # fmt: skip
    pair = Chain({"1": 1.0, "2": 1.0}, links, parameters)
    found = suggestions(pair, pair.nominal, (Band(14.0, 18.0),), (motion_of("1"),), (force_at("1"),))
    assert found[0].deviation[1] < 0.2  # k2 is all but unseen at node 1 about the first mode
    band = next(s for s in found if s.kind == "band")
    low, high = (float(w) for w in band.what.removesuffix(" Hz").split(" to "))
    assert low < np.sqrt(2e4) / (2 * np.pi) < high


def test_suggestions_are_ranked_and_few():
    e = EXAMPLES["kabe-damped"]()
    found = suggestions(e.structure, e.structure.nominal, e.bands, e.outputs, e.inputs, count=3)
    assert len(found) == 3
    score = [np.log(s.deviation).sum() for s in found]
    assert score == sorted(score)
    assert all(s.gain > 1 for s in found)


def test_bands_are_proposed_as_high_as_the_bench_measures():
    low = (Band(0.2, 0.6),)
    natural = modes(STRUCTURE, STRUCTURE.nominal).frequency
    for highest, expected in ((float(natural[0]), 0), (1.06 * natural[1], 2), (100.0, 3)):
        found = suggestions(STRUCTURE, STRUCTURE.nominal, low, OUTPUTS, INPUTS, highest=highest, count=9)
        assert sum(s.kind == "band" for s in found) == expected


def test_on_a_driven_beam_only_places_that_such_a_sensor_measures_are_proposed():
    e = EXAMPLES["beam"]()
    found = suggestions(e.structure, e.structure.nominal, e.bands, e.outputs, e.inputs, count=20)
    sensors = [s.what for s in found if s.kind == "sensor"]
    assert sensors
    assert all(s.endswith(":z") for s in sensors)


def test_without_parameters_there_is_nothing_to_learn():
    fixed = Chain({"1": 1.0}, (Link("1", GROUND, 1.0),))
    with pytest.raises(ModelError, match="no free parameter"):
        suggestions(fixed, [], (Band(0.1, 0.2),), (motion_of("1"),), (force_at("1"),))
