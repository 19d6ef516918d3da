"""The main window: lays out all widgets, without access to the pipeline."""

from collections.abc import Callable, Mapping, Sequence
from itertools import chain
from pathlib import Path

from PyQt6.QtCore import QEvent, QSize, Qt, pyqtSignal
from PyQt6.QtGui import QAction, QCloseEvent, QDragEnterEvent, QDropEvent
from PyQt6.QtWidgets import (
    QComboBox,
    QDockWidget,
    QLabel,
    QMainWindow,
    QStackedWidget,
    QStatusBar,
    QTabWidget,
    QToolBar,
    QVBoxLayout,
    QWidget,
)

from app.session.layout import LAYOUT_NAMES, Layout
from app.window.actions import (
    MENUS,
    REFERENCE_COMMANDS,
    THEME_COMMANDS,
    make_actions,
    make_stage_commands,
)
from app.window.menus import build_menus, build_tool_bar, make_drawers
from widgets.align.alignment_panel import AlignmentPanel
from widgets.compare.comparison_page import ComparisonPage
from widgets.folder.folder_page import FolderPage
from widgets.frames.error_attribution_panel import ErrorAttributionPanel
from widgets.frames.frames_panel import FramesPanel
from widgets.shell.banner import Banner
from widgets.shell.command_bar import ActionTabs
from widgets.shell.inspector import Inspector
from widgets.shell.log_panel import LogPanel
from widgets.shell.message_bell import MessageBell
from widgets.shell.panes import LookPage
from widgets.stages.parameters_panel import ParametersPanel
from widgets.stages.probes_panel import ProbesPanel, TracePanel
from widgets.stages.section_panel import SectionPanel
from widgets.stages.stage_column import StageColumn
from widgets.stages.steps_panel import StepsPanel
from widgets.stages.verdict_line import VerdictLine
from widgets.style.base import ChoiceBox, EventListener
from widgets.style.notification_bar import NotificationBar
from widgets.style.run_bar import RunBar
from widgets.style.styling import fill, set_spacing
from widgets.task.task_page import TaskPage
from widgets.timeline.timeline import Timeline
from widgets.track.track_page import TrackPage
from widgets.views.view_3d import View3D
from widgets.views.view_3d_panel import ScenePanel, View3DPanel

DEFAULT_SIZE = QSize(1600, 950)
_FRAME = QSize(2, 40)  # that a desktop draws around a window: borders and title bar
# width of a sensor chooser; of its list, which cuts no name off
_CHOOSER_LETTERS = 9
_SENSOR_LIST_PX = 240
_INSPECTOR_FROM_PX = 1400  # a narrower page folds the inspector
_STATUS_PX = 4  # of the status bar around its highest part: it never moves the panes
_SAY_MS = 5000  # until a sentence of the status bar leaves


