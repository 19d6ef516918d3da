"""All stages as thumbnails with their state and warnings; a click selects one."""

import math
from collections.abc import Collection, Mapping
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from PyQt6.QtCore import QEvent, QPointF, QRectF, QSize, Qt, pyqtSignal
from PyQt6.QtGui import QFont, QFontMetrics, QPainter, QPalette, QPen, QPixmap
from PyQt6.QtWidgets import QAbstractButton, QHBoxLayout, QSizePolicy, QWidget

from pipeline.views.preview import Preview
from widgets.style.base import EventListener, make_caption_font
from widgets.style.icons import paint_state
from widgets.style.styling import set_spacing
from widgets.style.theme import get_theme_colours
from widgets.views.preview_renderer import MAX_ZOOM, PreviewRenderer

_PICTURE_PX = QSize(132, 62)
_SIGN_PX = 16
_EDGE_PX = 4
# below this share of pixels with a value, only those are shown, with this margin
_FEW = 0.3
_AROUND = 1.25


class Thumbnail(QAbstractButton):
    """One stage: its preview, title, state and warning sign."""

    def __init__(self, title: str) -> None:
        super().__init__()
        self.setText(title)
        self.setAccessibleName(title)
        self.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Fixed)
        self.state = "waiting"
        self.warnings = tuple[str, ...]()
        self.is_in_pane = self.is_active = self.is_collapsed = False
        self._picture: Preview | None = None
        self._pixmap: QPixmap | None = None
        EventListener(self, self._drop_pixmap, QEvent.Type.Resize, QEvent.Type.PaletteChange)

    def show_preview(self, picture: Preview | None) -> None:
        """Take another preview, None for none; the thumbnail is rendered when it is painted."""
        if picture is not self._picture:
            self._picture = picture
            self._pixmap = None
            self.update()

    def show_state(self, state: str, warnings: tuple[str, ...]) -> None:
        """Show the state and warnings of the stage."""
        if (state, warnings) != (self.state, self.warnings):
            self.state = state
            self.warnings = warnings
            self.setToolTip("\n".join((f"{self.text()}: {state}", *warnings)))
            self.update()

    def set_collapsed(self, folded: bool) -> None:
        """Show sign and title only."""
        self.is_collapsed = folded
        self.updateGeometry()

    def show_pane_state(self, *, shown: bool, active: bool) -> None:
        """Show whether the stage is in a pane, and whether a click replaces that pane."""
        self.is_in_pane = shown
        self.is_active = active
        self.update()

    def sizeHint(self) -> QSize:  # noqa: N802
        """Return room for the thumbnail under a line of text, or the line alone."""
        high = 0 if self.is_collapsed else _PICTURE_PX.height()
        return QSize(_PICTURE_PX.width() + 2 * _EDGE_PX, high + self._line_px() + 2 * _EDGE_PX)

    def minimumSizeHint(self) -> QSize:  # noqa: N802
        """Return a narrower width where there are many."""
        return QSize(74, self.sizeHint().height())

    def paintEvent(self, e: Any) -> None:  # noqa: N802
        """Paint sign and title over the thumbnail, with a frame if it is in a pane."""
        del e
        painter = QPainter(self)
        palette = self.palette()
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        room = QRectF(self.rect()).adjusted(1, 1, -1, -1)
        painter.setBrush(
            palette.color(QPalette.ColorRole.Base if self.is_in_pane else QPalette.ColorRole.Window)
        )
        rim = palette.color(
            QPalette.ColorRole.Highlight if self.is_in_pane else QPalette.ColorRole.Mid
        )
        painter.setPen(QPen(rim, 2.4 if self.is_active or self.hasFocus() else 1.0))
        painter.drawRoundedRect(room, 4, 4)
        line = self._line_px()
        paint_state(painter, QRectF(_EDGE_PX, _EDGE_PX, _SIGN_PX, _SIGN_PX), self.state, palette)
        font = self._font()
        painter.setFont(font)
        painter.setPen(palette.color(QPalette.ColorRole.WindowText))
        wide = self.width() - _SIGN_PX - 3 * _EDGE_PX
        title = QFontMetrics(font).elidedText(self.text(), Qt.TextElideMode.ElideRight, wide)
        painter.drawText(
            QRectF(_SIGN_PX + 2 * _EDGE_PX, _EDGE_PX, wide, line),
            Qt.AlignmentFlag.AlignVCenter,
            title,
        )
        if self._picture is None or self.is_collapsed:
            return
        size = QSize(self.width() - 2 * _EDGE_PX, _PICTURE_PX.height())
        if self._pixmap is None:
            self._pixmap = render_thumbnail(self._picture, size, self.devicePixelRatioF(), palette)
        painter.setOpacity(0.5 if self.state in ("stale", "running", "waiting") else 1.0)
        painter.drawPixmap(_EDGE_PX, _EDGE_PX + line, self._pixmap)

    def _drop_pixmap(self) -> None:
        self._pixmap = None

    def _font(self) -> QFont:
        font = make_caption_font(self.font())
        font.setBold(self.is_active)
        return font

    def _line_px(self) -> int:
        return max(_SIGN_PX, QFontMetrics(self._font()).height()) + 2


