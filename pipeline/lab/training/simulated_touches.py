"""Simulated touches that generators are trained on: those of a target alone, and pairs of a gel and
a bubble.

Objects of the catalogue and random bodies are pressed onto sensor instances that differ as those of
a lab do. Of a target's touch an unknown source observes a part, which is sampled, so that no pair
is simulated; the physical render of that part is the answer that a network has to improve on. A
pair's bubble has a camera that is widened to be symmetric about its axis, so that the pair can be
mirrored: the mirrored pair is what the mirrored object gives. The gel's image is rendered anew
then, by another sensor instance, since its LEDs are not symmetric.
"""

import io
import math
from collections.abc import Callable, Mapping
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, Generic, Literal, TypeVar, cast

import numpy as np

from pipeline.core.arrays import Doubles, Floats, Mask, freeze
from pipeline.core.derived import derive_once
from pipeline.core.errors import SettingProblem
from pipeline.core.files import open_atomic, read_cached_arrays
from pipeline.core.frozen import frozen
from pipeline.core.geometry import rigid
from pipeline.core.geometry.camera import Camera
from pipeline.core.geometry.meshes import Mesh
from pipeline.core.geometry.rasterisation import render_mesh
from pipeline.core.memo import Memo
from pipeline.core.values.results import TargetDepth, make_pixel_index
from pipeline.physics import optics
from pipeline.physics.simulation import poses, shapes, variation
from pipeline.physics.simulation.datasets import BUBBLE_DEEPER_MM
from pipeline.physics.simulation.press import move_bubble_closer, simulate_press
from pipeline.physics.simulation.random_bodies import make_random_body
from pipeline.sensors.spec import SensorSpec, load_sensor
from pipeline.stages.touch.physical_render import PhysicalRenderParams, render_touch
from pipeline.stages.touch.t2d2 import make_working_sensor

DataSplit = Literal["training", "unseen_grasps", "unseen_tools", "all_objects"]
DATA_SPLITS: tuple[DataSplit, ...] = ("training", "unseen_grasps", "unseen_tools", "all_objects")
"""`training` adds random bodies to the training objects. `all_objects` are training objects and
unseen tools, for networks that see one sensor alone. The position of a split is part of its random
seeds.
"""
_SMALL_MM = 6.0, 17.0  # extent of small bodies
_MAX_EMPTY = 100  # touches in a row without contact
T = TypeVar("T")


def sample_object(
    split: DataSplit,
    rng: np.random.Generator,
    index: int,
    *,
    catalogue_share: float,
    small_share: float = 0.0,
    outline_share: float = 0.0,
) -> tuple[str, Mesh]:
    """Name and mesh of object `index` of a split; the name "" is a random body.

    In training, `catalogue_share` are training objects and the rest random bodies, `small_share` of
    them small and with nothing behind their pattern, `outline_share` of the patterns rims. Other
    splits go through their objects in order.
    """
    if split == "training" and rng.random() >= catalogue_share:
        make = _make_small_body if small_share and rng.random() < small_share else make_random_body
        return "", make(rng, outline_share=outline_share)
    names = {
        "training": shapes.list_shapes("training"),
        "unseen_grasps": shapes.list_shapes("training"),
        "unseen_tools": shapes.list_shapes("unseen"),
        "all_objects": shapes.list_labelled_shapes(),
    }[split]
    name = names[int(rng.integers(len(names))) if split == "training" else index % len(names)]
    return name, shapes.make_shape(name).mesh


def find_next_contact(
    simulate: Callable[[int], T | None], index: int, none: str = "no contact in"
) -> T:
    """Touch `index`, or the next one that `simulate` returns.

    Raises SettingProblem after a hundred without contact.
    """
    for k in range(index, index + _MAX_EMPTY):
        touch = simulate(k)
        if touch is not None:
            return touch
    raise SettingProblem(f"{none} {_MAX_EMPTY} touches from {index} on; choose another press_seed")


