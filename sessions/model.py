"""model.toml: the structure, what may be updated, the bands, and where mechanisms may act.

    [structure]
    kind = "matrices"                # or chain, beam, frame, modal
    file = "structure.npz"           # relative to this file

docs/models.md describes every key of every kind.
"""

from __future__ import annotations

import hashlib
import json
import os
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from labnnum.bands import Band, check_bands
from labnnum.errors import ConfigError, InputError
from labnnum.structures import Structure
from sessions.matrix_file import read_matrix_file
from sessions.model_common import Common
from sessions.model_tables import KINDS
from sessions.toml import parse, read_toml, strangers
from sessions.toml_write import dumps


@dataclass(frozen=True, slots=True)
class Places:
    """Where a mechanism may act; None means everywhere."""

    nodes: tuple[str, ...] | None = None
    elements: tuple[tuple[str, str], ...] | None = None
    supports: tuple[str, ...] | None = None


@dataclass(frozen=True, eq=False)
class Model:
    """A model file, read.

    Parameters
    ----------
    structure : Structure
    bands : tuple of Band
        Sorted by frequency; empty if the file has none.
    places : Places
    raw : mapping
        The file's tables as they stand.
    path : Path
    """

    structure: Structure
    bands: tuple[Band, ...]
    places: Places
    raw: Mapping[str, Any]
    path: Path


def read_model(path: str | Path) -> Model:
    """The model in a TOML file.

    Raises
    ------
    FileError
        If the file, or the file of matrices that it names, is missing or damaged.
    ConfigError
        One line that names file, key and what was expected.
    """
    path = Path(path)
    return parse_model(read_toml(path), path)


def parse_model(text: str, path: Path) -> Model:
    """The model in a TOML text; `path` is named in messages, and files are found relative to it."""
    table = parse(text, _kind(text, path), str(path))
    for where, key, known in strangers(table):
        raise ConfigError(f"{path}: {where}{key} is no key; there are {', '.join(dict.fromkeys(known))}")
    raw = tomllib.loads(text)
    try:
        structure = table.structure.build(table, path.parent)  # ty: ignore[missing-attribute]
        bands = check_bands([b.build() for b in table.band]) if table.band else ()
        places = _places(table, structure)
        if table.mechanism:
            structure = _extended(structure, raw["mechanism"], path.parent)
    except InputError as error:
        said = str(error)
        raise type(error)(said if said.startswith(str(path.parent / "")) else f"{path}: {said}") from error
    return Model(structure, bands, places, raw, path)


def write_model(
    path: str | Path, model: Model | Mapping[str, Any], mechanisms: Sequence[Mapping[str, Any]] = ()
) -> None:
    """Write a model's tables, with further `mechanisms`, so that `read_model` reads the same structure back.

    The file of matrices is not copied: the key `file` is written relative to the new place.
    """
    path = Path(path)
    raw = dict(model.raw if isinstance(model, Model) else model)
    if isinstance(model, Model) and "file" in raw["structure"]:
        moved = os.path.relpath((model.path.parent / raw["structure"]["file"]).resolve(), path.resolve().parent)
        raw["structure"] = {**raw["structure"], "file": Path(moved).as_posix()}
    if mechanisms:
        raw["mechanism"] = [*raw.get("mechanism", ()), *mechanisms]
    path.write_text(dumps(raw), encoding="utf-8")


def fingerprint(model: Model) -> str:
    """Sixteen hexadecimal digits that change with the structure, its parameters, damping, bands or mechanisms.

    Layout, comments and the order of keys do not matter, nor does [places]; of a file of matrices the arrays count,
    not its name.
    """
    content = {k: v for k, v in model.raw.items() if k != "places"}
    digest = hashlib.sha256()
    if "file" in content["structure"]:
        arrays = read_matrix_file(model.path.parent / content["structure"]["file"])
        content["structure"] = {k: v for k, v in content["structure"].items() if k != "file"}
        for name in sorted(arrays):
            digest.update(name.encode())
            digest.update(np.ascontiguousarray(arrays[name]).tobytes())
    digest.update(json.dumps(_canonical(content), sort_keys=True).encode())
    return digest.hexdigest()[:16]


def _canonical(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {k: _canonical(v) for k, v in value.items()}
    if isinstance(value, list):
        return [_canonical(v) for v in value]
    return float(value) if isinstance(value, int) and not isinstance(value, bool) else value


def _kind(text: str, path: Path) -> type[Common]:
    try:
        structure = tomllib.loads(text).get("structure")
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(f"{path}: is not TOML: {error}") from error
    if not isinstance(structure, Mapping):
        raise ConfigError(f"{path}: the table [structure] is missing; it needs kind = one of {', '.join(KINDS)}")
    kind = structure.get("kind")
    if kind not in KINDS:
        said = "missing" if kind is None else repr(kind)
        raise ConfigError(f"{path}: structure.kind is {said}: expected one of {', '.join(KINDS)}")
    return KINDS[kind]


def _places(table: Common, structure: Structure) -> Places:
    """Places as said, each of which the structure must have."""
    p = table.places
    known = {d.partition(":")[0] for d in structure.dofs} | set(structure.supports) | set(structure.nodes) | {"ground"}
    named = [("nodes", n) for n in p.nodes or ()] + [("supports", n) for n in p.supports or ()]
    named += [("elements", n) for pair in p.elements or () for n in pair]
    for key, node in named:
        if node not in known:
            shown = ", ".join(sorted(known)[:12]) + (", ..." if len(known) > 12 else "")
            raise ConfigError(f"places.{key}: the structure has no node {node!r}; it has {shown}")
    return Places(p.nodes, p.elements, p.supports)


def _extended(structure: Structure, entries: Sequence[Mapping[str, Any]], folder: Path) -> Structure:
    """The structure with the mechanisms of [[mechanism]] added; entries of users' own name their file."""
    from labnnum.mechanisms import extend
    from sessions.own_mechanisms import catalogue, sources

    return extend(structure, entries, catalogue(sources(entries, folder)))
