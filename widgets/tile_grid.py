"""Pictures side by side that are looked at as one: panned, zoomed and pointed at together, in millimetres."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

from PyQt6.QtCore import QPointF, QSize, Qt, pyqtSignal
from PyQt6.QtWidgets import QBoxLayout, QFrame, QGridLayout, QLabel, QSizePolicy, QVBoxLayout, QWidget

from pipeline.previews.tile import Tile
from widgets.preview_view import SIDE_TEXT_PX, PreviewView
from widgets.styling import make_bold, set_spacing, shrink_font

_MOST_COLUMNS = 8
_NARROW_PX = 360
_RIM_PX, _WORDS_PX, _LEVELS_PX = 10, 72, 48  # of a tile that are not picture, near enough to choose how tiles stand
_BESIDE_GAINS = 1.1  # times wider must pictures be with words beside them: under a picture they are read sooner
_LEAST_PX = (320, 240)
_LINES = 6  # of figures beside a picture, as far as there is room, and more where one of the tiles has more


class TileView(QFrame):
    """One tile."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setFrameShape(QFrame.Shape.StyledPanel)
        self.tile = Tile(title="")
        self._title, self._told, self.view = QLabel(), QLabel(), PreviewView()
        make_bold(self._title)
        shrink_font(self._told, 0.5)
        for label in (self._title, self._told):
            label.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Fixed)
            label.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
        self._told.setWordWrap(True)
        self._told.setAlignment(Qt.AlignmentFlag.AlignTop | Qt.AlignmentFlag.AlignLeft)
        self.view.set_caption_lines(1)
        self._beside, self._lines = False, _LINES
        self._around = set_spacing(QVBoxLayout(self), 2, (3, 3, 3, 2))
        self._around.addWidget(self._title)
        self._around.addWidget(self._told)
        self._around.addWidget(self.view, 1)

    def resizeEvent(self, a0: Any) -> None:  # noqa: N802
        """A narrow tile has its figures in two lines."""
        super().resizeEvent(a0)
        self._fit_words()

    def place_text(self, *, at_side: bool) -> None:
        """Put all words to the right of the picture, or over and under it."""
        if at_side == self._beside:
            return
        self._beside = at_side
        told = self.view.text_area.layout()
        room = told if at_side and isinstance(told, QBoxLayout) else self._around
        for at, label in enumerate((self._title, self._told)):
            room.insertWidget(at, label)
        self._title.setWordWrap(at_side)
        self.view.place_text(at_side=at_side)
        self.view.set_caption_lines(3 if at_side else 1)
        self._fit_words()

    def _fit_words(self) -> None:
        line = self._told.fontMetrics().lineSpacing()
        lines = 2 if self.width() < _NARROW_PX else 1
        if self._beside:
            lines = min(max(2, (self.height() - _WORDS_PX - 2 * _LEVELS_PX) // line), self._lines)
        self._told.setFixedHeight(lines * line + 2)
        self._title.setFixedHeight((2 if self._beside else 1) * self._title.fontMetrics().lineSpacing() + 2)

    @property
    def needed_lines(self) -> int:
        """How many lines its figures fill beside the picture."""
        return -(-self._told.heightForWidth(SIDE_TEXT_PX) // self._told.fontMetrics().lineSpacing())

    def reserve_lines(self, lines: int) -> None:
        """Have room for so many of them, which is the same in all tiles: what stands below is level."""
        if lines != self._lines:
            self._lines = lines
            self._fit_words()

    def show_tile(self, tile: Tile, versus: str) -> None:
        """Show a tile, or what is to be seen in its place ("", truth, difference, wipe, blink)."""
        self.tile = tile
        for label, text in ((self._title, tile.title), (self._told, tile.subtitle)):
            label.setText(text)
            label.setToolTip(text)
        versus = versus if versus in ("wipe", "blink") or not tile.default_mode else tile.default_mode
        shown = tile.preview
        if tile.truth is not None and versus == "truth":
            shown = tile.truth
        elif tile.difference is not None and versus == "difference":
            shown = tile.difference
        if shown is not None:
            self.view.show_preview(shown)
        self.view.canvas.setVisible(shown is not None or bool(tile.problem))
        self.view.show_message(tile.problem)
        if shown is not None and tile.truth is not None and versus == "wipe":
            self.view.overlay.show_wipe(tile.truth)
        elif shown is not None and tile.truth is not None and versus == "blink":
            self.view.overlay.show_blink(tile.truth)
        else:
            self.view.overlay.clear()


class TileGrid(QWidget):
    """Shows tiles as large as they fit; `pointed` tells what the pixel under the mouse reads, "" for none."""

    readout_changed = pyqtSignal(str)
    limit_dragged = pyqtSignal(str, float)  # as those of `widgets.colour_bar.Levels`
    limits_fitted = pyqtSignal(object)

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Expanding)
        self._grid = set_spacing(QGridLayout(self), 4)
        self._views: list[TileView] = []
        self._versus = ""
        self.tiles: tuple[Tile, ...] = ()
        self._placed: tuple[tuple[int, int], ...] = ()

    @property
    def views(self) -> tuple[TileView, ...]:
        """Of the tiles that are shown, in their order."""
        return tuple(self._views[: len(self.tiles)])

    def sizeHint(self) -> QSize:  # noqa: N802
        """Room for a few."""
        return QSize(900, 500)

    def minimumSizeHint(self) -> QSize:  # noqa: N802
        """The same however tiles stand: else that changes the room by which it is chosen, and so back and forth."""
        return QSize(*_LEAST_PX)

    def hasHeightForWidth(self) -> bool:  # noqa: N802
        """No, for the same reason: titles that wrap ask for it."""
        return False

    def show_tiles(self, tiles: Sequence[Tile]) -> None:
        """Show these in place of what was shown; one of the same size stays where it was looked at."""
        self.tiles = tuple(tiles)
        while len(self._views) < len(self.tiles):
            self._add()
        for view, tile in zip(self._views, self.tiles, strict=False):
            view.show_tile(tile, self._versus)
        lines = max((view.needed_lines for view in self.views), default=0)
        for view in self.views:
            view.view.colour_bar.setVisible(self._scaled)
            view.reserve_lines(max(lines, _LINES))
        self._place()

    def set_comparison_mode(self, versus: str) -> None:
        """What every tile shows in place of its picture, or beside it."""
        if versus != self._versus:
            self._versus = versus
            self.show_tiles(self.tiles)

    def reset_view(self) -> None:
        """Fit every picture."""
        for view in self.views:
            view.view.reset_view()

    def resizeEvent(self, a0: Any) -> None:  # noqa: N802
        """Another shape has room for another number in a row."""
        super().resizeEvent(a0)
        self._place()

    def _add(self) -> None:
        made = TileView()
        made.view.view_changed.connect(partial(self._looked, made))
        made.view.pixel_hovered.connect(partial(self._point, made))
        made.view.colour_bar.limit_dragged.connect(self.limit_dragged)
        made.view.colour_bar.limits_fitted.connect(self.limits_fitted)
        self._views.append(made)

    @property
    def _scaled(self) -> bool:
        """Whether any of them has a colour bar; those without one keep its room, so that pictures stay level."""
        return any(view.view.preview is not None and view.view.preview.scale is not None for view in self.views)

    def _place(self) -> None:
        """Rows and columns: as the tiles say where rows begin, else so that pictures are largest."""
        columns, beside = self._shape()
        places = _places([tile.starts_row for tile in self.tiles], columns)
        for view in self.views:
            view.place_text(at_side=beside)
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
        """How many stand in a row, and whether their words stand beside the pictures: what makes these largest."""
        apart = [tile.starts_row for tile in self.tiles]
        tall = max((view.view.height_over_width for view in self.views if view.tile.preview is not None), default=0.75)
        words_px = _WORDS_PX + _LEVELS_PX * self._scaled

        def estimate_width(shape: tuple[int, bool]) -> float:
            places, beside = _places(apart, shape[0]) or ((0, 0),), shape[1]
            rows, cols = (1 + max(place[k] for place in places) for k in (0, 1))
            wide_px = self.width() / cols - _RIM_PX - SIDE_TEXT_PX * beside
            high_px = self.height() / rows - (_RIM_PX if beside else words_px)
            return min(wide_px, max(1.0, high_px) / tall) / (_BESIDE_GAINS if beside else 1.0)

        most = 1 if any(apart) else min(_MOST_COLUMNS, max(1, len(apart)))
        return max(((cols, beside) for beside in (False, True) for cols in range(1, most + 1)), key=estimate_width)

    def _looked(self, at: TileView) -> None:
        """What one picture looks at, the others look at, as large."""
        own = at.view.preview
        if own is None or not own.pixel_mm > 0:
            return
        canvas, (rows, cols) = at.view.canvas, own.pixels.shape[:2]
        x_mm = (canvas.centre.x() - 0.5 * cols) * own.pixel_mm
        y_mm = (canvas.centre.y() - 0.5 * rows) * own.pixel_mm
        for other in self.views:
            there = other.view.preview
            if other is at or there is None or not there.pixel_mm > 0:
                continue
            high, wide = there.pixels.shape[:2]
            centre = QPointF(0.5 * wide + x_mm / there.pixel_mm, 0.5 * high + y_mm / there.pixel_mm)
            other.view.canvas.set_view(centre, canvas.scale / own.pixel_mm * there.pixel_mm)

    def _point(self, at: TileView, row: int, col: int) -> None:
        """A crosshair on the same place of all, with what is read there."""
        own = at.view.preview
        if own is None or row < 0:
            for view in self.views:
                view.view.show_crosshair(None)
            self.readout_changed.emit("")
            return
        shape = own.pixels.shape
        for view in self.views:
            there = view.view.preview
            same = there is not None and there.pixels.shape == shape
            view.view.show_crosshair(
                (row, col) if same else None, there.format_value(row, col) if same and there else ""
            )
        self.readout_changed.emit(f"{at.tile.title} {own.describe_pixel(row, col)}")


def _places(apart: Sequence[bool], columns: int) -> tuple[tuple[int, int], ...]:
    """(row, col) of each tile: `columns` in a row, or as many as stand between those that begin one."""
    told = any(apart)
    places: list[tuple[int, int]] = []
    row = col = 0
    for begins in apart:
        if places and (begins if told else col == columns):
            row, col = row + 1, 0
        places.append((row, col))
        col += 1
    return tuple(places)
