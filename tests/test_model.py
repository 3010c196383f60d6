"""model.toml: every kind is read as documented, written back the same, and refused with the key that is wrong."""

import json
import re
from pathlib import Path

import h5py
import numpy as np
import pytest
from scipy.io import savemat
from scipy.sparse import csc_matrix

from labnnum.errors import BandError, ConfigError, FileError, InputError
from labnnum.recording import Channel
from labnnum.response import frf, modes
from labnnum.structures import Beam, Chain, Frame, MatrixStructure, ModalStructure
from labnnum.structures.examples import dissertation_beam, truck
from sessions.model import fingerprint, parse_model, read_model, write_model
from sessions.toml_write import dumps

TRUCK = """
[structure]
kind = "chain"
[[structure.mass]]
node = 1
mass = 3728.0
[[structure.mass]]
node = 2
mass = 657
[[structure.mass]]
node = 3
mass = "m3"
position = [0, 0, 1.5]
[[structure.link]]
between = [1, "ground"]
stiffness = 21e5
[[structure.link]]
between = [1, 2]
stiffness = "k2"
damping = "b2"
[[structure.link]]
between = [2, 3]
stiffness = 23.5e3
damping = 600

[[parameter]]
name = "m3"
nominal = 130
lower = 100
upper = 160
std = 15
unit = "kg"
[[parameter]]
name = "k2"
nominal = 5e5
lower = 2e5
upper = 8e5
[[parameter]]
name = "b2"
nominal = 1050
lower = 900
upper = 1200

[[band]]
low = 4
high = 7
[[band]]
low = 1.2
high = 2.7
imag = 0
[places]
nodes = [2, 3]
elements = [[1, 2]]
"""

BEAM = """
[structure]
kind = "beam"
length = 0.254
elements = 6
spacing = [2, 2, 1.5, 1.5, 1.5, 1.5]
E = 6.894757293168e10
rho = 2767.990471020321
width = 0.0381
height = 0.0015875
base = "z"
[[structure.support]]
node = "start"
[[structure.lump]]
node = 3
mass = "m_acc"
inertia = "I_acc"
[[structure.point]]
node = "p"
x = 0.1
[[structure.spring]]
node = "end"
stiffness = 0.0
[damping]
kind = "proportional"
alpha = "alpha"
beta = "beta"
[[parameter]]
name = "m_acc"
nominal = 10e-3
lower = 7e-3
upper = 13e-3
[[parameter]]
name = "I_acc"
nominal = 1.5e-6
lower = 0.75e-6
upper = 2.25e-6
[[parameter]]
name = "alpha"
nominal = 1.5
lower = 0.5
upper = 2.5
[[parameter]]
name = "beta"
nominal = 2e-5
lower = 0.5e-5
upper = 3.5e-5
"""

FRAME = """
[structure]
kind = "frame"
plane = "xz"
[[structure.node]]
node = "a"
xyz = [0, 0, 0]
[[structure.node]]
node = "b"
xyz = [0, 0, 0.5]
[[structure.node]]
node = "c"
xyz = [0.4, 0, 0.5]
[[structure.profile]]
name = "bar"
E = "E"
rho = 7800
width = 0.01
height = 0.01
[[structure.member]]
between = ["a", "b"]
profile = "bar"
divide = 4
[[structure.member]]
between = ["b", "c"]
profile = "bar"
divide = 2
[[structure.support]]
node = "a"
[[structure.support]]
node = "c"
fixed = ["z"]
[[structure.lump]]
node = "b"
mass = 0.1
[[structure.spring]]
node = "c"
direction = "x"
stiffness = 1e3
damping = 2
[damping]
kind = "structural"
eta = 0.01
[[parameter]]
name = "E"
nominal = 2e11
lower = 1.8e11
upper = 2.2e11
"""

