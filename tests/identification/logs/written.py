"""The dive of `dive`, written as vehicles write it, with the libraries that write such files."""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from undertow.errors import UndertowError
from undertow.identification.logs.mapping import Column, LogMapping
from undertow.identification.logs.run import Run

from .dive import FULL, Array, Dive

POSE, VELOCITY = ("x", "y", "z", "phi", "theta", "psi"), ("u", "v", "w", "p", "q", "r")
BEGIN = 1_700_000_000  # s since 1970, when the dive began


def assert_the_dive(run: Run, dive: Dive, within: float) -> None:
    """Every channel of the dive is in the run, to within a number."""
    expected = dive.run
    assert np.max(np.abs(run.t - expected.t)) < 1e-6
    for name, values in expected.channels.items():
        turns = np.round((run.channels[name] - values)[0] / (2 * np.pi)) * 2 * np.pi if name == "psi" else 0.0
        assert np.max(np.abs(run.channels[name] - turns - values)) < within, name


def cut_off(path: Path, read: Callable[[Path], object]) -> None:
    """Cut a file at many places: it has to be read, or refused in one line that names it."""
    whole = path.read_bytes()
    for share in (0.0, 0.001, 0.01, 0.1, 0.3, 0.5, 0.8, 0.95, 0.999):
        path.write_bytes(whole[: round(share * len(whole))])
        said = refusal(lambda: read(path))
        assert "\n" not in said, said
        assert not said or path.name in said, said
    path.write_bytes(whole)


def refusal(act: Callable[[], object]) -> str:
    """What is said where something is refused; "" where it is done."""
    try:
        act()
    except UndertowError as error:
        return str(error)
    return ""


def in_newtons(mapping: LogMapping) -> LogMapping:
    """A mapping whose commands are scaled, from shares of the largest thrust to N."""

    def scaled(column: Column) -> Column:
        return column.model_copy(update={"scale": FULL * column.scale, "offset": FULL * column.offset})

    columns = {
        name: scaled(column) if column.channel.startswith("f") else column
        for name, column in mapping.columns.items()
    }
    return mapping.model_copy(update={"columns": columns})


# --- PX4 ------------------------------------------------------------------------------------------
_C = {"uint64_t": "Q", "float": "f", "uint8_t": "B", "bool": "B"}


class ULogWriter:
    """Bytes of a ULog by its documented format (PX4 user guide, ULog file format)."""

    def __init__(self) -> None:
        self.definitions = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 1_000_000)
        self.definitions += self._message("B", bytes(40))
        self.data: list[tuple[int, bytes]] = []
        self.subscriptions = b""
        self._number = 0

    def _message(self, kind: str, body: bytes) -> bytes:
        return struct.pack("<HB", len(body), ord(kind)) + body

    def parameter(self, name: str, value: float) -> None:
        key = f"float {name}".encode()
        self.definitions += self._message("P", bytes([len(key)]) + key + struct.pack("<f", value))

    def add(
        self, name: str, fields: Mapping[str, str], columns: Mapping[str, Any], instance: int = 0
    ) -> None:
        """Messages of one kind; lists of floats are written as ``float[4] q``."""
        if instance == 0:
            text = "".join(f"{kind} {field};" for field, kind in fields.items())
            self.definitions += self._message("F", f"{name}:{text}".encode())
        self.subscriptions += self._message("A", struct.pack("<BH", instance, self._number) + name.encode())
        for k, stamp in enumerate(columns["timestamp"]):
            body = struct.pack("<H", self._number)
            for field, kind in fields.items():
                plain, cells = kind.split("[")[0], np.atleast_1d(columns[field][k]).tolist()
                body += struct.pack(f"<{len(cells)}{_C[plain]}", *cells)
            self.data.append((int(stamp), self._message("D", body)))
        self._number += 1

    def write(self, path: Path) -> Path:
        rows = b"".join(body for _, body in sorted(self.data, key=lambda row: row[0]))
        path.write_bytes(self.definitions + self.subscriptions + rows)
        return path


