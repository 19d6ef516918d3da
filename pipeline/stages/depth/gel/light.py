"""Node *light*: the illumination of a frame, from its image, its rest image and the context frames
of the recording.

It depends on nothing else: settings of the stage are at their defaults, so that a slider does not
change the light. That of a recording is cached on disk, as its fit takes as long as several frames.
"""

from dataclasses import replace
from typing import cast

from pipeline.calibration.calibration_table import make_built_in
from pipeline.core import disk_store
from pipeline.core.arrays import Image
from pipeline.core.digests import compute_cached_digest
from pipeline.core.errors import StageWarning
from pipeline.core.memo import Memo
from pipeline.core.params import NoParams
from pipeline.core.progress import Progress
from pipeline.core.values.frames import TactileFrame
from pipeline.stages.depth.gel.change import FrameChange, observe_change
from pipeline.stages.depth.gel.rest import RestState
from pipeline.stages.depth.gel.settings import LIGHT
from pipeline.stages.depth.gel.slopes import ChangedImage, make_changed_image
from pipeline.stages.depth.illumination import selection
from pipeline.stages.depth.illumination.light import FrameLight, Illumination, ImagePatch
from pipeline.stages.depth.poisson import Integrator

_NOT_COVERED = StageWarning(
    "no indentation of the calibration covers this touch: it is measured without calibration"
)
_CODE = (
    "pipeline.stages.depth",
    "pipeline.stages.depth.gel",
    "pipeline.stages.depth.illumination",
    "pipeline.calibration",
    "pipeline.physics",
    "pipeline.sensors",
)
_recordings: Memo[tuple[str, ...], Illumination] = Memo(8)


def estimate_light(
    frame: TactileFrame, rest: RestState, change: FrameChange, _params: NoParams, progress: Progress
) -> FrameLight:
    """The illumination of a frame: chosen by several context frames, else by the frame itself.

    None where the calibration table was fitted to presses, and some of them cover the touch.
    """
    progress.step(0.0, "estimating the light")
    image = cast("Image", frame.image)
    notes = tuple[str, ...]()
    if not rest.uses_illumination:
        window = make_changed_image(image, rest, change, rest.calibration).window
        if rest.calibration.covers(window.changed, (window.rows.start, window.cols.start)):
            return FrameLight(illumination=None, calibration=rest.calibration)
        described = replace(make_built_in(rest.source), pixel_mm=rest.pixel_mm)
        rest = replace(rest, calibration=described)
        notes = (_NOT_COVERED,)
    reference = cast("Image", frame.reference)
    model = choose_for_recording(frame.context_frames, reference, rest, progress)

    def observe() -> selection.Touch:
        return make_touch(make_changed_image(image, rest, change, rest.calibration), progress)

    if model is None:
        model = selection.choose_illumination([observe()])
    elif model.model == "field":
        dent_mm = change.press.dent_mm
        model = selection.adapt_field(model, dent_mm, rest.source, rest.pixel_mm, observe)
    if model.is_fitted_leds:
        n = len(frame.context_frames)
        to = f"{n} touches of the recording" if model.from_context else "this touch"
        notes = (*notes, f"measured with this sensor's LEDs, fitted to {to}")
    return FrameLight(illumination=model, calibration=rest.calibration, notes=notes)


def choose_for_recording(
    images: tuple[Image, ...], reference: Image, rest: RestState, progress: Progress
) -> Illumination | None:
    """The light of the sensor instance, chosen by several touches (rows, cols, 3) of one recording.

    None for fewer.
    """
    if len(images) < LIGHT.min_context_touches:
        return None
    source = rest.source
    calibration = rest.calibration
    made_of = (
        compute_cached_digest(images),
        compute_cached_digest(reference),
        compute_cached_digest(source),
        compute_cached_digest(calibration),
    )

    def choose() -> Illumination:
        touches = [find_touch(image, reference, rest, progress) for image in images]
        found = [touch for touch in touches if touch is not None]
        if len(found) < LIGHT.min_context_touches:
            return selection.DESCRIBED
        return selection.choose_for_recording(found) or selection.DESCRIBED

    chosen = _recordings.get_or_make(
        made_of, lambda: disk_store.load_or_make(Illumination, made_of, _CODE, choose, "led_fits")
    )
    return chosen if chosen.from_context else None


def find_touch(
    image: Image, reference: Image, rest: RestState, progress: Progress
) -> selection.Touch | None:
    """The touch of an image (rows, cols, 3) on the refinement grid.

    None where its light is not needed.
    """
    change = observe_change(image, reference, rest)
    if change.press.verdict != "press" or change.press.is_smooth:
        return None
    return make_touch(make_changed_image(image, rest, change, rest.calibration), progress)


def make_touch(changed: ChangedImage, progress: Progress) -> selection.Touch:
    """A press on the refinement grid."""
    _, cells = changed.patches

    def make_integrator(patch: ImagePatch) -> Integrator:
        return changed.make_integrator(patch, progress, 0.3)

    guess_mm = changed.guess_surface(cells, make_integrator(cells))
    return selection.Touch(
        guess_mm=guess_mm, patch=cells, source=changed.source, make_integrator=make_integrator
    )
