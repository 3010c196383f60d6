"""Diagnosis of files: recordings and a model in, diagnosis.json, diagnosis.html and extended.toml out."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from labnnum.diagnosis import Diagnosis, Limits, Observation, Scatter, diagnose, observe_all, observe_frf
from labnnum.errors import FileError, InputError
from labnnum.frf import Frf
from labnnum.mechanisms import ExtendedStructure
from labnnum.recording import Recording
from labnnum.structures.base import Structure
from sessions.exchange import read_any
from sessions.levels import per_level
from sessions.limits import read_limits
from sessions.model import Model, read_model, write_model
from sessions.own_mechanisms import catalogue, source_of, sources


def observations_of(paths: Sequence[str | Path], channels: str | Path | None = None) -> list[Observation]:
    """Observations of sessions and importable files: one a recording, one a file of FRFs.

    A session that holds FRFs only gives the last of them.
    """
    out: list[Observation] = []
    recorded: list[Recording] = []
    for path in paths:
        found = read_any(path, channels)
        if isinstance(found, Frf):
            out.append(observe_frf(found, str(path)))
            continue
        if not found:
            raise FileError(f"{path}: holds no recording; import or measure one first")
        recorded += found
    out += observe_all(recorded)
    if not out:
        raise FileError("no recording was given")
    return out


def run(
    recordings: Sequence[str | Path],
    model: Model,
    held_out: Sequence[str | Path] = (),
    channels: str | Path | None = None,
    rig: str | Path | None = None,
    progress: Callable[[str], None] = lambda text: None,
    mechanisms: Sequence[str | Path] = (),
) -> Diagnosis:
    """Read, observe and diagnose; limits and scatter of the rig where it was calibrated.

    Raises
    ------
    InputError
        For files, channels or models that cannot be used.
    """
    progress("reading")
    train = observations_of(recordings, channels)
    test = observations_of(held_out, channels) if held_out else []
    return run_observed(train, model, test, rig, progress, mechanisms)


def run_observed(
    train: Sequence[Observation],
    model: Model,
    test: Sequence[Observation] = (),
    rig: str | Path | None = None,
    progress: Callable[[str], None] = lambda text: None,
    mechanisms: Sequence[str | Path] = (),
) -> Diagnosis:
    """The same from observations, which may have come by different channels.toml files."""
    scatter, limits = read_limits(rig) if rig else (Scatter(), Limits())
    _require_sensors(model, train)
    p = model.places
    places = {k: getattr(p, k) for k in ("nodes", "elements", "supports") if getattr(p, k) is not None}
    span = (0.9 * model.bands[0].low, 1.05 * model.bands[-1].high) if model.bands else None
    d = diagnose(
        model.structure, train, test, places=places, span=span, scatter=scatter, limits=limits, 
        catalogue=catalogue([*mechanisms, *sources(model.raw.get("mechanism", ()), model.path.parent)]),
        progress=progress,
    )  # fmt: skip
    return replace(d, nonlinear={**d.nonlinear, "per_level": per_level([*train, *test])})


def _require_sensors(model: Model, observations: Sequence[Observation]) -> None:
    known = set(model.structure.dofs)
    for o in observations:
        for c in (*o.frf.outputs, *(c for c in o.frf.inputs if c.role != "base")):
            if not c.dof:
                raise InputError(f"{o.label}: channel {c.name!r} has no node and direction; give both in channels.toml")
            if c.dof not in known and ":" in c.dof:
                try:
                    model.structure.participation(c.dof, model.structure.nominal)
                except ValueError as error:
                    raise InputError(f"{o.label}: channel {c.name!r} sits at {c.dof}, and {error}") from error
        if any(c.role == "base" for c in o.frf.inputs) and not model.structure.base:
            raise InputError(
                f"{o.label}: channel {o.frf.inputs[0].name!r} is base motion, but {model.path} has no key"
                ' structure.base; add base = "z" (or its direction)'
            )


def diagnose_files(
    recordings: Sequence[str | Path],
    model: str | Path,
    out: str | Path,
    held_out: Sequence[str | Path] = (),
    channels: str | Path | None = None,
    rig: str | Path | None = None,
    progress: Callable[[str], None] = lambda text: None,
    mechanisms: Sequence[str | Path] = (),
) -> dict[str, Any]:
    """Content of diagnosis.json, written with diagnosis.html and extended.toml into the folder `out`."""
    read = read_model(model)
    d = run(recordings, read, held_out, channels, rig, progress, mechanisms)
    progress("drawing")
    return write_answer(Path(out), read, d)


def write_answer(folder: Path, read: Model, d: Diagnosis) -> dict[str, Any]:
    """diagnosis.json (its content), diagnosis.html and extended.toml in a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    content = d.as_dict()
    (folder / "diagnosis.json").write_text(json.dumps(content, indent=2, allow_nan=False) + "\n", encoding="utf-8")
    write_extended(folder / "extended.toml", read, d)
    from sessions.report.diagnosis import write_page

    write_page(folder / "diagnosis.html", read, d)
    return content


