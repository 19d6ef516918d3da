"""Sweep guidance: how strongly the generated touch follows the measured one, against the
recorded truth.
"""

import tactoscope as ts

with ts.open("sample_data/recordings/first_touch.h5", "soft_bubble", source="gelslim") as touches:
    errors_mm = {}
    for guidance in (0.0, 1.0, 2.0, 4.0):
        # only the touch and what follows is computed again
        frame = touches.with_(method="t2d2", steps=4, guidance=guidance)[5]
        errors_mm[guidance] = frame.metrics["touch_depth.contact_mae_mm"]
        print(f"guidance {guidance:g}: {errors_mm[guidance]:.3f} mm in contact")

best = min(errors_mm, key=errors_mm.get)
print(f"best here: {best:g}")
