"""The method that every stage with known truth has besides its own: what the recording knows in
place of a computation.

It pins a cause: with the truth in one stage, only the errors of those after it remain. Every result
made with it says so by a warning.
"""

from dataclasses import replace
from functools import partial
from typing import Any

from pipeline.core.errors import SettingProblem, StageWarning
from pipeline.core.graph import Method
from pipeline.core.params import NoParams
from pipeline.core.progress import Progress
from pipeline.stages.stage import Stage

TRUTH = "truth"  # name of the method


def make_truth_method(stage: Stage) -> Method:
    """Return the method whose value is the recording's truth of a stage."""
    return Method(
        stage=stage.name,
        name=TRUTH,
        title="Truth",
        run=partial(_return_truth, stage.title.lower()),
        params=NoParams,
        reads=(get_input_name(stage.name),),
        help="what the recording knows, in place of a computation",
    )


def get_input_name(stage: str) -> str:
    """Return the name of the input that holds a stage's truth."""
    return f"true_{stage}"


def _return_truth(title: str, value: Any | None, _params: NoParams, _progress: Progress) -> Any:
    if value is None:
        raise SettingProblem(
            f"the recording does not know the true {title} of this frame; choose another method "
            "for it"
        )
    warning = StageWarning(
        f"with true {title}: the recording's truth is in place of a computation; unpin it"
    )
    return replace(value, notes=(warning, *value.notes))
