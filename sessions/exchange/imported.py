"""From arrays and a channels.toml to runs, recordings and FRFs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from labnnum.errors import ChannelError, ConfigError, FileError
from labnnum.frf import Frf
from labnnum.recording import Recording
from sessions.channels import ChannelMap, FrfRow, RunTable, Source
from sessions.exchange.arrays import Arrays, even_rate
from sessions.tables import StoredChannel


@dataclass(frozen=True, eq=False)
class ImportedRun:
    """One recording of a file: raw samples as they came, and what they mean."""

    channels: tuple[StoredChannel, ...]
    raw: NDArray
    rate: float
    label: str
    period: int = 0
    drop_periods: int = 0
    level: float = float("nan")
    breaks: tuple[int, ...] = ()
    excluded: tuple[tuple[int, int], ...] = ()
    overloads: tuple[tuple[int, int, int], ...] = ()

    def recording(self) -> Recording:
        """The same in SI units."""
        data = np.array([c.to_si(row) for c, row in zip(self.channels, self.raw, strict=True)])
        return Recording(
            tuple(c.channel for c in self.channels), data, self.rate, self.breaks, self.excluded, self.overloads,
            self.period, self.drop_periods, self.level, self.label,
        )  # fmt: skip


def to_runs(file: Arrays, channels: ChannelMap) -> list[ImportedRun]:
    """The runs that a file holds: one, or those of [[run]].

    Raises
    ------
    ChannelError
        If an array is missing, of another length than the others, or no signal.
    ConfigError
        If nothing tells the sample rate.
    """
    whole = _whole(file, channels)
    tables = [run for run in channels.run if run.fits(file.path)]
    if channels.run and not tables:
        raise ConfigError(f"{channels.name}: no [[run]] is of the file {file.path.name}")
    cut = [_cut(whole, run, i, channels) for i, run in enumerate(tables)] if tables else [whole]
    for run in cut:
        if not file.channels:  # what labnnum exported comes back as it was
            _require_periods(run, channels.name)
    return [_without_mean(run, channels) for run in cut]


def _require_periods(run: ImportedRun, where: str) -> None:
    """ConfigError if a period is stated of which no stretch holds one that counts."""
    edges = [0, *sorted(run.breaks), run.raw.shape[1]]
    longest = max(b - a for a, b in pairwise(edges))
    if run.period and longest < (1 + run.drop_periods) * run.period:
        raise ConfigError(
            f"{where}: period {run.period} and drop_periods {run.drop_periods} leave nothing of {run.label}, whose"
            f" longest stretch has {longest} samples"
        )


def _whole(file: Arrays, channels: ChannelMap) -> ImportedRun:
    stored = tuple(_of_full_scale(c) if file.parts else c for c in channels.stored())
    rows, axis = _rows(file, channels)
    rate, jumps = _rate(file, channels, axis)
    names = [c.channel.name for c in stored]
    overloads = []
    for name, start, stop in channels.overloads:
        if name not in names:
            raise ConfigError(f"{channels.name}: overloads: there is no channel {name!r}")
        overloads.append((names.index(name), start, stop))
    return ImportedRun(
        stored, np.array(rows), rate, file.path.name, channels.period, channels.drop_periods,
        channels.level_of(file.path), (*channels.breaks, *jumps), channels.excluded, tuple(overloads),
    )  # fmt: skip


def _of_full_scale(channel: StoredChannel) -> StoredChannel:
    """Parts of full scale become what `full_scale` says the end of the range is."""
    if np.isnan(channel.full_scale):
        return channel
    scale = channel.scale * channel.full_scale
    return replace(channel, scale=scale, raw_unit="parts of full scale", full_scale=1.0)


def _rows(file: Arrays, channels: ChannelMap) -> tuple[list[NDArray], NDArray | None]:
    """One row of samples a channel, and the time axis if it turned out to be the row before them."""
    sources: list[Source | None] = [c.source for c in channels.channel]
    axis = None
    if all(s is None for s in sources) and not any(c.name in file.arrays for c in channels.channel):
        sources, axis = _by_position(file, [c.name for c in channels.channel])
    rows = []
    for table, source in zip(channels.channel, sources, strict=True):
        what = f"channel {table.name!r}"
        row = np.atleast_1d(file.pick(table.name if source is None else source, what))
        if row.ndim != 1 or row.dtype.kind not in "fiub":
            raise ChannelError(
                f"{file.path}: {what}: an array of {row.dtype} {row.shape} is no signal; choose a row as in"
                f' source = "{source or table.name}[0]"'
            )
        if rows and row.size != rows[0].size:
            raise ChannelError(
                f"{file.path}: {what} has {row.size} samples where {channels.channel[0].name!r} has {rows[0].size}"
            )
        rows.append(row)
    if rows[0].size < 2:
        raise ChannelError(f"{file.path}: channel {channels.channel[0].name!r} has {rows[0].size} samples")
    return rows, axis


def _by_position(file: Arrays, names: list[str]) -> tuple[list[Source | None], NDArray | None]:
    """Channels in the order of the table's rows; a row more, and even, is the time axis before them."""
    table = file.table
    if table is not None and len(table) == len(names):
        return list(range(len(names))), None
    if table is not None and len(table) == len(names) + 1:
        try:
            even_rate(table[0], "")
        except FileError:
            pass
        else:
            return list(range(1, len(names) + 1)), table[0]
    missing = next(n for n in names if n not in file.arrays)
    raise ChannelError(
        f"{file.path}: channel {missing!r}: there is no array {missing!r}; there are {file.names()}:"
        " say which it is with source = ..."
    )


