"""The core's methods in NumPy, to be read: oracles of the compiled ones. Forces are (k, d), F_n the last component."""

import numpy as np

PROVEN = 1e-9


def phi(F, powers):
    """phi, phi' and phi'' of pairs (coefficient, exponent) at F (k,)."""
    c, e = np.array(powers, dtype=float).reshape(-1, 2).T
    F = np.maximum(F, 1e-300)[:, None]
    return (c * F**e).sum(axis=1), (c * e * F ** (e - 1)).sum(axis=1), (c * e * (e - 1) * F ** (e - 2)).sum(axis=1)


# -- the dual Newton method --------------------------------------------------------------------------------------------


class Dual:
    """min 1/2 w x^2 + q x over friction, lo <= F_n <= hi and A x = b (m, k, d); ``give``: see ``closest``."""

    def __init__(self, A, b, w, q, lo, hi, friction, give=0.0):
        self.A, self.b, self.w, self.q, self.lo, self.hi, self.give = A, b, w, q, lo, hi, give
        self.n, self.radii = friction.round_dimensions, friction.radii

    def pulls(self, c):
        """How slopes c (k, d) pull at F_n, by group of components that saturate together, and the groups' weights."""
        round_part = [np.linalg.norm(c[:, : self.n], axis=1)] if self.n else []
        weights = [self.w[:, 0]] if self.n else []
        for j in range(self.n, len(self.radii)):
            round_part.append(self.radii[j] * np.abs(c[:, j]))
            weights.append(self.radii[j] ** 2 * self.w[:, j])
        return np.array(round_part), np.array(weights)

    def forces(self, c):
        """The minimisers at slopes c (k, d), contact by contact."""
        pull, weight = self.pulls(c)
        F = np.full(len(c), -np.inf)
        for chosen in np.ndindex(*(2,) * len(pull)):  # the largest root of lines, one for each set that is saturated
            which = np.array(chosen, dtype=bool)
            F = np.maximum(F, (pull[which].sum(axis=0) - c[:, -1]) / (self.w[:, -1] + weight[which].sum(axis=0)))
        F = np.clip(F, self.lo, self.hi)
        x = np.empty_like(c)
        x[:, -1] = F
        if self.n:
            size = np.maximum(np.maximum(pull[0], self.w[:, 0] * F), 1e-300)
            x[:, : self.n] = -c[:, : self.n] * (F / size)[:, None]
        for j in range(self.n, len(self.radii)):
            x[:, j] = np.clip(-c[:, j] / self.w[:, j], -self.radii[j] * F, self.radii[j] * F)
        return x

    def slopes(self, y):
        return self.q + np.einsum("mkd,m->kd", self.A, y)

    def hessian(self, c, x):
        """A generalised Hessian of the negative dual: sum of A_i dx_i/dc_i A_i'."""
        H, F = np.zeros((len(self.b),) * 2), x[:, -1]
        for i in range(len(c)):
            A, w, n = self.A[:, i], self.w[i], self.n
            ray, slope, D = A[:, -1].copy(), w[-1], np.zeros((len(w), len(w)))
            if n:
                size = np.linalg.norm(c[i, :n])
                if size > w[0] * F[i]:
                    u = c[i, :n] / size
                    D[:n, :n] = F[i] / size * (np.eye(n) - np.outer(u, u))
                    ray, slope = ray - A[:, :n] @ u, slope + w[0]
                else:
                    D[:n, :n] = np.eye(n) / w[0]
            for j in range(n, len(self.radii)):
                if abs(c[i, j]) > w[j] * self.radii[j] * F[i]:
                    edge = np.sign(c[i, j]) * self.radii[j]
                    ray, slope = ray - edge * A[:, j], slope + w[j] * edge**2
                else:
                    D[j, j] = 1 / w[j]
            H += A @ D @ A.T
            if self.lo[i] < F[i] < self.hi[i]:
                H += np.outer(ray, ray) / slope
        return H

    def least_along(self, y):
        """The least y . (A x - b) of all admissible x."""
        c = np.einsum("mkd,m->kd", self.A, y)
        s = c[:, -1] - self.pulls(c)[0].sum(axis=0)
        return np.minimum(self.lo * s, self.hi * s).sum() - self.b @ y

    def residual(self, x, y):
        return np.einsum("mkd,kd->m", self.A, x) - self.b - self.give * y

    def ascend(self, y, tolerance):
        """("converged" | "infeasible" | "stalled", x, y)."""
        for it in range(200):
            x = self.forces(self.slopes(y))
            r = self.residual(x, y)
            if np.abs(r).max() <= tolerance:
                return "converged", x, y
            H = self.hessian(self.slopes(y), x)
            lift = self.give + 1e-14 * np.trace(H) + 1e-12 + min(1e-2, 1e-3 * np.abs(r).max())
            step = np.linalg.solve(H + lift * np.eye(len(r)), r)
            for ray in (step, y) if it % 8 == 7 else (step,):
                if self.give == 0 and self.least_along(ray) > PROVEN * np.abs(ray).max():
                    return "infeasible", x, ray / np.abs(ray).max()

            def along(t, y=y, step=step):
                return self.residual(self.forces(self.slopes(y + t * step)), y + t * step) @ step

            low, high = 0.0, 1.0
            while along(high) > 0:
                low, high = high, 4 * high
                if high > 1e14:
                    return "stalled", x, y
            for _ in range(60):  # bisection
                middle = (low + high) / 2
                low, high = (middle, high) if along(middle) > 0 else (low, middle)
            y = y + high * step
        return "stalled", x, y


