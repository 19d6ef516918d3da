"""The U-Net of the paper's lab (Ronneberger et al. 2015, with batch normalisation and padded
convolutions).

Tensors have the names of the gelslim_depth package. `predict_depth_mm` follows its published
processing: the difference image, reduced to the training size by area means, gives shares of the
training data's depth range.
"""

from collections import OrderedDict
from itertools import pairwise
from typing import cast

import torch
from torch import Tensor, nn
from torch.nn import functional


class UNet(nn.Module):
    """Fields (n, outputs, rows, cols) of images (n, inputs, rows, cols).

    `levels` widths, each twice the one before.

    The others describe a network of depth: the size (px) of its images, and the normalisation of
    its depth, which is 0 at the least depth `min_depth_mm` of the training data and `-norm_scale`
    at 0 mm.
    """

    def __init__(
        self,
        *,
        inputs: int = 3,
        outputs: int = 1,
        width: int = 64,
        levels: int = 5,
        rows: int = 160,
        cols: int = 213,
        min_depth_mm: float = -1.9180814027786255,
        norm_scale: float = 0.9,
        uses_difference: bool = True,
    ) -> None:
        super().__init__()
        widths = [width * 2**level for level in range(levels)]
        self.size = (int(rows), int(cols))
        self.uses_difference = bool(uses_difference)
        self.min_depth_mm = float(min_depth_mm)
        self.norm_scale = float(norm_scale)
        self.inc = _make_double_convolution(inputs, width)
        self.down = nn.ModuleList(_make_down(narrow, wide) for narrow, wide in pairwise(widths))
        self.up = nn.ModuleList(
            _Up(wide, narrow) for narrow, wide in reversed(list(pairwise(widths)))
        )
        self.outc = nn.ModuleDict({"conv": nn.Conv2d(width, outputs, 1)})

    def forward(self, images: Tensor) -> Tensor:
        """The fields, without an activation at the end."""
        skips = [cast("Tensor", self.inc(images))]
        for down in self.down:
            skips.append(down(skips[-1]))
        field = skips.pop()
        for up in self.up:
            field = up(field, skips.pop())
        return self.outc["conv"](field)

    def predict_depth_mm(self, image: Tensor, reference: Tensor) -> Tensor:
        """Depth (n, 1, rows, cols) in mm, 0 at rest and negative where pressed, of images (n, 3,
        rows, cols) of 0..255.

        As published, also the enlargement to the image's size is a mean over areas.
        """
        shown = (image - reference + 255.0) / 2.0 if self.uses_difference else image
        shown = functional.interpolate(shown, size=self.size, mode="area") / 255.0
        depth_mm = self.min_depth_mm + self(shown) * self.min_depth_mm / self.norm_scale
        return functional.interpolate(depth_mm, size=image.shape[-2:], mode="area")


def _make_double_convolution(inputs: int, outputs: int) -> nn.Module:
    layers: list[nn.Module] = []
    for channels in (inputs, outputs):
        layers += [
            nn.Conv2d(channels, outputs, 3, padding=1, bias=False),
            nn.BatchNorm2d(outputs),
            nn.ReLU(),
        ]
    return nn.Sequential(OrderedDict(double_conv=nn.Sequential(*layers)))


def _make_down(inputs: int, outputs: int) -> nn.Module:
    halved = nn.Sequential(nn.MaxPool2d(2), _make_double_convolution(inputs, outputs))
    return nn.Sequential(OrderedDict(maxpool_conv=halved))


class _Up(nn.Module):
    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.up = nn.ConvTranspose2d(inputs, outputs, 2, stride=2)
        self.conv = _make_double_convolution(inputs, outputs)

    def forward(self, field: Tensor, skip: Tensor) -> Tensor:
        """Twice the size, padded to that of `skip`, which an odd size halves with a remainder."""
        field = self.up(field)
        rows, cols = (
            int(a) - int(b) for a, b in zip(skip.shape[-2:], field.shape[-2:], strict=True)
        )
        field = functional.pad(field, (cols // 2, cols - cols // 2, rows // 2, rows - rows // 2))
        return self.conv(torch.cat([skip, field], dim=1))
