"""Figures that are kept beside a text: SVG files as small as they can be drawn."""

from __future__ import annotations

import re
from pathlib import Path

from matplotlib.figure import Figure

from sessions.report.figures import svg


def write_svg(path: Path, figure: Figure) -> None:
    """A figure as SVG: coordinates to a tenth of a point, no indents, comments or ids that nothing refers to.

    Nothing that can be seen is lost. The ids are the file's own, so that only one such file fits in a page of HTML.
    """
    text = re.sub(r"<!--.*?-->", "", svg(figure), flags=re.DOTALL)
    text = re.sub(r'\b(d|x|y)="[^"]*"', lambda found: _rounded(found[0]), text)
    used = dict.fromkeys(re.findall(r'href="#([^"]+)"', text) + re.findall(r"url\(#([^)]+)\)", text))
    short = {name: f"i{number}" for number, name in enumerate(used)}
    text = re.sub(r' id="([^"]+)"', lambda found: f' id="{short[found[1]]}"' if found[1] in short else "", text)
    text = re.sub(r'(?<=href="#)([^"]+)|(?<=url\(#)([^)]+)', lambda found: short[found[0]], text)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(re.sub(r">\s+<", "><", text).strip() + "\n", encoding="utf-8")


def _rounded(text: str) -> str:
    return re.sub(r"\s+", " ", re.sub(r"\d+\.\d\d+", lambda x: f"{float(x[0]):.1f}".removesuffix(".0"), text))
