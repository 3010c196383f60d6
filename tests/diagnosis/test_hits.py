"""Offsets of hits: what a structure on soft cords still does at the end of a record is no offset."""

import numpy as np
import pytest

from labnnum.diagnosis.engine import Engine
from labnnum.diagnosis.hits import without_offset
from labnnum.diagnosis.objective import Problem
from labnnum.diagnosis.observe import observe_hits
from labnnum.diagnosis.scatter import Data, Scatter
from labnnum.diagnosis.task import measured
from labnnum.recording import Channel, Recording
from tests.diagnosis.test_nonlinear import FORCE, chain

SENSORS = tuple(Channel(f"a{i}", "acceleration", "response", str(i), "x") for i in (1, 2, 3, 4))

RATE = 1000.0
N = 3000
START = 60
CHANNELS = (
    Channel("force", "force", "reference", "a", "y"),
    Channel("v", "velocity", "response", "b", "y"),
)


def _blow() -> np.ndarray:
    force = np.zeros(N)
    force[START : START + 9] = np.sin(np.pi * (np.arange(9) + 1) / 10) ** 2
    return force


def _velocity(force: np.ndarray) -> np.ndarray:
    """Velocity of a rigid mass on soft cords (0.3 Hz, hardly damped) that also bends (40 Hz), both masses 1."""
    from scipy.signal import lfilter

    out = np.zeros(N)
    for f, zeta in ((0.3, 0.02), (40.0, 0.01)):
        w = 2 * np.pi * f
        pole = np.exp((-zeta * w + 1j * w * np.sqrt(1 - zeta**2)) / RATE)
        out += np.real(lfilter([1.0], [1.0, -pole], force.astype(complex))) / RATE
    return out


def test_offset_is_told_before_the_blow_where_the_end_still_moves():
    force = _blow()
    response = _velocity(force)
    x = np.vstack([force + 0.01, response - 0.2])
    left = without_offset(x, 0)
    assert np.abs(left - np.vstack([force, response])).max() < 1e-12
    still_moving = np.median(response[-N // 10 :])
    assert abs(still_moving) > 0.1 * np.abs(response).max()


def test_offset_is_told_at_the_end_where_nothing_comes_before_the_blow():
    force = np.roll(_blow(), -START)
    response = np.exp(-np.arange(N) / 40.0)
    left = without_offset(np.vstack([force + 0.5, response + 0.3]), 0)
    assert np.abs(left - np.vstack([force, response])).max() < 1e-9


@pytest.mark.parametrize("quiet", [28, 29, 30, 31])
def test_what_a_filter_lets_ring_before_the_blow_is_no_offset(quiet):
    """Before a blow that a sharp filter has seen samples alternate, and grow towards it."""
    at = np.arange(N) - quiet
    ringing = 0.0002 * (-1.0) ** at / np.maximum(np.abs(at) + 0.5, 1)
    force = np.roll(_blow(), quiet - START) + np.where(at < 0, ringing, 0.0)
    response = _velocity(np.roll(_blow(), quiet - START)) + np.where(at < 0, ringing, 0.0)
    left = without_offset(np.vstack([force + 0.5, response + 0.3]), 0)
    assert np.abs(left - np.vstack([force, response])).max() < 0.03 * np.abs(ringing[:quiet]).mean()


def test_an_offset_that_was_not_taken_off_begins_with_the_record():
    """It is an ordinary error of a hit, and explains a step at the record's start, not one at the blow."""
    engine = Engine(chain(), SENSORS, (FORCE,), (2 * np.pi * 0.5, 2 * np.pi * 12))
    s = 0.05 + 2j * np.pi * np.linspace(0.5, 12, 300)
    value = engine.response(engine.start(), (), s).value
    step = 0.05 * np.median(np.abs(value), axis=2, keepdims=True) * np.exp(0.2 * (s - 0.05)) * np.abs(s[0]) / s
    sigma = np.full(value.shape, 1e-3) * np.median(np.abs(value), axis=2, keepdims=True)
    x = engine.start().vector()
    left = {
        lead: Problem(engine, Data(s, value + step, sigma, lead), (), Scatter()).normal(x).objective
        for lead in (0.0, 0.2)
    }
    assert left[0.2] < 5.0
    assert left[0.2] < 0.2 * left[0.0]


def test_how_long_records_begin_before_the_blow_is_told():
    force = _blow()
    seen = observe_hits([Recording(CHANNELS, np.vstack([force, _velocity(force)]), RATE)]).frf
    assert seen.settings["lead"] == pytest.approx((START + 4) / RATE)
    assert measured(seen).lead == seen.settings["lead"]


@pytest.mark.parametrize("offset", [0.0, 0.4])
def test_frf_of_hits_on_soft_cords_is_that_of_the_structure(offset):
    """The FRF of hits, seen through the window's shift, against the model's own."""
    force = _blow()
    data = np.vstack([force, _velocity(force) + offset])
    seen = observe_hits([Recording(CHANNELS, data, RATE)]).frf
    s = seen.settings["window_decay"] + 1j * seen.omega
    z = np.exp(s / RATE)
    exact = np.zeros(s.size, complex)
    for f, zeta in ((0.3, 0.02), (40.0, 0.01)):
        w = 2 * np.pi * f
        for sign in (1, -1):
            pole = np.exp((-zeta * w + sign * 1j * w * np.sqrt(1 - zeta**2)) / RATE)
            exact += 0.5 / (1 - pole / z) / RATE
    band = seen.frequency < 100
    error = np.abs(seen.value[0, 0] - exact)[band]
    assert np.sqrt(np.mean(error**2)) < 0.01 * np.sqrt(np.mean(np.abs(exact[band]) ** 2))