def ulog(dive: Dive, resets: tuple[float, ...] = (), armed: tuple[float, float] | None = None) -> ULogWriter:
    """The dive as PX4 logs it, from 1 s after its start; reset at some times, armed for a time."""
    stamps, log = 1_000_000 + np.round(dive.t * 1e6).astype(np.int64), ULogWriter()
    count = np.sum([dive.t >= t for t in resets], axis=0) if resets else np.zeros(len(stamps), int)
    log.parameter("CA_ROTOR_COUNT", 8.0)
    sampled = {"timestamp": stamps + 3000, "timestamp_sample": stamps}
    clock = {"timestamp": "uint64_t", "timestamp_sample": "uint64_t"}
    position = dict(zip(("x", "y", "z"), dive.pose[:, :3].T, strict=True))
    position |= dict(zip(("vx", "vy", "vz"), dive.velocity_ned.T, strict=True))
    valid = dict.fromkeys(("xy_valid", "z_valid", "v_xy_valid", "v_z_valid"), np.ones(len(stamps), int))
    fields = {**clock, **dict.fromkeys(position, "float"), **dict.fromkeys(valid, "bool")}
    fields["xy_reset_counter"] = "uint8_t"
    log.add("vehicle_local_position", fields, {**sampled, **position, **valid, "xy_reset_counter": count})
    attitude = {**clock, "q": "float[4]", "quat_reset_counter": "uint8_t"}
    still = np.zeros(len(stamps), int)
    log.add("vehicle_attitude", attitude, {**sampled, "q": dive.quaternion, "quat_reset_counter": still})
    log.add("vehicle_angular_velocity", {**clock, "xyz": "float[3]"}, {**sampled, "xyz": dive.rates})
    outputs = np.column_stack([dive.output, np.full((len(stamps), 4), np.nan)])
    log.add("actuator_motors", {"timestamp": "uint64_t", "control": "float[12]"},
            {"timestamp": stamps, "control": outputs})  # fmt: skip
    battery = {"timestamp": "uint64_t", "voltage_v": "float"}
    for instance, volts in enumerate((15.5, 12.0)):
        columns = {"timestamp": stamps[::20], "voltage_v": np.full(len(stamps), volts)}
        log.add("battery_status", battery, columns, instance)
    if armed is not None:
        at = 1_000_000 + np.array([0, *(round(t * 1e6) for t in armed)])
        log.add("vehicle_status", {"timestamp": "uint64_t", "arming_state": "uint8_t"},
                {"timestamp": at, "arming_state": [1, 2, 1]})  # fmt: skip
    return log


def by_pyulog(path: Path) -> Path:
    """A log that pyulog has read, and written over."""
    log = pytest.importorskip("pyulog").ULog(str(path))
    log.write_ulog(str(path))
    return path


# --- ROS ------------------------------------------------------------------------------------------
BAGS = {"dive.bag": "ROS 1", "dive.db3": "ROS 2, SQLite", "dive.mcap": "ROS 2, MCAP"}


