"""A structure of your own: its matrices and nothing else; FRFs, exact sensitivities and updating come with it.

Here two discs on a shaft in torsion, fixed at one end. The stiffness of each half of the shaft is unknown.
"""

from dataclasses import dataclass
from typing import final

import numpy as np

from labnnum.frf import Frf
from labnnum.parameters import Parameter
from labnnum.recording import Channel
from labnnum.response import frf, modes
from labnnum.structures.base import Matrices, Structure
from labnnum.updating.refine import refine


@final
@dataclass(frozen=True)
class Shaft(Structure):
    """Two discs: J1 q1'' + k1 q1 + k2 (q1 - q2) = M1, J2 q2'' + k2 (q2 - q1) = M2, with structural damping."""

    inertia: tuple[float, float] = (0.02, 0.01)
    loss: float = 0.01

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return (Parameter("k1", 8e3, 5e3, 11e3, "N*m/rad"), Parameter("k2", 5e3, 3e3, 7e3, "N*m/rad"))

    @property
    def dofs(self) -> tuple[str, ...]:
        return ("1:rz", "2:rz")

    def matrices(self, theta: np.ndarray) -> Matrices:
        k1, k2 = theta
        M = np.diag(self.inertia)
        K = np.array([[k1 + k2, -k2], [-k2, k2]])
        return Matrices(M, 0 * M, K, self.loss * K)

    def participation(self, dof: str, theta: np.ndarray) -> np.ndarray:
        return np.eye(2)[self.require_dof(dof)]


def main() -> None:
    shaft = Shaft()
    moment = Channel("moment", "moment", "reference", "2", "rz")
    discs = [Channel(name, "angular_acceleration", "response", name[-1], "rz") for name in ("disc1", "disc2")]
    truth = np.array([8.7e3, 4.4e3])
    print("natural frequencies, nominal:", modes(shaft, shaft.nominal).frequency.round(2))

    lines = np.linspace(40.0, 220.0, 361)
    exact = frf(shaft, truth, lines, discs, [moment])
    rng = np.random.default_rng(0)
    error = 0.02 * np.abs(exact)
    noise = error * (rng.standard_normal(exact.shape) + 1j * rng.standard_normal(exact.shape)) / np.sqrt(2)
    measured = Frf(lines, exact + noise, tuple(discs), (moment,), variance=error**2)

    found = refine(shaft, measured)
    for p, true, value, std in zip(found.parameters, truth, found.value, found.std, strict=True):
        print(f"{p.name}: {value:.0f} {p.unit}, true value within three of {std:.1f}: {abs(value - true) < 3 * std}")


if __name__ == "__main__":
    main()

# prints:
# natural frequencies, nominal: [ 73.55 154.01]
# k1: 8700 N*m/rad, true value within three of 0.9: True
# k2: 4400 N*m/rad, true value within three of 0.4: True