class MainWindow(QMainWindow):
    """Verdict over the page of a layout over the timeline, surrounded by drawers."""

    paths_dropped = pyqtSignal(list)  # of Path
    closing = pyqtSignal()
    _put_away: Sequence[QWidget] = ()  # by a presentation

    def __init__(self, columns: Mapping[str, str]) -> None:
        """`columns` has the title of each by its name."""
        super().__init__()
        self.setWindowTitle("Tactoscope[*]")
        screen = self.screen()
        self.resize(DEFAULT_SIZE.boundedTo(screen.availableSize()) if screen else DEFAULT_SIZE)
        self.setAcceptDrops(True)
        self.setDockNestingEnabled(True)
        self.may_close: Callable[[], bool] = lambda: True  # called before the window closes
        in_menus = chain(*MENUS.values(), REFERENCE_COMMANDS, THEME_COMMANDS)
        commands = *in_menus, *make_stage_commands(columns.values())
        self.actions_by_name: Mapping[str, QAction] = make_actions(self, commands)
        numbered = {name: f"{i + 1} {columns[name]}" for i, name in enumerate(columns)}
        self.columns = {name: StageColumn(name, title) for name, title in numbered.items()}
        self.banner = Banner()
        self.timeline = Timeline()
        self.frames = FramesPanel()
        self.parameters = ParametersPanel()
        self.alignment = AlignmentPanel()
        self.trace = TracePanel()
        self.log = LogPanel()
        self.probes = ProbesPanel()
        self.error_attribution = ErrorAttributionPanel()
        self.steps_panel = StepsPanel()
        self.section_panel = SectionPanel()
        self._hidden_stages = frozenset[str]()
        self.current_layout = Layout()
        self.view_panels = {name: View3DPanel() for name in numbered}
        self.scene_panel = ScenePanel()
        self.verdict = VerdictLine()
        self.pages = QStackedWidget()
        self.comparison = ComparisonPage()
        self.task = TaskPage()
        self.track = TrackPage()
        self.inspector = Inspector(self.parameters, self.error_attribution)
        self.look = LookPage(numbered, self.inspector)
        held = ((c, c.head, self.view_panels[name]) for name, c in self.columns.items())
        for widget in chain(*held, (self.scene_panel,)):  # until a pane shows them
            widget.setParent(self.look)
            widget.hide()
        self.source = _make_sensor_box("source", "the touch is recorded by")
        self.target = _make_sensor_box("target", "the touch is translated into")
        self.route = _make_chooser("route", "Route: which stages lead to the touch of the target")
        self._build_centre()
        self._build_drawers()
        self.menus = build_menus(self, self.actions_by_name, len(self.columns), self.drawers)
        self.scene_panel.offer(self.actions_by_name["press_motion"], self.menus["Scene"])
        layouts = [self.actions_by_name[f"layout_{name}"] for name in LAYOUT_NAMES]
        self.layout_tabs = ActionTabs(layouts, "layout")
        for name in ("track", "task", "folder"):
            self.offer_layout(name, offered=False)
        self._menu_button = build_tool_bar(
            self,
            self.actions_by_name,
            self.menus,
            (self.source, QLabel("→"), self.target, self.route, self.layout_tabs),
            (self.drawers.frames, self.drawers.diagnostics),  # *Align* opens the other
        )
        self._build_status()

    def show_title(self, recording: str, details: str) -> None:
        """Show a recording's name, "" for none, in the title and at the left of the tool bar."""
        parts = filter(None, (f"{recording}[*]" if recording else "", details, "Tactoscope"))
        self.setWindowTitle(" · ".join(parts) if recording else "Tactoscope[*]")
        self._menu_button.setText(f"\N{TRIGRAM FOR HEAVEN} {recording or 'Menu'}")

    def maximize_if_tight(self) -> None:
        """Maximise the window where its default size and a title bar do not fit the screen."""
        screen = self.screen()
        whole = DEFAULT_SIZE + _FRAME
        if screen is not None and whole.boundedTo(screen.availableSize()) != whole:
            self.setWindowState(self.windowState() | Qt.WindowState.WindowMaximized)

    def show_drawer(self, drawer: QDockWidget) -> None:
        """Open a drawer in front of the others."""
        drawer.show()
        drawer.raise_()

    def show_diagnostics(self, tab: QWidget) -> None:
        """Open the diagnostics drawer at a tab."""
        self.show_drawer(self.drawers.diagnostics)
        self.tabs.setCurrentWidget(tab)

    def _build_centre(self) -> None:
        self.folder = FolderPage(self.actions_by_name["open_folder"])
        for page in (self.look, self.comparison, self.track, self.task, self.folder):
            self.pages.addWidget(page)
        self.look.active_changed.connect(self.inspector.show_stage)
        self._is_wide = False
        EventListener(self.look, self._fold_inspector, QEvent.Type.Resize)
        centre = QWidget()
        layout = set_spacing(QVBoxLayout(centre), 4, (4, 4, 4, 0))
        self.strips = set_spacing(QVBoxLayout(), 4)  # what is to be acted on, over no view
        self.bell = MessageBell()
        self.add_notification(self.banner)
        fill(layout, self.strips, self.verdict, (self.pages, 1), self.timeline)
        self.setCentralWidget(centre)

    def _build_drawers(self) -> None:
        self.tabs = QTabWidget()
        self.tabs.setObjectName("diagnostic_tabs")
        self.tabs.setAccessibleName("diagnostics")
        self.tabs.setDocumentMode(True)
        self.tabs.addTab(self.probes, "Probes")
        self.tabs.addTab(self.section_panel, "Section")
        self.tabs.addTab(self.steps_panel, "Steps")
        self.tabs.addTab(self.log, "Log")
        for panel, names in (
            (self.alignment, ("open_alignment", "save_alignment")),
            (
                self.comparison,
                ("set_variant_settings", "set_variant_recording", "clear_variant"),
            ),
            (self.task, ("open_rollouts",)),
            (self.track, ("open_track", "export_track")),
            (self.timeline, ("first", "previous", "play", "next", "last", "loop")),
        ):
            for name in names:
                panel.add_command(self.actions_by_name[name])
        self.drawers = make_drawers(self, self.frames, self.alignment, self.tabs)

    def _build_status(self) -> None:
        """The trace at the left; at the right the pixel under the mouse, or what is computed."""
        self.activity_label = QLabel()
        self.run_bar = RunBar("frame")
        self.readout = QLabel()
        self.readout.setObjectName("probe")
        status = self._status = QStatusBar()
        status.setSizeGripEnabled(False)
        status.setFixedHeight(self.run_bar.cancel_button.sizeHint().height() + _STATUS_PX)
        self.setStatusBar(status)
        status.addWidget(self.trace, 1)
        for widget in (self.readout, self.activity_label, self.run_bar, self.bell):
            status.addPermanentWidget(widget)
        self.show_progress(None)
        self.show_pixel("")

    def show_pixel(self, text: str) -> None:
        """Show what is known of the pixel under the mouse; "" for none."""
        self.readout.setText(text)
        self.readout.setVisible(bool(text))

    def say(self, sentence: str) -> None:
        """Show a sentence in place of the trace for a few seconds."""
        self._status.showMessage(sentence, _SAY_MS)
        self.bell.add_message(sentence)

    @property
    def said(self) -> str:
        """The sentence in the status bar; "" while there is none."""
        return self._status.currentMessage()

    def _fold_inspector(self) -> None:
        """Fold the inspector where the page becomes narrow, and unfold it where it becomes wide."""
        is_wide = self.look.width() >= _INSPECTOR_FROM_PX
        if is_wide != self._is_wide:
            self._is_wide = is_wide
            self.actions_by_name["inspector"].setChecked(is_wide)

    def show_inspector(self) -> None:
        """Show *Look* with the inspector."""
        if self.current_layout.name != "look":
            self.actions_by_name["layout_look"].trigger()
        self.actions_by_name["inspector"].setChecked(True)

    def show_inspector_if_checked(self) -> None:
        """Show the inspector, unless its command or the layout hides it."""
        is_shown = self.actions_by_name["inspector"].isChecked() and not self.is_presenting
        self.inspector.setVisible(is_shown and self.current_layout.name == "look")

    def show_progress(self, fraction: float | None, text: str = "") -> None:
        """Show what is being computed; None shows that nothing is."""
        self.run_bar.show_progress(fraction)
        self.activity_label.setText(text if fraction is not None else "ready")
        self.activity_label.setVisible(fraction is not None)

    @property
    def views_3d(self) -> tuple[View3D, ...]:
        """The 3D views: one per column, then the track's, the task's, the scene's."""
        return (
            *(cell.view for cell in self.view_panels.values()),
            self.track.scene.view,
            self.task.scene.view,
            self.scene_panel.view,
        )

    def add_notification(self, bar: NotificationBar) -> None:
        """Add a bar over the pages; what it says stays in the bell."""
        self.strips.addWidget(bar)
        bar.message_shown.connect(self.bell.add_message)

    def offer_layout(self, name: str, *, offered: bool) -> None:
        """Show the tab of a layout, or hide it where there is nothing for it; its command stays."""
        self.layout_tabs.offer(self.actions_by_name[f"layout_{name}"], offered=offered)

    @property
    def is_presenting(self) -> bool:
        """Whether the panes are shown alone."""
        return bool(self._put_away)

    def set_presenting(self, *, on: bool) -> None:
        """Show the panes alone on the full screen, or the whole window again."""
        if on == self.is_presenting:
            return
        put_away = self._put_away
        if on:
            around = *self.findChildren(QToolBar), *self.drawers, self._status
            put_away = [one for one in (*around, self.verdict) if one.isVisible()]
        else:
            self.look.show_titles({})
        self._put_away = put_away if on else ()
        for widget in put_away:
            widget.setVisible(not on)
        self.setWindowState(self.windowState() ^ Qt.WindowState.WindowFullScreen)
        self.show_layout(self.current_layout)

    def hide_stages(self, names: frozenset[str]) -> None:
        """Hide the columns that the route does not compute."""
        self._hidden_stages = names
        self.show_layout(self.current_layout)

    def show_layout(self, layout: Layout) -> None:
        """Show the page of a layout, and stages in its panes."""
        self.current_layout = layout
        pages = {
            "compare": self.comparison,
            "track": self.track,
            "task": self.task,
            "folder": self.folder,
        }
        page = pages.get(layout.name, self.look)
        self.look.filmstrip.hide_stages(self._hidden_stages)
        self.look.filmstrip.setVisible(layout.name == "look" and not self.is_presenting)
        panes = layout.resolve_panes(self.route_columns) if page is self.look else ()
        solid = dict(self.view_panels)
        for name, dims in panes:
            if dims == "scene" or layout.name == "align":
                solid[name] = self.scene_panel
        self.look.show_panes(
            [(name, self.columns[name], solid[name], dims) for name, dims in panes]
        )
        self.show_inspector_if_checked()
        self.pages.setCurrentWidget(page)
        # a task steps through ticks, a folder through recordings
        self.timeline.setVisible(layout.name not in ("task", "folder") and not self.is_presenting)
        for i, key in enumerate(self.columns):
            self.actions_by_name[f"stage_{i + 1}"].setEnabled(key in self.route_columns)
        for name in LAYOUT_NAMES:
            self.actions_by_name[f"layout_{name}"].setChecked(name == layout.name)

    @property
    def route_columns(self) -> list[str]:
        """The columns that the route computes."""
        return [name for name in self.columns if name not in self._hidden_stages]

    def visible_columns(self) -> tuple[str, ...]:
        """The stages that are visible, large or as cards."""
        return tuple(self.current_layout.list_stages(self.route_columns))

    @property
    def active_timeline(self) -> Timeline:
        """The timeline that the playback commands act on."""
        return self.task.ticks if self.current_layout.name == "task" else self.timeline

    @property
    def shows_true_touch(self) -> bool:
        """Whether the generated touch is shown with the recorded one."""
        touch = self.columns.get("touch")
        return self.current_layout.name == "task" or (touch is not None and touch.isVisible())

    def connect_command(self, name: str, function: Callable[[], object]) -> None:
        """Call `function` when a command is triggered."""
        self.actions_by_name[name].triggered.connect(lambda _checked=False: function())

    def dragEnterEvent(self, a0: QDragEnterEvent | None) -> None:  # noqa: N802
        """Accept files and folders."""
        if a0 is not None and _list_paths(a0):
            a0.acceptProposedAction()

    def dropEvent(self, a0: QDropEvent | None) -> None:  # noqa: N802
        """Emit the dropped paths."""
        if a0 is not None and (paths := _list_paths(a0)):
            a0.acceptProposedAction()
            self.paths_dropped.emit(paths)

    def closeEvent(self, a0: QCloseEvent | None) -> None:  # noqa: N802
        """Ask about unsaved changes, then close."""
        if a0 is not None and not self.may_close():
            a0.ignore()
            return
        self.closing.emit()
        super().closeEvent(a0)


def _list_paths(dropped: QDropEvent) -> list[Path]:
    mime = dropped.mimeData()
    urls = () if mime is None else mime.urls()
    return [Path(url.toLocalFile()) for url in urls if url.isLocalFile()]


def _make_chooser(name: str, tip: str) -> ChoiceBox:
    box = ChoiceBox(f"choose_{name.partition(' ')[0]}", name)
    box.setToolTip(tip)
    box.setSizeAdjustPolicy(QComboBox.SizeAdjustPolicy.AdjustToMinimumContentsLengthWithIcon)
    box.setMinimumContentsLength(_CHOOSER_LETTERS)
    return box


def _make_sensor_box(role: str, use: str) -> ChoiceBox:
    box = _make_chooser(f"{role} sensor", f"{role.capitalize()}: the sensor that {use}")
    view = box.view()
    assert view is not None
    view.setMinimumWidth(_SENSOR_LIST_PX)
    return box
