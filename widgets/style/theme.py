"""Colours of the window; those of quantities are in `pipeline.views.colours`.

Overlays on images (outlines, crosshair) are the same in every theme. Text and signs on the window's
background come from a `ThemeColours`, one for light and one for dark, with a contrast of at least
4.5 to 1.
"""

from collections.abc import Mapping

from PyQt6.QtGui import QColor, QPalette
from PyQt6.QtWidgets import QApplication, QToolTip

from pipeline.core.frozen import frozen
from pipeline.views.colours import ColourMapName, ColourScale, Rgb

CROSSHAIR_COLOUR: Rgb = (230, 0, 115)  # crosshair of the probe
SECTION_COLOUR: Rgb = (240, 228, 66)  # the section line, with a dark casing
CATEGORY_COLOURS: tuple[
    Rgb, ...
] = (  # poses of a registration, Okabe-Ito: the result first, then the others, best first
    (0, 114, 178),
    (230, 159, 0),
    (0, 158, 115),
    (204, 121, 167),
    (86, 180, 233),
    (213, 94, 0),
    (240, 228, 66),
    (90, 90, 100),
)

_OUTLINED = "QCheckBox", "QSlider", "QLineEdit", "QAbstractSpinBox", "QComboBox"
# of controls, by whether it is dark
_OUTLINE: dict[bool, Rgb] = {False: (122, 129, 140), True: (145, 152, 164)}
_FUSION_OUTLINE = 140  # per cent, as `QColor.darker` takes it


PROBE_COLOURS = tuple(CATEGORY_COLOURS[k] for k in (1, 4, 2, 6, 3))


@frozen
class ThemeColours:
    """Colours on one background."""

    backdrop: Rgb  # behind images and 3D views
    no_value: Rgb  # pixels without a value; in a light window `NO_VALUE_COLOUR`
    # signed values: the centre is as bright as the window, so that images do not glare
    diverging: ColourMapName
    icon: Rgb
    secondary_text: Rgb  # labels of other text
    warning_text: Rgb  # warnings
    warning_mark: Rgb
    neutral: Rgb  # error attribution: a sum
    accent: Rgb  # a share that the truth removes (Okabe-Ito blue)
    worse: Rgb  # a share that the truth adds (vermilion)
    gauge: Rgb  # gauge: value
    gauge_background: Rgb  # gauge: range
    ghost: Rgb  # gauge: value before a drag
    sensitivity: Rgb  # gauge: sensitivity to an axis
    axes: tuple[Rgb, Rgb, Rgb]  # x, y, z
    states: Mapping[str, Rgb]


# of a light and of a dark window
_COLOURS = {
    "backdrop": ("#fafafc", "#181a1e"),
    "no_value": ("#e0e2e6", "#3a3d44"),
    "icon": ("#3c424c", "#cdd2da"),
    "secondary_text": ("#5c626e", "#a0a8b4"),
    "warning_text": ("#96401f", "#f5a578"),
    "warning_mark": ("#a05200", "#f5af50"),
    "neutral": ("#646c78", "#969eaa"),
    "accent": ("#0072b2", "#56b4e9"),
    "worse": ("#cd5500", "#f08c46"),
    "gauge": ("#467db4", "#6ea5d7"),
    "gauge_background": ("#e2e5ea", "#3e424a"),
    "ghost": ("#282c34", "#e1e4e8"),
    "sensitivity": ("#f0be78", "#96692d"),
}
_AXES = (
    ("#be2d2d", "#f87d76"),
    ("#1c7630", "#73d082"),
    ("#325ac8", "#87aaff"),
)
_STATES = {
    ("computed", "read"): ("#007356", "#55cba5"),
    ("cached", "unchanged"): ("#2869b4", "#7db6f5"),
    ("warning",): ("#a05200", "#f5af50"),
    ("skipped",): ("#60656f", "#a5aab4"),
    ("running", "preview", "draft"): ("#925a00", "#f0c35f"),
    ("failed",): ("#be2828", "#ff8a80"),
    ("stale",): ("#7d5a14", "#d8bc73"),
    ("waiting",): ("#60666e", "#a2a8b1"),
}


