"""What a cluster costs: two worker processes on loopback against two threads of one process.

Run it by itself, ``python benchmarks/cluster.py``; it takes minutes. It needs the extra
``distributed``.
"""

import hashlib
import json
import statistics
import sys
import tempfile
import time
from pathlib import Path

from distributed import Client

from capsyn import problems, synthesize

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))
from dask_processes import processes, start_scheduler, start_worker  # noqa: E402

ROUNDS = 3