def dual_newton(A, b, P, q, powers, lo, hi, friction):
    """min 1/2 P x^2 + q x + phi(F_n): (code, x, y). Powers by their quadratic models, with a proximal weight."""
    x, y = np.zeros(P.shape), np.zeros(len(b))
    x[:, -1] = np.clip(2.0 / len(P), lo, hi)
    weight = 0.0 if P.min() >= 0.03 else 0.1
    for _ in range(60):
        w, own = P + weight, q - weight * x
        _, first, second = phi(x[:, -1], powers)
        w[:, -1] += second
        own[:, -1] += first - second * x[:, -1]
        last = x
        code, x, y = Dual(A, b, w, own, lo, hi, friction).ascend(y, 1e-11)
        if code != "converged" or np.abs(x - last).max() < 1e-11:
            return code, x, y
        weight = 0.0 if weight == 0.0 else max(0.1 * weight, 1e-3)
    return "converged", x, y


# -- the interior-point method -----------------------------------------------------------------------------------------


def interior_point(A, b, P, q, powers, lo, hi, friction, R, R_lo, R_hi):
    """The same with torque rows R (r, k d) and any friction model: (code, x, y (m,), w (r,)).

    A primal log barrier, damped Newton steps on the whole KKT system, balance as equations, for a sequence of weights:
    the multipliers are those of the equations, and differences of barrier terms.
    """
    k, d = q.shape
    n, m = k * d, len(b)
    flat, n_round, F = A.reshape(m, n), friction.round_dimensions, np.arange(d - 1, n, d)
    facets = np.hstack([-friction.facets, np.ones((len(friction.facets), 1))])
    G = [np.kron(np.eye(k), facets), np.eye(n)[F], -np.eye(n)[F], R, -R]
    h = [np.zeros(k * len(facets)), lo, -hi, R_lo, -R_hi]
    G, h = np.vstack(G), np.concatenate(h)

    def terms(x, mu):
        """Barrier function, gradient and Hessian; infinite outside."""
        s, f = G @ x - h, x.reshape(k, d)
        if s.min() <= 0:
            return np.inf, None, None
        value, first, second = phi(f[:, -1], powers)
        total = 0.5 * (P.ravel() * x) @ x + q.ravel() @ x + value.sum() - mu * np.log(s).sum()
        g = P.ravel() * x + q.ravel() - mu * G.T @ (1 / s)
        g[F] += first
        H = np.diag(P.ravel()) + mu * G.T @ (G / s[:, None] ** 2)
        H[F, F] += second
        for i in range(k if n_round else 0):
            at = np.r_[i * d : i * d + n_round, i * d + d - 1]
            J = np.diag(np.r_[-np.ones(n_round), 1.0])
            v = J @ x[at]
            gap = v @ x[at]
            if gap <= 0 or x[at[-1]] <= 0:
                return np.inf, None, None
            total -= mu * np.log(gap)
            g[at] -= 2 * mu * v / gap
            H[np.ix_(at, at)] += mu * (4 * np.outer(v, v) / gap**2 - 2 * J / gap)
        return total, g, H

    x = np.zeros(n)
    x[F] = np.minimum(np.maximum(0.6 / np.sqrt(k), lo + 0.1 * np.minimum(hi - lo, 1 / k)), hi - 0.1 * (hi - lo))
    y, mu = np.zeros(m), 0.1
    while mu > 1e-11:
        for _ in range(100):
            value, g, H = terms(x, mu)
            r = flat @ x - b
            # In the barriers' own scale: a singular H^-1 has no digits left at the end.
            half = np.linalg.inv(np.linalg.cholesky(H + 1e-11 * np.diag(np.diag(H))))
            T = half @ flat.T
            y = np.linalg.lstsq(T, -half @ g, rcond=None)[0] + np.linalg.lstsq(T.T @ T, r, rcond=None)[0]
            dx, t = -half.T @ (half @ (g + flat.T @ y)), 1.0
            while terms(x + t * dx, mu)[0] == np.inf or (
                np.abs(r).max() < 1e-9 and terms(x + t * dx, mu)[0] > value + 1e-9 * abs(value) + 1e-12
            ):
                t /= 2
                if t < 1e-12:
                    return "stalled", x.reshape(k, d), y, np.zeros(len(R))
            x = x + t * dx
            if np.abs(t * dx).max() < 1e-9 and np.abs(flat @ x - b).max() < 1e-10:
                break
        mu /= 4
    s = G @ x - h
    r = len(R)
    w = mu * 4 * (1 / s[len(s) - r :] - 1 / s[len(s) - 2 * r : len(s) - r]) if r else np.zeros(0)
    return "converged", x.reshape(k, d), y, w


# -- least squares in a box ---------------------------------------------------------------------------------------------


def box_least_squares(H, b, eps):
    """min 1/2 |H k + b|^2 + eps/2 |k|^2 over |k| <= 1, by coordinate descent."""
    k, r, square = np.zeros(H.shape[1]), np.array(b, dtype=float), (H * H).sum(axis=0) + eps
    for _ in range(3000):
        before = k.copy()
        for j in range(len(k)):
            new = np.clip(k[j] - (H[:, j] @ r + eps * k[j]) / square[j], -1.0, 1.0)
            r += H[:, j] * (new - k[j])
            k[j] = new
        if np.abs(k - before).max() < 1e-14:
            break
    return k