def _rate(file: Arrays, channels: ChannelMap, axis: NDArray | None) -> tuple[float, tuple[int, ...]]:
    time, jumps, seen = channels.time, (), file.rate
    if isinstance(channels.sample_rate, str):
        return file.scalar(channels.sample_rate, "sample_rate"), ()
    if time is None and axis is None and channels.sample_rate is None and np.isnan(seen):
        time = file.time_axis()
    if time is not None or axis is not None:
        axis = file.pick(time, "time") if time is not None else axis
        assert axis is not None
        seen, jumps = even_rate(axis, f"{file.path}: time {time if time is not None else '(first row)'}")
    if channels.sample_rate is None:
        if np.isnan(seen):
            raise ConfigError(f"{channels.name}: sample_rate is missing, and {file.path.name} does not tell it")
        return seen, jumps
    if abs(channels.sample_rate - seen) > 1e-3 * channels.sample_rate:
        raise ConfigError(
            f"{channels.name}: sample_rate is {channels.sample_rate:g} Hz but {file.path.name} says {seen:g} Hz"
        )
    return channels.sample_rate, jumps


def _cut(whole: ImportedRun, run: RunTable, number: int, channels: ChannelMap) -> ImportedRun:
    n = whole.raw.shape[1]
    stop = n if run.stop is None else run.stop
    if not run.start < stop <= n:
        raise ConfigError(
            f"{channels.name}: run[{number + 1}]: start {run.start} and stop {stop} do not lie in {n} samples"
        )

    def shift(a: int, b: int) -> tuple[int, int]:
        return max(a - run.start, 0), min(b, stop) - run.start

    inside = [shift(a, b) for a, b in whole.excluded]
    over = [(c, *shift(a, b)) for c, a, b in whole.overloads]
    return replace(
        whole,
        raw=whole.raw[:, run.start : stop],
        label=f"{whole.label} {run.label or f'run {number + 1}'}",
        period=whole.period if run.period is None else run.period,
        drop_periods=whole.drop_periods if run.drop_periods is None else run.drop_periods,
        level=whole.level if run.level is None else run.level,
        breaks=tuple(b - run.start for b in whole.breaks if run.start < b < stop),
        excluded=tuple((a, b) for a, b in inside if a < b),
        overloads=tuple((c, a, b) for c, a, b in over if a < b),
    )


