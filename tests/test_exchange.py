"""Exchange: what is exported comes back, and what others wrote is read as they meant it."""

import json
import re

import numpy as np
import pytest
import scipy.io
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from labnnum.errors import ChannelError, ConfigError, FileError
from labnnum.frf import Frf
from labnnum.recording import Channel, Recording
from sessions.channels import parse_channels
from sessions.exchange import load_frf, load_recordings, read_any
from sessions.exchange.export import export_frf, export_recordings

CHANNELS = (
    Channel("hammer", "force", "reference", "12", "-z"),
    Channel("tip, left", "acceleration", "response", "tip", "x"),
    Channel("gauge", "strain", "response"),
    Channel("room", "temperature", "monitor"),
)
DIGITS = {".uff": 1e-12, "ascii": 6e-13}


def recording(n=257, rate=1000.0, **kwargs):
    rng = np.random.default_rng(7)
    data = rng.normal(size=(4, n)) * np.array([[1e3], [1.0], [1e-9], [300.0]])
    return Recording(CHANNELS, data, rate, **{"level": 2.5, "period": 64, "drop_periods": 1, **kwargs})


def same_channels(a, b):
    for one, two in zip(a, b, strict=True):
        assert (one.name, one.quantity, one.role, one.node, one.direction) == (
            two.name, two.quantity, two.role, two.node, two.direction,
        )  # fmt: skip


def frf(frequency, coherence=True):
    rng = np.random.default_rng(3)
    n = len(frequency)
    value = rng.normal(size=(2, 2, n)) * 1e-4 + 1j * rng.normal(size=(2, 2, n))
    kept = {"coherence": rng.uniform(size=(2, n)), "variance": rng.uniform(size=(2, 2, n))} if coherence else {}
    outputs = (
        Channel("a", "acceleration", node="2", direction="-y"),
        Channel("turn", "angle", node="2", direction="rz"),
    )
    inputs = (Channel("f", "force", "reference", "1", "y"), Channel("m", "moment", "reference", "1", "rz"))
    return Frf(frequency, value, outputs, inputs, **kept, n_averages=12.5, estimator="H1", settings={"window": "hann"})


AXES = {
    "even": np.arange(200) * 0.01953125,
    "even with an increment of many digits": 3.7 + np.arange(200) * 0.123456789012345,
    "from an FFT": np.fft.rfftfreq(1000, 1 / 610.35),
    "uneven": np.sort(np.random.default_rng(1).uniform(1, 1000, 77)),
}


@pytest.mark.parametrize("suffix", [".npz", ".csv", ".mat", ".wav"])
def test_recordings_come_back_to_the_bit(tmp_path, suffix):
    before = recording(breaks=(100,), excluded=((5, 9),), overloads=((1, 20, 30),))
    path = tmp_path / f"case{suffix}"
    export_recordings(path, [before])
    (after,) = read_any(path)
    assert_array_equal(after.data, before.data)
    same_channels(after.channels, before.channels)
    for name in ("rate", "breaks", "excluded", "overloads", "period", "drop_periods", "level"):
        assert getattr(after, name) == getattr(before, name)


@pytest.mark.parametrize("rate", [25600.0, 610.35, 51200 / 3])
@pytest.mark.parametrize("ascii_", [False, True])
def test_recordings_in_universal_files(tmp_path, rate, ascii_):
    before = [recording(rate=rate), recording(n=100, rate=rate, level=7.0, period=0)]
    export_recordings(tmp_path / "case.uff", before, ascii_)
    after = read_any(tmp_path / "case.uff")
    for one, two in zip(before, after, strict=True):
        if ascii_:
            assert_allclose(two.data, one.data, rtol=6e-13)
        else:
            assert_array_equal(two.data, one.data)
        same_channels(two.channels, one.channels)
        assert (two.rate, two.period, two.level) == (one.rate, one.period, one.level)


def test_stretches_of_a_broken_recording_stay_apart(tmp_path):
    before = recording(breaks=(100,), excluded=((0, 20),))
    export_recordings(tmp_path / "case.uff", [before])
    first, second = read_any(tmp_path / "case.uff")
    assert_array_equal(first.data, before.data[:, 20:100])
    assert_array_equal(second.data, before.data[:, 100:])


