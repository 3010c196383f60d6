"""Frames against beams, closed forms and statics."""

import numpy as np
import pytest

from labnnum.errors import ConfigError, ModelError
from labnnum.parameters import Parameter
from labnnum.recording import DIRECTIONS, Channel
from labnnum.response import frf, modes
from labnnum.structures import Frame
from labnnum.structures.frame import JointMass, JointSpring, Member, Profile, torsion_constant, unit_matrices

E, RHO, W, H, L = 2.1e11, 7850.0, 0.03, 0.01, 0.9
BAR = Profile(E=E, rho=RHO, width=W, height=H)
ROD = Profile(E=E, rho=RHO, diameter=0.02, bore=0.012)


def straight(along, n=16, profile=BAR, fixed=DIRECTIONS, **more):
    """A clamped line of n members along a direction in space."""
    along = np.array(along, float) / np.linalg.norm(along)
    nodes = {str(i): tuple(along * L * i / n) for i in range(n + 1)}
    members = tuple(Member(str(i), str(i + 1), "p", **({"up": more["up"]} if "up" in more else {})) for i in range(n))
    more.pop("up", None)
    return Frame(nodes, {"p": profile}, members, fixed={"0": fixed}, **more)


def bending(stiff, mass_per_length, root):
    return root**2 * np.sqrt(stiff / mass_per_length) / L**2 / (2 * np.pi)


@pytest.mark.parametrize("along", [(1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 2, -0.5)])
def test_a_line_in_space_bends_twists_and_stretches_whichever_way_it_points(along):
    s = straight(along)
    found = modes(s, [], 60).frequency
    area = W * H
    j = torsion_constant(W, H)
    wanted = [
        bending(E * W * H**3 / 12, RHO * area, 1.875104069),
        bending(E * W * H**3 / 12, RHO * area, 4.694091133),
        bending(E * H * W**3 / 12, RHO * area, 1.875104069),
        np.sqrt(E / 2.6 * j / (RHO * W * H * (W**2 + H**2) / 12)) / (4 * L),
        np.sqrt(E / RHO) / (4 * L),
    ]
    for f in wanted:
        assert np.abs(found / f - 1).min() < 5e-4


def test_up_turns_the_section():
    for up, wide in (((0, 0, 1), False), ((0, 1, 0), True)):
        s = straight((1, 0, 0), up=up)
        tip, push = Channel("w", "displacement", "response", "16", "z"), Channel("f", "force", "reference", "16", "z")
        second = H * W**3 / 12 if wide else W * H**3 / 12
        assert frf(s, [], [0.0], [tip], [push])[0, 0, 0].real == pytest.approx(L**3 / (3 * E * second), rel=1e-8)


def test_statics_of_a_bent_bar():
    """An L in the plane: force across the second leg's tip bends both legs and twists the first (Castigliano)."""
    a, b = 0.5, 0.3
    nodes = {"0": (0.0, 0.0, 0.0), "1": (a, 0.0, 0.0), "2": (a, b, 0.0)}
    s = Frame(nodes, {"r": ROD}, (Member("0", "1", "r"), Member("1", "2", "r")), fixed={"0": DIRECTIONS})
    second = np.pi / 64 * (0.02**4 - 0.012**4)
    ei, gj = E * second, E / 2.6 * 2 * second
    tip, push = Channel("w", "displacement", "response", "2", "z"), Channel("f", "force", "reference", "2", "z")
    exact = a**3 / (3 * ei) + b**3 / (3 * ei) + a * b**2 / gj
    assert frf(s, [], [0.0], [tip], [push])[0, 0, 0].real == pytest.approx(exact, rel=1e-9)


def test_planes_keep_what_happens_in_them():
    space = modes(straight((1, 0, 0)), [], 6).frequency
    for plane in ("xy", "xz"):
        flat = modes(straight((1, 0, 0), plane=plane), [], 2).frequency
        assert all(np.abs(space / f - 1).min() < 1e-8 for f in flat)


def test_a_free_frame_has_six_rigid_motions():
    nodes = {"a": (0.0, 0.0, 0.0), "b": (0.4, 0.1, 0.0), "c": (0.2, 0.3, 0.5)}
    s = Frame(nodes, {"r": ROD}, (Member("a", "b", "r"), Member("b", "c", "r"), Member("c", "a", "r")))
    f = modes(s, []).frequency
    assert (f[:6] == 0).all()
    assert f[6] > 1


