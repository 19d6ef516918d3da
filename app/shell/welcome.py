"""The welcome page, shown while nothing is open."""

from app.document.autosave import AutosaveController
from app.document.feature import Feature
from app.document.session_controller import SessionController
from app.session.sample import SAMPLE_RECORDING
from pipeline.io.formats import list_formats
from widgets.shell.welcome import WelcomePage

_MAX_SUFFIXES = 3  # of a format; the file dialog has all
_COMMANDS = ("open_sample", "open_recording", "open_folder", "live")


class WelcomeController(Feature):
    """Connects the page with the session."""

    def __init__(self, controller: SessionController, autosave: AutosaveController) -> None:
        super().__init__(controller)
        self._autosave, window = autosave, self._window
        centre = window.centralWidget()
        assert centre is not None
        actions = window.actions_by_name
        formats = "\n".join(
            f"{f.title} ({' '.join(f.suffixes[:_MAX_SUFFIXES]) or 'folder'})"
            for f in list_formats()
        )
        self.page = WelcomePage(
            centre, window.pages, [actions[name] for name in _COMMANDS], formats
        )
        self.page.recent_chosen.connect(controller.open_path)
        self.page.hide()
        actions["open_sample"].setEnabled(SAMPLE_RECORDING.exists())
        window.connect_command("open_sample", self.open_sample)
        self.show_session()

    def open_sample(self) -> None:
        """Open the sample recording."""
        self._controller.open_path(SAMPLE_RECORDING)

    def show_session(self) -> None:
        """Show the page if nothing is open."""
        # whose pages may read a folder
        is_empty = self._session.recording is None and self._session.layout.name not in (
            "track",
            "task",
            "folder",
        )
        if is_empty and self.page.isHidden():
            self.page.show_recent(self._autosave.preferences.recent_files)
            self.page.raise_()
        self.page.setVisible(is_empty)
