"""The commands of the window.

Menus, tool bar, timeline and shortcuts share one action per command.
"""

from collections.abc import Iterable, Mapping
from dataclasses import KW_ONLY, dataclass

from PyQt6.QtGui import QAction, QKeySequence
from PyQt6.QtWidgets import QMainWindow

from widgets.style.icons import make_command_icon


@dataclass(frozen=True, slots=True)
class Command:
    """Text, icon and shortcut of a command; `name` is the object name of its action."""

    name: str
    text: str
    tip: str
    key: str = ""
    _: KW_ONLY
    icon: str = ""
    checkable: bool = False


FILE_COMMANDS = (
    Command("open_sample", "Open sample", "Open the sample recording", icon="sample"),
    Command("open_recording", "Open recording…", "Open a recording", "Ctrl+O", icon="open"),
    Command(
        "open_folder",
        "Open folder…",
        "Open a folder: the images of one recording, or several recordings as a table",
        "Ctrl+Shift+O",
        icon="folder",
    ),
    Command(
        "open_mesh",
        "Open mesh…",
        "Open the mesh of the touched object, for its pose",
        "Ctrl+M",
        icon="cube",
    ),
    Command("close_mesh", "Close mesh", "Return to the mesh of the recording, if any"),
    Command(
        "open_calibration",
        "Open calibration…",
        "Open a calibration table of the source sensor",
    ),
    Command(
        "open_weights", "Open weights…", "Open network weights for a method that reads weights"
    ),
    Command("close_weights", "Close weights", "Return to the shipped weights"),
    Command("open_session", "Open session…", "Open a saved session", icon="session"),
    Command(
        "save_session",
        "Save session",
        "Save the session: files, settings and layout",
        "Ctrl+S",
        icon="save",
    ),
    Command(
        "save_session_as", "Save session as…", "Save the session under another name", "Ctrl+Shift+S"
    ),
    Command(
        "export",
        "Export…",
        "Write panes as image, points, arrays, table or video",
        "Ctrl+E",
        icon="image",
    ),
    Command(
        "export_bundle",
        "Export repro bundle…",
        "Write this frame and everything that reproduces it to a folder",
    ),
    Command("quit", "Quit", "Close the window", "Ctrl+Q", icon="close"),
)
REFERENCE_COMMANDS = (
    Command(
        "reference_median",
        "Median of this recording",
        "Use the median of all frames as the reference: touches at different places vanish",
        checkable=True,
    ),
    Command(
        "reference_untouched",
        "Median of untouched frames",
        "Use the median of the frames with least contact as the reference",
        checkable=True,
    ),
    Command("reference_frame", "This frame", "Use this frame as the reference", checkable=True),
    Command(
        "open_reference",
        "Choose file…",
        "Open the reference image of the source sensor",
        checkable=True,
    ),
    Command(
        "reference_recorded",
        "As recorded",
        "Return to the reference of the recording, if any",
        checkable=True,
    ),
)
CAPTURE_COMMANDS = (
    Command(
        "live",
        "Live…",
        "Open a live source: a simulated sensor, a camera, or a folder that grows",
        "Ctrl+Shift+L",
        icon="live",
    ),
    Command(
        "copy_image", "Copy image", "Copy an image of the active pane, or of the window", "Ctrl+C"
    ),
    Command(
        "save_video",
        "Save video…",
        "Write source, scene, generated and recorded touch of all frames as a video",
        "Ctrl+Shift+V",
    ),
    Command("save_screenshot", "Save screenshot…", "Save an image of the window", "Ctrl+Shift+E"),
    Command(
        "copy_command",
        "Copy as command",
        "Copy the command line that reproduces the screen",
        "Ctrl+Shift+C",
    ),
)
EDIT_COMMANDS = (
    Command("undo", "Undo", "Undo the last change", "Ctrl+Z", icon="undo"),
    Command("redo", "Redo", "Redo the change", "Ctrl+Shift+Z", icon="redo"),
    Command(
        "reset_all",
        "Reset parameters",
        "Reset the parameters of every stage to their defaults",
        icon="reset",
    ),
    Command("cancel", "Cancel", "Cancel the computation and clear the probe", "Esc", icon="stop"),
)
PLAYBACK_COMMANDS = (
    Command("first", "First frame", "Go to the first frame", "Home", icon="first"),
    Command("previous", "Previous frame", "Go to the previous frame", "Left", icon="previous"),
    Command("play", "Play", "Play or pause", "Space", icon="play", checkable=True),
    Command("next", "Next frame", "Go to the next frame", "Right", icon="next"),
    Command("last", "Last frame", "Go to the last frame", "End", icon="last"),
    Command("back_10", "Back 10 frames", "Go 10 frames back", "Shift+Left"),
    Command("forward_10", "Forward 10 frames", "Go 10 frames forward", "Shift+Right"),
    Command(
        "worse_frame",
        "Worse frame",
        "Go to the next worse frame by the metric of the frames table",
        "J",
    ),
    Command(
        "worst_frame",
        "Worst frame",
        "Go to the frame with the largest known error",
        "Shift+J",
        icon="worst",
    ),
    Command(
        "better_frame",
        "Better frame",
        "Go to the next better frame by the metric of the frames table",
        "K",
    ),
    Command("loop", "Loop", "Restart after the last frame", "Ctrl+L", icon="loop", checkable=True),
    Command("loop_from", "Loop from here", "Start the loop at this frame", "["),
    Command("loop_to", "Loop to here", "End the loop at this frame", "]"),
    Command("loop_all", "Loop all frames", "Loop over the whole recording"),
)
VIEW_COMMANDS = (
    Command(
        "link_cameras",
        "Link cameras",
        "Rotate all 3D views of one frame together",
        "L",
        icon="link",
        checkable=True,
    ),
    Command("reset_view", "Reset view", "Fit every image and 3D view", "R", icon="fit"),
    Command(
        "fit_contact",
        "Fit contact",
        "Zoom every image to the contact, or back to the sensor",
        "Z",
        checkable=True,
    ),
    Command(
        "link_previews",
        "Link images",
        "Pan and zoom all images together, in millimetres",
        "Shift+L",
        checkable=True,
    ),
    Command("pin_probe", "Pin probe", "Keep the probed pixel", "F", icon="target", checkable=True),
    Command(
        "magnify",
        "Magnifier",
        "Show the pixel values around the pointer in a corner of the image",
        "M",
        icon="magnifier",
        checkable=True,
    ),
    Command(
        "full_screen",
        "Presentation",
        "Show the three panes on the full screen, the press in motion; Esc leaves",
        "F11",
        icon="panes",
        checkable=True,
    ),
    Command(
        "probe_by_keys",
        "Probe by keys",
        "Move the probe or the section line by arrow keys; Enter pins, Tab goes to the next "
        "image, Esc ends",
        "P",
    ),
    Command(
        "inspector",
        "Inspector",
        "Show the parameters of the chosen stage, figures of the frame and where its error comes "
        "from",
        "F3",
        icon="sliders",
        checkable=True,
    ),
    Command(
        "section_line",
        "Section line",
        "Draw a line through all images and plot the heights along it",
        "X",
        icon="section",
        checkable=True,
    ),
)
COMPARISON_MODE_COMMANDS = (
    Command(
        "show_truth",
        "Truth",
        "Show the truth instead of the result",
        "T",
        icon="tick",
        checkable=True,
    ),
    Command(
        "show_difference",
        "Difference",
        "Show the result minus the truth",
        "D",
        icon="minus",
        checkable=True,
    ),
    Command(
        "show_wipe",
        "Wipe",
        "Show the result left of a handle, the truth right of it",
        "W",
        icon="wipe",
        checkable=True,
    ),
    Command(
        "show_blink",
        "Blink",
        "Alternate between the result and the truth",
        "B",
        icon="blink",
        checkable=True,
    ),
)
VARIANT_COMMANDS = (
    Command(
        "set_variant_settings",
        "Keep these settings as B",
        "Keep the current settings as session B of Compare",
        "Ctrl+H",
    ),
    Command(
        "set_variant_recording",
        "Open recording as B…",
        "Use another recording with the current settings as session B of Compare",
    ),
    Command("clear_variant", "Clear B", "Remove session B of Compare"),
)
REGISTRATION_COMMANDS = (
    Command(
        "open_alignment",
        "Open alignment…",
        "Open the alignment of the two sensors, a .toml",
    ),
    Command("save_alignment", "Save alignment as…", "Save the alignment with its offsets as .toml"),
    Command(
        "edit_alignment",
        "Edit alignment",
        "Open the alignment dock and focus its first number",
        "A",
        icon="axes",
    ),
    Command("step_through", "Step through", "Keep the iterations of a stage and show them"),
    Command("open_track", "Open track…", "Open a folder with a track"),
    Command(
        "export_track", "Export track…", "Write table, summary and surface of the track to a folder"
    ),
)
LAYOUT_COMMANDS = (
    Command(
        "layout_look",
        "Look",
        "Show all stages as cards, and up to three of them large",
        "Ctrl+1",
        checkable=True,
    ),
    Command(
        "layout_compare",
        "Compare",
        "Compare methods, settings, or values on a grid, on one frame",
        "Ctrl+2",
        checkable=True,
    ),
    Command(
        "layout_align",
        "Align",
        "Show the target depth against the recorded touch, with the alignment handles",
        "Ctrl+3",
        checkable=True,
    ),
    Command(
        "layout_track",
        "Track",
        "Show the motion of the touched object and its fused surface",
        "Ctrl+4",
        checkable=True,
    ),
    Command(
        "layout_task",
        "Task",
        "Show the rollouts of a task: why a trial fails",
        "Ctrl+5",
        checkable=True,
    ),
    Command(
        "layout_folder",
        "Folder",
        "Show the recordings of a folder as one table",
        "Ctrl+6",
        checkable=True,
    ),
)
TASK_COMMANDS = (
    Command("open_rollouts", "Open rollouts…", "Open a folder of recorded trials"),
    Command("previous_trial", "Previous trial", "Open the trial above in the table", "Ctrl+Up"),
    Command("next_trial", "Next trial", "Open the trial below in the table", "Ctrl+Down"),
    Command("next_decision", "Next decision", "Go to the tick of the next decision", "N"),
    Command(
        "attribute_rollout",
        "Attribute decision",
        "Run the rollout again with the truth in place of one stage after the other",
        "Ctrl+Return",
    ),
    Command("copy_trials", "Copy trials", "Copy the listed trials as a table"),
    Command(
        "export_rollout_video",
        "Export rollout video…",
        "Write scene, touches and force of every tick as video",
    ),
)
SCENE_COMMANDS = (
    Command(
        "press_motion",
        "Press in motion",
        "Play the press in the scene: depth scaled from 0 to this frame's. In the scene the space "
        "bar pauses, Esc ends",
        "Shift+Space",
        checkable=True,
    ),
    Command("scene_free", "Oblique view", "Look at the scene from the side and above"),
    Command("scene_top", "Top view", "Look at the scene from the cameras"),
    Command("scene_side", "Side view", "Look at the scene along the surfaces"),
    Command("scene_iso", "Isometric view", "Look at the scene along the diagonal of the axes"),
    Command("scene_source", "Source's axis", "Look along the optical axis of the source"),
    Command("scene_target", "Target's axis", "Look along the optical axis of the target"),
    Command(
        "scene_orthographic",
        "Orthographic",
        "Draw the scene without perspective: equal lengths are equal everywhere",
        checkable=True,
    ),
    Command(
        "scene_measure",
        "Measure",
        "Click two points of the scene's surfaces: their distance in mm",
        checkable=True,
    ),
    Command("export_scene", "Export scene…", "Write the scene as image, or the press as a film"),
)
THEME_COMMANDS = (
    Command(
        "theme_light",
        "Light theme",
        "Use dark text on a light background",
        icon="sun",
        checkable=True,
    ),
    Command(
        "theme_dark",
        "Dark theme",
        "Use light text on a dark background",
        icon="moon",
        checkable=True,
    ),
    Command("theme_system", "System theme", "Follow the desktop's theme", checkable=True),
)
HELP_COMMANDS = (
    Command(
        "palette", "Commands…", "Search all commands and their shortcuts", "Ctrl+K", icon="help"
    ),
)
MENUS: Mapping[str, tuple[Command, ...]] = {  # title -> commands; every command is in one menu
    "&File": FILE_COMMANDS,
    "&Edit": EDIT_COMMANDS,
    "&Capture": CAPTURE_COMMANDS,
    "&Play": PLAYBACK_COMMANDS,
    "&View": VIEW_COMMANDS,
    "&Scene": SCENE_COMMANDS,
    "&Layout": LAYOUT_COMMANDS,
    "Co&mpare": COMPARISON_MODE_COMMANDS + VARIANT_COMMANDS,
    "&Registration": REGISTRATION_COMMANDS,
    "&Task": TASK_COMMANDS,
    "&Help": HELP_COMMANDS,
}


def make_stage_commands(titles: Iterable[str]) -> tuple[Command, ...]:
    """Return the commands 1, 2, ... that show one stage large."""
    return tuple(
        Command(
            f"stage_{i + 1}",
            f"Show {title.lower()}",
            "Show this stage in the active pane",
            str(i + 1),
        )
        for i, title in enumerate(titles)
    )


def make_actions(window: QMainWindow, commands: tuple[Command, ...]) -> dict[str, QAction]:
    """Create one QAction per command, owned by the window; object name -> action."""
    actions: dict[str, QAction] = {}
    for command in commands:
        action = QAction(command.text, window)
        action.setObjectName(command.name)
        if command.icon:
            action.setIcon(make_command_icon(command.icon))
        action.setCheckable(command.checkable)
        action.setShortcut(QKeySequence(command.key))
        action.setToolTip(f"{command.tip} ({command.key})" if command.key else command.tip)
        window.addAction(action)
        actions[command.name] = action
    return actions
