"""Laws without a name: their dynamic stiffness from the data line by line, whatever its size."""

from dataclasses import replace

import numpy as np
import pytest

from labnnum.diagnosis.diagnose import all_terms
from labnnum.diagnosis.engine import Engine
from labnnum.diagnosis.locate import imitated
from labnnum.diagnosis.places import places_of
from labnnum.diagnosis.scatter import Data
from labnnum.mechanisms.local_law import LocalLaw, PairLaw
from labnnum.recording import Channel
from tests.diagnosis.test_nonlinear import FORCE, chain

SENSORS = tuple(Channel(f"a{i}", "acceleration", "response", str(i), "x") for i in (1, 2, 3, 4))


def seen(mechanism, at, p):
    """An engine, what it reads with one law of these coefficients acting, and all terms of that law."""
    engine = Engine(chain(), SENSORS, (FORCE,), (2 * np.pi * 0.5, 2 * np.pi * 12))
    _, terms = all_terms(engine, places_of(engine, None), (mechanism,))
    term = next(t for t in terms if (t.place.id, t.place.to) == at)
    s = 2j * np.pi * np.linspace(0.5, 12, 300) + 0.05
    value = engine.response(replace(engine.start(), terms=np.asarray(p, float)), [term], s).value
    return engine, Data(s, value, 1e-3 * np.abs(value)), terms, term


@pytest.mark.parametrize("size", [0.1, 3.0])
def test_a_law_of_any_size_is_read_off_the_data(size):
    """A spring with loss and inertia three times the joint's own turns its stiffness round within the band."""
    p = np.zeros(9)
    p[:3] = 1000 * size, 100 * size, 500 * size
    engine, data, terms, own = seen(LocalLaw(), ("2", "3"), p)
    share, found = imitated(engine, data, engine.start(), own)
    assert share > 0.999
    at = own.groups[0].law.basis(data.s)
    assert found @ at == pytest.approx(p @ at, rel=0.05, abs=0.02 * np.abs(p @ at).max())
    others = [imitated(engine, data, engine.start(), t)[0] for t in terms if t.place != own.place]
    assert share > max(others)


def test_a_gyroscope_between_two_masses_is_a_skew_pair():
    skew = np.zeros(12)
    skew[5], skew[6] = 800.0, -800.0
    engine, data, terms, own = seen(PairLaw(), ("2", "3"), skew)
    share, found = imitated(engine, data, engine.start(), own)
    assert share > 0.999
    assert found[[5, 6]] == pytest.approx([800.0, -800.0], rel=0.05)
    assert np.abs(np.delete(found, [5, 6])).max() < 40.0
    assert share > max(imitated(engine, data, engine.start(), t)[0] for t in terms if t.place != own.place)
