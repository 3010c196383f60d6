"""A real law under hits of one level: whatever the linear search ends in, it is said that one level cannot tell."""

import numpy as np

from labnnum.diagnosis import diagnose, observe_all
from labnnum.nonlinear import Element
from labnnum.recording import Recording
from tests.diagnosis.test_nonlinear_records import RATE, blow, chain, joint_23, recorded


def hits(elements, count=4):
    """Blows of one level on a chain with these laws, and some noise on every channel."""
    out = []
    for seed in range(count):
        made = recorded(blow((1 + 0.05 * seed) * 150.0), elements, chain(12.0))
        rng = np.random.default_rng(seed)
        noise = 1e-3 * np.std(made.data, axis=1, keepdims=True) * rng.standard_normal(made.data.shape)
        out.append(Recording(made.channels, made.data + noise, RATE, label=f"hit {seed}"))
    return out


def test_a_hardening_spring_under_hits_of_one_level_is_not_called_linear_without_a_word():
    observations = observe_all(hits([Element("cubic", joint_23(), (3e4,))]))
    assert [o.kind for o in observations] == ["hammer"]
    found = diagnose(chain(12.0), observations, depth=1)
    assert found.verdict in ("missing-physics", "unexplained"), found.summary
    assert all(n.term.mechanism.domain != "nonlinear" for n in found.named)
    assert "All hits are of one level: that cannot tell linear from nonlinear" in found.summary
    assert "One level cannot tell linear from nonlinear" in found.next_experiment
