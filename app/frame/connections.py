"""Who listens to whom, readable from top to bottom."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar, get_args

from PyQt6.QtCore import Qt
from PyQt6.QtGui import QAction, QKeySequence
from PyQt6.QtWidgets import QMessageBox, QWidget

from app.frame import dialogs
from app.frame.actions import key_table
from app.frame.aligning import Aligning
from app.frame.basins import BasinsTab
from app.frame.blaming import Blaming
from app.frame.comparing import Comparing
from app.frame.grasping import Grasping
from app.frame.greeting import Greeting
from app.frame.handing import Handing
from app.frame.instrument import Instrument
from app.frame.keeping import Keeping
from app.frame.keying import Keying
from app.frame.layouts import Layouts
from app.frame.limits import Limits
from app.frame.living import Living
from app.frame.looking import Looking
from app.frame.own_layouts import OwnLayouts
from app.frame.pointing import Pointing
from app.frame.sectioning import Sectioning
from app.frame.showing import Showing
from app.frame.stepping import Stepping
from app.frame.sweeping import Sweeping
from app.frame.themes import Themes
from app.frame.triage import Triage
from app.frame.window import Window
from app.session.remembered import Theme
from app.session.state import DISPLAY
from pipeline.pictures.display import DisplayParams
from pipeline.scoring.beside import Versus
from pipeline.sensors.spec import names
from pipeline.translation.catalogue import Catalogue
from widgets.hands import Hands
from widgets.icons import drawn
from widgets.palette import Palette

T = TypeVar("T")


def connect(instrument: Instrument, theme: Theme = "light") -> Keeping:
    """Fill the window's choices and connect everything; returns what outlives the window.

    `theme` is the one that is on.
    """
    window, job, tracer = instrument.window, instrument.job, instrument.tracer
    _fill(window, instrument.catalogue)

    job.delivered.connect(instrument.take_part)
    job.finished.connect(instrument.take_frame)
    job.failed.connect(instrument.take_failure)
    job.cancelled.connect(instrument.take_cancel)
    job.progressed.connect(instrument.take_progress)

    instrument.relay.line.connect(window.log.show_line)
    instrument.relay.uncaught.connect(instrument.show_problem)

    window.timeline.frame_chosen.connect(instrument.choose_frame)
    window.frames.frame_chosen.connect(instrument.choose_frame)
    window.parameters.params_edited.connect(instrument.choose_params)
    for slider in window.steps.values():
        slider.step_chosen.connect(instrument.screen.show_step)
    window.parameters.drag_ended.connect(instrument.refresh)
    for column in window.columns.values():
        column.pixel_hovered.connect(tracer.hover)
        column.pixel_clicked.connect(tracer.click)
        column.method_chosen.connect(instrument.choose_method)
    window.paths_dropped.connect(instrument.open_paths)
    window.stop.clicked.connect(job.cancel)
    window.closing.connect(instrument.close)

    change = instrument.change
    window.source.activated.connect(lambda: change("choose source", source=window.source.currentData(), stream=""))
    window.target.activated.connect(lambda: change("choose target", target=window.target.currentData()))
    window.route.activated.connect(lambda: change("choose route", route=window.route.currentData()))
    Blaming(instrument)
    BasinsTab(instrument)
    Stepping(instrument)
    Pointing(instrument)
    Keying(instrument)
    Sectioning(instrument)
    Showing(instrument)
    Triage(instrument)
    sweeping = Sweeping(instrument)
    comparing = Comparing(instrument)
    keeping = Keeping(instrument)
    Greeting(instrument, keeping)
    Themes(instrument, keeping, theme)
    OwnLayouts(instrument, keeping)
    Handing(instrument, keeping, sweeping)
    Living(instrument, keeping)
    aligning = Aligning(instrument)
    Grasping(instrument, aligning)
    _connect_files(instrument, aligning, keeping, comparing)
    _connect_play(instrument)
    _connect_view(instrument, Layouts(instrument))
    _connect_undo(instrument)
    _connect_hands(window)
    return keeping


def _fill(window: Window, catalogue: Catalogue) -> None:
    window.source.addItem("as recorded", "")
    for name in names():
        window.source.addItem(name, name)
        window.target.addItem(name, name)
    for route in catalogue.routes:
        window.route.addItem(route.name, route.name)
        window.route.setItemData(window.route.count() - 1, route.title, Qt.ItemDataRole.ToolTipRole)
    window.route.setEnabled(len(catalogue.routes) > 1)
    for slot in catalogue.slots:
        window.columns[slot.name].offer_methods([(m.name, m.title, m.help) for m in slot.methods])
        for method in slot.methods:
            title = slot.title if len(slot.methods) == 1 else f"{slot.title} · {method.title}"
            window.parameters.add_group(method.key, title, method.params(), method.help)
    window.parameters.add_group(DISPLAY, "Display", DisplayParams())


def _connect_files(instrument: Instrument, aligning: Aligning, keeping: Keeping, comparing: Comparing) -> None:
    window = instrument.window

    def asks(command: str, ask: Callable[[QWidget, str, str], T | None], then: Callable[[T], object]) -> None:
        def run() -> None:
            said = ask(window, command, keeping.folder)
            if said is not None:
                then(said)

        window.on(command, run)

    own = {
        "open_reference": instrument.open_reference, "open_weights": instrument.open_weights,
        "hold_recording": comparing.hold_recording,
    }  # fmt: skip
    for command in dialogs.OPENERS:
        asks(command, dialogs.to_open, own.get(command, instrument.open_path))
    asks("save_alignment", dialogs.to_save, aligning.save)
    asks("save_session_as", dialogs.to_save, instrument.save_session)
    window.on("save_session", keeping.save)
    asks("save_picture", dialogs.to_save, instrument.save_picture)
    asks("open_mesh", dialogs.mesh, lambda asked: instrument.open_mesh(*asked))
    window.on("close_mesh", lambda: instrument.open_mesh(None))
    window.on("close_weights", lambda: instrument.open_weights(None))
    window.on("quit", window.close)
    window.on("keys", lambda: QMessageBox.information(window, "Keys", key_table(window.actions_by_name)))


def _connect_play(instrument: Instrument) -> None:
    window, line = instrument.window, instrument.window.timeline
    play = window.actions_by_name["play"]

    def show_playing(playing: bool) -> None:
        play.setChecked(playing)
        play.setText("Pause" if playing else "Play")
        play.setIcon(drawn("pause" if playing else "play"))

    line.play_toggled.connect(show_playing)
    window.on("play", lambda: line.play(on=not line.playing))
    window.on("first", lambda: line.step_to(0))
    window.on("last", line.step_to_last)
    window.on("previous", lambda: line.step(-1))
    window.on("next", lambda: line.step(1))
    window.on("ten_back", lambda: line.step(-10))
    window.on("ten_on", lambda: line.step(10))
    loop = window.actions_by_name["loop"]
    loop.toggled.connect(line.set_looping)

    def loop_over(first: int, last: int) -> None:
        line.loop_over(first, last)
        loop.setChecked(True)

    window.on("loop_from", lambda: loop_over(line.frame, max(line.frame, line.span[1])))
    window.on("loop_to", lambda: loop_over(min(line.frame, line.span[0]), line.frame))
    window.on("loop_all", lambda: loop_over(0, line.slider.maximum()))


def _connect_view(instrument: Instrument, layouts: Layouts) -> None:
    window, tracer = instrument.window, instrument.tracer
    freeze = window.actions_by_name["freeze_trace"]
    freeze.toggled.connect(tracer.freeze)
    tracer.pinned.connect(freeze.setChecked)
    link = window.actions_by_name["link_cameras"]
    link.setChecked(instrument.session.linked)
    window.on("link_cameras", lambda: instrument.change("link cameras", linked=link.isChecked()))
    Looking(instrument)
    Limits(instrument)
    window.on("reset_view", instrument.reset_view)
    for versus in get_args(Versus)[1:]:
        window.on(f"show_{versus}", lambda versus=versus: _choose_versus(instrument, versus))
    window.on("cancel", instrument.cancel)
    for i, name in enumerate(window.columns):
        window.on(f"only_{i + 1}", lambda name=name: _choose_column(instrument, layouts, name))


def _choose_column(instrument: Instrument, layouts: Layouts, name: str) -> None:
    """Alone among the stages, else into the active pane."""
    if instrument.session.layout.name == "inspect":
        layouts.show_slot(name)
    else:
        instrument.show_only(name)


def _choose_versus(instrument: Instrument, versus: Versus) -> None:
    """One of them at a time; a second time goes back to what was worked out."""
    instrument.show_versus("" if instrument.screen.versus == versus else versus)


def _connect_hands(window: Window) -> None:
    """Every command by its name, and controls that leave wheel and keys to the window."""
    palette, command = Palette(window), window.actions_by_name["palette"]
    command.setShortcuts([command.shortcut(), QKeySequence("Ctrl+Shift+P")])
    window.on("palette", lambda: palette.ask([a for a in window.actions() if a is not command and a.text()]))
    Hands(window)


def _connect_undo(instrument: Instrument) -> None:
    stack, actions = instrument.undo, instrument.window.actions_by_name

    def names_itself(action: QAction, word: str) -> Callable[[str], None]:
        return lambda text: action.setText(f"{word} {text}".strip())

    for name, word, offered, told in (
        ("undo", "Undo", stack.canUndoChanged, stack.undoTextChanged),
        ("redo", "Redo", stack.canRedoChanged, stack.redoTextChanged),
    ):
        actions[name].setEnabled(False)
        offered.connect(actions[name].setEnabled)
        told.connect(names_itself(actions[name], word))
    instrument.window.on("undo", stack.undo)
    instrument.window.on("redo", stack.redo)
    instrument.window.on("reset_all", lambda: instrument.change("reset all parameters", params={}))
