"""Scale of an estimated force: weighed presses of one sensor instance, in its calibration file.

The contact model leaves an unknown factor (stiffness, thickness and air pressure of the instance)
and, where depth is read too deep or too shallow, an exponent near 1:

    log weighed = log factor + exponent log estimated

Least squares with a normal prior on the exponent: two weighings of similar force determine the
factor alone, two of very different forces the exponent as well.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import msgspec
import numpy as np
from msgspec import Meta

from pipeline.core.arrays import Doubles, freeze
from pipeline.core.errors import FileProblem, SettingProblem
from pipeline.core.files import read_arrays, write_arrays
from pipeline.core.frozen import frozen
from pipeline.core.typed_data import Name, convert

UNKNOWN_SCALE = "its scale is not known; weigh two presses and run 'tactoscope calibrate force'"
# standard deviation of one estimated force, as a share (`benchmarks/force.py`)
_WEIGHING_ERROR = 0.06
_EXPONENT_DEVIATION = 0.1  # of the prior, about 1
_EXPONENTS = (0.3, 3.0)  # accepted in a file
_Positive = Annotated[float, Meta(gt=0.0, le=1e12)]
_MOST_VALUES = 100_000  # in a list of a file
_SPREAD_MIN = 2.0  # largest over smallest force, below which the exponent is the prior's
_RESIDUAL_MAX = 0.25  # share by which a weighing may differ from the fit


class _Content(msgspec.Struct, kw_only=True, frozen=True):
    force_sensor: Name
    force_scale: tuple[_Positive, Annotated[float, Meta(ge=_EXPONENTS[0], le=_EXPONENTS[1])]]
    force_weighings: Annotated[tuple[tuple[_Positive, _Positive], ...], Meta(min_length=2)]


@frozen
class ForceScale:
    """Weighed force of one sensor instance as a function of the force that the contact model
    estimates.
    """

    sensor: str
    factor: float
    exponent: float
    weighings_n: Doubles  # (n, 2) estimated and weighed, N

    def apply(self, estimated_n: float) -> float:
        """Force in N of an estimate in N."""
        return self.factor * max(estimated_n, 0.0) ** self.exponent

    @property
    def residuals(self) -> Doubles:
        """Fitted over weighed force less 1 (n,)."""
        return np.array(
            [self.apply(estimated) / weighed - 1.0 for estimated, weighed in self.weighings_n]
        )

    @property
    def warnings(self) -> tuple[str, ...]:
        """What may be wrong with the weighings, and what to do."""
        weighed = self.weighings_n[:, 1]
        out: list[str] = []
        if float(weighed.max() / weighed.min()) < _SPREAD_MIN:
            out.append(
                "the weighed forces are too similar to show whether light and strong presses "
                "scale alike; "
                f"weigh two that differ by a factor of {_SPREAD_MIN:g} or more"
            )
        worst = int(np.abs(self.residuals).argmax())
        if abs(self.residuals[worst]) > _RESIDUAL_MAX:
            out.append(
                f"weighing {worst} differs from the others by "
                f"{100 * abs(self.residuals[worst]):.0f} %; "
                "check its force and that the whole contact is in the image"
            )
        return tuple(out)


def fit_force_scale(
    sensor: str, estimated_n: Sequence[float], weighed_n: Sequence[float]
) -> ForceScale:
    """The scale of two or more weighings; raises SettingProblem unless all forces are positive."""
    pairs = np.array([estimated_n, weighed_n], np.float64).T.reshape(-1, 2)
    if len(pairs) < 2:
        raise SettingProblem(f"a force scale needs two weighings, got {len(pairs)}")
    for index, (estimated, weighed) in enumerate(pairs):
        if not (np.isfinite(weighed) and weighed > 0):
            raise SettingProblem(f"weighing {index}: the force must be above 0 N, got {weighed:g}")
        if not (np.isfinite(estimated) and estimated > 0):
            raise SettingProblem(f"weighing {index} shows no contact; choose a frame that touches")
    x, y = np.log(pairs).T
    x_mean = float(x.mean())
    y_mean = float(y.mean())
    noise = _WEIGHING_ERROR**-2
    prior = _EXPONENT_DEVIATION**-2
    slope = float((x - x_mean) @ (y - y_mean)) * noise + prior
    exponent = slope / (float((x - x_mean) @ (x - x_mean)) * noise + prior)
    exponent = min(max(exponent, _EXPONENTS[0]), _EXPONENTS[1])
    factor = float(np.exp(y_mean - exponent * x_mean))
    return ForceScale(sensor=sensor, factor=factor, exponent=exponent, weighings_n=freeze(pairs))


def save_force_scale(scale: ForceScale, path: Path, calibration: Path | None = None) -> None:
    """Write the scale as .npz, with everything that the file `calibration` holds."""
    known = {} if calibration is None else read_arrays(calibration, "the calibration")
    own = {
        "force_sensor": np.array(scale.sensor),
        "force_scale": np.array([scale.factor, scale.exponent]),
        "force_weighings": scale.weighings_n,
    }
    write_arrays(path, {**known, **own}, "the calibration", load_force_scale)


def load_force_scale(path: Path) -> ForceScale | None:
    """The force scale in a calibration file, None where it holds none.

    Raises FileProblem for a damaged one.
    """
    fields = read_arrays(path, "the calibration")
    if "force_scale" not in fields:
        return None
    own = {name: array for name, array in fields.items() if name.startswith("force_")}
    if any(array.size > _MOST_VALUES for array in own.values()):
        raise FileProblem(
            f"the force scale holds a list of more than {_MOST_VALUES} values; calibrate again",
            path,
        )
    own = {name: array.tolist() for name, array in own.items()}
    content = convert(own, _Content, "the force scale", path, remedy="calibrate again")
    factor, exponent = content.force_scale
    weighings_n = freeze(np.array(content.force_weighings, np.float64))
    return ForceScale(
        sensor=content.force_sensor, factor=factor, exponent=exponent, weighings_n=weighings_n
    )


def format_force_scale(scale: ForceScale) -> list[str]:
    """The scale as lines for a terminal."""
    worst = 100 * float(np.abs(scale.residuals).max())
    return [
        f"force of {scale.sensor}: {scale.factor:.4g} N times the estimate to the power of "
        f"{scale.exponent:.3f}",
        f"  {len(scale.weighings_n)} weighings, largest residual {worst:.0f} %",
        *(f"  warning: {warning}" for warning in scale.warnings),
    ]
