"""Compiled sums over modes and lines: what every evaluation of an engine is made of.

Modes are numbered r, responses o, inputs i, motions at which terms act k and lines f, which come last in each array.
Each function takes contiguous arrays and returns new ones.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray


@njit(cache=True, error_model="numpy")
def placed(omega, zeta, band, outside, shift, log_zeta):  # pragma: no cover - compiled
    """Frequencies and damping ratios of all modes, those in the band offset by `shift` and damped as fitted; what is
    guessed of the others' damping follows.
    """
    w, z = omega.copy(), zeta[: omega.size].copy()
    common = 0.0
    for j in range(band.size):
        w[band[j]] *= 1 + shift[j]
        common += log_zeta[j] - np.log(z[band[j]])
        z[band[j]] = np.exp(log_zeta[j])
    for r in outside:
        z[r] = min(z[r] * np.exp(common / band.size), 0.95)
    return w, z


@njit(cache=True, error_model="numpy")
def receptances(omega, zeta, share, cords, rigid, s):  # pragma: no cover - compiled
    """Receptances (r, f) 1 / (omega^2 + 2 zeta omega rate + s^2), the rate s, or i omega by `share`; `cords` s more on
    the first `rigid` modes.
    """
    d = np.empty((omega.size, s.size), np.complex128)
    for r in range(omega.size):
        w, loss = omega[r], 2 * zeta[r] * omega[r]
        first = loss * (1 - share) + (cords if r < rigid else 0.0)
        for f in range(s.size):
            real, imag = s[f].real, s[f].imag
            a = w * w + first * real + real * real - imag * imag
            b = first * imag + loss * share * w + 2 * real * imag
            size = a * a + b * b
            d[r, f] = complex(a / size, -b / size)
    return d


@njit(cache=True, error_model="numpy")
def summed(left, right, d, static, slope, s):  # pragma: no cover - compiled
    """Sum over modes of left (r, a) d (r, f) right (r, b), and beside it static - slope s^2: (a, b, f)."""
    out = np.empty((left.shape[1], right.shape[1], s.size), np.complex128)
    for a in range(left.shape[1]):
        for b in range(right.shape[1]):
            one = out[a, b]
            for f in range(s.size):
                one[f] = static[a, b] - slope[a, b] * (s[f] * s[f])
            for r in range(d.shape[0]):
                size = left[r, a] * right[r, b]
                if size != 0.0:
                    for f in range(s.size):
                        one[f] += size * d[r, f]
    return out


@njit(cache=True, error_model="numpy")
def spread(left, d):  # pragma: no cover - compiled
    """Participations left (r, a) times d (r, f): (r, a, f)."""
    out = np.empty((left.shape[0], left.shape[1], d.shape[1]), np.complex128)
    for r in range(left.shape[0]):
        for a in range(left.shape[1]):
            for f in range(d.shape[1]):
                out[r, a, f] = left[r, a] * d[r, f]
    return out


@njit(cache=True, error_model="numpy")
def paired(left, right):  # pragma: no cover - compiled
    """Sum over m of left (m, o, f) and right (n, m, i, f): (n, o, i, f)."""
    n, m, n_i, n_f = right.shape
    out = np.zeros((n, left.shape[1], n_i, n_f), np.complex128)
    for j in range(n):
        for r in range(m):
            for o in range(left.shape[1]):
                for i in range(n_i):
                    for f in range(n_f):
                        out[j, o, i, f] += left[r, o, f] * right[j, r, i, f]
    return out


def across(a: NDArray, b: NDArray) -> NDArray[np.complex128]:
    """Sum over k of a (j, k, f) and b (k, c, f): (j, c, f)."""
    return _across(a, b) if b.shape[1] < 3 or b.shape[0] < 3 else _across_parts(a, b)


@njit(cache=True, error_model="numpy")
def _across(a, b):  # pragma: no cover - compiled
    out = np.zeros((a.shape[0], b.shape[1], a.shape[2]), np.complex128)
    for j in range(a.shape[0]):
        for k in range(a.shape[1]):
            for c in range(b.shape[1]):
                for f in range(a.shape[2]):
                    out[j, c, f] += a[j, k, f] * b[k, c, f]
    return out


@njit(cache=True, error_model="numpy")
def _across_parts(a, b):  # pragma: no cover - compiled
    """The same by real and imaginary parts, which pays where each is used several times."""
    (n_j, n_k, n_f), n_c = a.shape, b.shape[1]
    out = np.empty((n_j, n_c, n_f), np.complex128)
    real_b, imag_b = b.real.copy(), b.imag.copy()
    real, imag = np.empty(n_f), np.empty(n_f)
    for j in range(n_j):
        real_a, imag_a = a[j].real.copy(), a[j].imag.copy()
        for c in range(n_c):
            real[:] = 0.0
            imag[:] = 0.0
            for k in range(n_k):
                p, q, u, v = real_a[k], imag_a[k], real_b[k, c], imag_b[k, c]
                for f in range(n_f):
                    real[f] += p[f] * u[f] - q[f] * v[f]
                    imag[f] += p[f] * v[f] + q[f] * u[f]
            for f in range(n_f):
                out[j, c, f] = complex(real[f], imag[f])
    return out


def turned(w: NDArray, b: NDArray) -> NDArray[np.complex128]:
    """Sum over m of real w (k, m) and b (m, c, f): (k, c, f), as one real product."""
    return (w @ b.reshape(len(b), -1).view(np.float64)).view(np.complex128).reshape(len(w), *b.shape[1:])


@njit(cache=True, error_model="numpy")
def solved(a, left, right):  # pragma: no cover - compiled
    """(I + a) x = [left, right] on each line: a (k, k, f), left (k, i, f), right (o, k, f) as (k, o, f)."""
    k, n_i, n_o, n_f = a.shape[0], left.shape[1], right.shape[0], a.shape[2]
    one, two = np.empty((k, n_i, n_f), np.complex128), np.empty((k, n_o, n_f), np.complex128)
    own, rhs = np.empty((k, k), np.complex128), np.empty((k, n_i + n_o), np.complex128)
    for f in range(n_f):
        for i in range(k):
            own[i] = a[i, :, f]
            own[i, i] += 1.0
            rhs[i, :n_i] = left[i, :, f]
            rhs[i, n_i:] = right[:, i, f]
        eliminate(own, rhs)
        one[:, :, f] = rhs[:, :n_i]
        two[:, :, f] = rhs[:, n_i:]
    return one, two


@njit(cache=True, error_model="numpy")
def eliminate(a, b):  # pragma: no cover - compiled
    """Turns b into the solution x of a x = b, by elimination with the largest pivot of each column; a is used up."""
    k = a.shape[0]
    for p in range(k):
        best = p
        for i in range(p + 1, k):
            if abs(a[i, p]) > abs(a[best, p]):
                best = i
        if best != p:
            for c in range(k):
                a[p, c], a[best, c] = a[best, c], a[p, c]
            for c in range(b.shape[1]):
                b[p, c], b[best, c] = b[best, c], b[p, c]
        for i in range(p + 1, k):
            ratio = a[i, p] / a[p, p]
            for c in range(p + 1, k):
                a[i, c] -= ratio * a[p, c]
            for c in range(b.shape[1]):
                b[i, c] -= ratio * b[p, c]
    for p in range(k - 1, -1, -1):
        for j in range(p + 1, k):
            for c in range(b.shape[1]):
                b[p, c] -= a[p, j] * b[j, c]
        for c in range(b.shape[1]):
            b[p, c] /= a[p, p]


@njit(cache=True, error_model="numpy")
def coupled(g, z_in, z_out, h0, dw, q, x, p):  # pragma: no cover - compiled
    """The forces -g z (k, k, f) of motions z_in (k, i, f) added to q (r, i, f) through dw (r, k, f) and to x (o, i, f)
    through h0 (o, k, f), those of z_out (k, o, f) to p (r, o, f).
    """
    n_k, n_i, n_f = z_in.shape
    n_o = z_out.shape[1]
    one, two = np.zeros((n_k, n_i, n_f), np.complex128), np.zeros((n_k, n_o, n_f), np.complex128)
    for k in range(n_k):
        for j in range(n_k):
            for i in range(n_i):
                for f in range(n_f):
                    one[k, i, f] -= g[k, j, f] * z_in[j, i, f]
            for o in range(n_o):
                for f in range(n_f):
                    two[k, o, f] -= g[k, j, f] * z_out[j, o, f]
    for k in range(n_k):
        for i in range(n_i):
            for o in range(n_o):
                for f in range(n_f):
                    x[o, i, f] += h0[o, k, f] * one[k, i, f]
        for r in range(dw.shape[0]):
            for i in range(n_i):
                for f in range(n_f):
                    q[r, i, f] += dw[r, k, f] * one[k, i, f]
            for o in range(n_o):
                for f in range(n_f):
                    p[r, o, f] += dw[r, k, f] * two[k, o, f]


@njit(cache=True, error_model="numpy")
def rates(omega, zeta, share, follows, s):  # pragma: no cover - compiled
    """What a relative change of its damping ratio, one of its frequency and a larger share of hysteretic damping add to
    each mode's dynamic stiffness, (r, f); `follows` (r,) is what moves with the frequency besides.
    """
    shape = (omega.size, s.size)
    damped, stiffer, swing = (
        np.empty(shape, np.complex128),
        np.empty(shape, np.complex128),
        np.empty(shape, np.complex128),
    )
    for r in range(omega.size):
        w, twice = omega[r], 2 * zeta[r] * omega[r]
        for f in range(s.size):
            rate = (1 - share) * s[
                f
            ] + 1j * share * w  # what damping acts on: velocity, or displacement at a right angle
            damped[r, f] = twice * rate
            stiffer[r, f] = 2 * w * w + twice * (rate + 1j * share * w) + follows[r]
            swing[r, f] = twice * (1j * w - s[f])
    return damped, stiffer, swing


@njit(cache=True, error_model="numpy")
def state_slopes(stiffer, q, p, d_log, d_load, d_out):  # pragma: no cover - compiled
    """Displacements (n, o, i, f) by each of n parameters of the structure, what terms add left aside.

    `stiffer` (r, f) is what a relative change of its frequency adds to a mode's dynamic stiffness; derivatives as in
    `point.State`; q (r, i, f) and p (r, o, f) are the modes' responses to the inputs and by which the outputs follow.
    """
    n, (n_r, n_i, n_f), n_o = d_log.shape[0], q.shape, p.shape[1]
    out = np.zeros((n, n_o, n_i, n_f), np.complex128)
    push = np.empty(n_f, np.complex128)
    for j in range(n):
        for r in range(n_r):
            for i in range(n_i):
                for f in range(n_f):
                    push[f] = d_load[j, r, i] - d_log[j, r] * stiffer[r, f] * q[r, i, f]
                for o in range(n_o):
                    for f in range(n_f):
                        out[j, o, i, f] += p[r, o, f] * push[f] + d_out[j, r, o] * q[r, i, f]
    return out


@njit(cache=True, error_model="numpy")
def mode_slopes(stiffer, damped, q, p, band, outside, over, load, out):  # pragma: no cover - compiled
    """Into out (n, o, i, f): derivatives by the frequency offset of each band mode, by its damping, which the others'
    follows, and by its load.

    `stiffer` and `damped` (r, f) are what relative changes of frequency and damping add to each mode's dynamic
    stiffness, `over` (b,) that by which frequencies are offset and `load` (b,) the typical loads.
    """
    n_b, n_o, n_i, n_f = band.size, p.shape[1], q.shape[1], q.shape[2]
    shared = np.zeros((n_o, n_i, n_f), np.complex128)
    for r in outside:
        for i in range(n_i):
            for o in range(n_o):
                for f in range(n_f):
                    shared[o, i, f] += damped[r, f] * q[r, i, f] * p[r, o, f]
    for j in range(n_b):
        r = band[j]
        for o in range(n_o):
            for i in range(n_i):
                for f in range(n_f):
                    pair = p[r, o, f] * q[r, i, f]
                    out[j, o, i, f] = -stiffer[r, f] * pair / over[j]
                    out[n_b + j, o, i, f] = -damped[r, f] * pair - shared[o, i, f] / n_b
                    out[2 * n_b + j, o, i, f] = p[r, o, f] * load[j]


@njit(cache=True, error_model="numpy")
def weighed(factors, q, p, out):  # pragma: no cover - compiled
    """Into out (o, i, f): sum over modes of factors (r, f) p (r, o, f) q (r, i, f)."""
    out[:] = 0.0
    for r in range(p.shape[0]):
        for i in range(q.shape[1]):
            for o in range(p.shape[1]):
                for f in range(q.shape[2]):
                    out[o, i, f] += p[r, o, f] * (factors[r, f] * q[r, i, f])


@njit(cache=True, error_model="numpy")
def forced(x, h, force):  # pragma: no cover - compiled
    """Displacements x (o, i, f) and what each of n forces (n, k, i, f) adds through h (o, k, f): (n, o, i, f)."""
    n, n_k, n_i, n_f = force.shape
    out = np.empty((n, x.shape[0], n_i, n_f), np.complex128)
    for j in range(n):
        for o in range(x.shape[0]):
            for i in range(n_i):
                one = out[j, o, i]
                one[:] = x[o, i]
                for k in range(n_k):
                    for f in range(n_f):
                        one[f] += h[o, k, f] * force[j, k, i, f]
    return out


@njit(cache=True, error_model="numpy")
def put(columns, values, factor):  # pragma: no cover - compiled
    """Into columns (n, o i, 2 f): real and imaginary parts of values (n, o, i, f) times factor (o, i, f).

    Either may have one response or input only, which then stands for all.
    """
    n_f = values.shape[3]
    n_o, n_i = max(values.shape[1], factor.shape[0]), max(values.shape[2], factor.shape[1])
    for n in range(values.shape[0]):
        for o in range(n_o):
            for i in range(n_i):
                one = values[n, min(o, values.shape[1] - 1), min(i, values.shape[2] - 1)]
                two = factor[min(o, factor.shape[0] - 1), min(i, factor.shape[1] - 1)]
                row = columns[n, o * n_i + i]
                for f in range(n_f):
                    z = one[f] * two[f]
                    row[f] = z.real
                    row[n_f + f] = z.imag


@njit(cache=True, error_model="numpy")
def eliminated(gram, n):  # pragma: no cover - compiled
    """First n rows (rows, n, a) of the Cholesky factor U of each Gram matrix (rows, a, a) = U'U, one added to the first
    n diagonals: unknowns of deviation one, so that pivots are one at least beside rounding.
    """
    rows, a = gram.shape[0], gram.shape[1]
    out = np.zeros((rows, n, a))
    for row in range(rows):
        for j in range(n):
            own = out[row, j]
            for i in range(j, a):
                own[i] = gram[row, j, i]
            for k in range(j):
                above = out[row, k]
                size = above[j]
                for i in range(j, a):
                    own[i] -= size * above[i]
            pivot = np.sqrt(max(own[j] + 1.0, 1.0))
            own[j] = pivot
            for i in range(j + 1, a):
                own[i] /= pivot
    return out


@njit(cache=True, error_model="numpy")
def forward(factor, b):  # pragma: no cover - compiled
    """U'^-1 b of the upper factors (rows, n, a) and the first n of b (rows, a): (rows, n), and its squares' sum."""
    rows, n = factor.shape[0], factor.shape[1]
    out = np.empty((rows, n))
    out[:] = b[:, :n]
    squares = 0.0
    for row in range(rows):
        for j in range(n):
            out[row, j] /= factor[row, j, j]
            squares += out[row, j] ** 2
            for i in range(j + 1, n):
                out[row, i] -= factor[row, j, i] * out[row, j]
    return out, squares


@njit(cache=True, error_model="numpy")
def mode_derivatives(heavy, firm, shape, value):  # pragma: no cover - compiled
    """Derivatives of log frequency (n, m), and of shapes as a mix of shapes (n, m, m): d shape = shape @ mix, by those
    of M and K, (n, a, a) each, between shapes (a, m) with eigenvalues (m,).

    Fox and Kapoor (1968), equations 8 and 14. Between modes closer than rounding the mix is left out: it turns the
    pair within its own plane.
    """
    n, m, most = heavy.shape[0], value.size, value.max()
    d_log, mix = np.zeros((n, m)), np.zeros((n, m, m))
    across = np.ascontiguousarray(shape.T)
    for j in range(n):
        mass, stiff = across @ (heavy[j] @ shape), across @ (firm[j] @ shape)
        for r in range(m):
            if value[r] > 1e-10 * most:
                d_log[j, r] = (stiff[r, r] - value[r] * mass[r, r]) / (2 * value[r])
            for s in range(m):
                gap = value[r] - value[s]
                if abs(gap) > 1e-9 * max(abs(value[r]), 1e-3 * most):
                    mix[j, s, r] = (stiff[s, r] - value[r] * mass[s, r]) / gap
            mix[j, r, r] = -mass[r, r] / 2
    return d_log, mix
