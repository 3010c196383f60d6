"""Where a winning law is tried again: where its own base says that the distortion comes from."""

from types import SimpleNamespace

import numpy as np
import pytest

from labnnum.diagnosis.nonlinear import chain
from labnnum.diagnosis.nonlinear.locate import Spot
from labnnum.mechanisms.base import Place

SPOTS = [Spot(Place("ground", str(i)), "x", np.eye(5)[i]) for i in range(5)]


def tried(i, cost, x):
    made = SimpleNamespace(data_part=cost, count=100, x=x)
    return SimpleNamespace(spot=SPOTS[i], mechanism="stick-slip", cost=cost, made=made, simulated=True, named=True)


@pytest.mark.parametrize(("rival", "asked"), [(2000.0, [["1"], ["3", "4"]]), (150.0, [["1"]])])
def test_a_law_that_leaves_far_more_than_noise_is_tried_where_its_base_finds_the_force(monkeypatch, rival, asked):
    calls, bases = [], []

    def at_places(found, best, spots, scatter):
        calls.append([s.place.id for s in spots])
        return [tried(1, rival, "rival")] if spots and spots[0] is SPOTS[1] else [tried(3, 90.0, "right")]

    def looked(plain, x, spots):
        bases.append(x)
        return [SimpleNamespace(spot=s, share=0.9) for s in (SPOTS[0], SPOTS[1], SPOTS[3], SPOTS[4])], []

    bench = SimpleNamespace(on=lambda lines: SimpleNamespace(joint=lambda laws: None))
    monkeypatch.setattr(chain, "Bench", lambda *args: bench)
    monkeypatch.setattr(chain, "twins", lambda found, spot, every: [])
    monkeypatch.setattr(chain, "at_places", at_places)
    monkeypatch.setattr(chain, "looked", looked)
    monkeypatch.setattr(chain, "nearest", lambda found: found)
    best = tried(0, 3000.0, "best")
    recovered = [SimpleNamespace(spot=s, gain=g) for s, g in zip(SPOTS, (10.0, 9.0, 1.0, 1.0, 1.0), strict=True)]
    found = SimpleNamespace(best=best, tried=[best], recovered=recovered, engine=None, point=None, runs=())
    made = chain.rivals(found, SPOTS, None)
    assert calls == asked
    assert bases == (["rival"] if len(asked) > 1 else [])
    assert [t.spot.place.id for t in made] == [a[0] for a in asked]
