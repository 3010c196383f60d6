"""Diagnosis: locate the mismatch, name the missing physics, model it, and show the fit improve."""

from labnnum.diagnosis.diagnose import diagnose
from labnnum.diagnosis.observe import Observation, observe, observe_all, observe_frf
from labnnum.diagnosis.scatter import Scatter
from labnnum.diagnosis.verdict import Diagnosis, Limits

__all__ = ["Diagnosis", "Limits", "Observation", "Scatter", "diagnose", "observe", "observe_all", "observe_frf"]
