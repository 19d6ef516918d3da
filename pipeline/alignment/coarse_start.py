"""Initial alignments from pairs of imprints, or from a grid search in the plane: outlines have many local minima."""

from collections.abc import Iterator, Sequence

import numpy as np

from pipeline.alignment.normal_equations import ResidualNoise, compute_cost, compute_touch_distances
from pipeline.alignment.residuals import Evidence, thin_points
from pipeline.alignment.touches import AlignmentTouch
from pipeline.base.arrays import Doubles, Floats, freeze
from pipeline.base.errors import SettingProblem
from pipeline.base.progress import Progress
from pipeline.geometry import rigid
from pipeline.geometry.camera import Camera
from pipeline.imprints.tiles import ImprintPairs, check_pairing
from pipeline.imprints.transfer import ImprintPair, TransferModel
from pipeline.sensors.alignment import Alignment, compose_motion
from pipeline.sensors.spec import SensorSpec
from pipeline.values.results import DepthMap


def make_touch_pairs(touches: Sequence[AlignmentTouch]) -> ImprintPairs:
    """Make pairs of the moments with contact on both sensors, in millimetres on either rest surface."""
    made = tuple(_touch(t) for t in touches if t.has_contact_on_both)
    return ImprintPairs(
        pairs=made, notes=(f"{len(made)} of {len(touches)} moments have contact on both sensors", *check_pairing(made))
    )


def compute_pixel_mm(depth: DepthMap) -> float:
    """Return the width of a pixel at the median depth."""
    seen = depth.depth_mm[np.isfinite(depth.depth_mm)]
    return float(np.median(seen)) / depth.camera.fx_px


def _touch(touch: AlignmentTouch) -> ImprintPair:
    def size(depth: DepthMap) -> tuple[float, float]:
        return depth.camera.cols * compute_pixel_mm(depth), depth.camera.rows * compute_pixel_mm(depth)

    imprint: Floats = np.nan_to_num(touch.target.indentation_mm).astype(np.float32)
    return ImprintPair(name=str(touch.index), contact=freeze(touch.source.contact.astype(np.float32)), is_metric=True,
                source_size=size(touch.source), imprint=freeze(imprint), target_size=size(touch.target))  # fmt: skip


COMPARISON_NOISE = ResidualNoise(surface_mm=0.2, outline_mm=0.4)  # fixed, so that costs of different alignments compare
COMPARISON_SCALE = ResidualNoise(surface_mm=1.0, outline_mm=2.0)
_SHIFTS_MM = np.arange(-4.0, 4.5, 1.0)
_TURNS_DEG = np.arange(-8.0, 8.5, 4.0)
_TOUCHES = 4  # touches compared, spread over all
_POINTS = 80  # points of each kind
_APART_MM = 1.5  # starts nearer than this, and within one rotation step, converge alike


