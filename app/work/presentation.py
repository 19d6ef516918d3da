"""What a presentation shows of a frame, on screen and in a video: source, generated touch, recorded touch if known."""

from __future__ import annotations

from collections.abc import Mapping

from app.work.stage_previews import SourcePreview, StagePreview
from pipeline.previews.contrast import FittedContrast
from pipeline.translation.translate import Translation
from widgets.presentation_view import PresentedPane

SOURCE, GENERATED = "source", "touch"


def choose_presented_stages(opened: Translation) -> tuple[str, ...]:
    """Return the columns of a presentation: the source, and the touch or else the last stage of the route."""
    return (SOURCE, GENERATED if GENERATED in opened.stages else opened.stages[-1])


def make_panes(opened: Translation, shown: Mapping[str, object], contrast: FittedContrast) -> tuple[PresentedPane, ...]:
    """Return two panes, or three where the truth is known; () until both columns of the frame are there."""
    stage = choose_presented_stages(opened)[1]
    source, part = shown.get(SOURCE), shown.get(stage)
    if not isinstance(source, SourcePreview) or not isinstance(part, StagePreview):
        return ()
    method = part.result.method
    by = "physics" if part.result.fallback else "" if method is None else method.title
    target = opened.source.title if stage == "depth" else opened.target.title
    titles = [f"{opened.source.title}, recorded", f"{target}, {opened.catalogue.stage(stage).title.lower()}: {by}"]
    previews = [source.preview, part.preview]
    if part.truth_view is not None:
        titles.append(f"{target}, recorded")
        previews.append(part.truth_view.truth)
    return tuple(
        PresentedPane(title=title.removesuffix(": "), preview=preview)
        for title, preview in zip(titles, contrast.fit(*previews), strict=True)
    )
