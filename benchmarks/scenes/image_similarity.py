"""How alike two images are, as one number: the map of the similarity without the border that no window fits into."""

from __future__ import annotations

import numpy as np

from pipeline.metrics.image_similarity import BORDER_PX, compute_similarity_map


def compute_similarity(a: np.ndarray, b: np.ndarray, data_range: float) -> float:
    inner = (slice(BORDER_PX, -BORDER_PX),) * 2
    return float(compute_similarity_map(a, b, data_range)[inner].mean())
