"""The session file: what goes in comes out, nothing is overwritten, and every failure has its line."""

import errno
import json
import os
import signal
import subprocess
import sys
import textwrap
import threading
from pathlib import Path

import h5py
import numpy as np
import pytest
from numpy.testing import assert_array_equal

from drivers.block import Block
from labnnum.errors import ChannelError, FileError, StoreError
from labnnum.frf import Frf
from labnnum.recording import Channel
from sessions import journal
from sessions.lock import lock_path
from sessions.store import create_session, open_session
from sessions.tables import StoredChannel

FORCE = Channel("f", "force", "reference", "1", "x", sensitivity=0.01)
ACC = Channel("a", "acceleration", "response", "2", "-z", sensitivity=0.25)


def block(start, n=100, **flags):
    count = np.arange(start, start + n, dtype=float)
    return Block(np.array([count, -count]), start, 1000.0 + start, **flags)


@pytest.fixture
def session(tmp_path):
    with create_session(tmp_path / "s.h5", "rig = 1", "model = 2") as made:
        yield made


def reread(session):
    session.close()
    return open_session(session.path)


class TestRuns:
    def test_volts_come_back_as_si_units_with_all_that_was_said(self, session):
        run = session.start_run([FORCE, ACC], 1000, level=2.5, period=50, drop_periods=1, full_scale=[10, 5])
        run.append(block(0))
        run.append(block(100))
        run.finish()
        with reread(session) as read:
            (again,) = read.runs
            assert again.channels == (FORCE, ACC)
            assert [c.full_scale for c in again.stored] == [10, 5]
            assert (again.rate, again.level, again.period, again.drop_periods) == (1000, 2.5, 50, 1)
            assert again.finished == "complete"
            assert (read.rig_text, read.model_text) == ("rig = 1", "model = 2")
            assert_array_equal(again.raw()[0], np.arange(200))
            (recording,) = read.recordings()
        assert_array_equal(recording.data[0], np.arange(200) * (1 / 0.01))
        assert recording.level == 2.5
        assert recording.period == 50
        assert recording.breaks == ()

    def test_si_units_come_back_to_the_bit(self, session):
        data = np.random.default_rng(1).normal(size=(2, 333))
        session.start_run([FORCE, ACC], 10, unit="SI").append(Block(data, 0, 0.0))
        with reread(session) as read:
            assert_array_equal(read.recordings()[0].data, data)

    def test_offset_and_scale(self, session):
        kept = StoredChannel(Channel("t", "temperature", "monitor"), "degC", 1.0, -273.15)
        session.start_run([kept], 1).append(Block(np.array([[0.0, 20.0]]), 0, 0.0))
        assert_array_equal(session.recordings()[0].data, [[273.15, 293.15]])

    def test_what_is_missing_breaks_the_record(self, session):
        run = session.start_run([FORCE, ACC], 1000)
        for start, flags in ((0, {}), (100, {}), (250, {"lost": 50}), (360, {}), (460, {"lost": 1})):
            run.append(block(start, **flags))
        assert run.gaps() == (200, 300, 400)
        assert session.recordings()[0].breaks == (200, 300, 400)

    def test_an_overflow_is_kept_out_and_an_overload_is_marked(self, session):
        run = session.start_run([FORCE, ACC], 1000)
        run.append(block(0))
        run.append(block(100, overflow=True))
        run.append(block(200, overload=np.array([False, True])))
        (recording,) = session.recordings()
        assert list(recording.spans()) == [(0, 100), (200, 300)]
        assert recording.overloads == ((1, 200, 300),)

    def test_every_hit_is_kept_with_every_judgement(self, session):
        run = session.start_run([FORCE, ACC], 1000)
        run.append(block(0, 1000))
        assert run.add_hit(100, 200, verdicts=[{"name": "double hit", "ok": True}], info={"point": "3"}) == 0
        assert run.add_hit(300, 400, False, "double hit") == 1
        run.add_hit(500, 600)
        run.judge_hit(2, False, "rejected by hand")
        run.judge_hit(1, True, "accepted by hand")
        with reread(session) as read:
            hits = read.runs[0].hits
            assert [h.accepted for h in hits] == [True, True, False]
            assert [j.reason for j in hits[1].history] == ["double hit", "accepted by hand"]
            assert hits[0].verdicts == ({"name": "double hit", "ok": True},)
            assert hits[0].info == {"point": "3"}
            assert list(read.recordings()[0].spans()) == [(100, 200), (300, 400)]

    def test_several_blocks_with_one_acknowledgement(self, session):
        run = session.start_run([FORCE, ACC], 1000)
        run.append(block(0))
        flags = {"lost": 3, "overload": np.array([True, False])}
        assert run.append_all([block(100, 7), block(110, 20, **flags)]) == 127
        assert run.append_all([]) == 127
        assert_array_equal(run.blocks["at"], [0, 100, 107])
        assert_array_equal(run.blocks["overload"], [[0, 0], [0, 0], [1, 0]])
        assert run.gaps() == (107,)

    def test_replay_gives_the_blocks_as_they_came(self, session):
        run = session.start_run([FORCE, ACC], 1000)
        came = [block(0), block(120, 77, lost=20), block(197, 3, overload=np.array([True, False]))]
        for one in came:
            run.append(one)
        for before, after in zip(came, run.replay(), strict=True):
            assert_array_equal(before.data, after.data)
            assert (before.start, before.time, before.lost) == (after.start, after.time, after.lost)

    def test_channels_must_fit(self, session):
        run = session.start_run([FORCE], 1000)
        with pytest.raises(ChannelError, match="block of 2 channels in a run of 1"):
            run.append(block(0))
        with pytest.raises(ChannelError, match="'x' has no sensitivity"):
            session.start_run([Channel("x")], 1000)
        with pytest.raises(StoreError, match="no hit 0"):
            run.judge_hit(0, True)


