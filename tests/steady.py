"""Steady states by time integration alone: scipy's solve_ivp from one change of friction or of a slider to the next.

It shares nothing with the package: forces are written out here, and what sticks is a constraint, solved for.
"""

from dataclasses import dataclass, field

import numpy as np
from scipy.integrate import solve_ivp

SETTING = {"method": "DOP853", "rtol": 1e-9, "atol": 1e-11}
FREE = {
    "cubic": lambda p, z, v: p[0] * z**3,
    "quadratic": lambda p, z, v: p[0] * z**2,
    "one-sided-gap": lambda p, z, v: p[0] * max(z - p[1], 0.0),
    "clearance": lambda p, z, v: p[0] * (max(z - p[1], 0.0) + min(z + p[1], 0.0)),
    "quadratic-damping": lambda p, z, v: p[0] * v * abs(v),
}


@dataclass
class Truth:
    """M u'' + C u' + K u + sum column force = load cos(omega t); `laws` holds (name, column, parameters)."""

    M: np.ndarray
    C: np.ndarray
    K: np.ndarray
    load: np.ndarray
    laws: list
    omega: float
    mode: list = field(default_factory=list)

    def __post_init__(self):
        self.n = len(self.M)
        self.inverse = np.linalg.inv(self.M)
        self.inner = [i for i, law in enumerate(self.laws) if law[0] in ("jenkins", "bouc-wen")]
        self.switched = [i for i, law in enumerate(self.laws) if law[0] in ("jenkins", "coulomb")]
        self.mode = [0] * len(self.laws)  # 0 sticks, 1 and -1 slide

    def at_rest(self):
        return np.zeros(2 * self.n + len(self.inner))

    def _free(self, t, y):
        """Accelerations without what is held, and each law's motion and speed."""
        u, v = y[: self.n], y[self.n : 2 * self.n]
        f = self.load * np.cos(self.omega * t) - self.C @ v - self.K @ u
        for i, (name, column, p) in enumerate(self.laws):
            z, s = column @ u, column @ v
            if name in FREE:
                f = f - column * FREE[name](p, z, s)
            elif name == "coulomb":
                f = f - column * p[0] * self.mode[i]
            elif name == "jenkins":
                f = f - column * (y[2 * self.n + self.inner.index(i)] if self.mode[i] == 0 else p[1] * self.mode[i])
            else:
                f = f - column * p[0] * y[2 * self.n + self.inner.index(i)]
        return self.inverse @ f

    def _holding(self, t, y):
        """Forces that hold the motions that stick, and the accelerations with them."""
        a = self._free(t, y)
        held = [i for i, law in enumerate(self.laws) if law[0] == "coulomb" and self.mode[i] == 0]
        if not held:
            return {}, a
        columns = np.array([self.laws[i][1] for i in held])
        force = np.linalg.solve(columns @ self.inverse @ columns.T, columns @ a)
        return dict(zip(held, force, strict=True)), a - self.inverse @ columns.T @ force

    def rate(self, t, y):
        _, a = self._holding(t, y)
        out = np.concatenate([y[self.n : 2 * self.n], a, np.zeros(len(self.inner))])
        for j, i in enumerate(self.inner):
            name, column, p = self.laws[i]
            s = column @ y[self.n : 2 * self.n]
            if name == "jenkins":
                out[2 * self.n + j] = p[0] * s if self.mode[i] == 0 else 0.0
            else:
                h = y[2 * self.n + j]
                out[2 * self.n + j] = s * (1 - (p[1] * np.sign(s * h) + p[2]) * abs(h) ** p[3])
        return out

    def _events(self):
        out = []
        for i in self.switched:
            name, column, p = self.laws[i]

            def event(t, y, i=i, name=name, column=column, p=p):
                if self.mode[i]:
                    return self.mode[i] * (column @ y[self.n : 2 * self.n])
                if name == "jenkins":
                    return p[1] - abs(y[2 * self.n + self.inner.index(i)])
                return p[0] * (1 + 1e-9) - abs(self._holding(t, y)[0][i])

            event.terminal, event.direction = True, -1
            out.append(event)
        return out

    def _switch(self, i, t, y):
        name, _, p = self.laws[i]
        if self.mode[i]:
            before = self.mode[i]
            self.mode[i] = 0
            if name == "jenkins":
                y[2 * self.n + self.inner.index(i)] = before * p[1]
            elif abs(self._holding(t, y)[0][i]) > p[0]:
                self.mode[i] = int(np.sign(self._holding(t, y)[0][i]))
        elif name == "jenkins":
            self.mode[i] = int(np.sign(y[2 * self.n + self.inner.index(i)]))
        else:
            self.mode[i] = int(np.sign(self._holding(t, y)[0][i]))
        return y

    def run(self, y, start, end, at=()):
        """The state at `end`, and the motions u (n, len(at)) at the times `at`."""
        t, seen, at = start, [], np.asarray(at, float)
        events = self._events()
        for _ in range(100000):
            now = at[(at >= t) & (at < end)]
            setting = SETTING | ({"max_step": 0.2 / self.omega} if events else {})  # a step may not pass two events
            done = solve_ivp(self.rate, (t, end), y, events=events or None, dense_output=at.size > 0, **setting)
            stop, y = done.t[-1], done.y[:, -1].copy()
            if at.size:
                seen.append(done.sol(now[now < stop])[: self.n] if (now < stop).any() else np.zeros((self.n, 0)))
            if done.status != 1:
                return y, np.hstack(seen) if seen else None
            still = 1e-12 + 1e-9 * np.abs(y[self.n : 2 * self.n]).max()
            for event, i in zip(done.t_events, self.switched, strict=True):
                name, column, _ = self.laws[i]  # sliders at one place turn together, and only one event is told
                turns = name == "jenkins" and self.mode[i] * (column @ y[self.n : 2 * self.n]) < still
                if event.size or (self.mode[i] and turns):
                    y = self._switch(i, stop, y)
            t = stop
        raise AssertionError("the integration does not come to its end")

    def started(self, y):
        """Modes of what sticks or slides from a state alone."""
        for i in self.switched:
            name, column, _ = self.laws[i]
            if name == "coulomb":
                self.mode[i] = int(np.sign(column @ y[self.n : 2 * self.n]))
        for i, force in self._holding(0.0, y)[0].items():
            if abs(force) > self.laws[i][2][0]:
                self.mode[i] = int(np.sign(force))
        return y

    def steady(self, periods, y=None, samples=256):
        """Complex amplitudes of u, (n, samples // 2), after so many periods; the state then."""
        y, period = self.at_rest() if y is None else np.asarray(y, float), 2 * np.pi / self.omega
        y, _ = self.run(self.started(y), 0.0, periods * period)
        at = np.arange(samples) * period / samples
        end, u = self.run(y, 0.0, period, at)
        spectrum = np.fft.rfft(u, axis=1) * 2 / samples
        spectrum[:, 0] /= 2
        return spectrum, end
