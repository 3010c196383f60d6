"""Whatever cannot be used ends in one line that names it and the remedy, status 2, and nothing written over."""

import json
import os
import re
import subprocess
import sys

import h5py
import numpy as np
import pytest

from drivers.block import Block
from labnnum.errors import StoreError
from labnnum.frf import Frf
from labnnum.recording import Channel, Recording
from sessions import cli
from sessions.exchange.export import export_frf, export_recordings
from sessions.runs import Run
from sessions.store import create_session

CHANNELS = """
sample_rate = 1000
[[channel]]
name = "f"
quantity = "force"
role = "reference"
[[channel]]
name = "a"
unit = "m/s^2"
"""


def signals(n=4000):
    return np.random.default_rng(1).normal(size=(2, n))


def npz(folder, name="case.npz", channels=CHANNELS, **change):
    f, a = signals()
    np.savez(folder / name, **{"f": f, "a": a, **change})
    (folder / "channels.toml").write_text(channels)


def session(folder, n=4000, data=None, **attributes):
    with create_session(folder / "case.h5") as made:
        run = made.start_run([Channel("f", "force", "reference"), Channel("a")], 1000, unit="SI", **attributes)
        run.append(Block(signals(n) if data is None else data, 0, 0.0))


def spoilt(position, value):
    a = signals()[1]
    a[position] = value
    return a


def clipped():
    t = np.arange(4000) / 1000
    return np.minimum(np.sin(2 * np.pi * 3 * t), 0.7)


def cut(path, share=0.5):
    os.truncate(path, int(path.stat().st_size * share))


def truncated_npz(folder):
    npz(folder)
    cut(folder / "case.npz")


def truncated_uff(folder, ascii_):
    export_recordings(folder / "case.uff", [Recording((Channel("a"),), signals()[:1], 1000.0)], ascii_)
    cut(folder / "case.uff")


def truncated_mat(folder):
    export_recordings(folder / "case.mat", [Recording((Channel("a"),), signals()[:1], 1000.0)])
    cut(folder / "case.mat")


def truncated_wav(folder):
    export_recordings(folder / "case.wav", [Recording((Channel("a"),), signals()[:1], 1000.0)])
    cut(folder / "case.wav")


def truncated_csv(folder):
    (folder / "case.csv").write_text("f,a\n1,2\n3,4\n5")
    (folder / "channels.toml").write_text(CHANNELS)


def truncated_json(folder):
    (folder / "case.json").write_text(json.dumps({"f": [1, 2, 3]})[:-4])
    (folder / "channels.toml").write_text(CHANNELS)


def newer(folder):
    session(folder)
    with h5py.File(folder / "case.h5", "r+") as file:
        file.attrs["version"] = 99


def truncated_session(folder):
    session(folder)
    cut(folder / "case.h5")


def foreign_session(folder):
    with h5py.File(folder / "case.h5", "w") as file:
        file["x"] = np.zeros(10)


def text_session(folder):
    (folder / "case.h5").write_text("not HDF5 at all")


def frf_session(folder):
    with create_session(folder / "case.h5") as made:
        made.add_frf(Frf([1.0, 2.0], np.ones((1, 1, 2)), (Channel("a"),), (Channel("f", "force", "reference"),)))


def existing(folder):
    npz(folder)
    (folder / "out.h5").write_text("mine")


def updater(folder):
    with h5py.File(folder / "case.h5", "w") as file:
        file.attrs["format"], file.attrs["version"] = "labnnum-updater", 1


def half_headed(folder):
    """A table whose headings name one of the two channels: the other is missing, and nothing may stand in for it."""
    (folder / "case.csv").write_text("t,f\n" + "".join(f"{i / 1000},{i % 7}\n" for i in range(100)))
    (folder / "channels.toml").write_text(CHANNELS)


def with_file(folder, name):
    session(folder)
    (folder / name).write_text("mine")


