//! Maps in metres and upright: the frame and the unit that a monocular map leaves open, taken from what else is known.

pub mod board;
pub mod rig;

use crate::open::open_map;
use anyhow::{Result, bail, ensure};
use eval::{AlignMode, Trajectory, align, associate, read_trajectory};
use geometry::{Se3, Sim3};
use map::{KeyframeId, Map};
use nalgebra::{UnitQuaternion, Vector3};
use std::path::{Path, PathBuf};

/// What tells a map's unit.
#[derive(Clone, Debug, PartialEq)]
pub enum Metres {
    /// So many metres is a map unit.
    Scale(f64),
    /// Two keyframes are so many metres apart.
    Distance {
        /// The one.
        from: KeyframeId,
        /// The other.
        to: KeyframeId,
        /// Between their cameras' centres.
        metres: f64,
    },
    /// A trajectory in metres of the same times (GPS, odometry, motion capture), in the form of TUM: frame and unit are
    /// its own.
    Track {
        /// Its file.
        file: PathBuf,
        /// Largest difference of times that belong together, seconds.
        max_diff: f64,
    },
    /// The map of a LiDAR on the same robot at the same time ([`rig::tie`]): frame and unit are its own.
    Lidar {
        /// Its file, or the folder of its run.
        map: PathBuf,
        /// Where the camera is on the LiDAR, metres.
        lidar_from_camera: Se3,
    },
}

impl Metres {
    /// Whether it brings a frame of its own, and not the unit alone.
    fn brings_frame(&self) -> bool {
        matches!(self, Self::Track { .. } | Self::Lidar { .. })
    }
}

/// The axis of the exported world that points against gravity.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "clap", derive(clap::ValueEnum))]
pub enum Up {
    /// As most viewers and ROS have it; x is where the first camera looks
    Z,
    /// As in computer graphics; -z is where the first camera looks
    Y,
}

/// What brings a map to metres and upright: the similarity `new_from_world`. Of `up` nothing is left to say where a track
/// or a LiDAR's map gives the whole frame.
///
/// # Errors
/// When keyframes are not in the map, the track cannot be read or has too few positions in common with the map, which must
/// not lie on one line, a length is not a positive number, or as [`rig::tie`] says.
pub fn placement(map: &Map, metres: Option<&Metres>, up: Option<Up>) -> Result<Sim3> {
    let metres_from_world = match metres {
        None => Sim3::identity(),
        Some(Metres::Scale(scale)) => scaling(*scale)?,
        Some(Metres::Distance { from, to, metres }) => scaling(metres / distance(map, *from, *to)?)?,
        Some(Metres::Track { file, max_diff }) => track_from_world(map, file, *max_diff)?,
        Some(Metres::Lidar { map: lidar, lidar_from_camera }) => {
            let lidar = open_map(lidar)?.map;
            rig::tie(map, &lidar, lidar_from_camera)?.lidar_world_from_camera_world
        }
    };
    match (up, metres) {
        (Some(_), Some(metres)) if metres.brings_frame() => {
            bail!(
                "a track and a LiDAR's map bring their own frame: what is up in it is said there, so leave out --up"
            )
        }
        (Some(up), _) => Ok(metres_from_world * Sim3::new(upright(map, up), Vector3::zeros(), 1.0)),
        (None, _) => Ok(metres_from_world),
    }
}

/// Brings a map to metres and upright, and has its agent say that its unit is a metre where `metres` told: the one agent of
/// a map that is not united, as the own maps of united agents keep units of their own. Returns by how much lengths grew.
///
/// # Errors
/// As [`placement`]; the map is then as it was.
pub fn place(map: &mut Map, metres: Option<&Metres>, up: Option<Up>) -> Result<f64> {
    let new_from_world = placement(map, metres, up)?;
    // What stays where it is stays so to the last bit.
    if new_from_world != Sim3::identity() {
        map.transform(&new_from_world);
    }
    if let (Some(_), [only]) = (metres, &mut map.agents.values_mut().collect::<Vec<_>>()[..]) {
        only.set_metric();
    }
    Ok(new_from_world.scale)
}

