"""Extrapolate contact beyond a gel's view: ridges that reach the image border continue straight."""

from dataclasses import dataclass

import numpy as np

from pipeline.base.arrays import Doubles, Floats

_INSET = 0.047  # share of the side between the image border and the line on which ridges are detected
_MIN_CONTACT = 0.28  # contact for a ridge to count there
_MIN_DISTANCE = 0.09  # shares of the side between two ridges
_BASELINE, _MIN_LENGTH = (
    0.35,
    0.14,
)  # shares of the side over which a ridge's direction is measured, and must be visible
_STEP_DEG = 1.5
_FULL_CONTACT = 0.75  # contact from which a ridge continues at full strength
_MIN_MEAN = 0.3  # mean contact along a ridge


@dataclass(frozen=True, slots=True, kw_only=True)
class BoundaryRidges:
    """Ridges that reach the image border: (n,) each, in pixels, directions outward."""

    x_px: Doubles
    y_px: Doubles
    right: Doubles
    down: Doubles
    strength: Doubles  # 0..1


def detect_boundary_ridges(contact: Floats) -> BoundaryRidges:
    """Detect the ridges that leave a contact image (rows, cols); each direction has the most contact behind it."""
    import cv2

    smooth = np.asarray(cv2.GaussianBlur(contact, (0, 0), max(1.0, 0.012 * max(contact.shape))), np.float32)
    x, y = _frame(contact.shape)
    profile = _sample(smooth, x, y)
    apart = round(_MIN_DISTANCE * float(np.mean(contact.shape)))
    taken = np.zeros(len(profile), np.bool_)
    found: list[tuple[float, ...]] = []
    for k in np.argsort(-profile):
        if profile[k] < _MIN_CONTACT:
            break
        if taken[k]:
            continue
        taken[np.arange(k - apart, k + apart + 1) % len(profile)] = True
        right, down, clear = _inward(smooth, float(x[k]), float(y[k]))
        if clear > _MIN_MEAN:
            found.append((float(x[k]), float(y[k]), -right, -down, min(1.0, float(profile[k]) / _FULL_CONTACT)))
    table = np.array(found, np.float64).reshape(-1, 5).T
    return BoundaryRidges(x_px=table[0], y_px=table[1], right=table[2], down=table[3], strength=table[4])


def _inward(smooth: Floats, x_px: float, y_px: float) -> tuple[float, float, float]:
    """Return (right, down, mean contact along it) of the ridge that ends at a point of the frame, looking inward."""
    rows, cols = smooth.shape
    side, inset = float(np.mean(smooth.shape)), _INSET * float(np.mean(smooth.shape))
    angles = np.deg2rad(np.arange(0.0, 360.0, _STEP_DEG))
    along = np.arange(0.0, _BASELINE * side)
    xs = x_px + along * np.cos(angles)[:, None]
    ys = y_px + along * np.sin(angles)[:, None]
    inside = (xs >= inset - 1) & (xs <= cols - inset) & (ys >= inset - 1) & (ys <= rows - inset)
    passed = _sample(smooth, xs.ravel(), ys.ravel()).reshape(xs.shape) * inside
    n = inside.sum(axis=1)
    mean = np.where(n >= _MIN_LENGTH * side, passed.sum(axis=1) / np.maximum(n, len(along)), -1.0)
    best = int(np.argmax(mean))
    near = np.arange(best - 4, best + 5) % len(angles)
    turn = complex((np.maximum(mean[near], 0.0) ** 8 * np.exp(1j * angles[near])).sum())
    length = max(abs(turn), 1e-30)
    return turn.real / length, turn.imag / length, float(mean[best])


def _frame(shape: tuple[int, ...]) -> tuple[Doubles, Doubles]:
    """Return (x, y) of the pixels of a frame a little within the image, once around."""
    rows, cols = shape
    inset = round(_INSET * float(np.mean(shape)))
    x = np.arange(inset, cols - inset, dtype=np.float64)
    y = np.arange(inset, rows - inset, dtype=np.float64)
    left, right, top, bottom = float(inset), float(cols - 1 - inset), float(inset), float(rows - 1 - inset)
    return (
        np.concatenate([x, np.full(len(y), right), x[::-1], np.full(len(y), left)]),
        np.concatenate([np.full(len(x), top), y, np.full(len(x), bottom), y[::-1]]),
    )


def _sample(image: Floats, x_px: Doubles, y_px: Doubles) -> Doubles:
    import cv2

    there = (x_px.astype(np.float32).reshape(1, -1), y_px.astype(np.float32).reshape(1, -1))
    return np.asarray(cv2.remap(image, *there, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT), np.float64).ravel()
