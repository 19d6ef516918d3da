"""Colours of the window itself; those of quantities are `pipeline.pictures.colours`."""

from __future__ import annotations

from PyQt6.QtGui import QColor, QPalette

from pipeline.pictures.colours import Rgb

CONTACT: Rgb = (230, 85, 13)  # outline of the contact mask
FELT: Rgb = (255, 255, 255)  # outline of what the target really felt, dark on both sides: seen on every colour
FELT_CASING: Rgb = (20, 24, 30)
TRACE: Rgb = (230, 0, 115)  # crosshair of the traced pixel
BACKDROP: Rgb = (250, 250, 252)
GAUGE: Rgb = (86, 140, 190)  # a figure of the score
GAUGE_ROOM: Rgb = (226, 229, 234)
GHOST: Rgb = (40, 44, 52)  # where it stood when a drag began
MATTERS: Rgb = (240, 190, 120)  # how much an axis changes it
DOUBT: Rgb = (180, 95, 0)
WHOLE: Rgb = (110, 118, 130)  # of an error taken apart: a sum,
TAKEN: Rgb = (0, 114, 178)  # what goes with the truth (Okabe-Ito blue),
WORSE: Rgb = (213, 94, 0)  # and what comes with it (vermilion)
AXES: tuple[Rgb, Rgb, Rgb] = ((204, 60, 60), (50, 150, 70), (50, 90, 200))  # x, y, z

STATES: dict[str, Rgb] = {
    "computed": (0, 128, 96),
    "read": (0, 128, 96),
    "cached": (40, 105, 180),
    "unchanged": (40, 105, 180),
    "doubtful": (180, 95, 0),
    "skipped": (110, 115, 125),
    "running": (190, 120, 0),
    "preview": (190, 120, 0),
    "failed": (190, 40, 40),
    "stale": (150, 110, 30),
    "waiting": (140, 145, 150),
}


def qcolor(colour: Rgb, alpha: int = 255) -> QColor:
    """The Qt colour of a triple."""
    return QColor(*colour, alpha)


def backdrop(palette: QPalette) -> QColor:
    """What lies behind pictures and 3D views."""
    base = palette.color(QPalette.ColorRole.Base)
    return qcolor(BACKDROP) if base.lightness() > 128 else base


def light_palette() -> QPalette:
    """A calm light palette, set by hand: without a desktop theme Qt does not know which one to take."""
    palette = QPalette()
    role, group = QPalette.ColorRole, QPalette.ColorGroup
    for which, rgb in (
        (role.Window, (243, 244, 247)), (role.WindowText, (28, 30, 34)), (role.Base, (255, 255, 255)),
        (role.AlternateBase, (247, 248, 250)), (role.Text, (28, 30, 34)), (role.Button, (238, 240, 244)),
        (role.ButtonText, (28, 30, 34)), (role.ToolTipBase, (255, 255, 240)), (role.ToolTipText, (28, 30, 34)),
        (role.Highlight, (45, 110, 190)), (role.HighlightedText, (255, 255, 255)), (role.Link, (30, 95, 180)),
        (role.PlaceholderText, (125, 130, 138)), (role.Mid, (200, 204, 210)), (role.Midlight, (226, 229, 234)),
    ):  # fmt: skip
        palette.setColor(which, qcolor(rgb))
    for which in (role.WindowText, role.Text, role.ButtonText):
        palette.setColor(group.Disabled, which, qcolor((150, 154, 160)))
    return palette
