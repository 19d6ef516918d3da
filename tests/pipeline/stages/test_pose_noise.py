"""Poses from depth with modelled noise are as far off as their covariance says."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from pipeline.core.geometry import rigid
from pipeline.core.geometry.camera import Camera
from pipeline.core.values.results import DepthErrorModel, DepthMap, make_pixel_index
from pipeline.physics import lattice
from pipeline.physics.simulation import shapes
from pipeline.stages.pose.signed_distances import PoseParams, track_pose

CAMERA = Camera(rows=120, cols=160, fx_px=120.0, fy_px=120.0, cx_px=79.5, cy_px=59.5)
REST_MM = 20.0
DEEP_MM = 1.0
PIXEL_MM = 20.0 / 120.0
PARAMS = PoseParams(keep_steps=False)
N_TOUCHES = 24


def touch(name, seed, white_mm, error):
    """A touch of a shape, its depth off by white noise and by a correlated error.

    And where the shape truly is.
    """
    rng = np.random.default_rng([seed, 5])
    mesh = shapes.make_shape(name).mesh
    turn = rigid.rotation(np.deg2rad([*rng.uniform(-5.0, 5.0, 2), 0.0])) @ rigid.rotation(
        [0, 0, rng.uniform(0, 6.3)]
    )
    lowest_mm = rigid.apply(turn, mesh.vertices_mm)[:, 2].min()
    truth = rigid.translation(*rng.uniform(-2.0, 2.0, 2), REST_MM - DEEP_MM - lowest_mm) @ turn
    on = lattice.Lattice(x0_mm=-16.0, y0_mm=-12.0, step_mm=0.04, shape=(601, 801))
    surface = np.minimum(
        lattice.rasterise_mesh(rigid.apply(truth, mesh.vertices_mm), mesh.triangles, on), REST_MM
    )
    depth = lattice.intersect_rays(CAMERA, surface, on, guess_mm=np.full(CAMERA.shape, REST_MM))
    contact = depth < REST_MM - 1e-6
    depth = depth + white_mm * rng.standard_normal(depth.shape)
    if error is not None:
        waves = gaussian_filter(
            rng.standard_normal(depth.shape), error.correlation_mm / PIXEL_MM / np.sqrt(2.0)
        )
        depth = depth + error.rms_mm * waves / waves.std()
    depth = depth.astype(np.float32)
    depth_map = DepthMap(
        indentation_mm=np.float32(REST_MM) - depth,
        depth_mm=depth,
        contact=contact,
        camera=CAMERA,
        source_index=make_pixel_index(CAMERA.shape),
        error=error,
    )
    return depth_map, mesh, truth


def off_by(pose, truth, middle):
    """(6,) rotation in rad and shift of the contact's middle in mm."""
    off = pose @ rigid.invert(truth)
    return np.concatenate([rigid.rotation_vector_rad(off), rigid.apply(off, middle) - middle])


@pytest.mark.parametrize(
    ("name", "error", "least"),
    [
        ("notched_elbow", None, 1 / 2),
        ("letters", None, 1 / 2),
        ("notched_elbow", DepthErrorModel(rms_mm=0.03, correlation_mm=0.5), 1 / 3),
        ("letters", DepthErrorModel(rms_mm=0.03, correlation_mm=0.5), 1 / 3),
    ],
)
def test_the_covariance_is_that_of_poses_from_depth_with_modelled_noise(name, error, least):
    found = []
    for seed in range(N_TOUCHES):
        depth_map, mesh, truth = touch(name, seed, 0.02 if error is None else 0.005, error)
        pose = track_pose(depth_map, mesh, PARAMS, truth)
        off = off_by(pose.sensor_from_object, truth, pose.scene_mm.mean(axis=0).astype(float))
        off = pose.observable @ off
        known = pose.observable @ pose.covariance @ pose.observable.T
        found.append(
            off @ np.linalg.pinv(known, rcond=1e-10) @ off / round(float(np.trace(pose.observable)))
        )
    # Chi-square over its degrees of freedom: 24 times some six tell its mean to 12 %.
    assert least < np.mean(found) < 2.0
