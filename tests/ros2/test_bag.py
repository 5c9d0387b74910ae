"""`loopbox export --ros2`, read by rosbags: an implementation of bags and of CDR that knows nothing of loopbox."""

import numpy as np
from conftest import BODY_FROM_OPTICAL, STORE, cloud_file, loopbox, matrix, points, seconds, trajectory, transform
from rosbags.highlevel import AnyReader
from rosbags.typesys import get_types_from_msg


def read(bag):
    """The messages of each topic with their times, decoded by the definitions that the bag carries."""
    found = {}
    with AnyReader([bag]) as reader:
        for connection, time, data in reader.messages():
            message = reader.deserialize(data, connection.msgtype)
            found.setdefault(connection.topic, []).append((time * 1e-9, message))
        definitions = {connection.msgtype: connection.msgdef.data for connection in reader.connections}
    return found, definitions


def exported(run, name, *arguments):
    bag = run / name
    loopbox("export", run, "--ros2", bag, *arguments)
    return read(bag)


def test_the_definitions_are_those_of_ros(run):
    _, definitions = exported(run, "definitions.mcap")
    assert sorted(definitions) == ["nav_msgs/msg/Odometry", "sensor_msgs/msg/PointCloud2", "tf2_msgs/msg/TFMessage"]
    for kind, text in definitions.items():
        for name, fields in get_types_from_msg(text, kind).items():
            assert fields == STORE.fielddefs[name], name


def test_poses_are_those_of_the_trajectory(run):
    topics, _ = exported(run, "poses.mcap")
    assert sorted(topics) == ["/tf", "/the_yard/odometry", "/the_yard/points"]
    expected = trajectory(run / "trajectory.txt")
    odometry, transforms = topics["/the_yard/odometry"], topics["/tf"]
    assert len(odometry) == len(transforms) == len(expected) > 50
    before = None
    for (time, pose), (logged, message), (_, moved) in zip(expected, odometry, transforms):
        assert abs(seconds(message.header.stamp) - time) < 1e-6 and abs(logged - time) < 1e-6
        assert (message.header.frame_id, message.child_frame_id) == ("the_yard/map", "the_yard/camera")
        assert np.allclose(transform(message.pose.pose), pose, atol=1e-9)
        linear, angular = (
            np.array([part.x, part.y, part.z]) for part in (message.twist.twist.linear, message.twist.twist.angular)
        )
        if before is not None:
            # Half a step along the velocity from both sides meets in the middle, to the second order.
            step = time - before[0]
            motion = np.linalg.inv(before[1]) @ pose
            assert np.allclose(linear * step, motion[:3, 3], atol=1e-3 + 0.01 * np.linalg.norm(motion[:3, 3]))
            cross = (motion[:3, :3] - motion[:3, :3].T) / 2
            assert np.allclose(angular * step, [cross[2, 1], cross[0, 2], cross[1, 0]], atol=1e-3)
        before = (time, pose)
        # The tree of frames: map, camera, and the camera with the axes of its images.
        tree = {found.child_frame_id: found for found in moved.transforms}
        camera, optical = tree.pop("the_yard/camera"), tree.pop("the_yard/camera_optical")
        assert not tree and abs(seconds(camera.header.stamp) - time) < 1e-6
        assert (camera.header.frame_id, optical.header.frame_id) == ("the_yard/map", "the_yard/camera")
        assert np.allclose(transform(camera.transform), pose, atol=1e-9)
        assert np.allclose(transform(optical.transform)[:3, :3], BODY_FROM_OPTICAL)


def test_points_are_those_of_the_cloud(run):
    topics, _ = exported(run, "points.mcap")
    clouds = [message for _, message in topics["/the_yard/points"]]
    assert len(clouds) > 5
    assert all(cloud.header.frame_id == "the_yard/map" for cloud in clouds)
    stamps = [seconds(cloud.header.stamp) for cloud in clouds]
    assert stamps == sorted(stamps)
    found = np.concatenate([points(cloud) for cloud in clouds])
    expected = cloud_file(run / "cloud.ply")
    assert len(expected) > 10_000
    assert np.allclose(found, expected, rtol=1e-5, atol=1e-5)


def test_metres_an_axis_that_is_up_and_thinning_are_kept(run):
    more = ("--scale", 2.5, "--up", "z")
    topics, _ = exported(run, "placed.mcap", *more, "--voxel", 0.1)
    loopbox("export", run, "--tum", run / "placed.txt", "--ply", run / "placed.ply", *more, "--voxel", 0.1)
    # The world's axes are a body's already; the camera's are turned.
    poses = np.loadtxt(run / "placed.txt")
    odometry = topics["/the_yard/odometry"]
    assert len(odometry) == len(poses)
    for numbers, (_, message) in zip(poses, odometry):
        found = transform(message.pose.pose)
        assert np.allclose(found[:3, 3], numbers[1:4], atol=1e-9)
        assert np.allclose(found[:3, :3], matrix(numbers[4:8]) @ BODY_FROM_OPTICAL.T, atol=1e-9)
    # A camera that is carried level is level.
    assert np.mean([transform(message.pose.pose)[2, 2] for _, message in odometry]) > 0.9
    [(time, cloud)] = topics["/the_yard/points"]
    assert abs(time - poses[-1, 0]) < 1e-6
    expected = cloud_file(run / "placed.ply")
    expected[:, :3] = expected[:, :3] @ BODY_FROM_OPTICAL
    assert np.allclose(points(cloud), expected, rtol=1e-5, atol=1e-5)
