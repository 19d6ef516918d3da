"""A third kind of sensor comes from a module of its own and goes through depth, target depth and
preview.
"""

from __future__ import annotations

import dataclasses
import importlib.metadata
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from pipeline.core import entry_points
from pipeline.core.arrays import freeze
from pipeline.core.errors import CalibrationError, SettingProblem, ShapeError
from pipeline.core.geometry import membrane
from pipeline.core.graph import Skipped
from pipeline.core.values.frames import TactileFrame
from pipeline.core.values.results import DepthMap, make_pixel_index
from pipeline.io.hdf5_writer import RecordingWriter
from pipeline.physics.sensor_images import IMAGE_RENDERERS, render_reference
from pipeline.physics.simulation.press import simulate_press
from pipeline.sensors import kinds
from pipeline.sensors.kinds import GEL, GelSensor, SensorKind, register_kind
from pipeline.sensors.spec import SensorSpec, load_sensor
from pipeline.stages.depth import frame_checks, photometric
from pipeline.stages.depth.contact_force import FORCE_MODELS
from pipeline.stages.depth.gel.rest import DEPTH_ESTIMATORS
from pipeline.stages.depth.photometric import DepthParams
from pipeline.stages.networks import weights_registry
from pipeline.stages.networks.weights import NoWeights
from pipeline.stages.touch import latent_diffusion, t2d2, t2t, vqvae
from pipeline.translation.translate import Request, open_translation
from pipeline.views.display_params import DisplayParams
from pipeline.views.preview import make_frame_preview, make_indentation_scale

TOML = """kind = "taxels"
title = "Taxel array"
[image]
rows = { value = 12, unit = "px", from = "test" }
cols = { value = 16, unit = "px", from = "test" }
[camera]
fx = { value = 20.0, unit = "px", from = "test" }
fy = { value = 20.0, unit = "px", from = "test" }
cx = { value = 7.5, unit = "px", from = "test" }
cy = { value = 5.5, unit = "px", from = "test" }
[rest]
depth = { value = 20.0, unit = "mm", from = "test" }
[limits]
contact_min = { value = 0.1, unit = "mm", from = "test" }
indentation_max = { value = 3.0, unit = "mm", from = "test" }
no_contact_change = { value = 0.2, unit = "mm", from = "test" }
[alignment]
translation = { value = [0.0, 0.0, -20.0], unit = "mm", from = "test" }
rotation_vector = { value = [0.0, 0.0, 0.0], unit = "deg", from = "test" }
"""


class TaxelArray(SensorKind):
    """Flat pads that read how far each is pressed, in mm."""

    def parse_parts(self, section, data, path):
        return {}

    def parse_membrane(self, section, camera, parts):
        z = section("rest").read_number("depth", "mm", 0.1, 1000.0)
        return membrane.make_flat_membrane(
            z, camera.cols * z / camera.fx_px, camera.rows * z / camera.fy_px
        )

    def find_image_problem(self, image):
        return "has negative taxels" if (image < -1.0).any() else ""


def render_image(_sensor, indentation_mm, _depth_mm, _seed, _shear_mm):
    return indentation_mm


def estimate_depth(frame, sensor, _calibration, params, _progress):
    pressed = sensor.sensor_kind.compute_change(frame.image, frame.reference)
    if float(np.abs(pressed).max()) < sensor.limits.no_contact_change / params.sensitivity:
        still = frame_checks.make_untouched_depth(frame, sensor, ("no taxel is pressed",))
        return Skipped(output=still, reason=still.notes[0])
    return DepthMap(
        indentation_mm=freeze(pressed),
        depth_mm=freeze((sensor.rest_depth_mm - pressed).astype(np.float32)),
        contact=freeze(pressed > params.contact_limit * sensor.limits.contact_min_mm),
        camera=sensor.camera,
        source_index=make_pixel_index(sensor.camera.shape),
    )


TAXELS = TaxelArray(
    key="taxels",
    is_depth=True,
    change_sign=1.0,
    full_change=1.0,
    peak_change=2.0,
    display_group="gel",
    still_change=0.1,
    drift_change=None,
)
IMAGE_RENDERERS.add(TaxelArray, render_image)
DEPTH_ESTIMATORS.add(TaxelArray, estimate_depth)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    (tmp_path / "array.toml").write_text(TOML)
    return tmp_path / "array.toml"


@pytest.fixture
def sensor(path: Path, monkeypatch) -> SensorSpec:
    monkeypatch.setattr(kinds, "_registered", {})
    register_kind(TAXELS)
    return load_sensor(str(path))


def make_frame(sensor: SensorSpec, pressed_mm: float) -> TactileFrame:
    image = np.zeros(sensor.camera.shape, np.float32)
    image[4:7, 6:10] = pressed_mm
    return TactileFrame(sensor=sensor.name, image=image, reference=render_reference(sensor))