MODAL = """
[structure]
kind = "modal"
[[structure.node]]
node = 1
xyz = [0, 0, 0]
[[structure.mode]]
frequency = "f1"
damping_ratio = 0.01
shape = { "1:x" = 0.5, "2:x" = -0.3 }
[[structure.mode]]
frequency = 20
damping_ratio = 0.02
shape = { "1:x" = 0.2, "2:x" = 0.6 }
[structure.flexibility]
"1:x" = 1e-6
[[parameter]]
name = "f1"
nominal = 10
lower = 9
upper = 11
"""

MATRICES = """
[structure]
kind = "matrices"
file = "structure.npz"
base = "z"
[damping]
kind = "modal"
ratio = ["zeta", 0.01]
[[parameter]]
name = "E"
nominal = 1.0
lower = 0.8
upper = 1.2
std = 0.05
[[parameter]]
name = "zeta"
nominal = 0.008
lower = 0.0
upper = 0.1
[places]
supports = ["1"]
"""

K0 = np.array([[200.0, -200.0, 0.0], [-200.0, 300.0, -100.0], [0.0, -100.0, 100.0]])
ARRAYS = {
    "M0": np.diag([1.0, 2.0, 1.0]), "K0": K0, "dK_E": K0, "dofs": np.array(["1:z", "2:z", "3:z"]),
    "nodes": np.array(["1", "2", "3"]), "xyz": np.array([[0.0, 0, 0], [0.1, 0, 0], [0.2, 0, 0]]),
}  # fmt: skip


@pytest.fixture
def folder(tmp_path):
    for name, text in {"truck": TRUCK, "beam": BEAM, "frame": FRAME, "modal": MODAL, "matrices": MATRICES}.items():
        (tmp_path / f"{name}.toml").write_text(text, encoding="utf-8")
    np.savez(tmp_path / "structure.npz", **ARRAYS)
    return tmp_path


KINDS = {"truck": Chain, "beam": Beam, "frame": Frame, "modal": ModalStructure, "matrices": MatrixStructure}


@pytest.mark.parametrize(("name", "kind"), KINDS.items(), ids=KINDS)
def test_every_kind_is_read_and_written_back_the_same(folder, name, kind):
    model = read_model(folder / f"{name}.toml")
    assert isinstance(model.structure, kind)
    (folder / "deeper").mkdir()
    write_model(folder / "deeper" / "again.toml", model)
    again = read_model(folder / "deeper" / "again.toml")
    assert fingerprint(again) == fingerprint(model)
    assert again.structure.dofs == model.structure.dofs
    a, b = (m.structure.matrices(m.structure.nominal) for m in (model, again))
    for x in "MCKD":
        np.testing.assert_array_equal(getattr(a, x), getattr(b, x))
    assert again.bands == model.bands
    assert again.places == model.places


def test_the_truck_of_the_file_is_the_truck(folder):
    s, ready = read_model(folder / "truck.toml").structure, truck(("m3", "k2", "b2"))
    theta = np.array([111.0, 4e5, 1000.0])
    for x in "MCK":
        np.testing.assert_allclose(getattr(s.matrices(theta), x), getattr(ready.matrices(theta), x))


def test_the_beam_of_the_file_is_the_beam(folder):
    s, ready = read_model(folder / "beam.toml").structure, dissertation_beam()
    for x in "MCK":
        a, b = (getattr(t.matrices(ready.nominal), x) for t in (s, ready))
        np.testing.assert_allclose(a, b, rtol=1e-6, atol=1e-9 * np.abs(b).max())


def test_bands_are_sorted_and_places_checked(folder):
    model = read_model(folder / "truck.toml")
    assert [b.low for b in model.bands] == [1.2, 4.0]
    assert model.bands[0].imag == 0
    assert model.places.nodes == ("2", "3")
    assert model.places.elements == (("1", "2"),)
    assert model.places.supports is None


def test_divided_members_name_their_inner_nodes(folder):
    s = read_model(folder / "frame.toml").structure
    assert "a-b.3:x" in s.dofs
    assert "c:z" not in s.dofs
    np.testing.assert_allclose(s.nodes["a-b.1"], (0, 0, 0.125))