class TestResults:
    def test_results_are_appended_and_never_overwritten(self, session):
        assert session.add_result("estimate", "first", {"k": np.float64(2)}, {"cov": np.eye(2)}) == (
            "results/estimate/0001"
        )
        session.add_result("estimate", "second", {}, settings={"window": "hann"})
        with reread(session) as read:
            first, second = read.results("estimate")
            assert first.payload == {"k": 2.0}
            assert_array_equal(first.arrays["cov"], np.eye(2))
            assert (second.name, second.settings) == ("second", {"window": "hann"})
            assert len(read.results()) == 2
            assert read.results("nothing") == []

    def test_an_frf_keeps_all_it_had(self, session):
        rng = np.random.default_rng(0)
        f = np.array([0.0, 1.0, 2.5])
        value = rng.normal(size=(2, 1, 3)) + 1j * rng.normal(size=(2, 1, 3))
        outputs = (ACC, Channel("b", "displacement", node="3", direction="y"))
        frf = Frf(
            f, value, outputs, (FORCE,), coherence=rng.uniform(size=(2, 3)), variance=rng.uniform(size=(2, 1, 3)),
            n_averages=7.5, estimator="H1", settings={"window": "hann", "n_segment": 6},
            input_spectrum=np.ones((1, 1, 3)), input_condition=np.ones(3),
        )  # fmt: skip
        session.add_frf(frf, {"runs": [1]})
        with reread(session) as read:
            (again,) = read.frfs()
        for name in ("frequency", "value", "coherence", "variance", "input_spectrum", "input_condition"):
            assert_array_equal(getattr(again, name), getattr(frf, name))
        assert (again.outputs, again.inputs, again.estimator, again.n_averages) == (outputs, (FORCE,), "H1", 7.5)
        assert again.settings["window"] == "hann"
        assert again.settings["runs"] == [1]
        assert again.settings["stored"] == "results/frf/0001"


