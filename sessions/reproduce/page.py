"""One HTML page of a reproduction: tables and figures, self-contained."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

_HEAD = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>labnnum: {title}</title>
<style>
body {{ font: 15px/1.5 system-ui, sans-serif; max-width: 72rem; margin: 2rem auto; padding: 0 1rem; color: #1b2631 }}
pre {{ font: 12.5px/1.45 ui-monospace, monospace; background: #f5f7f9; padding: 0.8rem; overflow-x: auto }}
svg {{ width: 100%; height: auto }}
</style></head><body>
<h1>{title}</h1>
"""


def page(title: str, parts: Sequence[tuple[str, str, Sequence[str]]]) -> str:
    """HTML with one section for each (heading, text table, figures as SVG)."""
    out = [_HEAD.format(title=escape(title))]
    for heading, table, figures in parts:
        out.append(f"<h2>{escape(heading)}</h2>\n<pre>{escape(table)}</pre>\n")
        out += [f"<figure>{figure}</figure>\n" for figure in figures if figure]
    return "".join([*out, "</body></html>\n"])
