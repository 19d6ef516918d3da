"""What all live sources share: which sensor it is, and its images from those that arrive."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.core.arrays import Floats, Image, freeze
from pipeline.core.errors import SettingProblem
from pipeline.core.geometry.camera import Camera
from pipeline.io.gel_images import GelImageConverter, make_gel_converter, require_colour
from pipeline.io.resampling import infer_depth_camera
from pipeline.io.sensor_guess import resolve_sensor_name
from pipeline.sensors.spec import load_sensor


class LiveImages:
    """Images and depth of one sensor, stated or guessed; of another size they begin anew."""

    def __init__(
        self, sensor: str = "", *, file_names: Sequence[str] = (), may_differ: bool = False
    ) -> None:
        self.sensor = sensor  # "" before the first image
        self._may_differ = may_differ  # images may be differences from a reference
        self.shape: tuple[int, ...] = ()  # of the last image that arrived
        self._stated = sensor
        self.file_names = file_names  # that may name the sensor
        self._converter: GelImageConverter | None = None
        self._camera: Camera | None = None
        self._is_coloured = False

    def convert_image(self, rgb: Image) -> Image:
        """An image (rows, cols, 3) in the sensor's size.

        Raises SettingProblem for an unknown sensor or one of depth, FileProblem for grey images.
        """
        rows, cols, _ = rgb.shape
        if self._converter is None or rgb.shape != self.shape:
            self._check_kind(is_depth=False)
            self._converter = make_gel_converter(
                self._stated,
                (rows, cols),
                None if self._may_differ else rgb,
                lambda: rgb,
                file_names=self.file_names,
            )
            self._set_sensor(self._converter.sensor, f"images of {cols} x {rows} px")
            self.shape = rgb.shape
        if not self._is_coloured:
            require_colour([rgb], Path(self.sensor))
            self._is_coloured = bool((rgb.max(axis=2) > rgb.min(axis=2)).any())
        return self._converter.convert_image(rgb)

    def find_camera(self, depth_mm: Floats, published: Camera | None = None) -> Camera | None:
        """Intrinsics of a depth image: as published, else as its size tells, None = the sensor's.

        Raises SettingProblem for a sensor without depth.
        """
        if depth_mm.shape != self.shape:
            self._check_kind(is_depth=True)
            rows, cols = depth_mm.shape
            name, _ = resolve_sensor_name(
                self._stated, (rows, cols), is_depth=True, file_names=self.file_names
            )
            self._set_sensor(name, f"depth of {cols} x {rows} px")
            self._camera = infer_depth_camera(load_sensor(name), (rows, cols))[0]
            self.shape = depth_mm.shape
        fits = published is not None and published.shape == depth_mm.shape
        return published if fits else self._camera

    def _check_kind(self, *, is_depth: bool) -> None:
        if not self._stated:
            return
        spec = load_sensor(self._stated)
        if spec.sensor_kind.is_depth != is_depth:
            what = "depth of 16 bits or floats" if is_depth else "colour images"
            raise SettingProblem(
                f"this source gives {what}, which {spec.title} does not; name its own sensor "
                "(--sensor, --partner-sensor)"
            )

    def _set_sensor(self, name: str, what: str) -> None:
        if not name:
            raise SettingProblem(f"no known sensor has {what}; give --sensor")
        self.sensor = name


def scale_depth(raw: NDArray[np.generic], step_mm: float = 1.0) -> Floats:
    """Depth in mm of what a camera gives in steps of `step_mm`, NaN where that is no distance."""
    depth_mm = raw.astype(np.float32) * np.float32(step_mm)
    depth_mm[~np.isfinite(depth_mm) | (depth_mm <= 0.0)] = np.nan
    return freeze(depth_mm)
