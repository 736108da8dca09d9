"""Commands that need no ROS: `ins_process`, `ins_simulate`, `ins_report`.

Top layer beside `ins_nav.nodes`: imports any other folder. Start with `ins_nav.cli.process`.
"""

import os

# Before numpy: matrices here are small, and BLAS threads that wait for busy cores cost up to a hundredfold.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
