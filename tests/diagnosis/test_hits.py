"""Offsets of hits: what a structure on soft cords still does at the end of a record is no offset."""

import numpy as np
import pytest

from labnnum.diagnosis.hits import without_offset
from labnnum.diagnosis.observe import observe_hits
from labnnum.recording import Channel, Recording

RATE = 1000.0
N = 3000
START = 60


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


@pytest.mark.parametrize("offset", [0.0, 0.4])
def test_frf_of_hits_on_soft_cords_is_that_of_the_structure(offset):
    """The FRF of hits, seen through the window's shift, against the model's own."""
    force = _blow()
    data = np.vstack([force, _velocity(force) + offset])
    channels = (
        Channel("force", "force", "reference", "a", "y"),
        Channel("v", "velocity", "response", "b", "y"),
    )
    seen = observe_hits([Recording(channels, data, RATE)]).frf
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
