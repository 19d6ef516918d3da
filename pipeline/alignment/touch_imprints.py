"""Imprint pairs of the moments that both sensors recorded, to fit an alignment to."""

from collections.abc import Sequence

import numpy as np

from pipeline.alignment.touches import AlignmentTouch
from pipeline.base.arrays import Floats, freeze
from pipeline.imprints.tiles import ImprintPairs, check_pairing
from pipeline.imprints.transfer import ImprintPair
from pipeline.values.results import DepthMap


def make_touch_pairs(touches: Sequence[AlignmentTouch]) -> ImprintPairs:
    """Make pairs of the moments with contact on both sensors, in millimetres on either rest surface."""
    made = tuple(_touch(t) for t in touches if t.has_contact_on_both)
    return ImprintPairs(
        pairs=made, notes=(f"{len(made)} of {len(touches)} moments have contact on both sensors", *check_pairing(made))
    )


def compute_pixel_mm(depth: DepthMap) -> float:
    """Return the width of a pixel at the median depth."""
    seen = depth.depth_mm[np.isfinite(depth.depth_mm)]
    return float(np.median(seen)) / depth.camera.fx_px


def _touch(touch: AlignmentTouch) -> ImprintPair:
    def size(depth: DepthMap) -> tuple[float, float]:
        return depth.camera.cols * compute_pixel_mm(depth), depth.camera.rows * compute_pixel_mm(depth)

    imprint: Floats = np.nan_to_num(touch.target.indentation_mm).astype(np.float32)
    return ImprintPair(name=str(touch.index), contact=freeze(touch.source.contact.astype(np.float32)), is_metric=True,
                source_size=size(touch.source), imprint=freeze(imprint), target_size=size(touch.target))  # fmt: skip
