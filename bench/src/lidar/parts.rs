//! Stretches of maps as maps of their own, with the truth known: what strangers are made of.

use super::truth::Truth;
use anyhow::{Context, Result};
use geometry::{Se3, Sim3};
use map::{AgentInfo, Keyframe, Map, Scan, Sensor, load_map, save_map};
use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use std::collections::HashSet;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Length of a stretch, metres: some keyframes, no more than two robots have when they meet.
const STRETCH: f64 = 12.0;
/// Shorter ends are left out, metres.
const LEAST: f64 = 6.0;
/// Edge of the cells in which the overlap of two parts is counted, metres.
const CELL: f64 = 0.5;

/// A stretch of a map.
pub struct Part {
    /// What it is of, for people.
    pub name: String,
    /// The world it was recorded in.
    pub world: String,
    /// Its map's file.
    pub file: PathBuf,
    /// Poses of the keyframes in its map, and where they truly were.
    pub poses: Vec<[Se3; 2]>,
    /// Cells of the true world that its points lie in.
    cells: HashSet<[i32; 3]>,
}

/// A map with known truth, to be cut.
pub struct Whole<'a> {
    /// The map.
    pub map: &'a Path,
    /// The truth of its recording.
    pub truth: &'a Truth,
    /// The recording's name.
    pub name: &'a str,
    /// Its world's.
    pub world: &'a str,
}

/// Cuts a map into stretches, each written into a folder within `home`; `mirrored` as a mirror shows it, which is a world
/// that there is not.
///
/// # Errors
/// When the map cannot be read or a part not be written.
pub fn cut(whole: &Whole, home: &Path, mirrored: bool) -> Result<Vec<Part>> {
    let map = load_map(whole.map).with_context(|| whole.map.display().to_string())?.map;
    let known = |keyframe: &Keyframe| Some((keyframe.clone(), whole.truth.at(keyframe.timestamp)?));
    let keyframes: Vec<(Keyframe, Se3)> = map.keyframes.values().filter_map(known).collect();
    stretches(&keyframes, whole.name, whole.world, home, mirrored)
}

/// Keyframes, each with where it truly was, as stretches; as [`cut`].
///
/// # Errors
/// When a part cannot be written.
pub fn stretches(
    keyframes: &[(Keyframe, Se3)],
    name: &str,
    world: &str,
    home: &Path,
    mirrored: bool,
) -> Result<Vec<Part>> {
    let mut travelled = vec![0.0];
    for step in keyframes.windows(2) {
        travelled
            .push(travelled[travelled.len() - 1] + (step[1].1.translation - step[0].1.translation).norm());
    }
    let total = travelled.last().copied().unwrap_or(0.0);
    let count = (total / STRETCH) as usize + usize::from(total % STRETCH >= LEAST);
    let prefix = if mirrored { "mirrored " } else { "" };
    let stretch = |i: usize| {
        let at = |metres: f64| travelled.partition_point(|along| *along < metres);
        let of = &keyframes[at(STRETCH * i as f64)..at(STRETCH * (i + 1) as f64)];
        let name = format!("{prefix}{name} {i}");
        let folder = home.join(name.replace([' ', '/'], "-"));
        part(of, &name, &format!("{prefix}{world}"), &folder, mirrored)
    };
    (0..count).map(stretch).collect()
}

fn part(of: &[(Keyframe, Se3)], name: &str, world: &str, folder: &Path, mirrored: bool) -> Result<Part> {
    let mut map = Map::of(AgentInfo::new(name, Sensor::Lidar));
    let (mut poses, mut cells) = (Vec::new(), HashSet::new());
    for (keyframe, truth) in of {
        let (mut keyframe, mut truth) = (keyframe.clone(), *truth);
        if mirrored {
            let flipped = keyframe.scan.iter().flat_map(|scan| scan.points()).map(|[x, y, z]| [x, -y, z]);
            keyframe.scan = Some(Arc::new(Scan::new(flipped.collect::<Vec<_>>())));
            keyframe.world_from_keyframe = Sim3::from(flip(&keyframe.world_from_keyframe.rigid()));
            truth = flip(&truth);
        }
        for p in keyframe.scan.iter().flat_map(|scan| scan.points()) {
            let p = truth * Vector3::from(p.map(f64::from));
            cells.insert([0, 1, 2].map(|axis| (p[axis] / CELL).floor() as i32));
        }
        poses.push([keyframe.world_from_keyframe.rigid(), truth]);
        map.keyframes.insert(keyframe.id, keyframe);
    }
    std::fs::create_dir_all(folder).with_context(|| format!("{}: cannot be made", folder.display()))?;
    let file = folder.join("map.mcap");
    save_map(&file, &map)?;
    Ok(Part { name: name.to_owned(), world: world.to_owned(), file, poses, cells })
}

