"""Creates the controllers of all features, and connects commands, widgets and session."""

from collections.abc import Callable, Mapping
from functools import partial
from typing import get_args

from PyQt6.QtGui import QAction, QKeySequence

from app.align.alignment import AlignmentController
from app.align.alignment_gizmo import AlignmentGizmoController
from app.align.ball_calibration import BallCalibrationController
from app.compare.comparison import ComparisonController
from app.document.autosave import AutosaveController
from app.document.reference_choice import ReferenceController
from app.document.session_controller import SessionController
from app.export.export import ExportController
from app.folder.folder import FolderController
from app.frames.error_attribution import ErrorAttributionController
from app.frames.frame_ranking import FrameRankingController
from app.frames.verdict import VerdictController
from app.live.live import LiveController
from app.session.preferences import Theme
from app.session.state import DISPLAY_KEY
from app.shell.device_choice import DeviceController
from app.shell.layouts import LayoutController
from app.shell.mending import MendingController
from app.shell.panels import add_panels
from app.shell.presentation import PresentationController
from app.shell.shortcuts import KeyboardController, make_parameter_actions
from app.shell.themes import ThemeController
from app.shell.welcome import WelcomeController
from app.stages.pan_zoom import ColourLimitController, PanZoomController
from app.stages.pinned_probes import PinnedProbesController
from app.stages.probe_3d import Probe3DController
from app.stages.scene import SceneController
from app.stages.section_line import SectionLineController
from app.stages.step_scrubber import StepScrubberController
from app.task.rollout_attribution import RolloutAttributionController
from app.task.rollout_export import RolloutExportController
from app.task.rollouts import RolloutController
from app.track.track import TrackController
from app.window import dialogs
from app.window.main_window import MainWindow
from pipeline.sensors.spec import list_sensor_titles
from pipeline.translation.catalogue import Catalogue
from pipeline.translation.truth_view import ComparisonMode
from pipeline.views.display_params import DisplayParams
from widgets.shell.command_palette import CommandPalette
from widgets.style.icons import make_command_icon
from widgets.style.tables import TableCopier
from widgets.timeline.timeline import Timeline
from widgets.views.preview_key_filter import KeyboardFocusFilter


def connect(controller: SessionController, theme: Theme = "dark") -> AutosaveController:
    """Create the controllers of all features and connect everything; `theme` is the current one."""
    window = controller.window
    job = controller.job
    _fill_choices(window, controller.catalogue)

    job.delivered.connect(controller.handle_part)
    job.finished.connect(controller.handle_frame)
    job.failed.connect(controller.handle_failure)
    job.cancelled.connect(controller.handle_cancellation)
    job.progressed.connect(controller.handle_progress)

    controller.relay.line_logged.connect(window.log.show_line)
    controller.relay.error_uncaught.connect(controller.show_problem)

    window.timeline.frame_chosen.connect(controller.choose_frame)
    window.frames.frame_chosen.connect(controller.choose_frame)
    _connect_columns(controller)
    window.paths_dropped.connect(controller.open_paths)
    window.run_bar.cancel_button.clicked.connect(job.cancel)
    window.closing.connect(controller.close)

    window.source.chosen.connect(partial(_choose, controller, "source", {"stream": ""}))
    window.target.chosen.connect(partial(_choose, controller, "target", {}))
    window.route.chosen.connect(partial(_choose, controller, "route", {}))

    for add_feature in (
        PinnedProbesController,
        Probe3DController,
        KeyboardController,
        SectionLineController,
        PresentationController,
        PanZoomController,
        ColourLimitController,
    ):
        add_feature(controller)
    VerdictController(controller, ErrorAttributionController(controller))
    step_scrubber = StepScrubberController(controller)
    frame_ranking = FrameRankingController(controller)
    comparison = ComparisonController(controller)
    autosave = AutosaveController(controller)
    welcome = WelcomeController(controller, autosave)
    ThemeController(controller, autosave, theme)
    device = DeviceController(controller, autosave)
    export = ExportController(controller, autosave, comparison)
    rollouts = RolloutController(controller)
    RolloutAttributionController(controller, rollouts)
    RolloutExportController(controller, rollouts, export, autosave)
    LiveController(controller, autosave)
    FolderController(controller)
    track = TrackController(controller, export, autosave)
    mending = MendingController(controller, BallCalibrationController(controller, export, autosave))
    reference = ReferenceController(controller)
    alignment = AlignmentController(controller)
    gizmo = AlignmentGizmoController(controller, alignment)
    scene = SceneController(controller)
    alignment.dragged.connect(scene.show_drag)
    layouts = LayoutController(controller)

    # A session change (`change`, undo, redo, opening) becomes work here, and only here: the stages
    # are requested by `SessionController.show_session`, then every feature follows in this order.
    # The layout comes last, as it may request the stages again in another comparison mode.
    for follow in (
        step_scrubber.show_session,  # iterations of the chosen stage
        frame_ranking.show_session,  # notes
        comparison.show_session,  # computes the visible tab
        device.show_session,  # remembers it
        autosave.show_session,  # schedules the recovery file
        mending.show_session,  # drops the offers for another recording
        reference.show_session,  # which one is chosen
        welcome.show_session,  # hides the page once something is open
        alignment.show_session,  # offsets; drops a proposal for another alignment
        gizmo.show_session,  # its place
        track.show_session,  # drops a track of another recording
        scene.show_session,  # places what the stages show
        rollouts.show_session,  # reads the trial of the Task layout
        layouts.show_session,  # drawers and comparison mode of the layout
    ):
        controller.session_shown.connect(follow)

    _connect_files(controller, alignment, autosave, comparison, track)
    _connect_playback(controller)
    _connect_view(controller)
    _connect_undo(controller)
    _connect_palette(window)
    add_panels(controller)
    return autosave


