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

from app.frame.actions import ARRANGE, EDIT, FILE, HELP, PLAY, THEME, VERSUS, VIEW, make_actions, stage_commands
from app.frame.arranged import arrange, arranged
from app.frame.bars import build_menus, build_tool_bar
from app.frame.drawers import Drawers
from app.session.layout import LAYOUTS, Layout, Own
from widgets.alignment_panel import AlignmentPanel
from widgets.banner import Banner
from widgets.basin_map import BasinPanel
from widgets.compare_page import ComparePage
from widgets.frames_panel import FramesPanel
from widgets.log_panel import LogPanel
from widgets.looks import spaced
from widgets.panes import PanesPage
from widgets.parameters_panel import ParametersPanel
from widgets.picture_row import PictureRow
from widgets.section_panel import SectionPanel
from widgets.solid_cell import SolidCell
from widgets.solid_view import SolidView
from widgets.stage_column import StageColumn
from widgets.steps import StepsSlider
from widgets.steps_panel import StepsPanel
from widgets.still_label import StillLabel
from widgets.sweep_page import SweepPage
from widgets.timeline import Timeline
from widgets.timings_panel import TimingsPanel
from widgets.trace_panel import TracePanel
from widgets.warning_line import WarningLine
from widgets.waterfall import BlamePanel

SIZE = QSize(1600, 950)
_DOING_PX = 260  # for what the background does, in words
LOW_STRIP_PX, HIGH_STRIP_PX, MOST_STRIP = 24, 44, 0.125  # of the errors; of the window: higher bars tell no more


