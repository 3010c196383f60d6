"""A sound server for the tests that need one; they skip, with the reason, where none can run."""

import sys

import pytest

from drivers.simulated.sound_server import SoundServer

from .rigs import AUDIO_RATE

LACKING = SoundServer.missing() if sys.platform == "linux" else "null sinks are PulseAudio's, on Linux"


@pytest.fixture(scope="module")
def server():
    if LACKING:
        pytest.skip(LACKING)
    with SoundServer(rate=AUDIO_RATE) as running:
        yield running


@pytest.fixture
def sound(server, monkeypatch):
    """This process plays into the drive and records the answer."""
    for key, value in server.environment("drive", "answer").items():
        monkeypatch.setenv(key, value)
    return server


@pytest.fixture
def echo(server, monkeypatch):
    """This process records what it plays."""
    for key, value in server.environment("answer", "answer").items():
        monkeypatch.setenv(key, value)
    return server
