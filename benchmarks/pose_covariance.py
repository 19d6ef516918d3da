"""Are poses as far off as their covariance says? On depth as it is measured, and on exact depth
with modelled noise.

    python -m benchmarks.pose_covariance [PART OF A SENSOR'S NAME [WAY [PRESSES]]]

WAY is one of those below, with every sensor's name if the first is ""; PRESSES of each object, 6
unless said.

Catalogue objects are pressed into every simulated sensor. *Measured* is what the stage *depth*
estimates from the sensor's image, by physics and by network; *modelled* is the true membrane with
white noise of 0.01 mm and the error that the sensor's description states, drawn as a smooth field;
*translated* is the touch that physics makes of what another sensor measured of the same press,
which takes that sensor's error along. A pose begins at the truth, so that its error is that of the
measurement and no other minimum's. Reported is its chi-square under its covariance, in the
directions that it calls determined, as the median over touches over what a right covariance's
median would be: above 1 poses are farther off than they say; its standard error is that of a median
of draws from these touches. The error of a row is how many times that is too much or too little;
the baseline is the same without the sensor's measured error. Next to them stands the error of
measured depth and the length over which it hangs together, median and mean over the touches: what
sensors are described with lies between the two.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy.ndimage import gaussian_filter
from scipy.stats import chi2

from benchmarks.harness.results import BenchmarkResult
from benchmarks.harness.text_report import print_result
from benchmarks.harness.timing import Requirement, build_measurement, summarize_times
from benchmarks.scenes.depth_helpers import build_reader
from pipeline.core.arrays import Doubles, freeze
from pipeline.core.geometry import rigid
from pipeline.core.geometry.meshes import Mesh
from pipeline.core.params import NoParams
from pipeline.core.values.frames import TactileFrame
from pipeline.core.values.results import DepthErrorModel, DepthMap, make_pixel_index
from pipeline.physics.sensor_images import render_sensor_image
from pipeline.physics.simulation import shapes
from pipeline.physics.simulation.poses import make_paper_grid
from pipeline.physics.simulation.press import SimulatedPress, simulate_press
from pipeline.sensors.alignment import resolve_alignment
from pipeline.sensors.spec import SensorSpec, list_sensor_names, load_sensor
from pipeline.stages.cloud.back_projection import BackProjectionParams, back_project_depth
from pipeline.stages.pose.signed_distances import PoseParams, track_pose
from pipeline.stages.target_depth.surface_projection import SurfaceProjectionParams, project_cloud
from pipeline.stages.touch.physical_render import PhysicalRenderParams, render_touch
from pipeline.stages.touch_depth import stage as touch_depth

OBJECTS = ("letters", "curve", "cross", "star")
"""Of the catalogue's, those whose contacts determine a pose."""
PRESSES = 6  # of each, unless said
_DRAWS = 1000
_WHITE_MM = 0.01
_COMPUTED = DepthErrorModel(rms_mm=0.03, correlation_mm=0.5)  # where nobody has measured a sensor's
# of what is translated
_SOURCES = {"gelslim": "digit", "digit": "gelslim_dotless", "soft_bubble": "gelslim"}
NEEDS = "five minutes"
_PARAMS = PoseParams(keep_steps=False)
_OFF = 2.0


@dataclass(frozen=True, slots=True, kw_only=True)
class CovarianceScore:
    """Touches of one sensor by one depth."""

    # chi-square over what a right covariance has as its median
    normalized_chi_square: tuple[float, ...]
    naive: tuple[float, ...]  # without the measured error
    ms: tuple[float, ...]  # a pose, of the processor
    shift_um: tuple[float, ...]  # that the pose is off at the contact's middle, where determined
    rank: tuple[int, ...]  # directions that are determined

    @property
    def ratio(self) -> float:
        """Its median."""
        return (
            float(np.median(self.normalized_chi_square))
            if self.normalized_chi_square
            else float("nan")
        )

    @property
    def ratio_error(self) -> float:
        """Standard error of that median."""
        if not self.normalized_chi_square:
            return float("nan")
        size = (_DRAWS, len(self.normalized_chi_square))
        drawn = np.random.default_rng(5).choice(self.normalized_chi_square, size)
        return float(np.median(drawn, axis=1).std())


@lru_cache(maxsize=2)
def touches(name: str, presses: int = PRESSES) -> tuple[tuple[SimulatedPress, Mesh, Doubles], ...]:
    """Presses of a sensor that converged and touch, the object, and where it was in the
    alignment frame.
    """
    return tuple(_pressed(load_sensor(name), presses))