class Window(QMainWindow):
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
            self, FILE + EDIT + PLAY + VIEW + VERSUS + ARRANGE + THEME + stage_commands(titles) + HELP
        )
        self.columns = {name: StageColumn(name, f"{i + 1} · {title}") for i, (name, title) in enumerate(columns)}
        self.banner, self.timeline = Banner(), Timeline()
        self.steps = {name: StepsSlider(name) for name in sorted(scrubbed)}  # under the 3D views of these columns
        self.frames, self.parameters, self.alignment = FramesPanel(), ParametersPanel(), AlignmentPanel()
        self.trace, self.log, self.timings, self.blame = TracePanel(), LogPanel(), TimingsPanel(), BlamePanel()
        self.basins, self.step_tab, self.section_tab = BasinPanel(), StepsPanel(), SectionPanel()
        self._alone, self._off_route, self.layout_shown = "", frozenset[str](), Layout()
        self.cells = {name: SolidCell(self.steps.get(name)) for name, _ in columns}
        self.truth, self.truth_cell = StageColumn("truth", "Truth"), SolidCell()  # of the touch, for demonstrations
        self.warning = WarningLine()
        self.pages, self.rows, self.sweep, self.compare = QStackedWidget(), PictureRow(), SweepPage(), ComparePage()
        self.panes = PanesPage({name: f"{i + 1} · {title}" for i, (name, title) in enumerate(columns)})
        self.source, self.target, self.route = (self._chooser(n) for n in ("source", "target", "route"))
        self._build_centre()
        self._build_drawers()
        self.menus = build_menus(self, self.actions_by_name, len(self.columns), self.drawers.all)
        choosers = ("source", self.source), ("target", self.target), ("route", self.route)
        build_tool_bar(self, self.actions_by_name, choosers, self.timeline)
        self._build_status()

    def _take_room(self) -> None:
        """As large as wanted, but no larger than the screen."""
        screen = self.screen()
        self.resize(SIZE if screen is None else SIZE.boundedTo(screen.availableSize()))

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
        for page in (self.rows, self.panes, self.sweep, self.compare):
            self.pages.addWidget(page)
        self.rows.spare_found.connect(self._share_spare)
        centre = QWidget()
        layout = spaced(QVBoxLayout(centre), 2, (2, 2, 2, 0))
        self._strips = spaced(QVBoxLayout(), 2)
        layout.addLayout(self._strips)
        layout.addWidget(self.banner)
        layout.addWidget(self.pages, 1)
        layout.addWidget(self.warning)
        layout.addWidget(self.timeline)
        layout.addWidget(self.trace)
        self.setCentralWidget(centre)

    def _share_spare(self, spare_px: int) -> None:
        """What pictures and 3D views do not need is the errors'."""
        strip = self.timeline.errors  # counted from its height now: what was asked for may not be laid out yet
        if abs(spare_px) > 1:
            most_px = round(MOST_STRIP * self.height())
            strip.show_high(min(max(strip.height() + spare_px, LOW_STRIP_PX), most_px))

    def _build_drawers(self) -> None:
        for name in ("open_alignment", "save_alignment"):
            self.alignment.add_command(self.actions_by_name[name])
        self.tabs = QTabWidget()
        self.tabs.setObjectName("reading_tabs")
        self.tabs.setDocumentMode(True)
        tabs = (
            (self.blame, "Blame"),
            (self.section_tab, "Section"),
            (self.step_tab, "Steps"),
            (self.basins, "Basins"),
            (self.log, "Log"),
            (self.timings, "Timings"),
        )
        for widget, title in tabs:
            self.tabs.addTab(widget, title)
        for name in ("hold_settings", "hold_recording", "let_go"):
            self.compare.add_command(self.actions_by_name[name])
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
        self.probe, self.doing, self.bar, self.stop = StillLabel(), QLabel(), QProgressBar(), QPushButton("Cancel")
        self.probe.setObjectName("probe")
        self.bar.setRange(0, 1000)
        self.bar.setFixedWidth(140)
        self.doing.setFixedWidth(_DOING_PX)
        self.doing.setAlignment(Qt.AlignmentFlag.AlignRight | Qt.AlignmentFlag.AlignVCenter)
        for widget in (self.bar, self.stop):  # nothing moves when work begins and ends
            room = widget.sizePolicy()
            room.setRetainSizeWhenHidden(True)
            widget.setSizePolicy(room)
        self.bar.setTextVisible(False)
        self.stop.setObjectName("cancel_button")
        status = self.statusBar()
        assert status is not None
        status.addWidget(self.probe, 1)
        for widget in (self.bar, self.stop, self.doing):
            status.addPermanentWidget(widget)
        self.show_progress(None)

    def show_progress(self, fraction: float | None, text: str = "") -> None:
        """What the background does, None when it rests."""
        for widget in (self.bar, self.stop):
            widget.setVisible(fraction is not None)
        self.doing.setText(text if fraction is not None else "ready")
        if fraction is not None:
            self.bar.setValue(round(1000 * fraction))

    @property
    def solids(self) -> tuple[SolidView, ...]:
        """The 3D views: one a column, then the truth's, then those of two sessions at once."""
        return (
            *(cell.view for cell in self.cells.values()),
            self.truth_cell.view,
            *(c.view for c in self.compare.solids),
        )

    def show_only(self, name: str | None) -> None:
        """Show one column alone, or all of the route for None."""
        self._alone = name or ""
        self.show_layout(self.layout_shown)

    def leave_out(self, names: frozenset[str]) -> None:
        """Hide the columns that the route does not have."""
        self._off_route = names
        self._alone = "" if self._alone in names else self._alone
        self.panes.leave_out(names)
        self.show_layout(self.layout_shown)

    def arranged(self, name: str) -> Own:
        """How the window stands, under a name."""
        return arranged(self, name, self._alone)

    def show_layout(self, layout: Layout, *, anew: bool = False) -> None:
        """Arrange the columns; a user's own arrangement also what it came with, where it is another or wanted anew."""
        begins = layout.own is not None and (anew or layout.own != self.layout_shown.own)
        self.layout_shown = layout
        if begins and layout.own is not None:
            self._alone = layout.own.alone if layout.own.alone in self.here else ""
        pairs = {name: (column, self.cells[name]) for name, column in self.columns.items()}
        if layout.name == "inspect":
            panes = layout.panes_of(self.here)
            self.panes.take([(name, *pairs[name], dims) for name, dims in panes])
            shown = [name for name, _ in panes]
        else:
            self.panes.let_go()
            few = layout.name in ("align", "demo")
            self.rows.take((*pairs.values(), (self.truth, self.truth_cell)), wide=few)
            shown = layout.columns_of(self.here, self._alone)
        for name, widgets in pairs.items():
            for widget in widgets:
                if layout.name != "inspect" or name not in shown:
                    widget.setVisible(name in shown)
        for widget in (self.truth, self.truth_cell):
            widget.setVisible(layout.name == "demo")
        self.rows.below.setVisible(layout.name != "align")
        pages = {"inspect": self.panes, "sweep": self.sweep, "compare": self.compare}
        self.pages.setCurrentWidget(pages.get(layout.name, self.rows))
        if layout.name not in ("stages", "demo"):  # in these, as high as the rows leave it
            self.timeline.errors.show_high(HIGH_STRIP_PX if layout.name == "inspect" else LOW_STRIP_PX)
        for i, key in enumerate(self.columns):
            action = self.actions_by_name[f"only_{i + 1}"]
            action.setChecked(layout.name == "stages" and key == self._alone)
            action.setEnabled(key in self.here)
        for name in LAYOUTS:
            self.actions_by_name[f"layout_{name}"].setChecked(name == layout.name)
        if begins and layout.own is not None and not arrange(self, layout.own):
            self.banner.show_problem(f"the drawers of {layout.own.name!r} were kept by another version and stay closed")

    @property
    def here(self) -> list[str]:
        """The columns that the route has."""
        return [name for name in self.columns if name not in self._off_route]

    def visible_columns(self) -> tuple[str, ...]:
        """The stages that somebody can see, in large or in small."""
        inspected = self.layout_shown.name == "inspect"
        return tuple(self.here if inspected else self.layout_shown.columns_of(self.here, self._alone))

    def on(self, name: str, what: Callable[[], object]) -> None:
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
