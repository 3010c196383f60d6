"""What an FRF's coherence mixes, told apart beside it: splits and harmonics of sweeps, stored in the session."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from labnnum.errors import ChannelError, EstimationError
from labnnum.estimators import Hits, Welch
from labnnum.orders import Orders, is_sweep, orders
from labnnum.recording import Channel, Recording
from labnnum.split import Split, split_hits, split_periods, split_record
from labnnum.split.base import SURE
from sessions.store import Result, Session

KIND = "split"
"""Kind of the stored result."""

GROUPS = ("parts", "beside", "chance", "common")


@dataclass(frozen=True, eq=False)
class Told:
    """What was told apart beside one FRF.

    Parameters
    ----------
    frf : str
        Its path in the session.
    split : Split or None
        None where none could be made: `untold` says why.
    harmonics : Orders or None
        Of the first record, where it is a sweep.
    untold : str
        Why there is no split, or no harmonics of a sweep.
    """

    frf: str
    split: Split | None
    harmonics: Orders | None = None
    untold: str = ""

    def as_dict(self, bands: Sequence[tuple[float, float]] = ()) -> dict[str, Any]:
        """For JSON: kind, remarks, a row for each response and band (octaves if none are given), and of a sweep a row
        for each channel and order.
        """
        if self.split is None:
            return {"untold": self.untold}
        remarks = [*self.split.remarks, *([self.untold] if self.untold else [])]
        out: dict[str, Any] = {"kind": self.split.kind, "remarks": remarks}
        out["bands"] = self.split.table(bands)
        if self.harmonics is not None:
            out["harmonics"] = self.harmonics.table()
        return out


def tell_apart(
    recordings: Sequence[Recording], processor: Hits | Welch, lines: Sequence[int] | None = None, frf: str = ""
) -> Told:
    """What lowers the coherence of recordings that belong together, and the harmonics of a sweep.

    Parameters
    ----------
    recordings : sequence of Recording
        Without what is overloaded.
    processor : Hits or Welch
        As in the estimate; periodic recordings are split by their periods all the same.
    lines : sequence of int, optional
        Lines that were played, where the bench knows them.
    frf : str
        Path of the FRF that it belongs to.
    """
    try:
        if recordings[0].period:
            made = split_periods(list(recordings), None if lines is None else np.array(lines))
        elif isinstance(processor, Hits):
            made = split_hits(list(recordings), processor)
        else:
            made = split_record(list(recordings), processor)
    except (ChannelError, EstimationError) as error:
        return Told(frf, None, untold=str(error))
    try:
        return Told(frf, made, _harmonics(recordings[0]))
    except EstimationError as error:
        return Told(frf, made, untold=str(error))


def _harmonics(recording: Recording) -> Orders | None:
    """Of a sweep; None of anything else."""
    if len(recording.inputs) != 1 or recording.burst:
        return None
    start, stop = max(recording.spans(), key=lambda span: span[1] - span[0])
    n, first = recording.period, start + recording.drop_periods * recording.period
    u = recording.data[recording.inputs[0], first : first + n] if n else recording.data[recording.inputs[0], start:stop]
    return orders(recording) if u.size >= 64 and is_sweep(u) else None


def store_told(session: Session, told: Told, name: str) -> str:
    """Keep it beside its FRF; the path in the session."""
    payload: dict[str, Any] = {"frf": told.frf, "untold": told.untold}
    arrays = {}
    if told.split is not None:
        s = told.split
        payload["split"] = {
            "kind": s.kind, "outputs": [asdict(c) for c in s.outputs], "remarks": list(s.remarks),
            "related": dict(s.related), **{g: list(getattr(s, g)) for g in GROUPS},
        }  # fmt: skip
        arrays |= {"frequency": s.frequency, "coherence": s.coherence}
        arrays |= {f"{g}: {k}": v for g in GROUPS for k, v in getattr(s, g).items()}
        payload["bands"] = told.as_dict()["bands"]
    if told.harmonics is not None:
        h = told.harmonics
        payload["harmonics"] = {
            "order": list(h.order), "channels": [asdict(c) for c in h.channels], "table": h.table(),
        }  # fmt: skip
        arrays |= {f"harmonics: {k}": getattr(h, k) for k in ("frequency", "amplitude", "noise")}
    return session.add_result(KIND, name, payload, arrays)


def read_told(result: Result) -> Told:
    """What `store_told` kept."""
    p, a = result.payload, result.arrays
    split = harmonics = None
    if "split" in p:
        s = p["split"]
        groups: dict[str, Mapping[str, Any]] = {g: {k: a[f"{g}: {k}"] for k in s[g]} for g in GROUPS}
        split = Split(
            s["kind"], a["frequency"], tuple(Channel(**c) for c in s["outputs"]), a["coherence"],
            related=s["related"], remarks=tuple(s["remarks"]), **groups,
        )  # fmt: skip
    if "harmonics" in p:
        h = p["harmonics"]
        harmonics = Orders(
            a["harmonics: frequency"], tuple(h["order"]), a["harmonics: amplitude"], a["harmonics: noise"],
            tuple(Channel(**c) for c in h["channels"]),
        )  # fmt: skip
    return Told(p["frf"], split, harmonics, p["untold"])


def told_of(results: Sequence[Result], frf: str) -> Told | None:
    """The newest that belongs to an FRF; None where none was kept."""
    mine = [r for r in results if r.kind == KIND and r.payload.get("frf") == frf]
    return read_told(mine[-1]) if mine else None


def in_words(told: Told, bands: Sequence[tuple[float, float]] = ()) -> list[str]:
    """Lines for a terminal: of each response where its coherence goes, over each band, else all lines; what was not
    told; and the harmonics of a sweep.
    """
    if told.split is None:
        return [f"what lowers the coherence is not told apart: {told.untold}"]
    split, out = told.split, [told.untold] if told.untold else []
    ranges = split.bands(bands) if bands else [(float(split.frequency[0]), float(split.frequency[-1]))]
    for row in split.table(ranges):
        parts = ", ".join(f"{name} {shown(**share)}" for name, share in row["parts"].items())
        beside = ", ".join(f"{name} {shown(**share)}" for name, share in row["beside"].items() if share["seen"])
        out.append(
            f"{row['response']}, {row['low']:.4g} to {row['high']:.4g} Hz: coherence over all {WHAT[split.kind]} lacks"
            f" {100 * row['lost']:.2g} % of one: {parts}{f'; beside it {beside}' if beside else ''}"
        )
    for h in told.harmonics.table() if told.harmonics is not None else ():
        if h["largest_db"] is not None:
            out.append(
                f"{h['channel']}: order {h['order']} {h['power_db']:.1f} dB relative to the fundamental (floor"
                f" {h['floor_db']:.1f} dB), most at {h['at_hz']:.4g} Hz: {h['largest_db']:.1f} dB"
            )
    return out


WHAT = {"periods": "periods", "record": "segments", "hits": "hits"}


def shown(share: float, std: float, seen: bool) -> str:
    """A share in percent, or the limit below which it lies.

    Examples
    --------
    >>> shown(0.0312, 0.001, True), shown(0.0004, 0.001, False)
    ('3.1 %', 'below 0.4 %')
    """
    return f"{100 * share:.2g} %" if seen else f"below {100 * (max(share, 0.0) + SURE * std):.1g} %"
