"""The views of all stages' values."""

from collections.abc import Mapping

from pipeline.views.image_views import TARGET_DEPTH, TOUCH, make_depth_view
from pipeline.views.point_views import CLOUD, POSE
from pipeline.views.view import View

VIEWS: Mapping[str, View] = {
    "depth": make_depth_view("depth", "measured surface", "source"),
    "cloud": CLOUD,
    "target_depth": TARGET_DEPTH,
    "touch": TOUCH,
    "touch_depth": make_depth_view("touch_depth", "depth of the generated touch", "target"),
    "pose": POSE,
}  # stage -> view
