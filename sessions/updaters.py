"""Updater files (.h5): a trained network with its bands, range, model and validation, to load years later.

Layout of format 2: arrays of the network under /network, of the features under /features (where they have any), of
the novelty check under /novelty; frequency, validation,
fingerprint and, where a measurement's random error was taken for the training, trained_variance (relative, a line each)
at the root; everything else as JSON in /about; the model file's text in /model.toml.

Files of every format up to this one are read. Whatever a format added stands in `ADDED`: an older file may lack it, and
the network's own default holds; a file of its format or a later one that lacks it is damaged. A file of a later format
than this is refused.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from labnnum import __version__
from labnnum.bands import Band
from labnnum.errors import FileError
from labnnum.frf import Frf
from labnnum.recording import Channel
from labnnum.structures.base import Structure
from labnnum.updating.fingerprint import fingerprint, require_same
from labnnum.updating.kinds import make_features
from labnnum.updating.network import RbfNetwork
from labnnum.updating.novelty import Novelty
from labnnum.updating.seen import view_settings
from labnnum.updating.training import TrainingSet
from labnnum.updating.updater import Updater
from sessions import HDF5_SUFFIXES
from sessions.model import Model, parse_model
from sessions.tables import read_json, read_text, write_json, write_text

FORMAT = "labnnum-updater"
VERSION = 2

ADDED: dict[str, int] = {"gains": 2, "reach": 2}
"""Array of /network -> the format that brought it; the others are in all. Format 2: the second stage, gains.py."""


def save_updater(path: str | Path, updater: Updater, model: Model | None = None) -> Path:
    """Write an updater file; the path.

    Parameters
    ----------
    path : path
        Must not exist: nothing is written over.
    updater : Updater
    model : Model, optional
        The model file that the structure came from; with it, the updater can be loaded without naming a model.

    Raises
    ------
    FileError
        If the file exists or its folder does not.
    """
    path = Path(path)
    require_free(path)
    part = path.with_name(f".{path.name}.part")
    with h5py.File(part, "w") as file:
        _write(file, updater, path, model)
    os.replace(part, path)
    return path


def is_updater(path: Path) -> bool:
    """Whether a file is an updater, of any version."""
    try:
        with h5py.File(path, "r") as file:
            return file.attrs.get("format") == FORMAT
    except OSError:
        return False


def require_free(path: Path) -> None:
    """FileError if something stands at `path` already, its folder is missing, or it is not called .h5."""
    if path.exists():
        raise FileError(f"{path}: exists already; choose another name, or delete it first")
    if not path.parent.is_dir():
        raise FileError(f"{path}: there is no folder {path.parent}; create it first")
    if path.suffix.lower() not in HDF5_SUFFIXES:
        raise FileError(f"{path}: an updater is an .h5 file; call it {path.stem}.h5")


def load_updater(path: str | Path, structure: Structure | None = None) -> Updater:
    """The updater of a file.

    Parameters
    ----------
    path : path
    structure : Structure, optional
        The model to use it with; by default the one whose file it remembers.

    Raises
    ------
    FileError
        If the file is missing, truncated, no updater, of a newer version, or does not remember its model.
    ModelError
        If the model is not the one that it was trained on.
    """
    path = Path(path)
    with _opened(path) as file:
        try:
            return _read(file, path, structure)
        except (KeyError, TypeError) as error:
            raise FileError(f"{path}: is damaged: {error}; train it again with 'labnnum train'") from error


def _opened(path: Path) -> h5py.File:
    if path.is_dir():
        raise FileError(f"{path}: is a folder; name an updater (.h5) in it")
    if not path.is_file():
        raise FileError(f"{path}: no such updater; make one with 'labnnum train model.toml -o {path.name}'")
    try:
        file = h5py.File(path, "r")
    except OSError as error:
        raise FileError(f"{path}: is no HDF5 file, or cut short; train it again with 'labnnum train'") from error
    kind, version = file.attrs.get("format"), int(file.attrs.get("version", 0))
    if kind == FORMAT and 1 <= version <= VERSION:
        return file
    file.close()
    if kind == FORMAT and version < 1:
        raise FileError(f"{path}: states no format from 1 to {VERSION}; train it again with 'labnnum train'")
    if kind == FORMAT:
        raise FileError(f"{path}: is of format {version}, this program reads up to {VERSION}: update labnnum")
    raise FileError(f"{path}: is no updater{f' but a {kind}' if kind else ''}; give a file made by 'labnnum train'")


def _write(file: Any, updater: Updater, path: Path, model: Model | None) -> None:
    file.attrs.update({"format": FORMAT, "version": VERSION, "code_version": __version__})
    network = file.create_group("network")
    for key, value in updater.network.arrays().items():
        if isinstance(value, np.ndarray):
            network.create_dataset(key, data=value)
        else:
            network.attrs[key] = value
    novelty = file.create_group("novelty")
    novelty.create_dataset("differences", data=updater.novelty.differences)
    novelty.create_dataset("box", data=updater.novelty.box)
    file.create_dataset("frequency", data=updater.frequency)
    file.create_dataset("validation", data=updater.validation)
    if updater.trained_variance is not None:
        file.create_dataset("trained_variance", data=updater.trained_variance)
    file.create_dataset("fingerprint", data=fingerprint(updater.structure))
    features = updater.features.settings()
    large = {key: value for key, value in features.items() if isinstance(value, np.ndarray)}
    for key, value in large.items():
        file.create_dataset(f"features/{key}", data=value)
    about = {
        "parameters": [p.name for p in updater.structure.parameters],
        "bands": [asdict(b) for b in updater.bands],
        "features": {
            "kind": updater.features.kind,
            **{k: v for k, v in features.items() if k not in large},
        },
        "outputs": [asdict(c) for c in updater.outputs],
        "inputs": [asdict(c) for c in updater.inputs],
        "settings": updater.settings,
    }
    if model is not None:
        about["model_file"] = Path(os.path.relpath(model.path.resolve(), path.resolve().parent)).as_posix()
        write_text(file, "model.toml", model.path.read_text(encoding="utf-8"))
    write_json(file, "about", about)


def _read(file: Any, path: Path, structure: Structure | None) -> Updater:
    about = read_json(file, "about")
    if structure is None:
        structure = _remembered(file, path, about)
    require_same(structure, tuple(about["parameters"]), file["fingerprint"][()], str(path))
    group = file["network"]
    arrays = {key: dataset[()] for key, dataset in group.items()}
    for key, since in ADDED.items():
        if key not in arrays and file.attrs["version"] >= since:
            raise FileError(f"{path}: is damaged: network/{key} is missing; train it again with 'labnnum train'")
    scalars = {"degree": int, "kernel": str, "kind": str, "gamma": float}
    arrays |= {key: kind(group.attrs[key]) for key, kind in scalars.items()}
    told = dict(about["features"])
    told |= {key: dataset[()] for key, dataset in file["features"].items()} if "features" in file else {}
    return Updater(
        structure=structure,
        features=make_features(told.pop("kind"), [Band(**b) for b in about["bands"]], **told),
        outputs=tuple(Channel(**c) for c in about["outputs"]),
        inputs=tuple(Channel(**c) for c in about["inputs"]),
        frequency=file["frequency"][()],
        network=RbfNetwork(**arrays),
        novelty=Novelty(file["novelty/differences"][()], file["novelty/box"][()]),
        validation=file["validation"][()],
        settings=about["settings"],
        trained_variance=file["trained_variance"][()] if "trained_variance" in file else None,
    )


def _remembered(file: Any, path: Path, about: dict[str, Any]) -> Structure:
    text = read_text(file, "model.toml")
    if not text:
        raise FileError(f"{path}: does not remember its model; name it with --model")
    return parse_model(text, (path.parent / about["model_file"])).structure


def save_training(path: Path, data: TrainingSet, key: NDArray[np.float64]) -> None:
    """Keep an unfinished training set; a kill while writing leaves the one before."""
    part = path.with_name(f"{path.name}.part")
    with h5py.File(part, "w") as file:
        file.attrs.update({"format": f"{FORMAT}-training", "version": VERSION, "done": data.done})
        file.create_dataset("parameters", data=data.parameters)
        file.create_dataset("features", data=data.features[: data.done])
        file.create_dataset("key", data=key)
    os.replace(part, path)


def load_training(path: Path, key: NDArray[np.float64]) -> TrainingSet | None:
    """The unfinished training set of an interrupted run; None if there is none, or it was of another plan."""
    if not path.is_file():
        return None
    try:
        with h5py.File(path, "r") as file:
            stored: Any = file
            if not np.array_equal(stored["key"][()], key):
                return None
            theta, rows = stored["parameters"][()], stored["features"][()]
            features = np.full((len(theta), rows.shape[1]), np.nan)
            features[: len(rows)] = rows
            return TrainingSet(theta, features, len(rows))
    except (OSError, KeyError) as error:
        raise FileError(f"{path}: the unfinished training set cannot be read ({error}); delete it") from error


def training_key(
    structure: Structure, bands: Sequence[Band], outputs: Sequence[Channel], inputs: Sequence[Channel],
    frequency: NDArray, like: Frf | None = None, options: Mapping[str, Any] | None = None,
) -> NDArray[np.float64]:  # fmt: skip
    """What must agree for an unfinished training set to be continued: all that decides its features, and the version.

    Parameters
    ----------
    structure : Structure
    bands : sequence of Band
        Their weights count.
    outputs, inputs : sequence of Channel
    frequency : ndarray, shape (n_f,)
        Hz.
    like : Frf, optional
        The measurement whose window and random error the training takes.
    options : mapping, optional
        What else `Updater.train` is told: samples, seed, noise, features, network, ...
    """
    about = {
        "version": __version__,
        "places": [structure.base, *structure.dofs],
        "bands": [asdict(b) for b in bands],
        "outputs": [asdict(c) for c in outputs],
        "inputs": [asdict(c) for c in inputs],
        "view": None if like is None else view_settings(like),
        "options": dict(options or {}),
    }
    digest = hashlib.sha256(json.dumps(about, sort_keys=True, default=str).encode())
    if like is not None and like.variance is not None:
        for array in (like.value, like.variance):
            digest.update(np.ascontiguousarray(array).tobytes())
    words = np.frombuffer(digest.digest(), np.uint32).astype(float)
    return np.concatenate([fingerprint(structure), np.asarray(frequency, float), words])