class TestWhoMayWrite:
    def test_nothing_is_written_over(self, session):
        with pytest.raises(FileError, match="exists already"):
            create_session(session.path)
        session.close()
        before = session.path.read_bytes()
        with pytest.raises(FileError, match="exists already and is not written over"):
            create_session(session.path)
        assert session.path.read_bytes() == before

    def test_one_writer_at_a_time(self, session):
        script = f"from sessions.store import open_session; open_session({str(session.path)!r}, 'a')"
        other = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
        assert f"is being written by process {os.getpid()}" in other.stderr
        with pytest.raises(StoreError, match="is being written by process"):
            open_session(session.path, "a")

    def test_a_reader_sees_what_is_acknowledged_and_disturbs_nobody(self, session):
        run = session.start_run([FORCE, ACC], 1000)
        for k in range(20):
            run.append(block(100 * k))
            with open_session(session.path) as reader:
                assert reader.runs[0].n_samples == 100 * (k + 1)
        with open_session(session.path) as early:
            for k in range(20, 40):
                run.append(block(100 * k))
            assert_array_equal(early.runs[0].raw()[0], np.arange(2000))
            session.close()
            assert_array_equal(early.runs[0].raw()[0], np.arange(2000))
        with open_session(session.path) as late:
            assert_array_equal(late.runs[0].raw()[0], np.arange(4000))
        assert os.listdir(session.path.parent) == [session.path.name]

    def test_a_thread_reads_while_another_writes(self, session):
        run, wrong = session.start_run([FORCE, ACC], 1000), []

        def look():
            while run.n_samples < 30_000:
                n = run.n_samples
                start = max(0, n - 700)
                if not np.array_equal(run.raw(start, n)[0], np.arange(start, n)):
                    wrong.append(n)

        reader = threading.Thread(target=look)
        reader.start()
        for k in range(300):
            run.append(block(100 * k))
        reader.join()
        assert not wrong
        with reread(session) as read:
            assert_array_equal(read.runs[0].raw()[0], np.arange(30_000))

    def test_the_lock_of_a_killed_writer_is_explained_and_taken_over(self, tmp_path):
        path = tmp_path / "s.h5"
        script = f"""
            import os, signal
            import numpy as np
            from drivers.block import Block
            from labnnum.recording import Channel
            from sessions.store import create_session
            run = create_session({str(path)!r}).start_run([Channel("a")], 10, unit="SI")
            run.append(Block(np.ones((1, 5)), 0, 0.0))
            os.kill(os.getpid(), signal.SIGKILL)
        """
        done = subprocess.run([sys.executable, "-c", textwrap.dedent(script)], check=False)
        assert done.returncode == -signal.SIGKILL
        assert lock_path(path).exists()
        with open_session(path, "a") as session:
            assert "stopped without closing" in session.notice
            assert session.runs[0].n_samples == 5
            assert session.runs[0].finished == ""
            session.start_run([FORCE, ACC], 10).append(block(0))
        with open_session(path) as session:
            assert session.notice == ""
            assert [run.n_samples for run in session.runs] == [5, 100]

    @pytest.mark.parametrize("removable", [True, False])
    def test_where_an_open_file_cannot_be_removed_a_closed_session_was_still_closed(
        self, tmp_path, monkeypatch, removable
    ):
        """As on Windows; and in a folder that lets nothing be removed the file stays, and names nobody."""
        path, order, close, unlink = tmp_path / "s.h5", [], os.close, Path.unlink

        def removed(self, missing_ok=False):
            if self == lock_path(path):
                order.append("removed")
                if not removable:
                    raise PermissionError
            unlink(self, missing_ok)

        monkeypatch.setattr("sessions.lock.fcntl", None)
        monkeypatch.setattr("sessions.lock._lock_byte", lambda fd: None)
        monkeypatch.setattr("sessions.lock.os.close", lambda fd: (order.append("closed"), close(fd)))
        monkeypatch.setattr(Path, "unlink", removed)
        create_session(path).close()
        assert order[-2:] == ["closed", "removed"]
        assert lock_path(path).exists() is not removable
        with open_session(path, "a") as session:
            assert session.notice == ""

    def test_reading_and_closed_sessions_refuse_to_write(self, session):
        session.start_run([FORCE], 10)
        session.close()
        session.close()
        with pytest.raises(StoreError, match="closed"):
            session.start_run([FORCE], 10)
        with pytest.raises(StoreError, match="is closed; open it again"):
            session.runs
        with open_session(session.path) as reader, pytest.raises(StoreError, match="for reading only"):
            reader.runs[0].finish()


class TestDamage:
    def test_missing(self, tmp_path):
        with pytest.raises(FileError, match=r"none\.h5: no such session"):
            open_session(tmp_path / "none.h5")
        with pytest.raises(FileError, match="there is no folder"):
            create_session(tmp_path / "no" / "s.h5")

    def test_foreign(self, tmp_path):
        (tmp_path / "text.h5").write_text("hello")
        with pytest.raises(FileError, match="is no HDF5 file"):
            open_session(tmp_path / "text.h5")
        h5py.File(tmp_path / "other.h5", "w").close()
        with pytest.raises(FileError, match="is HDF5 but no labnnum session"):
            open_session(tmp_path / "other.h5")

    def test_newer_version_is_named(self, session):
        session.close()
        with h5py.File(session.path, "r+") as file:
            file.attrs["version"] = 7
        for mode in ("r", "a"):
            with pytest.raises(FileError, match=r"has session version 7 .* up to version 1: install a newer"):
                open_session(session.path, mode)
        assert not lock_path(session.path).exists()

    @pytest.mark.parametrize("keep", [4, 100, 2000, 20000])
    def test_truncated(self, session, keep):
        run = session.start_run([FORCE, ACC], 1000)
        run.append(block(0, 4000))
        session.close()
        os.truncate(session.path, keep)
        for mode in ("r", "a"):
            with pytest.raises(FileError, match=r"truncated|is no HDF5 file|damaged"):
                open_session(session.path, mode)

    def test_a_flipped_bit_in_the_samples_is_noticed(self, session):
        run = session.start_run([FORCE, ACC], 1000)
        run.append(block(0, 4000))
        session.close()
        raw = bytearray(session.path.read_bytes())
        raw[raw.index(np.arange(1000.0, 1010.0).tobytes())] ^= 1
        session.path.write_bytes(raw)
        with open_session(session.path) as read, pytest.raises(FileError, match="is damaged"):
            read.recordings()


