"""Combo box of named choices."""

from collections.abc import Mapping
from typing import Any

from PyQt6.QtCore import QSignalBlocker, Qt, pyqtSignal
from PyQt6.QtWidgets import QComboBox, QStyle, QStyleOptionComboBox, QStylePainter


class ChoiceBox(QComboBox):
    """Offers names by their texts; a text that does not fit ends in dots. `chosen` carries what the user chose."""

    chosen = pyqtSignal(str)

    def __init__(self, name: str, description: str, choices: Mapping[str, str] | None = None) -> None:
        """`name` finds the box, `description` is what a screen reader says."""
        super().__init__()
        self.setObjectName(name)
        self.setAccessibleName(description)
        self.setSizeAdjustPolicy(QComboBox.SizeAdjustPolicy.AdjustToContents)
        self.offer(choices or {})
        self.activated.connect(lambda: self.chosen.emit(self.choice))

    @property
    def choice(self) -> str:
        """Name of the current choice; "" for none."""
        return str(self.currentData() or "")

    def offer(
        self, choices: Mapping[str, str], chosen: str | None = None, tips: Mapping[str, str] | None = None
    ) -> None:
        """Offer name -> text and show `chosen`, by default the choice before, else the first; emits no signal.

        `tips` are tooltips by name.
        """
        chosen = self.choice if chosen is None else chosen
        with QSignalBlocker(self):
            if [self.itemData(i) for i in range(self.count())] != list(choices):
                self.clear()
                for name, text in choices.items():
                    self.addItem(text, name)
                    self.setItemData(self.count() - 1, (tips or {}).get(name), Qt.ItemDataRole.ToolTipRole)
            self.setCurrentIndex(max(0, self.findData(chosen)))

    def paintEvent(self, e: Any) -> None:  # noqa: N802
        """Paint the box with the part of the text that fits."""
        del e
        painter, option, style = QStylePainter(self), QStyleOptionComboBox(), self.style()
        self.initStyleOption(option)
        if style is not None:
            part = QStyle.SubControl.SC_ComboBoxEditField
            room = style.subControlRect(QStyle.ComplexControl.CC_ComboBox, option, part, self)
            icon_px = 0 if option.currentIcon.isNull() else option.iconSize.width() + 4
            end = Qt.TextElideMode.ElideRight
            option.currentText = option.fontMetrics.elidedText(option.currentText, end, room.width() - icon_px - 4)
        painter.drawComplexControl(QStyle.ComplexControl.CC_ComboBox, option)
        painter.drawControl(QStyle.ControlElement.CE_ComboBoxLabel, option)
