"""From a file of another program to updated parameters: read, estimate, update.

The file is made here first, so that the truth is known: three masses on springs, shaken with noise, and two arrays
in an .npz with a channels.toml that says what they are.
"""

import tempfile
from pathlib import Path

import numpy as np

from labnnum.estimators import H1, Welch
from labnnum.updating import Updater
from sessions.exchange import read_any
from sessions.model import read_model
from sessions.rig import read_rig
from sessions.simulate import Bench, simulate_run
from sessions.starters import write_starter
from sessions.store import create_session, open_session

CHANNELS = """
sample_rate = 512

[[channel]]
name = "force"
quantity = "force"
unit = "lbf"
role = "reference"
node = "1"
direction = "x"

[[channel]]
name = "a3"
unit = "g"
node = "3"
direction = "x"
"""


def make_file(folder: Path, truth: np.ndarray) -> None:
    """hits.npz and channels.toml as another program would have left them, in pounds and g."""
    from drivers.simulated import Drive, Input

    write_starter(folder, "simulated", "chain")
    structure = read_model(folder / "model.toml").structure
    force, _, a3 = read_rig(folder / "rig.toml").channels
    excitation = read_rig(folder / "rig.toml").toml.excitation
    with create_session(folder / "made.h5") as session:
        inputs = [Input(c, full_scale=float("inf"), bits=0) for c in (force, a3)]
        bench = Bench(rate=512.0, noise=0.01, bits=16, oversample=4, seed=1)
        simulate_run(session, structure, truth, inputs, Drive(force), excitation, bench, level=10.0)
    with open_session(folder / "made.h5") as session:
        newtons, acceleration = session.recordings()[0].data
    np.savez(folder / "shaken.npz", force=newtons / 4.4482216152605, a3=acceleration / 9.80665)
    (folder / "channels.toml").write_text(CHANNELS, encoding="utf-8")


def main(folder: Path) -> None:
    truth = np.array([5.6, 5.4e5, 2.8e5])
    make_file(folder, truth)
    model = read_model(folder / "model.toml")

    recordings = read_any(folder / "shaken.npz", channels=folder / "channels.toml")
    frf = H1(Welch(2048, window="hann"))(recordings).require_coherence(0.9, model.bands)
    updater = Updater.train(model.structure, model.bands, frf.outputs, frf.inputs, frf.frequency, samples=100, like=frf)
    estimate = updater.estimate(frf)

    print(f"coherence in the bands is above 0.9; {frf.n_averages:.0f} averages")
    for name, true, value, std in zip(("m3", "k2", "k3"), truth, estimate.value, estimate.std, strict=True):
        within = abs(value - true) < 3 * std
        print(f"{name}: true value within three standard deviations: {within}; std below 1 %: {std < 0.01 * true}")


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as place:
        main(Path(place))

# prints:
# coherence in the bands is above 0.9; 56 averages
# m3: true value within three standard deviations: True; std below 1 %: True
# k2: true value within three standard deviations: True; std below 1 %: True
# k3: true value within three standard deviations: True; std below 1 %: True