def test_supports_of_places_are_clamped_where_nothing_else_holds_them(folder):
    s = read_model(folder / "matrices.toml").structure
    assert s.dofs == ("2:z", "3:z")
    assert s.supports == ("1",)
    out = Channel("a", "acceleration", "response", "1", "z")
    np.testing.assert_allclose(frf(s, s.nominal, [1.0], [out], [Channel("b", role="base")]), 1.0)


def test_supports_that_stand_on_springs_stay(folder):
    held = K0 + np.diag([50.0, 0, 0])
    np.savez(folder / "structure.npz", **{**ARRAYS, "K0": held})
    s = read_model(folder / "matrices.toml").structure
    assert s.dofs == ("1:z", "2:z", "3:z")
    assert s.supports == ("1",)


def test_supports_may_be_said(folder):
    text = MATRICES.replace('base = "z"', 'base = "z"\nsupports = ["3"]').replace('supports = ["1"]', "")
    assert parse_model(text, folder / "m.toml").structure.dofs == ("1:z", "2:z")


def as_mat5(path):
    sparse = {k: csc_matrix(v) if k == "K0" else v for k, v in ARRAYS.items() if k not in ("dofs", "nodes")}
    savemat(path, {**sparse, "dofs": np.array(list(ARRAYS["dofs"]), object), "nodes": np.array([[1.0, 2.0, 3.0]])})


def as_mat73(path):
    with h5py.File(path, "w", userblock_size=512) as file:
        for name in ("M0", "K0", "dK_E", "xyz"):
            file.create_dataset(name, data=ARRAYS[name].T).attrs["MATLAB_class"] = np.bytes_("double")
        for name in ("dofs", "nodes"):
            refs = []
            for i, text in enumerate(ARRAYS[name]):
                cell = file.create_dataset(f"#refs#/{name}{i}", data=np.array([[ord(c)] for c in text], "u2"))
                cell.attrs["MATLAB_class"] = np.bytes_("char")
                refs.append(cell.ref)
            item = file.create_dataset(name, data=np.array([refs], dtype=h5py.ref_dtype))
            item.attrs["MATLAB_class"] = np.bytes_("cell")
    with open(path, "r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file".ljust(512, b" "))


def as_hdf5(path):
    with h5py.File(path, "w") as file:
        for name, value in ARRAYS.items():
            if value.dtype.kind == "U":
                file.create_dataset(name, data=[str(v) for v in value], dtype=h5py.string_dtype())
            else:
                file[name] = value


@pytest.mark.parametrize(("name", "write"), [("s.mat", as_mat5), ("s73.mat", as_mat73), ("s.h5", as_hdf5)])
def test_files_of_matrices(folder, name, write):
    write(folder / name)
    wanted = read_model(folder / "matrices.toml")
    found = parse_model(MATRICES.replace("structure.npz", name), folder / "m.toml")
    a, b = (m.structure.matrices(np.array([1.1, 0.02])) for m in (wanted, found))
    for x in "MCK":
        np.testing.assert_allclose(getattr(a, x), getattr(b, x))
    assert found.structure.nodes == wanted.structure.nodes


def test_damping_matrix_of_the_file_is_taken_where_none_is_said(folder):
    np.savez(folder / "structure.npz", **ARRAYS, C0=0.01 * K0)
    text = re.sub(r"\[damping\].*?\n\[\[", "[[", MATRICES, flags=re.DOTALL)
    text = re.sub(r'\[\[parameter\]\]\nname = "zeta".*?\n\[places', "[places", text, flags=re.DOTALL)
    s = parse_model(text, folder / "m.toml").structure
    np.testing.assert_allclose(s.matrices(s.nominal).C, 0.01 * K0[1:, 1:])


