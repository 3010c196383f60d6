"""What a diagnosis has marched is counted the same everywhere, and what it leaves out depends on nothing else."""

from types import SimpleNamespace

import numpy as np
import pytest

from labnnum.diagnosis.engine import Engine
from labnnum.diagnosis.nonlinear import effort
from labnnum.diagnosis.nonlinear.beside import ends_of
from labnnum.diagnosis.nonlinear.chain import twins
from labnnum.diagnosis.nonlinear.effort import counted, exhausted, marched, spent, tired, weary
from labnnum.diagnosis.nonlinear.fitting import _tried
from labnnum.diagnosis.nonlinear.locate import Spot
from labnnum.errors import ModelError
from labnnum.mechanisms.base import Place
from labnnum.structures import Chain
from labnnum.structures.chain import Link
from tests.diagnosis.test_nonlinear import FORCE, OUTPUTS, chain, multisine, steady


def test_marches_are_counted_where_somebody_counts():
    structure, spectrum = chain(), multisine(25.0, 1)
    base, solver, parameters = steady(structure, spectrum, "cubic", (3e4,))
    r = base.at(base.start())

    def settled():
        solver.settle(r, parameters, solver.guess(r, np.zeros((solver.n, 1))), 25)
        return spent()

    assert settled() == 0.0
    with counted():
        first = settled()
        with counted():
            assert settled() == pytest.approx(first, rel=1e-12)
        assert first > solver.n * effort.STEP * effort.UNIT
        assert settled() == pytest.approx(2 * first, rel=1e-12)
    assert spent() == 0.0


def test_a_search_is_tired_once_it_has_marched_for_long():
    assert not tired()
    with counted():
        marched(int(0.9 * effort.LONG / (effort.STEP * effort.UNIT)), 5, 1, 0)
        assert not tired()
        marched(int(0.2 * effort.LONG / (effort.STEP * effort.UNIT)), 5, 1, 0)
        assert tired()
    assert not tired()


def test_searches_that_count_anew_add_up_to_one_diagnosis():
    part = int(0.6 * effort.LONG / (effort.STEP * effort.UNIT))
    with counted():
        for _ in range(int(effort.WHOLE / (0.6 * effort.LONG))):
            with counted():
                marched(part, 5, 1, 0)
                assert not tired()
                assert not exhausted()
        marched(part, 5, 1, 0)
        assert not tired()  # one search may end what it began
        assert not weary()
        assert exhausted()
        with counted():
            assert exhausted()
    with counted():
        assert not exhausted()


@pytest.mark.parametrize("symmetric", [True, False])
def test_a_mirror_image_is_told_from_what_only_resembles(symmetric):
    masses = (1.0, 1.0, 1.0, 1.0) if symmetric else (1.0, 1.0, 1.3, 1.6)
    ends = [("1", "ground"), ("1", "2"), ("2", "3"), ("3", "4"), ("4", "ground")]
    structure = Chain({str(i + 1): m for i, m in enumerate(masses)}, tuple(Link(*e, 1000.0, 4.0) for e in ends))
    engine = Engine(structure, OUTPUTS, (FORCE,), (2 * np.pi * 0.5, 2 * np.pi * 12))
    spots = [Spot(Place("ground", str(i + 1)), "x", np.eye(4)[i]) for i in range(4)]
    found = twins(SimpleNamespace(engine=engine), spots[1], spots)
    assert [s.place.id for s in found] == (["3"] if symmetric else [])


@pytest.mark.parametrize("where", ["settle", "value"])
def test_a_step_to_where_the_structure_is_none_is_a_step_too_far(where):
    def none_below_zero(step, made):
        def called(x, *_):
            if step == where and x[0] < 0:
                raise ModelError("the model is singular")
            return made

        return called

    joint = SimpleNamespace(settle=none_below_zero("settle", [None]), value=none_below_zero("value", 3.0))
    assert _tried(joint, np.array([1.0]), [None], np.zeros(0)) == (3.0, [None])
    assert _tried(joint, np.array([-1.0]), [None], np.zeros(0)) == (np.inf, [None])


@pytest.mark.parametrize(
    ("one", "other", "same"),
    [
        (Place("element", "6", "7"), Place("joint", "7", "6"), True),
        (Place("node", "4"), Place("ground", "4"), True),
        (Place("ground", "4"), Place("ground", "5"), False),
    ],
)
def test_a_mechanism_of_the_quietest_level_has_the_share_of_distortion_of_its_place(one, other, same):
    assert (ends_of(one) == ends_of(other)) is same
