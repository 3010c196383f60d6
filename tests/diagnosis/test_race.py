"""The race of candidates: where the leader's mirror image is tried."""

from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest

from labnnum.diagnosis import race
from labnnum.diagnosis.diagnose import all_terms
from labnnum.diagnosis.engine import Engine
from labnnum.diagnosis.places import places_of
from labnnum.diagnosis.point import Point
from labnnum.diagnosis.task import Candidate
from labnnum.mechanisms.added_mass import AddedMass
from labnnum.mechanisms.ground_stiffness import GroundStiffness
from labnnum.recording import Channel
from labnnum.structures.chain import Chain, Link

FORCE = Channel("f", "force", "reference", "3", "x")
SENSORS = tuple(Channel(f"a{i}", "acceleration", "response", str(i), "x") for i in (1, 3, 4))
ENDS = [("1", "ground"), ("1", "2"), ("2", "3"), ("3", "4"), ("4", "ground")]


@dataclass(frozen=True)
class Ended:
    """What a race looks at of a fit."""

    point: Point


@pytest.mark.parametrize("mechanism", [AddedMass(), GroundStiffness()])
@pytest.mark.parametrize(("masses", "images"), [((1.0, 1.0, 1.0, 1.0), ["3"]), ((1.0, 1.0, 1.3, 1.6), [])])
def test_the_leader_is_tried_at_its_mirror_image_as_it_is(masses, images, mechanism):
    structure = Chain({str(i + 1): m for i, m in enumerate(masses)}, tuple(Link(*e, 1000.0, 4.0) for e in ENDS))
    engine = Engine(structure, SENSORS, (FORCE,), (2 * np.pi * 0.5, 2 * np.pi * 12))
    _, terms = all_terms(engine, places_of(engine, None), (mechanism,))
    term = next(t for t in terms if t.place.id == "2" and t.n)
    p = term.starts[0]
    start = engine.start()
    shifted = replace(start, shift=start.shift + 0.01)
    leader = Candidate((term.fitted,), Ended(replace(shifted, terms=p)), 1.0)
    entries = []
    ahead = SimpleNamespace(
        task=SimpleNamespace(engine=engine),
        before=Candidate((), Ended(start), 2.0),
        leader=leader,
        run=entries.extend,
    )
    race._mirrored(ahead, terms)
    assert [e.lead.term.place.id for e in entries] == images
    for e in entries:
        assert e.rung is None
        assert np.array_equal(e.lead.start, p)
        assert e.origin is not None
        assert np.array_equal(e.origin.fit.point.shift, shifted.shift)
