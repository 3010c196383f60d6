"""Verdict: one check, what it found, and what to do about it."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Verdict:
    """Outcome of one check; true where it passed, so that `all(verdicts)` judges a list.

    Parameters
    ----------
    name : str
        The check: "coherence", "double hit", "overload", "leakage" and so on.
    ok : bool
    value, limit : float
        What was found and what it was held against; NaN where a number says nothing.
    reason : str
        One line for a person: what was found, where, and if it is not good the likely cause and the remedy.
    channel : str
        The channel it is about, empty if none.

    Examples
    --------
    >>> bool(Verdict("level", False, 0.1, 0.5, "force peak 0.1 N is below 0.5 N: hit harder"))
    False
    """

    name: str
    ok: bool
    value: float
    limit: float
    reason: str
    channel: str = ""

    def __bool__(self) -> bool:
        return self.ok
