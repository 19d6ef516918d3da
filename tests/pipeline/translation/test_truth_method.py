"""The truth of a recording as a method: what it leaves of the error, and where it is not known."""

from __future__ import annotations

from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest

from app.session.sample import SAMPLE_RECORDING
from pipeline.core.errors import SettingProblem
from pipeline.translation.catalogue import BUILT_IN
from pipeline.translation.error_attribution import DEFAULT_METRIC, attribute_error
from pipeline.translation.pixel_trace import trace_to_source
from pipeline.translation.reports.export import export_file
from pipeline.translation.reports.export_request import ExportRequest
from pipeline.translation.reports.report import collect_stage_arrays
from pipeline.translation.reports.sheet import draw_sheet, render_pane
from pipeline.translation.translate import Request, open_translation
from pipeline.translation.translated_frame import FrameReport
from pipeline.views.display_params import DisplayParams

FRAME = 5


@pytest.fixture(scope="module")
def sample():
    request = Request(
        recording=SAMPLE_RECORDING,
        source="gelslim",
        target="soft_bubble",
        methods=(("depth", "physics"), ("touch", "physics")),
    )
    with closing(open_translation(request)) as opened:
        yield opened


def pin(opened, *stages):
    methods = {**dict(opened.request.methods), **dict.fromkeys(stages, "truth")}
    return replace(opened, request=replace(opened.request, methods=tuple(methods.items())))


def evaluate(opened, stage, index=FRAME):
    return opened.evaluate(index, [stage])


def test_the_error_that_remains_is_that_of_the_attribution(sample):
    shares = attribute_error(sample, FRAME).shares
    results = evaluate(pin(sample, "depth"), "touch_depth")
    assert results["depth"].method.name == "truth"
    assert sample.compute_metrics(results, FRAME)[DEFAULT_METRIC] == shares[0].remaining
    pinned = pin(sample, "depth", "target_depth")
    results = evaluate(pinned, "touch_depth")
    assert "depth" not in results  # nothing reads it any more
    assert sample.compute_metrics(results, FRAME)[DEFAULT_METRIC] == next(
        s.remaining for s in shares[::-1] if s.stage == "target_depth"
    )


def test_a_pixel_is_followed_through_the_truth(sample):
    results = evaluate(pin(sample, "depth"), "cloud")
    contact = np.flatnonzero(results["depth"].output.contact)
    assert trace_to_source(results, "depth", int(contact[0])) == contact[0]


def test_a_frame_without_truth_is_named(sample):
    opened = pin(replace(sample, stream=replace(sample.stream, truth=lambda _: None)), "depth")
    with pytest.raises(SettingProblem, match="true depth of this frame"):
        evaluate(opened, "depth")


def test_a_stage_whose_truth_no_recording_knows_has_no_such_method():
    assert "truth" not in [method.name for method in BUILT_IN.list_choices("cloud")]
    with pytest.raises(SettingProblem, match="truth"):
        BUILT_IN.method("cloud", "truth")


def test_every_output_made_with_a_truth_says_so(sample, tmp_path):
    pinned = pin(sample, "depth")
    assert (sample.truth_label, pinned.truth_label) == ("", "with true depth")
    results = evaluate(pinned, "touch_depth")
    assert "with true depth" in results["depth"].warnings[0]
    report = FrameReport(index=FRAME, results=results, metrics={})
    frame = pinned.stream.frame(FRAME)
    sheet = draw_sheet(frame, report, pinned)
    assert "with true depth" in sheet.get_suptitle()
    assert render_pane("touch", frame, results, pinned, DisplayParams()).title.endswith(
        "with true depth"
    )
    assert "depth.is_truth" in collect_stage_arrays(frame, results)
    assert "depth.is_truth" not in collect_stage_arrays(frame, evaluate(sample, "touch_depth"))
    table = tmp_path / "table.csv"
    outcome = export_file(
        ExportRequest(request=pinned.request, path=table, frames=str(FRAME), pane="depth")
    )
    assert outcome.fallbacks == ("with true depth",)
    assert table.read_text().splitlines()[0].endswith(",with true depth")


def test_panes_and_sheets_name_what_answered(sample):
    """A method that falls back to physics does not give it its name."""
    chosen = replace(
        sample, request=replace(sample.request, methods=(("depth", "physics"), ("touch", "vqvae")))
    )
    results = evaluate(chosen, "touch")
    assert results["touch"].fallback
    frame = chosen.stream.frame(FRAME)
    assert (
        render_pane("touch", frame, results, chosen, DisplayParams()).title
        == "Generated touch · physics"
    )
    sheet = draw_sheet(frame, FrameReport(index=FRAME, results=results, metrics={}), chosen)
    assert not [axes for axes in sheet.axes if "VQ-VAE" in axes.get_title()]
