"""Depth Anything V2 with the paper's contact head, with the published tensor names.

Yang et al. 2024: a DINOv2 encoder (`pretrained.*`) and a DPT decoder (`depth_head.*`). The second
head (`mask_head.*`) predicts contact from the decoder's finest features.
"""

from typing import Literal, get_args

import torch
from torch import Tensor, nn
from torch.nn import functional

from pipeline.stages.networks.depth_anything_input import PATCH_PX, ImageContent
from pipeline.stages.networks.dinov2 import ENCODER_SIZES, DinoV2Encoder

# ImageNet statistics of the encoder's training images
MEAN = (0.485, 0.456, 0.406)
STD = (0.229, 0.224, 0.225)


class DepthAnything(nn.Module):
    """Indentation and contact from an image of whole patches; see `forward`.

    `answer` is what the depth head predicts: "metric" is indentation and "distance" is distance
    from the camera, both as a share of `largest_mm`; "relative" is >= 0 and has no unit. `side` is
    the shorter side (px) of the training images, `image_content` what they showed
    (`prepare_image`).
    """

    def __init__(
        self,
        *,
        encoder: str = "vits",
        contact: bool = True,
        answer: Literal["metric", "distance", "relative"] = "metric",
        largest_mm: float = 0.0,
        side: int = 518,
        image_content: ImageContent = "image",
    ) -> None:
        super().__init__()
        if (
            encoder not in ENCODER_SIZES
            or answer not in ("metric", "distance", "relative")
            or image_content not in get_args(ImageContent)
        ):
            raise ValueError(
                f"no encoder {encoder!r}, answer {answer!r} or image content {image_content!r}"
            )
        self.answer = answer
        self.image_content = image_content
        self.largest_mm = float(largest_mm)
        self.side = int(side)
        size = ENCODER_SIZES[encoder]
        self.pretrained = DinoV2Encoder(size)
        self.depth_head = _DepthHead(size.width, size.features, size.projected)
        self.mask_head = _MaskHead(size.features) if contact else None

    def forward(
        self, image: Tensor, window: tuple[int, int, int, int] | None = None, answer: str = ""
    ) -> tuple[Tensor, Tensor | None]:
        """(depth, contact) from RGB images (n, 3, rows, cols) in 0..1 whose size is a multiple of
        the patch size.

        Depth (n, rows, cols) is a share 0..1 of `largest_mm`, or relative. Contact (n, rows, cols)
        is a logit, None without the contact head. `window` (top, left, rows, cols) in patches
        places this crop in a larger image, whose other patches are skipped. A non-empty `answer`
        replaces the network's own.
        """
        rows = image.shape[-2] // PATCH_PX
        cols = image.shape[-1] // PATCH_PX
        mean, std = (image.new_tensor(v)[:, None, None] for v in (MEAN, STD))
        tokens = self.pretrained((image - mean) / std, window or (0, 0, rows, cols))
        raw_depth, features = self.depth_head(tokens, rows, cols)
        is_relative = (answer or self.answer) == "relative"
        depth = functional.relu(raw_depth) if is_relative else torch.sigmoid(raw_depth)
        contact = (
            None
            if self.mask_head is None
            else self.mask_head(features, (rows * PATCH_PX, cols * PATCH_PX))
        )
        return depth[:, 0], None if contact is None else contact[:, 0]


