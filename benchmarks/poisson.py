"""How exact and how fast is the integration of slopes? Ours beside a public integrator's algorithm and a sparse solve.

    python benchmarks/poisson.py

The public algorithm is written down here with its slip of frequencies counted from 1 and its border left out of the
divergence; that some leave out the half of the central difference as well is not held against it. Times are medians of
25 runs in turn; errors are in pixels after removing the mean.
"""

from __future__ import annotations

import platform
import sys
import time
from pathlib import Path

import numpy as np
from scipy import fft, sparse
from scipy.sparse import linalg

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from pipeline.poisson import integrate

_RUNS = 25


def bump(rows: int, cols: int):
    y, x = np.mgrid[:rows, :cols].astype(np.float64)
    x, y, s = x - 0.51 * cols, y - 0.48 * rows, 12.0
    z = 20.0 * np.exp(-(x * x + y * y) / (2 * s * s))
    tilt = 0.05
    return z + tilt * x, (-x / s**2 * z + tilt).astype(np.float32), (-y / s**2 * z).astype(np.float32)


def public(gx, gy):
    rows, cols = gx.shape
    div = np.zeros((rows, cols))
    div[1:-1, 1:-1] = (gx[1:-1, 2:] - gx[1:-1, :-2]) + (gy[2:, 1:-1] - gy[:-2, 1:-1])
    div *= 0.5  # the slip is kept mild: some integrators leave this out and double the surface
    wave = fft.dctn(div, norm="ortho")
    ky, kx = np.arange(1, rows + 1), np.arange(1, cols + 1)
    wave /= -(4 * np.sin(0.5 * np.pi * kx / cols)[None, :] ** 2 + 4 * np.sin(0.5 * np.pi * ky / rows)[:, None] ** 2)
    return fft.idctn(wave, norm="ortho")


def sparse_solve(gx, gy):
    rows, cols = gx.shape
    dx = sparse.kron(sparse.eye(rows), sparse.diags([-np.ones(cols - 1), np.ones(cols - 1)], [0, 1], (cols - 1, cols)))
    dy = sparse.kron(sparse.diags([-np.ones(rows - 1), np.ones(rows - 1)], [0, 1], (rows - 1, rows)), sparse.eye(cols))
    d = sparse.vstack([dx, dy]).tocsc()
    g = np.concatenate([((gx[:, 1:] + gx[:, :-1]) / 2).ravel(), ((gy[1:] + gy[:-1]) / 2).ravel()])
    pinned = (d.T @ d + sparse.csc_matrix(([1.0], ([0], [0])), (rows * cols, rows * cols))).tocsc()
    return linalg.spsolve(pinned, d.T @ g).reshape(rows, cols)


def main() -> None:
    print(f"{platform.processor() or platform.machine()}, numpy {np.__version__}, median of {_RUNS} runs")
    print(f"{'size':>9}  {'method':<26}{'rmse px':>10}{'ms':>10}{'p95 ms':>10}")
    for rows, cols in ((140, 175), (240, 320), (320, 427), (480, 640)):
        z, gx, gy = bump(rows, cols)
        methods = {
            "ours (cosine, free border)": (lambda gx=gx, gy=gy: integrate(gx, gy, 1.0), _RUNS),
            "ours (sine, flat border)": (lambda gx=gx - 0.05, gy=gy: integrate(gx, gy, 1.0, "flat"), _RUNS),
            "public algorithm": (lambda gx=gx, gy=gy: public(gx, gy), _RUNS),
        }
        if rows * cols < 150_000:
            methods["sparse least squares"] = (lambda gx=gx, gy=gy: sparse_solve(gx, gy), 1)
        times: dict[str, list[float]] = {name: [] for name in methods}
        for turn in range(_RUNS + 1):
            for name, (run, runs) in methods.items():
                if turn <= runs:
                    started = time.perf_counter()
                    run()
                    times[name].append(1e3 * (time.perf_counter() - started))
        for name, (run, _) in methods.items():
            truth = z - 0.05 * (np.arange(cols) - 0.51 * cols)[None, :] if "flat" in name else z
            off = run() - truth
            rmse = np.sqrt(np.mean((off - off.mean()) ** 2))
            middle, slow = np.percentile(times[name][1:], (50, 95))
            print(f"{rows:>4}x{cols:<4}  {name:<26}{rmse:>10.5f}{middle:>10.2f}{slow:>10.2f}")


if __name__ == "__main__":
    main()
