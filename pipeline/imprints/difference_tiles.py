"""Read difference tiles of a gel, as training sets store them: contrast-stretched, squeezed to squares, rotated.

What is left of the touch is where its ridges are. The described LEDs map colour to slope, up to one factor; the slopes
of a surface have no curl, and an indentation is sharper at its top than at its foot. So a tile alone determines its
orientation.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.base.arrays import Doubles, Floats, Image, freeze
from pipeline.base.errors import SettingProblem
from pipeline.imprints.image_rotation import ORIENTATIONS, orient_image, rotate_half_turn
from pipeline.sensors.spec import SensorSpec

_SMOOTHED_PX = 1.5
_RIDGE_PX = 2.5  # half the width of a ridge's top in a tile of 128 px
_BORDER_PX = 6  # differences at a tile's edge are the camera's
_FULL_QUANTILE = 99.5  # quantile of the ridges that counts as full contact
_FULL_SHARE = 0.6  # share of that from which contact is full


@dataclass(frozen=True, slots=True, kw_only=True)
class Ridges:
    """Contact of a gel as far as a tile shows it."""

    contact: Floats  # (rows, cols) 0..1
    orientation: int  # `orient_image(tile, orientation)` is as the sensor's camera sees it
    curl_free: float  # share of the slopes' energy that a surface explains
    next_best: float  # the same of the best orientation other than this or half a turn from it


def compute_colour_to_slope(spec: SensorSpec) -> Doubles:
    """Return (2, 3): change of colour to slope (right, down), up to one factor, from the described LEDs."""
    if spec.optics is None:
        raise SettingProblem(f"{spec.name} has no LEDs to estimate slopes from; it measures depth itself")
    colours = np.zeros((3, 2))
    for led in spec.optics.leds:
        angle = math.radians(led.azimuth_deg)
        colours -= np.outer(led.rgb, (math.cos(angle), math.sin(angle)))
    inverse = np.linalg.pinv(colours)
    return inverse / np.abs(inverse).max()


def detect_ridges(tile: Image, spec: SensorSpec, orientation: int | None = None) -> Ridges:
    """Detect the ridges of a tile (rows, cols, 3) in the camera's orientation; estimated if None."""
    matrix = compute_colour_to_slope(spec)
    explained = [_curl_free(*_slopes(orient_image(tile, k), matrix)) for k in ORIENTATIONS]
    best = int(np.argmax(explained)) if orientation is None else orientation
    if orientation is None and _skewness(_peaks(orient_image(tile, best), matrix)) < 0:
        best = rotate_half_turn(best)
    peaks = np.maximum(_peaks(orient_image(tile, best), matrix), 0.0)
    strongest = max(float(np.percentile(peaks, _FULL_QUANTILE)), 1e-9)
    others = [e for k, e in enumerate(explained) if k not in (best, rotate_half_turn(best))]
    contact = np.minimum(peaks / (strongest * _FULL_SHARE), 1.0).astype(np.float32)
    return Ridges(contact=freeze(contact), orientation=best,
                  curl_free=explained[best], next_best=max(others))  # fmt: skip


def _slopes(tile: NDArray[np.uint8], matrix: Doubles) -> tuple[Doubles, Doubles]:
    import cv2

    change = tile.astype(np.float64) - np.median(tile.reshape(-1, 3), axis=0)
    smooth = np.asarray(cv2.GaussianBlur(change, (0, 0), _SMOOTHED_PX)) @ matrix.T
    return smooth[..., 0], smooth[..., 1]


def _peaks(tile: NDArray[np.uint8], matrix: Doubles) -> Doubles:
    """Return the surface's curvature, highest on top of indentations; 0 at the tile's border."""
    import cv2

    gx, gy = (np.asarray(cv2.GaussianBlur(g, (0, 0), _RIDGE_PX - _SMOOTHED_PX + 1)) for g in _slopes(tile, matrix))
    bend = -(np.gradient(gx, axis=1) + np.gradient(gy, axis=0))
    inner = np.zeros_like(bend)
    inside = slice(_BORDER_PX, -_BORDER_PX)
    inner[inside, inside] = bend[inside, inside]
    return inner


def _skewness(values: Doubles) -> float:
    return float((values**3).mean() / max(float((values**2).mean()), 1e-12) ** 1.5)


def _curl_free(gx: Doubles, gy: Doubles) -> float:
    """Return the share of the slopes' energy that is the gradient of a surface, mirrored at the borders."""
    wide_x = np.block([[gx, -gx[:, ::-1]], [gx[::-1], -gx[::-1, ::-1]]])
    wide_y = np.block([[gy, gy[:, ::-1]], [-gy[::-1], -gy[::-1, ::-1]]])
    fx, fy = np.fft.fft2(wide_x), np.fft.fft2(wide_y)
    kx, ky = np.fft.fftfreq(wide_x.shape[1])[None, :], np.fft.fftfreq(wide_x.shape[0])[:, None]
    length_sq = kx**2 + ky**2
    length_sq[0, 0] = 1.0
    along = np.abs(kx * fx + ky * fy) ** 2 / length_sq
    return float(along.sum() / max(float((np.abs(fx) ** 2 + np.abs(fy) ** 2).sum()), 1e-12))
