"""A bench that does not exist, as a driver like any other."""

from drivers.simulated.bench import Faults, SimulatedBench
from drivers.simulated.exciter import SimulatedExciter
from drivers.simulated.inputs import Input
from drivers.simulated.plant import Drive, Shaker, element, plant, with_chain
from drivers.simulated.sources import TIPS, FunctionWave, Hammer, Hit, Operator, Player, Silence, Source, blow

__all__ = [
    "TIPS",
    "Drive",
    "Faults",
    "FunctionWave",
    "Hammer",
    "Hit",
    "Input",
    "Operator",
    "Player",
    "Shaker",
    "Silence",
    "SimulatedBench",
    "SimulatedExciter",
    "Source",
    "blow",
    "element",
    "plant",
    "with_chain",
]
