"""Samples of what is not a plain touch: a stretch without contact, and touches that are hard to read."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from pipeline.base.arrays import Doubles
from pipeline.geometry import rigid
from pipeline.sensors.parts import Glow
from pipeline.sensors.spec import SensorSpec, load_sensor
from pipeline.simulation import shapes
from sample_data.writing import PressFrame, write_recording

HOVER_MM = 20.0  # over the gels, out of reach of the bubble too
EXPOSURE_FACTOR = 1.6  # of the saturated frame, against a good one
TROUBLE_NOTES = (
    "simulated: a hexagon frame, which a turn by 60 degrees maps to itself: poses that differ by such a turn are equal",
    "frame 0: nothing touches",
    "frame 1: a slack contact, so light that the gel hardly shows it",
    "frame 2: deep; the bubble bridges the middle of the frame without touching it",
    "frame 3: the GelSlim is exposed too long, and many of its pixels are saturated",
    "frame 4: the contact reaches beyond the GelSlim's picture",
    "frames 5 and 6: the same press, turned by 60 degrees: no sensor can tell them apart but by its noise",
)


def make_no_contact(path: Path) -> None:
    """Three frames of every kind of sensor while an object hovers over them."""
    felt_by = tuple(load_sensor(name) for name in ("gelslim", "digit", "soft_bubble"))
    shots = [PressFrame(pose=rigid.translation(0.0, 0.0, HOVER_MM + k), sensors=felt_by) for k in range(3)]
    write_recording(path, shapes.make_shape("notched_elbow"), shots, ("simulated: nothing touches in any frame",))


def make_trouble(path: Path) -> None:
    """Seven frames of a GelSlim and a Soft Bubble, each with its own difficulty."""
    gel, bubble = load_sensor("gelslim"), load_sensor("soft_bubble")
    good, too_bright = (gel, bubble), (overexpose_sensor(gel), bubble)
    shots = (
        PressFrame(pose=rigid.translation(0.0, 0.0, HOVER_MM), sensors=good),
        PressFrame(pose=_held(-0.05), sensors=good),
        PressFrame(pose=_held(-1.0, x_mm=1.0), sensors=good),
        PressFrame(pose=_held(-0.6, x_mm=-1.0), sensors=too_bright),
        PressFrame(pose=_held(-0.6, x_mm=7.0, y_mm=-3.0, turn_deg=20.0), sensors=good),
        PressFrame(pose=_held(-0.6, turn_deg=10.0), sensors=good),
        PressFrame(pose=_held(-0.6, turn_deg=70.0), sensors=good),
    )
    write_recording(path, shapes.make_shape("hexagon"), shots, TROUBLE_NOTES)


def overexpose_sensor(spec: SensorSpec) -> SensorSpec:
    """The sensor with all of its light `EXPOSURE` times as strong."""
    optics = spec.optics
    assert optics is not None

    def brighter(rgb: tuple[float, float, float]) -> tuple[float, float, float]:
        return (EXPOSURE_FACTOR * rgb[0], EXPOSURE_FACTOR * rgb[1], EXPOSURE_FACTOR * rgb[2])

    glows: tuple[Glow, ...] = tuple(replace(glow, rgb=brighter(glow.rgb)) for glow in optics.glows)
    leds = tuple(replace(led, rgb=brighter(led.rgb)) for led in optics.leds)
    return replace(spec, optics=replace(optics, base_rgb=brighter(optics.base_rgb), leds=leds, glows=glows))


def _held(face_z_mm: float, *, x_mm: float = 0.0, y_mm: float = 0.0, turn_deg: float = 0.0) -> Doubles:
    return rigid.translation(x_mm, y_mm, face_z_mm) @ rigid.rotation((0.0, 0.0, np.deg2rad(turn_deg)))