def _without_mean(run: ImportedRun, channels: ChannelMap) -> ImportedRun:
    """Channels with offset = "mean" get that mean as their offset."""
    kept = [
        replace(c, offset=float(np.mean(row, dtype=float))) if table.offset == "mean" else c
        for c, row, table in zip(run.channels, run.raw, channels.channel, strict=True)
    ]
    return replace(run, channels=tuple(kept))


_HERTZ = {"Hz": 1.0, "kHz": 1e3, "rad/s": 1 / (2 * np.pi), "rpm": 1 / 60}


def to_frf(files: Sequence[Arrays], channels: ChannelMap) -> Frf:
    """The FRFs that files hold, as [frf] says.

    Raises
    ------
    ConfigError
        If a pair of output and input is missing or given twice.
    ChannelError
        If an array is missing or does not fit the frequencies.
    """
    spec = channels.frf
    assert spec is not None
    stored = channels.stored()
    outputs = [c for c in stored if c.channel.role in ("response", "monitor")]
    inputs = [c for c in stored if c.channel.role in ("reference", "base")]
    if not outputs or not inputs:
        raise ConfigError(f"{channels.name}: an FRF needs a channel with role response and one with role reference")
    frequency = _frequency(files, channels)
    if spec.row:
        value, coherence, variance = _from_rows(files, channels, frequency, outputs, inputs)
    else:
        value, coherence, variance = _from_array(files, channels, frequency, len(outputs), len(inputs))
    factor = np.array([[o.scale / i.scale for i in inputs] for o in outputs])[..., None]
    value = value * factor if spec.convention == "exp(+iwt)" else np.conj(value) * factor
    _require_finite(value, frequency, outputs, inputs, files[0].path)
    return Frf(
        frequency, value, tuple(c.channel for c in outputs), tuple(c.channel for c in inputs), coherence,
        None if variance is None else variance * factor**2, spec.n_averages, spec.estimator,
        {**spec.settings, "source": ", ".join(f.path.name for f in files)},
    )  # fmt: skip


def _frequency(files: Sequence[Arrays], channels: ChannelMap) -> NDArray[np.float64]:
    spec = channels.frf
    assert spec is not None
    if spec.frequency_unit not in _HERTZ:
        raise ConfigError(f"{channels.name}: frf.frequency_unit must be one of {', '.join(_HERTZ)}")
    axes = [np.asarray(f.pick(spec.frequency, "frf.frequency"), float) for f in files]
    for file, axis in zip(files, axes, strict=True):
        if axis.ndim != 1 or not (np.diff(axis) > 0).all():
            raise ChannelError(f"{file.path}: frf.frequency {spec.frequency!r} does not ascend")
        if not np.array_equal(axis, axes[0]):
            raise ChannelError(f"{file.path}: its frequencies differ from those of {files[0].path.name}")
    return axes[0] * _HERTZ[spec.frequency_unit]


def _from_array(
    files: Sequence[Arrays], channels: ChannelMap, frequency: NDArray, n_out: int, n_in: int
) -> tuple[NDArray, NDArray | None, NDArray | None]:
    spec = channels.frf
    assert spec is not None
    if len(files) > 1 or spec.value is None:
        raise ConfigError(f"{channels.name}: frf.value, or a [[frf.row]] for each output and input, is missing")

    def shaped(source: Source, key: str, shape: tuple[int, ...]) -> NDArray:
        return _in_order(np.asarray(files[0].pick(source, f"frf.{key}")), shape, f"{files[0].path}: frf.{key}")

    value = shaped(spec.value, "value", (n_out, n_in, frequency.size)).astype(complex)
    coherence = None if spec.coherence is None else shaped(spec.coherence, "coherence", (n_out, frequency.size))
    variance = None if spec.variance is None else shaped(spec.variance, "variance", value.shape)
    return value, coherence, variance