def fill(session, upto):
    """Blocks until `upto` samples; what was acknowledged is returned through the list."""
    acknowledged = []
    try:
        run = session.start_run([FORCE, ACC], 1000)
        acknowledged.append(0)
        for k in range(upto):
            acknowledged.append(run.append(block(100 * k)))
        run.add_hit(0, 50)
        session.close()
    except (_Killed, StoreError) as error:
        return acknowledged, error
    return acknowledged, None


class _Killed(BaseException):
    """The process ends here."""


def dying(monkeypatch, at, failure):
    """Let the journal's `at`-th write do half its work and fail; how many writes there were."""
    real, count = journal._pwrite, [0]

    def write(fd, data, offset):
        count[0] += 1
        if count[0] == at:
            real(fd, memoryview(data)[: len(data) // 2], offset)
            raise failure
        if count[0] > at and isinstance(failure, _Killed):
            raise failure
        real(fd, data, offset)

    monkeypatch.setattr(journal, "_pwrite", write)
    return count


@pytest.mark.parametrize("sync", [0.0, 1.0])
def test_killed_at_any_write_nothing_acknowledged_is_lost(tmp_path, monkeypatch, sync):
    path, at = tmp_path / "s.h5", 0
    while True:
        at += 1
        session = create_session(path, sync=sync)
        with monkeypatch.context() as patch:
            count = dying(patch, at, _Killed())
            acknowledged, error = fill(session, 2 if sync == 0 else 4)
            if session._journal is not None:
                session._journal.abandon()
                os.close(session._lock._fd)
        with open_session(path) as read:
            stored = [run.n_samples for run in read.runs]
            assert len(stored) >= min(1, len(acknowledged))
            if stored:
                assert stored[0] >= max(acknowledged, default=0)
                assert_array_equal(read.runs[0].raw()[0], np.arange(stored[0]))
        path.unlink()
        if error is None:
            assert count[0] > 10
            return


class Disk:
    """What is on the disk for certain, what the system may still hold back, and what power cuts would leave."""

    def __init__(self, monkeypatch, rng, share):
        self.rng, self.share = rng, share
        self.safe, self.held, self.cuts, self.forced = {}, [], [], 0
        write, truncate, sync = journal._pwrite, os.ftruncate, os.fsync

        def pwrite(fd, data, offset):
            self.hold(fd, offset, bytes(data))
            write(fd, data, offset)

        def ftruncate(fd, size):
            self.hold(fd, size, None)
            truncate(fd, size)

        def fsync(fd):
            self.maybe_cut()
            sync(fd)
            name = os.readlink(f"/proc/self/fd/{fd}")
            if os.path.isfile(name):
                self.held = [op for op in self.held if op[0] != name]
                with open(name, "rb") as file:
                    self.safe[name] = file.read()

        monkeypatch.setattr(journal, "_pwrite", pwrite)
        monkeypatch.setattr(os, "ftruncate", ftruncate)
        monkeypatch.setattr(os, "fsync", fsync)

    def hold(self, fd, at, data):
        self.maybe_cut()
        self.held.append((os.readlink(f"/proc/self/fd/{fd}"), at, data))

    def maybe_cut(self):
        if self.rng.random() < self.share and self.forced is not None:
            self.cuts.append((self.forced, self.left()))

    def left(self):
        """Files of which the last writes arrived, or did not, or did in part."""
        files = {name: bytearray(content) for name, content in self.safe.items()}
        odds = self.rng.choice([0.1, 0.5, 0.9])
        for name, at, data in [op for op in self.held if self.rng.random() < odds]:
            content = files.setdefault(name, bytearray())
            if data is None:
                content[:] = content[:at].ljust(at, b"\0")
                continue
            data = data[: self.rng.integers(0, len(data) + 1)] if self.rng.random() < 0.3 else data
            content[:] = content.ljust(at + len(data), b"\0")
            content[at : at + len(data)] = data
        return files


@pytest.mark.skipif(not os.path.isdir("/proc/self/fd"), reason="needs /proc")
@pytest.mark.parametrize("seed", range(3))
def test_a_power_cut_leaves_a_file_that_opens_with_all_that_was_forced(tmp_path, seed):
    rng = np.random.default_rng(seed)
    path, share = tmp_path / "s.h5", 0.15
    with pytest.MonkeyPatch.context() as patch:
        disk = Disk(patch, rng, 0.0)
        session = create_session(path, sync=1e9)
        run = session.start_run([FORCE, ACC], 1000)
        disk.safe[str(path)] = path.read_bytes()
        session._journal.checkpoint()
        disk.share = share
        for k in range(30):
            acknowledged = run.append(block(100 * k, 100))
            disk.cuts += [(disk.forced, disk.left()) for _ in range(2)]
            if rng.random() < 0.25:
                session._journal.checkpoint()
                disk.forced = acknowledged
        session.close()
    assert len(disk.cuts) > 10
    for number, (forced, files) in enumerate(disk.cuts):
        folder = tmp_path / f"cut{number}"
        folder.mkdir()
        for name, content in files.items():
            (folder / os.path.basename(name)).write_bytes(content)
        with open_session(folder / "s.h5") as read:
            n = read.runs[0].n_samples
            assert n >= forced
            assert_array_equal(read.runs[0].raw()[0], np.arange(n))


@pytest.mark.parametrize("at", [1, 2, 3, 6, 7, 8])
def test_a_full_disk_ends_the_run_and_keeps_what_was_before(tmp_path, monkeypatch, at):
    path = tmp_path / "s.h5"
    session = create_session(path)
    with monkeypatch.context() as patch:
        dying(patch, at, OSError(errno.ENOSPC, "No space left on device"))
        acknowledged, error = fill(session, 8)
    assert "the disk is full; everything acknowledged before is kept" in str(error)
    assert sum(run.n_samples for run in session.runs) == (acknowledged or [0])[-1]
    with pytest.raises(StoreError, match="the disk is full"):
        session.add_result("note", "later", {})
    session.close()
    with open_session(path) as read:
        assert sum(run.n_samples for run in read.runs) == (acknowledged or [0])[-1]


def test_a_limit_of_the_operating_system_ends_the_run_cleanly(tmp_path):
    path = tmp_path / "s.h5"
    script = f"""
        import json, resource, signal
        import numpy as np
        from drivers.block import Block
        from labnnum.errors import StoreError
        from labnnum.recording import Channel
        from sessions.store import create_session
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (200_000, 200_000))
        done = 0
        with create_session({str(path)!r}) as session:
            run = session.start_run([Channel("a")], 10, unit="SI")
            try:
                while True:
                    done = run.append(Block(np.arange(done, done + 1000.0)[None], done, 0.0))
            except StoreError as error:
                print(json.dumps([done, str(error)]))
    """
    made = subprocess.run([sys.executable, "-c", textwrap.dedent(script)], capture_output=True, text=True, check=True)
    done, message = json.loads(made.stdout)
    assert "the disk is full" in message
    assert done >= 10_000
    with open_session(path) as session:
        assert_array_equal(session.runs[0].raw()[0], np.arange(done))


def test_an_interrupted_call_leaves_nothing_behind(session, monkeypatch):
    run = session.start_run([FORCE, ACC], 1000)
    run.append(block(0))
    resize, calls = h5py.Dataset.resize, []

    def interrupted(*args):
        calls.append(args)
        if len(calls) == 2:  # the samples are in, their row of the block table is not
            raise KeyboardInterrupt
        return resize(*args)

    with monkeypatch.context() as patch:
        patch.setattr(h5py.Dataset, "resize", interrupted)
        with pytest.raises(KeyboardInterrupt):
            run.append(block(100))
    assert len(calls) == 2
    assert run.n_samples == 100
    run.append(block(100))
    run.finish("stopped by the user")
    with reread(session) as read:
        assert_array_equal(read.runs[0].raw()[0], np.arange(200))
        assert read.runs[0].finished == "stopped by the user"


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
def test_twenty_kills_lose_nothing(request):
    script = request.config.rootpath / "benchmarks" / "kill.py"
    done = subprocess.run(
        [sys.executable, str(script), "--kills", "20", "--seed", "3", "--json"],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    figures = json.loads(done.stdout)
    assert done.returncode == 0, figures
    assert figures["lost"] == figures["unreadable"] == 0
    assert figures["acks"] > 0
