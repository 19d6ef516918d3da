"""Does drifted light or a shifted camera look like a touch? Drifted reference images of every gel
sensor.

    python -m benchmarks.drift [METHOD]

METHOD is a method of the stage *depth* (default by sensor). Alone: 3 % more light and less; light
that rises by 12 grey levels from one border to the other, along x and along y; the camera 2 pixels
aside, along each axis and both, and 5 pixels aside; a spot of light 10 grey levels bright or dark,
small and large, white and tinted; JPEG of quality 70. Then random mixtures of them: every colour's
gain within 3 %, a ramp of up to 12 grey levels in any direction, of any colour, a shift of up to 2
pixels in any direction. Images are the simulated sensor's, and the untouched ones of a real Mini,
DIGIT and GelSlim 3.0 where they are at hand, each with fresh noise. The error is the number of
frames in which any pixel counts as contact. Last, objects are pressed under the same mixtures, so
that nobody reads "never a contact": the error is 1 - intersection over union with the true contact,
the baseline the same presses without drift.
"""

from __future__ import annotations

import sys
import time

import cv2
import numpy as np

from benchmarks.harness.results import BenchmarkResult
from benchmarks.harness.text_report import print_result
from benchmarks.harness.timing import Requirement, build_measurement, summarize_times
from benchmarks.scenes.depth_helpers import build_reader, picture, recorded_data
from pipeline.core.errors import FileProblem
from pipeline.core.geometry import rigid
from pipeline.core.values.frames import TactileFrame
from pipeline.physics import optics
from pipeline.physics.simulation import shapes
from pipeline.physics.simulation.press import simulate_press
from pipeline.sensors.spec import load_sensor
from pipeline.stages.metrics.stage_metrics import iou

_SENSORS = ("gelslim", "gelslim_dotless", "gelsight_mini", "digit")
_REAL = {
    "gelslim": "gelslim3_balls/ref.jpg",
    "gelsight_mini": "gsmini_balls/background.png",
    "digit": "digit_balls/background.png",
}
_GAIN = 0.03
_RAMP_GREY = 12.0
_SHIFT_PX = 2.0
_FAR_PX = 5.0
_SPOT_GREY = 10.0
_JPEG_QUALITY = 70
# place and width, shares of the longer side
_SPOTS = ((0.3, 0.3, 0.08), (0.6, 0.4, 0.15), (0.2, 0.6, 0.25))
_MIXTURES = 200
_PRESS_MM = 0.4
_LEVEL = (0.0, 0.0)


def apply_drift(
    image, *, gain=(1.0, 1.0, 1.0), ramp=_LEVEL, tint=(1.0, 1.0, 1.0), shift=_LEVEL, spot=None
):
    """The image (rows, cols, 3) with light times `gain` plus `ramp` grey levels across x and y,
    moved by `shift`.

    `spot` (x, y, width, grey levels): light of this `tint`, in shares of the longer side.
    """
    rows, cols = image.shape[:2]
    by = np.array([[1, 0, shift[0]], [0, 1, shift[1]]], np.float64)
    moved = cv2.warpAffine(
        image.astype(np.float32),
        by,
        (cols, rows),
        flags=cv2.INTER_CUBIC,
        borderMode=cv2.BORDER_REPLICATE,
    )
    y, x = np.mgrid[-0.5 : 0.5 : rows * 1j, -0.5 : 0.5 : cols * 1j]
    more = ramp[0] * x + ramp[1] * y
    if spot is not None:
        right = np.arange(cols) / max(rows, cols) - spot[0]
        down = np.arange(rows) / max(rows, cols) - spot[1]
        more = more + spot[3] * np.exp(-(right**2 + down[:, None] ** 2) / (2 * spot[2] ** 2))
    return moved * np.array(gain) + more[..., None] * np.array(tint)


def add_camera_noise(light, noise_grey: float, seed: int):
    """What 8 bits and the camera's noise make of it."""
    noise = np.random.default_rng(seed).normal(0.0, noise_grey, light.shape)
    return np.clip(np.rint(light + noise), 0, 255).astype(np.uint8)


def table():
    """Each kind of drift alone."""
    yield from ({"gain": (1 + gain,) * 3} for gain in (_GAIN, -_GAIN))
    for along in ((_RAMP_GREY, 0.0), (0.0, _RAMP_GREY)):
        yield {"ramp": along}
    for along in (
        (_SHIFT_PX, 0.0),
        (0.0, _SHIFT_PX),
        (-_SHIFT_PX, _SHIFT_PX),
        (_FAR_PX, 0.0),
        (3.0, -4.0),
    ):
        yield {"shift": along}
    for spot in _SPOTS:
        for grey, tint in (
            (_SPOT_GREY, (1.0, 1.0, 1.0)),
            (-_SPOT_GREY, (1.0, 1.0, 1.0)),
            (_SPOT_GREY, (1.0, 0.3, 0.6)),
        ):
            yield {"spot": (*spot, grey), "tint": tint}
    yield {"jpeg": True}