def test_fingerprints_tell_models_apart(folder):
    base = fingerprint(read_model(folder / "truck.toml"))
    assert len(base) == 16

    def of(text):
        return fingerprint(parse_model(text, folder / "x.toml"))

    assert of(TRUCK) == base
    assert of("# a comment\n" + TRUCK.replace("657", "657.0")) == base
    assert of(TRUCK.replace("nodes = [2, 3]", "nodes = [2]")) == base
    assert of(TRUCK.replace("657", "658")) != base
    assert of(TRUCK.replace("high = 7", "high = 8")) != base
    first = fingerprint(read_model(folder / "matrices.toml"))
    np.savez(folder / "structure.npz", **{**ARRAYS, "M0": 2 * ARRAYS["M0"]})
    assert fingerprint(read_model(folder / "matrices.toml")) != first


WRONG = {
    "no structure": (TRUCK, "[structure]\n", "", "structure.kind is missing: expected one of"),
    "no table": ("[damping]\nkind = 'none'\n", "kind", "kind", "the table .structure. is missing"),
    "kind": (TRUCK, '"chain"', '"chian"', "structure.kind is 'chian': expected one of chain, beam"),
    "not toml": (TRUCK, "[structure]", "[structure", "is not TOML"),
    "misspelt key": (TRUCK, "stiffness = 21e5", "stifness = 21e5", r"structure.link\[1\].stifness is no key; did you"),
    "unknown table": (TRUCK, "[places]", "[zorro]\na = 1\n[places]", "zorro is no key; there are"),
    "missing key": (TRUCK, "mass = 657", "", r"structure.mass\[2\].mass is missing"),
    "wrong kind of value": (TRUCK, "lower = 100", 'lower = "low"', r"parameter\[1\].lower"),
    "bounds": (TRUCK, "lower = 100", "lower = 140", "parameter 'm3': needs lower <= nominal"),
    "std": (TRUCK, "std = 15", "std = -1", "parameter 'm3': std"),
    "undeclared": (TRUCK, 'mass = "m3"', 'mass = "m9"', "parameter 'm9', which is not declared"),
    "unused": (TRUCK, 'mass = "m3"', "mass = 130", "parameter 'm3' is used by nothing"),
    "twice": (TRUCK, "node = 2\n", "node = 1\n", "structure.mass: '1' stands there twice"),
    "no such node": (TRUCK, "between = [2, 3]", "between = [2, 4]", "there is no mass '4'"),
    "places": (TRUCK, "nodes = [2, 3]", "nodes = [2, 8]", "places.nodes: the structure has no node '8'; it has"),
    "empty band": (TRUCK, "high = 7", "high = 3", r"band \[4, 3\] Hz is empty"),
    "overlap": (TRUCK, "low = 4", "low = 2", "overlap"),
    "damping key": (
        BEAM,
        'kind = "proportional"',
        'kind = "modal"',
        "damping.alpha: damping of kind modal takes ratio",
    ),
    "damping value": (FRAME, "eta = 0.01", "", "damping.eta is missing"),
    "damping of modes": (MODAL, "[[parameter]]", '[damping]\nkind = "none"\n[[parameter]]', "leave .damping. out"),
    "support": (BEAM, '"start"', '"9"', "support at '9': supports sit on mesh nodes 1 to 7"),
    "theory": (BEAM, "elements = 6", 'elements = 6\ntheory = "euler"', "structure.theory"),
    "spacing": (BEAM, "spacing = [2, 2,", "spacing = [2,", "spacing = .*expected 6 positive lengths"),
    "profile": (FRAME, "width = 0.01", "", "a profile needs diameter"),
    "frame node": (FRAME, 'between = ["b", "c"]', 'between = ["b", "d"]', "there is no node 'd'"),
    "no file": (MATRICES, "structure.npz", "other.npz", "other.npz: no such file .key file"),
    "kind of file": (MATRICES, "structure.npz", "matrices.toml", "expected a file of matrices"),
    "no derivative": (MATRICES, 'name = "E"', 'name = "G"', "parameter 'G' has neither dM_G nor dK_G"),
    "base": (MATRICES, 'base = "z"', 'base = "u"', "structure.base"),
    "mechanism": (TRUCK, "[places]", '[[mechanism]]\nid = "none-such"\n[places]', "mechanism"),
}


