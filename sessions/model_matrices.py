"""[structure] of kind matrices: what a finite element program exported."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import numpy as np

from labnnum.errors import ConfigError
from labnnum.parameters import Parameter
from labnnum.structures import MatrixStructure, Structure
from labnnum.structures.quantities import Damping
from sessions.matrix_file import read_matrix_file
from sessions.model_common import Base, Common, Point3, StructureTable, Text


class MatrixTable(StructureTable):
    """[structure] of kind matrices."""

    kind: Literal["matrices"]
    file: str
    base: Base = ""
    supports: tuple[Text, ...] | None = None

    def build(self, common: Common, folder: Path) -> Structure:
        """The structure in the file."""
        path = folder / self.file
        held = read_matrix_file(path)
        damping = common.damping_model
        if common.damping is None and "C0" in held:
            damping = Damping("matrix")
        dofs = tuple(str(d) for d in held["dofs"].reshape(-1))
        clamped, carried = self._supports(common, dofs, held["K0"])
        for name in _unmoved(common.parameters, held, damping):
            raise ConfigError(
                f"{path}: parameter {name!r} has neither dM_{name} nor dK_{name} (nor dC_{name} with damping of kind"
                " matrix), and the damping does not name it"
            )
        return MatrixStructure(
            M0=held["M0"],
            K0=held["K0"],
            all_dofs=dofs,
            C0=held.get("C0"),
            dM=_slopes(held, "dM_", common),
            dK=_slopes(held, "dK_", common),
            dC=_slopes(held, "dC_", common),
            parameters=common.parameters,
            damping=damping,
            base=self.base,
            clamped=clamped,
            positions=_positions(path, held),
            pairs=_pairs(held, common),
            carried=carried,
        )

    def _supports(
        self, common: Common, dofs: tuple[str, ...], stiffness: Any
    ) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """Clamped and carried nodes: as said, else those of [places] that nothing in K0 holds are clamped."""
        if self.supports is not None:
            return self.supports, ()
        named = common.places.supports or ()
        held = {n for n in named if _is_held(n, dofs, stiffness)}
        return tuple(n for n in named if n not in held), tuple(n for n in named if n in held)


def _is_held(node: str, dofs: tuple[str, ...], stiffness: Any) -> bool:
    """Whether K0 resists the rigid translation of the whole structure at this node."""
    if stiffness.shape != (len(dofs), len(dofs)):
        return False
    ways = [d.partition(":")[2] for d in dofs]
    here = [i for i, d in enumerate(dofs) if d.partition(":")[0] == node]
    for way in {"x", "y", "z"} & {ways[i] for i in here}:
        rigid = np.array([float(w == way) for w in ways])
        force = np.abs(stiffness @ rigid)[here]
        if (force > 1e-6 * (np.abs(stiffness) @ rigid)[here].max(initial=0.0)).any():
            return True
    return False


def _unmoved(parameters: tuple[Parameter, ...], held: Mapping[str, Any], damping: Damping) -> list[str]:
    keys = ("dM_", "dK_", "dC_") if damping.kind == "matrix" else ("dM_", "dK_")
    named = {q for q in damping.quantities if isinstance(q, str)}
    return [p.name for p in parameters if p.name not in named and not any(k + p.name in held for k in keys)]


def _slopes(held: Mapping[str, Any], prefix: str, common: Common) -> dict[str, Any]:
    return {p.name: held[prefix + p.name] for p in common.parameter if prefix + p.name in held}


def _positions(path: Path, held: Mapping[str, Any]) -> dict[str, Point3]:
    if ("nodes" in held) != ("xyz" in held):
        raise ConfigError(f"{path}: nodes and xyz belong together: give both or none")
    if "nodes" not in held:
        return {}
    names, xyz = held["nodes"].reshape(-1), held["xyz"]
    if xyz.shape != (names.size, 3):
        raise ConfigError(f"{path}: xyz has shape {xyz.shape}: expected {(names.size, 3)}, a row for each of nodes")
    return {str(n): (float(p[0]), float(p[1]), float(p[2])) for n, p in zip(names, xyz, strict=True)}


def _pairs(held: Mapping[str, Any], common: Common) -> tuple[tuple[str, str], ...]:
    if "elements" in held:
        return tuple((str(a), str(b)) for a, b in held["elements"].reshape(-1, 2))
    return common.places.elements or ()