@pytest.mark.parametrize("axis", AXES)
@pytest.mark.parametrize("name", ["x.npz", "x.csv", "x.mat", "x.uff", "ascii.uff"])
def test_frfs_come_back(tmp_path, axis, name):
    before = frf(AXES[axis])
    exact = not name.endswith(".uff")
    ascii_ = name == "ascii.uff"
    export_frf(tmp_path / name, before, ascii_)
    after = load_frf(tmp_path / name)
    arrays = ("frequency", "value", "coherence", "variance")
    for key in arrays:
        one, two = getattr(before, key), getattr(after, key)
        if exact or (key != "frequency" and not ascii_):
            assert_array_equal(two, one)
        elif key == "frequency" and ascii_ and axis == "uneven":
            assert_allclose(two, one, rtol=5.1e-7)  # seven digits are what the standard's field has room for
        else:
            parts = (np.real, np.imag) if np.iscomplexobj(one) else (np.asarray,)
            for part in parts:
                assert_allclose(part(two), part(one), rtol=1e-12, atol=0)
    same_channels(after.outputs, before.outputs)
    same_channels(after.inputs, before.inputs)
    assert (after.n_averages, after.estimator) == (12.5, "H1")


@given(st.lists(st.floats(allow_nan=True, allow_infinity=True, width=64), min_size=2, max_size=30))
@settings(max_examples=25, deadline=None)
def test_any_number_survives_a_binary_universal_file(tmp_path_factory, numbers):
    path = tmp_path_factory.mktemp("u") / "x.uff"
    data = np.array([numbers])
    export_recordings(path, [Recording((Channel("a"),), data, 1.0)])
    assert_array_equal(read_any(path)[0].data, data)


def test_pyuff_reads_what_we_write(tmp_path):
    """An independent reader; its axis is good to the header's digits where it ignores the ID line."""
    pyuff = pytest.importorskip("pyuff")
    before = frf(AXES["even"])
    for ascii_ in (False, True):
        path = tmp_path / f"x{ascii_}.uff"
        export_frf(path, before, ascii_)
        sets = pyuff.UFF(str(path)).read_sets()
        functions = [s for s in sets if s["func_type"] == 4]
        assert [s["rsp_node"] for s in functions] == [2] * 4
        assert [s["rsp_dir"] for s in functions] == [-2, -2, 6, 6]
        assert [s["ref_dir"] for s in functions] == [2, 6, 2, 6]
        assert functions[0]["ordinate_axis_units_lab"] == "m/s^2"
        assert functions[0]["orddenom_axis_units_lab"] == "N"
        assert_allclose(functions[0]["x"], before.frequency, rtol=1e-12)
        for k, (o, i) in enumerate(((0, 0), (0, 1), (1, 0), (1, 1))):
            assert_allclose(functions[k]["data"], before.value[o, i], rtol=1e-11)
        assert len([s for s in sets if s["func_type"] in (6, 26)]) == 2
    with path.open("rb") as file:
        assert all(len(line) <= 81 for line in file)


def test_we_read_what_pyuff_writes(tmp_path):
    pyuff = pytest.importorskip("pyuff")
    x = np.array([1.0, 2.5, 3.0, 10.0])
    data = np.array([1 + 1j, 2 - 3j, 1e-5 + 0j, 4j])
    path = tmp_path / "x.uff"
    for node in (3, 4):
        one = pyuff.prepare_58(
            binary=0, func_type=4, rsp_node=node, rsp_dir=-3, ref_node=1, ref_dir=3, data=data * node, x=x, id1="i",
            abscissa_spacing=0, abscissa_spec_data_type=18, ordinate_spec_data_type=12, orddenom_spec_data_type=13,
            rsp_ent_name="NONE", ref_ent_name="NONE",
        )  # fmt: skip
        pyuff.UFF(str(path)).write_sets(one, "add")
    read = load_frf(path)
    assert_array_equal(read.frequency, x)
    assert_allclose(read.value[:, 0], [3 * data, 4 * data], rtol=1e-11)
    assert [c.dof for c in read.outputs] == ["3:z", "4:z"]
    assert [c.sign for c in read.outputs] == [-1, -1]
    assert (read.inputs[0].quantity, read.outputs[0].quantity) == ("force", "acceleration")


