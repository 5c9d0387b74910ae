//! A camera and a LiDAR on one robot: what the LiDAR's map tells the camera's, by both trajectories and the pose of the
//! one sensor on the other.

use crate::lidar::poses::GivenPoses;
use anyhow::{Context, Result, anyhow, bail, ensure};
use geometry::pose_alignment::{PoseAlignment, PosePair, align_poses};
use geometry::{Se3, Sim3};
use map::Map;
use std::fs;
use std::path::Path;

/// Poses of the LiDAR farther apart than this are not interpolated, seconds: five sweeps of most sensors.
const MAX_GAP: f64 = 0.5;
/// Fewest images with a pose of both sensors: those of half a second.
const MIN_PAIRS: usize = 10;
/// Nearest way that tells metres, root mean square from its middle: ten times what a LiDAR's pose errs by.
const MIN_REACH: f64 = 0.2;
/// Largest distance between the two ways as a share of their reach (median): the scale may be as wrong.
const MAX_SCALE_DOUBT: f64 = 0.05;
/// Largest angle between the two ways, degrees (median): clocks 50 ms apart make it at 60 °/s.
const MAX_ANGLE: f64 = 3.0;

/// What else may be wrong where two ways are not one.
const CHECK: &str = "check the extrinsic, lidar_from_camera of a camera that looks along z, and both clocks";

/// A camera's map tied to that of the LiDAR beside it.
#[derive(Clone, Debug)]
pub struct Tied {
    /// Maps points of the camera's world, in its unit, into the LiDAR's, metres.
    pub lidar_world_from_camera_world: Sim3,
    /// The evidence.
    pub alignment: PoseAlignment,
    lidar: GivenPoses,
    lidar_from_camera: Se3,
}

impl Tied {
    /// Where the camera was by the LiDAR's map, in its world, metres; `None` at times that have no pose of the LiDAR's.
    pub fn lidar_world_from_camera(&self, time: f64) -> Option<Se3> {
        Some(self.lidar.between(time, MAX_GAP)? * self.lidar_from_camera)
    }
}

/// Ties the map of a camera to that of a LiDAR that was on the same robot at the same time, by one clock: frame and unit
/// of the camera's world follow from both ways. `lidar_from_camera` is where the camera is on the LiDAR (x forward, y
/// left, z up, metres), looking along its own z.
///
/// # Errors
/// When a map is not of one such agent, they have too few times in common, the robot moved too little to tell metres, or
/// the ways are not those of two sensors that lie to each other so.
pub fn tie(camera: &Map, lidar: &Map, lidar_from_camera: &Se3) -> Result<Tied> {
    camera.of_cameras().context("metres are for a camera's map")?;
    lidar.of_lidars().context("metres are taken from a LiDAR's map")?;
    for (map, sensor) in [(camera, "camera"), (lidar, "LiDAR")] {
        let agents = map.agents.len();
        ensure!(
            agents == 1,
            "a rig is of one agent each, the {sensor}'s map of {agents}: split it by `loopbox unmerge`"
        );
    }
    let stamped =
        lidar.trajectory().into_iter().map(|pose| (pose.timestamp, pose.world_from_camera)).collect();
    let poses = GivenPoses::new(stamped).context("the LiDAR's map has no trajectory to go by")?;
    let images = camera.trajectory();
    let pair = |pose: &map::StampedPose| {
        let world_from_lidar = poses.between(pose.timestamp, MAX_GAP)?;
        let target_from_body = world_from_lidar * *lidar_from_camera;
        Some(PosePair { target_from_body, source_from_body: pose.world_from_camera })
    };
    let pairs: Vec<PosePair> = images.iter().filter_map(pair).collect();
    if pairs.len() < MIN_PAIRS {
        let span = images.first().zip(images.last());
        let (first, last) = span.map_or((0.0, 0.0), |(first, last)| (first.timestamp, last.timestamp));
        let [begin, end] = poses.span();
        bail!(
            "{} of {} images were taken while the LiDAR has poses, too few to tell metres: the images' times are \
             {first:.3} to {last:.3} s, the scans' {begin:.3} to {end:.3} s\nhint: both need the time of one clock",
            pairs.len(),
            images.len()
        );
    }
    let alignment = align_poses(&pairs)
        .map_err(|error| anyhow!("the motion does not tell metres: {error}\nhint: drive farther; {CHECK}"))?;
    check(&alignment)?;
    let (lidar_world_from_camera_world, lidar_from_camera) =
        (alignment.target_from_source, *lidar_from_camera);
    Ok(Tied { lidar_world_from_camera_world, alignment, lidar: poses, lidar_from_camera })
}

