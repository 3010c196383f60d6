"""A banded friction damper with backlash: laws of force and motion on a component test."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from labnnum.errors import FileError
from sessions.component import ComponentAnswer, identify_tests, read_tests, write_component
from sessions.prove.real_rows import Row

NAME = "friction damper"
TRAIN = ("0.5Hz30lbtension0.5", "1Hz30lbtension0.5")
"""Tests that are fitted to: the small stroke, slow. Judged on: twice the stroke, and twice the fastest."""
PUBLISHED_WORK = {("0.5", "0.5"): 337.0, ("1", "0.5"): 329.0, ("2", "0.5"): 299.0}
"""J a cycle, by frequency (Hz) and stroke (in) as the file names write them."""


def damper(data: Path, examples: Path) -> ComponentAnswer:
    """Laws fitted to the two slow tests of small stroke; the other tests held out."""
    files = sorted(data.glob("*.json"))
    train = [f for f in files if f.stem.removeprefix("ds2_").removesuffix("amplitude") in TRAIN]
    if len(train) < len(TRAIN):
        raise FileError(f"{data}: lacks the tests ds2_*{TRAIN[0]}* and ds2_*{TRAIN[1]}*, which the laws are fitted to")
    channels = examples / "channels.toml"
    return identify_tests(read_tests(train, channels), read_tests([f for f in files if f not in train], channels))


def friction_damper(
    data: Path, examples: Path, out: Path, progress: Callable[[str], None] = lambda text: None
) -> list[Row]:
    """Rows of the comparison: the law, its parameters with intervals, work per cycle, and what other laws leave."""
    found = damper(data, examples)
    progress("drawing the loops")
    every = [*found.tests, *found.held_out]
    told = [_conditions(t.label) for t in every]
    titles = [
        f"{hertz} Hz, {25.4 * float(stroke):.1f} mm{', held out' if i >= len(found.tests) else ''}"
        for i, (hertz, stroke) in enumerate(told)
    ]
    content = write_component(out, found, titles)
    rows = [Row(NAME, "law", content["law"] or "none", "dry friction with backlash", "friction with clearance")]
    rows += [_parameter(name, p) for name, p in (content["parameters"] | content["derived"]).items()]
    beside = content["viscous_beside"]
    rows.append(Row(NAME, "dashpot beside the law, N*s/m", f"{beside['value']:.0f} +- {beside['half_90']:.0f} (90 %)"))
    rows += [
        Row(NAME, f"relative error held out, {f['law']}", f"{f['held_out']:.3f}",
            asked="viscous damping rejected" if f["law"].startswith("viscous") else "")
        for f in content["laws"]
    ]  # fmt: skip
    for title, conditions, t in zip(titles, told, content["tests"], strict=True):
        work = f"{t['work_J']:.0f}; {t['work_law_J']:.0f}; {t['work_viscous_J']:.0f}"
        published = f"{PUBLISHED_WORK[conditions]:.0f}" if conditions in PUBLISHED_WORK else ""
        rows += [
            Row(NAME, f"{title}: relative error of the law; viscous", f"{t['error']:.3f}; {t['error_viscous']:.3f}"),
            Row(NAME, f"{title}: work a cycle, J: measured; law; viscous", work, published),
            Row(NAME, f"{title}: half travel read off the loop; off the law's, mm",
                f"{1e3 * t['half_travel_m']:.2f}; {1e3 * t['half_travel_law_m']:.2f}"),
        ]  # fmt: skip
    return rows


def _parameter(name: str, p: dict[str, Any]) -> Row:
    scale, unit = (1e3, "mm") if p["unit"] == "m" else (1.0, p["unit"])
    value = f"{scale * p['value']:.4g} +- {scale * p['half_90']:.4g} (90 %)"
    lost = name in ("backlash", "half travel", "full travel")
    return Row(NAME, f"{name}, {unit}", value, "about 7 in all" if lost else "")


def _conditions(label: str) -> tuple[str, str]:
    """Frequency (Hz) and stroke (in) as a file's name writes them: ds2_0.5Hz30lbtension1amplitude."""
    hertz, _, rest = Path(label).stem.removeprefix("ds2_").partition("Hz")
    return hertz, rest.partition("tension")[2].removesuffix("amplitude")
