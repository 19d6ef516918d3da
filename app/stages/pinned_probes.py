"""The Probes tab: marks of the pinned pixels in all previews, and a table of value and error of
every stage there.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from PyQt6.QtCore import QEvent

from app.document.feature import Feature
from app.document.session_controller import SessionController
from app.views.pixel_trace import Places
from app.views.stage_previews import StagePreview
from pipeline.core.frozen import frozen
from pipeline.views.preview import Preview
from widgets.stages.probes_panel import ProbeRow
from widgets.style.base import EventListener
from widgets.style.styling import make_single_shot_timer

_DELAY_MS = 40  # shortest interval between updates
_NONE = "\N{EN DASH}"
_NOT_THERE = "not there: the trace ends before"


class PinnedProbesController(Feature):
    """Shows the probe's pins; the errors need the truth of every stage, which is read while the
    tab is visible.
    """

    def __init__(self, controller: SessionController) -> None:
        super().__init__(controller)
        self._panel = self._window.probes
        self._timer = make_single_shot_timer(self, _DELAY_MS, self._show)
        controller.probe.pins_changed.connect(self._update_soon)
        controller.probe.results_changed.connect(self._update_soon)
        self._panel.probe_chosen.connect(controller.probe.choose_pin)
        self._panel.clear_button.clicked.connect(controller.probe.clear_trace)
        EventListener(self._panel, self._update_soon, QEvent.Type.Show, QEvent.Type.Hide)

    def _update_soon(self) -> None:
        if not self._timer.isActive():
            self._timer.start()

    def _show(self) -> None:
        probe = self._controller.probe
        columns = self._columns
        traces = {number: probe.locate(*pixel) for number, pixel in sorted(probe.pins.items())}
        for name, column in columns.items():
            places = {number: at[name] for number, (_, at) in traces.items()}
            marks = [(number, place) for number, place in places.items() if place is not None]
            column.view.canvas.show_marks(tuple(marks))
        is_visible = self._panel.isVisible()
        self._controller.request_extra("truth", wanted=is_visible and bool(traces))
        if is_visible:
            shown = self._list_columns()
            rows = [_make_row(number, places, shown) for number, (_, places) in traces.items()]
            titles = ("probe", *(column.title for column in shown)) if rows else ()
            self._panel.show_probes(titles, rows)

    def _list_columns(self) -> list[_Column]:
        """List what is read at a pixel, the source's position first."""
        shown = [_Column(name="source", title="source pixel")]
        for name in self._window.visible_columns():
            part = self._views.get_shown_stage(name)
            if part is None:
                continue
            title = "source"
            difference = None
            if isinstance(part, StagePreview):
                title = self._controller.catalogue.stage(name).title.lower()
                difference = part.truth_view and part.truth_view.difference_to_truth
            scale = part.preview.scale
            unit = "rgb" if scale is None else scale.unit
            shown.append(_Column(name=name, title=f"{title}, {unit}", preview=part.preview))
            if difference is not None and difference.scale is not None:
                title = f"{title} error, {difference.scale.unit}"
                shown.append(_Column(name=name, title=title, preview=difference, sign="+"))
        return shown


@frozen
class _Column:
    """What the table reads at a pixel: a preview of a stage, or the position itself."""

    name: str  # of the stage
    title: str
    preview: Preview | None = None
    sign: str = ""


def _make_row(number: int, places: Places, columns: Sequence[_Column]) -> ProbeRow:
    cells = [str(number)]
    tips = ["The crosshair stays here while this row is chosen"]
    for column in columns:
        place = places[column.name]
        at = _NONE if place is None else f"({place[1]}, {place[0]})"
        cells.append(_format(column.preview, place, column.sign) if column.preview else at)
        tips.append(_NOT_THERE if place is None else f"pixel {at}")
    return ProbeRow(number=number, cells=tuple(cells), tips=tuple(tips))


def _format(preview: Preview, place: tuple[int, int] | None, sign: str) -> str:
    """Return the number at a pixel without its unit, or its colour."""
    if place is None:
        return _NONE
    value = preview.get_value(*place)
    if value is None:
        return preview.format_value(*place).removeprefix("rgb ") or _NONE
    return f"{value:{sign}.3f}" if math.isfinite(value) else _NONE
