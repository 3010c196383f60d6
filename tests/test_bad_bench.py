"""Rigs and simulations that cannot be: one line, status 2, and no empty session left behind."""

import re
import sys

import pytest

from sessions import cli
from sessions.starters import write_starter


def edited(name, old, new):
    def prepare(folder):
        text = (folder / name).read_text()
        assert old in text
        (folder / name).write_text(text.replace(old, new, 1))

    return prepare


def rig(old, new):
    return edited("rig.toml", old, new)


MEASURE = "measure rig.toml -o out.h5"
SIMULATE = "simulate model.toml -o out.h5"


def nothing(folder):
    """The starter as it is."""


TABLE = {
    "misspelt table": (rig("[device]", "[devise]"), MEASURE, r"device is missing; did you mean it by 'devise'"),
    "misspelt key": (rig("rate = 2560", "rat = 2560"), MEASURE, r"device\.rate is missing; did you mean it by 'rat'"),
    "key that nobody reads": (
        rig("ramp = 0.5", "highest_force = 5\nramp = 0.5"), MEASURE,
        r"rig\.toml: safety\.highest_force is no key; there are ramp, overload, lost",
    ),
    "window": (rig('"hann"', '"han"'), MEASURE, r"processing\.window: .*window 'han' is not one of boxcar, hann"),
    "no second segment": (rig("segment = 16384", "segment = 163840000"), MEASURE, r"processing\.segment: two segments"),
    "no such model": (rig('"model.toml"', '"mdel.toml"'), MEASURE, r"mdel\.toml: no such file"),
    "no such node": (rig('node = "3"', 'node = "33"'), MEASURE, r"no degree of freedom '33:z'"),
    "no such parameter": (
        rig("nominal value\n", "nominal value\nm_ac = 0.01\n"), MEASURE,
        r"simulated\.parameters\.m_ac: the model has m_acc, I_acc",
    ),
    "parameter that is no number": (
        rig("nominal value\n", "nominal value\nm_acc = nan\n"), MEASURE,
        r"simulated\.parameters\.m_acc: nan is no finite number",
    ),
    "session's name": (nothing, "measure rig.toml -o out.txt", r"out\.txt: a session is an \.h5 file"),
    "infinite bound": (edited("model.toml", "upper = 2.5", "upper = inf"), "modes model.toml", r"\.upper: .*finite"),
    "infinite sensitivity": (
        rig("sensitivity = 0.0102", "sensitivity = inf"), MEASURE,
        r"channel\[1\]: .*sensitivity inf must be a finite number",
    ),
    "no response": (rig('role = "response"', 'role = "monitor"'), MEASURE, r"channel: none has the role response"),
    "noise": (nothing, SIMULATE + " --noise=-1", r"--noise -1: expected 0 or more"),
    "level": (nothing, SIMULATE + " --level nan", r"--level nan: expected a positive number"),
    "rate": (nothing, SIMULATE + " --rate 0", r"--rate 0: expected a positive number"),
    "bits": (nothing, SIMULATE + " --bits 64", r"--bits 64: expected 1 to 32"),
    "duration": (nothing, SIMULATE + " --duration 0", r"--duration"),
    "band": (nothing, SIMULATE + " --low 500 --high 100", r"low 500 Hz must be below high 100 Hz"),
    "response": (nothing, SIMULATE + " --response 99:z", r"no degree of freedom '99:z'"),
    "tip": (nothing, SIMULATE + " --excitation hammer --drive 7:z --tip foam", r"hammer tip 'foam' is not one of"),
    "excitation": (nothing, SIMULATE + " --excitation loud", r"--excitation 'loud': expected one of random"),
    "no channel to calibrate": (nothing, "calibrate rig.toml", r"name the channel to calibrate, one of base, a3"),
    "no time to calibrate": (nothing, "calibrate rig.toml a3 --seconds=-1", r"--seconds -1: expected a positive"),
    "training noise": (nothing, "train model.toml -o u.h5 --noise=-1", r"--noise -1: expected 0 or more"),
    "training centres": (nothing, "train model.toml -o u.h5 --centres 0", r"--centres 0: expected 1 or more"),
    "training seed": (nothing, "train model.toml -o u.h5 --seed=-1", r"--seed -1: expected 0 or more"),
    "updater's name": (nothing, "train model.toml -o u.txt", r"u\.txt: an updater is an \.h5 file; call it u\.h5"),
    "floor": (nothing, "update x.h5 -m model.toml --floor=-1", r"--floor -1: expected 0 or more"),
    "diagnosis into a file": (nothing, "diagnose x.h5 -m model.toml -o rig.toml", r"rig\.toml: is a file; --out names"),
}  # fmt: skip


@pytest.mark.parametrize("case", TABLE)
def test_bad_bench(case, tmp_path, monkeypatch, capsys):
    prepare, line, expected = TABLE[case]
    write_starter(tmp_path, "simulated", "beam")
    prepare(tmp_path)
    monkeypatch.chdir(tmp_path)
    before = {p.name: p.read_bytes() for p in tmp_path.iterdir()}
    monkeypatch.setattr(sys, "argv", ["labnnum", *line.split()])
    with pytest.raises(SystemExit) as end:
        cli.main()
    shown = capsys.readouterr()
    said = shown.err.strip().splitlines()[-1]
    assert end.value.code == 2, shown.err
    assert said.startswith("labnnum: ")
    assert re.search(expected, said), said
    assert {p.name: p.read_bytes() for p in tmp_path.iterdir()} == before
