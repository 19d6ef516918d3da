"""One touch as both sensors observed it: what an alignment is scored on and refined with."""

from collections.abc import Iterable

import numpy as np

from pipeline.core.arrays import Doubles
from pipeline.core.errors import SettingProblem
from pipeline.core.frozen import frozen
from pipeline.core.progress import SILENT, Progress
from pipeline.core.values.frames import TactileFrame, Truth
from pipeline.core.values.results import DepthMap, make_depth_map
from pipeline.sensors.alignment import Alignment, shift_alignment_along_z
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.depth.photometric import DepthParams, estimate_depth
from pipeline.translation.alignment.nudge import compute_pivot_mm
from pipeline.translation.translate import Translation, estimate_camera_shift_mm


@frozen
class AlignmentTouch:
    """One moment: the source's depth map and the target's, each in its own camera frame."""

    index: int
    source: DepthMap
    target: DepthMap
    source_shift_mm: float = 0.0  # `translate.estimate_camera_shift_mm` of either side
    target_shift_mm: float = 0.0

    def apply_instance_shifts(self, alignment: Alignment) -> Alignment:
        """Return the alignment between the sensor instances that recorded this touch."""
        return shift_alignment_along_z(
            alignment, source_shift_mm=self.source_shift_mm, target_shift_mm=self.target_shift_mm
        )

    @property
    def has_contact_on_both(self) -> bool:
        """Return whether both sensors have contact."""
        return bool(self.source.contact.any()) and bool(self.target.contact.any())


def find_pivot(touch: AlignmentTouch, alignment: Alignment) -> Doubles:
    """Return the contact's centroid (3,) in the described target frame: the pivot of rotations."""
    return compute_pivot_mm(
        touch.source,
        shift_alignment_along_z(
            alignment, source_shift_mm=touch.source_shift_mm, target_shift_mm=0.0
        ),
    )


def load_paired_touch(
    translation: Translation, index: int, params: DepthParams | None = None, *, exact: bool = False
) -> AlignmentTouch:
    """Load frame `index` of both sensors through the depth stage, or (`exact`) from the recording's
    ground truth.

    Raises SettingProblem when the target did not record, or when ground truth is requested and
    unknown; FileProblem for a damaged frame.
    """
    params = params or DepthParams()
    other = translation.read_target_observation(translation.check_index(index))
    if other is None:
        raise SettingProblem(
            f"{translation.target.name} recorded no frame {index} here; "
            f"scoring an alignment needs a recording of both sensors"
        )
    frame, (target_frame, target_truth) = translation.stream.frame(index), other
    if exact:
        source = _make_exact(frame, translation.source, translation.read_source_truth(index))
        target = _make_exact(target_frame, translation.target, target_truth)
    else:
        source = estimate_depth(frame, translation.source, translation.calibration, params)
        target = estimate_depth(target_frame, translation.target, None, params)
    return AlignmentTouch(
        index=index,
        source=source,
        target=target,
        source_shift_mm=estimate_camera_shift_mm(frame, translation.source),
        target_shift_mm=estimate_camera_shift_mm(target_frame, translation.target),
    )


def load_paired_touches(
    translation: Translation,
    indices: Iterable[int],
    params: DepthParams | None = None,
    *,
    exact: bool = False,
    progress: Progress = SILENT,
) -> tuple[AlignmentTouch, ...]:
    """Load the frames with contact on both sensors, in order.

    Raises like `load_paired_touch`, and where there is none.

    Frames at whose time the target recorded none are left out, unless all are.
    """
    asked = tuple(indices)
    wanted = translation.select_paired(asked) or asked[:1]
    touches: list[AlignmentTouch] = []
    for done, index in enumerate(wanted):
        progress.step(done / len(wanted), f"depth of frame {index} on both sides")
        touch = load_paired_touch(translation, index, params, exact=exact)
        if touch.has_contact_on_both:
            touches.append(touch)
    if not touches:
        raise SettingProblem(
            f"none of the {len(asked)} frames has contact on both {translation.source.name} and "
            f"{translation.target.name}; choose other frames"
        )
    return tuple(touches)


def _make_exact(frame: TactileFrame, spec: SensorSpec, truth: Truth | None) -> DepthMap:
    if truth is None or truth.indentation_mm is None or truth.contact is None:
        raise SettingProblem(
            f"the ground truth of frame {frame.index} of {spec.name} is not known; use the depth "
            "stage"
        )
    camera = frame.camera or spec.camera
    rest = spec.rest_depth_mm if camera == spec.camera else spec.membrane.rest_depth_mm(camera)
    if frame.is_depth and frame.reference is not None and frame.camera is not None:
        rest = np.asarray(frame.reference, np.float64)
    return make_depth_map(rest, truth.indentation_mm, truth.contact, camera)
