"""Programs that stand for those of OpenFOAM."""

from __future__ import annotations

import sys
from pathlib import Path

# Added mass and drag of the water in the stand-in for the solver.
ADDED, LINEAR, QUADRATIC = 20.0, 2.0, 40.0

_SOLVER = f"""#!{sys.executable}
import os, re, sys
from pathlib import Path
import numpy as np
rows = [[float(w) for w in re.findall(r"[-+.e0-9]+", line)] for line in open("constant/motion.dat")]
rows = np.array([row for row in rows if len(row) == 7])
t, x = rows[:, 0], rows[:, 1]
end = float(re.search(r"endTime (\\S+);", open("system/controlDict").read())[1])
v, keep = np.gradient(x, t), (t > 1e-12) & (t <= end + 1e-9)
a = np.gradient(v, t)
water = -({ADDED} * a + {LINEAR} * v + {QUADRATIC} * abs(v) * v) / COPIES
state = Path("state")
begin = float(state.read_text()) if state.exists() else 0.0
folder = Path(f"postProcessing/forces/{{begin:g}}")
folder.mkdir(parents=True)
with open(folder / "force.dat", "w") as out:
    out.write("# Time total pressure viscous\\n")
    for n, (now, f) in enumerate(zip(t[keep], water[keep])):
        if now <= begin:
            continue
        if Path("fatal").exists():
            print("--> FOAM FATAL IO ERROR:\\nEntry 'sigma' not found\\n\\nFOAM exiting")
            sys.exit(1)
        print(f"Courant Number mean: 0.1 max: {{900 if Path('diverge').exists() and n > 5 else 0.5}}")
        print(f"Time = {{now:.10g}}\\n", flush=True)
        out.write(f"{{now:.10g}} ({{f:.12g}} 0 0) (0 0 0) (0 0 0)\\n")
        if Path("cut").exists() and n == 20:
            Path("cut").unlink()
            state.write_text(f"{{t[keep][n - 3]:.10g}}")  # the last time that was written
            out.flush()
            os.kill(os.getpid(), 9)
"""


def stand_ins(folder: Path, copies: int) -> Path:
    """Programs with the names of OpenFOAM's that know the force of the water without computing it."""
    folder.mkdir()
    for name in ("blockMesh", "surfaceFeatureExtract", "snappyHexMesh", "pimpleFoam"):
        program = folder / name
        text = (
            _SOLVER.replace("COPIES", str(copies))
            if name == "pimpleFoam"
            else "#!/bin/sh\necho '  cells: 1234'\n"
        )
        program.write_text(text)
        program.chmod(0o755)
    return folder
