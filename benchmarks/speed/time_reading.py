"""Reading a DataFlash log: all messages found; position, attitude, velocity, rates and motors taken from it.

pymavlink reads one flight, undertow twenty in a row; times are those of one.
"""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

from undertow.identification.logs.formats.fieldlog import read_field_log

from .conftest import Speed
from .goals import OURS

READING = "reading a DataFlash log, 100,000 messages"
MESSAGES, FLIGHTS, STEP = 100_000, 20, 2_500  # number, how often, µs between messages
KINDS = {
    76: ("XKF1", "QBccCfffffffccce", "TimeUS,C,Roll,Pitch,Yaw,VN,VE,VD,dPD,PN,PE,PD,GX,GY,GZ,OH"),
    84: ("XKQ", "QBffff", "TimeUS,C,Q1,Q2,Q3,Q4"),
    162: ("IMU", "QBffffffIIfBBHH", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ,EG,EA,T,GH,AH,GHz,AHz"),
    94: ("RCOU", "QHHHHHHHHHHHHHH", "TimeUS," + ",".join(f"C{k}" for k in range(1, 15))),
}
READ = {"XKF1": "PN PE PD VN VE VD", "XKQ": "Q1 Q2 Q3 Q4", "IMU": "GyrX GyrY GyrZ",
        "RCOU": "C1 C2 C3 C4 C5 C6 C7 C8"}  # fmt: skip
_STRUCT = {"Q": "Q", "B": "B", "c": "h", "C": "H", "e": "i", "f": "f", "H": "H", "I": "I"}


def _flight(path: Path, times: int) -> Path:
    rng, out = np.random.default_rng(1), []
    for number, (name, cells, columns) in KINDS.items():
        length = 3 + struct.calcsize("<" + "".join(_STRUCT[c] for c in cells))
        described = struct.pack(
            "<BB4s16s64s", number, length, name.encode(), cells.encode(), columns.encode()
        )
        out.append(b"\xa3\x95\x80" + described)
    values = rng.normal(size=(MESSAGES, 16)).tolist()
    for k in range(MESSAGES * times):
        number = list(KINDS)[k % len(KINDS)]
        cells = KINDS[number][1]
        drawn = zip(cells, values[k % MESSAGES], strict=False)
        row = [v if c == "f" else 0 if c == "B" else int(abs(v) * 100) for c, v in drawn]
        layout = "<BBB" + "".join(_STRUCT[c] for c in cells)
        out.append(struct.pack(layout, 0xA3, 0x95, number, k * STEP, *row[1:]))
    path.write_bytes(b"".join(out))
    return path


def _ours(path: Path) -> dict[str, np.ndarray]:
    series = read_field_log(path).series
    return {f"{n}.{c}": series[n].columns[c] for n, columns in READ.items() for c in columns.split()}


def _theirs(path: Path) -> dict[str, np.ndarray]:
    reader = pytest.importorskip("pymavlink.DFReader").DFReader_binary(str(path))
    found: dict[str, list[float]] = {f"{n}.{c}": [] for n, columns in READ.items() for c in columns.split()}
    while (message := reader.recv_msg()) is not None:
        name = message.get_type()
        for column in READ.get(name, "").split():
            found[f"{name}.{column}"].append(getattr(message, column))
    reader.close()
    return {name: np.array(values) for name, values in found.items()}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("reading")


def time_undertow(speed: Speed, folder: Path) -> None:
    one, many = _flight(folder / "one.bin", 1), _flight(folder / "many.bin", FLIGHTS)
    ours, theirs = _ours(one), _theirs(one)
    apart = max(float(np.max(np.abs(ours[name] - theirs[name]))) for name in ours)
    speed(READING, OURS, lambda: _ours(many), calls=FLIGHTS, apart=apart, limit=0.0, rounds=3)


def time_pymavlink(speed: Speed, folder: Path) -> None:
    path = _flight(folder / "theirs.bin", 1)
    speed(READING, "pymavlink", lambda: _theirs(path), rounds=2)
