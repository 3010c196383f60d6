"""Rigs and a structure that the tests of whole runs share."""

import numpy as np

from labnnum.errors import DeviceLostError
from labnnum.response import frf
from sessions.model import read_model
from sessions.rig import parse_rig

MODEL = """
[structure]
kind = "chain"
base = "{base}"
[[structure.mass]]
node = "1"
mass = 2.0
[[structure.mass]]
node = "2"
mass = 1.0
[[structure.link]]
between = ["1", "ground"]
stiffness = 8e5
damping = 80.0
[[structure.link]]
between = ["1", "2"]
stiffness = 5e5
damping = 50.0
"""

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
    (folder / "model.toml").write_text(MODEL.format(base=base))
    path = folder / "rig.toml"
    path.write_text(text)
    return parse_rig(text, path)


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
