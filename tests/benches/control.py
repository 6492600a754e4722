"""The same Riccati and H-infinity cases by scipy and slycot: cases as JSON on standard input, times as JSON lines.

A package that is missing gives a line with "skipped" instead of a figure.
"""

import json
import sys
import time


def median_us(run, times=101):
    samples = []
    for _ in range(times):
        start = time.perf_counter()
        run()
        samples.append(time.perf_counter() - start)
    return sorted(samples)[times // 2] * 1e6


def line(name, value=None, **more):
    print(json.dumps({"name": name, "value": value, **more}), flush=True)


def main():
    cases = json.load(sys.stdin)
    try:
        import numpy as np
        import scipy
        from scipy.linalg import solve_continuous_are, solve_discrete_are
    except ImportError as error:
        line("scipy", skipped=str(error))
        return
    riccati = [(case["name"], case["kind"], *(np.array(case[k]) for k in "ABQR")) for case in cases["riccati"]]
    for name, kind, a, b, q, r in riccati:
        solve = solve_continuous_are if kind == "care" else solve_discrete_are
        line(f"{name}_scipy", median_us(lambda: solve(a, b, q, r)), unit="us", version=scipy.__version__)
    try:
        import slycot
        from slycot import sb02md, sb10ad
    except ImportError as error:
        line("slycot", skipped=str(error))
        return
    for name, kind, a, b, q, r in riccati:
        if kind != "care":
            continue
        n = a.shape[0]

        def solve():
            g = b @ np.linalg.solve(r, b.T)
            return sb02md(n, a, g, q, "C")

        line(f"{name}_slycot", median_us(solve), unit="us", version=slycot.__version__)
    p = {k: np.array(v) for k, v in cases["hinf"].items() if k != "gamma"}
    a = p["A"]
    b = np.hstack([p["B1"], p["B2"]])
    c = np.vstack([p["C1"], p["C2"]])
    d = np.block([[p["D11"], p["D12"]], [p["D21"], np.zeros((p["D21"].shape[0], p["D12"].shape[1]))]])
    inputs, outputs = p["B2"].shape[1], p["C2"].shape[0]

    def synthesise():
        return sb10ad(a.shape[0], b.shape[1], c.shape[0], inputs, outputs, cases["hinf"]["gamma"], a, b, c, d, gtol=1e-6)

    try:
        found = synthesise()
        line("hinf_synthesis_slycot", median_us(synthesise, 5) / 1e3, unit="ms", gamma=float(found[0]))
    except Exception as error:  # slycot's own error types differ between versions
        line("hinf_synthesis_slycot", skipped=str(error).strip().splitlines()[0])


main()
