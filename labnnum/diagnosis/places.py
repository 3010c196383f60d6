"""Where missing physics may act: the model's [places], or everything that the structure shows."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from labnnum.diagnosis.engine import Engine
from labnnum.errors import ModelError
from labnnum.mechanisms.attached import in_structure
from labnnum.mechanisms.base import Mechanism, Site, Term
from labnnum.mechanisms.geometry import touching


@dataclass(frozen=True, slots=True)
class Places:
    """Nodes, elements and supports where mechanisms may act."""

    nodes: tuple[str, ...]
    elements: tuple[tuple[str, str], ...]
    supports: tuple[str, ...]


def places_of(engine: Engine, given: Mapping[str, Sequence] | None = None) -> Places:
    """Places from a model's [places] table; what it leaves out is taken from the structure.

    Raises
    ------
    ModelError
        If it names a node that the structure does not have.
    """
    given = given or {}
    structure = engine.structure
    own = tuple(dict.fromkeys(d.split(":")[0] for d in structure.dofs))
    known = set(own) | set(structure.nodes) | set(structure.supports)
    nodes = tuple(str(n) for n in given["nodes"]) if "nodes" in given else own
    supports = tuple(str(n) for n in given["supports"]) if "supports" in given else tuple(structure.supports)
    if "elements" in given:
        elements = tuple((str(a), str(b)) for a, b in given["elements"])
    else:
        site = engine.site(nodes, (), supports)
        elements = structure.elements or touching(site)
    for name in [*nodes, *supports, *(n for pair in elements for n in pair)]:
        if name not in known:
            raise ModelError(f"[places] names node {name!r}, which the structure does not have")
    return Places(tuple(n for n in nodes if n in own), elements, supports)


def all_terms(engine: Engine, places: Places, catalogue: Iterable[Mechanism]) -> tuple[Site, list[Term]]:
    """The site and every mechanism of the catalogue at every place where it can act."""
    site = engine.site(places.nodes, places.elements, places.supports)
    floats = engine.rigid_modes > 0
    terms = [t for m in catalogue if m.domain != "nonlinear" for t in m.terms(site)]
    return site, [in_structure(t, floats=floats) for t in terms]