# -------------------------------------------------------------------- extended.toml


def write_extended(path: Path, model: Model, d: Diagnosis) -> None:
    """The model with its updated parameters, fitted damping and named mechanisms, as a model of its own."""
    ratios, theta = np.array([float(f"{z:.6g}") for z in _ratios(d)]), d.detail["final"].point.theta
    tables, factors = dict(model.raw), np.ones(0)
    if tables["structure"].get("kind") == "modal":
        tables, theta, factors = _damped_modes(model, ratios, theta, d.detail["engine"].band_modes)
        tables["structure"] = _moved_modes(tables["structure"], d)
    elif not _keeps_damping(model.structure):
        tables["damping"] = {"kind": "modal", "ratio": ratios.tolist()}
    else:
        factors = _losses(d)
    damped = replace(model, raw=tables)
    write_updated(path, damped, theta, [*_entries(d, path.parent, factors), *_kept_laws(d, model)])


def _damped_modes(
    model: Model, ratios: np.ndarray, theta: np.ndarray, seen: np.ndarray
) -> tuple[dict[str, Any], np.ndarray, np.ndarray]:
    """Tables of a modal structure damped by `ratios`, which ascend in frequency; the parameters; and the factors by
    which modes of the numbers `seen` damp more than a parameter says that they share.
    """
    tables, theta, factors = dict(model.raw), theta.copy(), np.ones(int(seen.max()) + 1)
    own, names = model.structure.parameters[: theta.size], [p.name for p in model.structure.parameters]
    nominal = {p.name: p.nominal for p in own}
    modes = [dict(m) for m in tables["structure"]["mode"]]
    ranked = sorted(modes, key=lambda m: nominal.get(m["frequency"], m["frequency"]))[: ratios.size]
    shared: dict[str, list[int]] = {}
    for i, (mode, ratio) in enumerate(zip(ranked, ratios.tolist(), strict=False)):
        if isinstance(mode["damping_ratio"], str):
            shared.setdefault(mode["damping_ratio"], []).append(i)
        else:
            mode["damping_ratio"] = ratio
    for name, those in shared.items():
        fitted = np.intersect1d(those, seen)
        if fitted.size:
            value = float(np.exp(np.mean(np.log(ratios[fitted]))))
            theta[names.index(name)], factors[fitted] = value, ratios[fitted] / value
    told = {name: theta[names.index(name)] for name in shared}
    tables["structure"] = {**tables["structure"], "mode": modes}
    if told:
        tables["parameter"] = [_reaching(e, told.get(e["name"], e["nominal"])) for e in tables["parameter"]]
    return tables, theta, factors


