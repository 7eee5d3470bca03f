"""Real logs of vehicles from public repositories, which the project does not hand on.

Put them into ../shared/data/field-logs, or a folder named by UNDERTOW_FIELD_LOGS; without them the tests
that read them skip. ``small.BIN`` and ``small.tlog`` (clydemcqueen/ardusub_log_tools, testing),
``px4/sample_log_small.ulg`` (PX4/pyulog, test), ``ros2/wbag`` and ``ros2/cdr_test`` (ros2/rosbag2,
rosbag2_tests/resources), ``glider/`` (smerckel/dbdreader, data, with its folder cac).
"""

from __future__ import annotations

import os
from pathlib import Path

_BESIDE = Path(__file__).parents[4] / "shared" / "data" / "field-logs"
FIELD = Path(os.environ.get("UNDERTOW_FIELD_LOGS", _BESIDE))
