"""Depth of a gel as a chain of nodes: rest -> change -> light -> slopes -> surface -> contact.

The graph evaluates them one by one, so that a changed parameter repeats only the nodes that read
it.
"""

from collections.abc import Callable
from typing import Any

from pipeline.core.graph import Method
from pipeline.core.params import NoParams
from pipeline.stages.depth.depth_params import DepthParams
from pipeline.stages.depth.gel.change import ChangeParams, detect_press
from pipeline.stages.depth.gel.contact import ContactParams, detect_contact
from pipeline.stages.depth.gel.light import estimate_light
from pipeline.stages.depth.gel.rest import describe_rest
from pipeline.stages.depth.gel.slopes import SlopeParams, measure_slopes
from pipeline.stages.depth.gel.surface import estimate_surface

READS = ("frame", "source", "calibration")


def _make_node(
    name: str,
    reads: tuple[str, ...],
    run: Any,
    params: Any,
    select: Callable[[DepthParams], Any] | None = None,
) -> Method:
    return Method(
        stage=f"depth.{name}",
        name=name,
        title=name.capitalize(),
        run=run,
        params=params,
        reads=reads,
        select_params=select,
    )


_REST, _CHANGE, _LIGHT, _SLOPES, _SURFACE = (
    f"depth.{n}" for n in ("rest", "change", "light", "slopes", "surface")
)
NODES = (
    _make_node("rest", READS, describe_rest, DepthParams),
    _make_node(
        "change",
        ("frame", _REST),
        detect_press,
        ChangeParams,
        lambda p: ChangeParams(contact_limit=p.contact_limit),
    ),
    _make_node("light", ("frame", _REST, _CHANGE), estimate_light, NoParams, lambda _: NoParams()),
    _make_node(
        "slopes",
        ("frame", _REST, _CHANGE, _LIGHT),
        measure_slopes,
        SlopeParams,
        lambda p: SlopeParams(sensitivity=p.sensitivity, smoothing_px=p.smoothing_px),
    ),
    _make_node(
        "surface", (_CHANGE, _SLOPES, _LIGHT), estimate_surface, NoParams, lambda _: NoParams()
    ),
    _make_node(
        "contact",
        ("frame", _REST, _CHANGE, _LIGHT, _SLOPES, _SURFACE),
        detect_contact,
        ContactParams,
        lambda p: ContactParams(contact_limit=p.contact_limit, pressure_share=p.pressure_share),
    ),
)