def _choose(
    controller: SessionController, field: str, others: Mapping[str, str], value: str
) -> None:
    controller.change(f"choose {field}", **{field: value}, **others)


def _connect_columns(controller: SessionController) -> None:
    window = controller.window
    probe = controller.probe
    window.parameters.params_edited.connect(controller.choose_params)
    window.parameters.slider_held.connect(controller.hold_slider)
    for column in window.columns.values():
        column.pixel_hovered.connect(probe.probe_pixel)
        column.pixel_clicked.connect(probe.toggle_pin)
        column.method_chosen.connect(controller.choose_method)


def _fill_choices(window: MainWindow, catalogue: Catalogue) -> None:
    sensors = list_sensor_titles()
    window.source.offer({"": "as recorded", **sensors})
    window.target.offer(sensors)
    titles = {route.name: route.title for route in catalogue.routes}
    window.route.offer({route.name: route.label for route in catalogue.routes}, tips=titles)
    window.route.setEnabled(len(catalogue.routes) > 1)
    for stage in catalogue.stages:
        choices = catalogue.list_choices(stage.name)
        column = window.columns[stage.name]
        column.offer_methods([(m.name, m.title, m.help) for m in choices])
        for method in choices:
            title = stage.title if len(choices) == 1 else f"{stage.title} · {method.title}"
            window.parameters.add_group(method.key, title, method.params(), method.help)
    window.parameters.add_group(DISPLAY_KEY, "Display", DisplayParams())


def _connect_files(
    controller: SessionController,
    alignment: AlignmentController,
    autosave: AutosaveController,
    comparison: ComparisonController,
    track: TrackController,
) -> None:
    window = controller.window
    connect_dialog = autosave.connect_dialog
    openers = {
        "open_reference": controller.open_reference,
        "open_weights": controller.open_weights,
        "set_variant_recording": comparison.set_variant_recording,
        "open_track": track.open_track,
    }
    for command in dialogs.OPEN_DIALOGS:
        connect_dialog(command, dialogs.ask_open_path, openers.get(command, controller.open_path))
    connect_dialog("save_alignment", dialogs.ask_save_path, alignment.save_alignment)
    connect_dialog("save_session_as", dialogs.ask_save_path, controller.save_session)
    window.connect_command("save_session", autosave.save_session)
    connect_dialog("save_screenshot", dialogs.ask_save_path, controller.save_screenshot)
    connect_dialog("open_mesh", dialogs.ask_mesh, lambda answer: controller.open_mesh(*answer))
    window.connect_command("close_mesh", lambda: controller.open_mesh(None))
    window.connect_command("close_weights", lambda: controller.open_weights(None))
    window.connect_command("quit", window.close)


