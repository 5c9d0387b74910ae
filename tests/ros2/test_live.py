"""`loopbox run --ros2`, listened to by Eclipse zenoh's own Python binding and decoded by rosbags."""

import json
import os
import socket
import subprocess
import time

import numpy as np
import zenoh
from conftest import BODY_FROM_OPTICAL, ROOT, STORE, cloud_file, points, seconds, trajectory, transform

KINDS = {
    "tf": "tf2_msgs/msg/TFMessage",
    "the_yard/odometry": "nav_msgs/msg/Odometry",
    "the_yard/points": "sensor_msgs/msg/PointCloud2",
    "the_yard/map_points": "sensor_msgs/msg/PointCloud2",
}
COMMON = {
    "tf_static": "tf2_msgs/msg/TFMessage",
    "parking_a/common_odometry": "nav_msgs/msg/Odometry",
    "parking_c/common_odometry": "nav_msgs/msg/Odometry",
    "parking_a/common_points": "sensor_msgs/msg/PointCloud2",
}


def free_port():
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        return found.getsockname()[1]


def listener(port, mode):
    config = zenoh.Config()
    for key, value in {
        "mode": mode,
        "listen/endpoints": [f"tcp/127.0.0.1:{port}"],
        "scouting/multicast/enabled": False,
    }.items():
        config.insert_json5(key, json.dumps(value))
    return zenoh.open(config)


def run_published(out, port, *more):
    command = [os.environ["LOOPBOX"], "run", "demo/parking_a", "--end", "6", "--name", "the yard", "--out", str(out)]
    command += ["--features", "later", "--ros2", f"tcp/127.0.0.1:{port}", *more]
    ended = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=120)
    assert ended.returncode == 0, ended.stderr
    return ended


def listened(tmp_path, mode):
    port, samples = free_port(), []
    with listener(port, mode) as session:
        session.declare_subscriber("**", lambda sample: samples.append((str(sample.key_expr), bytes(sample.payload))))
        ended = run_published(tmp_path / "yard", port, "--realtime")
        time.sleep(1)
    found = {}
    for key, data in samples:
        found.setdefault(key, []).append(STORE.deserialize_cdr(data, KINDS[key]))
    return ended, found


