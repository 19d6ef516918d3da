"""Base of everything that connects a part of the window with the session."""

from PyQt6.QtCore import QObject

from app.document.session_controller import SessionController
from app.session.state import Session
from pipeline.translation.translate import Translation


class Feature(QObject):
    """Lives as long as the controller of the session, and sees it and the window.

    Subclasses override what they follow. Features follow in the order in which they are created.
    """

    def __init__(self, controller: SessionController) -> None:
        super().__init__(controller)
        self._controller = controller
        self._window = controller.window
        self._columns = controller.window.columns
        self._actions = controller.window.actions_by_name
        self._views = controller.views
        self._change = controller.change
        controller.session_shown.connect(self.show_session)
        controller.translation_shown.connect(self.show_translation)
        controller.frame_shown.connect(self.show_frame)
        controller.closing.connect(self.close)

    @property
    def _session(self) -> Session:
        return self._controller.session

    @property
    def _translation(self) -> Translation | None:
        """The recording on screen."""
        return self._views.translation

    def show_session(self) -> None:
        """Follow a change of the session."""

    def show_translation(self) -> None:
        """Follow another recording on screen, or the same one between other sensors."""

    def show_frame(self) -> None:
        """Follow a frame that is finished and on screen."""

    def close(self) -> None:
        """End what runs, as the window closes."""