IMPORT = "import case.npz -o out.h5"

TABLE = {
    # files
    "missing file": (lambda f: None, "import none.npz -o out.h5", r"none\.npz: no such file"),
    "missing session": (lambda f: None, "info none.h5", r"none\.h5: no such session; create one with 'labnnum"),
    "missing session for frf": (lambda f: None, "frf none.h5", r"none\.h5: no such session"),
    "missing session for export": (lambda f: None, "export none.h5 out.npz", r"none\.h5: no such session"),
    "unknown ending": (lambda f: (f / "case.xyz").touch(), "import case.xyz -o out.h5", r"case\.xyz: its format"),
    "truncated NPZ": (truncated_npz, IMPORT, r"case\.npz: is truncated or no NumPy file"),
    "truncated UFF": (lambda f: truncated_uff(f, False), "import case.uff -o out.h5", r"case\.uff: .*truncated"),
    "truncated ASCII UFF": (lambda f: truncated_uff(f, True), "import case.uff -o out.h5", r"case\.uff: .*truncated"),
    "truncated MAT": (truncated_mat, "import case.mat -o out.h5", r"case\.mat: is truncated"),
    "truncated WAV": (truncated_wav, "import case.wav -o out.h5", r"case\.wav: is truncated"),
    "truncated CSV": (truncated_csv, "import case.csv -o out.h5", r"case\.csv: line 4 has 1 columns where 2 are usual"),
    "truncated JSON": (truncated_json, "import case.json -o out.h5", r"case\.json: is no JSON or truncated"),
    "text called NPZ": (lambda f: (f / "case.npz").write_text("hello"), IMPORT, r"case\.npz: is truncated or no NumPy"),
    "binary called text": (lambda f: (f / "x.csv").write_bytes(b"\0\1"), "import x.csv -o out.h5", r"x\.csv: is bin"),
    "words called text": (lambda f: (f / "x.csv").write_text("a b"), "import x.csv -o out.h5", r"x\.csv: no line of"),
    "text called UFF": (lambda f: (f / "x.uff").write_text("a"), "import x.uff -o out.h5", r"x\.uff: is no universal"),
    "folder": (lambda f: (f / "case.npz").mkdir(), IMPORT, r"case\.npz: is a folder; name the files in it"),
    "folder as session": (lambda f: (f / "case.h5").mkdir(), "frf case.h5", r"case\.h5: is a folder; name a session"),
    "column missing": (half_headed, "import case.csv -o out.h5", r"case\.csv: channel 'a': there is no array 'a'"),
    "no session's name": (npz, "import case.npz -o out.txt", r"out\.txt: a session is an \.h5 file; call it out\.h5"),
    "name too long": (npz, "import case.npz -o " + "x" * 300 + ".h5", r"xx\.h5: File name too long"),
    "no folder for a session": (npz, "import case.npz -o no/out.h5", r"no/out\.h5: there is no folder no"),
    "file as a folder": (npz, "import case.npz -o case.npz/out.h5", r"case\.npz/out\.h5: there is no folder"),
    "a session imported": (session, "import case.h5 -o out.h5", r"case\.h5: is a session already"),
    # sessions
    "newer session": (newer, "info case.h5", r"case\.h5: has session version 99 .*: install a newer labnnum"),
    "newer session for frf": (newer, "frf case.h5", r"case\.h5: has session version 99"),
    "newer session exported": (newer, "export case.h5 out.npz", r"case\.h5: has session version 99"),
    "truncated session": (truncated_session, "info case.h5", r"case\.h5: is truncated .*restore it from a copy"),
    "truncated session for frf": (truncated_session, "frf case.h5", r"case\.h5: is truncated"),
    "foreign HDF5": (foreign_session, "info case.h5", r"case\.h5: is HDF5 but no labnnum session"),
    "no HDF5": (text_session, "frf case.h5", r"case\.h5: is no HDF5 file"),
    "updater as session": (updater, "frf case.h5", r"case\.h5: is an updater and no session; use it as in 'labnnum"),
    "no rig kept": (session, "info case.h5 --rig", r"case\.h5: keeps no rig\.toml"),
    # channels
    "NaN": (lambda f: npz(f, a=spoilt(17, np.nan)), IMPORT, r"case\.npz: channel 'a' is not finite at sample 17"),
    "infinite": (lambda f: npz(f, f=spoilt(3, np.inf)), IMPORT, r"channel 'f' is not finite at sample 3"),
    "constant": (lambda f: npz(f, a=np.full(4000, 2.5)), IMPORT, r"channel 'a' is constant \(2\.5\); is its sensor"),
    "clipped": (lambda f: npz(f, a=clipped()), IMPORT, r"channel 'a' is clipped at 0\.7 m/s\^2 \(12 times, .*lower"),
    "clipped in a session": (
        lambda f: session(f, data=np.array([signals()[0], clipped()])), "frf case.h5", r"'a' is .*--keep-clipped",
    ),
    "other length": (lambda f: npz(f, a=np.ones(7)), IMPORT, r"channel 'a' has 7 samples where 'f' has 4000"),
    "no array": (
        lambda f: npz(f, channels=CHANNELS.replace('"a"', '"b"')), IMPORT, r"channel 'b': there is no array 'b'; there",
    ),
    "no row": (
        lambda f: npz(f, channels=CHANNELS + "source = 5"), IMPORT, r"channel 'a': there is no row or column 5",
    ),
    # channels.toml
    "no channels.toml": (
        lambda f: np.savez(f / "case.npz", f=np.ones(3)), IMPORT, r"case\.npz: what are its channels\?.*--channels",
    ),
    "channels.toml missing": (npz, IMPORT + " --channels none.toml", r"none\.toml: no such file"),
    "no TOML": (lambda f: npz(f, channels="a b"), IMPORT, r"channels\.toml: is not TOML"),
    "no rate": (
        lambda f: npz(f, channels=CHANNELS.replace("sample_rate = 1000", "")), IMPORT, r"sample_rate is missing",
    ),
    "misspelt key": (
        lambda f: npz(f, channels=CHANNELS.replace("quantity", "quantitty")), IMPORT,
        r"channels\.toml: channel\[1\]\.quantitty is no key; did you mean 'quantity'",
    ),
    "unknown role": (
        lambda f: npz(f, channels=CHANNELS.replace("reference", "ref")), IMPORT, r"channel\[1\]\.role: must be 'ref",
    ),
    "unknown unit": (
        lambda f: npz(f, channels=CHANNELS.replace("m/s^2", "furlong/s^9q")), IMPORT,
        r"channels\.toml: channel\[2\]: channel 'a': unit 'furlong/s\^9q' is unknown; write it as in",
    ),
    "unit of something else": (
        lambda f: npz(f, channels=CHANNELS.replace('quantity = "force"', 'quantity = "force"\nunit = "mm"')), IMPORT,
        r"channel 'f': unit 'mm' does not measure force",
    ),
    "period longer than the data": (
        lambda f: npz(f, channels="period = 5000\n" + CHANNELS), IMPORT, r"period 5000 and drop_periods 0 leave noth",
    ),
    "every period dropped": (
        lambda f: npz(f, channels="period = 1000\ndrop_periods = 4\n" + CHANNELS), IMPORT, r"drop_periods 4 leave noth",
    ),
    # estimates
    "segment beyond memory": (session, "frf case.h5 --segment 999999999999", r"is longer than the longest unbroken"),
    "decay": (session, "frf case.h5 --hits --decay nan", r"decay is nan: it must be 0 or more, in 1/s"),
    "gate": (session, "frf case.h5 --hits --gate=-1", r"gate is -1\.0: it must be 0 or more, in s"),
    "decay of noise": (session, "frf case.h5 --decay 5", r"decay and gate are for hammer hits, and this is none"),
    "coherence": (session, "frf case.h5 --coherence 2", r"--coherence 2: expected a number from 0 to 1"),
    "band beyond the rate": (session, "frf case.h5 --band 900:1000", r"band 900 to 1000 Hz lies above half the sample"),
    "too few segments": (lambda f: session(f, 500), "frf case.h5 --segment 400", r"only one segment of 400 fits"),
    "segment too long": (lambda f: session(f, 500), "frf case.h5 --segment 4096", r"4096 is longer .*lower n_segment"),
    "unknown window": (session, "frf case.h5 --window ham", r"window 'ham' is not one of .*hann"),
    "unknown estimator": (session, "frf case.h5 --estimator H7", r"estimator 'H7' is not one of auto, H1"),
    "overlap": (session, "frf case.h5 --overlap 1.5", r"overlap is 1\.5: it must be 0 or more and less than 1"),
    "no period": (session, "frf case.h5 --estimator periodic", r"has no period, so periods cannot be averaged"),
    "no such run": (session, "frf case.h5 --run 3", r"case\.h5: there is no run 3; there are 1"),
    "empty band": (session, "frf case.h5 --band 200:100", r"band \[200, 100\] Hz is empty"),
    "no band": (session, "frf case.h5 --band low", r"band 'low' is not LOW:HIGH in Hz"),
    "nothing recorded": (frf_session, "frf case.h5", r"case\.h5: there are no samples to estimate from"),
    # exports
    "unknown format": (session, "export case.h5 out.xls", r"out\.xls: cannot export to '\.xls'; choose one of \.uff"),
    "FRF as sound": (frf_session, "export case.h5 out.wav --frf", r"a WAV file cannot hold an FRF"),
    "no FRF yet": (session, "export case.h5 out.uff --frf", r"case\.h5: holds no FRF yet; estimate one with"),
    "FRF and no recording": (frf_session, "export case.h5 out.npz", r"holds FRFs and no recordings; export with --frf"),
    "no such number": (session, "export case.h5 out.npz --number 4", r"there is no run 4; there are 1"),
    "no folder": (session, "export case.h5 no/out.npz", r"there is no folder no"),
    # command lines
    "unknown option": (session, "frf case.h5 --windw hann", r"no such option: --windw .*see 'labnnum frf --help'"),
    "unknown command": (session, "fr case.h5", r"no such command 'fr'.*see 'labnnum --help'"),
    "argument missing": (session, "frf", r"missing argument 'session'; see 'labnnum frf --help'"),
    "word for a number": (session, "frf case.h5 --segment many", r"invalid value for '--segment'"),
    # what is there stays
    "report over a file": (lambda f: with_file(f, "x.html"), "report case.h5 -o x.html", r"x\.html: exists .* no rep"),
    "report over a model": (lambda f: with_file(f, "m.toml"), "report case.h5 -o m.toml", r"m\.toml: exists .* no rep"),
    "report into a folder": (
        lambda f: (session(f), (f / "sub").mkdir()), "report case.h5 -o sub", r"sub: is a folder; name the page in it",
    ),
    "report of another kind": (session, "report case.h5 -o x.pdf", r"x\.pdf: a report is an \.html file; call it x"),
    "import over a file": (existing, IMPORT, r"out\.h5: exists already and is not written over"),
    "import over its source": (npz, "import case.npz -o case.npz", r"case\.npz: exists already and is not"),
    "export over a file": (
        lambda f: (session(f), (f / "out.npz").write_text("mine")), "export case.h5 out.npz", r"out\.npz: exists",
    ),
}  # fmt: skip


