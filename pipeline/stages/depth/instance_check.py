"""Whether a recording is of the unit that its calibration was made on: told from the untouched pictures of both.

Lamps, paint and glue differ from unit to unit, and with them the picture of a gel at rest, by far more than one unit's
light and lens drift. What is no drift (`drift`) is left of the one picture when it is explained by the other.
"""

from __future__ import annotations

import numpy as np

from pipeline.base.arrays import Image
from pipeline.base.memo import Memo
from pipeline.base.stage_warnings import StageWarning
from pipeline.calibration import reference_thumbnail
from pipeline.calibration.calibration_table import Calibration
from pipeline.engine.digests import compute_cached_digest
from pipeline.stages.depth import drift

# Half of the picture differs by more. One simulated unit after drift: 0.2; two: 1.2 to 1.8 (Minis with lamps all alike,
# one pair of ten), others from 4; one real Mini in six recordings, maybe of several days: 0.3 to 2.5; beside another: 8
# to 22. A unit that differs by less is read alike.
_ANOTHER_GREY = 3.0
_BLOCK_PX = 8


def check_sensor_instance(calibration: Calibration, reference: Image) -> tuple[str, ...]:
    """What is said of a calibration beside a recording's untouched picture (rows, cols, 3); empty where they agree.

    One from the sensor's description, or of before it kept its picture, tells nothing.
    """
    still = calibration.reference_thumbnail
    if still is None:
        return ()
    off, likely = _compared.get_or_make(
        (compute_cached_digest(reference), compute_cached_digest(still)),
        lambda: _differ(reference_thumbnail.make_thumbnail(reference), still),
    )
    if off <= _ANOTHER_GREY and likely:
        return ()
    why = (
        f"the untouched pictures differ by {off:.0f} grey levels beyond drift"
        if likely
        else "the light of the untouched pictures differs by more than one unit's drifts"
    )
    return (StageWarning(f"the calibration may be of another unit, or of another light: {why}; calibrate this one"),)


_compared: Memo[tuple[str, str], tuple[float, bool]] = Memo(8)


def _differ(now: Image, still: Image) -> tuple[float, bool]:
    """Grey levels by which half of the picture differs beyond drift, and whether that drift is one unit's."""
    import cv2

    if now.shape != still.shape:
        now = np.asarray(cv2.resize(now, still.shape[1::-1], interpolation=cv2.INTER_AREA), np.uint8)
    found, _ = drift.fit_drift(now, still)
    alike = still.astype(np.float32) if found is None else drift.apply_drift(still, found)
    off = np.abs(drift.compute_block_means(now, _BLOCK_PX) - drift.compute_block_means(alike, _BLOCK_PX)).max(axis=2)
    return float(np.median(off)), found is None or not found.exceeds_instance_drift(float(still.mean()))
