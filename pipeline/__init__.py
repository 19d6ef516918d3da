"""Everything about touch translation that can be known without a screen."""

__version__ = "0.2.0"

import os
import sys

# One thread for numpy's and scipy's linear algebra in every process that imports this package,
# workers too: several add up in another order, and on a busy machine wait for each other. Each
# library reads it when it is loaded. No kernel of numba's runs on several, OpenCV's bytes do not
# depend on them, and `reproducible_inference` limits torch's.
os.environ["OPENBLAS_NUM_THREADS"] = "1"
# idle threads of torch leave the processor to others
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
if "numpy" in sys.modules:  # loaded before, with as many threads as it liked
    import threadpoolctl

    threadpoolctl.threadpool_limits(limits=1, user_api="blas")

# Most pixels of an image that OpenCV decodes: twice those of the largest camera in a tactile
# sensor, since a dozen are held at once. It reads the limit once, when it is loaded.
os.environ.setdefault("OPENCV_IO_MAX_IMAGE_PIXELS", str(1 << 24))