/// Refuses what does not determine the scale, and ways that are not of one robot.
fn check(alignment: &PoseAlignment) -> Result<()> {
    let PoseAlignment { reach, distance, pairs, .. } = *alignment;
    ensure!(
        reach >= MIN_REACH,
        "the motion does not tell metres: the camera moved {reach:.3} m about the middle of its way, and less than \
         {MIN_REACH} m is within what poses err by\nhint: drive farther"
    );
    let angle = alignment.angle.to_degrees();
    ensure!(
        angle <= MAX_ANGLE,
        "camera and LiDAR turn otherwise, by {angle:.1}° in the middle of {pairs} images: they were not on one robot, their \
         clocks differ, or the extrinsic is another one\nhint: {CHECK}"
    );
    ensure!(
        alignment.scale_doubt() <= MAX_SCALE_DOUBT,
        "the motion does not tell metres: the ways of camera and LiDAR are {distance:.3} m apart in the middle, of a way \
         that reaches {reach:.3} m\nhint: drive farther; {CHECK}"
    );
    Ok(())
}

/// The pose `lidar_from_camera` as people give it: `tx,ty,tz,qx,qy,qz,qw` (metres, and the quaternion as TUM has it), or a
/// file of these seven numbers or of the upper 3×4 of the matrix, row by row.
///
/// # Errors
/// When it is neither, or not rigid.
pub fn extrinsic(text: &str) -> Result<Se3> {
    let numbers = match numbers(text) {
        Some(numbers) => numbers,
        None => {
            let read = fs::read_to_string(Path::new(text));
            let read =
                read.with_context(|| format!("{text}: is neither a pose nor a file that can be read"))?;
            numbers(&read).with_context(|| format!("{text}: is not a list of numbers"))?
        }
    };
    // What people write down is rounded.
    let is_one = |square: f64| (square - 1.0).abs() < 0.02;
    if let Ok(seven) = <[f64; 7]>::try_from(&numbers[..]) {
        let square: f64 = seven[3..].iter().map(|q| q * q).sum();
        ensure!(is_one(square), "the quaternion of the extrinsic has length {:.3}, not 1", square.sqrt());
        return Ok(Se3::from_tum(seven));
    }
    ensure!(
        numbers.len() == 12,
        "an extrinsic is 7 or 12 numbers, not {}: tx,ty,tz,qx,qy,qz,qw",
        numbers.len()
    );
    let matrix = nalgebra::Matrix3x4::from_row_slice(&numbers);
    let rotation = matrix.fixed_columns::<3>(0).into_owned();
    let off = (rotation * rotation.transpose() - nalgebra::Matrix3::identity()).amax();
    ensure!(off < 0.02 && rotation.determinant() > 0.0, "the extrinsic's left 3×3 is no rotation");
    let rotation = nalgebra::UnitQuaternion::from_matrix(&rotation);
    Ok(Se3::new(rotation, matrix.column(3).into_owned()))
}

/// Finite numbers between commas, spaces and ends of lines; `None` where anything else is.
fn numbers(text: &str) -> Option<Vec<f64>> {
    let words = text.split(|c: char| c == ',' || c.is_whitespace()).filter(|word| !word.is_empty());
    words.map(|word| word.parse().ok().filter(|number: &f64| number.is_finite())).collect()
}

#[cfg(test)]
mod tests;
