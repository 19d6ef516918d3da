"""Every command of the window as one action, used by menus, tool bar, timeline and keys alike."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import KW_ONLY, dataclass

from PyQt6.QtGui import QAction, QKeySequence
from PyQt6.QtWidgets import QMainWindow

from widgets.icons import make_command_icon


@dataclass(frozen=True, slots=True)
class Command:
    """How one command looks; `name` is its object name."""

    name: str
    text: str
    tip: str
    _: KW_ONLY
    icon: str = ""
    key: str = ""
    checkable: bool = False


FILE_COMMANDS = (
    Command("open_sample", "Open the sample", "Open the recording that comes along", icon="target"),
    Command("open_recording", "Open recording…", "Open a recorded touch", icon="open", key="Ctrl+O"),
    Command("open_folder", "Open folder…", "Open a folder of images", icon="folder", key="Ctrl+Shift+O"),
    Command("open_mesh", "Open mesh…", "Open the touched object's mesh, for its pose", icon="cube", key="Ctrl+M"),
    Command("close_mesh", "Close mesh", "Go back to the recording's own mesh, or to none"),
    Command(
        "open_calibration",
        "Open calibration…",
        "Open the look-up that `tactoscope calibrate balls` made",
        icon="target",
    ),
    Command("open_weights", "Open weights…", "Open a network's weights, for the method that takes such"),
    Command("close_weights", "Close weights", "Go back to the weights that come along"),
    Command("open_reference", "Open reference…", "Open the image of the untouched sensor", icon="file"),
    Command(
        "open_alignment",
        "Open alignment…",
        "Open how the two sensors stand to each other, a .toml as `tactoscope align refine` writes it",
        icon="open",
    ),
    Command(
        "save_alignment",
        "Save alignment as…",
        "Save how the two sensors stand to each other, with what was moved, as .toml",
        icon="save",
    ),
    Command("open_session", "Open session…", "Open a saved session", icon="session"),
    Command("save_session", "Save session", "Save what is open, shown and set", icon="save", key="Ctrl+S"),
    Command("save_session_as", "Save session as…", "Save the session under another name", key="Ctrl+Shift+S"),
    Command(
        "live",
        "Live…",
        "Watch a sensor: simulated, plugged in, or a folder that grows",
        icon="blink",
        key="Ctrl+Shift+L",
    ),
    Command(
        "export",
        "Export…",
        "Write a pane or all of them as picture, points, arrays, table or video",
        icon="picture",
        key="Ctrl+E",
    ),
    Command(
        "copy_command", "Copy as command", "Copy the command line that makes what is on screen", key="Ctrl+Shift+C"
    ),
    Command(
        "export_bundle", "Make a case…", "Put this frame and all that it was made of into a folder that can be sent"
    ),
    Command(
        "copy_image",
        "Copy picture",
        "Put a picture of the pane in front, or of the window, on the clipboard",
        key="Ctrl+C",
    ),
    Command("save_screenshot", "Save picture…", "Save a picture of the window", key="Ctrl+Shift+E"),
    Command("quit", "Quit", "Close the window", icon="close", key="Ctrl+Q"),
)
EDIT_COMMANDS = (
    Command("undo", "Undo", "Take the last change back", icon="undo", key="Ctrl+Z"),
    Command("redo", "Redo", "Bring the change back", icon="redo", key="Ctrl+Shift+Z"),
    Command("reset_all", "Reset all parameters", "Put every stage back to its defaults", icon="reset"),
    Command("cancel", "Cancel", "Stop the running work, or take the crosshairs away", icon="stop", key="Esc"),
)
PLAYBACK_COMMANDS = (
    Command("first", "First frame", "Go to the first frame", icon="first", key="Home"),
    Command("previous", "Previous frame", "Go one frame back", icon="previous", key="Left"),
    Command("play", "Play", "Play or pause", icon="play", key="Space", checkable=True),
    Command("next", "Next frame", "Go one frame on", icon="next", key="Right"),
    Command("last", "Last frame", "Go to the last frame", icon="last", key="End"),
    Command("back_10", "Ten frames back", "Go ten frames back", key="Shift+Left"),
    Command("forward_10", "Ten frames on", "Go ten frames on", key="Shift+Right"),
    Command("worse_frame", "Worse frame", "The next worse frame by the figure of the frames' table", key="J"),
    Command("worst_frame", "Worst frame", "Go to the frame with the largest error that is known", icon="worst",
            key="Shift+J"),
    Command("better_frame", "Better frame", "The next better frame by the figure of the frames' table", key="K"),
    Command("loop", "Loop", "Begin again after the last frame", icon="loop", key="Ctrl+L", checkable=True),
    Command("loop_from", "Loop from here", "Playing loops from this frame on", key="["),
    Command("loop_to", "Loop to here", "Playing loops up to this frame", key="]"),
    Command("loop_all", "Loop over all frames", "Playing loops over the whole recording"),
)  # fmt: skip
VIEW_COMMANDS = (
    Command(
        "link_cameras", "Link cameras", "3D views of one frame turn together", icon="link", key="L", checkable=True
    ),
    Command("reset_view", "Reset view", "Fit every picture and 3D view", icon="reset", key="R"),
    Command(
        "fit_contact",
        "Fit contact",
        "Zoom every picture to the contact, or back to the sensor",
        icon="fit",
        key="Z",
        checkable=True,
    ),
    Command(
        "link_previews",
        "Link pictures",
        "Pan and zoom all pictures together, in millimetres",
        icon="link",
        key="Shift+L",
        checkable=True,
    ),
    Command("pin_probe", "Freeze trace", "Keep the traced pixel where it is", icon="target", key="F", checkable=True),
    Command(
        "magnify",
        "Magnify",
        "The values of the pixels around the pointer, large in a corner of the picture",
        icon="fit",
        key="M",
        checkable=True,
    ),
    Command(
        "full_screen", "Full screen", "Fill the screen, for a demonstration, or come back", key="F11", checkable=True
    ),
    Command(
        "probe_by_keys",
        "Point by keys",
        "Arrow keys move the traced pixel, or the section line; Enter pins, Tab goes to the next picture, Esc ends",
        icon="target",
        key="P",
    ),
    Command(
        "section_line",
        "Section line",
        "A line through all pictures, and what each has for a height along it",
        icon="section",
        key="X",
        checkable=True,
    ),
)
COMPARISON_MODE_COMMANDS = (
    Command("show_truth", "Show truth", "The truth in place of what was worked out", icon="tick", key="T",
            checkable=True),
    Command("show_difference", "Show difference", "What was worked out less the truth", icon="minus", key="D",
            checkable=True),
    Command("show_wipe", "Wipe", "What was worked out left of a handle, the truth right of it", icon="wipe", key="W",
            checkable=True),
    Command("show_blink", "Blink", "What was worked out and the truth in turns", icon="blink", key="B",
            checkable=True),
)  # fmt: skip
LAYOUT_COMMANDS = (
    Command("edit_alignment", "Type the alignment", "Open the alignment's drawer with the keyboard in its first number",
            icon="axes", key="A"),
    Command("toggle_inspect", "Inspect or stages", "Change between a few large panes and all stages", icon="panes",
            key="I"),
    Command("layout_stages", "Stages", "Every slot side by side, pictures over 3D views", key="Ctrl+1", checkable=True),
    Command("layout_inspect", "Inspect", "Large panes under a filmstrip of all slots", key="Ctrl+2", checkable=True),
    Command("layout_align", "Align", "Felt against carried over in one large pane, the handles beside it",
            key="Ctrl+3", checkable=True),
    Command("layout_sweep", "Sweep", "Any two parameters against error and time", key="Ctrl+4", checkable=True),
    Command("layout_demo", "Demo", "Source, generated touch and truth, large", key="Ctrl+5", checkable=True),
    Command("layout_compare", "Compare", "One frame several ways: by every method, by other settings, by other seeds",
            key="Ctrl+6", checkable=True),
    Command("save_arrangement", "Keep this arrangement…", "Keep panes, drawers and handles as they stand, under a name",
            icon="panes", key="Ctrl+Shift+A"),
    Command("rename_arrangement", "Rename the arrangement…", "Give the arrangement that is on another name"),
    Command("delete_arrangement", "Delete the arrangement", "Forget the arrangement that is on; the window stays so"),
    Command("set_variant_settings", "Hold these settings", "These settings stay as B beside what is set from now on",
            icon="link", key="Ctrl+H"),
    Command("set_variant_recording", "Beside another recording…", "Another recording as B, with these settings",
            icon="open"),
    Command("step_through", "Step through", "Keep the steps on the way to the pose and look at them", icon="axes"),
    Command("map_basins", "Map basins", "Register this touch from a grid of starts: how safe its pose is", icon="axes"),
    Command("clear_variant", "Let B go", "Compare with nothing", icon="minus"),
)  # fmt: skip
THEME_COMMANDS = (
    Command("theme_light", "Light theme", "Dark letters on a light ground", icon="sun", checkable=True),
    Command("theme_dark", "Dark theme", "Light letters on a dark ground", icon="moon", checkable=True),
    Command("theme_system", "Theme of the system", "Light or dark, as the desktop says", checkable=True),
)
HELP_COMMANDS = (
    Command("palette", "Commands…", "Find any command by a few letters of its name", key="Ctrl+K"),
    Command("keys", "Keys", "Show the keys", icon="help", key="F1"),
)


def make_stage_commands(titles: tuple[str, ...]) -> tuple[Command, ...]:
    """1 to 6: one stage alone, or all again."""
    return tuple(
        Command(
            f"only_{i + 1}",
            f"Only {title.lower()}",
            "Show this stage alone, or all again; what is hidden is not worked out",
            key=str(i + 1),
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
        if command.icon:
            action.setIcon(make_command_icon(command.icon))
        action.setCheckable(command.checkable)
        action.setShortcut(QKeySequence(command.key))
        action.setToolTip(f"{command.tip} ({command.key})" if command.key else command.tip)
        window.addAction(action)
        made[command.name] = action
    return made


def format_shortcut_table(actions: Mapping[str, QAction]) -> str:
    """The keys as rich text."""
    rows = [
        f"<tr><td><b>{action.shortcut().toString()}</b>&nbsp;&nbsp;&nbsp;</td><td>{action.text()}</td></tr>"
        for action in actions.values()
        if action.shortcuts()
    ]
    return f"<table>{''.join(rows)}</table>"
