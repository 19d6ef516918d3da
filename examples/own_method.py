"""An own method: a contact rule of your own, in place of the one of the depth stage."""

from dataclasses import dataclass, replace

import tactoscope as ts


@dataclass(frozen=True, slots=True, kw_only=True)
class Params:
    limit_mm: float = ts.setting(0.1, "Limit", unit="mm", low=0.0, high=2.0)


with ts.open("sample_data/recordings/first_touch.h5", "soft_bubble", source="gelslim") as touches:
    depth = touches.get_method("depth")

    def threshold(*reads):
        *inputs, params, progress = reads
        measured = depth.run(*inputs, depth.params(), progress)
        return replace(measured, contact=measured.indentation_mm > params.limit_mm)

    mine = replace(depth, name="mine", title="Limit", run=threshold, params=Params, nodes=())
    for limit_mm in (0.05, 0.2):
        frame = touches.with_(stage="depth", method=mine, limit_mm=limit_mm)[5]
        print(f"{limit_mm} mm: {frame.depth.contact.sum()} px", frame.metrics["depth.contact_iou"])
