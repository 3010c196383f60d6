"""Laws without a name: their dynamic stiffness from the data line by line, whatever its size."""

from dataclasses import replace

import numpy as np
import pytest

from labnnum.diagnosis.diagnose import all_terms
from labnnum.diagnosis.engine import Engine
from labnnum.diagnosis.locate import imitated
from labnnum.diagnosis.places import places_of
from labnnum.diagnosis.scatter import Data
from labnnum.mechanisms.local_law import FreeLaw, LocalLaw, PairLaw
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


class _Delayed:
    """A spring that answers late beside a dashpot, as a stiffness to be acted with through a law's own columns."""

    def __init__(self, k, tau):
        self.k, self.tau = k, tau

    def at(self, s):
        return self.k * np.exp(-s * self.tau) + 1.05 * self.k * self.tau * s


def test_a_spring_that_answers_late_is_where_a_free_law_says():
    """Its stiffness turns round several times in the band, which no smooth law follows."""
    late = _Delayed(400.0, 0.12)
    engine, data, smooth, own = seen(LocalLaw(), ("2", "3"), np.zeros(9))
    law = own.groups[0].law
    fine = 2j * np.pi * np.linspace(0.5, 12, 2000)
    _, free = all_terms(engine, places_of(engine, None), (FreeLaw(),))
    mine = next(t for t in free if t.place == own.place and t.variant == own.variant)

    def fitted(basis):
        rows, wanted = basis(fine).T, late.at(fine)
        stacked, both = np.vstack([rows.real, rows.imag]), np.concatenate([wanted.real, wanted.imag])
        p = np.linalg.lstsq(stacked, both, rcond=None)[0]
        return p, float(np.max(np.abs(p @ basis(fine) - wanted)) / late.k)

    exact, missed = fitted(mine.groups[0].law.basis)
    assert missed < 0.02 < 0.2 < fitted(law.basis)[1]
    value = engine.response(replace(engine.start(), terms=exact), [mine], data.s).value
    seen_late = Data(data.s, value, 1e-3 * np.abs(value))
    shares = {str(t.place): imitated(engine, seen_late, engine.start(), t)[0] for t in free}
    assert max(shares, key=lambda place: shares[place]) == str(mine.place)
    assert shares[str(mine.place)] > 0.99
    assert shares[str(mine.place)] > max(imitated(engine, seen_late, engine.start(), t)[0] for t in smooth)


def test_a_free_law_holds_a_smooth_one():
    """Its first coefficients are those of the smooth law, so that a fit may go on from there."""
    engine, data, _, own = seen(LocalLaw(), ("2", "3"), np.zeros(9))
    _, free = all_terms(engine, places_of(engine, None), (FreeLaw(),))
    mine = next(t for t in free if t.place == own.place and t.variant == own.variant)
    s = data.s
    np.testing.assert_allclose(mine.groups[0].law.basis(s)[:9], own.groups[0].law.basis(s), rtol=1e-12)
    assert np.all(mine.stiffness(s, np.zeros(mine.n)) == 0)
