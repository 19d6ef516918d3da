"""All stages as cards in their order; a click selects one."""

import math
from collections.abc import Collection, Mapping
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from PyQt6.QtCore import QEvent, QPointF, QRectF, QSize, QSizeF, Qt, pyqtSignal
from PyQt6.QtGui import QAction, QGuiApplication, QPainter, QPalette, QPen, QPixmap
from PyQt6.QtWidgets import (
    QAbstractButton,
    QToolButton,
    QWidget,
)

from pipeline.views.preview import Preview
from widgets.style.base import FIXED, GROWS, EventListener
from widgets.style.icons import PENDING, is_trouble, paint_state
from widgets.style.styling import fill, make_column, make_command_button, make_row, name_widget
from widgets.style.theme import get_theme_colours, to_qcolor
from widgets.views.canvas import draw_tag, measure_tag
from widgets.views.preview_renderer import MAX_ZOOM, PreviewRenderer

_PICTURE_PX = QSize(132, 82)
_SIGN = QSizeF(16, 16)
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
        self.setSizePolicy(GROWS, FIXED)
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
        make_column(
            0, self.remedy, 1, around_px=(_EDGE_PX, self._line_px() + _EDGE_PX, 2, 2), on=self
        )
        self.show_feedable(feedable=False)

    def show_feedable(self, *, feedable: bool) -> None:
        """Set whether the stage lacks what its remedy gives it."""
        if self.remedy is not None:
            self.is_feedable = feedable
            self.remedy.setVisible(feedable and not self.is_collapsed)
            across = FIXED if feedable else GROWS
            self.setSizePolicy(across, FIXED)

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
        painter.setBrush(palette.base())
        rim = palette.highlight() if self.is_in_pane else palette.midlight()
        painter.setPen(QPen(rim, 2.4 if self.is_active or self.hasFocus() else 1.2))
        painter.drawRoundedRect(QRectF(self.rect()).adjusted(1, 1, -1, -1), 4, 4)
        if self.state in PENDING:
            painter.fillRect(2, 1, self.width() - 4, 2, to_qcolor(ink.states["running"]))
        metrics = self.fontMetrics()
        line = self._line_px()
        room = QRectF(_EDGE_PX + 2, _EDGE_PX, self.width() - 2 * _EDGE_PX - 2, line)
        if is_trouble(self.state):
            paint_state(painter, QRectF(room.topLeft(), _SIGN), self.state, palette)
            room.setLeft(room.left() + _SIGN.width() + _EDGE_PX)
        wide = int(room.width())
        title = metrics.elidedText(self.text(), Qt.TextElideMode.ElideRight, wide)
        painter.setPen(palette.windowText().color())
        painter.drawText(room, Qt.AlignmentFlag.AlignVCenter, title)
        needed = metrics.horizontalAdvance(title) + metrics.horizontalAdvance(self.method)
        has_room = needed + 2 * _EDGE_PX <= wide and not self.is_feedable
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
            box = measure_tag(painter, self.method)
            draw_tag(painter, box, QPointF(_EDGE_PX, 2 * _EDGE_PX + line), self.method)
        if self.share is not None:  # as a bar along the lower edge, and its value over it
            share, text = self.share
            wide = max(2, round(min(1.0, abs(share)) * (self.width() - 2 * _EDGE_PX)))
            colour = to_qcolor(ink.worse if share > 0.5 else ink.accent)
            painter.fillRect(_EDGE_PX, self.height() - 2 * _EDGE_PX, wide, _EDGE_PX, colour)
            box = measure_tag(painter, text)
            top = self.height() - 2.5 * _EDGE_PX - box.height()
            draw_tag(painter, box, QPointF(_EDGE_PX, top), text)

    def _drop_pixmap(self) -> None:
        self._pixmap = None

    def _line_px(self) -> int:
        return max(round(_SIGN.height()), self.fontMetrics().height()) + 4


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
        x, y = (0.5 * float(at[0] + at[-1] + 1) for at in (cols, rows))
        plate.centre = QPointF(x, y)
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
        row = make_row(4, on=self)
        for name, thumbnail in self.thumbnails.items():
            thumbnail.clicked.connect(partial(self._choose, name))
            fill(row, (thumbnail, 1))

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
        is_collapsed = all(each.is_collapsed for each in self.thumbnails.values())
        return 0 if is_collapsed else _PICTURE_PX.height()

    def hide_stages(self, names: Collection[str]) -> None:
        """Hide the stages that the route does not have."""
        for name, thumbnail in self.thumbnails.items():
            thumbnail.setVisible(name not in names)

    def show_pane_stages(self, shown: Collection[str], active: str) -> None:
        """Show which stages are in panes, and which of them a click replaces."""
        for name, thumbnail in self.thumbnails.items():
            thumbnail.show_pane_state(shown=name in shown, active=name == active)