fn scaling(scale: f64) -> Result<Sim3> {
    ensure!(scale.is_finite() && scale > 0.0, "a scale of {scale} cannot be: lengths are positive numbers");
    Ok(Sim3::new(UnitQuaternion::identity(), Vector3::zeros(), scale))
}

/// How far two keyframes are apart, map units.
fn distance(map: &Map, from: KeyframeId, to: KeyframeId) -> Result<f64> {
    let at = |id: KeyframeId| match map.keyframes.get(&id) {
        Some(keyframe) => Ok(keyframe.world_from_keyframe.translation),
        None => bail!(
            "there is no keyframe {} in the map\nhint: its keyframes' numbers stand in report.html and in `loopbox view`",
            id.0
        ),
    };
    let distance = (at(from)? - at(to)?).norm();
    ensure!(distance > 0.0, "keyframes {} and {} are at one place: give two that are apart", from.0, to.0);
    Ok(distance)
}

/// The similarity that brings the map's trajectory to a track (Umeyama 1991).
fn track_from_world(map: &Map, file: &Path, max_diff: f64) -> Result<Sim3> {
    let trajectory = map.trajectory();
    let estimate = Trajectory {
        timestamps: Some(trajectory.iter().map(|pose| pose.timestamp).collect()),
        world_from_camera: trajectory.iter().map(|pose| pose.world_from_camera.into()).collect(),
    };
    ensure!(
        map.agents.len() == 1,
        "a track is of one agent, the map of {}: split it by `loopbox unmerge`, or give a scale",
        map.agents.len()
    );
    let track = read_trajectory(file)?;
    ensure!(
        track.timestamps.is_some(),
        "{}: its poses have no time stamps, by which those of the map are found\nhint: --track takes a TUM file, with the time before \
         each pose",
        file.display()
    );
    let pairs = associate(&estimate, &track, max_diff)?;
    Ok(align(&pairs, AlignMode::Sim3)?.0)
}

/// Turns the world so that up, as the cameras tell, is the axis that is wanted, and the first camera looks along the
/// axis that the convention has for ahead.
fn upright(map: &Map, axis: Up) -> UnitQuaternion<f64> {
    let poses = || map.keyframes.values().map(|keyframe| &keyframe.world_from_keyframe);
    let (up, _) = map::level(poses());
    let looks = poses().next().map_or(Vector3::z(), |pose| pose.rotation * Vector3::z());
    let level = |v: Vector3<f64>| (v - up * up.dot(&v)).try_normalize(1e-6);
    // A camera that looks straight up or down leaves its image's top to say what is ahead.
    let ahead =
        level(looks).or_else(|| level(Vector3::x())).or_else(|| level(Vector3::z())).unwrap_or(Vector3::x());
    let left = up.cross(&ahead);
    // Rows are the new axes in the old world.
    let rows = match axis {
        Up::Z => [ahead, left, up],
        Up::Y => [-left, up, -ahead],
    };
    let matrix = nalgebra::Matrix3::from_rows(&rows.map(|row| row.transpose()));
    UnitQuaternion::from_matrix(&matrix)
}

#[cfg(test)]
mod tests {
    use super::*;
    use geometry::{GrayImage, Pinhole, Se3};
    use map::{AgentInfo, FramePose, Keyframe};
    use nalgebra::Vector6;
    use std::sync::Arc;

