"""The paper's source encoder with published tensor names: a ResNet-18 and two transposed convolutions."""

from typing import cast

from torch import Tensor, nn
from torch.nn import functional


class ConditionEncoder(nn.Module):
    """Features (n, width, side / 8, side / 8) of images (n, inputs, side, side); published are 64 of 3 inputs."""

    def __init__(self, *, width: int = 64, inputs: int = 3) -> None:
        super().__init__()
        self.resnet = _Resnet18(width, inputs)
        self.deconv1 = nn.ConvTranspose2d(8 * width, 4 * width, 4, 2, 1)
        self.deconv2 = nn.ConvTranspose2d(4 * width, width, 4, 2, 1)

    def forward(self, images: Tensor) -> Tensor:
        """The condition that is concatenated with the noisy latents."""
        features = self.deconv1(functional.relu(self.resnet(images)))
        return self.deconv2(functional.relu(features))


class _Resnet18(nn.Module):
    """ResNet-18 (He et al. 2016) without its classifier."""

    def __init__(self, width: int, inputs: int) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(inputs, width, 7, 2, 3, bias=False)
        self.bn1 = nn.BatchNorm2d(width)
        self.layer1 = nn.Sequential(_Basic(width, width, 1), _Basic(width, width, 1))
        self.layer2 = nn.Sequential(_Basic(width, 2 * width, 2), _Basic(2 * width, 2 * width, 1))
        self.layer3 = nn.Sequential(_Basic(2 * width, 4 * width, 2), _Basic(4 * width, 4 * width, 1))
        self.layer4 = nn.Sequential(_Basic(4 * width, 8 * width, 2), _Basic(8 * width, 8 * width, 1))

    def forward(self, images: Tensor) -> Tensor:
        """Features at 1/32 of the side length."""
        field = functional.max_pool2d(functional.relu(self.bn1(self.conv1(images))), 3, 2, 1)
        return self.layer4(self.layer3(self.layer2(self.layer1(field))))


class _Basic(nn.Module):
    def __init__(self, inputs: int, outputs: int, stride: int) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(inputs, outputs, 3, stride, 1, bias=False)
        self.bn1 = nn.BatchNorm2d(outputs)
        self.conv2 = nn.Conv2d(outputs, outputs, 3, 1, 1, bias=False)
        self.bn2 = nn.BatchNorm2d(outputs)
        if stride != 1 or inputs != outputs:
            self.downsample = nn.Sequential(nn.Conv2d(inputs, outputs, 1, stride, bias=False), nn.BatchNorm2d(outputs))

    def forward(self, field: Tensor) -> Tensor:
        inner = self.bn2(self.conv2(functional.relu(self.bn1(self.conv1(field)))))
        skip = cast("nn.Module", self.downsample)(field) if hasattr(self, "downsample") else field
        return functional.relu(inner + skip)
