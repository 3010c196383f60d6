"""joint-stiffness: an element or joint softer or stiffer than the model has it; a crack; a joint that is not rigid."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import final

import numpy as np

from labnnum.mechanisms.base import ROTATIONS, Mechanism, Place, Site, Term, scalar_term
from labnnum.mechanisms.geometry import element_gain, element_stiffness, factors
from labnnum.mechanisms.laws import Compliance, Spring


@final
@dataclass(frozen=True)
class JointStiffness(Mechanism):
    """K_e (1 + d) for an element, or a hinge of compliance c within it or at either end."""

    id = "joint-stiffness"
    title = "joint or element of another stiffness"
    equation = "f = d K_e u, or hinge angle = c moment"
    shows = "shifts that follow each mode's strain there"
    told_apart = "a parameter error elsewhere has another pattern over the modes"
    symbol = "zigzag between nodes"
    reference = "Ostachowicz and Krawczuk (1991); Friswell and Mottershead (1995), section 7"

    def terms(self, site: Site) -> Iterable[Term]:
        """The whole element's factor, then hinges in its middle and at its ends."""
        for a, b in site.elements:
            found = element_stiffness(site, a, b)
            if found is None:
                continue
            index, k, directions = found
            place = Place("element", a, b)
            n = site.stiffness.shape[0]
            whole = np.zeros((n, factors(k).shape[1]))
            whole[index] = factors(k)
            gain = element_gain(site, a, b)
            term = scalar_term(
                self,
                site,
                place,
                Spring(("relative_change",), ("1",)),
                whole,
                positive=False,
                lower=-0.98,
                variant="element",
                gain=gain,
            )
            if term is not None:
                yield term
            yield from self._hinges(site, place, index, k, directions)

    def _hinges(
        self, site: Site, place: Place, index: list[int], k: np.ndarray, directions: list[str]
    ) -> Iterable[Term]:
        half = len(directions) // 2
        for axis in ROTATIONS:
            at = [i for i, d in enumerate(directions) if d == axis]
            if not at:
                continue
            ends = {f"hinge {axis} end {i + 1}": np.eye(len(directions))[:, j] for i, j in enumerate(at)}
            if len(at) == 2 and half:
                ends[f"hinge {axis} middle"] = (
                    np.eye(len(directions))[:, at[1]] - np.eye(len(directions))[:, at[0]]
                ) / 2
            for variant, v in ends.items():
                load, kappa = k @ v, float(v @ k @ v)
                if kappa <= 0:
                    continue
                column = np.zeros((site.stiffness.shape[0], 1))
                column[index, 0] = load / kappa
                law = Compliance(kappa, ("compliance_turn",), ("rad/(N*m)",))
                term = scalar_term(self, site, place, law, column, variant=variant)
                if term is not None:
                    yield term

    def sense(self, term: Term, p: np.ndarray) -> str | None:
        """Either "loss" where the joint is softer than the model has it, "gain" where it is stiffer."""
        softer = p[0] < 0 if term.variant == "element" else p[0] > 0
        return "loss" if softer else "gain"
