"""The error of measured depth that a sensor's description states; `benchmarks/pose_covariance.py` measured it."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.geometry import rigid
from pipeline.physics import optics
from pipeline.sensors.spec import sensor
from pipeline.simulation import shapes
from pipeline.simulation.poses import paper_grid
from pipeline.simulation.press import press
from pipeline.stages.depth.stage import DepthParams, depth
from pipeline.stages.pose.stage import PoseParams, pose_from
from pipeline.values.frames import TactileFrame

PRESSES = 6
WITHIN, LENGTHS_WITHIN = 1.5, 2.5  # one object's six presses, beside all that it was measured on


def measured(name):
    """The rms (mm) in contact and the length at which the error's correlation is exp(-1/2), as sensors describe them.

    That is half-way between the median and the mean over presses.
    """
    spec, mesh, found = sensor(name), shapes.shape("notched_elbow").mesh, []
    for k, pose in enumerate(paper_grid(mesh, n=PRESSES, seed=3)):
        made = press(mesh, pose, spec, seed=k)
        frame = TactileFrame(sensor=name, image=made.image, reference=optics.untouched(spec))
        told = depth(frame, spec, None, DepthParams())
        both = told.contact & made.truth.contact
        error = np.where(both, made.truth.indentation_mm - told.indentation_mm, 0.0).astype(float)
        counted, products = (_itself(a)[0, :200] for a in (both.astype(float), error))
        along = products / np.maximum(counted, 50.0)
        length = np.flatnonzero(np.append(along, -np.inf) < along[0] * np.exp(-0.5))[0] * spec.pixel_mm
        found.append((np.sqrt(along[0]), length, told.error))
    each = [f[:2] for f in found]
    return 0.5 * (np.median(each, axis=0) + np.mean(each, axis=0)), found[0][2]


def _itself(image):
    return np.fft.irfft2(np.abs(np.fft.rfft2(image, [2 * n for n in image.shape])) ** 2)


@pytest.mark.parametrize("name", ["digit", "gelslim_dotless"])
def test_measured_depth_carries_the_error_that_presses_show(name):
    (rms_mm, correlation_mm), told = measured(name)
    assert told.rms_mm == sensor(name).limits.depth_rms_mm
    assert 1 / WITHIN < told.rms_mm / rms_mm < WITHIN
    assert 1 / LENGTHS_WITHIN < told.correlation_mm / correlation_mm < LENGTHS_WITHIN


@pytest.mark.parametrize("name", ["digit", "gelslim_dotless"])
def test_the_poses_covariance_is_as_wide_as_poses_from_measured_depth_err(name):
    spec, mesh, found = sensor(name), shapes.shape("notched_elbow").mesh, []
    for k, placed in enumerate(paper_grid(mesh, n=PRESSES, seed=7)):
        made = press(mesh, placed, spec, seed=k)
        frame = TactileFrame(sensor=name, image=made.image, reference=optics.untouched(spec))
        truth = made.truth.sensor_from_object
        told = pose_from(depth(frame, spec, None, DepthParams()), mesh, PoseParams(), truth)
        off, middle = told.sensor_from_object @ rigid.invert(truth), told.scene_mm.mean(axis=0).astype(float)
        error = np.concatenate([rigid.rotation_vector_rad(off), rigid.apply(off, middle) - middle])
        error, known = told.observable @ error, told.observable @ told.covariance @ told.observable.T
        rank = round(float(np.trace(told.observable)))
        if rank:  # a grasp that leaves every direction open has no error to compare
            found.append(error @ np.linalg.pinv(known, rcond=1e-10) @ error / rank)
    assert len(found) >= PRESSES - 1
    assert 0.1 < np.median(found) < 2.5, "chi-square over its degrees of freedom; 30 and 100 without the sensor's error"
