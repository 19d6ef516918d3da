"""The inspector: parameters of the chosen stage, figures of the frame, and where its error comes
from.
"""

from collections.abc import Sequence

from PyQt6.QtCore import Qt
from PyQt6.QtWidgets import QFormLayout, QLabel, QWidget

from widgets.frames.error_attribution_panel import ErrorAttributionPanel
from widgets.stages.parameters_panel import ALL_STAGES, ParametersPanel
from widgets.style.base import enlarge_font
from widgets.style.styling import (
    make_bold,
    make_button,
    make_column,
    name_widget,
    set_spacing,
)

_WIDTH_PX = 260
_FIGURE_PT = 2.0  # by which figures are larger than text


class Inspector(QWidget):
    """Parameters over figures over the attribution of the error."""

    def __init__(self, parameters: ParametersPanel, attribution: ErrorAttributionPanel) -> None:
        super().__init__()
        name_widget(self, "inspector", "inspector")
        self.setFixedWidth(_WIDTH_PX)
        self._parameters = parameters
        self._stage = ""
        self.all_button = make_button(
            "All parameters", "all_parameters", "Show the parameters of every stage, or of this one"
        )
        self.all_button.setCheckable(True)
        self.all_button.toggled.connect(self._choose)
        self._title = make_bold(QLabel("This frame"))
        self._figures = set_spacing(QFormLayout(), 2)
        self._figures.setFieldGrowthPolicy(QFormLayout.FieldGrowthPolicy.AllNonFixedFieldsGrow)
        make_column(
            8,
            (parameters, 1),
            self.all_button,
            self._title,
            self._figures,
            attribution,
            around_px=(4, 4, 4, 4),
            on=self,
        )

    def show_stage(self, stage: str) -> None:
        """Show the parameters of a stage."""
        self._stage = stage
        self._choose()

    def _choose(self, *_: object) -> None:
        self._parameters.show_stage(ALL_STAGES if self.all_button.isChecked() else self._stage)

    def show_figures(self, figures: Sequence[tuple[str, str, str]]) -> None:
        """Show (title, value, tooltip) of what is known of the frame."""
        while self._figures.rowCount():
            self._figures.removeRow(0)
        for title, value, tip in figures:
            label, number = QLabel(title), QLabel(value)
            label.setWordWrap(True)
            enlarge_font(number, _FIGURE_PT)
            number.setAlignment(Qt.AlignmentFlag.AlignRight | Qt.AlignmentFlag.AlignVCenter)
            for widget in (label, number):
                widget.setToolTip(tip)
            self._figures.addRow(label, number)
        self._title.setVisible(bool(figures))
