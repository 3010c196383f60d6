"""The page: a verdict, the sections, and everything they need in one file."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import Environment, FileSystemLoader, StrictUndefined, Template

from labnnum.errors import FileError
from labnnum.frf import Frf
from sessions.report.content import Content, gather
from sessions.report.figures import excited
from sessions.report.numbers import date, percent, quantity
from sessions.report.sections import SECTIONS, Section, SectionMaker

MARK = "labnnum report</title>"
"""By which a report is known."""


def write_report(
    session: str | os.PathLike[str],
    out: str | os.PathLike[str],
    *,
    sections: Sequence[SectionMaker] = SECTIONS,
    extra: Mapping[str, Any] | None = None,
) -> Path:
    """Path of the HTML report of a session, written to `out`.

    Parameters
    ----------
    session : path
    out : path
        An earlier report is written over, as it holds nothing that the session does not; any other file is not.
    sections : sequence of functions Content -> Section or None
    extra : mapping, optional
        What sections of a caller's own need: `Content.extra`.

    Raises
    ------
    FileError
        If the session cannot be read, or the report cannot be written.
    """
    out = Path(out)
    require_page(out)
    text = render(gather(session, extra), sections)
    part = out.with_name(f".{out.name}.part")
    try:
        part.write_text(text, encoding="utf-8")
        os.replace(part, out)
    except OSError as error:
        with suppress(OSError):
            part.unlink()
        raise FileError(f"{out}: cannot be written ({error.strerror}); choose another place with -o") from error
    return out


def require_page(out: Path) -> None:
    """FileError unless `out` is the name of a page, and free or an earlier report."""
    if out.is_dir():
        raise FileError(f"{out}: is a folder; name the page in it, as in -o {out.name}/report.html")
    if out.is_file() and MARK not in out.read_text(encoding="utf-8", errors="replace")[:2000]:
        raise FileError(f"{out}: exists already, is no report of labnnum, and is not written over; choose another name")
    if out.suffix.lower() not in (".html", ".htm"):
        raise FileError(f"{out}: a report is an .html file; call it {out.stem}.html")


def render(content: Content, sections: Sequence[SectionMaker] = SECTIONS) -> str:
    """HTML of the report."""
    made: list[Section] = [s for s in (make(content) for make in sections) if s is not None]
    return _template().render(
        title=content.path.stem, date=date(content.created), verdict=verdict(content), facts=key_facts(content),
        sections=made, version=content.code_version,
    )  # fmt: skip


def verdict(content: Content) -> tuple[str, str]:
    """One sentence that says what came out, and its kind: "good", "doubt" or "none"."""
    stored = content.estimate
    if stored is None:
        what = "FRFs were estimated; no model was updated." if content.frfs else "Raw data only; nothing estimated yet."
        return what, "none"
    e = stored.estimate
    what = f"{len(e.parameters)} parameter{'s' if len(e.parameters) > 1 else ''} updated"
    if not e.converged:
        return f"{what}, but the refinement did not converge.", "doubt"
    granted = f" and a model error of {percent(stored.floor)}" if stored.floor else ""
    if np.isfinite(e.chi2) and e.chi2 > 2:
        chance = "chance" if not granted else f"what chance{granted} would leave"
        return (
            f"{what}, but the model does not explain the measurement: the misfit is {e.chi2:.3g} times {chance}.",
            "doubt",
        )
    if e.warnings:
        return f"{what}; {len(e.warnings)} warning{'s' if len(e.warnings) > 1 else ''} to read first.", "doubt"
    if np.isfinite(e.chi2):
        return f"{what}; the model explains the measurement within its random error{granted}.", "good"
    return f"{what}; the misfit could not be judged.", "none"


def key_facts(content: Content) -> list[tuple[str, str]]:
    """Figures of the head: (figure, what it is)."""
    facts = []
    if content.runs:
        n, length = len(content.runs), sum(r.duration for r in content.runs)
        facts.append((quantity(length, "s"), f"recorded in {n} run{'s' if n > 1 else ''}"))
    frf = content.frf
    if frf is not None:
        facts.append((f"{len(frf.outputs)} × {len(frf.inputs)}", "responses × inputs"))
        if np.isfinite(frf.n_averages):
            facts.append((f"{frf.n_averages:.3g}", "effective averages"))
        facts += _coherence(frf, content)
    if content.estimate is not None and np.isfinite(content.estimate.estimate.chi2):
        one = "chance and the model error granted" if content.estimate.floor else "chance"
        facts.append((f"{content.estimate.estimate.chi2:.3g}", f"misfit (1 is {one})"))
    return facts


def _coherence(frf: Frf, content: Content) -> list[tuple[str, str]]:
    """Mean coherence where it counts: in the bands of the estimate, else where the input has power."""
    if frf.coherence is None:
        return []
    bands = content.estimate.bands if content.estimate is not None else ()
    where = "in the bands" if bands else "where excited"
    mask = np.zeros(frf.frequency.shape, bool)
    for low, high in bands or (excited(frf),):
        mask |= (frf.frequency >= low) & (frf.frequency <= high)
    found = frf.coherence[:, mask]
    if not np.isfinite(found).any():
        return []
    return [(f"{np.nanmean(found):.3f}", f"mean coherence {where}")]


@lru_cache(maxsize=1)
def _template() -> Template:
    loader = FileSystemLoader(Path(__file__).parent / "templates")
    return Environment(loader=loader, autoescape=True, undefined=StrictUndefined).get_template("page.html")
