"""Tiles of previews that share pan, zoom and crosshair, in millimetres."""

import math
from collections.abc import Sequence
from functools import partial
from typing import Any

from PyQt6.QtCore import QEvent, QPointF, QSize, Qt, pyqtSignal
from PyQt6.QtWidgets import (
    QFrame,
    QGridLayout,
    QLabel,
    QWidget,
)

from pipeline.views.preview import Preview, Tile
from widgets.style.base import FIXED, GROWS, YIELDS, EventListener
from widgets.style.styling import fill, make_bold, make_column, make_text, set_spacing
from widgets.views.preview_view import SIDE_TEXT_PX, PreviewView

_MOST_COLUMNS = 8
_NARROW_PX = 360
# estimates of a tile's border, text and colour bar, good enough to choose the layout
_RIM_PX = 10
_WORDS_PX = 72
_LEVELS_PX = 48
_SIDE_PX = 160  # height of title, colour bar and caption beside an image
# gain in image width needed to place the text at the side: under an image it is read sooner
_SIDE_TEXT_GAIN = 1.1
_LEAST_PX = (320, 240)
_LINES = 6  # metric lines at the side where there is room, more if a tile has more


class TileView(QFrame):
    """One tile."""

    def __init__(self) -> None:
        super().__init__()
        self.setFrameShape(QFrame.Shape.StyledPanel)
        self.tile = Tile(title="")
        self._title = make_bold(QLabel())
        self._subtitle = make_text()
        self.view = PreviewView()
        for label in (self._title, self._subtitle):
            label.setSizePolicy(YIELDS, FIXED)
            label.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
        self._subtitle.setAlignment(Qt.AlignmentFlag.AlignTop | Qt.AlignmentFlag.AlignLeft)
        self.view.caption.set_lines(1)
        self._text_at_side = False
        self._lines = _LINES
        EventListener(self, self._fit_words, QEvent.Type.Resize)  # a narrow tile wraps its metrics
        self._around = make_column(2, around_px=(3, 3, 3, 2), on=self)
        fill(self._around, self._title, self._subtitle, (self.view, 1))

    def place_text(self, *, at_side: bool) -> None:
        """Place all text to the right of the image, or over and under it."""
        if at_side == self._text_at_side:
            return
        self._text_at_side = at_side
        room = self.view.text_layout if at_side else self._around
        for at, label in enumerate((self._title, self._subtitle)):
            room.insertWidget(at, label)
        self._title.setWordWrap(at_side)
        self.view.place_text(at_side=at_side)
        self.view.caption.set_lines(3 if at_side else 1)
        self._fit_words()

    def _fit_words(self) -> None:
        line = self._line_px
        lines = 2 if self.width() < _NARROW_PX else 1
        if self._text_at_side:
            lines = min(max(2, (self.height() - _SIDE_PX) // line), self._lines)
        self._subtitle.setFixedHeight(lines * line + 2)
        self._title.setFixedHeight((1 + self._text_at_side) * line + 2)

    @property
    def _line_px(self) -> int:
        return self._title.fontMetrics().lineSpacing()

    @property
    def needed_lines(self) -> int:
        """Number of lines that the metrics fill at the side of the image."""
        return math.ceil(self._subtitle.heightForWidth(SIDE_TEXT_PX) / self._line_px)

    def reserve_lines(self, lines: int) -> None:
        """Reserve this number of lines, the same in all tiles: images stay aligned."""
        if lines != self._lines:
            self._lines = lines
            self._fit_words()

    def show_tile(self, tile: Tile, versus: str) -> None:
        """Show a tile, or another view of it ("", truth, difference, wipe, blink)."""
        self.tile = tile
        for label, text in ((self._title, tile.title), (self._subtitle, tile.subtitle)):
            label.setText(text)
            label.setToolTip(text)
        if tile.default_mode and versus not in ("wipe", "blink"):
            versus = tile.default_mode
        if tile.preview is not None:
            self.view.show_compared(tile.preview, tile.truth, tile.difference, versus)
        self.view.canvas.setVisible(tile.preview is not None or bool(tile.problem))
        self.view.show_message(tile.problem)


class TileGrid(QWidget):
    """Shows tiles as large as they fit.

    `readout_changed` carries the value of the pixel under the mouse.
    """

    readout_changed = pyqtSignal(str)
    limit_dragged = pyqtSignal(str, float)  # as of `widgets.views.colour_bar.ColourBar`
    limits_fitted = pyqtSignal(object)

    def __init__(self) -> None:
        super().__init__()
        self.setSizePolicy(GROWS, GROWS)
        self._grid = set_spacing(QGridLayout(self), 4)
        self._views: list[TileView] = []
        self._versus = ""
        self.tiles: tuple[Tile, ...] = ()
        self._placed: tuple[tuple[int, int], ...] = ()

    @property
    def views(self) -> tuple[TileView, ...]:
        """Views of the tiles on display, in order."""
        return tuple(self._views[: len(self.tiles)])

    def sizeHint(self) -> QSize:  # noqa: N802
        """Return room for a few tiles."""
        return QSize(900, 500)

    def minimumSizeHint(self) -> QSize:  # noqa: N802
        """Return the same size for every layout: otherwise the layout would change the room that
        it is chosen by.
        """
        return QSize(*_LEAST_PX)

    def hasHeightForWidth(self) -> bool:  # noqa: N802
        """Return False, for the same reason: titles that wrap would ask for it."""
        return False

    def show_tiles(self, tiles: Sequence[Tile]) -> None:
        """Show these tiles; tiles of the same size keep their view."""
        self.tiles = tuple(tiles)
        while len(self._views) < len(self.tiles):
            self._add()
        for view, tile in zip(self._views, self.tiles, strict=False):
            view.show_tile(tile, self._versus)
        lines = max((view.needed_lines for view in self.views), default=0)
        for view in self.views:
            view.view.colour_bar.setVisible(self._has_scale)
            view.reserve_lines(max(lines, _LINES))
        self._place()

    def set_comparison_mode(self, versus: str) -> None:
        """Set what every tile shows instead of, or next to, its image."""
        if versus != self._versus:
            self._versus = versus
            self.show_tiles(self.tiles)

    def reset_view(self) -> None:
        """Fit every image."""
        for view in self.views:
            view.view.canvas.fit_view()

    def resizeEvent(self, a0: Any) -> None:  # noqa: N802
        """Choose the layout for the new size."""
        super().resizeEvent(a0)
        self._place()

    def _add(self) -> None:
        made = TileView()
        made.view.view_changed.connect(partial(self._sync_views, made))
        made.view.pixel_hovered.connect(partial(self._point, made))
        made.view.colour_bar.limit_dragged.connect(self.limit_dragged)
        made.view.colour_bar.limits_fitted.connect(self.limits_fitted)
        self._views.append(made)

    @property
    def _has_scale(self) -> bool:
        """Whether any tile has a colour bar.

        Tiles without one reserve its room, so that images stay aligned.
        """
        return any(
            view.view.preview is not None and view.view.preview.scale is not None
            for view in self.views
        )

    def _place(self) -> None:
        """Lay out rows as the tiles request, else so that images are largest."""
        columns, at_side = self._shape()
        places = _places([tile.starts_row for tile in self.tiles], columns)
        for view in self.views:
            view.place_text(at_side=at_side)
        if places != self._placed:
            self._placed = places
            for k in range(self._grid.columnCount()):
                self._grid.setColumnStretch(k, 0)
            for k in range(self._grid.rowCount()):
                self._grid.setRowStretch(k, 0)
            for view, (row, col) in zip(self._views, places, strict=False):
                self._grid.addWidget(view, row, col)
                self._grid.setColumnStretch(col, 1)
                self._grid.setRowStretch(row, 1)
        for index, view in enumerate(self._views):
            view.setVisible(index < len(self.tiles))

    def _shape(self) -> tuple[int, bool]:
        """Return the number per row, and whether text is at the side, that make images largest."""
        apart = [tile.starts_row for tile in self.tiles]
        tall = max(
            (view.view.height_over_width for view in self.views if view.tile.preview is not None),
            default=0.75,
        )
        words_px = _WORDS_PX + _LEVELS_PX * self._has_scale

        def estimate_width(shape: tuple[int, bool]) -> float:
            places = _places(apart, shape[0]) or ((0, 0),)
            at_side = shape[1]
            rows, cols = (1 + max(place[k] for place in places) for k in (0, 1))
            wide_px = self.width() / cols - _RIM_PX - SIDE_TEXT_PX * at_side
            high_px = self.height() / rows - (_RIM_PX if at_side else words_px)
            return min(wide_px, max(1.0, high_px) / tall) / (_SIDE_TEXT_GAIN if at_side else 1.0)

        most = 1 if any(apart) else min(_MOST_COLUMNS, max(1, len(apart)))
        return max(
            ((cols, at_side) for at_side in (False, True) for cols in range(1, most + 1)),
            key=estimate_width,
        )

    def _sync_views(self, at: TileView) -> None:
        """Show the same region at the same scale in all tiles."""
        own, canvas = at.view.preview, at.view.canvas
        for other in self.views:
            there = other.view.preview
            if own is None or there is None or other is at:
                continue
            finer = own.pixel_mm / there.pixel_mm
            if finer > 0:
                centre = _find_middle(there) + (canvas.centre - _find_middle(own)) * finer
                other.view.canvas.set_view(centre, canvas.scale / finer)

    def _point(self, at: TileView, row: int, col: int) -> None:
        """Show the crosshair at the same position of all tiles, with their values."""
        own = at.view.preview
        if own is None or row < 0:
            for view in self.views:
                view.view.canvas.show_crosshair(None)
            self.readout_changed.emit("")
            return
        for view in self.views:
            there = view.view.preview
            if there is not None and there.pixels.shape == own.pixels.shape:
                view.view.canvas.show_crosshair((row, col), there.format_value(row, col))
            else:
                view.view.canvas.show_crosshair(None)
        self.readout_changed.emit(f"{at.tile.title} {own.describe_pixel(row, col)}")


def _find_middle(preview: Preview) -> QPointF:
    rows, cols = preview.pixels.shape[:2]
    return QPointF(0.5 * cols, 0.5 * rows)


def _places(apart: Sequence[bool], columns: int) -> tuple[tuple[int, int], ...]:
    """Return (row, col) of each tile: `columns` per row, or as many as lie between tiles that
    start a row.
    """
    places: list[tuple[int, int]] = []
    row = col = 0
    for begins in apart:
        if places and (begins if any(apart) else col == columns):
            row, col = row + 1, 0
        places.append((row, col))
        col += 1
    return tuple(places)