def _make_colours(theme: int) -> ThemeColours:
    def pick(pair: tuple[str, str]) -> Rgb:
        red, green, blue = bytes.fromhex(pair[theme][1:])
        return red, green, blue

    x, y, z = map(pick, _AXES)
    return ThemeColours(
        diverging="diverging_dark" if theme else "diverging",
        axes=(x, y, z),
        states={name: pick(pair) for names, pair in _STATES.items() for name in names},
        **{name: pick(pair) for name, pair in _COLOURS.items()},
    )


LIGHT_COLOURS, DARK_COLOURS = map(_make_colours, (0, 1))


def get_probe_colour(number: int) -> Rgb:
    """Return the colour of a pinned pixel by its number, from 1; dark text is readable on it."""
    return PROBE_COLOURS[(number - 1) % len(PROBE_COLOURS)]


def to_qcolor(colour: Rgb, alpha: int = 255) -> QColor:
    """Convert an RGB triple to a Qt colour."""
    return QColor(*colour, alpha)


def to_hex(colour: Rgb) -> str:
    """Convert an RGB triple to a hex string for rich text and style sheets."""
    return "#{:02x}{:02x}{:02x}".format(*colour)


def is_dark(palette: QPalette) -> bool:
    """Return whether a palette has light text on a dark background."""
    return palette.color(QPalette.ColorRole.Base).lightness() < 128


def get_theme_colours(palette: QPalette) -> ThemeColours:
    """Return the theme colours of a palette."""
    return DARK_COLOURS if is_dark(palette) else LIGHT_COLOURS


def get_colour_map(ink: ThemeColours, scale: ColourScale) -> ColourMapName:
    """Return the colour map that a scale has in a theme."""
    return ink.diverging if scale.colour_map == "diverging" else scale.colour_map


def get_backdrop(palette: QPalette) -> QColor:
    """Return the colour behind images and 3D views."""
    return to_qcolor(get_theme_colours(palette).backdrop)


def make_palette(*, dark: bool) -> QPalette:
    """Return the window's palette, set explicitly: without a desktop theme Qt does not know
    which to take.
    """
    palette = QPalette()
    role = QPalette.ColorRole
    group = QPalette.ColorGroup
    table = (  # role, light, dark
        (role.Window, "#f3f4f7", "#26292f"),
        (role.WindowText, "#1c1e22", "#e2e5ea"),
        (role.Base, "#ffffff", "#1a1c21"),
        (role.AlternateBase, "#f7f8fa", "#212429"),
        (role.Text, "#1c1e22", "#e2e5ea"),
        (role.Button, "#eef0f4", "#34383f"),
        (role.ButtonText, "#1c1e22", "#e2e5ea"),
        (role.BrightText, "#be2828", "#ff8a80"),
        (role.ToolTipBase, "#fffff0", "#3a3e46"),
        (role.ToolTipText, "#1c1e22", "#eceef2"),
        (role.Highlight, "#2d6ebe", "#306ab8"),
        (role.HighlightedText, "#ffffff", "#ffffff"),
        (role.Link, "#1e5fb4", "#7db6f5"),
        (role.PlaceholderText, "#60666e", "#a0a6af"),
        (role.Light, "#ffffff", "#424750"),
        (role.Midlight, "#e2e5ea", "#3e424a"),
        (role.Mid, "#c8ccd2", "#545a64"),
        (role.Dark, "#a0a5ad", "#121418"),
        (role.Shadow, "#6e737c", "#08090b"),
    )
    for which, light, night in table:
        palette.setColor(which, QColor(night if dark else light))
    for which in (role.WindowText, role.Text, role.ButtonText):
        palette.setColor(group.Disabled, which, QColor("#747a84" if dark else "#969aa0"))
    # sliders
    palette.setColor(group.Disabled, role.Highlight, QColor("#545a64" if dark else "#c8ccd2"))
    return palette


def use_palette(*, dark: bool) -> None:
    """Set the palette of the application, unless it is set already.

    Fusion outlines a control in its window colour, darker by `_FUSION_OUTLINE`: nearly invisible on
    a dark window. So the controls of `_OUTLINED`, which paint nothing else in that colour, get a
    window colour that makes the outline stand out 3 to 1.
    """
    palette = make_palette(dark=dark)
    if palette != QApplication.palette():
        QApplication.setPalette(palette)
        QToolTip.setPalette(palette)
        palette.setColor(
            QPalette.ColorRole.Window, to_qcolor(_OUTLINE[dark]).lighter(_FUSION_OUTLINE)
        )
        for kind in _OUTLINED:
            QApplication.setPalette(palette, kind)