def test_a_channels_toml_overrules_a_universal_file(tmp_path):
    before = recording()
    export_recordings(tmp_path / "x.uff", [before])
    told = parse_channels("""
        [[channel]]
        name = "mine"
        unit = "lbf"
        source = "hammer"
        [[channel]]
        name = "second"
        source = 1
    """)
    (read,) = read_any(tmp_path / "x.uff", told)
    assert read.rate == 1000
    assert_allclose(read.data[0], before.data[0] * 4.4482216152605, rtol=1e-15)
    assert_array_equal(read.data[1], before.data[1])


def test_other_units_in_a_universal_file(tmp_path):
    """Units dataset 164: inches and pounds-force without axis labels."""
    pyuff = pytest.importorskip("pyuff")
    path = tmp_path / "x.uff"
    file = pyuff.UFF(str(path))
    units = pyuff.prepare_164(
        units_code=7, units_description="in lbf", temp_mode=1, length=1 / 0.0254, force=1 / 4.4482216152605,
        temp=1.8, temp_offset=459.67,
    )  # fmt: skip
    file.write_sets(units, "add")
    for kind, node in ((12, 5), (13, 6)):
        one = pyuff.prepare_58(
            binary=0, func_type=1, rsp_node=node, rsp_dir=1, ref_node=0, ref_dir=0, data=np.array([1.0, 2.0, 3.0]),
            x=np.array([0.0, 0.01, 0.02]), id1="i", abscissa_spacing=1, abscissa_spec_data_type=17,
            ordinate_spec_data_type=kind, orddenom_spec_data_type=0, rsp_ent_name="NONE", ref_ent_name="NONE",
        )  # fmt: skip
        file.write_sets(one, "add")
    (read,) = read_any(path)
    assert read.rate == 100
    assert [(c.quantity, c.role) for c in read.channels] == [("acceleration", "response"), ("force", "reference")]
    assert_allclose(read.data[0], np.array([1, 2, 3]) * 0.0254, rtol=1e-12)
    assert_allclose(read.data[1], np.array([1, 2, 3]) * 4.4482216152605, rtol=1e-12)


def write_map(folder, text):
    (folder / "channels.toml").write_text("sample_rate = 100\n" + text)


TWO = """
[[channel]]
name = "f"
quantity = "force"
unit = "lbf"
role = "reference"
[[channel]]
name = "a"
unit = "g"
"""


def sourced(first, second):
    """TWO with the places of both channels."""
    text = TWO.replace('unit = "lbf"', f'unit = "lbf"\nsource = {json.dumps(first)}')
    return text.replace('unit = "g"', f'unit = "g"\nsource = {json.dumps(second)}')


