"""What ordinary coherence mixes, told apart: noise, nonlinear distortion, transients and leakage."""

from labnnum.split.base import Share, Split
from labnnum.split.hits import split_hits
from labnnum.split.periods import split_periods
from labnnum.split.record import split_record

__all__ = ["Share", "Split", "split_hits", "split_periods", "split_record"]
