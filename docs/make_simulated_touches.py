"""Make docs/simulated.png: touches of the same objects as each simulated sensor records them.

    python docs/make_simulated_touches.py [FILE.png]

Rows are sensors, columns objects held at the same pose in the alignment frame. The soft bubble's
depth is shown as its imprint, dark = deep. Every picture carries its sensor's noise; everything is
simulated.
"""

from __future__ import annotations

import sys
from pathlib import Path

import cv2
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from pipeline.core.geometry import rigid
from pipeline.core.geometry.meshes import Mesh
from pipeline.physics import optics
from pipeline.physics.simulation import shapes
from pipeline.physics.simulation.press import simulate_press
from pipeline.sensors.spec import SensorSpec, load_sensor

SENSORS = ("gelslim", "gelslim_dotless", "digit", "gelsight_mini", "soft_bubble")
SHAPES = ("sphere", "edge", "ring", "three_lines", "lines_45", "hexagon", "letters", "star")
# past the untouched gels; the bubble stands out of their plane and is pressed deeper
DEPTH_MM = 0.7
TURN_DEG = 20.0
SHIFT_MM = (0.8, -0.5)
CELL_PX = (140, 187)  # height and width of one picture
GAP_PX = 6
HEAD_PX = 26
SIDE_PX = 120
_BUBBLE_MM = (-3.0, 14.0)  # shown range of the imprint


def place_object(thing: Mesh) -> np.ndarray:
    """Pose of an object whose lowest point is `DEPTH_MM` under the alignment plane, a little off
    the middle.
    """
    pose = rigid.from_parts((*SHIFT_MM, 0.0), (0.0, 0.0, TURN_DEG))
    pose[2, 3] = -DEPTH_MM - float(thing.vertices_mm[:, 2].min())
    return pose


def picture(spec: SensorSpec, image: np.ndarray) -> np.ndarray:
    """(rows, cols, 3) uint8 to look at."""
    if spec.kind == "gel":
        return np.asarray(image)
    imprint = spec.rest_depth_mm - image
    shade = np.clip((imprint - _BUBBLE_MM[0]) / (_BUBBLE_MM[1] - _BUBBLE_MM[0]), 0, 1)
    seen = cv2.applyColorMap(
        (255 * (1 - np.nan_to_num(shade))).astype(np.uint8), cv2.COLORMAP_BONE
    )[..., ::-1]
    return np.where(np.isfinite(image)[..., None], seen, 0).astype(np.uint8)


def cell(image: np.ndarray) -> np.ndarray:
    """A picture whole in a cell of the sheet."""
    scale = min(CELL_PX[0] / image.shape[0], CELL_PX[1] / image.shape[1])
    size = (round(image.shape[1] * scale), round(image.shape[0] * scale))
    out = np.full((*CELL_PX, 3), 255, np.uint8)
    top = (CELL_PX[0] - size[1]) // 2
    left = (CELL_PX[1] - size[0]) // 2
    out[top : top + size[1], left : left + size[0]] = cv2.resize(
        image, size, interpolation=cv2.INTER_AREA
    )
    return out


def render_reference(spec: SensorSpec) -> np.ndarray:
    """The sensor's picture of nothing, with noise."""
    if spec.kind == "gel":
        return picture(spec, optics.render(spec, np.zeros(spec.camera.shape, np.float32), seed=0))
    nothing = shapes.make_shape(SHAPES[0]).mesh
    pose = place_object(nothing)
    pose[2, 3] = 50.0
    return picture(spec, simulate_press(nothing, pose, spec, seed=0).image)


def row(spec: SensorSpec) -> np.ndarray:
    """One sensor's touches side by side."""
    cells = [cell(render_reference(spec))]
    for index, name in enumerate(SHAPES):
        thing = shapes.make_shape(name).mesh
        cells.append(
            cell(
                picture(
                    spec, simulate_press(thing, place_object(thing), spec, seed=index + 1).image
                )
            )
        )
    return np.hstack(
        [np.pad(c, ((0, GAP_PX), (0, GAP_PX), (0, 0)), constant_values=255) for c in cells]
    )


def main(path: Path) -> None:
    """Write the sheet."""
    rows = [row(load_sensor(name)) for name in SENSORS]
    body = np.vstack(rows)
    sheet = np.full((body.shape[0] + HEAD_PX, body.shape[1] + SIDE_PX, 3), 255, np.uint8)
    sheet[HEAD_PX:, SIDE_PX:] = body
    pen = {
        "fontFace": cv2.FONT_HERSHEY_SIMPLEX,
        "fontScale": 0.4,
        "color": (40, 40, 40),
        "lineType": cv2.LINE_AA,
    }
    for k, title in enumerate(("untouched", *(shapes.make_shape(n).title for n in SHAPES))):
        cv2.putText(sheet, title, (SIDE_PX + k * (CELL_PX[1] + GAP_PX) + 4, HEAD_PX - 9), **pen)
    for k, name in enumerate(SENSORS):
        cv2.putText(
            sheet,
            load_sensor(name).title,
            (4, HEAD_PX + k * (CELL_PX[0] + GAP_PX) + CELL_PX[0] // 2),
            **pen,
        )
    cv2.imwrite(str(path), sheet[..., ::-1], [cv2.IMWRITE_PNG_COMPRESSION, 9])


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).with_name("simulated.png"))