def render_thumbnail(picture: Preview, size: QSize, dense: float, palette: QPalette) -> QPixmap:
    """Render a preview with its contact outline on the theme's background, cropped to its values
    if they are few.
    """
    plate = PreviewRenderer()
    plate.set_theme(get_theme_colours(palette))
    # without a scale bar
    plate.set_preview(replace(picture, pixel_mm=math.nan, observed_outline_px=None))
    plate.size = size
    plate.fit_view()
    known = None if picture.values is None else np.isfinite(picture.values)
    if known is not None and 0 < np.count_nonzero(known) < _FEW * known.size:
        rows, cols = (np.flatnonzero(known.any(axis=axis)) for axis in (1, 0))
        wide, high = (_AROUND * (float(at[-1] - at[0]) + 1.0) for at in (cols, rows))
        scale = min(size.width() / wide, size.height() / high)
        plate.centre = QPointF(
            0.5 * float(cols[0] + cols[-1] + 1), 0.5 * float(rows[0] + rows[-1] + 1)
        )
        plate.scale = min(max(scale, plate.scale), MAX_ZOOM)
    return plate.render(dense, palette.color(QPalette.ColorRole.Window), QFont())


class Filmstrip(QWidget):
    """Thumbnails in the order of the stages; `chosen` carries a stage's name."""

    stage_chosen = pyqtSignal(str)

    def __init__(self, titles: Mapping[str, str]) -> None:
        super().__init__()
        self.setObjectName("filmstrip")
        self.thumbnails = {name: Thumbnail(title) for name, title in titles.items()}
        self.row = set_spacing(QHBoxLayout(self), 3, (2, 2, 2, 2))
        for name, thumbnail in self.thumbnails.items():
            thumbnail.clicked.connect(partial(self.stage_chosen.emit, name))
            self.row.addWidget(thumbnail, 1)

    def set_collapsed(self, folded: bool) -> None:
        """Hide or show the thumbnails."""
        for thumbnail in self.thumbnails.values():
            if thumbnail.is_collapsed != folded:
                thumbnail.set_collapsed(folded)

    @property
    def collapsible_px(self) -> int:
        """Height that collapsing the thumbnails would free."""
        return (
            0
            if all(each.is_collapsed for each in self.thumbnails.values())
            else _PICTURE_PX.height()
        )

    def hide_stages(self, names: Collection[str]) -> None:
        """Hide the stages that the route does not have."""
        for name, thumbnail in self.thumbnails.items():
            thumbnail.setVisible(name not in names)

    def show_pane_stages(self, shown: Collection[str], active: str) -> None:
        """Show which stages are in panes, and which of them a click replaces."""
        for name, thumbnail in self.thumbnails.items():
            thumbnail.show_pane_state(shown=name in shown, active=name == active)
