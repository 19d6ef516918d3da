"""Menus, tool bar, drawers with their icon rail, and the buttons of the timeline."""

from collections.abc import Iterable, Mapping, Sequence

from PyQt6.QtCore import QSize, Qt
from PyQt6.QtGui import QAction
from PyQt6.QtWidgets import (
    QDockWidget,
    QLabel,
    QMainWindow,
    QMenu,
    QTabWidget,
    QToolBar,
    QToolButton,
    QWidget,
)

from app.window.actions import MENUS, REFERENCE_COMMANDS, THEME_COMMANDS
from widgets.shell.command_bar import ActionTabs, CommandBar, name_extension
from widgets.style.icons import make_command_icon
from widgets.timeline.timeline import Timeline

REFERENCE = "Reference"  # title of the menu inside the File menu and of its button in the tool bar
_TOOLS = (
    "open_recording",
    "open_folder",
    "open_mesh",
    REFERENCE,
    "export",
    "",
    "undo",
    "redo",
    "",
    "link_cameras",
    "reset_view",
    "pin_probe",
    "section_line",
    "",
    "show_truth",
    "show_difference",
    "show_wipe",
    "show_blink",
)
_AFTER_SEPARATOR = frozenset(
    (
        "open_mesh",
        "save_session",
        "export",
        "quit",
        "reset_all",
        "copy_image",
        "back_10",
        "only_1",
        "toggle_inspect",
        "set_variant_settings",
        "edit_alignment",
        "step_through",
        "open_track",
    )
)
# Buttons that get their text next to the icon while there is room, the first ones first.
_TEXT_ORDER = (
    "open_recording",
    "open_mesh",
    "pin_probe",
    "export",
    "section_line",
    "show_difference",
    "show_truth",
    "show_wipe",
    "show_blink",
    "link_cameras",
    "reset_view",
    "open_folder",
    "undo",
    "redo",
)
_AREA = Qt.DockWidgetArea
_SIDE_PX = {_AREA.LeftDockWidgetArea: 360, _AREA.RightDockWidgetArea: 290}
_MAX_SIDE_SHARE = 0.2  # of the window's width, for the frames table
# height of the bottom drawer, and its largest share of the window
_BOTTOM_PX = 210
_MAX_BOTTOM_SHARE = 0.25


def build_menus(
    window: QMainWindow,
    actions: Mapping[str, QAction],
    n_columns: int,
    drawers: Iterable[QDockWidget],
) -> dict[str, QMenu]:
    """Create the menus, with every command once; title -> menu."""
    bar = window.menuBar()
    menus = dict[str, QMenu]()
    assert bar is not None
    name_extension(bar)
    for text, commands in MENUS.items():
        title = text.replace("&", "")
        menu = menus[title] = QMenu(text, bar)
        bar.addMenu(menu)
        names = [command.name for command in commands]
        names += [f"only_{i + 1}" for i in range(n_columns)] if title == "View" else []
        for name in names:
            if name in _AFTER_SEPARATOR:
                menu.addSeparator()
            if name == "open_calibration":
                menus[REFERENCE] = _add_reference_menu(menu, actions)
            menu.addAction(actions[name])
        if title == "View":
            menu.addSeparator()
            for drawer in drawers:
                menu.addAction(drawer.toggleViewAction())
            menu.addSeparator()
            menu.addActions([actions[command.name] for command in THEME_COMMANDS])
    return menus


def _add_reference_menu(menu: QMenu, actions: Mapping[str, QAction]) -> QMenu:
    references = QMenu(REFERENCE, menu)
    references.addActions([actions[command.name] for command in REFERENCE_COMMANDS])
    entry = menu.addMenu(references)
    assert entry is not None
    entry.setIcon(make_command_icon("file"))
    entry.setToolTip("Choose the reference of the source sensor")
    return references


def add_layout_tabs(window: QMainWindow, layouts: Sequence[QAction]) -> ActionTabs:
    """Add one tab per layout at the right of the menu bar, where they take no height."""
    bar = window.menuBar()
    assert bar is not None
    bar.setNativeMenuBar(False)
    tabs = ActionTabs(layouts, "layout")
    bar.setCornerWidget(tabs, Qt.Corner.TopRightCorner)
    return tabs


