"""The tasks by name. A task is one module with `TASK` and one line here, or an entry point in `tactoscope.tasks`."""

from pipeline.base.entry_points import load_entry_points, load_reference
from pipeline.base.errors import SettingProblem
from pipeline.tasks.task import ManipulationTask

_TASKS = {
    "insertion": "pipeline.tasks.insertion:TASK",
    "stack": "pipeline.tasks.stack:TASK",
    "marble": "pipeline.tasks.marble:TASK",
}


def load_task(name: str) -> ManipulationTask:
    """The task of this name; raises SettingProblem."""
    added = {task.name: task for task in load_entry_points("tactoscope.tasks") if isinstance(task, ManipulationTask)}
    if name in added:
        return added[name]
    if name not in _TASKS:
        known = ", ".join(sorted({*_TASKS, *added}))
        raise SettingProblem(f"no task {name!r}; there are {known}, and TOML files of tools for insertion")
    return load_reference(_TASKS[name])
