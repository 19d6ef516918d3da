"""The *Basins* tab at work: on request the touch on screen is registered from a grid of starts."""

from __future__ import annotations

import math
from typing import cast

from PyQt6.QtCore import QObject

from app.session.state import Session
from app.window.session_controller import SessionController
from app.work.basin_jobs import BasinMapResult, BasinPosePreview, run_basin_map
from app.work.jobs import LatestJob
from pipeline.base.errors import TouchError
from pipeline.registration.basin_map import ShiftAxis
from pipeline.stages.pose.signed_distances import PoseParams
from widgets.basin_map import BasinCell, get_pose_letter
from widgets.theme import CATEGORY_COLOURS

_HINT = (
    "where this touch's registration ends from 216 starts around its pose: how safe it is, and which others there are"
)


class BasinMapController(QObject):
    """Between the tab and the controller; a map of another frame or of other settings goes."""

    def __init__(self, controller: SessionController) -> None:
        super().__init__(controller)
        self._controller, self._panel = controller, controller.window.basins
        self._job = LatestJob("basins", self)
        self._ticket = 0
        self._begun: Session | None = None
        self.result: BasinMapResult | None = None
        self._panel.map_requested.connect(self._start)
        self._panel.cancel_requested.connect(self._job.cancel)
        self._panel.cell_chosen.connect(self._go)
        self._job.progressed.connect(self._progressed)
        self._job.finished.connect(self._finished)
        self._job.failed.connect(self._failed)
        self._job.cancelled.connect(self._cancelled)
        controller.session_shown.connect(self._session_shown)
        controller.window.connect_command("cancel", self._job.cancel)
        controller.window.connect_command("map_basins", self.open_and_start)
        controller.closing.connect(self._job.close)
        self._panel.show_message(_HINT)

    @property
    def is_busy(self) -> bool:
        """Whether a map is on its way."""
        return not self._job.is_settled

    def open_and_start(self) -> None:
        """Bring the tab to the front and begin."""
        window = self._controller.window
        window.drawers.diagnostics.show()
        window.drawers.diagnostics.raise_()
        window.tabs.setCurrentWidget(self._panel)
        self._start(self._panel.axis_box.currentText())

    def _start(self, along: str) -> None:
        controller = self._controller
        opened, latest, session = controller.views.translation, controller.latest_frame, controller.session
        if opened is None or latest is None or latest.index != session.frame or not controller.is_idle:
            self._panel.show_message("there is no finished frame to map; open a recording, or wait for this one")
            return
        method = next((m for m in opened.methods if m.stage == "pose"), None)
        params = PoseParams() if method is None else session.get_params(method)
        params = params if isinstance(params, PoseParams) else PoseParams()
        results, display, frame, axis = latest.results, session.display, latest.index, cast("ShiftAxis", along)
        self._begun, self.result = session, None
        self._panel.map.show_map((), (), (), "")
        self._panel.show_message("registering")
        self._panel.show_progress(0.0)
        self._ticket = self._job.submit(
            lambda report: run_basin_map(opened, frame, results, display, params, axis, report)
        )

    def _session_shown(self, session: Session) -> None:
        begun = self._begun
        if begun is None or (session.settings == begun.settings and session.frame == begun.frame):
            return
        self._job.cancel()
        self._begun = self.result = None
        self._panel.show_progress(None)
        self._panel.map.show_map((), (), (), "")
        self._panel.show_message(_HINT)

    def _progressed(self, ticket: int, fraction: float, _: str) -> None:
        if ticket == self._ticket and self._begun is not None and self._job.is_busy:
            self._panel.show_progress(fraction)

    def _finished(self, ticket: int, found: object) -> None:
        if ticket != self._ticket or self._begun is None:
            return
        if isinstance(found, BasinPosePreview) and self.result is not None:
            self._controller.views.show_pose(self.result.basins.poses[found.row, found.col], found.preview)
        if not isinstance(found, BasinMapResult):
            return
        self.result, of = found, found.basins
        self._panel.show_progress(None)
        self._panel.show_message(f"frame {found.frame}: {of.summary}; a click goes to an answer")
        cells = [
            [self._cell(found, row, col) for col in range(len(of.rotations_deg))]
            for row in range(len(of.translations_mm))
        ]
        rows, columns = [f"{mm:+.1f} mm" for mm in of.translations_mm], [f"{deg:+.0f}°" for deg in of.rotations_deg]
        self._panel.map.show_map(cells, rows, columns, f"{of.shift_axis}, turn")

    def _cell(self, found: BasinMapResult, row: int, col: int) -> BasinCell:
        of = found.basins
        answer, rmse = int(of.minimum_index[row, col]), float(of.rmse_mm[row, col])
        shift = f"{of.translations_mm[row]:+.1f} mm along {of.shift_axis}"
        start = f"rotated by {of.rotations_deg[col]:+.0f} deg, translated by {shift}"
        if answer < 0:
            return BasinCell(pose_index=answer, rmse_mm=math.nan, tooltip=f"{start}: led nowhere")
        known = of.minima[answer]
        equal = ", fits as well as the pose" if known.fits_equally and answer else ""
        name = f"answer {get_pose_letter(answer)}" if answer < len(CATEGORY_COLOURS) else "a rarer answer"
        ends = f"{name}{equal}, rmse {rmse:.3f} mm, {known.n_starts} starts end there"
        return BasinCell(pose_index=answer, rmse_mm=rmse, tooltip=f"{start}: {ends}")

    def _go(self, row: int, col: int) -> None:
        """Show the pose that a start ended in, until the next frame."""
        found = self.result
        if found is None:
            return
        self._controller.views.show_pose(found.basins.poses[row, col], None)
        self._ticket = self._job.submit(
            lambda _: BasinPosePreview(row=row, col=col, preview=found.make_preview(row, col))
        )
        self._panel.show_message(f"{self._panel.map.cells[row][col].tooltip}; it is shown until the next frame")

    def _failed(self, ticket: int, error: object) -> None:
        if ticket != self._ticket or not isinstance(error, BaseException):
            return
        self._begun = None
        self._panel.show_progress(None)
        self._panel.show_message(str(error))
        if not isinstance(error, TouchError):
            self._controller.show_problem(error)

    def _cancelled(self, ticket: int) -> None:
        if ticket == self._ticket and self._begun is not None:
            self._begun = None
            self._panel.show_progress(None)
            self._panel.show_message("stopped")
