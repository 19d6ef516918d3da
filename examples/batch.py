"""A batch on a cluster: each job of an array measures its share of the frames and writes one file.

With Slurm: sbatch --array=0-3 --wrap 'python examples/batch.py $SLURM_ARRAY_TASK_ID 4'
In a shell: for i in 0 1 2 3; do python examples/batch.py $i 4 & done; wait
"""

import csv
import sys
from pathlib import Path

import tactoscope as ts

RECORDING = "sample_data/recordings/first_touch.h5"  # at a path that every machine can read
job, n_jobs = map(int, sys.argv[1:] or (0, 3))

with ts.open(RECORDING, "soft_bubble", source="gelslim") as touches:
    rows = [
        {"frame": index, **touches[index].metrics} for index in range(job, len(touches), n_jobs)
    ]
with Path(f"metrics_{job}.csv").open("w", newline="") as file:
    table = csv.DictWriter(file, fieldnames=list({name: None for row in rows for name in row}))
    table.writeheader()
    table.writerows(rows)
print(f"{len(rows)} of {len(touches)} frames: metrics_{job}.csv")
