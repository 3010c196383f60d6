"""Structures: one kind a file. Each returns M, C, K and says how its coordinates move its points, nothing else."""

from __future__ import annotations

from labnnum.structures.base import Matrices, Structure
from labnnum.structures.beam import Beam
from labnnum.structures.chain import Chain
from labnnum.structures.frame import Frame
from labnnum.structures.matrices import MatrixStructure
from labnnum.structures.modal import ModalStructure

STRUCTURES: tuple[type[Structure], ...] = (Chain, Beam, Frame, MatrixStructure, ModalStructure)
"""Every kind of structure, in the order of the documentation."""

__all__ = ["STRUCTURES", "Beam", "Chain", "Frame", "MatrixStructure", "Matrices", "ModalStructure", "Structure"]