def run(monkeypatch, capsys, line):
    """Status and standard error of a command line."""
    monkeypatch.setattr(sys, "argv", ["labnnum", *line.split()])
    with pytest.raises(SystemExit) as end:
        cli.main()
    shown = capsys.readouterr()
    return end.value.code, shown.err, shown.out


def files(folder):
    return {p.name: p.read_bytes() if p.is_file() else None for p in folder.iterdir()}


@pytest.mark.parametrize("case", TABLE)
def test_bad_input(case, tmp_path, monkeypatch, capsys):
    prepare, line, expected = TABLE[case]
    prepare(tmp_path)
    monkeypatch.chdir(tmp_path)
    before = files(tmp_path)
    status, said, out = run(monkeypatch, capsys, line)
    assert out == ""
    assert len(said.splitlines()) == 1, said
    assert said.startswith("labnnum: ")
    assert re.search(expected, said), said
    assert status == 2
    assert files(tmp_path) == before


def test_a_disk_that_is_full_while_importing_leaves_nothing_behind(tmp_path, monkeypatch, capsys):
    npz(tmp_path)
    monkeypatch.chdir(tmp_path)
    before = files(tmp_path)

    def full(run, block):
        raise StoreError(f"{run.name}: the disk is full; everything acknowledged before is kept and readable")

    monkeypatch.setattr(Run, "append", full)
    monkeypatch.setattr(Run, "name", ".out.importing.h5", raising=False)
    status, said, _ = run(monkeypatch, capsys, IMPORT)
    assert status == 1
    assert re.fullmatch(r"labnnum: out\.h5: nothing was imported: .*the disk is full\n", said), said
    assert files(tmp_path) == before