def build_tool_bar(
    window: QMainWindow,
    actions: Mapping[str, QAction],
    references: QMenu,
    choosers: Sequence[tuple[str, QWidget]],
    timeline: Timeline,
) -> None:
    """Create the tool bar with the Reference menu and `choosers` (label, widget), and the
    buttons of the timeline.
    """
    entry = references.menuAction()
    assert entry is not None
    bar = CommandBar("Commands", window)
    bar.setObjectName("tool_bar")
    bar.setMovable(False)
    bar.setIconSize(QSize(20, 20))
    window.addToolBar(bar)
    for name in _TOOLS:
        if name:
            bar.addAction(entry if name == REFERENCE else actions[name])
        else:
            bar.addSeparator()
    button = bar.widgetForAction(entry)
    assert isinstance(button, QToolButton)
    button.setPopupMode(QToolButton.ToolButtonPopupMode.InstantPopup)
    bar.addSeparator()
    for label, box in choosers:
        word = QLabel(f"  {label} ")
        word.setBuddy(box)
        bar.addWidget(word)
        bar.addWidget(box)
    bar.set_text_order([actions[name] for name in _TEXT_ORDER])
    for name in ("first", "previous", "play", "next", "last"):
        timeline.add_command(actions[name])
    timeline.add_command(actions["loop"])


class Drawers:
    """Frames at the left, parameters and alignment at the right, diagnostics at the bottom."""

    def __init__(
        self,
        window: QMainWindow,
        *,
        frames: QWidget,
        parameters: QWidget,
        alignment: QWidget,
        diagnostics: QTabWidget,
    ) -> None:
        self._window = window
        self.rail = QToolBar("Drawers", window)
        self.rail.setObjectName("rail")
        self.rail.setMovable(False)
        name_extension(self.rail)
        self.rail.setIconSize(QSize(20, 20))
        window.addToolBar(Qt.ToolBarArea.LeftToolBarArea, self.rail)
        self.frames = self._add_drawer("Frames", frames, _AREA.LeftDockWidgetArea, "table", "F2")
        self.parameters = self._add_drawer(
            "Parameters", parameters, _AREA.RightDockWidgetArea, "sliders", "F3"
        )
        self.alignment = self._add_drawer(
            "Alignment", alignment, _AREA.RightDockWidgetArea, "axes", "F4"
        )
        self.diagnostics = self._add_drawer(
            "Diagnostics", diagnostics, _AREA.BottomDockWidgetArea, "lines", "F5"
        )
        window.tabifyDockWidget(self.parameters, self.alignment)
        window.setCorner(Qt.Corner.BottomLeftCorner, _AREA.LeftDockWidgetArea)
        window.setCorner(Qt.Corner.BottomRightCorner, _AREA.RightDockWidgetArea)
        for drawer in self.all_drawers:
            drawer.hide()

    @property
    def all_drawers(self) -> tuple[QDockWidget, ...]:
        """Every drawer, in the order of the rail."""
        return self.frames, self.parameters, self.alignment, self.diagnostics

    def _add_drawer(
        self, title: str, widget: QWidget, area: Qt.DockWidgetArea, icon: str, key: str
    ) -> QDockWidget:
        drawer = QDockWidget(title, self._window)
        drawer.setObjectName(f"dock_{title.lower()}")
        drawer.setWidget(widget)
        self._window.addDockWidget(area, drawer)
        action = drawer.toggleViewAction()
        assert action is not None
        action.setIcon(make_command_icon(icon))
        action.setShortcut(key)
        action.setToolTip(f"{title} ({key})")
        action.triggered.connect(lambda: self._fit_drawer(drawer))
        self._window.addAction(action)
        self.rail.addAction(action)
        button = self.rail.widgetForAction(action)
        if button is not None:
            button.setFocusPolicy(Qt.FocusPolicy.TabFocus)
            button.setAccessibleName(title)
        return drawer

    def _fit_drawer(self, drawer: QDockWidget) -> None:
        """Raise an opened drawer, and give it its default width or height."""
        if drawer.isHidden():
            return
        drawer.raise_()
        area = self._window.dockWidgetArea(drawer)
        if area in _SIDE_PX:
            most_px = round(_MAX_SIDE_SHARE * self._window.width())
            width_px = min(_SIDE_PX[area], max(most_px, _SIDE_PX[_AREA.RightDockWidgetArea]))
            self._window.resizeDocks([drawer], [width_px], Qt.Orientation.Horizontal)
        else:
            height_px = min(_BOTTOM_PX, round(_MAX_BOTTOM_SHARE * self._window.height()))
            self._window.resizeDocks([drawer], [height_px], Qt.Orientation.Vertical)