class TestArrays:
    data = np.random.default_rng(5).normal(size=(2, 50))

    def check(self, path, channels=None):
        (read,) = read_any(path, channels)
        assert_allclose(read.data[0], self.data[0] * 4.4482216152605, rtol=1e-15)
        assert_allclose(read.data[1], self.data[1] * 9.80665, rtol=1e-15)
        assert read.rate == 100

    @pytest.mark.parametrize("shape", ["named", "rows", "columns", "flat", "with time", "single precision"])
    def test_npz(self, tmp_path, shape):
        write_map(tmp_path, TWO)
        path = tmp_path / "case.npz"
        f, a = self.data
        if shape == "single precision":
            self.data = self.data.astype("f4").astype(float)
            f, a = self.data.astype("f4")
        arrays = {
            "rows": {"data": self.data},
            "columns": {"data": self.data.T},
            "flat": {"f": f[None], "a": a[:, None], "note": np.array("x")},
            "with time": {"data": np.vstack([np.arange(50) / 100, self.data])},
        }.get(shape, {"a": a, "f": f})
        np.savez(path, **arrays)
        self.check(path)

    def test_npy_and_sources(self, tmp_path):
        np.save(tmp_path / "x.npy", np.vstack([np.arange(50) / 100, self.data]))
        text = TWO.replace('unit = "lbf"', 'unit = "lbf"\nsource = 1').replace(
            'unit = "g"', 'unit = "g"\nsource = "data[2]"'
        )
        self.check(tmp_path / "x.npy", parse_channels(f"time = 0\n{text}"))

    @pytest.mark.parametrize(
        "form",
        [
            "f,a\n{0},{1}",
            "# made by hand\nf;a\n{0};{1}",
            "{0} {1}",
            "\t{0}\t{1}",
            '"f","a",\n{0},{1},',
            "% f a\n{0}  {1}",
        ],
    )
    def test_text(self, tmp_path, form):
        write_map(tmp_path, TWO)
        *head, line = form.split("\n")
        rows = [line.format(repr(float(x)), repr(float(y))) for x, y in self.data.T]
        (tmp_path / "x.csv").write_text("\n".join([*head, *rows]) + "\n")
        self.check(tmp_path / "x.csv")

    def test_decimal_comma(self, tmp_path):
        write_map(tmp_path, TWO)
        rows = [f"{x!r};{y!r}".replace(".", ",") for x, y in self.data.T.tolist()]
        (tmp_path / "x.txt").write_text("f;a\n" + "\n".join(rows), encoding="latin-1")
        self.check(tmp_path / "x.txt")

    def test_json(self, tmp_path):
        (tmp_path / "x.json").write_text(json.dumps({"rows": self.data.T.tolist(), "fs": 100, "by": "hand"}))
        self.check(tmp_path / "x.json", parse_channels('sample_rate = "fs"\n' + sourced("rows[:,0]", "rows[:,1]")))

    @pytest.mark.parametrize("version", ["5", "7.3"])
    def test_mat_with_a_struct(self, tmp_path, version):
        path = tmp_path / "x.mat"
        if version == "5":
            from scipy.io import savemat

            savemat(path, {"run": {"Y": self.data}, "Fs": 100.0})
        else:
            import h5py

            with h5py.File(path, "w", userblock_size=512) as file:
                file["run/Y"] = self.data.T
                file["Fs"] = np.array([[100.0]])
            raw = bytearray(path.read_bytes())
            raw[:20] = b"MATLAB 7.3 MAT-file "
            path.write_bytes(raw)
        self.check(path, parse_channels('sample_rate = "Fs"\n' + sourced("run.Y[0]", "run.Y[1,:]")))

    @pytest.mark.parametrize(("dtype", "full"), [("i2", 2**15), ("i4", 2**31), ("u1", 2**7), ("f4", 1)])
    def test_wav(self, tmp_path, dtype, full):
        from scipy.io import wavfile

        samples = (np.array([[0.5, -0.25], [0.125, -1.0]]) * full + (128 if dtype == "u1" else 0)).astype(dtype)
        wavfile.write(tmp_path / "x.wav", 48000, samples)
        channel = '[[channel]]\nname = "a"\nsensitivity = 0.5\nfull_scale = 10\n[[channel]]\nname = "b"\n'
        (read,) = read_any(tmp_path / "x.wav", parse_channels(channel))
        assert read.rate == 48000
        assert_allclose(read.data, [[10.0, 2.5], [-0.25, -1.0]])


def test_a_jump_of_the_time_axis_is_a_break(tmp_path):
    t = np.delete(np.arange(1000) / 50, slice(400, 420))
    np.savez(tmp_path / "x.npz", t=t, a=np.sin(t))
    (read,) = read_any(tmp_path / "x.npz", parse_channels('[[channel]]\nname = "a"\n'))
    assert (read.rate, read.breaks) == (50.0, (400,))


def test_stretches_of_a_file(tmp_path):
    np.savez(tmp_path / "x.npz", a=np.arange(100.0))
    told = parse_channels("""
        sample_rate = 10
        breaks = [50]
        excluded = [[0, 5], [40, 45]]
        overloads = [["a", 42, 60]]
        [[channel]]
        name = "a"
        offset = "mean"
        [[run]]
        label = "first"
        start = 10
        stop = 20
        level = 3.0
        [[run]]
        start = 30
        period = 7
    """)
    first, second = read_any(tmp_path / "x.npz", told)
    assert (first.label, first.level, first.breaks, first.excluded) == ("x.npz first", 3.0, (), ())
    assert_array_equal(first.data[0], np.arange(10) - 4.5)
    assert (second.period, second.breaks, second.excluded) == (7, (20,), ((10, 15),))
    assert second.overloads == ((0, 12, 30),)
    assert_array_equal(second.data[0], np.arange(30.0, 100) - np.arange(30.0, 100).mean())