def test_a_session_in_use_is_a_failure_and_not_bad_input(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    with create_session(tmp_path / "case.h5") as made:
        made.start_run([Channel("f", "force", "reference"), Channel("a")], 1000, unit="SI").append(
            Block(signals(), 0, 0.0)
        )
        status, said, _ = run(monkeypatch, capsys, "frf case.h5")
        assert status == 1
        assert f"is being written by process {os.getpid()}" in said
        assert "wait until it ends" in said


def test_what_is_bad_can_be_kept_and_is_marked(tmp_path, monkeypatch, capsys):
    npz(tmp_path, a=spoilt(17, np.nan), f=clipped())
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["labnnum", *IMPORT.split(), "--keep-bad"])
    with pytest.raises(SystemExit) as end:
        cli.main()
    said = capsys.readouterr()
    assert not end.value.code, said.err
    assert "channel 'f' is clipped 12 times, and kept so" in said.err
    rows = [line.split() for line in run(monkeypatch, capsys, "info out.h5")[2].splitlines()]
    assert [row[-1] for row in rows if row[:1] == ["f"]] == ["12"]
    from sessions.store import open_session

    with open_session(tmp_path / "out.h5") as read:
        (recording,) = read.recordings()
    assert recording.excluded == ((17, 18),)
    assert len(recording.overloads) == 12
    assert {c for c, _, _ in recording.overloads} == {0}
    assert np.isnan(recording.data[1, 17])


def test_the_installed_command_ends_the_same_way(tmp_path):
    done = subprocess.run(
        [sys.executable, "-m", "sessions.cli", "info", "none.h5"],
        capture_output=True, text=True, check=False, cwd=tmp_path,
    )  # fmt: skip
    assert done.returncode == 2
    assert done.stderr == "labnnum: none.h5: no such session; create one with 'labnnum import' or 'labnnum measure'\n"
    assert done.stdout == ""


def test_frf_files_with_holes_are_refused(tmp_path, monkeypatch, capsys):
    frf = Frf([1.0, 2.0], np.array([[[1.0, np.nan]]]), (Channel("a"),), (Channel("f", "force", "reference"),))
    export_frf(tmp_path / "case.npz", frf)
    monkeypatch.chdir(tmp_path)
    status, said, _ = run(monkeypatch, capsys, IMPORT)
    assert status == 2
    assert "the FRF of 'a' to 'f' is not finite at 2 Hz; leave that line out" in said