def _moved_modes(table: Mapping[str, Any], d: Diagnosis) -> dict[str, Any]:
    """The table of a modal structure that was identified, with the frequencies at which the fit has put its modes."""
    engine, point = d.detail["engine"], d.detail["final"].point
    modes = [dict(m) for m in table["mode"]]
    if not table.get("error") or any(isinstance(m["frequency"], str) for m in modes):
        return dict(table)
    frequency = engine.state(point.theta).omega / (2 * np.pi)
    frequency[engine.band_modes] *= 1.0 + point.shift
    ranked = sorted(modes, key=lambda m: m["frequency"])
    for mode, value in zip(ranked, frequency.tolist(), strict=False):
        mode["frequency"] = float(f"{value:.8g}")
    return {**table, "mode": modes}


def _reaching(entry: Mapping[str, Any], value: float) -> dict[str, Any]:
    """A [[parameter]] entry whose bounds hold a value."""
    return {**entry, "lower": min(entry["lower"], float(value)), "upper": max(entry["upper"], float(value))}


def _keeps_damping(structure: Structure) -> bool:
    """Whether damping is more than ratios of modes: dashpots at places, a matrix, or parameters of its own."""
    inner = structure.inner if isinstance(structure, ExtendedStructure) else structure
    damping = getattr(inner, "damping", None)
    if damping is None:
        return False
    if damping.kind == "matrix" or any(isinstance(q, str) for q in damping.quantities):
        return True
    m = replace(inner, damping=type(damping)()).matrices(inner.nominal)  # ty: ignore[invalid-argument-type]
    return bool(np.any(m.C))


def write_updated(path: Path, model: Model, theta: np.ndarray, entries: Sequence[Mapping[str, Any]]) -> None:
    """The model with nominal parameters `theta` and the [[mechanism]] `entries` in place of its own, at `path`."""
    own = {k: v for k, v in model.raw.items() if k != "mechanism"}
    tables = _updated(path, model, own, theta)
    moved = path if tables["structure"] is not own["structure"] else model.path
    write_model(path, replace(model, raw=tables, path=moved), entries)


def _ratios(d: Diagnosis) -> np.ndarray:
    engine, made = d.detail["engine"], d.detail["final"]
    ratios = engine.zeta0.copy()
    ratios[engine.band_modes] = np.exp(made.point.log_zeta)
    return ratios


def _updated(path: Path, model: Model, tables: dict[str, Any], theta: np.ndarray) -> dict[str, Any]:
    """Tables whose nominal parameters are the updated ones; matrices are expanded anew about them."""
    own = model.structure.parameters[: theta.size]
    values = dict(zip((p.name for p in own), theta, strict=True))
    entries = []
    for entry in tables.get("parameter", ()):
        value = float(values.get(entry["name"], entry["nominal"]))
        low, high = float(entry["lower"]), float(entry["upper"])
        entries.append({**entry, "nominal": min(max(value, low), high)})
    if entries:
        tables = {**tables, "parameter": entries}
    if "file" not in tables["structure"]:
        return tables
    from sessions.matrix_file import read_matrix_file

    arrays = dict(read_matrix_file(model.path.parent / tables["structure"]["file"]))
    for p in own:
        for base, slope in (("M0", f"dM_{p.name}"), ("K0", f"dK_{p.name}"), ("C0", f"dC_{p.name}")):
            if slope in arrays and base in arrays:
                arrays[base] = arrays[base] + (values[p.name] - p.nominal) * arrays[slope]
    name = f"{path.stem}.npz"
    np.savez(path.parent / name, **arrays)  # ty: ignore[invalid-argument-type]
    return {**tables, "structure": {**tables["structure"], "file": name}}


