"""What a presentation shows of a frame on screen and in a video: source, generated touch,
recorded touch if known.
"""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from PyQt6.QtCore import QSize
from PyQt6.QtGui import QImage

from app.document.evaluator import Evaluator
from app.session.state import Session
from app.views.stage_previews import SourcePreview, StagePreview
from app.window.jobs import JobReporter
from pipeline.core.arrays import Image
from pipeline.translation.reports.video import write_video
from pipeline.translation.translate import Translation
from pipeline.views.contrast import FittedContrast
from widgets.shell.presentation_view import PresentedPane, compose

SOURCE = "source"
GENERATED = "touch"


def choose_presented_stages(opened: Translation) -> tuple[str, ...]:
    """Return the columns of a presentation: the source, and the touch or else the last stage of
    the route.
    """
    return (SOURCE, GENERATED if GENERATED in opened.stages else opened.stages[-1])


def make_panes(
    opened: Translation, shown: Mapping[str, object], contrast: FittedContrast
) -> tuple[PresentedPane, ...]:
    """Return two panes, or three where the truth is known.

    () until both columns of the frame are there.
    """
    stage = choose_presented_stages(opened)[1]
    source = shown.get(SOURCE)
    part = shown.get(stage)
    if not isinstance(source, SourcePreview) or not isinstance(part, StagePreview):
        return ()
    by = ", ".join(filter(None, (part.result.answered_by, opened.truth_label)))
    target = opened.source.title if stage == "depth" else opened.target.title
    titles = [
        f"{opened.source.title}, recorded",
        f"{target}, {opened.catalogue.stage(stage).title.lower()}: {by}",
    ]
    previews = [source.preview, part.preview]
    if part.truth_view is not None:
        titles.append(f"{target}, recorded")
        previews.append(part.truth_view.truth)
    return tuple(
        PresentedPane(title=title, preview=preview)
        for title, preview in zip(titles, contrast.fit(*previews), strict=True)
    )


RATE_HZ = 10.0  # as the timeline plays


def write_presentation(
    session: Session, evaluator: Evaluator, size: QSize, path: Path, report: JobReporter
) -> str:
    """Write every frame of the session's recording as it is presented at `size`; returns the codec.

    Frames are at even sizes and `RATE_HZ`. Raises TouchError for a file that cannot be written.
    """
    even = QSize(size.width() // 2 * 2, size.height() // 2 * 2)
    return write_video(path, _draw_frames(session, evaluator, even, report), RATE_HZ)


def _draw_frames(
    session: Session, evaluator: Evaluator, size: QSize, report: JobReporter
) -> Iterator[Image]:
    opened, _ = evaluator.open_frame(session, report)
    contrast = FittedContrast()
    stages = choose_presented_stages(opened)
    for index in range(opened.n_frames):
        report.step(index / opened.n_frames, f"frame {index}")
        parts = _Parts(report)
        evaluator.evaluate_frame(session.with_updates(frame=index), stages, parts, truth_of=stages)
        yield _to_array(compose(make_panes(opened, parts.shown, contrast), size))


class _Parts(JobReporter):
    """Collects what a frame delivers; cancelled with the job that it is part of."""

    def __init__(self, whole: JobReporter) -> None:
        super().__init__(whole.job, whole.ticket)
        self.cancelled = whole.cancelled
        self.shown: dict[str, object] = {}

    def step(self, fraction: float, text: str) -> None:
        if self.cancelled.is_set():
            super().step(fraction, text)

    def deliver(self, part: object) -> None:
        result = getattr(part, "result", None)
        self.shown["source" if result is None else result.name] = part


def _to_array(image: QImage) -> Image:
    rgb = image.convertToFormat(QImage.Format.Format_RGB888)
    bits: Any = rgb.constBits()
    bits.setsize(rgb.sizeInBytes())
    rows = np.frombuffer(bits, np.uint8).reshape(rgb.height(), rgb.bytesPerLine())
    return rows[:, : 3 * rgb.width()].reshape(rgb.height(), rgb.width(), 3).copy()
