"""labnnum devices: names as rig.toml takes them; no PortAudio is said and is no failure."""

import json

from typer.testing import CliRunner

from labnnum.errors import DeviceNotFoundError
from sessions.cli import app

FOUND = {"input": [(2, "Scarlett 18i20 (ALSA)", 18, 48000.0)], "output": []}


def test_devices_are_listed(monkeypatch):
    monkeypatch.setattr("drivers.audio.devices", FOUND.__getitem__)
    monkeypatch.setattr("drivers.transport.ports", lambda: ("/dev/ttyUSB0",))
    said = CliRunner().invoke(app, ["devices"]).stdout
    assert "Scarlett 18i20 (ALSA)" in said
    assert "audio outputs: none" in said
    assert "serial ports: /dev/ttyUSB0" in said
    assert "audio, scpi, feeltech, junce" in said
    told = json.loads(CliRunner().invoke(app, ["devices", "--json"]).stdout)
    assert told["inputs"] == [{"number": 2, "name": "Scarlett 18i20 (ALSA)", "channels": 18, "rate": 48000.0}]
    assert told["portaudio"] == "found"


def test_a_computer_without_portaudio_is_told_so(monkeypatch):
    def missing(_):
        raise DeviceNotFoundError("PortAudio cannot be loaded")

    monkeypatch.setattr("drivers.audio.devices", missing)
    done = CliRunner().invoke(app, ["devices"])
    assert done.exit_code == 0
    assert "audio: PortAudio cannot be loaded" in done.stdout
