"""A hammer session on a bench that does not exist: every hit is kept, the bad ones with the reason."""

import tempfile
from collections import Counter
from pathlib import Path

from sessions.bench import measure
from sessions.devices import model_text
from sessions.rig import read_rig
from sessions.starters import write_starter
from sessions.store import open_session


def main(folder: Path) -> None:
    write_starter(folder, "simulated-hammer", "frame", seed=2)
    rig = read_rig(folder / "rig.toml")
    outcome = measure(rig, folder / "frame.h5", model_text=model_text(rig))

    with open_session(folder / "frame.h5") as session:
        for run in session.runs:
            accepted = sum(hit.accepted for hit in run.hits)
            why = Counter(hit.reason.split(":")[0] for hit in run.hits if not hit.accepted)
            print(f"{run.info['item']}: {accepted} accepted, rejected: {dict(why) or 'none'}")
    for name, frf in outcome.frfs.items():
        if frf.coherence is not None:
            print(f"{name}: H1 of {frf.n_averages:.0f} hits, coherence above 0.9: {frf.coherence.mean() > 0.9}")


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as place:
        main(Path(place))

# prints:
# hammer 2:x: 5 accepted, rejected: {'double hit': 1}
# hammer 3:-x: 5 accepted, rejected: {'double hit': 1}
# hammer 2:x: H1 of 5 hits, coherence above 0.9: True
# hammer 3:-x: H1 of 5 hits, coherence above 0.9: True
