"""What the first depth of a process loads, loaded before anybody asks for one."""

from __future__ import annotations

from pipeline.base.progress import Progress


def preload_depth(report: Progress) -> None:
    """Read a touch that never was: packages and compiled code are there when somebody opens one. Raises Cancelled."""
    import numpy as np

    from pipeline.base.arrays import freeze
    from pipeline.physics import optics
    from pipeline.sensors.spec import load_sensor
    from pipeline.stages.depth.stage import NETWORK
    from pipeline.values.frames import TactileFrame

    source = load_sensor("gelslim")
    still = optics.render_reference(source)
    image = still.copy()
    rows, cols = (n // 3 for n in image.shape[:2])
    image[rows : 2 * rows, cols : 2 * cols] = 255 - image[rows : 2 * rows, cols : 2 * cols]
    frame = TactileFrame(sensor=source.name, image=freeze(image.astype(np.uint8)), reference=still)
    weights = None if NETWORK.weights is None else NETWORK.weights(source, source, None)
    NETWORK.run(frame, source, None, weights, NETWORK.params(), report)
