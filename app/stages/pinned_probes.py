"""The Probes tab: marks of the pinned pixels in all previews, and a table of value and error of
every stage there.
"""

import math

from PyQt6.QtCore import QEvent

from app.document.feature import Feature
from app.document.session_controller import SessionController
from app.views.pixel_trace import Places
from app.views.stage_previews import StagePreview
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
        columns = self._window.columns
        traces = {number: probe.locate(*pixel) for number, pixel in sorted(probe.pins.items())}
        for name, column in columns.items():
            marks = [
                (number, place)
                for number, (_, places) in traces.items()
                if (place := places[name]) is not None
            ]
            column.view.canvas.show_marks(tuple(marks))
        is_visible = self._panel.isVisible()
        self._controller.request_extra("truth", wanted=is_visible and bool(traces))
        if is_visible:
            names = [
                name
                for name in self._window.visible_columns()
                if self._get_preview(name) is not None
            ]
            titles = ["probe", *(title for name in names for title in self._make_titles(name))]
            rows = [
                ProbeRow(number=number, **self._make_cells(number, places, names))
                for number, (_, places) in traces.items()
            ]
            self._panel.show_probes(titles if rows else (), rows)

    def _get_preview(self, name: str) -> Preview | None:
        part = self._controller.views.get_shown_stage(name)
        return None if part is None else part.preview

    def _get_difference(self, name: str) -> Preview | None:
        """Return the difference of a stage to its truth; None where that is not known."""
        part = self._controller.views.get_shown_stage(name)
        other = part.truth_view if isinstance(part, StagePreview) else None
        return None if other is None else other.difference_to_truth

    def _make_titles(self, name: str) -> list[str]:
        preview = self._get_preview(name)
        difference = self._get_difference(name)
        title = (
            "source" if name == "source" else self._controller.catalogue.stage(name).title.lower()
        )
        unit = "rgb" if preview is None or preview.scale is None else preview.scale.unit
        titles = [f"{title} pixel"] if name == "source" else []
        titles.append(f"{title}, {unit}")
        return (
            titles
            if difference is None or difference.scale is None
            else [*titles, f"{title} error, {difference.scale.unit}"]
        )

    def _make_cells(
        self, number: int, places: Places, names: list[str]
    ) -> dict[str, tuple[str, ...]]:
        cells = [str(number)]
        tips = ["The crosshair stays here while this row is chosen"]
        for name in names:
            preview = self._get_preview(name)
            difference = self._get_difference(name)
            place = places[name]
            texts = (
                []
                if name != "source"
                else [_NONE if place is None else f"({place[1]}, {place[0]})"]
            )
            texts.append(_format(preview, place))
            texts += [] if difference is None else [_format(difference, place, sign="+")]
            tip = _NOT_THERE if place is None else f"pixel ({place[1]}, {place[0]})"
            cells = [*cells, *texts]
            tips = [*tips, *[tip] * len(texts)]
        return {"cells": tuple(cells), "tips": tuple(tips)}


def _format(preview: Preview | None, place: tuple[int, int] | None, sign: str = "") -> str:
    """Return the number at a pixel without its unit, or its colour."""
    if preview is None or place is None:
        return _NONE
    value = preview.get_value(*place)
    if value is None:
        return preview.format_value(*place).removeprefix("rgb ") or _NONE
    return f"{value:{sign}.3f}" if math.isfinite(value) else _NONE