class BagWriter:
    """A bag of ROS 1 or 2, of messages given by their type and what is in them."""

    def __init__(self, path: Path, begin: int = BEGIN) -> None:
        highlevel = pytest.importorskip("rosbags.typesys")
        from rosbags import rosbag1, rosbag2

        self.ros1, self.begin, self.folder = path.suffix == ".bag", begin, path.with_suffix("")
        stores = highlevel.Stores
        self.store = highlevel.get_typestore(stores.ROS1_NOETIC if self.ros1 else stores.ROS2_HUMBLE)
        plugins = {".db3": rosbag2.StoragePlugin.SQLITE3, ".mcap": rosbag2.StoragePlugin.MCAP}
        self.path = path if self.ros1 else self.folder / path.name
        self.writer = (
            rosbag1.Writer(path)
            if self.ros1
            else rosbag2.Writer(self.folder, version=9, storage_plugin=plugins[path.suffix])
        )
        self._connections: dict[str, Any] = {}

    def __enter__(self) -> BagWriter:
        self.writer.open()
        return self

    def __exit__(self, *error: object) -> None:
        self.writer.close()

    def define(self, text: str, name: str) -> None:
        """Let messages of a type of one's own be written."""
        from rosbags.typesys import get_types_from_msg

        self.store.register(get_types_from_msg(text, name))

    def message(self, type_: str, **fields: Any) -> Any:
        """A message; header is given as (t, frame)."""
        if "header" in fields:
            fields["header"] = self.header(*fields["header"])
        return self.store.types[type_](**fields)

    def header(self, t: float, frame: str) -> Any:
        stamp = self.begin * 1_000_000_000 + round(t * 1e9)
        seconds, rest = divmod(stamp, 1_000_000_000)
        time = self.store.types["builtin_interfaces/msg/Time"](sec=seconds, nanosec=rest)
        counted = {"seq": 0} if self.ros1 else {}
        return self.store.types["std_msgs/msg/Header"](**counted, stamp=time, frame_id=frame)

    def write(self, topic: str, t: float, message: Any) -> None:
        """Write a message that was recorded at a time, s."""
        type_ = message.__msgtype__
        if topic not in self._connections:
            self._connections[topic] = self.writer.add_connection(topic, type_, typestore=self.store)
        encode = self.store.serialize_ros1 if self.ros1 else self.store.serialize_cdr
        stamp = self.begin * 1_000_000_000 + round(t * 1e9)
        self.writer.write(self._connections[topic], stamp, encode(message, type_))

    def vector(self, x: float, y: float, z: float, *, kind: str = "Vector3") -> Any:
        return self.store.types[f"geometry_msgs/msg/{kind}"](x=float(x), y=float(y), z=float(z))

    def quaternion(self, w: float, x: float, y: float, z: float) -> Any:
        return self.store.types["geometry_msgs/msg/Quaternion"](x=x, y=y, z=z, w=w)

    def odometry(self, t: float, frames: tuple[str, str], pose: Array, q: Array, twist: Array) -> Any:
        """Odometry at a place (3,), with a quaternion w, x, y, z and a twist (6,)."""
        make, none = self.store.types, np.zeros(36)
        place = make["geometry_msgs/msg/Pose"](
            position=self.vector(*pose, kind="Point"), orientation=self.quaternion(*map(float, q))
        )
        moved = make["geometry_msgs/msg/Twist"](
            linear=self.vector(*twist[:3]), angular=self.vector(*twist[3:])
        )
        return make["nav_msgs/msg/Odometry"](
            header=self.header(t, frames[0]),
            child_frame_id=frames[1],
            pose=make["geometry_msgs/msg/PoseWithCovariance"](pose=place, covariance=none),
            twist=make["geometry_msgs/msg/TwistWithCovariance"](twist=moved, covariance=none),
        )

    def commands(self, values: Array) -> Any:
        layout = self.store.types["std_msgs/msg/MultiArrayLayout"](dim=[], data_offset=0)
        return self.store.types["std_msgs/msg/Float64MultiArray"](
            layout=layout, data=np.asarray(values, float)
        )


TO_ENU = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
TO_FLU = np.diag([1.0, -1.0, -1.0])


def enu(dive: Dive) -> tuple[Array, Array, Array, Array]:
    """Position and quaternion in ENU/FLU, velocity in FLU (6 columns), and velocity along east, north, up."""
    turned = TO_ENU @ Rotation.from_quat(dive.quaternion, scalar_first=True).as_matrix() @ TO_FLU
    q = Rotation.from_matrix(turned).as_quat(scalar_first=True)
    twist = np.hstack([dive.velocity @ TO_FLU, dive.rates @ TO_FLU])
    return dive.pose[:, :3] @ TO_ENU.T, q, twist, dive.velocity_ned @ TO_ENU.T