def check(out, ended, found):
    assert sorted(found) == sorted(KINDS)
    odometry, transforms = found["the_yard/odometry"], found["tf"]
    live = np.loadtxt(out / "trajectory-live.txt")
    # As many as it says, but for those before the two had found each other.
    assert f"ros2: {len(live)} poses" in ended.stderr, ended.stderr
    assert len(live) - 60 < len(odometry) <= len(live)
    stamps = np.array([seconds(message.header.stamp) for message in odometry])
    assert np.all(np.diff(stamps) > 0)
    assert np.allclose(stamps[-1], live[-1, 0], atol=1e-6), "the last pose is there"
    known = {round(when, 5): pose for when, pose in trajectory(out / "trajectory-live.txt")}
    steps = []
    by_stamp = {}
    for message in transforms:
        tree = {part.child_frame_id: part for part in message.transforms}
        assert sorted(tree) == ["the_yard/camera", "the_yard/camera_optical", "the_yard/odom"]
        odom, camera = tree["the_yard/odom"], tree["the_yard/camera"]
        assert (odom.header.frame_id, camera.header.frame_id) == ("the_yard/map", "the_yard/odom")
        assert np.allclose(transform(tree["the_yard/camera_optical"].transform)[:3, :3], BODY_FROM_OPTICAL)
        when = round(seconds(camera.header.stamp), 5)
        by_stamp[when] = camera
        # What was handed out when the frame came is where the two together say that it is.
        assert np.allclose(transform(odom.transform) @ transform(camera.transform), known[when], atol=1e-6)
    for message in odometry:
        assert (message.header.frame_id, message.child_frame_id) == ("the_yard/odom", "the_yard/camera")
        pose = transform(message.pose.pose)
        camera = by_stamp.get(round(seconds(message.header.stamp), 5))
        assert camera is None or np.allclose(transform(camera.transform), pose)
        steps.append(pose[:3, 3])
    # It moves steadily: it is never many times as fast as usual.
    speeds = np.linalg.norm(np.diff(steps, axis=0), axis=1) / np.diff(stamps)
    assert speeds.max() < 6 * np.median(speeds), speeds
    # The last cloud of the map is a sample of the one that is written.
    last = points(found["the_yard/map_points"][-1])
    written = cloud_file(out / "cloud.ply")
    assert len(last) > 1000 and found["the_yard/map_points"][-1].header.frame_id == "the_yard/map"
    for point in last[:: len(last) // 100, :3]:
        assert np.abs(written[:, :3] - point).max(axis=1).min() < 1e-4 * max(1.0, np.linalg.norm(point)), point
    assert all(len(points(cloud)) > 0 for cloud in found["the_yard/points"])


def test_a_peer_hears_the_run(tmp_path):
    ended, found = listened(tmp_path, "peer")
    check(tmp_path / "yard", ended, found)


def test_a_router_hears_the_run_as_a_bridge_would(tmp_path):
    ended, found = listened(tmp_path, "router")
    check(tmp_path / "yard", ended, found)


def test_a_run_that_nobody_hears_is_the_same(tmp_path):
    command = [os.environ["LOOPBOX"], "run", "demo/parking_a", "--end", "3", "--features", "later", "--quiet", "--out"]
    subprocess.run([*command, str(tmp_path / "alone")], cwd=ROOT, check=True, timeout=120)
    begun = time.monotonic()
    ended = subprocess.run(
        [*command, str(tmp_path / "published"), "--ros2", f"tcp/127.0.0.1:{free_port()}"],
        cwd=ROOT, check=True, timeout=120, capture_output=True, text=True,
    )
    assert time.monotonic() - begun < 60
    for name in ["trajectory.txt", "trajectory-live.txt", "cloud.ply"]:
        assert (tmp_path / "alone" / name).read_bytes() == (tmp_path / "published" / name).read_bytes(), name
    assert "panicked" not in ended.stderr


def test_a_station_tells_where_agents_are_in_the_common_map(tmp_path):
    heard, meeting, samples = free_port(), free_port(), []
    program = os.environ["LOOPBOX"]
    at = f"tcp/127.0.0.1:{meeting}"
    with listener(heard, "peer") as session:
        session.declare_subscriber("**", lambda sample: samples.append((str(sample.key_expr), bytes(sample.payload))))
        station = subprocess.Popen(
            [program, "station", "--listen", at, "--out", str(tmp_path / "station"), "--agents", "2", "--quiet"]
            + ["--ros2", f"tcp/127.0.0.1:{heard}"],
            cwd=ROOT, stdout=subprocess.DEVNULL,
        )
        try:
            for name in ["parking_a", "parking_c"]:
                command = [program, "run", f"demo/{name}", "--out", str(tmp_path / name), f"--fleet={name}", "--connect", at, "--quiet"]
                subprocess.run(command, cwd=ROOT, check=True, timeout=200)
            assert station.wait(timeout=120) == 0
        finally:
            station.kill()
        time.sleep(1)
    found = {}
    for key, data in samples:
        found.setdefault(key, []).append(STORE.deserialize_cdr(data, COMMON[key]))
    assert sorted(found) == sorted(COMMON)
    frame = "parking_a/map"
    [place] = found["tf_static"][-1].transforms
    assert (place.header.frame_id, place.child_frame_id) == (frame, "parking_c/map")
    for name in ["parking_a", "parking_c"]:
        last = found[f"{name}/common_odometry"][-1]
        assert (last.header.frame_id, last.child_frame_id) == (frame, f"{name}/camera")
        when, pose = trajectory(tmp_path / "station" / f"trajectory-{name}.txt")[-1]
        assert abs(seconds(last.header.stamp) - when) < 1e-6
        assert np.allclose(transform(last.pose.pose), pose, atol=1e-6), name
    cloud = found["parking_a/common_points"][-1]
    assert cloud.header.frame_id == frame and 10_000 < cloud.width <= 65_536
