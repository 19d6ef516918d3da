"""The Basins tab: on request, the frame on screen is registered from a grid of start poses."""

import math
from typing import cast

from app.session.state import Session
from app.window.background_controller import BackgroundController
from app.window.session_controller import SessionController
from app.work.basin_jobs import BasinMapResult, run_basin_map
from pipeline.previews.preview import Preview
from pipeline.registration.basin_map import ShiftAxis
from pipeline.stages.pose.signed_distances import PoseParams
from widgets.basin_map import BasinCell, get_pose_letter
from widgets.theme import CATEGORY_COLOURS

_HINT = "Registers this frame from 216 start poses around its pose, and shows which pose each start converges to."


class BasinMapController(BackgroundController):
    """Connects the tab with the session; a map of another frame or of other settings is dropped."""

    shows_errors = True

    def __init__(self, controller: SessionController) -> None:
        self._panel = controller.window.basins
        super().__init__("basins", controller, self._panel.run_bar)
        self._session: Session | None = None  # of the map, or of the one that is computed
        self.result: BasinMapResult | None = None
        self._panel.run_bar.start_button.clicked.connect(self._start_map)
        self._panel.map.cell_chosen.connect(self._show_pose)
        controller.window.connect_command("cancel", self.cancel)
        controller.window.connect_command("map_basins", self.open_and_start)
        self._panel.message.setText(_HINT)

    def open_and_start(self) -> None:
        """Show the tab and compute the map."""
        self._controller.window.show_diagnostics(self._panel)
        self._start_map()

    def _start_map(self) -> None:
        controller = self._controller
        opened, latest, session = controller.views.translation, controller.latest_frame, controller.session
        if opened is None or latest is None or latest.index != session.frame or not controller.is_idle:
            self._panel.message.setText("No finished frame to map. Open a recording, or wait for this frame.")
            return
        method = next((m for m in opened.methods if m.stage == "pose"), None)
        params = PoseParams() if method is None else session.get_params(method)
        params = params if isinstance(params, PoseParams) else PoseParams()
        results, display, frame, axis = (
            latest.results,
            session.display,
            latest.index,
            cast("ShiftAxis", self._panel.axis_box.choice),
        )
        self._clear("registering")
        self._session = session
        self.start(lambda report: run_basin_map(opened, frame, results, display, params, axis, report))

    def show_session(self, session: Session) -> None:
        """Drop a map of another frame or of other settings."""
        mapped = self._session
        if mapped is not None and (session.settings != mapped.settings or session.frame != mapped.frame):
            self.abandon()
            self._clear(_HINT)

    def _clear(self, message: str) -> None:
        self._session = self.result = None
        self._panel.map.show_map({}, ("", ()), ("", ()))
        self._panel.message.setText(message)

    def show_result(self, result: object) -> None:
        """Show the map, or the pose of a start."""
        if isinstance(result, Preview) and self.result is not None:
            self._controller.views.show_pose(self.result.basins.poses[self._panel.map.used_cell], result)
        if not isinstance(result, BasinMapResult):
            return
        self.result, basins = result, result.basins
        self._panel.message.setText(f"frame {result.frame}: {basins.summary}; click a cell to show its pose")
        n_rows, n_cols = len(basins.translations_mm), len(basins.rotations_deg)
        cells = {(row, col): _make_cell(result, row, col) for row in range(n_rows) for col in range(n_cols)}
        down = basins.shift_axis, [f"{mm:+.1f} mm" for mm in basins.translations_mm]
        self._panel.map.show_map(cells, ("rotation", [f"{deg:+.0f}°" for deg in basins.rotations_deg]), down)

    def _show_pose(self, row: int, col: int) -> None:
        """Show the pose that a start converged to, until the next frame."""
        result = self.result
        if result is not None:
            self._controller.views.show_pose(result.basins.poses[row, col], None)
            self.start(lambda _: result.make_preview(row, col), shows_progress=False)
            self._panel.message.setText(f"{self._panel.map.cells[row, col].tooltip}; shown until the next frame")

    def show_failure(self, error: BaseException) -> None:
        """Show the error in the tab."""
        self._panel.message.setText(str(error))

    def show_cancelled(self) -> None:
        """Show in the tab that the map was cancelled."""
        if self.result is None:
            self._clear("cancelled")


def _make_cell(result: BasinMapResult, row: int, col: int) -> BasinCell:
    basins = result.basins
    index, rmse_mm = int(basins.minimum_index[row, col]), float(basins.rmse_mm[row, col])
    angle_deg, distance_mm = basins.rotations_deg[col], basins.translations_mm[row]
    start = f"rotation {angle_deg:+.0f}°, translation {distance_mm:+.1f} mm along {basins.shift_axis}"
    if index < 0:
        return BasinCell(pose_index=index, rmse_mm=math.nan, tooltip=f"{start}: did not converge")
    pose = basins.minima[index]
    equal = ", fits as well as the result" if pose.fits_equally and index else ""
    name = f"pose {get_pose_letter(index)}" if index < len(CATEGORY_COLOURS) else "a rarer pose"
    end = f"{name}{equal}, RMSE {rmse_mm:.3f} mm, reached from {pose.n_starts} starts"
    return BasinCell(pose_index=index, rmse_mm=rmse_mm, tooltip=f"{start}: {end}")
