from dataclasses import replace

import h5py
import numpy as np
import pytest

from labnnum.bands import Band
from labnnum.errors import FileError, ModelError
from labnnum.frf import Frf
from labnnum.recording import Channel
from labnnum.response import frf
from labnnum.updating import Updater
from labnnum.updating.gains import n_polynomials
from labnnum.updating.training import TrainingSet
from sessions.model import read_model
from sessions.updaters import load_training, load_updater, save_training, save_updater

MODEL = """
[structure]
kind = "chain"
[[structure.mass]]
node = "1"
mass = 2.0
[[structure.mass]]
node = "2"
mass = "m"
[[structure.link]]
between = ["1", "ground"]
stiffness = "k"
damping = 4.0
[[structure.link]]
between = ["1", "2"]
stiffness = 3000.0
damping = 2.0
[[parameter]]
name = "k"
nominal = 5000.0
lower = 3500.0
upper = 6500.0
std = 500.0
unit = "N/m"
[[parameter]]
name = "m"
nominal = 1.0
lower = 0.8
upper = 1.2
unit = "kg"
[[band]]
low = 3.0
high = 8.0
[[band]]
low = 8.0
high = 14.0
"""
LINES = np.linspace(2.0, 15.0, 131)
OUT = (Channel("a", "acceleration", "response", "2", "x"),)
IN = (Channel("f", "force", "reference", "1", "x"),)


@pytest.fixture(scope="module")
def case(tmp_path_factory):
    folder = tmp_path_factory.mktemp("updater")
    (folder / "model.toml").write_text(MODEL)
    model = read_model(folder / "model.toml")
    trained = Updater.train(model.structure, model.bands, OUT, IN, LINES, samples=64, noise=0.01)
    return folder, model, trained, save_updater(folder / "updater.h5", trained, model)


def test_a_stored_updater_answers_the_same(case):
    _, model, trained, path = case
    again = load_updater(path)
    x = trained.features(LINES, np.ones((3, 1, 1, LINES.size)) * (1 + 0.1j))
    assert np.array_equal(again.predict(x), trained.predict(x))
    assert again.bands == trained.bands == (Band(3.0, 8.0), Band(8.0, 14.0))
    assert again.outputs == OUT
    assert again.settings == trained.settings
    assert [p.name for p in again.structure.parameters] == ["k", "m"]
    assert np.array_equal(again.novelty.box, trained.novelty.box)
    assert load_updater(path, model.structure).structure is model.structure


def test_the_random_error_taken_for_the_training_comes_back_and_may_be_missing(case, tmp_path):
    _, model, _, path = case
    value = frf(model.structure, [5200.0, 1.05], LINES, OUT, IN)
    exact = [Frf(LINES, value, OUT, IN, variance=(share * np.abs(value)) ** 2) for share in (0.005, 0.03)]
    like, noisier = exact
    trained = Updater.train(model.structure, model.bands, OUT, IN, LINES, samples=64, like=like)
    stored = save_updater(tmp_path / "like.h5", trained)
    again = load_updater(stored, model.structure)
    assert again.trained_variance is not None
    assert np.allclose(again.trained_variance, 0.005**2, rtol=1e-9)
    wanted = trained.network_estimate(noisier).std
    assert np.array_equal(again.network_estimate(noisier).std, wanted)
    assert (wanted > 1.2 * np.sqrt(np.diag(trained.network.residual))).any()
    with h5py.File(stored, "a") as file:
        del file["trained_variance"]
    older = load_updater(stored, model.structure)
    assert older.trained_variance is None
    assert (older.network_estimate(noisier).std >= (1 - 1e-9) * wanted).all()
    assert load_updater(path).trained_variance is None


def test_another_model_is_refused(case, tmp_path):
    path = case[-1]
    (tmp_path / "stiffer.toml").write_text(MODEL.replace("3000.0", "3001.0"))
    with pytest.raises(ModelError, match=r"updater\.h5 was trained on another model"):
        load_updater(path, read_model(tmp_path / "stiffer.toml").structure)
    (tmp_path / "renamed.toml").write_text(MODEL.replace('"m"', '"tip"'))
    with pytest.raises(ModelError, match="for the parameters k, m; the model has k, tip"):
        load_updater(path, read_model(tmp_path / "renamed.toml").structure)


def test_nothing_is_written_over(case, tmp_path):
    _, model, trained, path = case
    before = path.read_bytes()
    with pytest.raises(FileError, match="exists already"):
        save_updater(path, trained, model)
    assert path.read_bytes() == before
    with pytest.raises(FileError, match="no folder"):
        save_updater(tmp_path / "absent" / "u.h5", trained)


