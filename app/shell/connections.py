"""Creates the controllers of all features, and connects commands, widgets and session."""

from collections.abc import Callable
from functools import partial
from typing import get_args

from PyQt6.QtGui import QKeySequence

from app.align.alignment import AlignmentController
from app.align.alignment_gizmo import AlignmentGizmoController
from app.compare.comparison import ComparisonController
from app.document.autosave import AutosaveController
from app.document.reference_choice import ReferenceController
from app.document.session_controller import SessionController
from app.export.export import ExportController
from app.folder.folder import FolderController
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

_FAR = 10**9  # frames


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
    window.parameters.params_edited.connect(controller.choose_params)
    window.parameters.slider_held.connect(controller.hold_slider)
    for column in window.columns.values():
        column.pixel_hovered.connect(controller.probe.probe_pixel)
        column.pixel_clicked.connect(controller.probe.toggle_pin)
        column.method_chosen.connect(controller.choose_method)
    window.paths_dropped.connect(controller.open_paths)
    window.run_bar.cancel_button.clicked.connect(job.cancel)
    window.closing.connect(controller.close)

    window.source.chosen.connect(partial(_choose, controller, "source", stream=""))
    window.target.chosen.connect(partial(_choose, controller, "target"))
    window.route.chosen.connect(partial(_choose, controller, "route"))

    # A session change (`change`, undo, redo, opening) becomes work in
    # `SessionController.show_session`; then every feature follows it in this order.
    for add_feature in (
        PinnedProbesController,
        Probe3DController,
        KeyboardController,
        SectionLineController,
        PresentationController,
        PanZoomController,
        ColourLimitController,
        VerdictController,
        StepScrubberController,
        FrameRankingController,
    ):
        add_feature(controller)
    comparison = ComparisonController(controller)
    autosave = AutosaveController(controller)
    WelcomeController(controller, autosave)
    ThemeController(controller, autosave, theme)
    DeviceController(controller, autosave)
    export = ExportController(controller, autosave, comparison)
    LiveController(controller, autosave)
    FolderController(controller)
    track = TrackController(controller, export, autosave)
    MendingController(controller, export)
    ReferenceController(controller)
    alignment = AlignmentController(controller)
    AlignmentGizmoController(controller, alignment)
    alignment.dragged.connect(SceneController(controller).show_drag)
    RolloutAttributionController(controller, RolloutController(controller, export))
    # last, as it may request the stages again in another comparison mode
    LayoutController(controller)

    _connect_files(controller, alignment, autosave, comparison, track)
    _connect_playback(controller)
    _connect_view(controller)
    _connect_undo(controller)
    _connect_palette(window)
    add_panels(controller)
    return autosave


def _choose(controller: SessionController, field: str, value: str, **others: str) -> None:
    controller.change(f"choose {field}", **{field: value}, **others)


def _fill_choices(window: MainWindow, catalogue: Catalogue) -> None:
    sensors = list_sensor_titles()
    window.source.offer({"": "as recorded", **sensors})
    window.target.offer(sensors)
    routes = catalogue.routes
    titles = {route.name: route.title for route in routes}
    window.route.offer({route.name: route.label for route in routes}, tips=titles)
    window.route.setEnabled(len(routes) > 1)
    for stage in catalogue.stages:
        choices = catalogue.list_choices(stage.name)
        window.columns[stage.name].offer_methods([(m.name, m.title, m.help) for m in choices])
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
    savers = {
        "save_alignment": alignment.save_alignment,
        "save_session_as": controller.save_session,
        "save_screenshot": controller.save_screenshot,
    }
    for command in dialogs.OPEN_DIALOGS:
        connect_dialog(command, dialogs.ask_open_path, openers.get(command, controller.open_path))
    for command, save in savers.items():
        connect_dialog(command, dialogs.ask_save_path, save)
    connect_dialog("open_mesh", dialogs.ask_mesh, lambda answer: controller.open_mesh(*answer))
    window.connect_command("save_session", autosave.save_session)
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
    # as far as the ends, where it stops
    for command, by in (
        ("first", -_FAR),
        ("back_10", -10),
        ("previous", -1),
        ("next", 1),
        ("forward_10", 10),
        ("last", _FAR),
    ):
        connect(command, lambda line, by=by: line.step_to(line.frame + by))
    connect(
        "loop_from",
        lambda line: set_loop_range(line, line.frame, max(line.frame, line.loop_range[1])),
    )
    connect(
        "loop_to",
        lambda line: set_loop_range(line, min(line.frame, line.loop_range[0]), line.frame),
    )
    connect("loop_all", lambda line: set_loop_range(line, 0, _FAR))


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
        window.connect_command(f"show_{mode}", partial(controller.toggle_comparison_mode, mode))
    window.connect_command("cancel", controller.cancel)
    if (card := window.look.filmstrip.thumbnails.get("pose")) is not None:
        card.offer_remedy(window.actions_by_name["open_mesh"])
    window.actions_by_name["inspector"].toggled.connect(window.show_inspector_if_checked)


def _connect_palette(window: MainWindow) -> None:
    """Connect the command palette, the keyboard focus filter and the copy of tables."""
    palette = CommandPalette(window)
    command = window.actions_by_name["palette"]
    command.setShortcuts([command.shortcut(), QKeySequence("Ctrl+Shift+P"), QKeySequence("F1")])

    def show() -> None:
        commands = [one for one in window.actions() if one is not command and one.text()]
        palette.show_commands(commands + make_parameter_actions(window, palette))

    window.connect_command("palette", show)
    KeyboardFocusFilter(window)
    TableCopier(window)


def _connect_undo(controller: SessionController) -> None:
    stack = controller.undo_stack
    window = controller.window
    undo, redo = window.actions_by_name["undo"], window.actions_by_name["redo"]

    def show_state() -> None:
        undo.setEnabled(stack.canUndo())
        redo.setEnabled(stack.canRedo())
        undo.setText(f"Undo {stack.undoText()}".strip())
        redo.setText(f"Redo {stack.redoText()}".strip())

    show_state()
    stack.indexChanged.connect(show_state)
    stack.undoTextChanged.connect(show_state)
    window.connect_command("undo", stack.undo)
    window.connect_command("redo", stack.redo)
    window.connect_command("reset_all", lambda: controller.change("reset parameters", params={}))