def mixture(rng):
    def direction(length):
        angle = rng.uniform(0, 2 * np.pi)
        far = rng.uniform(0, length)
        return far * np.cos(angle), far * np.sin(angle)

    return {
        "gain": 1 + rng.uniform(-_GAIN, _GAIN, 3),
        "ramp": direction(_RAMP_GREY),
        "tint": rng.uniform(0, 1, 3),
        "shift": direction(_SHIFT_PX),
    }


def render_reference_images():
    """(label, sensor, reference image)."""
    for name in _SENSORS:
        yield name, load_sensor(name), optics.render_reference(load_sensor(name))
    try:
        data = recorded_data()
    except FileProblem:
        return
    for name, file in _REAL.items():
        yield f"real {name}", load_sensor(name), picture(data / file)


def compress(image):
    """What JPEG makes of an image (rows, cols, 3)."""
    _, coded = cv2.imencode(".jpg", image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
    return np.ascontiguousarray(cv2.imdecode(coded, cv2.IMREAD_COLOR)[..., ::-1])


def measure_after_drift(read, source, still, light, seed, *, jpeg=False):
    """(depth map, ms) of an image made of `light`."""
    image = add_camera_noise(light, source.optics.noise_grey, seed)
    frame = TactileFrame(
        sensor=source.name, image=compress(image) if jpeg else image, reference=still
    )
    started = time.perf_counter()
    answer = read(frame, source)
    return answer, 1e3 * (time.perf_counter() - started)


def false_contacts(read, label, source, still, drifts):
    found = []
    for k, how in enumerate(drifts):
        changes = {name: value for name, value in how.items() if name != "jpeg"}
        light = apply_drift(still, **changes)
        found.append(measure_after_drift(read, source, still, light, k, jpeg="jpeg" in how))
    pixels = np.array([answer.contact.sum() for answer, _ in found])
    deepest = max(float(answer.indentation_mm.max()) for answer, _ in found)
    found_row = build_measurement(
        f"untouched, {label}",
        ours=summarize_times([ms for _, ms in found]),
        ours_error=float((pixels > 0).sum()),
        unit="frames",
        bar=Requirement(max_error=0),
    )
    return found_row, (
        f"{label}: {len(found)} frames, at most {pixels.max()} pixels of contact, "
        f"deepest {deepest:.3f} mm"
    )


def through_drift(read, rng):
    """Rows of presses under mixtures, next to the same without."""
    for name in _SENSORS:
        source = load_sensor(name)
        found = []
        still = optics.render_reference(source)
        for seed, thing in enumerate(
            shapes.make_shape(n).mesh for n in shapes.list_shapes("unseen")
        ):
            turn = rigid.rotation((0, 0, 0.4 * seed))
            turn[2, 3] = -_PRESS_MM - rigid.apply(turn, thing.vertices_mm)[:, 2].min()
            touched = simulate_press(thing, turn, source, seed=None)
            plain, _ = measure_after_drift(
                read, source, still, touched.image.astype(np.float32), seed
            )
            answer, ms = measure_after_drift(
                read, source, still, apply_drift(touched.image, **mixture(rng)), seed
            )
            found.append(
                (
                    1 - iou(answer.contact, touched.truth.contact),
                    1 - iou(plain.contact, touched.truth.contact),
                    ms,
                )
            )
        ours, plain, ms = np.array(found).T
        yield build_measurement(
            f"pressed by {_PRESS_MM:g} mm, {name}",
            peer="without drift",
            ours=summarize_times(ms),
            peer_timing=summarize_times(ms),
            ours_error=float(ours.mean()),
            peer_error=float(plain.mean()),
            unit="1 - IoU",
            bar=Requirement(min_error_ratio=0.8),
        )


def measure(method: str = "") -> BenchmarkResult:
    read = build_reader(method)
    rng = np.random.default_rng(0)
    every = list(render_reference_images())
    found = [
        false_contacts(read, f"each drift, {label}", source, still, table())
        for label, source, still in every
    ]
    each = -(-_MIXTURES // len(every))
    found += [
        false_contacts(
            read, f"random mixtures, {label}", source, still, [mixture(rng) for _ in range(each)]
        )
        for label, source, still in every
    ]
    return BenchmarkResult(
        title=f"Contact that drift makes up, by {method}",
        unit="frames",
        rows=(*(r for r, _ in found), *through_drift(read, rng)),
        notes=tuple(note for _, note in found),
    )


if __name__ == "__main__":
    print_result(measure(*sys.argv[1:2]))
