"""A short run of the program, and what is the same in bags and on the line."""

import os
import subprocess
from pathlib import Path

import numpy as np
import pytest
from rosbags.typesys import Stores, get_typestore

ROOT = Path(__file__).parents[2]
STORE = get_typestore(Stores.ROS2_JAZZY)
# x forward, y left, z up of x right, y down, z forward.
BODY_FROM_OPTICAL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])


def loopbox(*arguments):
    """Runs the program."""
    command = [os.environ["LOOPBOX"], *map(str, arguments)]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL, cwd=ROOT)


def matrix(quaternion):
    """The rotation of a message's or a TUM line's x, y, z, w."""
    x, y, z, w = quaternion
    return np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ])


def transform(message):
    """The 4×4 matrix of a `Transform` or a `Pose`."""
    at = getattr(message, "translation", None) or message.position
    turn = getattr(message, "rotation", None) or message.orientation
    found = np.eye(4)
    found[:3, :3] = matrix((turn.x, turn.y, turn.z, turn.w))
    found[:3, 3] = (at.x, at.y, at.z)
    return found


def seconds(stamp):
    return stamp.sec + stamp.nanosec * 1e-9


def points(cloud):
    """The numbers of a `PointCloud2`, a row a point."""
    types = {7: "f4"}
    names = [field.name for field in cloud.fields]
    kinds = np.dtype({
        "names": names,
        "formats": ["<" + types[field.datatype] for field in cloud.fields],
        "offsets": [field.offset for field in cloud.fields],
        "itemsize": cloud.point_step,
    })
    assert cloud.height == 1 and cloud.is_dense and not cloud.is_bigendian
    found = np.frombuffer(bytes(cloud.data), dtype=kinds)
    assert len(found) == cloud.width and cloud.row_step == cloud.width * cloud.point_step
    return np.stack([found[name].astype(float) for name in names], axis=1)


def trajectory(path):
    """Of each pose of a TUM file the seconds, and the 4×4 matrix in the axes of a body."""
    found = []
    for numbers in np.loadtxt(path):
        pose = np.eye(4)
        pose[:3, :3] = BODY_FROM_OPTICAL @ matrix(numbers[4:8]) @ BODY_FROM_OPTICAL.T
        pose[:3, 3] = BODY_FROM_OPTICAL @ numbers[1:4]
        found.append((numbers[0], pose))
    return found


def cloud_file(path):
    """The points of a PLY file, x forward, y left, z up, with their intensities."""
    content = path.read_bytes()
    head, body = content.split(b"end_header\n", 1)
    sizes = {"float": "<f4", "uchar": "u1"}
    columns = [line.split()[1:] for line in head.decode().splitlines() if line.startswith("property")]
    found = np.frombuffer(body, dtype=[(name, sizes[kind]) for kind, name in columns])
    position = np.stack([found[axis].astype(float) for axis in "xyz"], axis=1)
    return np.column_stack([position @ BODY_FROM_OPTICAL.T, found["intensity"].astype(float)])


@pytest.fixture(scope="session")
def run(tmp_path_factory):
    """The results of a short run over a shipped recording."""
    out = tmp_path_factory.mktemp("ros2") / "yard"
    loopbox("run", "demo/parking_a", "--end", 4, "--name", "the yard", "--out", out, "--features", "later", "--quiet")
    return out
