"""The illumination of a frame, from what the frame holds: its image, its reference and its context frames.

The illumination depends on nothing else: settings of the depth stage are at their defaults, so that a draft and a full
result of one frame rest on the same light, whichever comes first. It is cached by content. LEDs of a recording are
cached on disk as well, as their fit takes as long as several frames.
"""

from dataclasses import replace
from typing import cast

from pipeline.base.arrays import Image
from pipeline.base.memo import Memo
from pipeline.base.progress import Progress
from pipeline.calibration.calibration_table import Calibration
from pipeline.engine import disk_store
from pipeline.engine.digests import compute_cached_digest
from pipeline.sensors.spec import SensorSpec
from pipeline.stages.depth.illumination import selection
from pipeline.stages.depth.illumination.gel_surface import detect_changed_image, uses_illumination
from pipeline.stages.depth.illumination.light import Illumination, ImagePatch
from pipeline.stages.depth.poisson import Integrator
from pipeline.values.frames import TactileFrame

_MIN_CONTEXT_TOUCHES = 2  # one tells no more than the frame itself
_CODE = (
    "pipeline.stages.depth", "pipeline.stages.depth.gel", "pipeline.stages.depth.illumination", "pipeline.calibration",
    "pipeline.physics", "pipeline.sensors",
)  # fmt: skip
_cache: Memo[tuple[str, ...], Illumination] = Memo(1024)  # illuminations of frames, up to a few kilobytes each
_recordings: Memo[tuple[str, ...], Illumination] = Memo(8)


def estimate_illumination(
    frame: TactileFrame, source: SensorSpec, calibration: Calibration, progress: Progress
) -> Illumination:
    """The illumination of a gel's frame: chosen by several context frames, else by the frame itself.

    The described light where nothing has changed, and where the calibration table was fitted to indentations.
    """
    if not uses_illumination(source, calibration) or frame.reference is None:
        return selection.DESCRIBED
    image, reference = cast("Image", frame.image), cast("Image", frame.reference)
    keys = (
        compute_cached_digest(image),
        compute_cached_digest(reference),
        compute_cached_digest(frame.context_frames),
        compute_cached_digest(source),
        compute_cached_digest(calibration),
    )

    def estimate() -> Illumination:
        model = choose_for_recording(frame.context_frames, reference, source, calibration, progress)
        if model is not None and model.is_complete:
            return model
        touch = find_touch(image, reference, source, calibration, frame.context_frames, progress)
        if touch is None:
            return selection.DESCRIBED
        return selection.choose_illumination([touch]) if model is None else selection.fit_touch(model.model, touch)

    return _cache.get_or_make(keys, estimate)


def choose_for_recording(
    images: tuple[Image, ...], reference: Image, source: SensorSpec, calibration: Calibration, progress: Progress
) -> Illumination | None:
    """The light of the sensor instance, chosen by several touches (rows, cols, 3) of one recording; None for fewer."""
    if len(images) < _MIN_CONTEXT_TOUCHES:
        return None
    made_of = (
        compute_cached_digest(images),
        compute_cached_digest(reference),
        compute_cached_digest(source),
        compute_cached_digest(calibration),
    )

    def choose() -> Illumination:
        touches = [find_touch(image, reference, source, calibration, images, progress) for image in images]
        found = [touch for touch in touches if touch is not None]
        if len(found) < _MIN_CONTEXT_TOUCHES:
            return selection.DESCRIBED
        light = selection.choose_illumination(found)
        # Cast shadows differ from press to press by more than one choice allows: simulated recordings of a DIGIT,
        # .8 mm deep, err by 52 um in place of 47.
        holds = light.model == "leds" or not selection.casts_shadows(source)
        return replace(light, from_context=True) if holds else selection.DESCRIBED

    chosen = _recordings.get_or_make(
        made_of, lambda: disk_store.load_or_make(Illumination, made_of, _CODE, choose, "led_fits")
    )
    return chosen if chosen.from_context else None


def find_touch(
    image: Image, reference: Image, source: SensorSpec, calibration: Calibration, touches: tuple[Image, ...],
    progress: Progress,
) -> selection.Touch | None:  # fmt: skip
    """The touch of an image (rows, cols, 3) on the refinement grid; None where its light is not needed."""
    changed = detect_changed_image(image, reference, source, calibration, touches)
    if changed is None:
        return None
    _, cells = changed.patches

    def make_integrator(patch: ImagePatch) -> Integrator:
        return changed.make_integrator(patch, progress, 0.3)

    guess_mm = changed.guess_surface(cells, make_integrator(cells))
    return selection.Touch(guess_mm=guess_mm, patch=cells, source=source, make_integrator=make_integrator)
