"""What does the gel depth network cost per frame?

    python -m benchmarks.gel_network [WEIGHTS]

What the network adds to the physical depth of a frame with contact, for every gel sensor, resizing and notes included;
the baseline is a U-Net as large as the lab's published one (31 million parameters) on the colour change at 160 x 213,
with random weights: it takes the same time. Then the method *network* as a whole against physics alone, and a sensor of
1280 x 1708 pixels against one of 320 x 427: the error is the ratio of the times over that of the pixels, 16.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import torch
from torch import nn
from torch.nn import functional

from benchmarks.harness.results import BenchmarkResult
from benchmarks.harness.text_report import print_result
from benchmarks.harness.timing import Requirement, build_measurement, time_in_turns
from benchmarks.scenes.depth_helpers import build_reader
from pipeline.geometry import rigid
from pipeline.networks import network_factory
from pipeline.physics import optics
from pipeline.sensors.spec import load_sensor
from pipeline.simulation import shapes
from pipeline.simulation.press import simulate_press
from pipeline.stages.depth import gel_network
from pipeline.stages.depth import network as depth_network
from pipeline.stages.depth.gel_network import NetworkParams
from pipeline.values.frames import TactileFrame

_SENSORS = ("gelslim", "gelslim_dotless", "gelsight_mini", "digit")
_LARGE = 4  # times as many pixels along each side
_RUNS = 9


class Large(nn.Module):
    """A U-Net of 64 to 1024 channels."""

    def __init__(self):
        super().__init__()
        widths = (64, 128, 256, 512, 1024)
        self.down = nn.ModuleList(_twice(a, b) for a, b in pairwise((3, *widths)))
        self.up = nn.ModuleList(nn.ConvTranspose2d(b, a, 2, 2) for a, b in pairwise(widths))
        self.merge = nn.ModuleList(_twice(2 * a, a) for a in widths[:-1])
        self.last = nn.Conv2d(64, 1, 1)

    def forward(self, picture):
        """One field."""
        seen = []
        for level, down in enumerate(self.down):
            picture = down(functional.max_pool2d(picture, 2) if level else picture)
            seen.append(picture)
        field = seen.pop()
        for up, merge in zip(reversed(self.up), reversed(self.merge), strict=True):
            outside = seen.pop()
            grown = functional.interpolate(up(field), size=outside.shape[-2:])
            field = merge(torch.cat([outside, grown], dim=1))
        return self.last(field)


def _twice(inputs, outputs):
    def one(a, b):
        return nn.Conv2d(a, b, 3, padding=1), nn.BatchNorm2d(b), nn.ReLU(inplace=True)

    return nn.Sequential(*one(inputs, outputs), *one(outputs, outputs))


def simulate_touch(source):
    """A frame of a square punch pressed by 0.4 mm."""
    thing = shapes.make_shape("square").mesh
    pose = rigid.rotation((0.0, 0.0, 0.3))
    pose[2, 3] = -0.4 - rigid.apply(pose, thing.vertices_mm)[:, 2].min()
    touch = simulate_press(thing, pose, source, seed=1)
    return TactileFrame(sensor=source.name, image=touch.image, reference=optics.render_reference(source))


def enlarge_frame(frame):
    def times(picture):
        return np.ascontiguousarray(picture.repeat(_LARGE, axis=0).repeat(_LARGE, axis=1))

    return replace(frame, image=times(frame.image), reference=times(frame.reference))


def costs(read, network):
    peer, change = Large().eval(), torch.zeros(1, 3, 160, 213)
    size = sum(p.numel() for p in peer.parameters()) / 1e6

    def by_peer():
        with torch.inference_mode():
            peer(change)

    alone = build_reader("physics")
    for name in _SENSORS:
        source = load_sensor(name)
        frame = simulate_touch(source)
        looked_at = gel_network.estimate_physical_depth(frame, source)

        def adds(at=looked_at, of=source):
            gel_network.correct_depth(*at, of, network, NetworkParams())

        taken = time_in_turns({"ours": adds, "peer": by_peer}, runs=_RUNS)
        yield build_measurement(f"what the network adds to a frame of {name}", peer=f"U-Net of {size:.0f} M numbers",
                  ours=taken["ours"], peer_timing=taken["peer"], ours_error=0.0, unit="",
                  bar=Requirement(max_ms=15, min_speedup=10))  # fmt: skip
        taken = time_in_turns(
            {"ours": lambda f=frame, s=source: read(f, s), "peer": lambda f=frame, s=source: alone(f, s)}, runs=_RUNS
        )
        yield build_measurement(f"a frame of {name}, physics and network", peer="physics", ours=taken["ours"],
                  peer_timing=taken["peer"], ours_error=0.0, unit="", bar=Requirement())  # fmt: skip


def growth(read):
    small = load_sensor("gelslim_dotless")
    wide, frame = small.with_camera(small.camera.scale(_LARGE)), simulate_touch(small)
    many = enlarge_frame(frame)
    taken = time_in_turns({"few": lambda: read(frame, small), "many": lambda: read(many, wide)}, runs=_RUNS)
    share = taken["many"].median_ms / taken["few"].median_ms / _LARGE**2
    return build_measurement(
        "1280 x 1708 pixels, time over 16 times that of 320 x 427",
        ours=taken["many"],
        ours_error=share,
        peer="320 x 427",
        peer_timing=taken["few"],
        unit="x",
        bar=Requirement(max_error=1.0),
    )


def measure(weights: str = "") -> BenchmarkResult:
    read = build_reader(f"network={weights}" if weights else "network")
    mini = load_sensor("gelsight_mini")
    network = network_factory.load_predictor(
        depth_network.select_weights(mini, mini, Path(weights) if weights else None)
    )
    return BenchmarkResult(
        title="Run time of the gel depth network",
        unit="",
        rows=(*costs(read, network), growth(read)),
    )


if __name__ == "__main__":
    print_result(measure(*sys.argv[1:2]))
