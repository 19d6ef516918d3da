"""Every command of the window as one action, used by menus, tool bar, timeline and keys alike."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from PyQt6.QtGui import QAction, QIcon, QKeySequence
from PyQt6.QtWidgets import QMainWindow, QStyle

from widgets.icons import drawn

_Std = QStyle.StandardPixmap


@dataclass(frozen=True, slots=True, kw_only=True)
class Command:
    """How one command looks; `name` is its object name."""

    name: str
    text: str
    tip: str
    icon: _Std | str | None = None
    keys: tuple[str, ...] = ()
    checkable: bool = False


FILE = (
    Command(
        name="open_recording",
        text="Open recording…",
        tip="Open a recorded touch",
        icon=_Std.SP_DialogOpenButton,
        keys=("Ctrl+O",),
    ),
    Command(
        name="open_folder",
        text="Open folder…",
        tip="Open a folder of images",
        icon=_Std.SP_DirOpenIcon,
        keys=("Ctrl+Shift+O",),
    ),
    Command(
        name="open_mesh",
        text="Open mesh…",
        tip="Open the touched object's mesh, for its pose",
        icon="cube",
        keys=("Ctrl+M",),
    ),
    Command(name="close_mesh", text="Close mesh", tip="Go back to the recording's own mesh, or to none"),
    Command(
        name="open_calibration",
        text="Open calibration…",
        tip="Open the look-up that `tactoscope calibrate balls` made",
        icon="target",
    ),
    Command(
        name="open_reference",
        text="Open reference…",
        tip="Open the image of the untouched sensor",
        icon=_Std.SP_FileIcon,
    ),
    Command(
        name="open_alignment",
        text="Open alignment…",
        tip="Open how the two sensors stand to each other, a .toml as `tactoscope align refine` writes it",
        icon=_Std.SP_DialogOpenButton,
    ),
    Command(
        name="save_alignment",
        text="Save alignment as…",
        tip="Save how the two sensors stand to each other, with what was moved, as .toml",
        icon=_Std.SP_DialogSaveButton,
    ),
    Command(name="open_session", text="Open session…", tip="Open a saved session", icon=_Std.SP_FileDialogDetailedView),
    Command(
        name="save_session",
        text="Save session…",
        tip="Save what is open, shown and set",
        icon=_Std.SP_DialogSaveButton,
        keys=("Ctrl+S",),
    ),
    Command(
        name="save_picture", text="Save picture…", tip="Save a picture of the window", icon="picture", keys=("Ctrl+E",)
    ),
    Command(name="quit", text="Quit", tip="Close the window", icon=_Std.SP_DialogCloseButton, keys=("Ctrl+Q",)),
)
EDIT = (
    Command(name="undo", text="Undo", tip="Take the last change back", icon=_Std.SP_ArrowBack, keys=("Ctrl+Z",)),
    Command(name="redo", text="Redo", tip="Bring the change back", icon=_Std.SP_ArrowForward, keys=("Ctrl+Shift+Z",)),
    Command(
        name="reset_all",
        text="Reset all parameters",
        tip="Put every stage back to its defaults",
        icon=_Std.SP_DialogResetButton,
    ),
    Command(
        name="cancel",
        text="Cancel",
        tip="Stop the running work, or take the crosshairs away",
        icon=_Std.SP_BrowserStop,
        keys=("Esc",),
    ),
)
PLAY = (
    Command(
        name="first", text="First frame", tip="Go to the first frame", icon=_Std.SP_MediaSkipBackward, keys=("Home",)
    ),
    Command(
        name="previous", text="Previous frame", tip="Go one frame back", icon=_Std.SP_MediaSeekBackward, keys=("Left",)
    ),
    Command(name="play", text="Play", tip="Play or pause", icon=_Std.SP_MediaPlay, keys=("Space",), checkable=True),
    Command(name="next", text="Next frame", tip="Go one frame on", icon=_Std.SP_MediaSeekForward, keys=("Right",)),
    Command(name="last", text="Last frame", tip="Go to the last frame", icon=_Std.SP_MediaSkipForward, keys=("End",)),
    Command(name="ten_back", text="Ten frames back", tip="Go ten frames back", keys=("Shift+Left",)),
    Command(name="ten_on", text="Ten frames on", tip="Go ten frames on", keys=("Shift+Right",)),
    Command(
        name="loop", text="Loop", tip="Begin again after the last frame", icon="loop", keys=("Ctrl+L",), checkable=True
    ),
)
VIEW = (
    Command(
        name="link_cameras",
        text="Link cameras",
        tip="3D views of one frame turn together",
        icon="link",
        keys=("L",),
        checkable=True,
    ),
    Command(name="reset_view", text="Reset view", tip="Fit every picture and 3D view", icon="reset", keys=("R",)),
    Command(
        name="freeze_trace",
        text="Freeze trace",
        tip="Keep the traced pixel where it is",
        icon="target",
        keys=("F",),
        checkable=True,
    ),
)
HELP = (Command(name="keys", text="Keys", tip="Show the keys", icon=_Std.SP_DialogHelpButton, keys=("F1",)),)


def stage_commands(titles: tuple[str, ...]) -> tuple[Command, ...]:
    """1 to 6: one stage alone, or all again."""
    return tuple(
        Command(
            name=f"only_{i + 1}",
            text=f"Only {title.lower()}",
            tip="Show this stage alone, or all again; what is hidden is not worked out",
            keys=(str(i + 1),),
            checkable=True,
        )
        for i, title in enumerate(titles)
    )


def make_actions(window: QMainWindow, commands: tuple[Command, ...]) -> dict[str, QAction]:
    """One QAction per command, owned by the window and found by its object name."""
    made: dict[str, QAction] = {}
    for command in commands:
        action = QAction(command.text, window)
        action.setObjectName(command.name)
        action.setIcon(_icon(window, command.icon))
        action.setCheckable(command.checkable)
        action.setShortcuts([QKeySequence(k) for k in command.keys])
        shown = f" ({', '.join(command.keys)})" if command.keys else ""
        action.setToolTip(command.tip + shown)
        action.setStatusTip("")
        window.addAction(action)
        made[command.name] = action
    return made


def key_table(actions: Mapping[str, QAction]) -> str:
    """The keys as rich text."""
    rows = [
        f"<tr><td><b>{_keys(a)}</b>&nbsp;&nbsp;&nbsp;</td><td>{a.text()}</td></tr>"
        for a in actions.values()
        if a.shortcuts()
    ]
    return f"<table>{''.join(rows)}</table>"


def _keys(action: QAction) -> str:
    return ", ".join(k.toString() for k in action.shortcuts())


def _icon(window: QMainWindow, icon: _Std | str | None) -> QIcon:
    style = window.style()
    if icon is None or style is None:
        return QIcon()
    return drawn(icon) if isinstance(icon, str) else style.standardIcon(icon)
