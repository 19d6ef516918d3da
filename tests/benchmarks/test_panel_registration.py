"""Whether a depth that lies in another frame than its touch is laid back on it."""

from __future__ import annotations

import cv2
import numpy as np

from benchmarks.scenes import panel_registration

SHAPE = (68, 90)


def clip(lay, seed):
    """Touches of rectangles and their depths, which lie elsewhere: (pictures, depths)."""
    rng = np.random.default_rng(seed)
    pictures = []
    depths = []
    for _ in range(6):
        depth = np.zeros(SHAPE, np.float32)
        x, y, wide, tall = (int(v) for v in rng.integers((22, 18, 12, 10), (50, 40, 30, 22)))
        cv2.rectangle(depth, (x, y), (x + wide, y + tall), 80.0, -1)
        depth = cv2.GaussianBlur(depth, (0, 0), 1.5)
        there, _ = lay.warp(depth)
        change = np.hypot(*np.gradient(there))[..., None] * (1.0, 0.6, 0.3)
        pictures.append((100 + change + rng.normal(0, 1, (*SHAPE, 3))).astype(np.float32))
        depths.append(depth)
    return pictures, depths


def test_a_depth_shown_larger_and_aside_is_laid_on_its_touch():
    true = panel_registration.PanelMap(scale_x=1.5, scale_y=1.3, shift_x_px=4.0, shift_y_px=-3.0)
    still = np.full((*SHAPE, 3), 100.0, np.float32)
    found = panel_registration.fit_panel_map(
        [panel_registration.edges(*clip(true, seed), still) for seed in (1, 2)]
    )
    _, depths = clip(true, 3)
    for depth in depths:
        (there, known), (truth, _) = found.warp(depth), true.warp(depth)
        assert panel_registration.correlate(there, truth, known) > 0.95
        assert panel_registration.correlate(depth, truth, known) < 0.8


def test_what_is_level_is_like_nothing():
    assert panel_registration.correlate(np.zeros(SHAPE), np.eye(*SHAPE)) == 0.0