/// A pose as a mirror along y shows it.
fn flip(pose: &Se3) -> Se3 {
    let (q, t) = (pose.rotation.quaternion(), pose.translation);
    let rotation = UnitQuaternion::from_quaternion(Quaternion::new(q.w, -q.i, q.j, -q.k));
    Se3::new(rotation, Vector3::new(t.x, -t.y, t.z))
}

impl Part {
    /// The share of the one's surfaces that the other saw too, by the truth; the lesser of both ways.
    pub fn overlap(&self, other: &Self) -> f64 {
        if self.world != other.world {
            return 0.0;
        }
        self.plan_overlap(other)
    }

    /// The same as if both were of one world: how much of it stretches of doubles would share.
    pub fn plan_overlap(&self, other: &Self) -> f64 {
        self.seen_by(other).min(other.seen_by(self))
    }

    /// Share of the cells that have one of the other's in them or beside them.
    fn seen_by(&self, other: &Self) -> f64 {
        let near = |cell: &&[i32; 3]| {
            let neighbour = |k: i32| [cell[0] + k % 3 - 1, cell[1] + k / 3 % 3 - 1, cell[2] + k / 9 - 1];
            (0..27).any(|k| other.cells.contains(&neighbour(k)))
        };
        self.cells.iter().filter(near).count() as f64 / self.cells.len().max(1) as f64
    }

    /// How far a pose between the maps misplaces the other's keyframes beside the nearest of the own, metres, median.
    pub fn misplaced(&self, other: &Self, self_from_other: &Se3) -> f64 {
        let of = |[pose, truth]: &[Se3; 2]| {
            let apart = |own: &&[Se3; 2]| (own[1].translation - truth.translation).norm();
            let own = self.poses.iter().min_by(|a, b| apart(a).total_cmp(&apart(b)))?;
            let found = own[0].inverse() * *self_from_other * *pose;
            Some(((own[1].inverse() * *truth).inverse() * found).translation.norm())
        };
        measuring::median(other.poses.iter().filter_map(of).collect()).unwrap_or(f64::INFINITY)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(world: &str, at: f64, drawn: f64) -> Part {
        let pose = |x: f64| Se3::new(UnitQuaternion::identity(), Vector3::new(x, 0.0, 0.0));
        let poses = (0..4).map(|k| [pose(f64::from(k) + drawn), pose(f64::from(k) + at)]).collect();
        let cells = (0..40).map(|k| [k + (2.0 * at) as i32, 0, 0]).collect();
        Part { name: String::new(), world: world.into(), file: PathBuf::new(), poses, cells }
    }

    #[test]
    fn parts_overlap_and_are_misplaced_by_the_truth() {
        let (one, other) = (of("hall", 0.0, 0.0), of("hall", 10.0, 0.0));
        // Of 40 cells 20 are the other's, and one lies beside them.
        assert!((one.overlap(&other) - 21.0 / 40.0).abs() < 1e-9, "{}", one.overlap(&other));
        assert_eq!(one.overlap(&of("street", 0.0, 0.0)), 0.0);
        let exact = Se3::new(UnitQuaternion::identity(), Vector3::new(10.0, 0.0, 0.0));
        assert!(one.misplaced(&other, &exact) < 1e-9);
        let neighbour = Se3::new(UnitQuaternion::identity(), Vector3::new(10.0, 0.7, 0.0));
        assert!((one.misplaced(&other, &neighbour) - 0.7).abs() < 1e-9);
    }

    #[test]
    fn a_mirrored_pose_moves_mirrored_points() {
        let turned = UnitQuaternion::from_euler_angles(0.3, -0.2, 1.1);
        let (pose, p) = (Se3::new(turned, Vector3::new(1.0, 2.0, 3.0)), Vector3::new(0.5, -4.0, 2.0));
        let mirror = |v: Vector3<f64>| Vector3::new(v.x, -v.y, v.z);
        assert!((flip(&pose) * mirror(p) - mirror(pose * p)).norm() < 1e-12);
    }
}
