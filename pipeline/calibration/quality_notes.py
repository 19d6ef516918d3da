"""What a look-up is worth, in words: for the terminal, the window and a frame's notes."""

from __future__ import annotations

from pipeline.base.stage_warnings import StageWarning
from pipeline.calibration.calibration_table import Calibration

CALIBRATION_ADVICE = "press a ball in sixteen places all over the picture and run 'tactoscope calibrate balls'"
UNCALIBRATED = "uncalibrated look-up"
_ODD = 1.6  # times: the presses read by the described lights as a ball so much larger or smaller than was said
UNCALIBRATED_NOTE = StageWarning(
    f"{UNCALIBRATED}: a real unit's sizes and depths may be wrong by half; {CALIBRATION_ADVICE}"
)


def describe_quality(calibration: Calibration) -> str:
    """One sentence on the sizes and depths that come from this look-up."""
    if not calibration.presses:
        return UNCALIBRATED_NOTE
    if describe_size_mismatch(calibration):
        return StageWarning(describe_size_mismatch(calibration))
    n_used = sum(p.used for p in calibration.presses)
    error = calibration.expected_error
    worth = "" if error is None else f"a ball's diameter within {100 * error.diameter_share:.0f} %"
    if calibration.uses_built_in:
        told = f"; {worth}" if worth else ""
        return StageWarning(
            f"{UNCALIBRATED}: {n_used} presses did not surely better it{told}; {CALIBRATION_ADVICE}, with other pictures"
        )
    return f"{worth}{': ' if worth else ''}look-up from {n_used} presses of a ball"


def describe_size_mismatch(calibration: Calibration) -> str:
    """What speaks against the ball's size that was given; "" = nothing does."""
    share = calibration.diameter_ratio
    if share is None or 1.0 / _ODD < share < _ODD:
        return ""
    return (f"the presses of this calibration look like those of a ball of {share:.2g} times the diameter that was "
            "given: is it the radius that was, or another width of a pixel?")  # fmt: skip


def format_calibration(calibration: Calibration) -> list[str]:
    """The look-up as lines for a terminal."""
    size = f"{calibration.cols} x {calibration.rows} px of {calibration.pixel_mm:.4f} mm"
    used = [p.residual for p in calibration.presses if p.used]
    out = [f"calibration of {calibration.sensor}, {size}", f"  look-up: {calibration.origin}"]
    if used:
        out.append(f"  slope residual {calibration.residual:.3f} mm/mm over {len(used)} presses")
    odd = describe_size_mismatch(calibration)
    return [*out, f"  {describe_expected_error(calibration)}", *([f"  doubtful: {odd}"] if odd else [])]


def describe_expected_error(calibration: Calibration) -> str:
    """The error to be expected, and what the statement rests on."""
    error = calibration.expected_error
    if error is None:
        return describe_quality(calibration)
    basis = f"checked on {error.n_held_out} presses held out" if error.n_held_out else "foreseen, no press was held out"
    return (
        f"expected error of a ball's diameter {100 * error.diameter_share:.0f} %, of its depth "
        f"{100 * error.depth_share:.0f} %; {basis}"
    )
