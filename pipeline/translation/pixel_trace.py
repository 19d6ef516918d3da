"""One pixel followed through every slot, forward and back, by the index maps that the methods hand on."""

from __future__ import annotations

from collections.abc import Mapping

from pipeline.engine.graph import StageResult
from pipeline.stages.stage import GroundTruth, ProbePoint, Stage
from pipeline.translation.catalogue import BUILT_IN, Catalogue

SOURCE = "source"


def trace_forward(
    results: Mapping[str, StageResult], row: int, col: int, cols: int, catalogue: Catalogue = BUILT_IN
) -> tuple[ProbePoint, ...]:
    """Marks of source pixel (row, col), of an image `cols` wide, in every slot that was evaluated, to where it ends."""
    marks = {SOURCE: ProbePoint(stage=SOURCE, index=row * cols + col, row=row, col=col, text=f"({col}, {row})")}
    for name, result in results.items():
        slot = catalogue.stage(name)
        before = marks.get(_made_from(result, slot))
        if before is not None and before.index >= 0:
            marks[name] = slot.trace_point(result.output, before)
    return tuple(marks.values())


def trace_to_source(results: Mapping[str, StageResult], name: str, index: int, catalogue: Catalogue = BUILT_IN) -> int:
    """The source pixel (flat) that element `index` of a slot was made from; -1 where none was."""
    while index >= 0 and name != SOURCE:
        result = results.get(name)
        if result is None:
            return -1
        flat = result.output.source_index.reshape(-1)
        index = int(flat[index]) if index < flat.size else -1
        name = _made_from(result, catalogue.stage(name))
    return index


def describe_truth(column: str, row: int, col: int, facts: GroundTruth, catalogue: Catalogue = BUILT_IN) -> str:
    """What is known to be true at a pixel of a column, in words; "" where nothing is."""
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
    """The slot, or the source, whose elements the value's `source_index` names."""
    first = (result.method or stage.methods[0]).reads[0]
    return SOURCE if first == "frame" else first