def _pressed(spec: SensorSpec, presses: int) -> Iterator[tuple[SimulatedPress, Mesh, Doubles]]:
    for index, name in enumerate(OBJECTS):
        mesh = shapes.make_shape(name).mesh
        for k, at in enumerate(make_paper_grid(mesh, n=presses, seed=17 + index)):
            made = simulate_press(mesh, at, spec, seed=k)
            if made.converged and made.truth.contact is not None and made.truth.contact.any():
                yield made, mesh, at


def measure_depth(made: SimulatedPress, spec: SensorSpec, method: str) -> DepthMap:
    """What the stage makes of the image."""
    rest = np.zeros(spec.camera.shape, np.float32)
    untouched = render_sensor_image(spec, rest, spec.rest_depth_mm, 100)
    return build_reader(method)(
        TactileFrame(sensor=spec.name, image=made.image, reference=untouched), spec
    )


def simulate_depth(made: SimulatedPress, spec: SensorSpec, seed: int) -> DepthMap:
    """The true membrane with white noise and a smooth error."""
    rng = np.random.default_rng([seed, 23])
    limits = spec.limits
    error = _COMPUTED
    if limits.depth_rms_mm:
        error = DepthErrorModel(
            rms_mm=limits.depth_rms_mm, correlation_mm=limits.depth_correlation_mm
        )
    sigma_px = error.correlation_mm / spec.pixel_mm / np.sqrt(2.0)
    field = gaussian_filter(
        rng.standard_normal(spec.camera.shape), sigma_px, mode="wrap", truncate=3.0
    )
    # what smoothing left of a unit variance
    field *= error.rms_mm * 2.0 * np.sqrt(np.pi) * sigma_px
    depth = (
        spec.rest_depth_mm
        - made.truth.indentation_mm
        + field
        + _WHITE_MM * rng.standard_normal(field.shape)
    )
    return DepthMap(
        indentation_mm=freeze((spec.rest_depth_mm - depth).astype(np.float32)),
        depth_mm=freeze(depth.astype(np.float32)),
        contact=made.truth.contact,
        camera=spec.camera,
        source_index=make_pixel_index(spec.camera.shape),
        error=error,
    )


def translate_press(made: SimulatedPress, source: SensorSpec, target: SensorSpec) -> DepthMap:
    """What the target would feel of a press of the source."""
    cloud = back_project_depth(
        measure_depth(made, source, "network"),
        resolve_alignment(source, target),
        BackProjectionParams(),
    )
    touch = render_touch(
        project_cloud(cloud, target, SurfaceProjectionParams()), target, PhysicalRenderParams()
    )
    return touch_depth.use_membrane(touch, target, NoParams())


def chi_square(touch: DepthMap, truth: Doubles, mesh: Mesh) -> tuple[float, float, int] | None:
    """(chi-square of the error over its right median, mm that the middle is off, directions that
    are determined).

    None where nothing is determined.
    """
    found = track_pose(touch, mesh, _PARAMS, truth)
    if found.sensor_from_object is None or (rank := round(float(np.trace(found.observable)))) == 0:
        return None
    off = found.sensor_from_object @ rigid.invert(truth)
    middle = found.scene_mm.mean(axis=0).astype(float)
    error = np.concatenate([rigid.rotation_vector_rad(off), rigid.apply(off, middle) - middle])
    error = found.observable @ error
    known = found.observable @ found.covariance @ found.observable.T
    squared_length = float(error @ np.linalg.pinv(known, rcond=1e-10, hermitian=True) @ error)
    return squared_length / float(chi2.median(rank)), float(np.linalg.norm(error[3:])), rank