def test_files_that_are_no_updaters_are_refused(case, tmp_path):
    path = case[-1]
    with pytest.raises(FileError, match="no such updater"):
        load_updater(tmp_path / "none.h5")
    cut = tmp_path / "cut.h5"
    cut.write_bytes(path.read_bytes()[:3000])
    with pytest.raises(FileError, match="no HDF5 file, or cut short"):
        load_updater(cut)
    foreign = tmp_path / "foreign.h5"
    with h5py.File(foreign, "w") as file:
        file.attrs["format"] = "something"
    with pytest.raises(FileError, match="is no updater but a something"):
        load_updater(foreign)
    newer = tmp_path / "newer.h5"
    newer.write_bytes(path.read_bytes())
    with h5py.File(newer, "a") as file:
        file.attrs["version"] = 99
    with pytest.raises(FileError, match="format 99"):
        load_updater(newer)
    damaged = tmp_path / "damaged.h5"
    damaged.write_bytes(path.read_bytes())
    with h5py.File(damaged, "a") as file:
        del file["network/weights"]
    with pytest.raises(FileError, match=r"damaged\.h5: is damaged"):
        load_updater(damaged, case[1].structure)


def changed(path, to, *, version, without=()):
    """A copy of an updater file that states another format and lacks some of its arrays."""
    to.write_bytes(path.read_bytes())
    with h5py.File(to, "a") as file:
        file.attrs["version"] = version
        for name in without:
            del file[f"network/{name}"]
    return to


def test_a_file_of_format_1_is_read_and_answers_without_a_second_stage(case, tmp_path):
    _, _, trained, path = case
    with h5py.File(path, "r") as file:
        assert file.attrs["version"] == 2
    old = changed(path, tmp_path / "old.h5", version=1, without=("gains", "reach"))
    (tmp_path / "model.toml").write_text(MODEL)
    again = load_updater(old)
    first = replace(trained.network, gains=np.empty((0, 0, 0)), reach=np.empty(0))
    x = trained.features(LINES, np.ones((3, 1, 1, LINES.size)) * (1 + 0.1j))
    assert again.network.gains.size == 0
    assert np.array_equal(again.predict(x), first(x))


def test_a_second_stage_comes_back_and_is_missed_where_its_format_has_it(case, tmp_path):
    _, model, trained, path = case
    n_in, n_out = trained.network.centres.shape[1], 2
    gains = np.random.default_rng(1).normal(size=(n_polynomials(n_out, 2), 1 + n_in, n_out))
    staged = replace(trained, network=replace(trained.network, gains=gains, reach=np.full(n_out, 1.7)))
    again = load_updater(save_updater(tmp_path / "staged.h5", staged, model))
    x = trained.features(LINES, np.ones((3, 1, 1, LINES.size)) * (1 + 0.1j))
    assert np.array_equal(again.predict(x), staged.predict(x))
    assert not np.array_equal(again.predict(x), trained.predict(x))
    with pytest.raises(FileError, match=r"lacking\.h5: is damaged: network/reach is missing; train it again"):
        load_updater(changed(path, tmp_path / "lacking.h5", version=2, without=("reach",)), model.structure)
    with pytest.raises(FileError, match=r"unnumbered\.h5: states no format from 1 to 2"):
        load_updater(changed(path, tmp_path / "unnumbered.h5", version=0))


def test_without_a_model_file_the_model_must_be_named(case, tmp_path):
    trained = case[2]
    path = save_updater(tmp_path / "bare.h5", trained)
    with pytest.raises(FileError, match="--model"):
        load_updater(path)
    assert load_updater(path, trained.structure).features == trained.features


def test_an_unfinished_training_set_is_kept_for_its_plan_only(tmp_path):
    key = np.arange(5.0)
    features = np.vstack([np.ones((32, 3)), np.full((8, 3), np.nan)])
    data = TrainingSet(np.arange(80.0).reshape(40, 2), features, 32)
    path = tmp_path / "u.h5.training"
    assert load_training(path, key) is None
    save_training(path, data, key)
    again = load_training(path, key)
    assert again is not None
    assert again.done == 32
    assert np.array_equal(again.features, features, equal_nan=True)
    assert load_training(path, key + 1) is None
    path.write_bytes(b"rubbish")
    with pytest.raises(FileError, match="cannot be read"):
        load_training(path, key)
