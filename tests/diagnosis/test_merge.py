"""When names of a nonlinear law are kept, and when what it leaves says that it is not all."""

from types import SimpleNamespace

import pytest

from labnnum.diagnosis.nonlinear.decision import strays
from labnnum.diagnosis.nonlinear.merge import _halfway


@pytest.mark.parametrize(
    ("base", "left", "noise", "halfway"),
    [
        (0.20, 0.010, 0.003, False),  # nearly all
        (0.020, 0.011, 0.0035, True),  # half of it, three times the noise
        (0.020, 0.011, 0.009, False),  # half of it, and the rest is noise
        (0.15, 0.056, 0.0026, True),  # far from both
        (0.15, 0.045, 0.0026, False),  # most of it
    ],
)
def test_a_law_that_leaves_a_third_and_no_noise_is_no_name(base, left, noise, halfway):
    found = SimpleNamespace(
        named=("a law",), base_error=(0.0, base), extended_error=(0.0, left), noise=noise,
        study=SimpleNamespace(engine=SimpleNamespace(structure=None)), misfit=1.0, shown=float("nan"),
    )  # fmt: skip
    assert _halfway(found) is halfway
    found.named = ()
    assert not _halfway(found)


@pytest.mark.parametrize(
    ("misfit", "shown", "simulated", "astray"),
    [
        (0.9, 0.012, 0.24, True),  # the motion that was measured is explained, and not the one that is simulated
        (0.9, float("nan"), 0.24, False),  # it is not known
        (0.9, 0.11, 0.24, False),  # neither is
        (9.0, 0.012, 0.24, False),  # what the fit saw is not explained either
        (0.9, 0.001, 0.02, False),  # both are, to noise
    ],
)
def test_a_law_is_not_blamed_for_the_state_in_which_its_simulation_ends(misfit, shown, simulated, astray):
    found = SimpleNamespace(
        named=("a law",), base_error=(0.6, 0.47), extended_error=(0.007, simulated), noise=0.01,
        study=SimpleNamespace(engine=SimpleNamespace(structure=None)), misfit=misfit, shown=shown,
    )  # fmt: skip
    assert strays(found) is astray
    assert _halfway(found) is (not astray and simulated > 0.2)
