"""All stages as cards in their order; a click selects one."""

import math
from collections.abc import Collection, Mapping
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from PyQt6.QtCore import QEvent, QPointF, QRectF, QSize, Qt, pyqtSignal
from PyQt6.QtGui import QAction, QColor, QGuiApplication, QPainter, QPalette, QPen, QPixmap
from PyQt6.QtWidgets import (
    QAbstractButton,
    QHBoxLayout,
    QSizePolicy,
    QToolButton,
    QVBoxLayout,
    QWidget,
)

from pipeline.views.preview import Preview
from widgets.style.base import EventListener
from widgets.style.icons import PENDING, is_trouble, paint_state
from widgets.style.styling import fill, make_command_button, name_widget, set_spacing
from widgets.style.theme import ThemeColours, get_theme_colours, to_qcolor
from widgets.views.preview_renderer import MAX_ZOOM, PreviewRenderer

_PICTURE_PX = QSize(132, 82)
_SIGN_PX = 16
_EDGE_PX = 4
# below this share of pixels with a value, only those are shown, with this margin
_FEW = 0.3
_AROUND = 1.25


class Thumbnail(QAbstractButton):
    """Card of one stage: its preview, title, method, share of the error, and what is wrong.

    It is narrow, with the button that feeds it, while the stage cannot run.
    """

    def __init__(self, title: str) -> None:
        super().__init__()
        self.setText(title)
        self.setAccessibleName(title)
        self.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Fixed)
        self.state = "waiting"
        self.method = ""
        self.share: tuple[float, str] | None = None  # of the error (0 to 1), and its value
        self.is_in_pane = self.is_active = self.is_collapsed = self.is_feedable = False
        self.remedy: QToolButton | None = None
        self._picture: Preview | None = None
        self._pixmap: QPixmap | None = None
        EventListener(self, self._drop_pixmap, QEvent.Type.Resize, QEvent.Type.PaletteChange)

    def show_preview(self, picture: Preview | None) -> None:
        """Take another preview, None for none; the thumbnail is rendered when it is painted."""
        if picture is not self._picture:
            self._picture = picture
            self._pixmap = None
            self.update()

    def show_state(self, state: str, known: str) -> None:
        """Show the state of the stage; all that is known of it is the tooltip."""
        self.state = state
        self.setToolTip(known)
        self.update()

    def show_method(self, title: str) -> None:
        """Show the title of the method in use."""
        self.method = title
        self.update()

    def show_share(self, share: float | None, text: str = "") -> None:
        """Show the share of the error that comes from here; None where it is not known."""
        self.share = None if share is None else (share, text)
        self.update()

    def offer_remedy(self, action: QAction) -> None:
        """Show the command that feeds the stage, in place of its image."""
        self.remedy = make_command_button(action)
        layout = set_spacing(QVBoxLayout(self), 0, (_EDGE_PX, self._line_px() + _EDGE_PX, 2, 2))
        fill(layout, self.remedy, 1)
        self.show_feedable(feedable=False)

    def show_feedable(self, *, feedable: bool) -> None:
        """Set whether the stage lacks what its remedy gives it."""
        if self.remedy is not None:
            self.is_feedable = feedable
            self.remedy.setVisible(feedable and not self.is_collapsed)
            across = QSizePolicy.Policy.Fixed if feedable else QSizePolicy.Policy.Expanding
            self.setSizePolicy(across, QSizePolicy.Policy.Fixed)

    def set_collapsed(self, folded: bool) -> None:
        """Show sign and title only."""
        self.is_collapsed = folded
        self.show_feedable(feedable=self.is_feedable)
        self.updateGeometry()

    def show_pane_state(self, *, shown: bool, active: bool) -> None:
        """Show whether the stage is in a pane, and whether a click replaces that pane."""
        self.is_in_pane = shown
        self.is_active = active
        self.update()

    def sizeHint(self) -> QSize:  # noqa: N802
        """Return room for the thumbnail under a line of text, or the line alone."""
        high = 0 if self.is_collapsed else _PICTURE_PX.height() + _EDGE_PX
        return QSize(_PICTURE_PX.width() + 2 * _EDGE_PX, high + self._line_px() + _EDGE_PX)

    def minimumSizeHint(self) -> QSize:  # noqa: N802
        """Return a narrower width where there are many."""
        return QSize(74, self.sizeHint().height())

    def paintEvent(self, e: Any) -> None:  # noqa: N802
        """Paint title, method and image, framed if the stage is in a pane, with a line at the top
        while it is computed again.
        """
        del e
        painter = QPainter(self)
        palette = self.palette()
        ink = get_theme_colours(palette)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        painter.setBrush(palette.color(QPalette.ColorRole.Base))
        rim = palette.color(
            QPalette.ColorRole.Highlight if self.is_in_pane else QPalette.ColorRole.Midlight
        )
        painter.setPen(QPen(rim, 2.4 if self.is_active or self.hasFocus() else 1.2))
        painter.drawRoundedRect(QRectF(self.rect()).adjusted(1, 1, -1, -1), 4, 4)
        if self.state in PENDING:
            painter.fillRect(2, 1, self.width() - 4, 2, to_qcolor(ink.states["running"]))
        line = self._line_px()
        left = _EDGE_PX + 2
        if is_trouble(self.state):
            side = _SIGN_PX
            paint_state(painter, QRectF(left, _EDGE_PX, side, side), self.state, palette)
            left += side + _EDGE_PX
        room = QRectF(left, _EDGE_PX, self.width() - left - _EDGE_PX, line)
        method_px = self.fontMetrics().horizontalAdvance(self.method)
        has_room = self._paint_title(painter, room) >= method_px and not self.is_feedable
        if has_room:
            painter.setPen(to_qcolor(ink.secondary_text))
            painter.drawText(
                room, Qt.AlignmentFlag.AlignVCenter | Qt.AlignmentFlag.AlignRight, self.method
            )
        if self.is_collapsed or self.is_feedable:
            return
        if self._picture is not None:
            size = QSize(self.width() - 2 * _EDGE_PX, _PICTURE_PX.height())
            if self._pixmap is None:
                self._pixmap = render_thumbnail(
                    self._picture, size, self.devicePixelRatioF(), palette
                )
            painter.drawPixmap(_EDGE_PX, _EDGE_PX + line, self._pixmap)
        if self.method and not has_room:
            self._paint_label(painter, self.method, QPointF(_EDGE_PX, 2 * _EDGE_PX + line))
        if self.share is not None:
            self._paint_share(painter, ink, *self.share)

    def _paint_share(self, painter: QPainter, ink: ThemeColours, share: float, text: str) -> None:
        """Paint the share of the error as a bar along the lower edge, and its value over it."""
        most = self.width() - 2 * _EDGE_PX
        wide = max(2.0, min(1.0, abs(share)) * most)
        colour = to_qcolor(ink.worse if share > 0.5 else ink.accent)
        painter.fillRect(QRectF(_EDGE_PX, self.height() - 2 * _EDGE_PX, wide, _EDGE_PX), colour)
        top = self.height() - 2.5 * _EDGE_PX - self.fontMetrics().height()
        self._paint_label(painter, text, QPointF(_EDGE_PX, top))

    def _paint_title(self, painter: QPainter, room: QRectF) -> int:
        """Paint the title, and return how much room is left at its right."""
        metrics = self.fontMetrics()
        wide = int(room.width())
        painter.setPen(self.palette().color(QPalette.ColorRole.WindowText))
        title = metrics.elidedText(self.text(), Qt.TextElideMode.ElideRight, wide)
        painter.drawText(room, Qt.AlignmentFlag.AlignVCenter, title)
        return wide - metrics.horizontalAdvance(title) - 2 * _EDGE_PX

    def _paint_label(self, painter: QPainter, text: str, at: QPointF) -> None:
        """Paint a text over the image."""
        metrics = self.fontMetrics()
        box = QRectF(at.x(), at.y(), metrics.horizontalAdvance(text) + 8, metrics.height())
        painter.fillRect(box, QColor(20, 24, 30, 190))
        painter.setPen(QColor(255, 255, 255))
        painter.drawText(box, Qt.AlignmentFlag.AlignCenter, text)

    def _drop_pixmap(self) -> None:
        self._pixmap = None

    def _line_px(self) -> int:
        return max(_SIGN_PX, self.fontMetrics().height()) + 4


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
    return plate.render(dense, palette.color(QPalette.ColorRole.Window), QGuiApplication.font())


class Filmstrip(QWidget):
    """One card per stage; a click chooses it, Ctrl+click adds or removes it."""

    stage_chosen = pyqtSignal(str)
    stage_toggled = pyqtSignal(str)

    def __init__(self, titles: Mapping[str, str]) -> None:
        super().__init__()
        name_widget(self, "filmstrip")
        self.thumbnails = {name: Thumbnail(title) for name, title in titles.items()}
        row = set_spacing(QHBoxLayout(self), 4)
        for name, thumbnail in self.thumbnails.items():
            thumbnail.clicked.connect(partial(self._choose, name))
            row.addWidget(thumbnail, 1)

    def _choose(self, name: str) -> None:
        adds = QGuiApplication.keyboardModifiers() & Qt.KeyboardModifier.ControlModifier
        (self.stage_toggled if adds else self.stage_chosen).emit(name)

    def show_shares(self, shares: Mapping[str, tuple[float, str]]) -> None:
        """Show stage -> share of the error (0 to 1) and its value; the others show none."""
        for name, thumbnail in self.thumbnails.items():
            thumbnail.show_share(*shares.get(name, (None, "")))

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
