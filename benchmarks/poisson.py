"""How exact and how fast is the integration of slopes? Ours against a public integrator's algorithm
and a sparse solve.

    python -m benchmarks.poisson

The public integrator (GelSight's own, in its Python package) is written again here in its own
steps: frequencies counted from 1, double precision, one axis at a time, the sines of every pixel on
every call. That it leaves out the half of the central difference, which doubles the surface, is not
held against it, nor is its border. "Tidied" is the same algorithm with two-dimensional transforms
and the sines of rows and columns only. The bar of speed is for the size that is drawn. Errors are
in pixels after removing the mean.
"""

from __future__ import annotations

import numpy as np
from scipy import fft, fftpack, sparse
from scipy.sparse import linalg

from benchmarks.harness.results import BenchmarkResult, PlotPoint
from benchmarks.harness.text_report import print_result
from benchmarks.harness.timing import Requirement, build_measurement, time_in_turns
from pipeline.stages.depth.poisson import integrate_slopes

_SHAPES = ((140, 175), (240, 320), (320, 427), (480, 640))
_DRAWN = (320, 427)
_TILT = 0.05
_BAR = Requirement(min_speedup=3.5, max_ms=3, min_error_ratio=1000, max_error=1e-3)


def bump(rows: int, cols: int):
    y, x = np.mgrid[:rows, :cols].astype(np.float64)
    x = x - 0.51 * cols
    y = y - 0.48 * rows
    s = 12.0
    z = 20.0 * np.exp(-(x * x + y * y) / (2 * s * s))
    return (
        z + _TILT * x,
        (-x / s**2 * z + _TILT).astype(np.float32),
        (-y / s**2 * z).astype(np.float32),
    )


def divergence(gx, gy):
    rows, cols = gx.shape
    div = np.zeros((rows, cols))
    div[1:-1, 1:-1] = (gx[1:-1, 2:] - gx[1:-1, :-2]) + (gy[2:, 1:-1] - gy[:-2, 1:-1])
    return 0.5 * div


def public(gx, gy):
    rows, cols = gx.shape
    wave = fftpack.dct(fftpack.dct(divergence(gx, gy), norm="ortho").T, norm="ortho").T
    kx, ky = np.meshgrid(np.arange(1, cols + 1), np.arange(1, rows + 1))
    wave = wave / (
        -4.0 * (np.sin(0.5 * np.pi * kx / cols) ** 2 + np.sin(0.5 * np.pi * ky / rows) ** 2)
    )
    z = fftpack.idct(fftpack.idct(wave, norm="ortho").T, norm="ortho").T
    return z - z.mean()


def integrate_consistent(gx, gy):
    rows, cols = gx.shape
    wave = fft.dctn(divergence(gx, gy), norm="ortho")
    ky = np.arange(1, rows + 1)
    kx = np.arange(1, cols + 1)
    wave /= -(
        4 * np.sin(0.5 * np.pi * kx / cols)[None, :] ** 2
        + 4 * np.sin(0.5 * np.pi * ky / rows)[:, None] ** 2
    )
    return fft.idctn(wave, norm="ortho")


def sparse_solve(gx, gy):
    rows, cols = gx.shape
    dx = sparse.kron(
        sparse.eye(rows),
        sparse.diags([-np.ones(cols - 1), np.ones(cols - 1)], [0, 1], (cols - 1, cols)),
    )
    dy = sparse.kron(
        sparse.diags([-np.ones(rows - 1), np.ones(rows - 1)], [0, 1], (rows - 1, rows)),
        sparse.eye(cols),
    )
    d = sparse.vstack([dx, dy]).tocsc()
    g = np.concatenate([((gx[:, 1:] + gx[:, :-1]) / 2).ravel(), ((gy[1:] + gy[:-1]) / 2).ravel()])
    pinned = (d.T @ d + sparse.csc_matrix(([1.0], ([0], [0])), (rows * cols, rows * cols))).tocsc()
    return linalg.spsolve(pinned, d.T @ g).reshape(rows, cols)


def methods_for(gx, gy):
    return {
        "ours, free border (cosine)": lambda: integrate_slopes(gx, gy, 1.0),
        "ours, flat border (sine)": lambda: integrate_slopes(
            gx - np.float32(_TILT), gy, 1.0, "flat"
        ),
        "public integrator": lambda: public(gx, gy),
        "public integrator, tidied": lambda: integrate_consistent(gx, gy),
    }


def rmse_px(z, truth) -> float:
    off = z - truth
    return float(np.sqrt(np.mean((off - off.mean()) ** 2)))


def measure() -> BenchmarkResult:
    rows = []
    points = []
    for shape in _SHAPES:
        z, gx, gy = bump(*shape)
        level = z - _TILT * (np.arange(shape[1]) - 0.51 * shape[1])[None, :]
        methods = methods_for(gx, gy)
        errors = {
            name: rmse_px(run(), level if "flat" in name else z) for name, run in methods.items()
        }
        times = time_in_turns(methods, runs=15, calls=5)
        free, _, peer, _ = methods
        rows.append(
            build_measurement(
                f"integrate slopes, {shape[0]} x {shape[1]}",
                peer=peer,
                ours=times[free],
                peer_timing=times[peer],
                ours_error=errors[free],
                peer_error=errors[peer],
                unit="px",
                bar=_BAR if shape == _DRAWN else Requirement(min_error_ratio=1000),
            )
        )
        if shape == _DRAWN:
            solve = {"sparse least squares": lambda gx=gx, gy=gy: sparse_solve(gx, gy)}
            errors["sparse least squares"] = rmse_px(sparse_solve(gx, gy), z)
            times |= time_in_turns(solve, runs=1)
            points = [
                PlotPoint(
                    method=name, ms=t.median_ms, error=errors[name], ours=name.startswith("ours")
                )
                for name, t in times.items()
            ]
    return BenchmarkResult(
        title=f"Slopes to a surface, {_DRAWN[0]} x {_DRAWN[1]} pixels",
        unit="px",
        rows=tuple(rows),
        points=tuple(points),
        notes=("errors are rms after removing the mean, of a bump 20 px high on a tilt",),
    )


if __name__ == "__main__":
    print_result(measure())
