"""Lines of the comparison that `labnnum prove real` prints."""

from __future__ import annotations

from dataclasses import dataclass

from labnnum.diagnosis import Diagnosis


@dataclass(frozen=True)
class Row:
    """One line of the comparison.

    Parameters
    ----------
    recording, measure : str
        What was measured on which recording.
    found : str
        Run here.
    published : str
        What others report; it is not run here.
    asked : str
        What this program was built to reach.
    """

    recording: str
    measure: str
    found: str
    published: str = ""
    asked: str = ""


def said(d: Diagnosis) -> str:
    """Verdict with names and places, in a line."""
    names = "; ".join(f"{n.term.mechanism.id} at {n.place}" for n in d.named)
    return f"{d.verdict}: {names}" if names else f"{d.verdict} at {d.place}"
