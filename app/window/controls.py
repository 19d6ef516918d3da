"""Shows the session's values on the window's controls."""

from collections.abc import Mapping, Sequence

from PyQt6.QtCore import QSignalBlocker

from app.session.state import DISPLAY_KEY, Session
from app.window.main_window import MainWindow
from pipeline.core.graph import Method
from pipeline.translation.catalogue import Catalogue, Route
from pipeline.translation.translate import Translation


def show_controls(
    window: MainWindow,
    session: Session,
    route: Route,
    methods: Sequence[Method],
    catalogue: Catalogue,
    opened: Translation | None,
    unavailable: Mapping[str, Mapping[str, str]],
) -> None:
    """Show a session with this route and these methods on the controls, without change signals.

    `opened` is on screen.

    Only the parameters for the sensors' kinds are shown; those in `unavailable` (method key ->
    parameter -> reason) are greyed out.
    """
    kinds = map_sensor_kinds(methods, catalogue, opened)
    window.timeline.show_frame(session.frame)
    window.frames.show_frame(session.frame)
    for stage in catalogue.stages:
        for method in catalogue.list_choices(stage.name):
            if method.kinds and opened is not None:
                window.columns[stage.name].enable_method(
                    method.name, method.fits(opened.sensor_kinds[stage.sensor_role])
                )
            window.parameters.show_params(method.key, session.get_params(method))
    window.parameters.show_params(DISPLAY_KEY, session.display)
    window.parameters.show_groups(
        {**{m.key: kinds.get(m.key, "") for m in methods}, DISPLAY_KEY: ""}
    )
    for method in methods:
        column = window.columns[method.stage]
        column.show_method(method.name)
        window.look.filmstrip.thumbnails[method.stage].show_method(column.method_title)
        window.parameters.show_unavailable(method.key, unavailable.get(method.key, {}))
    for name in ("source", "target", "route"):
        box = getattr(window, name)
        value = route.name if name == "route" else getattr(session, name)
        with QSignalBlocker(box):
            box.setCurrentIndex(max(0, box.findData(value)))
    window.actions_by_name["link_cameras"].setChecked(session.cameras_linked)
    window.actions_by_name["close_mesh"].setEnabled(session.mesh is not None)
    window.actions_by_name["close_weights"].setEnabled(bool(session.weights))


def map_sensor_kinds(
    methods: Sequence[Method], catalogue: Catalogue, opened: Translation | None
) -> dict[str, str]:
    """Method key -> kind of sensor it reads; {} if nothing is open."""
    if opened is None:
        return {}
    kind = {"source": opened.source.kind, "target": opened.target.kind}
    return {method.key: kind[catalogue.stage(method.stage).sensor_role] for method in methods}
