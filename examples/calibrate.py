"""Calibrate a gel by presses of a ball, and use its table."""

import tactoscope as ts

# Yours in place of these: images of one ball of known diameter, pressed at a dozen places all over
# the gel.
stream = ts.simulate("sphere", ["digit"], n=6).stream()
presses = [stream.frame(index).image for index in range(stream.n_frames)]
reference = stream.frame(0).reference

table = ts.calibrate(presses, reference, sensor="digit", diameter_mm=10.0)
for press in table.presses:
    print(
        f"press {press.index}: residual {press.residual:.3f} mm/mm"
        if press.used
        else f"press {press.index}: not used"
    )
path = ts.save_calibration(table, "digit.npz")

depth = ts.depth(presses[0], reference, sensor="digit", calibration=path)
print(f"at most {depth.indentation_mm.max():.2f} mm deep")
