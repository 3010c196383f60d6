"""Several runs of the same channels as one Frf."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from labnnum.diagnosis.observe import Observation
from labnnum.errors import ChannelError
from labnnum.frf import Frf
from labnnum.recording import Channel


def what_of(channels: Sequence[Channel]) -> list[tuple[str, str, float, str]]:
    """What each channel is, and where: name, degree of freedom, sense, quantity."""
    return [(c.name, c.dof, c.sign, c.quantity) for c in channels]


def require_one_set_up(observations: Sequence[Observation]) -> None:
    """ChannelError where runs differ in their channels, their places, or the window that they are seen through."""
    first = observations[0]
    channels, decay = (
        what_of((*first.frf.outputs, *first.frf.inputs)),
        float(first.frf.settings.get("window_decay", 0.0)),
    )
    for o in observations[1:]:
        if what_of((*o.frf.outputs, *o.frf.inputs)) != channels:
            raise ChannelError(
                f"{o.label}: its channels, or their places, differ from those of {first.label}; expected one"
                " set-up, or hits at several points with the same sensors"
            )
        if not np.isclose(float(o.frf.settings.get("window_decay", 0.0)), decay, rtol=1e-9, atol=0.0):
            raise ChannelError(
                f"{o.label}: its FRFs are seen through another exponential window than those of {first.label}; expected"
                " hits alone, at one sample rate, or no hits"
            )


def pool(observations: Sequence[Observation]) -> Frf:
    """One Frf from several runs of the same channels: weighted means on shared lines, all lines together.

    A scatter between runs beyond their noise (remounts, level) is added to the variance.
    """
    first = observations[0].frf
    require_one_set_up(observations)
    if len(observations) == 1:
        return first
    step = np.min(np.concatenate([np.diff(o.frf.frequency) for o in observations])) * 0.25
    keys = [np.round(o.frf.frequency / step).astype(int) for o in observations]
    union = np.unique(np.concatenate(keys))
    shape = (*first.value.shape[:2], union.size)
    weight, total = np.zeros(shape), np.zeros(shape, complex)
    raised = np.zeros(shape)
    square, count = np.zeros(shape), np.zeros(union.size)
    where = [np.searchsorted(union, k) for k in keys]
    frequency = np.zeros(union.size)
    for o, at in zip(observations, where, strict=True):
        assert o.frf.variance is not None
        w = 1.0 / np.maximum(o.frf.variance, 1e-300)
        weight[..., at] += w
        total[..., at] += w * o.frf.value
        square[..., at] += w * np.abs(o.frf.value) ** 2
        raised[..., at] += w * (1.0 if o.frf.shared is None else o.frf.shared)
        count[at] += 1
        frequency[at] = o.frf.frequency
    mean = total / weight
    spread = np.maximum(square / weight - np.abs(mean) ** 2, 0)
    between = np.where(count > 1, spread / np.maximum(count - 1, 1), 0.0)
    variance = np.maximum(1.0 / weight, between)
    return replace(first, frequency=frequency, value=mean, variance=variance, coherence=None, input_spectrum=None,
                   input_condition=None, shared=raised / weight)  # fmt: skip