def _in_order(array: NDArray, shape: tuple[int, ...], where: str) -> NDArray:
    """The array as `shape`, frequencies last; three axes pair outputs with inputs and are never shuffled.

    ChannelError names the shapes that are taken.
    """
    *sides, n = shape
    if array.ndim > 2:
        for candidate in (array, np.moveaxis(array, 0, -1)):
            if candidate.shape == shape:
                return candidate
    else:
        row = np.atleast_2d(array)
        for candidate in (row, row.T):
            if candidate.shape == (np.prod(sides), n):
                return candidate.reshape(shape)
    words = "outputs, inputs" if len(sides) == 2 else "outputs"
    raise ChannelError(
        f"{where}: an array of {array.shape} is neither [{words}, frequencies] {shape} nor [frequencies, {words}]"
        f" {(n, *sides)}; or as rows {(int(np.prod(sides)), n)}, outputs slowest"
    )


def _from_rows(
    files: Sequence[Arrays],
    channels: ChannelMap,
    frequency: NDArray,
    outputs: Sequence[StoredChannel],
    inputs: Sequence[StoredChannel],
) -> tuple[NDArray, NDArray | None, NDArray | None]:
    spec = channels.frf
    assert spec is not None
    names = [[c.channel.name for c in side] for side in (outputs, inputs)]
    value = np.zeros((len(outputs), len(inputs), frequency.size), complex)
    coherence = np.full((len(outputs), frequency.size), np.nan)
    variance = np.full(value.shape, np.nan)
    done = np.zeros(value.shape[:2], bool)
    for number, row in enumerate(spec.row):
        where = f"{channels.name}: frf.row[{number + 1}]"
        for name, side in zip((row.output, row.input), names, strict=True):
            if name not in side:
                raise ConfigError(f"{where}: there is no channel {name!r} of that role; there are {', '.join(side)}")
        at = names[0].index(row.output), names[1].index(row.input)
        file = _file_of(files, row, where)
        if done[at]:
            raise ConfigError(f"{where}: output {row.output!r} and input {row.input!r} are given twice")
        done[at] = True
        value[at] = _value(file, row, where, frequency.size)
        if row.coherence is not None:
            coherence[at[0]] = _line(file, row.coherence, where, frequency.size)
        if row.variance is not None:
            variance[at] = _line(file, row.variance, where, frequency.size)
    if not done.all():
        o, i = np.argwhere(~done)[0]
        raise ConfigError(f"{channels.name}: no [[frf.row]] has output {names[0][o]!r} and input {names[1][i]!r}")
    known = [None if np.isnan(a).any() else a for a in (coherence, variance)]
    return value, known[0], known[1]


def _file_of(files: Sequence[Arrays], row: FrfRow, where: str) -> Arrays:
    fitting = [f for f in files if Path(f.path.name).match(row.file)]
    if len(fitting) != 1:
        raise ConfigError(f"{where}: file = {row.file!r} fits {len(fitting)} of the {len(files)} files given")
    return fitting[0]


def _value(file: Arrays, row: FrfRow, where: str, n: int) -> NDArray:
    if row.value is not None:
        return _line(file, row.value, where, n)
    if row.real is not None and row.imag is not None:
        return _line(file, row.real, where, n) + 1j * _line(file, row.imag, where, n)
    assert row.magnitude is not None and row.phase is not None  # noqa: PT018
    phase = np.deg2rad(_line(file, row.phase, where, n))
    return _line(file, row.magnitude, where, n) * np.exp(1j * phase)


def _line(file: Arrays, source: Source, where: str, n: int) -> NDArray:
    line = np.asarray(file.pick(source, where))
    if line.shape != (n,):
        raise ChannelError(f"{file.path}: {where}: {source!r} has shape {line.shape} where {n} frequencies are")
    return line


def _require_finite(
    value: NDArray,
    frequency: NDArray,
    outputs: Sequence[StoredChannel],
    inputs: Sequence[StoredChannel],
    path: Path,
) -> None:
    bad = np.argwhere(~np.isfinite(value))
    if bad.size:
        o, i, k = bad[0]
        raise ChannelError(
            f"{path}: the FRF of {outputs[o].channel.name!r} to {inputs[i].channel.name!r} is not finite at"
            f" {frequency[k]:g} Hz; leave that line out"
        )
