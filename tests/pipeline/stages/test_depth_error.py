"""The error of measured depth that is stated for a touch.

`benchmarks/pose_covariance.py` holds poses against it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pipeline.calibration.calibration_table import USUAL_STD, ExpectedError, make_built_in
from pipeline.core.geometry import rigid
from pipeline.core.values.frames import TactileFrame
from pipeline.core.values.results import DepthMap, make_pixel_index
from pipeline.physics import optics
from pipeline.physics.simulation import shapes
from pipeline.physics.simulation.poses import make_paper_grid
from pipeline.physics.simulation.press import simulate_press
from pipeline.physics.simulation.variation import vary_sensor
from pipeline.sensors.spec import load_sensor
from pipeline.stages.depth.gel.result import predict_gel_error
from pipeline.stages.depth.illumination.light import Illumination
from pipeline.stages.depth.photometric import DepthParams, estimate_depth
from pipeline.stages.pose.signed_distances import PoseParams, track_pose

PRESSES = 6
# one object's six presses; errors of single touches scatter by as much
WITHIN = 2.5
LENGTHS_WITHIN = 2.5


def measured(name, other=None):
    """For each press: rms (mm) in contact, the length at which the error's correlation is
    exp(-1/2), and what is stated.

    `other` is the seed of the first of other units, each press on one of its own.
    """
    spec = load_sensor(name)
    mesh = shapes.make_shape("notched_elbow").mesh
    found = []
    for k, pose in enumerate(make_paper_grid(mesh, n=PRESSES, seed=3)):
        unit = spec if other is None else vary_sensor(spec, other + k)
        made = simulate_press(mesh, pose, unit, seed=k)
        frame = TactileFrame(sensor=name, image=made.image, reference=optics.render_reference(unit))
        depth = estimate_depth(frame, spec, None, DepthParams())
        both = depth.contact & made.truth.contact
        error = np.where(both, made.truth.indentation_mm - depth.indentation_mm, 0.0).astype(float)
        counted, products = (_itself(a)[0, :200] for a in (both.astype(float), error))
        along = products / np.maximum(counted, 50.0)
        length = (
            np.flatnonzero(np.append(along, -np.inf) < along[0] * np.exp(-0.5))[0] * spec.pixel_mm
        )
        found.append((np.sqrt(along[0]), length, depth.error.rms_mm, depth.error.correlation_mm))
    return np.array(found).T


def _itself(image):
    return np.fft.irfft2(np.abs(np.fft.rfft2(image, [2 * n for n in image.shape])) ** 2)


@pytest.mark.parametrize(
    ("name", "other"), [("digit", None), ("digit", 40), ("gelslim_dotless", None)]
)
def test_measured_depth_carries_the_error_that_presses_show(name, other):
    rms_mm, length_mm, told_mm, told_length_mm = measured(name, other)
    assert 1 / WITHIN < np.median(told_mm / rms_mm) < WITHIN
    assert 1 / LENGTHS_WITHIN < np.median(told_length_mm) / np.mean(length_mm) < LENGTHS_WITHIN


def told_of(illumination, *, steep=1.0, level_mm=0.0, expected=None):
    spec = load_sensor("digit")
    table = replace(make_built_in(spec), expected_error=expected)
    shape = spec.camera.shape
    ramp = (steep * spec.pixel_mm * np.arange(shape[1], dtype=np.float32)[None, :]) * np.ones(
        shape, np.float32
    )
    rest = np.zeros(shape, np.float32)
    ramp += level_mm - ramp.mean()
    found = DepthMap(
        indentation_mm=ramp,
        depth_mm=rest,
        contact=rest == 0,
        camera=spec.camera,
        source_index=make_pixel_index(shape),
    )
    return predict_gel_error(found, spec, table, illumination).rms_mm


def test_a_touch_errs_as_its_light_and_its_slopes_have_it():
    spec = load_sensor("digit")
    usual, other = (Illumination(model="leds", parameters=(k,) * 20) for k in (0.0, 0.1))
    described, other_std_mm, refused = (
        told_of(light) for light in (usual, other, Illumination(model="trusted"))
    )
    assert described == pytest.approx(spec.limits.depth_rms_mm, rel=1e-3)
    assert other_std_mm == pytest.approx(spec.limits.depth_rms_other_instance_mm, rel=1e-3)
    assert 2 * described < other_std_mm < 0.5 * refused
    assert told_of(other, steep=0.5) == pytest.approx(0.5 * other_std_mm, rel=1e-3)
    assert told_of(other, steep=0.001) > 0.1 * other_std_mm  # no touch is without an error


@pytest.mark.parametrize("model", ["described", "field", "near", None])
def test_depth_as_a_whole_errs_by_what_the_calibration_expects_unless_usual_leds_explain_the_image(
    model,
):
    light = None if model is None else Illumination(model=model)
    flat = {"steep": 1e-3}
    for level_mm in (1.0, 2.0):
        shape_mm = told_of(light, **flat)
        for std, expected in (
            (USUAL_STD, None),
            (
                0.05,
                ExpectedError(
                    diameter_share=0.1,
                    diameter_p90=0.2,
                    depth_share=0.03,
                    depth_p90=0.05 * 1.645,
                    n_held_out=4,
                ),
            ),
        ):
            stated_mm = told_of(light, level_mm=level_mm, expected=expected, **flat)
            assert stated_mm == pytest.approx(np.hypot(shape_mm, std * level_mm), rel=0.02)
    usual = Illumination(model="leds", parameters=(0.0,) * 20)
    assert told_of(usual, level_mm=2.0, **flat) == pytest.approx(told_of(usual, **flat), rel=1e-3)


@pytest.mark.parametrize("name", ["digit", "gelslim_dotless"])
def test_the_poses_covariance_is_as_wide_as_poses_from_measured_depth_err(name):
    spec = load_sensor(name)
    mesh = shapes.make_shape("notched_elbow").mesh
    found = []
    for k, placed in enumerate(make_paper_grid(mesh, n=PRESSES, seed=7)):
        made = simulate_press(mesh, placed, spec, seed=k)
        frame = TactileFrame(sensor=name, image=made.image, reference=optics.render_reference(spec))
        truth = made.truth.sensor_from_object
        pose = track_pose(
            estimate_depth(frame, spec, None, DepthParams()), mesh, PoseParams(), truth
        )
        off = pose.sensor_from_object @ rigid.invert(truth)
        middle = pose.scene_mm.mean(axis=0).astype(float)
        error = np.concatenate([rigid.rotation_vector_rad(off), rigid.apply(off, middle) - middle])
        error = pose.observable @ error
        known = pose.observable @ pose.covariance @ pose.observable.T
        rank = round(float(np.trace(pose.observable)))
        if rank:  # a grasp that leaves every direction open has no error to compare
            found.append(error @ np.linalg.pinv(known, rcond=1e-10) @ error / rank)
    assert len(found) >= PRESSES - 1
    # The middle of six touches, each of which errs by 2.4 times more or less than is stated,
    # scatters by 2.7 times.
    assert 0.1 < np.median(found) < 4.0, (
        "chi-square over its degrees of freedom; 30 and 100 without the sensor's error"
    )
