"""The folder of a case: recordings, channels.toml, model.toml and structure.npz, as a user would have them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from sessions.prove.truth import fe
from sessions.prove.truth.bench import Bench
from sessions.prove.truth.session import analyser
from sessions.prove.words import axis_name, own_words, strings

if TYPE_CHECKING:
    from sessions.prove.cases import Case

QUANTITY = {2: ("acceleration", "m/s^2"), 1: ("velocity", "m/s"), 0: ("displacement", "m")}


def write_case(case: Case, folder: Path) -> list[Path]:
    """Write what a user would have (recordings, channels.toml, model.toml, structure.npz); paths of the recordings."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "channels.toml").write_text(channels_toml(case), encoding="utf-8")
    (folder / "model.toml").write_text(model_toml(case), encoding="utf-8")
    if not case.native:
        np.savez(folder / "structure.npz", **matrices(case.state.bench))  # ty: ignore[invalid-argument-type]
    return _write_frf(case, folder) if case.plan.excitation == "frf" else _write_runs(case, folder)


def _write_frf(case: Case, folder: Path) -> list[Path]:
    frequency, H, variance = analyser(case.runs, case.plan)
    sizes = np.array([size for _, size in case.units])
    factor = (sizes[0] / sizes[1:])[:, None, None]
    path = folder / "case_frf.npz"
    np.savez(path, f=frequency, H=H * factor, variance=variance * factor**2)
    return [path]


def _write_runs(case: Case, folder: Path) -> list[Path]:
    names = case.state.channel_names()
    paths = []
    for i, run in enumerate(case.runs):
        rows = {
            name: (row / size).astype(np.float32)
            for name, row, (_, size) in zip(names, run.data, case.units, strict=True)
        }
        path = folder / f"case_run{i + 1:02d}.npz"
        np.savez(path, **rows)
        paths.append(path)
    return paths


def channels_toml(case: Case) -> str:
    """Text of channels.toml."""
    bench, plan = case.state.bench, case.plan
    lines = [f"sample_rate = {plan.rate!r}"]
    if plan.excitation == "frf":
        lines = ["[frf]", 'frequency = "f"', 'value = "H"', 'variance = "variance"']
    if plan.excitation == "multisine":
        lines += [f"period = {plan.samples}", f"drop_periods = {plan.drop}"]
    unit = case.units[0][0]
    if bench.base is not None:
        entry = ("base", "acceleration", unit, "base", bench.feet[0], axis_name(bench, bench.base))
    else:
        assert bench.drive is not None
        entry = ("force", "force", unit, "reference", bench.drive[0], axis_name(bench, bench.drive[1]))
    lines += _channel(*entry)
    for sensor, (unit, _) in zip(bench.sensors, case.units[1:], strict=True):
        direction = ("-" if sensor.sign < 0 else "") + axis_name(bench, sensor.axis)
        lines += _channel(sensor.name, QUANTITY[sensor.order][0], unit, "response", sensor.node, direction)
    return "\n".join(lines) + "\n"


def _channel(name: str, quantity: str, unit: str, role: str, node: str, direction: str) -> list[str]:
    keys = ("name", "quantity", "unit", "role", "node", "direction")
    pairs = zip(keys, (name, quantity, unit, role, node, direction), strict=True)
    return ["", "[[channel]]", *(f'{key} = "{value}"' for key, value in pairs)]


def model_toml(case: Case) -> str:
    """Text of model.toml: the nominal structure, a guess of the damping, parameters and places."""
    bench = case.state.bench
    low, high = bench.band
    lines = [
        *(own_words(bench) if case.native else _of_matrices(bench)),
        "",
        "[damping]",
        'kind = "modal"',
        "ratio = 0.01",
    ]
    for name in bench.zones:
        size = bench.modulus if case.native else 1.0
        prior = {"nominal": size, "lower": 0.8 * size, "upper": 1.2 * size, "std": 0.05 * size}
        lines += ["", "[[parameter]]", f'name = "{name}"', *(f"{key} = {value!r}" for key, value in prior.items())]
        lines += ['unit = "Pa"'] if case.native else []
    lines += ["", "[[band]]", f"low = {low:.6g}", f"high = {high:.6g}", "", "[places]"]
    lines += [f"nodes = {strings(n for n in bench.coarse.named if n not in bench.feet)}"]
    lines += [f"elements = [{', '.join(strings(e) for e in bench.elements)}]"]
    lines += [f"supports = {strings(bench.feet)}"]
    return "\n".join(lines) + "\n"


def _of_matrices(bench: Bench) -> list[str]:
    lines = ["[structure]", 'kind = "matrices"', 'file = "structure.npz"']
    return lines if bench.base is None else [*lines, f'base = "{axis_name(bench, bench.base)}"']


def matrices(bench: Bench) -> dict[str, NDArray]:
    """Arrays of structure.npz: M0, K0, dK_<parameter>, dofs, nodes and xyz, held degrees of freedom included."""
    mesh = bench.coarse
    kept = np.array([d for d in range(mesh.size) if d % fe.DOFS_PER_NODE in mesh.kept])
    name_of = {i: name for name, i in mesh.named.items()}
    turn = np.where((kept % fe.DOFS_PER_NODE == 2) & (bench.swing == "z"), -1.0, 1.0)
    block = np.ix_(kept, kept)
    signs = np.outer(turn, turn)
    M, K, _ = fe.assemble(mesh)
    out = {"M0": M[block] * signs, "K0": K[block] * signs}
    for name, zone in bench.zones.items():
        part = fe.assemble(fe.zone_only(mesh, zone))[1]
        out[f"dK_{name}"] = part[block] * signs
    out["dofs"] = np.array(
        [f"{name_of[d // fe.DOFS_PER_NODE]}:{axis_name(bench, int(d % fe.DOFS_PER_NODE))}" for d in kept]
    )
    out["nodes"] = np.array([name_of[i] for i in range(len(mesh.xy))])
    xyz = np.zeros((len(mesh.xy), 3))
    xyz[:, 0], xyz[:, 1 if bench.swing == "y" else 2] = mesh.xy[:, 0], mesh.xy[:, 1]
    out["xyz"] = xyz
    return out
