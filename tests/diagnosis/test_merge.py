"""When names of a nonlinear law are kept, and when what it leaves says that it is not all."""

from types import SimpleNamespace

import pytest

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
        study=SimpleNamespace(engine=SimpleNamespace(structure=None)),
    )  # fmt: skip
    assert _halfway(found) is halfway
    found.named = ()
    assert not _halfway(found)
