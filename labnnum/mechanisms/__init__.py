"""The catalogue of missing physics: one mechanism a file, listed here once."""

from __future__ import annotations

from labnnum.mechanisms.added_mass import AddedMass
from labnnum.mechanisms.attached_oscillator import AttachedOscillator
from labnnum.mechanisms.axial_preload import AxialPreload
from labnnum.mechanisms.base import ChannelMechanism, Group, Mechanism, Place, Site, Term
from labnnum.mechanisms.channel_clipping import ChannelClipping
from labnnum.mechanisms.channel_delay import ChannelDelay
from labnnum.mechanisms.channel_gain import ChannelGain
from labnnum.mechanisms.channel_highpass import ChannelHighpass
from labnnum.mechanisms.channel_swap import ChannelSwap
from labnnum.mechanisms.clearance import Clearance
from labnnum.mechanisms.coulomb_friction import CoulombFriction
from labnnum.mechanisms.cubic_stiffness import CubicStiffness
from labnnum.mechanisms.drift import Drift
from labnnum.mechanisms.exciter_coupling import ExciterCoupling
from labnnum.mechanisms.extended import ExtendedStructure, extend
from labnnum.mechanisms.ground_stiffness import GroundStiffness
from labnnum.mechanisms.hysteresis import Hysteresis
from labnnum.mechanisms.hysteretic_damping import HystereticDamping
from labnnum.mechanisms.joint_stiffness import JointStiffness
from labnnum.mechanisms.local_dashpot import LocalDashpot
from labnnum.mechanisms.nonlinear_law import NonlinearMechanism
from labnnum.mechanisms.one_sided_gap import OneSidedGap
from labnnum.mechanisms.out_of_plane_mode import OutOfPlaneMode
from labnnum.mechanisms.quadratic_damping import QuadraticDamping
from labnnum.mechanisms.quadratic_stiffness import QuadraticStiffness
from labnnum.mechanisms.recording_filter import RecordingFilter
from labnnum.mechanisms.shear_rotary import ShearRotary
from labnnum.mechanisms.stick_slip import StickSlip
from labnnum.mechanisms.support_compliance import SupportCompliance
from labnnum.mechanisms.viscoelastic import Viscoelastic

CATALOGUE: tuple[Mechanism, ...] = (
    AddedMass(),
    GroundStiffness(),
    SupportCompliance(),
    JointStiffness(),
    LocalDashpot(),
    HystereticDamping(),
    Viscoelastic(),
    AttachedOscillator(),
    OutOfPlaneMode(),
    ShearRotary(),
    AxialPreload(),
    ExciterCoupling(),
    CubicStiffness(),
    QuadraticStiffness(),
    OneSidedGap(),
    Clearance(),
    CoulombFriction(),
    QuadraticDamping(),
    StickSlip(),
    Hysteresis(),
    ChannelGain(),
    ChannelDelay(),
    ChannelHighpass(),
    ChannelClipping(),
    ChannelSwap(),
    RecordingFilter(),
    Drift(),
)
"""Every mechanism that the diagnosis tries, in the order of the documentation."""

__all__ = [
    "CATALOGUE",
    "ChannelMechanism",
    "ExtendedStructure",
    "Group",
    "Mechanism",
    "NonlinearMechanism",
    "Place",
    "Site",
    "Term",
    "extend",
]
