"""Models and measurements that do not fit: one line, status 2, nothing written."""

import re
import sys

import numpy as np
import pytest

from labnnum.frf import Frf
from labnnum.recording import Channel
from sessions import cli
from sessions.store import create_session

MODEL = """
[structure]
kind = "chain"
direction = "x"
[[structure.mass]]
node = "1"
mass = 1.0
[[structure.mass]]
node = "2"
mass = 1.0
[[structure.link]]
between = ["1", "ground"]
stiffness = "k"
damping = 1.0
[[structure.link]]
between = ["1", "2"]
stiffness = 1e4
damping = 1.0
[[parameter]]
name = "k"
nominal = 1e4
lower = 5e3
upper = 2e4
unit = "N/m"
[[band]]
low = 5.0
high = 15.0
[[band]]
low = 20.0
high = 30.0
"""
LOOSE = MODEL.replace('node = "2"\nmass = 1.0', 'node = "2"\nmass = 0.0').replace("1e4\ndamping = 1.0", "0.0")
FREQUENCY = np.arange(1.0, 40.0, 0.25)


def measured(folder, node="2", **change):
    """A session with an FRF whose response stands at `node`."""
    omega = 2 * np.pi * FREQUENCY
    value = (1 / (1e4 - omega**2 + 1j * omega))[None, None]
    channels = (Channel("a", "acceleration", "response", node, "x"),), (Channel("f", "force", "reference", "1", "x"),)
    with create_session(folder / "case.h5") as made:
        made.add_frf(Frf(FREQUENCY, value, *channels, variance=np.abs(value) ** 2 * 1e-4, **change))


def both(model, node="2"):
    def prepare(folder):
        measured(folder, node)
        (folder / "model.toml").write_text(model)

    return prepare


UPDATE = "update case.h5 --model model.toml"
TRAIN = "train model.toml --frf case.h5 --samples 20 -o out.h5"

TABLE = {
    "no model": (lambda f: measured(f), UPDATE, r"model\.toml: no such file"),
    "no TOML": (both("structure"), UPDATE, r"model\.toml: is not TOML"),
    "misspelt key": (both(MODEL.replace("direction", "direktion")), UPDATE, r"model\.toml: structure.*direktion"),
    "sensors missing in the model": (both(MODEL, "9"), UPDATE, r"no degree of freedom '9:x'; it has 1:x, 2:x"),
    "sensors missing for training": (both(MODEL, "9"), TRAIN, r"no degree of freedom '9:x'"),
    "overlapping bands": (
        both(MODEL.replace("low = 20.0", "low = 12.0")), UPDATE, r"bands \[5, 15\] and \[12, 30\] Hz overlap",
    ),
    "empty band": (both(MODEL.replace("high = 15.0", "high = 5.0")), UPDATE, r"band \[5, 5\] Hz is empty"),
    "band outside the data": (both(MODEL.replace("high = 30.0", "high = 90.0")), TRAIN, r"reaches outside the data"),
    "singular": (both(LOOSE), UPDATE, r"singular"),
    "unstable": (both(MODEL.replace("stiffness = 1e4", "stiffness = -3e4")), UPDATE, r"unstable"),
    "outside its bounds": (both(MODEL.replace("nominal = 1e4", "nominal = 1e5")), UPDATE, r"parameter 'k': needs"),
    "no updater": (both(MODEL), "update case.h5 --updater none.h5", r"none\.h5"),
    "a session as updater": (both(MODEL), "update case.h5 --updater case.h5", r"case\.h5: .*updater"),
    "no FRF of that name": (both(MODEL), UPDATE + " --frf results/frf/0007", r"results/frf/0007"),
}  # fmt: skip


@pytest.mark.parametrize("case", TABLE)
def test_bad_model(case, tmp_path, monkeypatch, capsys):
    prepare, line, expected = TABLE[case]
    prepare(tmp_path)
    monkeypatch.chdir(tmp_path)
    before = {p.name: p.read_bytes() for p in tmp_path.iterdir()}
    monkeypatch.setattr(sys, "argv", ["labnnum", *line.split()])
    with pytest.raises(SystemExit) as end:
        cli.main()
    shown = capsys.readouterr()
    assert end.value.code == 2, shown.err
    assert shown.out == ""
    assert len([line for line in shown.err.splitlines() if line]) == 1, shown.err
    assert re.search(expected, shown.err), shown.err
    assert {p.name: p.read_bytes() for p in tmp_path.iterdir()} == before
