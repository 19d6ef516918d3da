"""A field for a number."""

from PyQt6.QtGui import QValidator
from PyQt6.QtWidgets import QDoubleSpinBox


class NumberBox(QDoubleSpinBox):
    """Writes a decimal point, as every figure of the window has, and takes a typed comma for one."""

    def validate(self, input: str | None, pos: int) -> tuple[QValidator.State, str, int]:  # noqa: A002 - Qt's name
        """Return whether the text is a number, and the text with a point; without this, 2,5 became 25."""
        return super().validate((input or "").replace(",", "."), pos)
