"""What is wrong with the frame on screen in one sentence, and the list of all that is."""

from collections.abc import Sequence
from functools import partial
from html import escape

from PyQt6.QtCore import pyqtSignal
from PyQt6.QtWidgets import QFrame, QMenu, QPushButton

from pipeline.core.frozen import frozen
from widgets.style.base import GROWS, PREFERS
from widgets.style.icons import StateIcon
from widgets.style.notification_bar import Choice, replace_buttons
from widgets.style.styling import fill, make_button, make_row, make_text, name_widget


@frozen
class Finding:
    """Something that is wrong: a sentence, and the stage it is about ("" = none)."""

    sentence: str
    stage: str = ""


class VerdictLine(QFrame):
    """One sentence with its buttons; a menu lists everything else.

    `finding_chosen` carries the stage of an entry.
    """

    finding_chosen = pyqtSignal(str)

    def __init__(self) -> None:
        super().__init__()
        name_widget(self, "verdict", "verdict")
        self.setFrameShape(QFrame.Shape.StyledPanel)
        self.sentence = ""
        self.findings: tuple[Finding, ...] = ()
        self._sign = StateIcon()
        self._sentence = make_text(rich=True)
        self._sentence.setSizePolicy(GROWS, PREFERS)
        self.list_button = make_button("", "findings", "Everything that is wrong with this frame")
        self._menu = QMenu(self.list_button)
        self.list_button.setMenu(self._menu)
        self._row = make_row(8, around_px=(8, 2, 2, 2), on=self)
        fill(self._row, self._sign, (self._sentence, 1), self.list_button)
        self.buttons: list[QPushButton] = []  # that mend what is wrong, or show where
        self.hide()

    @property
    def text(self) -> str:
        """The sentence, without markup, and all findings."""
        return "\n".join((self.sentence, *(finding.sentence for finding in self.findings)))

    def show_verdict(
        self,
        state: str,
        sentence: str,
        cause: str = "",
        findings: Sequence[Finding] = (),
        choices: Sequence[Choice] = (),
    ) -> None:
        """Show a state's sign, a sentence in bold letters and its cause, and all findings."""
        self.sentence = " ".join(filter(None, (sentence, cause)))
        self._sign.show_state(state)
        self._sentence.setText(f"<b>{escape(sentence)}</b> {escape(cause)}")
        self.setVisible(bool(self.sentence))  # an empty bar would take a row of every page
        self.findings = tuple(findings)
        self._menu.clear()
        for finding in self.findings:
            action = self._menu.addAction(finding.sentence.replace("&", "&&"))
            assert action is not None
            action.triggered.connect(partial(self._choose, finding.stage))
        self.list_button.setText("1 finding" if len(findings) == 1 else f"{len(findings)} findings")
        self.list_button.setVisible(bool(findings))
        self.buttons = replace_buttons(self._row, 2, self.buttons, choices, lambda: None)

    def _choose(self, stage: str, _checked: bool) -> None:
        self.finding_chosen.emit(stage)