def test_level_of_each_file(tmp_path):
    for name in ("a1", "b1"):
        np.savez(tmp_path / f"{name}.npz", a=np.arange(5.0))
    told = parse_channels('sample_rate = 1\nlevel = {"a*.npz" = 2.0, "b1.npz" = 3}\n[[channel]]\nname = "a"\n')
    found = load_recordings([tmp_path / "a1.npz", tmp_path / "b1.npz"], told)
    assert [r.level for r in found] == [2.0, 3.0]


class TestFrfTables:
    def test_rows_of_one_array(self, tmp_path):
        before = frf(AXES["uneven"], coherence=False)
        np.savez(tmp_path / "x.npz", w=before.omega, G=np.conj(before.value.reshape(4, -1)))
        told = parse_channels("""
            [frf]
            frequency = "w"
            frequency_unit = "rad/s"
            value = "G"
            convention = "exp(-iwt)"
            [[channel]]
            name = "a"
            unit = "g"
            [[channel]]
            name = "b"
            quantity = "displacement"
            unit = "mm"
            [[channel]]
            name = "f"
            role = "reference"
            unit = "kN"
            [[channel]]
            name = "g"
            role = "reference"
        """)
        after = load_frf(tmp_path / "x.npz", told)
        assert_allclose(after.frequency, before.frequency, rtol=1e-14)
        assert_allclose(after.value[0, 0], before.value[0, 0] * 9.80665e-3, rtol=1e-14)
        assert_allclose(after.value[1, 1], before.value[1, 1] * 1e-3, rtol=1e-14)
        assert np.isnan(after.n_averages)

    @pytest.mark.parametrize(("n_out", "n_in"), [(2, 2), (3, 3), (3, 2), (1, 3), (3, 1)])
    @pytest.mark.parametrize("kind", ["npz", "mat"])
    def test_frequencies_may_come_first_and_every_pair_stays_itself(self, tmp_path, n_out, n_in, kind):
        f = np.arange(1.0, 8)
        value = 10 * np.arange(n_out)[:, None, None] + np.arange(n_in)[:, None] + 1j * f
        first = {
            "f": f, "H": np.moveaxis(value, -1, 0), "V": np.moveaxis(np.abs(value), -1, 0),
            "C": np.linspace(0, 1, f.size * n_out).reshape(f.size, n_out),
        }  # fmt: skip
        if kind == "npz":
            np.savez(tmp_path / "x.npz", **first)
        else:
            scipy.io.savemat(tmp_path / "x.mat", first)
        told = parse_channels(
            '[frf]\nfrequency = "f"\nvalue = "H"\ncoherence = "C"\nvariance = "V"\n'
            + "".join(f'[[channel]]\nname = "a{o}"\nquantity = "acceleration"\n' for o in range(n_out))
            + "".join(f'[[channel]]\nname = "f{i}"\nrole = "reference"\n' for i in range(n_in))
        )
        after = load_frf(tmp_path / f"x.{kind}", told)
        assert_array_equal(after.value, value)
        assert_array_equal(after.variance, np.abs(value))
        assert_array_equal(after.coherence, first["C"].T)

    @pytest.mark.parametrize("shape", [(2, 3, 7), (7, 2, 3), (3, 7, 2), (2, 7, 3), (3, 14), (6, 8)])
    def test_an_array_in_another_order_is_refused_with_the_shapes_that_are_taken(self, tmp_path, shape):
        np.savez(tmp_path / "x.npz", f=np.arange(1.0, 8), H=np.ones(shape, complex))
        told = parse_channels(
            '[frf]\nfrequency = "f"\nvalue = "H"\n[[channel]]\nname = "a"\n[[channel]]\nname = "b"\n'
            '[[channel]]\nname = "c"\n[[channel]]\nname = "f"\nrole = "reference"\n'
            '[[channel]]\nname = "g"\nrole = "reference"\n'
        )
        said = (
            rf"frf.value: an array of {shape} is neither [outputs, inputs, frequencies] (3, 2, 7) nor"
            " [frequencies, outputs, inputs] (7, 3, 2); or as rows (6, 7), outputs slowest"
        )
        with pytest.raises(ChannelError, match=re.escape(said)):
            load_frf(tmp_path / "x.npz", told)

    def test_one_file_for_each_pair_with_magnitude_and_phase(self, tmp_path):
        f = np.arange(1.0, 20)
        for k in (1, 2):
            table = np.column_stack([f, k * f, np.full(f.size, 90.0), np.full(f.size, 0.9)])
            np.savetxt(tmp_path / f"p{k}.txt", table)
        row = '[[frf.row]]\noutput = "a"\ninput = "f{0}"\nmagnitude = 1\nphase = 2\ncoherence = 3\nfile = "p{0}.txt"\n'
        inputs = "".join(f'[[channel]]\nname = "f{k}"\nrole = "reference"\n' for k in (1, 2))
        told = parse_channels(f'[frf]\nfrequency = 0\n{row.format(1)}{row.format(2)}[[channel]]\nname = "a"\n{inputs}')
        from sessions.exchange import read_files

        after = read_files([tmp_path / "p2.txt", tmp_path / "p1.txt"], told)
        assert_allclose(after.value[0], [1j * f, 2j * f], atol=1e-13)
        assert_allclose(after.coherence, np.full((1, f.size), 0.9))
        with pytest.raises(ConfigError, match=r"frf.row\[2\]: file = 'p2.txt' fits 0 of the 1 files"):
            load_frf(tmp_path / "p1.txt", told)


