"""Align two sensors: refine where one is relative to the other, on touches that both recorded."""

import numpy as np

import tactoscope as ts

with ts.open("sample_data/recordings/digit_gelslim.h5", "gelslim", source="digit") as touches:
    fit = ts.align(touches, frames=range(0, len(touches), 2))
    before, after = fit.used_fit
    print(f"surfaces differ by {before.surface_mm:.3f} mm before, {after.surface_mm:.3f} mm after")
    print("predicted standard deviation (deg, mm):", np.round(fit.std, 3))
    print("not determined:", ", ".join(fit.weak_directions) or "nothing")
    frame = touches.with_alignment(fit.alignment)[2]
    print(
        f"contact IoU of frame 2: {touches[2].metrics['touch_depth.contact_iou']:.3f} before,",
        end=" ",
    )
    print(f"{frame.metrics['touch_depth.contact_iou']:.3f} after")
