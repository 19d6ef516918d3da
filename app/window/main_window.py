"""The window: where everything stands. It lays widgets out and knows nothing of the pipeline's work."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from PyQt6.QtCore import QSize, Qt, pyqtSignal
from PyQt6.QtGui import QAction, QCloseEvent, QDragEnterEvent, QDropEvent
from PyQt6.QtWidgets import (
    QComboBox,
    QLabel,
    QMainWindow,
    QMenu,
    QProgressBar,
    QPushButton,
    QStackedWidget,
    QTabWidget,
    QVBoxLayout,
    QWidget,
)

from app.session.layout import LAYOUT_NAMES, Arrangement, Layout
from app.window.actions import (
    COMPARISON_MODE_COMMANDS,
    EDIT_COMMANDS,
    FILE_COMMANDS,
    HELP_COMMANDS,
    LAYOUT_COMMANDS,
    PLAYBACK_COMMANDS,
    THEME_COMMANDS,
    VIEW_COMMANDS,
    make_actions,
    make_stage_commands,
)
from app.window.dock_state import capture_arrangement, restore_arrangement
from app.window.drawers import Drawers
from app.window.menus import build_menus, build_tool_bar
from widgets.alignment_panel import AlignmentPanel
from widgets.banner import Banner
from widgets.basin_map import BasinPanel
from widgets.comparison_page import ComparisonPage
from widgets.error_attribution_panel import ErrorAttributionPanel
from widgets.fixed_size_label import FixedSizeLabel
from widgets.frames_panel import FramesPanel
from widgets.log_panel import LogPanel
from widgets.panes import PanesPage
from widgets.parameters_panel import ParametersPanel
from widgets.section_panel import SectionPanel
from widgets.stage_column import StageColumn
from widgets.stage_rows import StageRows
from widgets.steps_panel import StepsPanel
from widgets.steps_slider import StepsSlider
from widgets.styling import set_spacing
from widgets.timeline import Timeline
from widgets.timings_panel import TimingsPanel
from widgets.trace_panel import TracePanel
from widgets.view_3d import View3D
from widgets.view_3d_panel import View3DPanel
from widgets.warning_line import WarningLine

DEFAULT_SIZE = QSize(1600, 950)
_DOING_PX = 260  # for what the background does, in words
MIN_STRIP_PX, INSPECT_STRIP_PX, MAX_STRIP_SHARE = (
    24,
    44,
    0.125,
)  # of the errors; of the window: higher bars tell no more


class MainWindow(QMainWindow):
    """Stage columns over 3D views over the timeline and the trace, with drawers around them."""

    paths_dropped = pyqtSignal(list)  # of Path
    closing = pyqtSignal()

    def __init__(self, columns: Sequence[tuple[str, str]], scrubbed: frozenset[str] = frozenset()) -> None:
        super().__init__()
        self.setWindowTitle("Tactoscope")
        self._take_room()
        self.setAcceptDrops(True)
        self.setDockNestingEnabled(True)
        self.may_close: Callable[[], bool] = lambda: True  # asked before the window goes
        titles = tuple(title for _, title in columns)
        self.actions_by_name: Mapping[str, QAction] = make_actions(
            self,
            FILE_COMMANDS
            + EDIT_COMMANDS
            + PLAYBACK_COMMANDS
            + VIEW_COMMANDS
            + COMPARISON_MODE_COMMANDS
            + LAYOUT_COMMANDS
            + THEME_COMMANDS
            + make_stage_commands(titles)
            + HELP_COMMANDS,
        )
        self.columns = {name: StageColumn(name, f"{i + 1} · {title}") for i, (name, title) in enumerate(columns)}
        self.banner, self.timeline = Banner(), Timeline()
        self.steps = {name: StepsSlider(name) for name in sorted(scrubbed)}  # under the 3D views of these columns
        self.frames, self.parameters, self.alignment = FramesPanel(), ParametersPanel(), AlignmentPanel()
        self.trace, self.log, self.timings, self.error_attribution = (
            TracePanel(),
            LogPanel(),
            TimingsPanel(),
            ErrorAttributionPanel(),
        )
        self.basins, self.steps_panel, self.section_panel = BasinPanel(), StepsPanel(), SectionPanel()
        self._alone, self._off_route, self.current_layout = "", frozenset[str](), Layout()
        self.view_panels = {name: View3DPanel(self.steps.get(name)) for name, _ in columns}
        self.truth_column, self.truth_view_panel = (
            StageColumn("truth", "Truth"),
            View3DPanel(),
        )  # of the touch, for demonstrations
        self.warning_line = WarningLine()
        self.pages, self.rows, self.comparison = QStackedWidget(), StageRows(), ComparisonPage()
        self.panes = PanesPage({name: f"{i + 1} · {title}" for i, (name, title) in enumerate(columns)})
        self.source, self.target, self.route = (self._chooser(n) for n in ("source", "target", "route"))
        self._build_centre()
        self._build_drawers()
        self.menus = build_menus(self, self.actions_by_name, len(self.columns), self.drawers.all_drawers)
        choosers = ("source", self.source), ("target", self.target), ("route", self.route)
        build_tool_bar(self, self.actions_by_name, choosers, self.timeline)
        self._build_status()

    def _take_room(self) -> None:
        """As large as wanted, but no larger than the screen."""
        screen = self.screen()
        self.resize(DEFAULT_SIZE if screen is None else DEFAULT_SIZE.boundedTo(screen.availableSize()))

    def stay_on_screen(self) -> None:
        """Come back from a screen that is gone or has become smaller."""
        screen = self.screen()
        if screen is None or self.isMaximized() or self.isFullScreen():
            return
        room, frame = screen.availableGeometry(), self.frameGeometry()
        edges = frame.size() - self.size()
        self.resize(self.size().boundedTo(room.size() - edges))
        frame = self.frameGeometry()
        left = min(max(frame.left(), room.left()), room.right() + 1 - frame.width())
        top = min(max(frame.top(), room.top()), room.bottom() + 1 - frame.height())
        self.move(max(left, room.left()), max(top, room.top()))

    def add_strip(self, strip: QWidget) -> None:
        """Give a strip its place over the stages."""
        self._strips.addWidget(strip)

    def _build_centre(self) -> None:
        for page in (self.rows, self.panes, self.comparison):
            self.pages.addWidget(page)
        self.rows.spare_height_changed.connect(self._share_spare)
        centre = QWidget()
        layout = set_spacing(QVBoxLayout(centre), 2, (2, 2, 2, 0))
        self._strips = set_spacing(QVBoxLayout(), 2)
        layout.addLayout(self._strips)
        layout.addWidget(self.banner)
        layout.addWidget(self.pages, 1)
        layout.addWidget(self.warning_line)
        layout.addWidget(self.timeline)
        layout.addWidget(self.trace)
        self.setCentralWidget(centre)

    def _share_spare(self, spare_px: int) -> None:
        """What pictures and 3D views do not need is the errors'."""
        strip = self.timeline.errors  # counted from its height now: what was asked for may not be laid out yet
        if abs(spare_px) > 1:
            most_px = round(MAX_STRIP_SHARE * self.height())
            strip.set_height_px(min(max(strip.height() + spare_px, MIN_STRIP_PX), most_px))

    def _build_drawers(self) -> None:
        for name in ("open_alignment", "save_alignment"):
            self.alignment.add_command(self.actions_by_name[name])
        self.tabs = QTabWidget()
        self.tabs.setObjectName("diagnostic_tabs")
        self.tabs.setDocumentMode(True)
        tabs = (
            (self.error_attribution, "Blame"),
            (self.section_panel, "Section"),
            (self.steps_panel, "Steps"),
            (self.basins, "Basins"),
            (self.log, "Log"),
            (self.timings, "Timings"),
        )
        for widget, title in tabs:
            self.tabs.addTab(widget, title)
        for name in ("set_variant_settings", "set_variant_recording", "clear_variant"):
            self.comparison.add_command(self.actions_by_name[name])
        self.drawers = Drawers(
            self, frames=self.frames, parameters=self.parameters, alignment=self.alignment, reading=self.tabs
        )

    def add_menu(self, menu: str, below: QMenu, *, before: str) -> None:
        """Give a menu of its own a place in one of the bar's, before a command."""
        self.menus[menu].insertMenu(self.actions_by_name[before], below)

    def _chooser(self, name: str) -> QComboBox:
        box = QComboBox()
        box.setObjectName(f"choose_{name}")
        box.setAccessibleName(f"{name} sensor" if name != "route" else "route")
        box.setSizeAdjustPolicy(QComboBox.SizeAdjustPolicy.AdjustToContents)
        return box

    def _build_status(self) -> None:
        self.readout, self.activity_label, self.progress_bar, self.cancel_button = (
            FixedSizeLabel(),
            QLabel(),
            QProgressBar(),
            QPushButton("Cancel"),
        )
        self.readout.setObjectName("probe")
        self.progress_bar.setRange(0, 1000)
        self.progress_bar.setFixedWidth(140)
        self.activity_label.setFixedWidth(_DOING_PX)
        self.activity_label.setAlignment(Qt.AlignmentFlag.AlignRight | Qt.AlignmentFlag.AlignVCenter)
        for widget in (self.progress_bar, self.cancel_button):  # nothing moves when work begins and ends
            room = widget.sizePolicy()
            room.setRetainSizeWhenHidden(True)
            widget.setSizePolicy(room)
        self.progress_bar.setTextVisible(False)
        self.cancel_button.setObjectName("cancel_button")
        status = self.statusBar()
        assert status is not None
        status.addWidget(self.readout, 1)
        for widget in (self.progress_bar, self.cancel_button, self.activity_label):
            status.addPermanentWidget(widget)
        self.show_progress(None)

    def show_progress(self, fraction: float | None, text: str = "") -> None:
        """What the background does, None when it rests."""
        for widget in (self.progress_bar, self.cancel_button):
            widget.setVisible(fraction is not None)
        self.activity_label.setText(text if fraction is not None else "ready")
        if fraction is not None:
            self.progress_bar.setValue(round(1000 * fraction))

    @property
    def views_3d(self) -> tuple[View3D, ...]:
        """The 3D views: one a column, then the truth's, then those of two sessions at once."""
        return (
            *(cell.view for cell in self.view_panels.values()),
            self.truth_view_panel.view,
            *(c.view for c in self.comparison.views_3d),
        )

    def show_only(self, name: str | None) -> None:
        """Show one column alone, or all of the route for None."""
        self._alone = name or ""
        self.show_layout(self.current_layout)

    def hide_stages(self, names: frozenset[str]) -> None:
        """Hide the columns that the route does not have."""
        self._off_route = names
        self._alone = "" if self._alone in names else self._alone
        self.panes.hide_stages(names)
        self.show_layout(self.current_layout)

    def capture_arrangement(self, name: str) -> Arrangement:
        """How the window stands, under a name."""
        return capture_arrangement(self, name, self._alone)

    def show_layout(self, layout: Layout, *, anew: bool = False) -> None:
        """Arrange the columns; a user's own arrangement also what it came with, where it is another or wanted anew."""
        begins = layout.arrangement is not None and (anew or layout.arrangement != self.current_layout.arrangement)
        self.current_layout = layout
        if begins and layout.arrangement is not None:
            self._alone = layout.arrangement.only_stage if layout.arrangement.only_stage in self.route_columns else ""
        pairs = {name: (column, self.view_panels[name]) for name, column in self.columns.items()}
        if layout.name == "inspect":
            panes = layout.resolve_panes(self.route_columns)
            self.panes.show_panes([(name, *pairs[name], dims) for name, dims in panes])
            shown = [name for name, _ in panes]
        else:
            self.panes.release_contents()
            few = layout.name in ("align", "demo")
            self.rows.set_columns((*pairs.values(), (self.truth_column, self.truth_view_panel)), wide=few)
            shown = layout.list_columns(self.route_columns, self._alone)
        for name, widgets in pairs.items():
            for widget in widgets:
                if layout.name != "inspect" or name not in shown:
                    widget.setVisible(name in shown)
        for widget in (self.truth_column, self.truth_view_panel):
            widget.setVisible(layout.name == "demo")
        self.rows.lower_row.setVisible(layout.name != "align")
        pages = {"inspect": self.panes, "sweep": self.comparison, "compare": self.comparison}
        self.pages.setCurrentWidget(pages.get(layout.name, self.rows))
        if layout.name not in ("stages", "demo"):  # in these, as high as the rows leave it
            self.timeline.errors.set_height_px(INSPECT_STRIP_PX if layout.name == "inspect" else MIN_STRIP_PX)
        for i, key in enumerate(self.columns):
            action = self.actions_by_name[f"only_{i + 1}"]
            action.setChecked(layout.name == "stages" and key == self._alone)
            action.setEnabled(key in self.route_columns)
        for name in LAYOUT_NAMES:
            self.actions_by_name[f"layout_{name}"].setChecked(name == layout.name)
        if begins and layout.arrangement is not None and not restore_arrangement(self, layout.arrangement):
            self.banner.show_problem(
                f"the drawers of {layout.arrangement.name!r} were kept by another version and stay closed"
            )

    @property
    def route_columns(self) -> list[str]:
        """The columns that the route has."""
        return [name for name in self.columns if name not in self._off_route]

    def visible_columns(self) -> tuple[str, ...]:
        """The stages that somebody can see, in large or in small."""
        inspected = self.current_layout.name == "inspect"
        return tuple(
            self.route_columns if inspected else self.current_layout.list_columns(self.route_columns, self._alone)
        )

    def connect_command(self, name: str, what: Callable[[], object]) -> None:
        """Connect a command."""
        self.actions_by_name[name].triggered.connect(lambda _checked=False: what())

    def dragEnterEvent(self, a0: QDragEnterEvent | None) -> None:  # noqa: N802
        """Take files and folders."""
        if a0 is not None and (mime := a0.mimeData()) is not None and mime.hasUrls():
            a0.acceptProposedAction()

    def dropEvent(self, a0: QDropEvent | None) -> None:  # noqa: N802
        """Say what was dropped."""
        if a0 is None or (mime := a0.mimeData()) is None:
            return
        paths = [Path(url.toLocalFile()) for url in mime.urls() if url.isLocalFile()]
        if paths:
            a0.acceptProposedAction()
            self.paths_dropped.emit(paths)

    def closeEvent(self, a0: QCloseEvent | None) -> None:  # noqa: N802
        """Ask where something would be lost, and let the background come to rest first."""
        if a0 is not None and not self.may_close():
            a0.ignore()
            return
        self.closing.emit()
        super().closeEvent(a0)
