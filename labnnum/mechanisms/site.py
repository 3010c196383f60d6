"""The site of a whole structure: what mechanisms need to know of one that stands in a model file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from labnnum.eigen import natural_modes
from labnnum.mechanisms.base import Site
from labnnum.mechanisms.geometry import held_motions, touching
from labnnum.recording import Channel
from labnnum.structures.base import Structure


def site_of(
    structure: Structure, channels: Sequence[Channel] = (), n_outputs: int = 0, drive: Sequence[str] = (), *,
    held: bool = True,
) -> Site:  # fmt: skip
    """The site of a structure with every elastic mode in its band and all places open.

    Motions without mass are no modes. Without `held` what its supports hold is left out, which a structure that floats
    has no answer for.

    Raises
    ------
    ModelError
        If a coordinate has neither mass nor stiffness, or nothing has mass.
    """
    theta = structure.nominal
    m = structure.matrices(theta)
    mass, stiffness = np.real(m.M), np.real(m.K)
    value, shape = natural_modes(mass, stiffness)
    elastic = value > 0
    dofs = {d: np.real(structure.participation(d, theta)) for d in structure.dofs}
    nodes = tuple(dict.fromkeys(d.split(":")[0] for d in structure.dofs))
    rigid = np.real(structure.rigid(theta)) if structure.base else None
    site = Site(
        mass, stiffness, dofs, dict(structure.nodes), nodes, structure.elements, structure.supports, tuple(channels),
        n_outputs, np.sqrt(value[elastic]), shape[:, elastic], rigid, tuple(drive),
        tuple(np.real(d.K) for d in structure.derivatives(theta)), held_motions(structure) if held else {},
    )  # fmt: skip
    mesh = structure.elements or touching(site)
    return replace(site, elements=mesh, mesh=mesh)