def _entries(d: Diagnosis, folder: Path, factors: np.ndarray) -> list[dict[str, Any]]:
    """[[mechanism]] entries: what the model held already, what was named, and the trim of frequencies and of damping.

    `factors` says by how much each mode damps more than the structure with its parameters does.
    """
    out: list[dict[str, Any]] = []
    fitted = d.detail["bayes"]
    std = np.sqrt(np.diag(fitted.covariance))[fitted.n_theta :]
    at = 0
    for term in fitted.terms:
        place = {k: v for k, v in term.place.as_dict().items() if v is not None}
        told = next((n.std for n in d.named if n.term is term), std[at : at + term.n])
        values = zip(term.parameters, fitted.point.terms[at:], told, strict=False)
        entry: dict[str, Any] = {
            "id": term.mechanism.id,
            "place": place,
            "parameters": {p.name: {"value": float(v), "std": float(s), "unit": p.unit} for p, v, s in values},
        }
        own = source_of(term.mechanism)
        if own is not None:
            entry["file"] = Path(os.path.relpath(own, folder.resolve())).as_posix()
        if term.variant:
            entry["variant"] = term.variant
        if term.data.get("extra_mode"):
            train = d.detail["train"]
            entry["dofs"] = [c.dof for c in train.outputs]
            entry["driven"] = [c.dof for c in train.inputs if c.role != "base"]
        out.append(entry)
        at += term.n
    out += _nonlinear_entries(d)
    engine, made = d.detail["engine"], d.detail["final"]
    shift = np.zeros(int(engine.band_modes.max()) + 1)
    shift[engine.band_modes] = made.point.shift
    trim = {"shift": shift} if np.any(np.abs(shift) > 1e-6) else {}
    trim |= {"damping": factors} if np.any(np.abs(factors - 1.0) > 1e-6) else {}
    if trim:
        out.append({"id": "modal-trim", **{k: [float(f"{v:.5g}") for v in values] for k, values in trim.items()}})
    return out


def _losses(d: Diagnosis) -> np.ndarray:
    """Factor by which each mode damps more than the structure says at the fitted parameters."""
    engine, theta = d.detail["engine"], d.detail["final"].point.theta
    state, m = engine.state(theta), engine.structure.matrices(theta)
    own = np.einsum("nm,nk,km->m", state.shape, np.real(m.C), state.shape)
    own = own + np.einsum("nm,nk,km->m", state.shape, np.real(m.D), state.shape) / np.maximum(state.omega, 1e-300)
    omega = state.omega.copy()
    omega[engine.band_modes] *= 1 + d.detail["final"].point.shift
    wanted = 2 * _ratios(d)[: omega.size] * omega
    free = np.setdiff1d(engine.band_modes, np.arange(engine.rigid_modes))
    fitted = free[own[free] > 1e-12 * own.max()]
    out = np.ones(int(engine.band_modes.max()) + 1)
    out[fitted] = wanted[fitted] / own[fitted]
    return out


def _kept_laws(d: Diagnosis, model: Model) -> list[dict[str, Any]]:
    """[[mechanism]] entries of what the model held and no linear search sees: nonlinear laws, unless others were named,
    and what the recorder does to all channels.
    """
    structure = model.structure
    if not isinstance(structure, ExtendedStructure):
        return []
    ids = {one.term.mechanism.id for one in structure.common}
    if not any(n.term.mechanism.domain == "nonlinear" for n in d.named):
        ids |= {law.term.mechanism.id for law in structure.laws}
    return [dict(entry) for entry in model.raw.get("mechanism", ()) if entry.get("id") in ids]


def _nonlinear_entries(d: Diagnosis) -> list[dict[str, Any]]:
    """[[mechanism]] entries of the nonlinear laws that were named, and of the recorder's filter beside them."""
    found = d.detail.get("nonlinear")
    return [
        {
            "id": n.term.mechanism.id,
            "place": {k: v for k, v in n.place.as_dict().items() if v is not None},
            **({"variant": n.term.variant} if n.term.variant else {}),
            "parameters": {
                p.name: {"value": float(v), "std": float(s), "unit": p.unit}
                for p, v, s in zip(n.term.parameters, n.value, n.std, strict=True)
            },
        }
        for n in (found.named if found is not None else ())
    ]