def _make_small_body(rng: np.random.Generator, *, outline_share: float) -> Mesh:
    """A random pattern on its own walls, scaled so that a gel feels nearly all of it."""
    large = make_random_body(rng, unsupported_share=1.0, outline_share=outline_share)
    extent = float(np.ptp(large.vertices_mm[:, :2], axis=0).max())
    scale = min(1.0, rng.uniform(*_SMALL_MM) / extent)
    return replace(large, vertices_mm=freeze(large.vertices_mm * (scale, scale, 1.0)))


class SampleCache(Generic[T]):
    """Simulated samples of one dataclass by name: in memory up to `max_bytes`, and in a folder
    where one is given.

    A simulation takes a tenth of a second and training draws each sample many times. A sample is a
    frozen dataclass of arrays and texts.
    """

    def __init__(self, kind: type[T], *, max_bytes: int = 1 << 30) -> None:
        self._kind = kind
        self._memory: Memo[str, T] = Memo(most_bytes=max_bytes)

    def get(self, name: str, folder: str, make: Callable[[], T], **unstored: Any) -> T:
        """Sample `name`: from memory, from `folder`/`name`.npz, or made. An empty `folder` stores
        nothing.

        `unstored` fields are cheap to compute and not written.
        """

        def load_or_make() -> T:
            path = Path(folder) / f"{name}.npz"
            arrays = read_cached_arrays(path) if folder else None
            # a file that is missing, cut short or of other fields is made again
            if arrays is not None and arrays.keys() | unstored.keys() == names:
                values = {
                    key: str(array) if array.dtype.kind == "U" else freeze(array)
                    for key, array in arrays.items()
                }
                return self._kind(**values, **unstored)
            sample = make()
            if folder:
                content = io.BytesIO()
                np.savez(content, **{key: getattr(sample, key) for key in names - unstored.keys()})
                path.parent.mkdir(parents=True, exist_ok=True)
                with open_atomic(path, "a training sample", None) as file:
                    file.write(content.getbuffer())
            return sample

        names = {field.name for field in fields(cast("Any", self._kind))}
        return self._memory.get_or_make(name, load_or_make)

    def clear(self) -> None:
        """Free the memory; files stay."""
        self._memory.clear()


VERSION = 5  # part of the seeds: incremented when the same number gives another touch
GEL = "gelslim"
BUBBLE = "soft_bubble"
# of all objects; of the random bodies
_CATALOGUE_SHARE = 0.4
_SMALL_SHARE = 0.6
# of the deepest point over a gel; data sets begin at 0.3 mm, other recordings lower
_TRAINING_DEPTH_MM = (0.15, 1.0)
# bubbles that come as close as in the data sets, and the range of the others' approach
_AS_RECORDED_SHARE = 0.6
_DEEPER_MM = (0.0, 11.0)
# bubbles of pairs that stand as in the data sets, and the others' placements about the description
_PLACED_AS_RECORDED_SHARE = 0.25
_CLOSER_MM = (-6.0, 10.0)  # its apex is 4 mm inside a gel's surface at 0
_ASIDE_MM = 3.5
_ROTATION_DEG = (2.0, 2.0, 22.0)
# training presses that only a bubble feels: share, depth over the gel
_ABOVE_SHARE = 0.06
_ABOVE_MM = (-4.0, 0.0)
_TOLERANCE_UM = 5.0  # of the physical render: residuals are tenths of a millimetre
# gels among the sampled sources, by the kind of the target
_GEL_SHARE = {"gel": 0.45, "bubble": 0.95}


@frozen
class TargetTouch:
    """A touch as observed, as rendered by physics, and as recorded.

    Arrays (rows, cols) on the working grid.
    """

    observed_mm: Floats  # indentation of the object where the source observes it, 0 elsewhere
    observed: Mask
    in_view: Mask
    physical_mm: Floats  # indentation of the physical render
    physical_contact: Mask
    target_mm: Floats  # indentation that the target records
    target_contact: Mask
    alignment_from_object: Doubles  # (4, 4) mm
    object_name: str  # of the catalogue; "" = a random body


