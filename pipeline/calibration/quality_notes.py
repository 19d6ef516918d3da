"""Notes on the quality of a calibration, for the terminal, the window and frames."""

from pipeline.calibration.calibration_table import Calibration
from pipeline.core.errors import CalibrationWarning, StageWarning

CALIBRATION_ADVICE = (
    "press a ball in sixteen places all over the image and run 'tactoscope calibrate balls'"
)
UNCALIBRATED = "sensor not calibrated"
# real units without calibration have 0.75 to 1.25; beyond, a length is wrong
_SIZE_RATIO_MAX = 1.35
UNCALIBRATED_NOTE = CalibrationWarning(
    f"{UNCALIBRATED}: sizes and depths may be wrong by half; {CALIBRATION_ADVICE}"
)


def describe_quality(calibration: Calibration) -> str:
    """One sentence on the accuracy of sizes and depths with this calibration."""
    if not calibration.presses:
        return UNCALIBRATED_NOTE
    if describe_size_mismatch(calibration):
        return StageWarning(describe_size_mismatch(calibration))
    n_used = sum(p.used for p in calibration.presses)
    error = calibration.expected_error
    worth = (
        ""
        if error is None
        else f"nine of ten balls' diameters within {100 * error.diameter_p90:.0f} %"
    )
    if calibration.depth_scale_map is not None:
        return (
            f"{worth}: depth scaled by {n_used} presses of a ball, where the light is not "
            "fitted to the touch"
        )
    if calibration.uses_built_in:
        accuracy = f"; {worth}" if worth else ""
        return CalibrationWarning(
            f"{UNCALIBRATED}: {n_used} presses did not improve it significantly{accuracy}; "
            f"{CALIBRATION_ADVICE} again"
        )
    return f"{worth}{': ' if worth else ''}calibrated by {n_used} presses of a ball"


def describe_size_mismatch(calibration: Calibration) -> str:
    """Why the given size of the ball may be wrong; "" if it fits."""
    share = calibration.diameter_ratio
    if share is None or 1.0 / _SIZE_RATIO_MAX < share < _SIZE_RATIO_MAX:
        return ""
    return (
        f"the presses look like a ball of {share:.2g} times the given diameter, so all sizes may "
        "be wrong: "
        "check that it is the diameter and not the radius, and the pixel width: "
        f"about {calibration.pixel_mm / share:.2g} mm would fit, not {calibration.pixel_mm:.2g} mm"
    )


def format_calibration(calibration: Calibration) -> list[str]:
    """The calibration as lines for a terminal."""
    size = f"{calibration.cols} x {calibration.rows} px of {calibration.pixel_mm:.4f} mm"
    used = sum(p.used for p in calibration.presses)
    out = [f"calibration of {calibration.sensor}, {size}", f"  table: {calibration.origin}"]
    if used:
        out.append(f"  slope residual {calibration.residual:.3f} mm/mm over {used} presses")
    odd = describe_size_mismatch(calibration)
    return [
        *out,
        f"  {describe_expected_error(calibration)}",
        *([f"  warning: {odd}"] if odd else []),
    ]


def describe_expected_error(calibration: Calibration) -> str:
    """The expected error and its basis."""
    error = calibration.expected_error
    if error is None:
        return describe_quality(calibration)
    return (
        f"expected error of a ball's diameter: up to {100 * error.diameter_p90:.0f} % in nine of "
        "ten touches (median "
        f"{100 * error.diameter_share:.0f} %), of its depth {100 * error.depth_p90:.0f} % "
        f"({100 * error.depth_share:.0f} %); "
        f"measured on {error.n_held_out} held-out presses"
    )
