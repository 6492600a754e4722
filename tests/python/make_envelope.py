"""Ten drawn attack envelopes of the prototype's altitude loop, by cvxpy: `tests/fixtures/reference/envelope_cvxpy.json`.

Neither the model nor the solver is ours: the loop is written down anew from its description (truth z v a, slots of 50 ms, a
Kalman filter 0.1 s back, lasers at 10 Hz, LQR with integral, thrust behind a lag of 60 ms), Riccati equations are SciPy's,
the linear program is CLARABEL's through cvxpy.

    pip install cvxpy scipy && python tests/python/make_envelope.py > tests/fixtures/reference/envelope_cvxpy.json
"""

import json
import random
import sys

import cvxpy
import numpy
from scipy.linalg import solve_continuous_are, solve_discrete_are

SLOT_S, LATE, LAG_S, IMUS, MOST = 0.05, 2, 0.06, 4, 50.0
F = numpy.array([[1, SLOT_S, -(SLOT_S**2) / 2], [0, 1, -SLOT_S], [0, 0, 1]])
G = numpy.array([SLOT_S**2 / 2, SLOT_S, 0])


def kalman(lasers):
    """Gain and one-sigma of the predicted altitude, two slots from one correction to the next."""
    q = numpy.diag([1e-8, 0.12**2 * SLOT_S, 0.02**2 * SLOT_S])
    h = numpy.tile([1.0, 0, 0], (lasers, 1))
    noise = 0.025**2 * numpy.eye(lasers)
    p = solve_discrete_are((F @ F).T, h.T, F @ q @ F.T + q, noise)
    return p @ h.T @ numpy.linalg.inv(h @ p @ h.T + noise), p[0, 0] ** 0.5


def regulator():
    a = numpy.array([[0, 1, 0], [0, 0, 0], [1, 0, 0.0]])
    b = numpy.array([[0], [1], [0.0]])
    return (b.T @ solve_continuous_are(a, b, numpy.diag([9.0, 1, 1]), numpy.array([[0.1]])) / 0.1)[0]


def follow(lasers, attacked, imus, slots):
    """Altitude at the end, and the series that detectors look at, each value a row over the columns of the attack."""
    per_laser = slots // 2
    columns = attacked * per_laser + imus * slots
    gain, sigma = kalman(lasers)
    law = regulator()
    unit = numpy.eye(columns)
    z, v, a, integral = (numpy.zeros(columns) for _ in range(4))
    x = numpy.zeros((3, columns))
    forces, altitudes, innovations, residuals, shares, thrust = [], [], [], [], [], []
    for k in range(slots):
        own = numpy.array([unit[attacked * per_laser + i * slots + k] for i in range(imus)]).reshape(imus, columns)
        forces.append(a + own.sum(0) / IMUS)
        altitudes.append(z.copy())
        if k >= LATE:
            h = k - LATE
            x = F @ x + numpy.outer(G, forces[h])
            if h % 2 == 0:
                y = numpy.tile(altitudes[h + 1], (lasers, 1))
                for laser in range(attacked):
                    y[laser] += unit[laser * per_laser + h // 2]
                innovations.append(y - x[0])
                x = x + gain @ (y - x[0])
                residuals.append(y - x[0])
        now = x
        for force in forces[max(0, k - LATE + 1) :]:
            now = F @ now + numpy.outer(G, force)
        integral = integral + SLOT_S * now[0]
        asked = -(law[0] * now[0] + law[1] * now[1] + law[2] * integral)
        shares.append(own)
        thrust.append((forces[-1] - x[2] - a)[None, :])
        end = z
        z, v, a = z + v * SLOT_S + a * SLOT_S**2 / 2, v + a * SLOT_S, a + SLOT_S / LAG_S * (asked - a)
    return end, sigma, [numpy.array(series) for series in (innovations, residuals, shares, thrust)]


def means(series, n):
    """Of every n in a row."""
    if len(series) <= n:
        return series[:0].reshape(0, series.shape[-1])
    sums = numpy.concatenate([numpy.zeros((1,) + series.shape[1:]), numpy.cumsum(series, 0)])
    return ((sums[n:] - sums[:-n]) / n).reshape(-1, series.shape[-1])


def largest_m(lasers, attacked, imus, horizon_s, gate_only):
    slots = round(horizon_s / SLOT_S)
    end, sigma, (innovations, residuals, shares, thrust) = follow(lasers, attacked, imus, slots)
    sample = numpy.hypot(0.017, 0.02)
    limits = [(innovations.reshape(-1, len(end)), 3.3 * numpy.hypot(sample, sigma))]
    if not gate_only:
        limits.append((means(residuals, 24), 3.3 * numpy.hypot(0.017 / 24**0.5, 0.012)))
        others = (residuals.sum(1, keepdims=True) - residuals) / (lasers - 1)
        limits += [(means(residuals - others, n), 3.5 * s) for n, s in ((5, 0.015), (24, 0.010))]
        part = 1 - imus / IMUS
        drift = numpy.hypot(0.13, 0.035), numpy.hypot(0.13 / 3**0.5, 0.035)
        if imus and part > 0:
            limits += [(part * means(shares, n), 3.3 * s) for n, s in ((4, 0.9), (16, drift[0]), (48, drift[1]))]
        if imus:
            limits += [(means(thrust, n), 3.3 * s) for n, s in ((16, numpy.hypot(0.3, 0.13)), (48, 0.15))]
    attack = cvxpy.Variable(len(end))
    constraints = [cvxpy.abs(attack) <= MOST]
    constraints += [cvxpy.abs(rows @ attack) <= limit for rows, limit in limits if len(rows)]
    problem = cvxpy.Problem(cvxpy.Maximize(end @ attack), constraints)
    problem.solve(solver=cvxpy.CLARABEL)
    assert problem.status == "optimal", problem.status
    return float(problem.value)


def main():
    dice = random.Random(21)
    cases = []
    while len(cases) < 10:
        lasers, imus = dice.choice([3, 4, 5]), dice.choice([0, 0, 1, 2])
        attacked = dice.randrange(0 if imus else 1, lasers)
        case = {
            "lasers": lasers,
            "attacked": attacked,
            "imus": imus,
            "horizon_s": dice.choice([3.0, 4.0, 5.0, 6.0]),
            "gate_only": dice.random() < 0.2,
        }
        case["altitude_m"] = largest_m(**case)
        print(case, file=sys.stderr)
        cases.append(case)
    versions = {"cvxpy": cvxpy.__version__, "numpy": numpy.__version__}
    json.dump({"made_by": "tests/python/make_envelope.py", "versions": versions, "cases": cases}, sys.stdout, indent=1)
    print()


if __name__ == "__main__":
    main()