@pytest.mark.parametrize(("text", "old", "new", "said"), WRONG.values(), ids=WRONG)
def test_what_is_wrong_is_named_in_one_line(folder, text, old, new, said):
    assert old in text
    path = folder / "wrong.toml"
    path.write_text(text.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(InputError, match=said) as caught:
        read_model(path)
    assert "\n" not in str(caught.value)
    assert str(folder) in str(caught.value)


def test_kinds_of_errors(folder):
    with pytest.raises(FileError, match="no such file"):
        read_model(folder / "none.toml")
    with pytest.raises(BandError):
        parse_model(TRUCK.replace("high = 7", "high = 3"), Path("m.toml"))
    (folder / "structure.npz").write_bytes((folder / "structure.npz").read_bytes()[:300])
    with pytest.raises(FileError, match=r"structure.npz: is truncated"):
        read_model(folder / "matrices.toml")
    np.savez(folder / "structure.npz", **{k: v for k, v in ARRAYS.items() if k != "dofs"})
    with pytest.raises(ConfigError, match="dofs is missing"):
        read_model(folder / "matrices.toml")
    np.savez(folder / "structure.npz", **{**ARRAYS, "xyz": np.zeros((2, 3))})
    with pytest.raises(ConfigError, match="xyz has shape"):
        read_model(folder / "matrices.toml")
    np.savez(folder / "structure.npz", **{**ARRAYS, "M0": np.array([["a"]])})
    with pytest.raises(ConfigError, match="M0 holds no real numbers"):
        read_model(folder / "matrices.toml")


def test_toml_text_of_awkward_values():
    import tomllib

    table = {
        "a": {"b c": 'quote " and \\ and ü', "d": [1, 2.5, [True, "x"]], "e": {"f": 1e-300}},
        "g": [{"h": -0.0}, {}],
    }
    assert tomllib.loads(dumps(table)) == table
    with pytest.raises(ConfigError, match=r"a.b: a set"):
        dumps({"a": {"b": {1, 2}}})


DOCS = Path(__file__).resolve().parents[1] / "docs" / "models.md"
BLOCKS = re.findall(r"```toml\n(.*?)```", DOCS.read_text(encoding="utf-8"), flags=re.DOTALL)


@pytest.mark.parametrize("text", BLOCKS, ids=[re.search(r'kind = "(\w+)"', b)[1] for b in BLOCKS])
def test_models_of_the_documentation_are_read_and_vibrate(text, tmp_path):
    s = parse_model(text, tmp_path / "model.toml").structure
    assert modes(s, s.nominal, 3).frequency[-1] > 0


def test_python_of_the_documentation():
    import doctest

    found = doctest.testfile(str(DOCS), module_relative=False)
    assert found.attempted > 10
    assert not found.failed


def run(*arguments):
    from typer.testing import CliRunner

    from sessions.cli import app

    return CliRunner().invoke(app, ["modes", *map(str, arguments)], catch_exceptions=False)


def test_command_prints_modes_and_what_moves_them(folder):
    shown = run(folder / "truck.toml")
    assert shown.exit_code == 0
    assert "Chain of 3 coordinates, supported at 1" in shown.stdout
    said = json.loads(run(folder / "truck.toml", "-n", 2, "--json").stdout)
    assert [round(2 * np.pi * m["frequency"], 1) for m in said["modes"]] == [12.9, 20.8]
    assert said["modes"][0]["share"]["b2"] == 0
    assert -0.5 < said["modes"][0]["share"]["m3"] < 0


def test_command_on_a_bad_model(folder):
    (folder / "bad.toml").write_text(TRUCK.replace("21e5", "-21e5"), encoding="utf-8")
    with pytest.raises(InputError, match="unstable"):
        run(folder / "bad.toml")
