import numpy as np
import pytest
from PyQt6.QtCore import QSize
from PyQt6.QtGui import QColor

from pipeline.core.figures import make_figure
from pipeline.translation.reports.sheet import draw_panel
from pipeline.views.preview import Preview
from widgets.views.preview_renderer import PreviewRenderer


def test_window_and_file_show_one_scale_bar(qapp):
    """The dark bar of both on a light image covers the same columns."""
    pixels = np.full((240, 320, 3), 200, np.uint8)
    preview = Preview(pixels=pixels, frame_name="digit frame", pixel_mm=0.05)
    figure = make_figure(figsize=(3.2, 2.4), dpi=100)
    draw_panel(figure, figure.add_axes((0, 0, 1, 1)), preview, "")
    figure.canvas.draw()
    in_file = np.asarray(figure.canvas.buffer_rgba())[..., :3]
    renderer = PreviewRenderer()
    renderer.set_preview(preview)
    renderer.size = QSize(320, 240)
    renderer.fit_view()
    image = renderer.render(1.0, QColor(255, 255, 255), qapp.font()).toImage()
    in_window = np.array(
        [[image.pixelColor(x, y).red() for x in range(320)] for y in range(200, 240)]
    )
    columns = [
        np.flatnonzero((red < 90).sum(axis=0) >= 2) for red in (in_file[225:, :, 0], in_window[25:])
    ]
    for drawn in columns:
        # 2 mm; 5 mm would be 100 pixels, more than 30 %
        assert len(drawn) == pytest.approx(40, abs=1.5)
        assert drawn[-1] == pytest.approx(0.95 * 320, abs=1.5)
