"""How fast is the gel render? Ours against the published calibration table, written in torch as
fast as we could.

    python -m benchmarks.optics_render

Every method starts from the same deformed surface of 320 x 427 pixels (320 x 240 with shadows) and
ends in 8 bits; markers, lens blur and noise are off. The baseline is the published recipe: slope
magnitude and direction, floor to 125 x 125 bins, a polynomial of second degree in x and y for each
bin and colour, plus the background; one row is its plain writing (whole tables, fancy indices), the
others a quicker one of the same result. It is filled with our own optics, so that its image can be
compared: what is left is what its bins cost. Its shadow step is the published fan: from each pixel
around the contact, four rays mark the darkest value that a table knows at that distance.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import torch

from benchmarks.harness.results import BenchmarkResult, Measurement, PlotPoint
from benchmarks.harness.timing import Requirement, Timing, build_measurement, time_in_turns
from pipeline.physics import gel, optics
from pipeline.sensors.spec import SensorSpec, load_sensor

_BINS = 125
_BAR = Requirement(min_speedup=15)
_RAY_STEPS = 40
_STEP_PX = 1.25
_FAN_RAD = (-0.1, -0.05, 0.0, 0.05)
_DIRECTION_RAD = 0.1
_NOTES = (
    "ours and the peer run on one thread",
    "the taxim package itself is not raced: torch-scatter, which it needs, has no wheel here and "
    "does not build within "
    "minutes; the peer is its published algorithm without its deformation of the gel",
    "error: rms of 8-bit grey levels from the same model before rounding; rounding alone is 0.29",
    "the shadow peer's table of darkness is calibrated from pictures; here it is made up, so its "
    "picture has no error",
)


def measure() -> BenchmarkResult:
    """Rows: a small, a usual and an image-wide deformation, and shadows."""
    spec = _bare(load_sensor("gelslim_dotless"))
    table = Table(spec)
    rows = [_row(question, spec, surface, table) for question, surface in _surfaces(spec).items()]
    digit = _bare(load_sensor("digit"), shadow=True)
    shadow = _row(
        "usual contact, shadows",
        digit,
        _pressed(digit, 4.0, 0.5),
        Table(digit).render_shadowed,
        "and fan of shadows",
    )
    rows.append(replace(shadow, peer_error=math.nan))
    points = [
        PlotPoint(
            method=f"ours: {r.question}, next to {r.peer}",
            ms=r.ours_ms,
            error=r.ours_error,
            ours=True,
        )
        for r in rows
    ]
    points += [
        PlotPoint(method=f"{r.peer}: {r.question}", ms=r.peer_ms, error=r.peer_error)
        for r in rows
        if r.peer_error > 0
    ]
    title = "A gel's picture from its deformed surface"
    return BenchmarkResult(
        title=title, unit="grey levels", rows=tuple(rows), points=tuple(points), notes=_NOTES
    )


def _row(
    question: str, spec: SensorSpec, surface, peer, name: str = "table look-up (torch)"
) -> Measurement:
    torch.set_num_threads(1)
    truth = np.clip(optics._render_light(spec, optics.require_optics(spec), surface), 0, 255)
    methods = {"ours": lambda: optics.render(spec, surface, seed=None), name: lambda: peer(surface)}
    # outputs are compared first
    errors = {method: _rms(call(), truth) for method, call in methods.items()}
    times: dict[str, Timing] = time_in_turns(methods, 25, calls=5)
    return build_measurement(
        question,
        ours=times["ours"],
        ours_error=errors["ours"],
        unit="grey levels",
        bar=_BAR,
        peer=name,
        peer_timing=times[name],
        peer_error=errors[name],
    )


def _bare(spec: SensorSpec, *, shadow: bool = False) -> SensorSpec:
    assert spec.optics is not None
    kept = spec.optics.shadow if shadow else 0.0
    return replace(
        spec, optics=replace(spec.optics, blur_px=0.0, noise_grey=0.0, shadow=kept), markers=None
    )


def _surfaces(spec: SensorSpec):
    y, x = np.mgrid[: spec.camera.rows, : spec.camera.cols] * spec.pixel_mm
    waves = 0.5 + 0.2 * np.sin(1.7 * x + 0.4 * y) + 0.2 * np.cos(1.3 * y - 0.6 * x)
    return {
        "small contact": _pressed(spec, 1.0, 0.2),
        "usual contact": _pressed(spec, 4.0, 0.5),
        "whole image": waves.astype(np.float32),
    }


def _pressed(spec: SensorSpec, radius_mm: float, depth_mm: float):
    y, x = np.mgrid[: spec.camera.rows, : spec.camera.cols]
    r = np.hypot(y - spec.camera.cy_px, x - spec.camera.cx_px) * spec.pixel_mm
    assert spec.gel is not None
    return gel.press_gel(
        spec.gel, spec.pixel_mm, depth_mm - r * r / (2 * radius_mm)
    ).indentation_mm.copy()


class Table:
    """Magnitude x direction of the slope -> six coefficients for each colour."""

    def __init__(self, spec: SensorSpec) -> None:
        self.shape = spec.camera.shape
        side_by_side = np.ascontiguousarray(_filled(spec).transpose(1, 2, 0, 3)).reshape(
            _BINS * _BINS, 18
        )
        self.side_by_side = torch.from_numpy(side_by_side)
        self.powers = torch.from_numpy(_powers(*self.shape))
        level = np.zeros(self.shape, np.float32)
        lit = optics._render_light(spec, optics.require_optics(spec), level)
        # the background, and what rounds to 8 bits
        self.to_grey = torch.from_numpy(lit + np.float32(0.5))
        self.pixel_mm = spec.pixel_mm

    def __call__(self, surface):
        """One gather of 18 coefficients for a pixel, one batched product, the rest in place."""
        with torch.no_grad():
            steep, direction = self._slopes(torch.from_numpy(surface))
            bins = self._bin(steep, direction)
            return self._change(bins).add_(self.to_grey).clamp_(0, 255).to(torch.uint8).numpy()

    def render_shadowed(self, surface):
        """With the fan of shadows, and the blurs that go with it."""
        with torch.no_grad():
            height = torch.from_numpy(surface)
            steep, direction = self._slopes(height)
            change = self._change(self._bin(steep, direction.clone())).permute(2, 0, 1).contiguous()
            _cast(change, height, direction)
            change = _blurred(change, 2.0, 8).permute(1, 2, 0) + self.to_grey
            picture = _blurred(change.permute(2, 0, 1).contiguous(), 1.1, 2).permute(1, 2, 0)
            return picture.clamp_(0, 255).to(torch.uint8).contiguous().numpy()

    def _slopes(self, height):
        gx = torch.empty_like(height)
        gy = torch.empty_like(height)
        torch.sub(height[:, 2:], height[:, :-2], out=gx[:, 1:-1])
        torch.sub(height[2:], height[:-2], out=gy[1:-1])
        gx[:, 0] = 2 * (height[:, 1] - height[:, 0])
        gx[:, -1] = 2 * (height[:, -1] - height[:, -2])
        gy[0] = 2 * (height[1] - height[0])
        gy[-1] = 2 * (height[-1] - height[-2])
        direction = torch.atan2(gy, gx)
        rise = gx.mul_(gx).addcmul_(gy, gy).sqrt_().mul_(0.5 / self.pixel_mm)
        return rise.atan_(), direction

    def _bin(self, steep, direction):
        i = steep.mul_(2 * (_BINS - 1) / math.pi).to(torch.int32)
        j = (
            direction.add_(math.pi)
            .mul_((_BINS - 1) / (2 * math.pi))
            .to(torch.int32)
            .clamp_(max=_BINS - 1)
        )
        return i.mul_(_BINS).add_(j).view(-1)

    def _change(self, bins):
        coefficients = self.side_by_side.index_select(0, bins).view(-1, 3, 6)
        return torch.bmm(coefficients, self.powers[:, :, None]).view(*self.shape, 3)


def _filled(spec: SensorSpec):
    """The table (3, bins, bins, 6), fitted to our own optics on few pixels: light varies slowly
    over the image.
    """
    small = spec.camera.scale(1 / 24)
    few = replace(spec, camera=small, rest_depth_mm=spec.membrane.rest_depth_mm(small))
    fit = np.linalg.pinv(_powers(*small.shape))
    one = np.ones(small.shape, np.float32)
    table = np.empty((3, _BINS, _BINS, 6), np.float32)
    for i in range(_BINS):
        steep = math.tan(min((i + 0.5) * 0.5 * math.pi / (_BINS - 1), 1.5))
        for j in range(_BINS):
            angle = (j + 0.5) * 2 * math.pi / (_BINS - 1) - math.pi
            change = optics.compute_colour_change(
                few, steep * math.cos(angle) * one, steep * math.sin(angle) * one
            )
            table[:, i, j] = (fit @ change.reshape(-1, 3)).T
    return table


def _powers(rows: int, cols: int):
    y, x = (np.mgrid[:rows, :cols] + 0.5) / np.array([rows, cols])[:, None, None]
    x = x.ravel()
    y = y.ravel()
    return np.stack([x * x, y * y, x * y, x, y, np.ones_like(x)], 1).astype(np.float32)


def _cast(change, height, direction) -> None:
    """Lower `change` (3, rows, cols) along rays from the pixels around the contact that look
    down on where they go.
    """
    rows, cols = height.shape
    contact = (height > 0.4 * height.max()).float()[None, None]
    around = torch.nn.functional.max_pool2d(contact, 9, 1, 4) - contact
    y, x = torch.nonzero(around[0, 0], as_tuple=True)
    # down the slope
    angle = torch.round(direction[y, x] / _DIRECTION_RAD) * _DIRECTION_RAD + math.pi
    angle = angle[:, None, None] + torch.tensor(_FAN_RAD)[None, :, None]
    way = torch.arange(1, _RAY_STEPS + 1) * _STEP_PX
    to_x = (x[:, None, None] + way * torch.cos(angle)).long()
    to_y = (y[:, None, None] + way * torch.sin(angle)).long()
    inside = (to_x >= 0) & (to_x < cols) & (to_y >= 0) & (to_y < rows)
    at = (to_y.clamp(0, rows - 1) * cols + to_x.clamp(0, cols - 1)).flatten()
    lower = inside & (height[y, x][:, None, None] > height.view(-1)[at].view_as(to_x))
    dark = torch.where(lower, -60.0 * (1 - way / way[-1]), 1e9).flatten()
    for colour in change:
        colour.view(-1).scatter_reduce_(0, at, dark, "amin")


def _blurred(planes, sigma_px: float, reach_px: int):
    kernel = torch.exp(-0.5 * (torch.arange(-reach_px, reach_px + 1) / sigma_px) ** 2)
    kernel = (kernel / kernel.sum()).view(1, 1, 1, -1)
    planes = torch.nn.functional.pad(planes[:, None], (reach_px,) * 4, "replicate")
    planes = torch.nn.functional.conv2d(
        torch.nn.functional.conv2d(planes, kernel), kernel.transpose(2, 3)
    )
    return planes[:, 0]


def _rms(picture, truth) -> float:
    return float(np.sqrt(np.mean((picture.astype(np.float64) - truth) ** 2)))


if __name__ == "__main__":
    from benchmarks.harness.text_report import print_result

    print_result(measure())