class _DepthHead(nn.Module):
    """Decoder of a dense prediction transformer (Ranftl et al. 2021): four levels, fused from
    coarse to fine.
    """

    def __init__(self, width: int, features: int, projected: tuple[int, ...]) -> None:
        super().__init__()
        self.projects = nn.ModuleList(nn.Conv2d(width, channels, 1) for channels in projected)
        self.resize_layers = nn.ModuleList(
            [
                nn.ConvTranspose2d(projected[0], projected[0], 4, stride=4),
                nn.ConvTranspose2d(projected[1], projected[1], 2, stride=2),
                nn.Identity(),
                nn.Conv2d(projected[3], projected[3], 3, stride=2, padding=1),
            ]
        )
        self.scratch = _Scratch(features, projected)

    def forward(self, tokens: list[Tensor], rows: int, cols: int) -> tuple[Tensor, Tensor]:
        """(depth before its activation (n, 1, rows, cols) in pixels, the finest features)."""
        levels: list[Tensor] = []
        for project, resize, tokens_of_level in zip(
            self.projects, self.resize_layers, tokens, strict=True
        ):
            grid = tokens_of_level.transpose(1, 2).reshape(tokens_of_level.shape[0], -1, rows, cols)
            levels.append(resize(project(grid)))
        features = self.scratch.fuse_levels(levels)
        field = self.scratch.output_conv1(features)
        size = (rows * PATCH_PX, cols * PATCH_PX)
        field = functional.interpolate(field, size, mode="bilinear", align_corners=True)
        return self.scratch.output_conv2(field), features


class _Scratch(nn.Module):
    def __init__(self, features: int, projected: tuple[int, ...]) -> None:
        super().__init__()
        self.layer1_rn, self.layer2_rn, self.layer3_rn, self.layer4_rn = (
            nn.Conv2d(channels, features, 3, padding=1, bias=False) for channels in projected
        )
        self.refinenet1, self.refinenet2, self.refinenet3, self.refinenet4 = (
            _Fusion(features) for _ in range(4)
        )
        self.output_conv1 = nn.Conv2d(features, features // 2, 3, padding=1)
        self.output_conv2 = nn.Sequential(
            nn.Conv2d(features // 2, 32, 3, padding=1), nn.ReLU(inplace=True), nn.Conv2d(32, 1, 1)
        )

    def fuse_levels(self, levels: list[Tensor]) -> Tensor:
        """Features at twice the size of the finest level."""
        layers = (self.layer1_rn, self.layer2_rn, self.layer3_rn, self.layer4_rn)
        thin = [layer(level) for layer, level in zip(layers, levels, strict=True)]
        path = self.refinenet4(thin[3], None, thin[2].shape[-2:])
        path = self.refinenet3(path, thin[2], thin[1].shape[-2:])
        path = self.refinenet2(path, thin[1], thin[0].shape[-2:])
        rows, cols = path.shape[-2:]
        return self.refinenet1(path, thin[0], (2 * rows, 2 * cols))


class _Fusion(nn.Module):
    def __init__(self, features: int) -> None:
        super().__init__()
        self.out_conv = nn.Conv2d(features, features, 1)
        # published names
        self.resConfUnit1 = _Residual(features)
        self.resConfUnit2 = _Residual(features)

    def forward(self, path: Tensor, skip: Tensor | None, size: tuple[int, int]) -> Tensor:
        """Fuse the coarser path with the skip connection of this level and resize to `size`."""
        path = self.resConfUnit2(path if skip is None else path + self.resConfUnit1(skip))
        return self.out_conv(
            functional.interpolate(path, size, mode="bilinear", align_corners=True)
        )


class _Residual(nn.Module):
    def __init__(self, features: int) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(features, features, 3, padding=1)
        self.conv2 = nn.Conv2d(features, features, 3, padding=1)

    def forward(self, field: Tensor) -> Tensor:
        return field + self.conv2(functional.relu(self.conv1(functional.relu(field))))


class _MaskHead(nn.Module):
    def __init__(self, features: int) -> None:
        super().__init__()
        self.mask_head = nn.Sequential(
            nn.Conv2d(features, features // 2, 3, padding=1),
            nn.ReLU(inplace=True),
            nn.Conv2d(features // 2, 1, 1),
        )

    def forward(self, features: Tensor, size: tuple[int, int]) -> Tensor:
        return self.mask_head(
            functional.interpolate(features, size, mode="bilinear", align_corners=True)
        )