def test_nothing_is_written_over(tmp_path):
    for name in ("x.npz", "x.uff", "x.csv", "x.mat", "x.wav"):
        (tmp_path / name).write_text("mine")
        with pytest.raises(FileError, match="exists already"):
            export_recordings(tmp_path / name, [recording()])
        assert (tmp_path / name).read_text() == "mine"
    with pytest.raises(FileError, match="cannot export to"):
        export_recordings(tmp_path / "x.xls", [recording()])
    with pytest.raises(FileError, match="WAV file cannot hold an FRF"):
        export_frf(tmp_path / "y.wav", frf(AXES["even"]))
    with pytest.raises(FileError, match="whole sample rates"):
        export_recordings(tmp_path / "y.wav", [recording(rate=610.35)])
    assert not list(tmp_path.glob("*.part*"))
    assert not list(tmp_path.glob("y*"))


def test_several_recordings_in_files_of_one(tmp_path):
    written = export_recordings(tmp_path / "x.npz", [recording(), recording(n=10)])
    assert [p.name for p in written] == ["x_run01.npz", "x_run02.npz"]
    assert [r.n_samples for r in load_recordings(written)] == [257, 10]


class TestTheSamplesOfOthers:
    def test_ascii_and_binary_read_equal(self, recordings):
        folder = recordings / "uff_samples"
        (one,), (two,) = (read_any(folder / n) for n in ("Sample_UFF58_ascii.uff", "Sample_UFF58b_bin.uff"))
        assert one.channels == two.channels == (Channel("Mic 01", "pressure", "response", "", "x"),)
        assert one.rate == two.rate == 65536
        assert one.n_samples == 79292
        # six digits of the ASCII file, and the single precision of both
        assert_allclose(one.data, two.data, rtol=5e-6 + 1e-7)

    def test_four_channels_of_one_run(self, recordings):
        (path,) = (recordings / "uff_samples").glob("MPSTD*.uff")
        (read,) = read_any(path)
        assert read.data.shape == (4, 222400)
        assert read.rate == 3200
        assert [c.name for c in read.channels] == ["1+Z", "2+Z", "3+Z", "1+Z #2"]
        assert {c.quantity for c in read.channels} == {"acceleration"}

    def test_geometry_of_test_lab(self, recordings):
        from sessions.exchange import uff

        (path,) = (recordings / "uff_samples").glob("TestLab*.uff")
        nodes = uff.nodes(path)
        assert len(nodes) == 36
        assert nodes["1"] == (-2.4, -0.95, 0.0)
        with pytest.raises(FileError, match="holds datasets 15, 18, 82, 151, 164"):
            read_any(path)

    def test_a_psd_keeps_its_unit(self, recordings):
        from sessions.exchange import uff

        path = recordings / "uff_samples" / "sample_dataset58_psd.uff"
        (psd,) = uff.read_functions(path)
        assert (psd.title, psd.unit, psd.x.size) == ("Pilot 1", "g²/Hz", 3201)
        assert psd.data[1] == 1.255863e-06
        with pytest.raises(FileError, match="power spectral density 'Pilot 1' in g²/Hz"):
            read_any(path)
