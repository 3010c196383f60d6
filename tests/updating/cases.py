"""Measurements made from models, for the tests of the updating room."""

import numpy as np

from labnnum.frf import Frf
from labnnum.parameters import truncated_samples
from labnnum.response import frf
from labnnum.structures.examples import EXAMPLES

LINES = np.linspace(1.0, 6.9, 160)


def truck(outputs=1):
    example = EXAMPLES["truck"]()
    return example.structure, example.outputs[:outputs], example.inputs, example.bands


def measured(structure, theta, frequency, outputs, inputs, relative=0.0, seed=0, known=True):
    value = frf(structure, theta, frequency, outputs, inputs)
    rng = np.random.default_rng(seed)
    scatter = relative * np.abs(value)
    noise = (rng.standard_normal(value.shape) + 1j * rng.standard_normal(value.shape)) * scatter / np.sqrt(2)
    return Frf(frequency, value + noise, outputs, inputs, variance=scatter**2 if known else None)


def truths(structure, n, seed=0):
    return truncated_samples(structure.parameters, np.random.default_rng(seed).random((n, len(structure.parameters))))