def score_sensor(spec: SensorSpec, how: str, presses: int = PRESSES) -> CovarianceScore:
    """All touches of a sensor, by a method of *depth*, "modelled" or "translated"."""
    chi_squares = list[float]()
    naive = list[float]()
    ms = list[float]()
    shift = list[float]()
    rank = list[int]()
    source = load_sensor(_SOURCES[spec.name]) if how == "translated" else spec
    for k, (made, mesh, at) in enumerate(touches(source.name, presses)):
        if how == "modelled":
            touched = simulate_depth(made, spec, k)
        elif how == "translated":
            touched = translate_press(made, source, spec)
        else:
            touched = measure_depth(made, spec, how)
        truth = rigid.invert(spec.alignment_from_sensor) @ at
        began_s = time.process_time()
        found = chi_square(touched, truth, mesh) if touched.contact.any() else None
        taken_ms = 1e3 * (time.process_time() - began_s)
        if found is None:
            continue
        plain = chi_square(replace(touched, error=None), truth, mesh)
        rank.append(found[2])
        chi_squares.append(found[0])
        shift.append(1e3 * found[1])
        ms.append(taken_ms)
        naive.append(found[0] if plain is None else plain[0])
    return CovarianceScore(
        normalized_chi_square=tuple(chi_squares),
        naive=tuple(naive),
        ms=tuple(ms),
        shift_um=tuple(shift),
        rank=tuple(rank),
    )


def error_of_depth(spec: SensorSpec, how: str, presses: int) -> str:
    """Over touches: rms in contact, the length at which the error's correlation is exp(-1/2),
    and what is reported.
    """
    found: list[tuple[float, float, float]] = []
    for made, _mesh, _at in touches(spec.name, presses):
        depth = measure_depth(made, spec, how)
        both = depth.contact & made.truth.contact
        if both.sum() < 100:
            continue
        error = np.where(both, made.truth.indentation_mm - depth.indentation_mm, 0.0).astype(float)
        counted, products = (
            _with_itself(a)[0, : spec.camera.cols // 2] for a in (both.astype(float), error)
        )
        along = products / np.maximum(counted, 50.0)
        length_px = np.flatnonzero(np.append(along, -np.inf) < along[0] * np.exp(-0.5))[0]
        found.append(
            (
                np.sqrt(along[0]),
                length_px * spec.pixel_mm,
                depth.error.rms_mm if depth.error else np.nan,
            )
        )
    rms_mm, length_mm, told_mm = np.median(found, axis=0)
    mean_mm, mean_length_mm, mean_told_mm = np.mean(found, axis=0)
    return (
        f"{rms_mm:.3f} mm over {length_mm:.1f} mm (means {mean_mm:.3f} over {mean_length_mm:.1f}), "
        f"stated as {told_mm:.3f} ({mean_told_mm:.3f}) over {spec.limits.depth_correlation_mm:g}"
    )


def _with_itself(image: np.ndarray) -> np.ndarray:
    return np.fft.irfft2(np.abs(np.fft.rfft2(image, [2 * n for n in image.shape])) ** 2)


def _ways(spec: SensorSpec) -> tuple[str, ...]:
    own = ("physics", "network", "modelled")
    return (*own, "translated") if spec.name in _SOURCES else own


def measure(part: str = "", way: str = "", presses: int | str = PRESSES) -> BenchmarkResult:
    n_presses = int(presses)
    rows = []
    notes = []
    for spec in (load_sensor(name) for name in list_sensor_names() if part in name):
        for how in (how for how in _ways(spec) if way in how):
            found = score_sensor(spec, how, n_presses)
            if not found.normalized_chi_square:
                notes.append(f"{spec.name}, {how}: no touch determines any direction")
                continue
            factor, plain = (max(r, 1.0 / r) for r in (found.ratio, float(np.median(found.naive))))
            rows.append(
                build_measurement(
                    f"{spec.name}, {how}: covariance, times off",
                    ours=summarize_times(found.ms),
                    ours_error=factor,
                    unit="times",
                    bar=Requirement(max_error=_OFF),
                    peer="residuals alone",
                    peer_error=plain,
                )
            )
            low, high = np.percentile(found.normalized_chi_square, (25, 75))
            note = (
                f"{spec.name}, {how}: chi-square {found.ratio:.2f} of a right one's, give or take "
                f"{found.ratio_error:.2f} ({low:.2f} to {high:.2f}: half of "
                f"{len(found.normalized_chi_square)} touches), "
                f"{np.median(found.naive):.2f} without the measured error; middle off "
                f"{np.median(found.shift_um):.0f} um; {np.mean(found.rank):.1f} of 6 directions "
                "determined"
            )
            if how == "translated":
                note += f"; from {_SOURCES[spec.name]}"
            elif how != "modelled":
                note += f"; depth off by {error_of_depth(spec, how, n_presses)}"
            notes.append(note)
    return BenchmarkResult(
        title="Errors of poses and their covariance",
        unit="times",
        rows=tuple(rows),
        notes=tuple(notes),
    )


if __name__ == "__main__":
    print_result(measure(*sys.argv[1:4]))
