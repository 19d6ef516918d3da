"""Base of everything that connects a part of the window with the session."""

from PyQt6.QtCore import QObject

from app.document.session_controller import SessionController


class Feature(QObject):
    """Lives as long as the controller of the session, and sees it and the window."""

    def __init__(self, controller: SessionController) -> None:
        super().__init__(controller)
        self._controller = controller
        self._window = controller.window