@frozen
class TouchPair:
    """Both sides of a touch on their working grids."""

    change_grey: Floats  # (rows, cols, 3) change of the gel's image, with noise
    gel_mm: Floats  # (rows, cols) indentation
    gel_contact: Mask
    symmetric_bubble_mm: Floats  # (rows, cols) of the symmetric camera, without noise
    symmetric_bubble_contact: Mask
    placement: Doubles  # (4, 4) mm, what moves the bubble from its description

    @property
    def bubble_mm(self) -> Floats:
        """Indentation (rows, cols) in the bubble's own camera."""
        return self.symmetric_bubble_mm[_crop_to_camera()]

    @property
    def bubble_contact(self) -> Mask:
        """Contact (rows, cols) in the bubble's own camera."""
        return self.symmetric_bubble_contact[_crop_to_camera()]


_touches = SampleCache(TargetTouch)
_pairs = SampleCache(TouchPair)


@derive_once
def load_working_sensor(name: str) -> SensorSpec:
    """A sensor as described, on its working grid."""
    return make_working_sensor(load_sensor(name))


def place_nominal_sensors(placement: Doubles, gel: str = GEL) -> tuple[SensorSpec, SensorSpec]:
    """Gel and bubble as described, on their working grids, the bubble moved by `placement`."""
    bubble = load_working_sensor(BUBBLE)
    moved: Doubles = freeze(placement @ bubble.alignment_from_sensor)
    return load_working_sensor(gel), replace(bubble, alignment_from_sensor=moved)


def simulate_target_touch(
    target: str, split: DataSplit, seed: int, index: int, folder: str = ""
) -> TargetTouch | None:
    """Touch `index` of a seed, the same on every call; None where the source observes nothing."""
    touch = _touches.get(
        f"target_{target}_{split}_{seed}_{index}",
        folder,
        lambda: _simulate_touch(
            load_working_sensor(target), split, _make_rng(split, seed, index), index
        ),
    )
    return touch if touch.observed.any() else None


def simulate_touch_pair(
    split: DataSplit,
    seed: int,
    index: int,
    folder: str = "",
    *,
    gel: str = GEL,
    bubble_alone: bool = False,
) -> TouchPair | None:
    """Pair `index` of a seed, the same on every call; None where the gel has no contact.

    With `bubble_alone` contact on the bubble is enough.
    """
    pair = _pairs.get(
        f"pair_{gel}_{split}_{seed}_{index}",
        folder,
        lambda: _simulate_pair(split, _make_rng(split, seed, index), index, gel),
    )
    has_contact = pair.gel_contact.any() or (bubble_alone and pair.bubble_contact.any())
    return pair if has_contact else None


def _make_rng(split: DataSplit, seed: int, index: int) -> np.random.Generator:
    return np.random.default_rng([VERSION, DATA_SPLITS.index(split), seed, index])


def _vary(sensor: SensorSpec, rng: np.random.Generator) -> SensorSpec:
    return variation.vary_sensor(sensor, int(rng.integers(1 << 31)), 1.0)


def _sample_approach(split: DataSplit, rng: np.random.Generator) -> float:
    """How much closer than described a bubble comes to the object, mm."""
    if split != "training" or rng.random() < _AS_RECORDED_SHARE:
        return BUBBLE_DEEPER_MM
    return rng.uniform(*_DEEPER_MM)


def _sample_press(
    split: DataSplit, rng: np.random.Generator, index: int, above_share: float = 0.0
) -> tuple[str, Mesh, Doubles]:
    """Name and mesh of an object, and its pose in the alignment frame."""
    name, mesh = sample_object(
        split, rng, index, catalogue_share=_CATALOGUE_SHARE, small_share=_SMALL_SHARE
    )
    depth_mm = poses.DEPTH_RANGE_MM
    if split == "training":
        depth_mm = _ABOVE_MM if rng.random() < above_share else _TRAINING_DEPTH_MM
    return name, mesh, poses.sample_press_pose(mesh, rng, depth_mm=depth_mm)