def test_an_unknown_kind_is_refused_with_those_that_are_known(path: Path):
    with pytest.raises(CalibrationError, match=r"'bubble' or 'gel', got 'taxels'"):
        load_sensor(str(path))


def test_another_package_adds_a_kind_by_an_entry_point(path: Path, monkeypatch):
    entry = importlib.metadata.EntryPoint(
        name="lab", value=f"{__name__}:TAXELS", group="tactoscope.sensor_kinds"
    )
    monkeypatch.setattr(
        importlib.metadata, "entry_points", lambda group: [entry] if group == entry.group else []
    )
    entry_points.load_entry_points.cache_clear()
    try:
        assert load_sensor(str(path)).sensor_kind is TAXELS
    finally:
        entry_points.load_entry_points.cache_clear()


def test_a_frame_of_the_third_kind_goes_through_depth(sensor: SensorSpec):
    depth = photometric.estimate_depth(make_frame(sensor, 0.8), sensor, None, DepthParams())
    assert depth.contact.sum() == 12
    assert depth.indentation_mm.max() == pytest.approx(0.8)
    assert depth.depth_mm.min() == pytest.approx(19.2)


def test_a_frame_without_contact_needs_no_estimate(sensor: SensorSpec):
    depth = photometric.skip_without_contact(make_frame(sensor, 0.05), sensor, None, DepthParams())
    assert depth is not None
    assert depth.notes == ("no taxel is pressed",)
    assert not depth.contact.any()
    assert (
        photometric.skip_without_contact(make_frame(sensor, 0.8), sensor, None, DepthParams())
        is None
    )


def test_the_kind_checks_its_frames(sensor: SensorSpec):
    with pytest.raises(ShapeError, match="negative taxels"):
        frame_checks.check_frame(make_frame(sensor, -2.0), sensor)


def test_the_third_kind_has_a_preview_with_its_scale(sensor: SensorSpec):
    display = DisplayParams(gel_limit_mm=2.0)
    preview = make_frame_preview(make_frame(sensor, 0.8).image, sensor.camera, sensor, display)
    assert preview.pixels.shape == (12, 16, 3)
    assert make_indentation_scale(sensor, display).high == 2.0


@pytest.mark.parametrize("target", ["gelslim", "soft_bubble"])
def test_a_recording_of_the_third_kind_is_translated(sensor: SensorSpec, path: Path, target: str):
    with RecordingWriter(path.with_name("touch.h5")) as writer:
        writer.append(sensor.name, make_frame(sensor, 0.8))
    request = Request(recording=path.with_name("touch.h5"), source=str(path), target=target)
    with closing(open_translation(request)) as translation:
        results = translation.evaluate(0, ["depth", "touch"])
        assert results["depth"].method.name == "physics"  # no network is for them
        assert not results["depth"].fallback
        touch = results["touch"].output
        assert touch.image.shape[:2] == translation.target.camera.shape
        assert touch.membrane.contact.any()


def test_what_a_kind_does_not_offer_is_refused_in_words(sensor: SensorSpec):
    from pipeline.physics.simulation import shapes

    with pytest.raises(SettingProblem, match="taxels"):
        simulate_press(shapes.make_shape("sphere").mesh, np.eye(4), sensor, seed=None)


@pytest.mark.parametrize("name", ["digit", "soft_bubble"])
def test_a_change_restores_the_image(name: str):
    sensor = load_sensor(name)
    kind = sensor.sensor_kind
    reference = render_reference(sensor)
    change = np.full(reference.shape, 2.0, np.float32)
    image = kind.apply_change(reference, change)
    assert image.dtype == reference.dtype
    np.testing.assert_allclose(kind.compute_change(image, reference)[3:-3, 3:-3], 2.0, atol=1e-4)


def test_a_subclass_has_the_entries_of_its_base_and_others_none():
    class SofterGel(GelSensor):
        """A gel in all but its description."""

    softer = SofterGel(
        **{field.name: getattr(GEL, field.name) for field in dataclasses.fields(GEL)}
    )
    assert FORCE_MODELS.get(softer) is FORCE_MODELS.get(GEL) is not None
    assert FORCE_MODELS.get(TAXELS) is None


@pytest.mark.parametrize("method", [t2d2, t2t, latent_diffusion, vqvae])
def test_networks_of_touches_say_that_they_do_not_know_the_third_kind(sensor: SensorSpec, method):
    """With weights of the user's, which a kind in a table of its own raised KeyError for."""
    gelslim = load_sensor("gelslim")
    file = weights_registry.WEIGHTS_FOLDER / "t2t_bubble.safetensors"
    found = method.select_weights(
        *((gelslim, sensor) if method is t2d2 else (sensor, gelslim)), file
    )
    assert isinstance(found, NoWeights)
