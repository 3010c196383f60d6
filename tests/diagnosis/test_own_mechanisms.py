"""A mechanism that a user wrote: found by its file, named by the diagnosis, and kept in the extended model."""

from pathlib import Path

import numpy as np
import pytest

from labnnum.errors import ConfigError, FileError
from labnnum.mechanisms import CATALOGUE
from labnnum.recording import Channel
from labnnum.response import frf
from sessions.diagnose import diagnose_files
from sessions.model import read_model
from sessions.own_mechanisms import catalogue

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "own_mechanism.py"
MODEL = """
[structure]
kind = "chain"
{masses}
{links}
[damping]
kind = "modal"
ratio = 0.01
[[parameter]]
name = "k"
nominal = 1e5
lower = 8e4
upper = 1.2e5
std = 3e3
"""
MASSES = "".join(f'[[structure.mass]]\nnode = "{i}"\nmass = 1.0\n' for i in range(1, 6))
LINKS = "".join(
    f'[[structure.link]]\nbetween = ["{a}", "{b}"]\nstiffness = "k"\n'
    for a, b in [("ground", 1), (1, 2), (2, 3), (3, 4), (4, 5)]
)
ADDED = f"""
[[mechanism]]
id = "inerter"
file = "{EXAMPLE.as_posix()}"
variant = "x"
place = {{ kind = "element", id = "2", to = "3" }}
parameters = {{ inertance = {{ value = 0.5, unit = "kg" }} }}
"""


@pytest.fixture(scope="module")
def case(tmp_path_factory):
    """A folder with the nominal model and FRFs of the chain that holds an inerter between 2 and 3."""
    folder = tmp_path_factory.mktemp("own")
    text = MODEL.format(masses=MASSES, links=LINKS)
    (folder / "model.toml").write_text(text)
    (folder / "true.toml").write_text(text + ADDED)
    outputs = [Channel(f"a{i}", "acceleration", "response", str(i), "x") for i in (1, 2, 3, 4, 5)]
    force = [Channel("f", "force", "reference", "1", "x")]
    lines = np.linspace(5.0, 110.0, 700)
    true = read_model(folder / "true.toml").structure
    value = frf(true, true.nominal, lines, outputs, force)[:, 0]
    noise = np.random.default_rng(3).normal(size=(2, *value.shape)) * 2e-4 * np.abs(value).max()
    data = {f"H{i + 1}": row for i, row in enumerate(value + noise[0] + 1j * noise[1])}
    np.savez(folder / "frf.npz", f=lines, **data)
    rows = "".join(f'[[frf.row]]\nvalue = "H{i}"\noutput = "a{i}"\ninput = "f"\n' for i in range(1, 6))
    channels = (
        '[frf]\nfrequency = "f"\n'
        + rows
        + "".join(
            f'[[channel]]\nname = "{c.name}"\nquantity = "{c.quantity}"\nunit = "{c.unit}"\nrole = "{c.role}"\n'
            f'node = "{c.node}"\ndirection = "x"\n'
            for c in [*outputs, *force]
        )
    )
    (folder / "channels.toml").write_text(channels)
    return folder


def test_the_catalogue_grows_by_a_file():
    grown = catalogue([EXAMPLE, EXAMPLE])
    assert [m.id for m in grown] == [*(m.id for m in CATALOGUE), "inerter"]


def test_a_model_file_holds_it(case):
    true, plain = read_model(case / "true.toml").structure, read_model(case / "model.toml").structure
    column = np.array([0, 1.0, -1, 0, 0])
    expected = plain.matrices(plain.nominal).M + 0.5 * np.outer(column, column)
    np.testing.assert_allclose(true.matrices(true.nominal).M, expected, atol=1e-12)


def test_it_is_named_and_kept(case, tmp_path):
    made = diagnose_files(
        [case / "frf.npz"], case / "model.toml", tmp_path / "out", channels=case / "channels.toml", mechanisms=[EXAMPLE]
    )
    assert made["verdict"] == "missing-physics"
    assert made["mechanism"]["id"] == "inerter"
    assert (made["place"]["id"], made["place"]["to"]) == ("2", "3")
    assert made["mechanism"]["parameters"]["inertance"]["value"] == pytest.approx(0.5, rel=0.03)
    extended = read_model(tmp_path / "out" / "extended.toml").structure
    assert any(p.name.startswith("inertance") for p in extended.parameters)


def test_files_that_are_no_mechanism(tmp_path):
    with pytest.raises(FileError, match="no such file"):
        catalogue([tmp_path / "none.py"])
    for text, said in (("x = 1", "defines no mechanism"), ("import nothing_like_it", "cannot be run")):
        path = tmp_path / "own.py"
        path.write_text(text)
        with pytest.raises(FileError, match=said):
            catalogue([path])
    path.write_text(EXAMPLE.read_text().replace('symbol = "flywheel"', 'symbol = ""'))
    with pytest.raises(ConfigError, match="has no symbol"):
        catalogue([path])
    path.write_text(EXAMPLE.read_text().replace('id = "inerter"', 'id = "added-mass"'))
    with pytest.raises(ConfigError, match="two mechanisms have the id"):
        catalogue([path])