def _simulate_touch(
    nominal: SensorSpec, split: DataSplit, rng: np.random.Generator, index: int
) -> TargetTouch:
    instance = _vary(nominal, rng)
    if instance.bubble is not None:
        instance = move_bubble_closer(instance, _sample_approach(split, rng))
    name, mesh, pose = _sample_press(split, rng, index)
    press = simulate_press(mesh, pose, instance, seed=None)
    vertices = rigid.apply(press.sensor_from_object, mesh.vertices_mm)
    surface = render_mesh(vertices, mesh.triangles, instance.camera)[0]
    view = observe_surface(rng, surface, nominal, gel_share=_GEL_SHARE[nominal.kind])
    rendered = render_touch(
        view, nominal, PhysicalRenderParams(tolerance_um=_TOLERANCE_UM)
    ).membrane
    assert rendered is not None
    return TargetTouch(
        observed_mm=view.indentation_mm,
        observed=view.contact,
        in_view=view.in_view,
        physical_mm=rendered.indentation_mm,
        physical_contact=rendered.contact,
        target_mm=press.indentation_mm,
        target_contact=press.contact,
        alignment_from_object=freeze(pose),
        object_name=name,
    )


def _sample_placement(split: DataSplit, rng: np.random.Generator) -> Doubles:
    """(4, 4) mm, what moves a pair's bubble from its description."""
    if split != "training" or rng.random() < _PLACED_AS_RECORDED_SHARE:
        return rigid.translation(0.0, 0.0, BUBBLE_DEEPER_MM)
    motion = rigid.rotation(np.deg2rad(_ROTATION_DEG) * rng.uniform(-1.0, 1.0, 3))
    motion[:3, 3] = *rng.uniform(-_ASIDE_MM, _ASIDE_MM, 2), rng.uniform(*_CLOSER_MM)
    return motion


def _simulate_pair(
    split: DataSplit, rng: np.random.Generator, index: int, gel_name: str
) -> TouchPair:
    placement = _sample_placement(split, rng)
    gel, bubble = (_vary(sensor, rng) for sensor in place_nominal_sensors(placement, gel_name))
    bubble = bubble.with_camera(make_symmetric_camera(bubble.camera))
    _, mesh, pose = _sample_press(split, rng, index, _ABOVE_SHARE)
    on_gel = simulate_press(mesh, pose, gel, seed=int(rng.integers(1 << 31)))
    on_bubble = simulate_press(mesh, pose, bubble, seed=None)
    return TouchPair(
        change_grey=freeze(on_gel.image.astype(np.float32) - optics.render_reference(gel)),
        gel_mm=on_gel.indentation_mm,
        gel_contact=on_gel.contact,
        symmetric_bubble_mm=on_bubble.indentation_mm,
        symmetric_bubble_contact=on_bubble.contact,
        placement=freeze(placement),
    )


def mirror_pair(pair: TouchPair, rng: np.random.Generator, gel_name: str = GEL) -> TouchPair:
    """The pair mirrored across x, y, both or neither.

    The gel's image is rendered by another sensor instance.
    """
    which = int(rng.integers(4))
    names = ("gel_mm", "gel_contact", "symmetric_bubble_mm", "symmetric_bubble_contact")
    axes = tuple(axis for axis, flips in ((-1, which & 1), (-2, which & 2)) if flips)
    flipped = flip_arrays({name: getattr(pair, name) for name in names}, axes)
    gel = _vary(load_working_sensor(gel_name), rng)
    image = optics.render(gel, flipped["gel_mm"], seed=int(rng.integers(1 << 31)))
    change = image.astype(np.float32) - optics.render_reference(gel)
    mirror = np.diag([-1.0 if which & 1 else 1.0, -1.0 if which & 2 else 1.0, 1.0, 1.0])
    placement = freeze(mirror @ pair.placement @ mirror)
    return replace(pair, change_grey=freeze(change), placement=placement, **flipped)


