"""Combo box whose text ends in dots where there is no room for it; its tooltip has all of it."""

from __future__ import annotations

from typing import Any

from PyQt6.QtCore import Qt
from PyQt6.QtWidgets import QComboBox, QStyle, QStyleOptionComboBox, QStylePainter


class ElidingComboBox(QComboBox):
    """A combo box that cuts no letter in the middle."""

    def paintEvent(self, e: Any) -> None:  # noqa: N802
        """Paint the box with the part of the text that fits."""
        del e
        painter, option, style = QStylePainter(self), QStyleOptionComboBox(), self.style()
        self.initStyleOption(option)
        if style is not None:
            part = QStyle.SubControl.SC_ComboBoxEditField
            room = style.subControlRect(QStyle.ComplexControl.CC_ComboBox, option, part, self)
            icon_px = 0 if option.currentIcon.isNull() else option.iconSize.width() + 4
            elided = option.fontMetrics.elidedText(
                option.currentText, Qt.TextElideMode.ElideRight, room.width() - icon_px - 4
            )
            option.currentText = elided
        painter.drawComplexControl(QStyle.ComplexControl.CC_ComboBox, option)
        painter.drawControl(QStyle.ControlElement.CE_ComboBoxLabel, option)
