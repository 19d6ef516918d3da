"""The Reference menu: what the source's frames are compared with."""

from functools import partial

from app.document.feature import Feature
from app.document.session_controller import SessionController
from pipeline.io.reference_estimate import MEDIAN, UNTOUCHED


class ReferenceController(Feature):
    """Chooses the reference, and shows which one is chosen."""

    def __init__(self, controller: SessionController) -> None:
        super().__init__(controller)
        choose = controller.choose_reference_frames
        connect = controller.window.connect_command
        connect("reference_median", partial(choose, MEDIAN))
        connect("reference_untouched", partial(choose, UNTOUCHED))
        connect("reference_frame", lambda: choose(str(controller.session.frame)))
        connect("reference_recorded", partial(choose, ""))
        for action in (action for name, action in self._actions.items() if "reference" in name):
            # a choice that changes nothing keeps its mark
            action.triggered.connect(self.show_session)
        self.show_session()

    def show_translation(self) -> None:
        """Offer what fits the source."""
        self.show_session()

    def show_session(self) -> None:
        """Mark what the session chooses."""
        session = self._session
        opened = self._translation
        frames = session.reference_frames
        chosen = {
            "reference_median": frames == MEDIAN,
            "reference_untouched": frames == UNTOUCHED,
            "reference_frame": frames == str(session.frame),
            "open_reference": session.reference is not None,
            "reference_recorded": not frames and session.reference is None,
        }
        for name, is_chosen in chosen.items():
            self._actions[name].setChecked(is_chosen)
            # a file may be chosen before the recording that it is for
            self._actions[name].setEnabled(
                name == "open_reference" or session.recording is not None
            )
        self._actions["reference_untouched"].setVisible(
            opened is None or opened.source.kind == "gel"
        )
