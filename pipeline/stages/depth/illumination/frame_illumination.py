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
from pipeline.stages.depth.illumination.constants import CONSTANTS
from pipeline.stages.depth.illumination.gel_surface import ChangedImage, detect_changed_image, uses_illumination
from pipeline.stages.depth.illumination.light import Illumination, ImagePatch
from pipeline.stages.depth.illumination.parameter_fit import LedObservation, fit_leds
from pipeline.stages.depth.illumination.surface_refinement import refine_surface
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
    """The illumination of a gel's frame: fitted to several context frames, else to the frame itself.

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
        of_recording = fit_recording(frame.context_frames, reference, source, calibration, progress)
        if of_recording is not None:
            return of_recording
        changed = detect_changed_image(image, reference, source, calibration, frame.context_frames)
        if changed is None:
            return selection.DESCRIBED
        _, cells = changed.patches
        integrate = changed.make_integrator(cells, progress, 0.3)
        return selection.choose_illumination(
            changed.guess_surface(cells, integrate), cells, source,
            lambda patch: changed.make_integrator(patch, progress, 0.3),
        )  # fmt: skip

    return _cache.get_or_make(keys, estimate)


def fit_recording(
    touches: tuple[Image, ...], reference: Image, source: SensorSpec, calibration: Calibration, progress: Progress
) -> Illumination | None:
    """LEDs of the sensor instance, fitted to several touches (rows, cols, 3) of one recording.

    None for less than two touches, and where no usual instance explains them.
    """
    if len(touches) < _MIN_CONTEXT_TOUCHES:
        return None
    made_of = (
        compute_cached_digest(touches),
        compute_cached_digest(reference),
        compute_cached_digest(source),
        compute_cached_digest(calibration),
    )

    def fit() -> Illumination:
        changed = [detect_changed_image(image, reference, source, calibration, touches) for image in touches]
        observations = [observe_leds(one, progress) for one in changed if one is not None]
        if len(observations) < _MIN_CONTEXT_TOUCHES:
            return selection.DESCRIBED
        leds = selection.pack_leds("leds", fit_leds(source, observations))
        return selection.DESCRIBED if leds is None else replace(leds, from_context=True)

    found = _recordings.get_or_make(
        made_of, lambda: disk_store.load_or_make(Illumination, made_of, _CODE, fit, "led_fits")
    )
    return found if found.model == "leds" else None


def observe_leds(changed: ChangedImage, progress: Progress) -> LedObservation:
    """What one touch contributes to the LED fit of its recording."""
    _, cells = changed.patches

    def make_integrator(patch: ImagePatch) -> Integrator:
        return changed.make_integrator(patch, progress)

    integrate = make_integrator(cells)
    plain = selection.make_light(selection.DESCRIBED, cells, changed.source)
    guess = changed.guess_surface(cells, integrate)
    surface, _ = refine_surface(guess, cells, plain, integrate, CONSTANTS.iterations)
    return selection.make_led_observation(surface, cells, changed.source, make_integrator)