def flip_arrays(arrays: Mapping[str, Any], axes: tuple[int, ...]) -> dict[str, Any]:
    """Arrays (..., rows, cols) by name, reversed along axes."""
    return {
        name: freeze(np.ascontiguousarray(np.flip(array, axes))) for name, array in arrays.items()
    }


def make_symmetric_camera(camera: Camera) -> Camera:
    """The smallest camera that holds all pixels of this one and has its axis in the middle, to
    half a pixel.
    """
    before_x, cols = _pad_axis(camera.cx_px, camera.cols)
    before_y, rows = _pad_axis(camera.cy_px, camera.rows)
    return replace(
        camera, rows=rows, cols=cols, cx_px=camera.cx_px + before_x, cy_px=camera.cy_px + before_y
    )


def _pad_axis(centre_px: float, n: int) -> tuple[int, int]:
    """(pixels to add before the first of `n`, pixels then)."""
    more = round(n - 1 - 2 * centre_px)  # pixels behind the centre less those before it
    return max(more, 0), n + abs(more)


def _crop_to_camera() -> tuple[slice, slice]:
    """The pixels of the bubble's own camera in the symmetric one."""
    camera = load_working_sensor(BUBBLE).camera
    x = _pad_axis(camera.cx_px, camera.cols)[0]
    y = _pad_axis(camera.cy_px, camera.rows)[0]
    return slice(y, y + camera.rows), slice(x, x + camera.cols)


# What an unknown source could observe of an object. A gel observes what lies within a millimetre of
# the deepest point in its window; a bubble observes far more, through a membrane that bridges dents
# and a camera that blurs. A network trained on the whole range serves sources of which it has seen
# no pair.
_FAR_MM = 60.0  # behind the nearest point: no object
# ranges of half the width and height of gels' windows, at the rest surface
_GEL_HALF_MM = (6.0, 13.0), (4.5, 10.0)
_WINDOW_OFFSET_MM = 1.2  # standard deviation of a window's centre
# of a membrane and its depth camera
_MAX_BRIDGE_MM = 2.5
_MAX_BLUR_MM = 0.8


def observe_surface(
    rng: np.random.Generator, surface_mm: Doubles, target: SensorSpec, *, gel_share: float
) -> TargetDepth:
    """What a source observes of an object whose z (rows, cols) in the target's camera is given, NaN
    = none, with contact where it lies beyond the target's rest surface.

    The source is a gel with probability `gel_share`, else a bubble, centred on the target's axis.
    Nothing is observed where the object is outside the window.
    """
    pixel_mm = target.pixel_mm
    in_view = np.ones(surface_mm.shape, np.bool_)
    far_mm = _FAR_MM + float(np.nanmin(surface_mm, initial=1e3))
    surface = np.nan_to_num(surface_mm, nan=far_mm).astype(np.float32)
    if rng.random() < gel_share:
        in_view = _sample_window(rng, target.camera, pixel_mm)
        measured = _add_gel_errors(rng, surface, pixel_mm)
        slice_mm = math.exp(rng.uniform(math.log(0.12), math.log(1.0)))
    else:
        measured = _add_bubble_errors(rng, surface, pixel_mm)
        slice_mm = rng.uniform(0.6, 8.0)
    observed = in_view & np.isfinite(surface_mm)
    observed &= measured <= measured[observed].min(initial=np.inf) + slice_mm
    rest = target.rest_depth_mm
    contact = observed & (measured <= rest)
    index = np.where(observed, make_pixel_index(rest.shape), np.int32(-1))
    return TargetDepth(
        depth_mm=freeze(np.where(observed, measured, np.float32(np.nan))),
        contact=freeze(contact),
        indentation_mm=freeze(np.where(contact, rest - measured, 0.0).astype(np.float32)),
        camera=target.camera,
        source_index=freeze(index.astype(np.int32)),
        in_view=freeze(in_view),
    )


