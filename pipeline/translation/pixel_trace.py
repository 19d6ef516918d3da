"""Trace of one pixel through all stages, forward and back, by the index maps of the methods."""

from pipeline.core.graph import StageResult, StageResults
from pipeline.stages.stage import GroundTruth, Stage
from pipeline.translation.catalogue import BUILT_IN, Catalogue
from pipeline.views.view import ProbePoint

SOURCE = "source"


def trace_forward(
    results: StageResults,
    row: int,
    col: int,
    cols: int,
    catalogue: Catalogue = BUILT_IN,
) -> tuple[ProbePoint, ...]:
    """Return the points of source pixel (row, col) of an image `cols` wide, in every evaluated
    stage.
    """
    marks = {
        SOURCE: ProbePoint(
            stage=SOURCE, index=row * cols + col, row=row, col=col, text=f"({col}, {row})"
        )
    }
    for name, result in results.items():
        before = marks.get(_made_from(result, catalogue.stage(name)))
        if before is not None and before.index >= 0:
            marks[name] = catalogue.views[name].trace_point(result.output, before)
    return tuple(marks.values())


def trace_to_source(
    results: StageResults, name: str, index: int, catalogue: Catalogue = BUILT_IN
) -> int:
    """Return the source pixel (flat index) that element `index` of a stage was made from.

    -1 if none.
    """
    while index >= 0 and name != SOURCE:
        result = results.get(name)
        if result is None:
            return -1
        flat = result.output.source_index.reshape(-1)
        index = int(flat[index]) if index < flat.size else -1
        name = _made_from(result, catalogue.stage(name))
    return index


def describe_truth(
    column: str, row: int, col: int, facts: GroundTruth, catalogue: Catalogue = BUILT_IN
) -> str:
    """Return the truth at a pixel of a column as text; "" where unknown."""
    at_source = column == SOURCE or catalogue.stage(column).sensor_role == "source"
    truth = facts.source_truth if at_source else facts.target_truth
    if truth is None or truth.indentation_mm is None:
        return ""
    rows, cols = truth.indentation_mm.shape
    if not (0 <= row < rows and 0 <= col < cols):
        return ""
    touched = "" if truth.contact is None or truth.contact[row, col] else ", not in contact"
    return f"{float(truth.indentation_mm[row, col]):.3f} mm{touched}"


def _made_from(result: StageResult, stage: Stage) -> str:
    """Return the stage, or the source, whose elements `source_index` refers to.

    Truth refers to the first method's.
    """
    first = (result.method if result.method in stage.methods else stage.methods[0]).reads[0]
    return SOURCE if first == "frame" else first
