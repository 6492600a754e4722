"""The same motion-capture log through Python's filterpy, as a peer of `cargo xtask bench estimate`.

Usage: filterpy_peer.py LOG.csv ROWS. Prints one JSON object: microseconds per step (one prediction of 1/120 s and one
update with four ranges and three angles) of its EKF and its UKF, and their position error against the truth.
"""

import csv
import json
import sys
import time

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter, JulierSigmaPoints, UnscentedKalmanFilter

MASS, INERTIA, GRAVITY, STEP = 1.545, np.array([0.029125, 0.029125, 0.055225]), 9.81, 1.0 / 120.0
CAMERAS = np.array([[10, 10, 10], [-10, 10, 10], [-10, -10, 10], [10, -10, 10]], float)
NOISE = np.diag(np.square([1.5e-3, 15e-3, 2e-3, 100e-3, 5e-3, 5e-3, 5e-3]))


def derivative(x, u):
    sf, cf, st, ct, ss, cs = (f(a) for a in x[6:9] for f in (np.sin, np.cos))
    p, q, r = x[9:12]
    a = u[0] / MASS
    turning = r * cf + q * sf
    ix, iy, iz = INERTIA
    return np.array([
        x[3], x[4], x[5],
        a * (sf * ss + cf * cs * st), a * (cf * st * ss - cs * sf), a * ct * cf - GRAVITY,
        p + turning * st / ct, q * cf - r * sf, turning / ct,
        (u[1] + (iy - iz) * q * r) / ix, (u[2] + (iz - ix) * p * r) / iy, (u[3] + (ix - iy) * p * q) / iz,
    ])


def step(x, dt, u):
    k1 = derivative(x, u)
    k2 = derivative(x + 0.5 * dt * k1, u)
    k3 = derivative(x + 0.5 * dt * k2, u)
    k4 = derivative(x + dt * k3, u)
    return x + dt / 6.0 * (k1 + 2 * k2 + 2 * k3 + k4)


def jacobian(x, u):
    """By central differences, 1e-6: what one writes in Python without a symbolic model."""
    a = np.empty((12, 12))
    for j in range(12):
        e = np.zeros(12)
        e[j] = 1e-6
        a[:, j] = (derivative(x + e, u) - derivative(x - e, u)) / 2e-6
    return a


def measure(x):
    return np.concatenate([np.linalg.norm(x[:3] - CAMERAS, axis=1), x[6:9]])


def measure_jacobian(x):
    d = x[:3] - CAMERAS
    h = np.zeros((7, 12))
    h[:4, :3] = d / np.linalg.norm(d, axis=1)[:, None]
    h[4:, 6:9] = np.eye(3)
    return h


def process_noise():
    q = np.zeros((12, 12))
    for first, second, density in ((0, 3, 0.02), (6, 9, 0.1)):
        v = density**2 / STEP
        for i in range(3):
            a, b = first + i, second + i
            q[a, a], q[b, b] = v * STEP**4 / 4, v * STEP**2
            q[a, b] = q[b, a] = v * STEP**3 / 2
    return q


def run(rows, predict, update, state):
    errors = []
    begun = time.perf_counter()
    for before, now in zip(rows, rows[1:]):
        predict(before[1:5])
        update(now[17:24])
        errors.append(state()[:3] - now[5:8])
    took = time.perf_counter() - begun
    return took / (len(rows) - 1) * 1e6, float(np.sqrt(np.mean(np.sum(np.square(errors), axis=1))))


def main():
    with open(sys.argv[1], newline="") as file:
        rows = np.array([[float(v) for v in row] for row in list(csv.reader(file))[1:int(sys.argv[2]) + 1]])
    ekf = ExtendedKalmanFilter(dim_x=12, dim_z=7)
    ekf.x, ekf.P, ekf.R, ekf.Q = np.zeros(12), np.eye(12) * 1e-6, NOISE, process_noise()

    def ekf_predict(u):
        x = ekf.x
        ah = jacobian(x, u) * STEP
        ekf.F = np.eye(12) + ah + ah @ ah / 2
        ekf.x = step(x, STEP, u)
        ekf.P = ekf.F @ ekf.P @ ekf.F.T + ekf.Q

    ukf = UnscentedKalmanFilter(
        dim_x=12, dim_z=7, dt=STEP, hx=measure, fx=step, points=JulierSigmaPoints(12, kappa=0.0))
    ukf.x, ukf.P, ukf.R, ukf.Q = np.zeros(12), np.eye(12) * 1e-6, NOISE, process_noise()
    ekf_us, ekf_m = run(rows, ekf_predict, lambda z: ekf.update(z, measure_jacobian, measure), lambda: ekf.x)
    ukf_us, ukf_m = run(rows, lambda u: ukf.predict(u=u), ukf.update, lambda: ukf.x)
    print(json.dumps({"ekf_us": ekf_us, "ekf_rmse_m": ekf_m, "ukf_us": ukf_us, "ukf_rmse_m": ukf_m}))


if __name__ == "__main__":
    main()
