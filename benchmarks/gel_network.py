"""What does reading a gel by network cost, and does even strong drift look like a touch to it?

    python benchmarks/gel_network.py [WEIGHTS]

What the network adds to the physical answer of a touched frame of every gel sensor, resizing and notes included;
the peer is a U-Net as large as the lab's published one (31 million numbers) on the change of colour at 160 x 213, with
random numbers: it takes the same time. Beside it the method *network* as a whole, physics included, the peer physics
alone. Then the same touch seen by a sensor of 1280 x 1708 pixels, beside the one of
320 x 427: the error is the ratio of the times over that of the pixels, 16. Last, untouched pictures of every simulated
sensor under more drift than `drift.py` asks for: every colour's gain within 10 %, ramps of up to 20 grey levels in any
direction, shifts of up to 3 pixels; the error is the number of frames in which any pixel is contact.
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

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.depth_reader import reader
from benchmarks.drift import drifted, read_through
from benchmarks.races import Bar, Timing, race, row, timing
from pipeline.geometry import rigid
from pipeline.geometry.camera import Camera
from pipeline.networks import building
from pipeline.physics import optics
from pipeline.racing.races import Answer
from pipeline.racing.report import show
from pipeline.sensors.spec import sensor
from pipeline.simulation import shapes
from pipeline.simulation.press import press
from pipeline.stages.depth import gel_network
from pipeline.stages.depth import network as depth_network
from pipeline.stages.depth.gel_network import NetworkParams
from pipeline.values.frames import TactileFrame

_SENSORS = ("gelslim", "gelslim_dotless", "gelsight_mini", "digit")
_GAIN, _RAMP_GREY, _SHIFT_PX, _FRAMES = 0.1, 20.0, 3.0, 50
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
            beside = seen.pop()
            grown = functional.interpolate(up(field), size=beside.shape[-2:])
            field = merge(torch.cat([beside, grown], dim=1))
        return self.last(field)


def _twice(inputs, outputs):
    def one(a, b):
        return nn.Conv2d(a, b, 3, padding=1), nn.BatchNorm2d(b), nn.ReLU(inplace=True)

    return nn.Sequential(*one(inputs, outputs), *one(outputs, outputs))


def touched(source):
    """A frame of a square punch pressed by 0.4 mm."""
    thing = shapes.shape("square").mesh
    pose = rigid.rotation((0.0, 0.0, 0.3))
    pose[2, 3] = -0.4 - rigid.apply(pose, thing.vertices_mm)[:, 2].min()
    felt = press(thing, pose, source, seed=1)
    return TactileFrame(sensor=source.name, image=felt.image, reference=optics.untouched(source))


def large(source):
    """The sensor with four times as many pixels along each side."""
    c = source.camera
    camera = Camera(rows=_LARGE * c.rows, cols=_LARGE * c.cols, fx_px=_LARGE * c.fx_px, fy_px=_LARGE * c.fy_px,
                    cx_px=_LARGE * c.cx_px + 1.5, cy_px=_LARGE * c.cy_px + 1.5)  # fmt: skip
    return source.seen_through(camera)


def enlarged(frame):
    def times(picture):
        return np.ascontiguousarray(picture.repeat(_LARGE, axis=0).repeat(_LARGE, axis=1))

    return replace(frame, image=times(frame.image), reference=times(frame.reference))


def costs(read, network):
    peer, change = Large().eval(), torch.zeros(1, 3, 160, 213)
    size = sum(p.numel() for p in peer.parameters()) / 1e6

    def by_peer():
        with torch.inference_mode():
            peer(change)

    alone = reader("physics")
    for name in _SENSORS:
        source = sensor(name)
        frame = touched(source)
        looked_at = gel_network.looked_at(frame, source)

        def adds(at=looked_at, of=source):
            gel_network.corrected(*at, of, network, NetworkParams())

        taken = race({"ours": adds, "peer": by_peer}, runs=_RUNS)
        yield row(f"what the network adds to a frame of {name}", peer=f"U-Net of {size:.0f} M numbers",
                  ours=taken["ours"], peer_timing=taken["peer"], ours_error=0.0, unit="",
                  bar=Bar(ms=15, faster=10))  # fmt: skip
        taken = race({"ours": lambda f=frame, s=source: read(f, s), "peer": lambda f=frame, s=source: alone(f, s)},
                     runs=_RUNS)  # fmt: skip
        yield row(f"a frame of {name}, physics and network", peer="physics", ours=taken["ours"],
                  peer_timing=taken["peer"], ours_error=0.0, unit="", bar=Bar())  # fmt: skip


def growth(read):
    small = sensor("gelslim_dotless")
    wide, frame = large(small), touched(small)
    many = enlarged(frame)
    taken = race({"few": lambda: read(frame, small), "many": lambda: read(many, wide)}, runs=_RUNS)
    share = taken["many"].median_ms / taken["few"].median_ms / _LARGE**2
    return row("1280 x 1708 pixels, time over 16 times that of 320 x 427", ours=taken["many"], ours_error=share,
               peer="320 x 427", peer_timing=taken["few"], unit="x", bar=Bar(error=1.0))  # fmt: skip


def strong(rng):
    def direction(length):
        angle, far = rng.uniform(0, 2 * np.pi), rng.uniform(0, length)
        return far * np.cos(angle), far * np.sin(angle)

    return {"gain": 1 + rng.uniform(-_GAIN, _GAIN) + rng.uniform(-0.02, 0.02, 3), "ramp": direction(_RAMP_GREY),
            "tint": rng.uniform(0, 1, 3), "shift": direction(_SHIFT_PX)}  # fmt: skip


def drifts(read):
    rng = np.random.default_rng(3)
    for name in _SENSORS:
        source = sensor(name)
        still = optics.untouched(source)
        found = [read_through(read, source, still, drifted(still, **strong(rng)), k) for k in range(_FRAMES)]
        false = sum(bool(answer.contact.any()) for answer, _ in found)
        ms: Timing = timing([taken for _, taken in found])
        yield row(f"untouched, strong drift, {name}, {_FRAMES} frames", ours=ms, ours_error=float(false),
                  unit="frames", bar=Bar(error=0))  # fmt: skip


def answer(weights: str = "") -> Answer:
    read = reader(f"network={weights}" if weights else "network")
    mini = sensor("gelsight_mini")
    network = building.ready(depth_network.weights(mini, mini, Path(weights) if weights else None))
    return Answer(
        title="What reading a gel by network costs, and what drift does to it",
        unit="frames",
        rows=(*costs(read, network), growth(read), *drifts(read)),
    )


if __name__ == "__main__":
    show(answer(*sys.argv[1:2]))