def _connect_playback(controller: SessionController) -> None:
    """Connect the playback commands with the frames, or with the ticks in the Task layout."""
    window = controller.window
    play = window.actions_by_name["play"]
    loop = window.actions_by_name["loop"]

    def show_playing(playing: bool) -> None:
        play.setChecked(playing)
        play.setText("Pause" if playing else "Play")
        play.setIcon(make_command_icon("pause" if playing else "play"))

    def connect(command: str, act: Callable[[Timeline], object]) -> None:
        window.connect_command(command, lambda: act(window.active_timeline))

    def set_loop_range(line: Timeline, first: int, last: int) -> None:
        line.set_loop_range(first, last)
        loop.setChecked(True)

    for line in (window.timeline, window.task.ticks):
        line.play_toggled.connect(show_playing)
        loop.toggled.connect(line.set_looping)
    connect("play", lambda line: line.play(on=not line.is_playing))
    connect("first", lambda line: line.step_to(0))
    connect("last", lambda line: line.step_to(line.slider.maximum()))
    for command, by in (("previous", -1), ("next", 1), ("back_10", -10), ("forward_10", 10)):
        connect(command, lambda line, by=by: line.step_to(line.frame + by))
    connect(
        "loop_from",
        lambda line: set_loop_range(line, line.frame, max(line.frame, line.loop_range[1])),
    )
    connect(
        "loop_to",
        lambda line: set_loop_range(line, min(line.frame, line.loop_range[0]), line.frame),
    )
    connect("loop_all", lambda line: set_loop_range(line, 0, line.slider.maximum()))


def _connect_view(controller: SessionController) -> None:
    window = controller.window
    probe = controller.probe
    pin = window.actions_by_name["pin_probe"]
    window.connect_command("pin_probe", lambda: probe.set_pinned(pin.isChecked()))
    probe.pin_changed.connect(pin.setChecked)
    link = window.actions_by_name["link_cameras"]
    link.setChecked(controller.session.cameras_linked)
    window.connect_command(
        "link_cameras", lambda: controller.change("link cameras", cameras_linked=link.isChecked())
    )
    window.connect_command("reset_view", lambda: controller.views.reset_cameras(controller.session))
    for mode in get_args(ComparisonMode)[1:]:
        window.connect_command(
            f"show_{mode}", lambda mode=mode: _toggle_comparison_mode(controller, mode)
        )
    window.connect_command("cancel", controller.cancel)
    for stage, card in window.look.filmstrip.thumbnails.items():
        if stage == "pose":
            card.offer_remedy(window.actions_by_name["open_mesh"])
    window.connect_command("inspector", window.show_inspector_if_checked)


def _toggle_comparison_mode(controller: SessionController, mode: ComparisonMode) -> None:
    """Choose a comparison mode; the current one is switched off."""
    controller.set_comparison_mode("" if controller.views.comparison_mode == mode else mode)


def _connect_palette(window: MainWindow) -> None:
    """Connect the command palette, the keyboard focus filter and the copy of tables."""
    palette = CommandPalette(window)
    command = window.actions_by_name["palette"]
    command.setShortcuts([command.shortcut(), QKeySequence("Ctrl+Shift+P"), QKeySequence("F1")])

    def list_commands() -> list[QAction]:
        commands = [
            action for action in window.actions() if action is not command and action.text()
        ]
        return commands + make_parameter_actions(window, palette)

    window.connect_command("palette", lambda: palette.show_commands(list_commands()))
    KeyboardFocusFilter(window)
    TableCopier(window)


def _connect_undo(controller: SessionController) -> None:
    stack = controller.undo_stack
    actions = controller.window.actions_by_name

    def make_text_setter(action: QAction, word: str) -> Callable[[str], None]:
        return lambda text: action.setText(f"{word} {text}".strip())

    for name, word, can_changed, text_changed in (
        ("undo", "Undo", stack.canUndoChanged, stack.undoTextChanged),
        ("redo", "Redo", stack.canRedoChanged, stack.redoTextChanged),
    ):
        actions[name].setEnabled(False)
        can_changed.connect(actions[name].setEnabled)
        text_changed.connect(make_text_setter(actions[name], word))
    controller.window.connect_command("undo", stack.undo)
    controller.window.connect_command("redo", stack.redo)
    controller.window.connect_command(
        "reset_all", lambda: controller.change("reset parameters", params={})
    )
