"""Splitter that chooses the sizes of its contents."""

from collections.abc import Sequence

from PyQt6.QtCore import QEvent, Qt
from PyQt6.QtWidgets import QSplitter

from widgets.event_listener import EventListener
from widgets.styling import make_single_shot_timer


class FittingSplitter(QSplitter):
    """Fits its contents until the user drags the handle; subclasses override `fit_sizes`."""

    def __init__(self) -> None:
        super().__init__(Qt.Orientation.Vertical)
        self.setChildrenCollapsible(False)
        self.is_user_sized = False  # afterwards the contents keep their share
        self._soon = make_single_shot_timer(self, 0, self.fit_sizes)
        self.splitterMoved.connect(self.keep_sizes)
        EventListener(self, self._soon.start, QEvent.Type.Resize)

    def fit_sizes(self) -> None:
        """Choose the sizes, unless the user set them."""
        raise NotImplementedError

    def keep_sizes(self) -> None:
        """Keep the sizes that the user chose."""
        self.is_user_sized = True

    def restore_sizes(self, sizes: Sequence[int]) -> None:
        """Restore user sizes; without sizes, fit the contents again."""
        self.is_user_sized = len(sizes) == self.count()
        if self.is_user_sized:
            self.setSizes(list(sizes))
        self._soon.start()
