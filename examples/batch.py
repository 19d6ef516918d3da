"""A batch on a cluster: each worker opens the recording itself, and returns what is measured of
a frame.
"""

from distributed import Client, LocalCluster

import tactoscope as ts

RECORDING = "sample_data/recordings/first_touch.h5"  # at a path that every worker can read


def measure(index: int) -> dict[str, float]:
    with ts.open(RECORDING, "soft_bubble", source="gelslim") as touches:
        return dict(touches[index].metrics)


if __name__ == "__main__":
    # or the address of a scheduler
    cluster = LocalCluster(n_workers=2, processes=False, dashboard_address=":0")
    with cluster, Client(cluster) as client:
        rows = client.gather(client.map(measure, range(4, 7)))
    for index, row in enumerate(rows, start=4):
        print(index, f"{row['touch_depth.mae_mm']:.3f} mm")
