"""Track: follow a touched object without its mesh, and fuse what was touched into a surface."""

import tactoscope as ts

moving = ts.simulate("notched_elbow", ["gelslim"], n=6, sequence="slide")

with ts.open(moving, "gelslim") as touches:
    record = ts.track(touches, stage="depth")
for row in record.rows:
    print(
        f"frame {row.frame}: {row.state}, moved by ({row.x_mm:.2f}, {row.y_mm:.2f}) mm, turned "
        f"{row.rz_deg:.1f} deg"
    )
if record.error is not None:
    print(f"off by at most {record.error.drift_mm:.3f} mm over {record.error.path_mm:.1f} mm")
if record.patch is not None:
    print(f"surface of {len(record.patch.triangles)} triangles")