def bag(path: Path, dive: Dive, *, world: bool = False, down: bool = False) -> Path:
    """The dive as odometry in ENU/FLU or, `down`, NED/FRD, its velocities in body axes or the `world`'s."""
    position, q, twist, east_north_up = enu(dive)
    if down:
        position, q, twist = dive.pose[:, :3], dive.quaternion, np.hstack([dive.velocity, dive.rates])
    if world:
        twist = np.hstack([east_north_up, twist[:, 3:]])
    frames = ("world_ned", "base_link_frd") if down else ("odom", "base_link")
    with BagWriter(path) as out:
        for k, t in enumerate(dive.t):
            late = t + 0.004  # recorded a little after it was measured
            out.write("/thrusters/input", float(t), out.commands(dive.thrust[k]))
            out.write("/odometry", late, out.odometry(float(t), frames, position[k], q[k], twist[k]))
    return out.path


# --- MATLAB and NetCDF ----------------------------------------------------------------------------
def workspace(dive: Dive) -> dict[str, Any]:
    """The dive as structs with matrices, as one saves a simulation of MSS."""
    nav = {"t": dive.t, "eta": dive.pose, "nu": np.hstack([dive.velocity, dive.rates])}
    return {"nav": nav, "thruster": {"time": dive.t, "f": dive.thrust}, "comment": "dive 7", "m": 11.5}


def mat(path: Path, dive: Dive) -> Path:
    """Of version 5, by SciPy."""
    from scipy.io import savemat

    savemat(path, workspace(dive), oned_as="column")
    return path


def mat73(path: Path, dive: Dive) -> Path:
    """Of version 7.3 as MATLAB writes it: HDF5 after 512 bytes of header, arrays turned."""
    h5py = pytest.importorskip("h5py")
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, value in workspace(dive).items():
            members = value if isinstance(value, dict) else {}
            if members:
                file.create_group(name).attrs["MATLAB_class"] = np.bytes_("struct")
            for field, column in members.items():
                stored = file.create_dataset(f"{name}/{field}", data=np.atleast_2d(column.T))
                stored.attrs["MATLAB_class"] = np.bytes_("double")
    with path.open("r+b") as stream:
        stream.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64, HDF5 schema 1.00 .".ljust(124) + b"\x00\x02IM")
    return path


def netcdf(path: Path, dive: Dive, kind: str = "NETCDF4") -> Path:
    """By netCDF4: navigation and commands along two dimensions, angles in degrees."""
    netcdf4 = pytest.importorskip("netCDF4")
    with netcdf4.Dataset(path, "w", format=kind) as file:
        for dimension in ("time", "time_cmd"):
            file.createDimension(dimension, len(dive.t))
            clock = file.createVariable(dimension, "f8", (dimension,))
            clock.units, clock[:] = "seconds since 2023-11-14 22:13:20", dive.t
        angles, linear = np.degrees(dive.pose[:, 3:]), dive.pose[:, :3]
        columns = {
            "x": (linear[:, 0], "m"), "y": (linear[:, 1], "m"), "DEPTH": (linear[:, 2], "m"),
            "ROLL": (angles[:, 0], "degrees"), "PITCH": (angles[:, 1], "degree"),
            "hdg": (angles[:, 2], "degree"),
        }  # fmt: skip
        columns |= {n: (column, "m s-1") for n, column in zip("uvw", dive.velocity.T, strict=True)}
        columns |= {n: (column, "rad s-1") for n, column in zip("pqr", dive.rates.T, strict=True)}
        for name, (column, unit) in columns.items():
            variable = file.createVariable(name, "f8", ("time",))
            variable.units, variable[:] = unit, column
        file["hdg"].standard_name = "platform_yaw_fore_starboard"
        for k in range(8):
            file.createVariable(f"f{k + 1}", "f8", ("time_cmd",))[:] = dive.thrust[:, k]
    return path
