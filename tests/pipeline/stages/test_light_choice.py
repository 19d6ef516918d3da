"""Which light a sensor instance has: chosen by one touch, or by several touches for all frames
of their recording.
"""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from pipeline.calibration import near_led_prior
from pipeline.core.geometry.camera import Camera
from pipeline.core.geometry.rigid import translation
from pipeline.core.progress import SILENT
from pipeline.core.values.frames import TactileFrame
from pipeline.physics import optics
from pipeline.physics.optics import compute_slopes
from pipeline.physics.simulation import shapes
from pipeline.physics.simulation.press import simulate_press
from pipeline.sensors.spec import load_sensor
from pipeline.stages.depth.gel import light as light_node
from pipeline.stages.depth.gel import rest
from pipeline.stages.depth.illumination import field_light, selection
from pipeline.stages.depth.illumination.light import (
    Illumination,
    ImagePatch,
    simulate_recorded_change,
)
from pipeline.stages.depth.photometric import DepthParams, estimate_gel_depth

PLACES_MM = (0.6, -0.8), (-1.0, 1.0), (2.0, 1.5)
DIGIT_PRESSES = 1, 14, 30
GELSLIM_3_PX_MM = 0.07


@pytest.fixture(autouse=True)
def caches(tmp_path, monkeypatch):
    """Empty caches, in memory and on disk."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    light_node._recordings.clear()
    yield
    light_node._recordings.clear()


def draw_touches(seed=3):
    """Presses of a ball on a Mini whose LEDs stand next to the gel: light that no distant LEDs
    explain.
    """
    source = load_sensor("gelsight_mini")
    (rows, cols), reference = source.camera.shape, optics.render_reference(source)
    rng = np.random.default_rng(seed)
    field = near_led_prior.sample_instances(source.optics, source.pixel_mm, (rows, cols), 1, rng)[
        0
    ].ravel()
    patch = ImagePatch(
        x_px=np.arange(cols, dtype=np.float32),
        y_px=np.arange(rows, dtype=np.float32),
        change=np.zeros(reference.shape, np.float32),
        reference=reference.astype(np.float32),
        changed=np.ones((rows, cols), np.bool_),
        downsampling=1,
        pixel_mm=source.pixel_mm,
        smoothing_px=0.0,
        unmarked_share=np.ones((rows, cols, 3), np.float32),
    )
    light = field_light.make_field_light(field, patch, source)
    mesh = shapes.make_shape("sphere").mesh
    frames = []
    for index, (x, y) in enumerate(PLACES_MM):
        press = simulate_press(
            mesh, translation(x, y, -0.8 - mesh.vertices_mm[:, 2].min()), source, seed=2
        )
        surface = np.array(press.truth.indentation_mm)
        change = light.render(surface, *compute_slopes(surface, source.pixel_mm)).change
        image = reference + simulate_recorded_change(change, patch, light.blur_px)
        image = np.clip(np.rint(image + rng.normal(0.0, 1.0, image.shape)), 0, 255).astype(np.uint8)
        frames.append(
            TactileFrame(sensor="gelsight_mini", image=image, reference=reference, index=index)
        )
    return source, frames


def find_touches(source, frames):
    state = rest.describe_rest(frames[0], source, None, DepthParams(), SILENT)
    return [light_node.find_touch(f.image, f.reference, state, SILENT) for f in frames]


def read(frame, source, context=()):
    return estimate_gel_depth(
        replace(frame, context_frames=tuple(context)), source, None, DepthParams()
    )


def test_a_touch_fits_nothing_where_the_field_of_its_recording_is_known():
    source, frames = draw_touches()
    touch = find_touches(source, frames[2:])[0]
    prior = near_led_prior.compute_prior(source, source.pixel_mm, source.camera.shape)
    dent_mm = np.zeros((24, 32), np.float32)
    dent_mm[10:16, 12:20] = 0.3
    shares, depths = [], []
    for certainty in (1.0, 30.0, 100.0, 1e4):
        field = Illumination(
            model="field",
            parameters=tuple(prior.mean),
            covariance=tuple(field_light.sum_covariance(certainty * prior.precision).ravel()),
        )
        place = (dent_mm, source, source.pixel_mm)
        shares.append(field_light.compute_known_share(field, *place))
        known = shares[-1] == 1.0
        found = selection.adapt_field(field, *place, None if known else lambda: touch)
        assert not found.covariance
        depths.append(found.parameters)
    assert shares[0] == 0.0
    assert shares == sorted(shares)
    assert shares[-1] == 1.0
    assert depths[0] == selection.choose_illumination([touch]).parameters
    assert depths[-1] == tuple(prior.mean)


def test_a_touch_far_from_those_of_its_recording_has_the_same_field_alone_and_among_them():
    source, frames = draw_touches()
    _, alone = read(frames[2], source)
    _, among = read(frames[2], source, [frame.image for frame in frames[:2]])
    assert alone == among
    assert not alone.from_context


def test_a_field_is_known_better_by_more_touches():
    source, frames = draw_touches()
    touches = find_touches(source, frames)
    dent_mm = np.zeros((24, 32), np.float32)
    dent_mm[13:20, 18:25] = 0.3  # between the second and the third touch
    known = [
        field_light.compute_known_share(
            selection.choose_illumination(touches[:n]), dent_mm, source, source.pixel_mm
        )
        for n in (2, 3)
    ]
    assert known[0] < known[1]


def read_image(path):
    return np.ascontiguousarray(cv2.imread(str(path))[..., ::-1])


def test_a_real_digit_takes_the_field_of_its_recording_and_asks_it_near_the_dent_alone(real_data):
    source = load_sensor("digit")
    folder = real_data / "digit_balls"
    reference = read_image(folder / "background.png")
    images = [read_image(folder / f"{index:04d}.png") for index in DIGIT_PRESSES]
    frame = TactileFrame(sensor="digit", image=images[2], reference=reference)
    _, alone = read(frame, source)
    depth, among = read(frame, source, images)
    _, other = read(replace(frame, image=images[0]), source, images)
    assert alone.model == among.model == "field"
    assert among == other != alone
    y, x = np.nonzero(depth.contact)
    assert len(y) > 1000
    far = (
        np.hypot(*np.indices(depth.contact.shape) - np.array([y.mean(), x.mean()])[:, None, None])
        > 100
    )
    assert np.abs(depth.indentation_mm[far]).max() < 0.05


def test_a_real_gelslim_is_read_by_near_leds_that_its_recording_chose(real_data):
    plain = load_sensor("gelslim")
    folder = real_data / "gelslim3_balls"
    camera = plain.camera
    focal_px = float(np.median(plain.rest_depth_mm)) / GELSLIM_3_PX_MM
    source = plain.with_camera(
        Camera(
            rows=camera.rows,
            cols=camera.cols,
            fx_px=focal_px,
            fy_px=focal_px,
            cx_px=camera.cx_px,
            cy_px=camera.cy_px,
        )
    )
    reference = read_image(folder / "ref.jpg")
    images = tuple(read_image(folder / f"sample_{index}.jpg") for index in (3, 10, 20))
    frame = TactileFrame(
        sensor="gelslim", image=images[2], reference=reference, context_frames=images[:2]
    )
    depth, measured = estimate_gel_depth(frame, source, None, DepthParams())
    assert measured.model == "near"
    assert measured.from_context
    assert depth.contact.any()