def list_initial_alignments(
    touches: Sequence[Evidence], start: Doubles, pivot_mm: Doubles, many: int, progress: Progress
) -> list[Doubles]:
    """Return motions (4, 4) to apply after `start`: the identity first, then the `many` best distinct ones of a grid.

    The grid spans 4 mm and 8 deg in the plane normal to the source's optical axis; after each translation the surfaces
    are brought together along that axis, because a wrong translation mostly shifts depth.
    """
    few = [thin_points(t, _POINTS) for t in touches[:: max(1, -(-len(touches) // _TOUCHES))]]
    x, y, normal = start[:3, :3].T
    ranked: list[tuple[float, int, float, float, Doubles]] = []
    for n, (right, down, turn) in enumerate(_grid()):
        if n % 50 == 0:
            progress.step(0.0, "searching for an initial alignment")
        motion = compose_motion(pivot_mm, np.deg2rad(turn) * normal, right * x + down * y)
        motion = rigid.translation(*(_lift_mm(few, motion @ start) * normal)) @ motion
        ranked.append((compute_cost(few, motion @ start, COMPARISON_NOISE, COMPARISON_SCALE), n, right, down, motion))
    chosen: list[tuple[float, float]] = []
    found = [np.eye(4)]
    for _, _, right, down, motion in sorted(ranked, key=lambda entry: entry[:2]):
        if all(np.hypot(right - a, down - b) >= _APART_MM for a, b in chosen):
            chosen.append((right, down))
            found.append(motion)
        if len(found) > many:
            break
    return found


def _grid() -> Iterator[tuple[float, float, float]]:
    for turn in _TURNS_DEG:
        for right in _SHIFTS_MM:
            for down in _SHIFTS_MM:
                yield float(right), float(down), float(turn)


def _lift_mm(touches: Sequence[Evidence], target_from_source: Doubles) -> float:
    """Return the translation (mm) along the source's axis that closes the gap between the surfaces."""
    normal = target_from_source[:3, 2]
    surfaces = [one.surface for one in compute_touch_distances(touches, target_from_source)]
    found = [s.mm / (s.jacobian @ normal) for s in surfaces if s.mm.size]
    return -float(np.median(np.concatenate(found))) if found else 0.0


def align_rigidly(touches: Sequence[AlignmentTouch], how: TransferModel, described: Alignment) -> Alignment:
    """Return the alignment with the in-plane motion of `how` and matching contact depths, stored on the target's side.

    Raises SettingProblem for a mirrored model, which is no rigid motion.
    """
    turn = _get_rotation(how)
    middles = [np.median([_middle_mm(d) for d in side], axis=0) for side in
               ([t.source for t in touches], [t.target for t in touches])]  # fmt: skip
    shift = np.array([how.right, how.down, 0.0]) + middles[1] - turn @ middles[0]
    shift[2] = float(np.median([_contact_z(t.target) + t.target_shift_mm - _contact_z(t.source) - t.source_shift_mm
                                for t in touches]))  # fmt: skip
    target_from_source = np.eye(4)
    target_from_source[:3, :3], target_from_source[:3, 3] = turn, shift
    onward = target_from_source @ rigid.invert(described.alignment_from_source)
    return Alignment(alignment_from_source=described.alignment_from_source, target_from_alignment=freeze(onward))


def align_tiles(how: TransferModel, source: SensorSpec, target: SensorSpec, described: Alignment) -> Alignment:
    """Return the alignment with the in-plane motion of a model in tile widths; tiles show both sensors' whole views.

    Distance and tilt are those of `described`. Raises SettingProblem for a mirrored model, which is no rigid motion.
    """
    turn = _get_rotation(how)
    rest_mm = float(np.median(source.rest_depth_mm))
    middle = find_view_middle(source.camera, rest_mm)
    z_mm = float((described.target_from_source @ np.append(middle, 1.0))[2])
    camera = target.camera
    moved = np.array([how.right * camera.cols / camera.fx_px, how.down * camera.rows / camera.fy_px, 0.0]) * z_mm
    target_from_source = np.eye(4)
    target_from_source[:3, :3] = turn
    target_from_source[:3, 3] = find_view_middle(camera, z_mm) + moved - turn @ middle
    onward = target_from_source @ rigid.invert(described.alignment_from_source)
    return Alignment(alignment_from_source=described.alignment_from_source, target_from_alignment=freeze(onward))


def compute_described_scale(source: SensorSpec, target: SensorSpec, described: Alignment) -> float:
    """Return the width of the source's view over that of the target's, where both see the source's rest surface."""
    rest_mm = float(np.median(source.rest_depth_mm))
    middle = find_view_middle(source.camera, rest_mm)
    z_mm = float((described.target_from_source @ np.append(middle, 1.0))[2])
    widths = [camera.cols * z / camera.fx_px for camera, z in ((source.camera, rest_mm), (target.camera, z_mm))]
    return widths[0] / widths[1]


def find_view_middle(camera: Camera, z_mm: float) -> Doubles:
    """Return the point (3,) in mm at the image's centre at depth `z_mm`."""
    x_px, y_px = (camera.cols - 1) / 2 - camera.cx_px, (camera.rows - 1) / 2 - camera.cy_px
    return np.array([x_px * z_mm / camera.fx_px, y_px * z_mm / camera.fy_px, z_mm])


def _get_rotation(how: TransferModel) -> Doubles:
    """Return the rotation (3, 3) about the optical axis; raises SettingProblem for a mirrored model."""
    if how.is_mirrored:
        raise SettingProblem(
            "the images of the two sensors agree only when one is mirrored; flip one sensor's images and try again"
        )
    cos, sin = np.cos(how.rotation_rad), np.sin(how.rotation_rad)
    return np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])


def _middle_mm(depth: DepthMap) -> Doubles:
    """Return the image centre's offset (mm) from the optical axis, (3,) with z = 0."""
    camera = depth.camera
    off_px = np.array([(camera.cols - 1) / 2 - camera.cx_px, (camera.rows - 1) / 2 - camera.cy_px, 0.0])
    return off_px * compute_pixel_mm(depth)


def _contact_z(depth: DepthMap) -> float:
    return float(np.nanmedian(depth.depth_mm[depth.contact]))
