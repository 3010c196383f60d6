"""Updating: from an FRF to the parameters of a model, by a trained network and by least squares.

The door is `Updater`: `Updater.train(...)` once, `updater.estimate(frf)` for every measurement. `refine` works without
training. How the room is laid out: features.py (what the network sees), training.py and batch.py (training sets),
network.py and fitting.py (the network and how it learns), refine.py with lsq.py, noise.py and covariance.py (least
squares on the FRF), novelty.py and matching.py (what is refused or flagged).
"""

from labnnum.updating.refine import refine
from labnnum.updating.updater import Updater

__all__ = ["Updater", "refine"]
