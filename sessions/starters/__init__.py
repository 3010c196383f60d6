"""Commented rig.toml and model.toml to start from: a kind of rig by a kind of structure."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from numpy.typing import NDArray

from labnnum.errors import ConfigError, FileError

RIGS: dict[str, str] = {
    "simulated": "a shaker on a bench that does not exist: try everything without hardware",
    "simulated-hammer": "a hammer on a bench that does not exist",
    "shaker": "an audio interface that records, a function generator on a serial line that excites",
    "hammer": "an audio interface and an impact hammer",
}
"""Kind of rig -> what it is."""


@dataclass(frozen=True)
class Starter:
    """A structure to start from: its model file, and where it is driven and measured.

    Parameters
    ----------
    about : str
    force : str
        "node:direction" that a hammer or a force-controlled shaker drives.
    responses : mapping
        Channel name -> "node:direction".
    points : tuple of str
        Where a roving hammer strikes.
    band : (low, high)
        Excited band in Hz.
    base : str
        Direction in which a shaker table moves all supports; empty where a shaker pushes at `force`.
    level : float
        RMS at which a shaker drives it: N, or m/s^2 of a shaker table.
    rate, duration, segment : float, float, int
        Of the simulated bench: samples per second, s of a run, samples of a segment.
    tip : str
        Of the hammer.
    peak : float
        Of a blow, in N.
    hit : float
        s within which the response to a blow has decayed.
    noise : float
        Of a simulated accelerometer, RMS in m/s^2.
    range : float
        Volts at the end of an accelerometer's input range.
    arrays : mapping
        Files beside the model: name -> arrays.
    """

    about: str
    force: str
    responses: Mapping[str, str]
    points: tuple[str, ...]
    band: tuple[float, float]
    base: str = ""
    level: float = 10.0
    rate: float = 2560.0
    duration: float = 60.0
    segment: int = 4096
    tip: str = "plastic"
    peak: float = 100.0
    hit: float = 1.0
    noise: float = 0.02
    range: float = 1.0
    arrays: Mapping[str, Mapping[str, NDArray]] = field(default_factory=dict)


def _strip() -> dict[str, NDArray]:
    """Matrices as a finite element program would export them: a free strip of four lumped masses on soft ground."""
    mass, stiffness, ground = 0.25, 2.0e6, 4.0e3
    n = 4
    K = np.zeros((n, n))
    dK = np.zeros((n, n))
    for i in range(n - 1):
        K[i : i + 2, i : i + 2] += stiffness * np.array([[1, -1], [-1, 1]])
    dK += K
    K += ground * np.eye(n)
    return {
        "M0": mass * np.eye(n),
        "K0": K,
        "dK_stiffness": dK,
        "dM_mass": mass * np.eye(n),
        "dofs": np.array([f"{i + 1}:z" for i in range(n)]),
        "nodes": np.array([str(i + 1) for i in range(n)]),
        "xyz": np.array([[0.1 * i, 0.0, 0.0] for i in range(n)]),
    }


STRUCTURES: dict[str, Starter] = {
    "beam": Starter(
        "a cantilevered aluminium beam with an accelerometer on it",
        force="3:z",
        responses={"a3": "3:z"},
        points=("7:-z", "5:-z", "3:-z"),
        band=(5.0, 1000.0),
        base="z",
        level=4.0,
        duration=120.0,
        segment=16384,
        tip="hard rubber",
        peak=1.2,
        hit=6.4,
    ),
    "chain": Starter(
        "three masses on springs",
        force="1:x",
        responses={"a1": "1:x", "a3": "3:x"},
        points=("1:x", "2:x", "3:x"),
        band=(2.0, 100.0),
        rate=512.0,
        duration=120.0,
        segment=2048,
        tip="rubber",
        peak=250.0,
        hit=4.0,
        noise=0.001,
        range=0.5,
    ),
    "frame": Starter(
        "a portal frame of steel tubes",
        force="2:x",
        responses={"a2": "2:x", "a3": "3:x"},
        points=("2:x", "3:-x"),
        band=(5.0, 450.0),
        rate=1280.0,
        duration=120.0,
        hit=2.0,
        tip="rubber",
    ),
    "matrices": Starter(
        "mass and stiffness matrices that another program exported",
        force="1:z",
        responses={"a1": "1:z", "a4": "4:z"},
        points=("1:-z", "2:-z", "4:-z"),
        band=(10.0, 1000.0),
        level=2.0,
        range=5.0,
        hit=5.0,
        tip="hard rubber",
        arrays={"structure.npz": _strip()},
    ),
}
"""Kind of structure -> what the files are filled with."""


def starter_files(rig: str, structure: str, **values: Any) -> dict[str, str | Mapping[str, NDArray]]:
    """File name -> text (or arrays) of a rig and a structure to start from.

    Parameters
    ----------
    rig : str
        A key of `RIGS`.
    structure : str
        A key of `STRUCTURES`.
    values : numbers or texts
        Of the templates' variables, where they shall differ: seed, duration, segment, level, parameters.

    Raises
    ------
    ConfigError
        If a kind is not known.
    """
    for key, known, asked in (("--rig", RIGS, rig), ("--structure", STRUCTURES, structure)):
        if asked not in known:
            raise ConfigError(f"{key} {asked!r}: expected one of {', '.join(known)}")
    start = STRUCTURES[structure]
    hammer = rig.endswith("hammer")
    given = {
        "rig": rig,
        "kind": structure,
        "start": start,
        "hammer": hammer,
        "simulated": rig.startswith("simulated"),
        "base": "" if hammer else start.base,
        "seed": 0,
        "duration": start.duration,
        "segment": start.segment,
        "level": start.level,
        "parameters": {},
    }
    known = given | values
    model = _templates().get_template(f"model-{structure}.toml").render(known)
    return {"rig.toml": _templates().get_template("rig.toml").render(known), "model.toml": model, **start.arrays}


def write_starter(folder: Path, rig: str, structure: str, **values: Any) -> tuple[Path, ...]:
    """Paths of the files written into `folder`, which is made if need be; nothing is written over.

    Raises
    ------
    FileError
        If one of the files exists.
    ConfigError
        If a kind is not known.
    """
    files = starter_files(rig, structure, **values)
    for name in files:
        if (folder / name).exists():
            raise FileError(f"{folder / name}: exists already and is not written over; choose another folder")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, content in files.items():
            if isinstance(content, str):
                (folder / name).write_text(content, encoding="utf-8")
            else:
                np.savez(folder / name, **content)  # ty: ignore[invalid-argument-type]
    except OSError as error:
        raise FileError(f"{folder}: cannot be written to ({error.strerror}); choose another folder") from error
    return tuple(folder / name for name in files)


@lru_cache(maxsize=1)
def _templates() -> Environment:
    return Environment(
        loader=FileSystemLoader(Path(__file__).parent / "templates"), undefined=StrictUndefined, trim_blocks=True,
        lstrip_blocks=True, keep_trailing_newline=True, autoescape=False,
    )  # fmt: skip