def test_equivalent_length_scales_mass_and_stiffness():
    free = Profile(E=E, rho=RHO, width=W, height=H, equivalent="L", reference=0.27)
    s = straight((1, 0, 0), profile=free, parameters=(Parameter("L", 0.27, 0.2, 0.3),))
    ratio = 0.25 / 0.27
    f0, f1 = (modes(s, [value], 2).frequency for value in (0.27, 0.25))
    np.testing.assert_allclose(f1 / f0, ratio**-2, rtol=1e-9)


def test_torsion_constants():
    """Timoshenko and Goodier's table: 0.1406 for a square, 0.229 for two to one, 1/3 for a strip."""
    assert torsion_constant(1.0, 1.0) == pytest.approx(0.1406, abs=5e-5)
    assert torsion_constant(1.0, 2.0) == pytest.approx(0.2287 * 2, rel=1e-3)
    assert torsion_constant(100.0, 1.0) == pytest.approx(100 / 3 * (1 - 0.0063), rel=1e-4)


def test_element_matrices_carry_rigid_motion():
    unit = unit_matrices(0.7)
    shift = np.tile(np.r_[np.ones(3), np.zeros(3)], 2)
    for name in ("EA", "GJ", "EIy", "EIz"):
        assert np.linalg.eigvalsh(unit[name]).min() > -1e-9
        np.testing.assert_allclose(unit[name] @ shift, 0.0, atol=1e-9)
    assert shift @ unit["rhoA"] @ shift == pytest.approx(3 * 0.7)


def test_joint_masses_and_springs():
    s = straight((1, 0, 0), masses=(JointMass("16", 5.0),), springs=(JointSpring("16", "z", 2e4, 3.0),))
    bare = straight((1, 0, 0))
    m, m0 = s.matrices(np.zeros(0)), bare.matrices(np.zeros(0))
    at = s.require_dof("16:z")
    assert m.M[at, at] - m0.M[at, at] == pytest.approx(5.0)
    assert m.K[at, at] - m0.K[at, at] == pytest.approx(2e4)
    assert m.C[at, at] == pytest.approx(3.0)


def test_base_motion_of_a_rigid_frame_is_carried():
    s = straight((0, 0, 1), base="x")
    tip = Channel("a", "acceleration", "response", "16", "x")
    foot = Channel("a", "acceleration", "response", "0", "x")
    across = Channel("b", "acceleration", "response", "16", "y")
    base = Channel("base", "acceleration", "base", "0", "x")
    out = frf(s, [], [0.01], [tip, foot, across], [base])[:, 0, 0]
    np.testing.assert_allclose(out, [1.0, 1.0, 0.0], atol=1e-4)


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ({"members": (Member("0", "9", "p"),)}, "member at '9'"),
        ({"members": (Member("0", "1", "q"),)}, "no profile 'q'"),
        ({"members": (Member("0", "0", "p"),)}, "'0' - '0' has no length"),
        ({"members": (Member("0", "1", "p", (1.0, 0.0, 0.0)),), "damping": None}, "up must not point along"),
        ({"fixed": {"7": ("x",)}}, "support at '7'"),
        ({"fixed": {"0": ("u",)}}, "support direction 'u'"),
        ({"masses": (JointMass("7", 1.0),)}, "mass at '7'"),
        ({"springs": (JointSpring("1", "w", 1.0),)}, "spring direction 'w'"),
        ({"plane": "zx"}, "frame plane 'zx'"),
        ({"plane": "xy", "base": "z"}, "base = 'z': the frame's nodes move along x, y"),
        ({"profiles": {"p": Profile(E=E, rho=RHO, width=0.1)}}, "a profile needs diameter"),
        ({"profiles": {"p": Profile(E=E, rho=RHO, diameter=0.1, equivalent=1.0)}}, "belong together"),
    ],
)
def test_frames_that_cannot_be(more, said):
    plain = {"positions": {"0": (0.0, 0.0, 0.0), "1": (1.0, 0.0, 0.0)}, "profiles": {"p": BAR}}
    plain |= {"members": (Member("0", "1", "p"),), "fixed": {"0": DIRECTIONS}}
    more = {k: v for k, v in more.items() if v is not None}
    with pytest.raises(ConfigError, match=said):
        Frame(**(plain | more)).matrices(np.zeros(0))


def test_a_frame_without_base():
    with pytest.raises(ModelError, match="supports do not move"):
        straight((1, 0, 0)).rigid(np.zeros(0))