    /// A map of cameras that look about, level in a world whose up is −y.
    fn map() -> Map {
        let camera = Pinhole { width: 8, height: 6, fx: 8.0, fy: 8.0, cx: 3.5, cy: 2.5 };
        let mut map = Map::of(AgentInfo::new("one", camera));
        for i in 0..12u32 {
            let (id, angle) = (KeyframeId(i), f64::from(i) * 0.2 + 0.3);
            let rotation = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), angle);
            let translation = Vector3::new(f64::from(i), 0.1 * angle.sin(), (f64::from(i) * 0.7).cos());
            let (pose, image) =
                (Sim3::new(rotation, translation, 1.0), Arc::new(GrayImage::filled(8, 6, 90)));
            map.keyframes.insert(id, Keyframe::of_image(id, f64::from(i), u64::from(i), pose, image));
            map.frames.push(FramePose {
                timestamp: f64::from(i),
                frame_index: u64::from(i),
                reference: id,
                keyframe_from_frame: Se3::identity(),
            });
        }
        map
    }

    #[test]
    fn upright_maps_have_up_and_ahead_where_they_are_wanted() {
        let map = map();
        let first = map.keyframes[&KeyframeId(0)].world_from_keyframe.rotation * Vector3::z();
        for (axis, up, ahead) in [(Up::Z, Vector3::z(), Vector3::x()), (Up::Y, Vector3::y(), -Vector3::z())] {
            let new_from_world = placement(&map, None, Some(axis)).unwrap();
            assert!((new_from_world.rotation * -Vector3::y() - up).norm() < 1e-2);
            assert!((new_from_world.rotation * first - ahead).norm() < 1e-2);
            assert_eq!(new_from_world.scale, 1.0);
        }
    }

    #[test]
    fn a_known_distance_tells_the_unit() {
        let map = map();
        let (from, to) = (KeyframeId(2), KeyframeId(9));
        let metres = Metres::Distance { from, to, metres: 3.5 };
        let mut placed = map.clone();
        placed.transform(&placement(&map, Some(&metres), Some(Up::Z)).unwrap());
        assert!((distance(&placed, from, to).unwrap() - 3.5).abs() < 1e-9);
        for (metres, reason) in [
            (Metres::Distance { from, to: from, metres: 1.0 }, "at one place"),
            (Metres::Distance { from, to: KeyframeId(77), metres: 1.0 }, "no keyframe 77"),
            (Metres::Scale(-2.0), "a scale of -2"),
            (Metres::Scale(f64::NAN), "a scale of NaN"),
        ] {
            let error = placement(&map, Some(&metres), None).unwrap_err().to_string();
            assert!(error.contains(reason), "{error}");
        }
    }

    /// Whoever says that a unit is a metre knows the unit, though nothing moves.
    #[test]
    fn a_metric_scale_is_reported_as_metric() {
        let (map, scale) = (map(), Metres::Scale(1.0));
        let mut placed = map.clone();
        assert_eq!(place(&mut placed, None, None).unwrap(), 1.0);
        assert!(placed == map && !placed.is_metric());
        assert_eq!(place(&mut placed, Some(&scale), None).unwrap(), 1.0);
        assert!(placed.is_metric() && placed.keyframes == map.keyframes);
        assert!(place(&mut placed, Some(&Metres::Scale(-1.0)), None).is_err());
    }

    #[test]
    fn a_track_without_times_is_refused_by_name() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("03.txt");
        std::fs::write(&file, "1 0 0 0 0 1 0 0 0 0 1 0\n1 0 0 1 0 1 0 0 0 0 1 0\n").unwrap();
        let track = Metres::Track { file: file.clone(), max_diff: 0.02 };
        let error = placement(&map(), Some(&track), None).unwrap_err().to_string();
        assert!(error.contains("03.txt: its poses have no time stamps") && error.contains("TUM"), "{error}");
    }

    #[test]
    fn a_track_gives_frame_and_unit() {
        let (map, folder) = (map(), tempfile::tempdir().unwrap());
        let rigid = Se3::exp(&Vector6::new(3.0, -2.0, 1.0, 0.4, 0.2, -0.9));
        let track_from_world = Sim3::new(rigid.rotation, rigid.translation, 6.25);
        let mut moved = map.clone();
        moved.transform(&track_from_world);
        let file = folder.path().join("gps.txt");
        map::save_tum(&file, &moved.trajectory()).unwrap();
        let track = Metres::Track { file, max_diff: 0.02 };
        let found = placement(&map, Some(&track), None).unwrap();
        assert!((found.inverse() * track_from_world).log().norm() < 1e-9);
        assert!(placement(&map, Some(&track), Some(Up::Z)).is_err());
    }
}