def _sample_window(rng: np.random.Generator, camera: Camera, pixel_mm: float) -> Mask:
    y, x = np.mgrid[: camera.rows, : camera.cols] * pixel_mm
    half_x, half_y = (rng.uniform(*both) for both in _GEL_HALF_MM)
    offset_x, offset_y = rng.normal(0.0, _WINDOW_OFFSET_MM, 2)
    inside = np.abs(x - camera.cx_px * pixel_mm - offset_x) <= half_x
    return inside & (np.abs(y - camera.cy_px * pixel_mm - offset_y) <= half_y)


def _add_gel_errors(rng: np.random.Generator, near: Floats, pixel_mm: float) -> Floats:
    """Two in five are exact; the others are scaled along z and uneven."""
    if rng.random() < 0.4:
        return near
    top = near.min()
    uneven = _sample_noise(rng, near.shape, pixel_mm, 0.06, (1.0, 4.0))
    return top + (near - top) * np.float32(rng.normal(1.0, 0.1)) + uneven


def _add_bubble_errors(rng: np.random.Generator, near: Floats, pixel_mm: float) -> Floats:
    """Dents bridged, edges blurred, smooth noise and bias of a depth camera."""
    import cv2

    reach = round(rng.uniform(0.0, _MAX_BRIDGE_MM) / pixel_mm)
    near = np.minimum(near, near.min() + np.float32(12.0))
    if reach and rng.random() < 0.7:
        disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach + 1, 2 * reach + 1))
        # A membrane comes from small z: it rests on the nearest points and spans narrow gaps behind
        # them.
        bridged = np.asarray(cv2.morphologyEx(near, cv2.MORPH_OPEN, disc), np.float32)
        near += np.float32(rng.uniform(0.0, 1.0)) * (bridged - near)
    sigma = rng.uniform(0.05, _MAX_BLUR_MM) / pixel_mm
    blurred = np.asarray(cv2.GaussianBlur(near, (0, 0), max(sigma, 0.3)), np.float32)
    noise = _sample_noise(rng, near.shape, pixel_mm, 0.2, (0.6, 1.2))
    bias = _sample_noise(rng, near.shape, pixel_mm, 0.2, (4.0, 12.0))
    return blurred + noise + bias + np.float32(rng.normal(0.0, 0.08))


def _sample_noise(
    rng: np.random.Generator,
    shape: tuple[int, ...],
    pixel_mm: float,
    most_mm: float,
    grain_mm: tuple[float, float],
) -> Floats:
    """Smooth noise (rows, cols) of a strength up to `most_mm` and a correlation length within
    `grain_mm`.
    """
    import cv2

    strength = np.float32(rng.uniform(0.0, most_mm))
    grain = rng.uniform(*grain_mm)
    coarse = rng.standard_normal([max(3, math.ceil(n * pixel_mm / grain)) for n in shape])
    return strength * np.asarray(
        cv2.resize(coarse.astype(np.float32), shape[::-1], interpolation=cv2.INTER_CUBIC)
    )


# of one depth frame of a bubble
_NOISE_MM = 0.4
_GRAIN_PX = 0.8


def sample_depth_noise(rng: np.random.Generator, shape: tuple[int, ...]) -> Floats:
    """Noise in mm of the difference of two depth frames of a bubble."""
    import cv2

    white = rng.standard_normal(shape).astype(np.float32)
    grains = np.asarray(cv2.GaussianBlur(white, (0, 0), _GRAIN_PX), np.float32)
    return grains * np.float32(math.sqrt(2.0) * _NOISE_MM * rng.uniform(0.7, 1.2) / grains.std())
