"""Whole ways through the command line: in, out and in again."""

import json
import sys

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from sessions import cli
from sessions.exchange import load_frf, load_recordings, read_any
from sessions.store import open_session

CHANNELS = """
sample_rate = 1000
serial = "77"
[[channel]]
name = "f"
quantity = "force"
unit = "N"
role = "reference"
node = "1:z"
[[channel]]
name = "a"
unit = "g"
node = 2
direction = "-z"
"""


@pytest.fixture
def command(monkeypatch, capsys, tmp_path):
    monkeypatch.chdir(tmp_path)

    def run(line):
        monkeypatch.setattr(sys, "argv", ["labnnum", *line.split()])
        with pytest.raises(SystemExit) as end:
            cli.main()
        shown = capsys.readouterr()
        assert not end.value.code, shown.err
        return shown

    return run


@pytest.fixture
def case(tmp_path):
    rng = np.random.default_rng(1)
    for k in (1, 2):
        f = rng.normal(size=3000).astype("f4")
        np.savez(tmp_path / f"case_run0{k}.npz", f=f, a=np.convolve(f, [1, -0.5, 0.2])[:3000].astype("f4"))
    (tmp_path / "channels.toml").write_text(CHANNELS)
    (tmp_path / "model.toml").write_text("[structure]\n")


def test_import_tells_what_it_did_and_keeps_where_it_came_from(command, case, tmp_path):
    shown = command("import case_run01.npz case_run02.npz -o case.h5 --model model.toml --json")
    said = json.loads(shown.out)
    assert [run["samples"] for run in said["runs"]] == [3000, 3000]
    assert "serial means nothing here" in shown.err
    with open_session(tmp_path / "case.h5") as session:
        first = session.runs[0]
        assert session.model_text == "[structure]\n"
        assert [c.channel.dof for c in first.stored] == ["1:z", "2:z"]
        assert first.stored[1].raw_unit == "g"
        assert set(first.info["files"]) == {"case_run01.npz", "case_run02.npz"}
        assert first.info["channels_toml"] == CHANNELS
        assert first.raw().dtype == "f4"
        stored = session.recordings()
    straight = load_recordings(sorted(tmp_path.glob("*.npz")))
    for one, two in zip(stored, straight, strict=True):
        assert_array_equal(one.data, two.data)
        assert one.channels == two.channels


@pytest.mark.parametrize("suffix", ["npz", "mat", "csv", "wav", "uff"])
def test_recordings_go_out_and_come_in_again(command, case, tmp_path, suffix):
    command("import case_run01.npz -o case.h5")
    (tmp_path / "out").mkdir()
    shown = command(f"export case.h5 out/case.{suffix} --json")
    assert f"out/case.{suffix}" in json.loads(shown.out)["files"]
    command(f"import out/case.{suffix} -o again.h5")
    (before,), (after,) = read_any("case.h5"), read_any("again.h5")
    assert_array_equal(after.data, before.data)
    for one, two in zip(before.channels, after.channels, strict=True):
        assert (one.name, one.quantity, one.role, one.dof, one.sign) == (
            two.name, two.quantity, two.role, two.dof, two.sign,
        )  # fmt: skip


def test_several_runs_and_one_of_them(command, case):
    command("import case_run01.npz case_run02.npz -o case.h5")
    assert command("export case.h5 all.npz").out.split() == ["all_run01.npz", "all_run02.npz"]
    assert command("export case.h5 two.csv --number 2").out.split() == ["two.csv"]
    assert_array_equal(read_any("two.csv")[0].data, read_any("all_run02.npz")[0].data)
    command("export case.h5 both.uff --ascii")
    assert len(read_any("both.uff")) == 2


@pytest.mark.parametrize("suffix", ["npz", "mat", "csv", "uff"])
def test_frfs_go_out_and_come_in_again(command, case, suffix):
    command("import case_run01.npz case_run02.npz -o case.h5")
    command("frf case.h5 --segment 256")
    command(f"export case.h5 frf.{suffix} --frf")
    command(f"import frf.{suffix} -o again.h5")
    before, after = load_frf("case.h5"), load_frf("again.h5")
    for key in ("frequency", "value", "coherence", "variance"):
        assert_array_equal(getattr(after, key), getattr(before, key))
    assert after.n_averages == before.n_averages
    assert command("info again.h5 --json").out.count("results/frf/0001") == 1


def test_info_of_other_files(command, case):
    said = json.loads(command("info case_run01.npz --json").out)
    assert said["arrays"]["f"] == {"shape": [3000], "type": "float32"}
    command("import case_run01.npz -o case.h5")
    command("export case.h5 case.uff")
    text = command("info case.uff").out
    assert "time response 'f' in N: 3000 values, 0 to 2.999 s" in text
    said = json.loads(command("info case.uff --json").out)
    assert [f["name"] for f in said["functions"]] == ["f", "a"]
