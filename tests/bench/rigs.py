"""Rigs and a structure that the tests of whole runs share."""

import json

import numpy as np

from labnnum.errors import DeviceLostError
from labnnum.response import frf
from sessions.model import read_model
from sessions.rig import parse_rig


def chain_toml(masses, links, base=None):
    """model.toml of a chain: its masses by node, and its links as (node, node, stiffness, damping)."""
    lines = ["[structure]", 'kind = "chain"', *([] if base is None else [f"base = {json.dumps(base)}"])]
    for node, mass in masses.items():
        lines += ["[[structure.mass]]", f"node = {json.dumps(node)}", f"mass = {mass!r}"]
    for a, b, stiffness, damping in links:
        lines += ["[[structure.link]]", f"between = {json.dumps([a, b])}"]
        lines += [f"stiffness = {json.dumps(stiffness)}", f"damping = {damping!r}"]
    return "\n".join(["", *lines, ""])


def two_masses(base=None, first=8e5, damping=(80.0, 50.0)):
    """A chain of 2 kg and 1 kg on the ground; `first` may name a parameter."""
    links = [("1", "ground", first, damping[0]), ("1", "2", 5e5, damping[1])]
    return chain_toml({"1": 2.0, "2": 1.0}, links, base)


HAMMER = """
[device]
rate = 2048
block = 512
[[channel]]
name = "hammer"
role = "reference"
unit = "N"
sensitivity = 0.02
[[channel]]
name = "a2"
unit = "m/s^2"
sensitivity = 0.05
node = "2"
direction = "x"
[excitation]
kind = "hammer"
high = 400
[trigger]
level = 10
pre = 0.05
duration = 0.7
[plan]
points = ["1:x", "2:x"]
hits = 3
[simulated]
seed = 3
bits = 16
[simulated.hammer]
interval = 1.0
peak = 150
tip = "hard rubber"
[simulated.channel.a2]
noise = 0.02
"""

SHAKER = """
[device]
rate = 1024
block = 256
[[channel]]
name = "{name}"
role = "{role}"
unit = "{unit}"
sensitivity = 0.2
{place}
[[channel]]
name = "a2"
unit = "m/s^2"
sensitivity = 0.1
node = "2"
direction = "x"
[generator]
max_volts = 8.0
[excitation]
kind = "multisine"
low = 5
high = 350
levels = [0.5, 2.0]
settle = 0.5
period = 1024
periods = 4
drop_periods = 1
[safety]
ramp = 0.1
[simulated]
seed = 3
gain = 5.0
[simulated.channel.a2]
noise = 0.01
"""
FORCE = {"name": "force", "role": "reference", "unit": "N", "place": 'node = "1"\ndirection = "x"'}
BASE = {"name": "table", "role": "base", "unit": "m/s^2", "place": 'direction = "x"'}


def rig_of(folder, text, base=""):
    (folder / "model.toml").write_text(two_masses(base))
    path = folder / "rig.toml"
    path.write_text(text)
    return parse_rig(text, path)


LIVE = """
[device]
rate = 4096
block = 256
real_time = true
buffer = 0.5
[[channel]]
name = "hammer"
role = "reference"
unit = "N"
sensitivity = 0.02
[[channel]]
name = "a1"
unit = "m/s^2"
sensitivity = 0.01
node = "1"
direction = "x"
[trigger]
pre = 0.05
duration = 0.3
[plan]
points = ["1:x"]
hits = 3
[simulated.hammer]
tip = "rubber"
interval = 0.45
"""

AUDIO_RATE = 8000
AUDIO = f"""
[device]
kind = "audio"
name = "pulse"
rate = {AUDIO_RATE}
block = 512
latency = 0.2
channels = 4
[[channel]]
name = "f"
role = "reference"
unit = "N"
sensitivity = 0.01
full_scale = 10.0
node = "1"
direction = "x"
[[channel]]
name = "a1"
unit = "m/s^2"
sensitivity = 0.01
full_scale = 10.0
node = "1"
direction = "x"
[[channel]]
name = "a2"
unit = "m/s^2"
sensitivity = 0.01
full_scale = 10.0
node = "2"
direction = "x"
"""


def live_rig(folder, *changes, mass=1.0, stiffness=1e6, damping=60.0):
    """A hammer at one mass on a spring, in real time, for what looks on."""
    (folder / "model.toml").write_text(chain_toml({"1": mass}, [("1", "ground", stiffness, damping)]))
    path = folder / "rig.toml"
    path.write_text(_changed(LIVE, changes))
    return parse_rig(path.read_text(), path)


def hammer_rig(folder, *changes):
    return rig_of(folder, _changed(HAMMER, changes))


def shaker_rig(folder, *changes, place=FORCE):
    return rig_of(folder, _changed(SHAKER.format(**place), changes), "x" if place is BASE else "")


def _changed(text, changes):
    for old, new in changes:
        assert old in text, old
        text = text.replace(old, new)
    return text


def agreement(rig, found):
    """RMS of the standardised error against the simulated structure."""
    model = read_model(rig.beside("model.toml"))
    lines = (found.frequency > 8) & (found.frequency < 340)
    exact = frf(model.structure, model.structure.nominal, found.frequency[lines], found.outputs, found.inputs)
    z = np.abs(found.value[:, :, lines] - exact) / np.sqrt(found.variance[:, :, lines])
    return float(np.sqrt(np.mean(z**2)))


def replay_of(rig, days):
    """Devices that play one list of blocks at each attempt, and are lost at its end."""
    from contextlib import contextmanager

    from drivers.digitiser import Digitiser
    from sessions.devices import Devices

    class Day(Digitiser):
        paced = False
        rate = rig.rate
        n_channels = 2

        def __init__(self, blocks):
            self._blocks = iter(blocks)

        def open(self): ...

        def start(self): ...

        def stop(self): ...

        def read(self, timeout=5.0):
            block = next(self._blocks, None)
            if block is None:
                raise DeviceLostError("the day is over")
            return block

    left = iter(days)

    @contextmanager
    def played(rig, item, attempt=0):
        yield Devices(Day(next(left)))

    return played
