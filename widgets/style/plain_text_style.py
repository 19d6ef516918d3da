"""Labels and tooltips show text as it is: a file's notes and names are no markup, and load no
images.
"""

from typing import Any

from PyQt6.QtCore import Qt
from PyQt6.QtWidgets import QLabel, QProxyStyle

# Qt's name of the label in a message box, whose texts are the program's own
_MESSAGE_BOX = "qt_msgbox_label"


class PlainTextStyle(QProxyStyle):
    """Qt's Fusion style in which a label that was not declared rich text is plain text, tooltips
    included.
    """

    def __init__(self) -> None:
        super().__init__("Fusion")

    def polish(self, *subject: Any) -> Any:  # pyright: ignore[reportIncompatibleMethodOverride] - three overloads
        """Prepare a widget before it is first shown."""
        for label in subject:
            is_undeclared = (
                isinstance(label, QLabel) and label.textFormat() == Qt.TextFormat.AutoText
            )
            if is_undeclared and label.objectName() != _MESSAGE_BOX:
                label.setTextFormat(Qt.TextFormat.PlainText)
        return super().polish(*subject)
