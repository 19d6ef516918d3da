"""A method is one module and one line, a stage one folder and one entry: toys made here go
everywhere.
"""

from __future__ import annotations

import math
import subprocess
import sys
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pipeline.core.errors import SettingProblem, select_warnings
from pipeline.core.params import list_settings
from pipeline.stages.touch_depth.stage import NO_MEMBRANE
from pipeline.translation import pixel_trace
from pipeline.translation.catalogue import BUILT_IN, with_method
from pipeline.translation.reports.report import (
    collect_stage_arrays,
    write_frame,
    write_report,
)
from pipeline.translation.translate import Request, open_translation
from pipeline.translation.translated_frame import FrameReport
from tests.pipeline.translation.toys import TOYS

SAMPLE = Path(__file__).parents[3] / "sample_data" / "recordings" / "first_touch.h5"
TOUCHED = 5


@pytest.fixture(scope="module")
def toy():
    opened = open_translation(
        Request(recording=SAMPLE, source="digit", target="gelslim", route="toy"), TOYS
    )
    yield opened
    opened.recording.close()


@pytest.fixture(scope="module")
def results(toy):
    return toy.evaluate(TOUCHED)


def test_a_route_has_its_own_slots_and_no_others(toy, results):
    assert list(results) == ["brightness", "touch", "touch_depth", "pose"]
    assert results["touch"].output.membrane is None
    assert results["touch_depth"].output.camera == toy.target.camera
    assert "melted" in results["touch"].notes


def test_what_a_toy_slot_says_reaches_figures_arrays_sheet_and_trace(toy, results, tmp_path):
    metrics = toy.compute_metrics(results, TOUCHED)
    assert metrics["brightness.contact_mae_mm"] == 0.0
    assert "touch.psnr_db" in metrics
    report = FrameReport(index=TOUCHED, results=results, metrics=metrics)
    frame = toy.stream.frame(TOUCHED)
    folder = write_frame(tmp_path, frame, report, toy, "key")
    assert (folder / "sheet.png").stat().st_size > 10_000
    assert collect_stage_arrays(frame, results)["brightness.share"].shape == frame.image.shape[:2]
    assert (
        '"contact_mae_mm"'
        not in write_report(tmp_path, toy, [report]).read_text().partition("frames")[0]
    )
    marks = pixel_trace.trace_forward(results, 3, 4, frame.image.shape[1], TOYS)
    assert [mark.stage for mark in marks] == ["source", "brightness", "touch"]
    assert marks[1].text.endswith("bright")
    assert pixel_trace.trace_to_source(results, "brightness", 17, TOYS) == 17


def test_parameters_and_methods_of_a_toy_are_set_by_name(toy, results):
    assert not toy.with_(gain=0)[TOUCHED].touch.image.any()
    assert results["touch"].output.image.any()
    with pytest.raises(
        SettingProblem, match="no method 'melt' for the stage 'touch'; there are physics"
    ):
        BUILT_IN.methods("t2d2", with_method({}, "touch=melt"))
    with pytest.raises(SettingProblem, match="stage=method"):
        with_method({}, "touch")


def test_a_touch_without_a_membrane_is_read_as_recorded_and_the_note_says_so(toy):
    asked = replace(toy, request=replace(toy.request, methods=(("touch_depth", "membrane"),)))
    result = asked.evaluate(TOUCHED, ["touch_depth"])["touch_depth"]
    assert NO_MEMBRANE in (*result.notes, *result.output.notes)
    read = replace(toy, request=replace(toy.request, methods=(("touch_depth", "from_image"),)))
    same = read[TOUCHED].touch_depth
    assert np.array_equal(result.output.indentation_mm, same.indentation_mm)


def test_the_truth_may_stand_for_a_slot(toy):
    """Blame by substitution: what is given is not worked out, and what rests on it is."""
    chain = replace(toy, request=replace(toy.request, route="t2d2"))
    measured = chain.evaluate(TOUCHED, chain.stages[:2])
    truth = chain.read_source_truth(TOUCHED)
    exact = replace(
        measured["depth"].output,
        indentation_mm=truth.indentation_mm,
        contact=truth.contact,
        depth_mm=(chain.source.rest_depth_mm - truth.indentation_mm).astype(np.float32),
    )
    given = chain.evaluate(TOUCHED, chain.stages[:2], given={"depth": exact})
    assert given["depth"].state == "given"
    assert given["depth"].output is exact
    assert given["cloud"].state == "computed"
    assert len(given["cloud"].output.points_mm) == np.count_nonzero(truth.contact)


def test_a_bubble_is_read_by_the_network_unless_somebody_says_otherwise():
    assert BUILT_IN.methods("t2d2", {"depth": "physics"})[0].name == "physics"
    with closing(
        open_translation(Request(recording=SAMPLE, source="soft_bubble", target="gelslim"))
    ) as opened:
        assert opened.methods[0].name == "network"
        assert opened.methods[0].weights_name in opened.read_inputs(TOUCHED)


def test_a_method_for_another_kind_of_sensor_makes_way_and_a_note_says_so():
    """A network of bubbles is no choice for a gel."""
    plain = Request(recording=SAMPLE, source="digit", target="soft_bubble")
    with closing(open_translation(plain)) as opened:
        assert opened.methods[0].name == "physics"
        assert not any("is for sensors" in note for note in opened.notes)
    with closing(open_translation(replace(plain, methods=(("depth", "network"),)))) as opened:
        assert opened.methods[0].name == "physics"
        (note,) = select_warnings(opened.notes)
        assert "'Network' is for sensors of kind bubble, and DIGIT is a gel" in note
        assert "(depth=physics)" in note
    with closing(open_translation(replace(plain, methods=(("depth", "truth"),)))) as opened:
        assert not any("is for sensors" in note for note in opened.notes), "truth of any sensor"


def test_a_gels_depth_loads_no_torch():
    code = f"""
import sys
from pathlib import Path
from pipeline.translation.translate import Request, open_translation
opened = open_translation(Request(recording=Path({str(SAMPLE)!r}), source="digit", target="soft_bubble"))
opened[{TOUCHED}].depth
assert "torch" not in sys.modules
"""
    subprocess.run([sys.executable, "-c", code], check=True)


_UNITS = {"mm": "mm", "um": "um", "px": "px", "deg": "deg", "ms": "ms"}
_NO_UNIT = {"guidance", "seed"}  # a name more than a number


def _all_settings():
    return {
        f"{method.key}.{name}": (value, setting)
        for stage in BUILT_IN.stages
        for method in stage.methods
        for name, (value, setting) in list_settings(method.params()).items()
    }


@pytest.mark.parametrize("key", sorted(_all_settings()))
def test_every_parameter_says_meaning_unit_range_and_where_it_comes_from(key):
    value, setting = _all_settings()[key]
    name = key.rpartition(".")[2]
    assert len(setting.help) >= 12, "what it means, so that it can be set without the code"
    assert setting.help.casefold() != setting.label.casefold()
    assert setting.source, "an equation's paper, or that it is our own"
    if isinstance(value, str):
        assert value in setting.choices
    elif not isinstance(value, bool):
        assert -math.inf < setting.low <= value <= setting.high < math.inf
        assert setting.unit or name in _NO_UNIT
        assert setting.unit == _UNITS.get(name.rpartition("_")[2], setting.unit), (
            "the name says the unit"
        )


def test_every_stage_has_a_view():
    assert set(BUILT_IN.views) == {stage.name for stage in BUILT_IN.stages}
