"""Who listens to whom, readable from top to bottom."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar, get_args

from PyQt6.QtCore import Qt
from PyQt6.QtGui import QAction, QKeySequence
from PyQt6.QtWidgets import QMessageBox, QWidget

from app.session.preferences import Theme
from app.session.state import DISPLAY_KEY
from app.window import dialogs
from app.window.actions import format_shortcut_table
from app.window.alignment import AlignmentController
from app.window.alignment_gizmo import AlignmentGizmoController
from app.window.arrangements import ArrangementController
from app.window.autosave import AutosaveController
from app.window.basin_map import BasinMapController
from app.window.colour_limits import ColourLimitController
from app.window.comparison import ComparisonController
from app.window.error_attribution import ErrorAttributionController
from app.window.export import ExportController
from app.window.frame_ranking import FrameRankingController
from app.window.layouts import LayoutController
from app.window.live import LiveController
from app.window.main_window import MainWindow
from app.window.pan_zoom import PanZoomController
from app.window.presentation import PresentationController
from app.window.probe_3d import Probe3DController
from app.window.section_line import SectionLineController
from app.window.session_controller import SessionController
from app.window.shortcuts import KeyboardController
from app.window.step_scrubber import StepScrubberController
from app.window.sweep import SweepController
from app.window.themes import ThemeController
from app.window.welcome import WelcomeController
from pipeline.evaluation.truth_view import ComparisonMode
from pipeline.previews.display_params import DisplayParams
from pipeline.sensors.spec import list_sensor_names
from pipeline.translation.catalogue import Catalogue
from widgets.command_palette import CommandPalette
from widgets.icons import make_command_icon
from widgets.keyboard_focus_filter import KeyboardFocusFilter

T = TypeVar("T")


def connect(instrument: SessionController, theme: Theme = "light") -> AutosaveController:
    """Fill the window's choices and connect everything; returns what outlives the window.

    `theme` is the one that is on.
    """
    window, job, tracer = instrument.window, instrument.job, instrument.probe
    _fill(window, instrument.catalogue)

    job.delivered.connect(instrument.handle_part)
    job.finished.connect(instrument.handle_frame)
    job.failed.connect(instrument.handle_failure)
    job.cancelled.connect(instrument.handle_cancellation)
    job.progressed.connect(instrument.handle_progress)

    instrument.relay.line_logged.connect(window.log.show_line)
    instrument.relay.error_uncaught.connect(instrument.show_problem)

    window.timeline.frame_chosen.connect(instrument.choose_frame)
    window.frames.frame_chosen.connect(instrument.choose_frame)
    window.parameters.params_edited.connect(instrument.choose_params)
    for slider in window.steps.values():
        slider.step_chosen.connect(instrument.views.show_step)
    window.parameters.drag_ended.connect(instrument.refresh)
    for column in window.columns.values():
        column.pixel_hovered.connect(tracer.probe_pixel)
        column.pixel_clicked.connect(tracer.toggle_pin)
        column.method_chosen.connect(instrument.choose_method)
    window.paths_dropped.connect(instrument.open_paths)
    window.cancel_button.clicked.connect(job.cancel)
    window.closing.connect(instrument.close)

    change = instrument.change
    window.source.activated.connect(lambda: change("choose source", source=window.source.currentData(), stream=""))
    window.target.activated.connect(lambda: change("choose target", target=window.target.currentData()))
    window.route.activated.connect(lambda: change("choose route", route=window.route.currentData()))
    ErrorAttributionController(instrument)
    BasinMapController(instrument)
    StepScrubberController(instrument)
    Probe3DController(instrument)
    KeyboardController(instrument)
    SectionLineController(instrument)
    PresentationController(instrument)
    FrameRankingController(instrument)
    sweeping = SweepController(instrument)
    comparing = ComparisonController(instrument)
    keeping = AutosaveController(instrument)
    WelcomeController(instrument, keeping)
    ThemeController(instrument, keeping, theme)
    ArrangementController(instrument, keeping)
    ExportController(instrument, keeping, sweeping)
    LiveController(instrument, keeping)
    aligning = AlignmentController(instrument)
    AlignmentGizmoController(instrument, aligning)
    _connect_files(instrument, aligning, keeping, comparing)
    _connect_play(instrument)
    _connect_view(instrument, LayoutController(instrument))
    _connect_undo(instrument)
    _connect_hands(window)
    return keeping


def _fill(window: MainWindow, catalogue: Catalogue) -> None:
    window.source.addItem("as recorded", "")
    for name in list_sensor_names():
        window.source.addItem(name, name)
        window.target.addItem(name, name)
    for route in catalogue.routes:
        window.route.addItem(route.name, route.name)
        window.route.setItemData(window.route.count() - 1, route.title, Qt.ItemDataRole.ToolTipRole)
    window.route.setEnabled(len(catalogue.routes) > 1)
    for slot in catalogue.stages:
        window.columns[slot.name].offer_methods([(m.name, m.title, m.help) for m in slot.methods])
        for method in slot.methods:
            title = slot.title if len(slot.methods) == 1 else f"{slot.title} · {method.title}"
            window.parameters.add_group(method.key, title, method.params(), method.help)
    window.parameters.add_group(DISPLAY_KEY, "Display", DisplayParams())


def _connect_files(
    instrument: SessionController,
    aligning: AlignmentController,
    keeping: AutosaveController,
    comparing: ComparisonController,
) -> None:
    window = instrument.window

    def connect_dialog(command: str, ask: Callable[[QWidget, str, str], T | None], then: Callable[[T], object]) -> None:
        def ask_and_apply() -> None:
            said = ask(window, command, keeping.dialog_folder)
            if said is not None:
                then(said)

        window.connect_command(command, ask_and_apply)

    own = {
        "open_reference": instrument.open_reference, "open_weights": instrument.open_weights,
        "set_variant_recording": comparing.set_variant_recording,
    }  # fmt: skip
    for command in dialogs.OPEN_DIALOGS:
        connect_dialog(command, dialogs.ask_open_path, own.get(command, instrument.open_path))
    connect_dialog("save_alignment", dialogs.ask_save_path, aligning.save_alignment)
    connect_dialog("save_session_as", dialogs.ask_save_path, instrument.save_session)
    window.connect_command("save_session", keeping.save_session)
    connect_dialog("save_screenshot", dialogs.ask_save_path, instrument.save_screenshot)
    connect_dialog("open_mesh", dialogs.ask_mesh, lambda asked: instrument.open_mesh(*asked))
    window.connect_command("close_mesh", lambda: instrument.open_mesh(None))
    window.connect_command("close_weights", lambda: instrument.open_weights(None))
    window.connect_command("quit", window.close)
    window.connect_command(
        "keys", lambda: QMessageBox.information(window, "Keys", format_shortcut_table(window.actions_by_name))
    )


def _connect_play(instrument: SessionController) -> None:
    window, line = instrument.window, instrument.window.timeline
    play = window.actions_by_name["play"]

    def show_playing(playing: bool) -> None:
        play.setChecked(playing)
        play.setText("Pause" if playing else "Play")
        play.setIcon(make_command_icon("pause" if playing else "play"))

    line.play_toggled.connect(show_playing)
    window.connect_command("play", lambda: line.play(on=not line.is_playing))
    window.connect_command("first", lambda: line.step_to(0))
    window.connect_command("last", line.step_to_last)
    window.connect_command("previous", lambda: line.step_by(-1))
    window.connect_command("next", lambda: line.step_by(1))
    window.connect_command("back_10", lambda: line.step_by(-10))
    window.connect_command("forward_10", lambda: line.step_by(10))
    loop = window.actions_by_name["loop"]
    loop.toggled.connect(line.set_looping)

    def set_loop_range(first: int, last: int) -> None:
        line.set_loop_range(first, last)
        loop.setChecked(True)

    window.connect_command("loop_from", lambda: set_loop_range(line.frame, max(line.frame, line.loop_range[1])))
    window.connect_command("loop_to", lambda: set_loop_range(min(line.frame, line.loop_range[0]), line.frame))
    window.connect_command("loop_all", lambda: set_loop_range(0, line.slider.maximum()))


def _connect_view(instrument: SessionController, layouts: LayoutController) -> None:
    window, tracer = instrument.window, instrument.probe
    freeze = window.actions_by_name["pin_probe"]
    freeze.toggled.connect(tracer.set_frozen)
    tracer.pin_changed.connect(freeze.setChecked)
    link = window.actions_by_name["link_cameras"]
    link.setChecked(instrument.session.cameras_linked)
    window.connect_command("link_cameras", lambda: instrument.change("link cameras", cameras_linked=link.isChecked()))
    PanZoomController(instrument)
    ColourLimitController(instrument)
    window.connect_command("reset_view", instrument.reset_view)
    for versus in get_args(ComparisonMode)[1:]:
        window.connect_command(f"show_{versus}", lambda versus=versus: _choose_versus(instrument, versus))
    window.connect_command("cancel", instrument.cancel)
    for i, name in enumerate(window.columns):
        window.connect_command(f"only_{i + 1}", lambda name=name: _choose_column(instrument, layouts, name))


def _choose_column(instrument: SessionController, layouts: LayoutController, name: str) -> None:
    """Alone among the stages, else into the active pane."""
    if instrument.session.layout.name == "inspect":
        layouts.show_stage(name)
    else:
        instrument.show_only(name)


def _choose_versus(instrument: SessionController, versus: ComparisonMode) -> None:
    """One of them at a time; a second time goes back to what was worked out."""
    instrument.set_comparison_mode("" if instrument.views.comparison_mode == versus else versus)


def _connect_hands(window: MainWindow) -> None:
    """Every command by its name, and controls that leave wheel and keys to the window."""
    palette, command = CommandPalette(window), window.actions_by_name["palette"]
    command.setShortcuts([command.shortcut(), QKeySequence("Ctrl+Shift+P")])
    window.connect_command(
        "palette", lambda: palette.show_commands([a for a in window.actions() if a is not command and a.text()])
    )
    KeyboardFocusFilter(window)


def _connect_undo(instrument: SessionController) -> None:
    stack, actions = instrument.undo_stack, instrument.window.actions_by_name

    def make_text_setter(action: QAction, word: str) -> Callable[[str], None]:
        return lambda text: action.setText(f"{word} {text}".strip())

    for name, word, offered, told in (
        ("undo", "Undo", stack.canUndoChanged, stack.undoTextChanged),
        ("redo", "Redo", stack.canRedoChanged, stack.redoTextChanged),
    ):
        actions[name].setEnabled(False)
        offered.connect(actions[name].setEnabled)
        told.connect(make_text_setter(actions[name], word))
    instrument.window.connect_command("undo", stack.undo)
    instrument.window.connect_command("redo", stack.redo)
    instrument.window.connect_command("reset_all", lambda: instrument.change("reset all parameters", params={}))
