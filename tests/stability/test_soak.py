"""Frame after frame through the whole chain: whatever comes, an answer or a sentence, and the
memory stays.
"""

from __future__ import annotations

import resource
from dataclasses import replace
from pathlib import Path

import numpy as np
from hypothesis import given

from pipeline.core.geometry import rigid
from pipeline.core.graph import Graph
from pipeline.core.values.frames import TactileFrame
from pipeline.sensors.alignment import Alignment
from pipeline.stages.depth import bubble_network
from pipeline.stages.touch import t2d2
from pipeline.translation.catalogue import BUILT_IN, default_params, with_setting
from tests.stability.checks import outcome, sound
from tests.stability.rows import SIZE, row
from tests.stability.scenes import aligned, frame, mesh, seeds, small

# the cache of results has its own bound; in addition there are tables for new sizes
GROWTH_MB = 200.0
CACHE_BYTES = 32 * 2**20
SENSORS = ("digit", "gelslim", "soft_bubble")
STAGES = ("depth", "cloud", "target_depth", "touch")
_GRAPH = Graph(BUILT_IN.methods("t2d2"))
_GRAPH.cache.most_bytes = CACHE_BYTES


def random_frame(name: str, rng: np.random.Generator) -> TactileFrame:
    """A press, with now and then what goes wrong in a cable, a file or a room."""
    seen = frame(name, int(rng.integers(6)))
    image = np.array(seen.image)
    kind = int(rng.integers(8))
    if kind == 0:
        image = np.array(seen.reference)
    elif kind == 1:
        image = rng.integers(0, 256, image.shape).astype(image.dtype)
    elif kind == 2:
        rows = slice(int(rng.integers(image.shape[0])), None)
        image[rows] = 0
    elif kind == 3 and seen.is_depth:
        image[rng.random(image.shape) < rng.random()] = rng.choice([np.nan, np.inf, 0.0, 6553.5])
    elif kind == 3:
        image = np.clip(image * rng.uniform(0, 3), 0, 255).astype(np.uint8)
    elif kind == 4:
        image = np.roll(image, rng.integers(-20, 20, 2), (0, 1))
    elif kind == 5:
        image = np.ascontiguousarray(image[: int(rng.integers(1, image.shape[0] + 1))])
    elif kind == 6:
        image[:] = rng.choice([0, 255, 20])
    return replace(seen, image=image, index=int(rng.integers(1000)))


def random_inputs(rng: np.random.Generator) -> dict[str, object]:
    name, other = (str(s) for s in rng.choice(SENSORS, 2))
    source = small(name)
    target = small(other)
    way = aligned(source, target)
    if rng.random() < 0.5:
        by = rigid.from_parts(
            rng.uniform(-5, 5, 3) * rng.choice([1, 1, 100]), rng.uniform(-30, 30, 3)
        )
        way = Alignment(
            alignment_from_source=by @ way.alignment_from_source,
            target_from_alignment=way.target_from_alignment,
        )
    return {
        "frame": random_frame(name, rng),
        "source": source,
        "target": target,
        "calibration": None,
        "alignment": way,
        "mesh": mesh("ball"),
        "previous": None,
        "previous_membrane": None,
        "depth_weights": bubble_network.select_weights(source, target, None),
        "touch_weights": t2d2.select_weights(source, target, None),
    }


def resident_mb() -> float:
    with Path("/proc/self/statm").open() as numbers:
        return int(numbers.read().split()[1]) * resource.getpagesize() / 2**20


@row(
    16,
    "random frames from depth to the generated touch: sound or a sentence, memory bounded",
    share=0.5,
    refused=0.25,
)
@given(seeds)
def test_chain(seed):
    run(STAGES, np.random.default_rng(seed))


@row(16, "random frames from depth to the pose: sound or a sentence", share=0.005, refused=0.25)
@given(seeds)
def test_chain_with_pose(seed):
    run((*STAGES, "pose"), np.random.default_rng(seed))


def run(stages, rng):
    inputs = random_inputs(rng)
    chosen = {"target_depth": "paper"} if rng.random() < 0.5 else {}
    kinds = {"source": inputs["source"].kind, "target": inputs["target"].kind}
    methods = BUILT_IN.methods("t2d2", chosen, kinds)
    params = default_params(methods)
    for setting in (
        f"cloud.stride={rng.integers(1, 4)}",
        "pose.n_starts=6",
    ):
        params = with_setting(params, setting)
    results, _ = outcome(_GRAPH.with_methods(methods).evaluate, stages, inputs, params)
    for result in (results or {}).values():
        sound(result.output)


def test_memory_does_not_grow():
    """After the rows above have filled every table and cache, as many frames again leave the
    memory as it is.
    """
    for seed in range(20):
        run(STAGES, np.random.default_rng(10**6 + seed))
    before = resident_mb()
    for seed in range(SIZE.cases // 10 if SIZE.long else 10):
        run(STAGES, np.random.default_rng(2 * 10**6 + seed))
    assert resident_mb() - before <= GROWTH_MB
