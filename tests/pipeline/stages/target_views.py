"""What methods from image to image read of a frame beside its image."""

from __future__ import annotations

from pipeline.core.graph import Graph
from pipeline.translation.catalogue import BUILT_IN


def estimate_views(frame, source, between, target):
    """Target depth and depth of a frame by default methods, as the graph gives them."""
    methods = BUILT_IN.methods("t2d2", kinds={"source": source.kind, "target": target.kind})
    weights = {
        m.weights_name: m.weights(source, target, None) for m in methods if m.weights is not None
    }
    inputs = {
        "frame": frame,
        "source": source,
        "target": target,
        "calibration": None,
        "alignment": between,
        **weights,
    }
    found = Graph(methods).evaluate(["target_depth"], inputs, {})
    return found["target_depth"].output, found["depth"].output
