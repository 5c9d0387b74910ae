//! Whether a merge depends on the units and worlds of its maps.

use super::cases::Case;
use super::cut::moved;
use super::program::{Attempt, Merged, Program};
use anyhow::{Context, Result, bail};
use eval::{DEFAULT_MAX_DIFF, Trajectory};
use geometry::Random;
use geometry::{Sim3, umeyama};
use map::{load_map, save_map};
use nalgebra::{SVector, Vector3};
use std::path::{Path, PathBuf};

/// How far one world is moved from another: up to so many units of it along each axis.
const DISTANCE: f64 = 100.0;

/// What is done with the two maps before they are merged.
struct Variant {
    what: &'static str,
    /// How much larger the numbers of each map's world become.
    scales: [f64; 2],
    /// How much larger the unit of each map's keyframes becomes.
    keyframe_scales: [f64; 2],
}

const VARIANTS: [Variant; 3] = [
    Variant { what: "worlds × 0.2 and × 5, moved", scales: [0.2, 5.0], keyframe_scales: [1.0, 1.0] },
    Variant { what: "worlds × 5 and × 0.2, moved", scales: [5.0, 0.2], keyframe_scales: [1.0, 1.0] },
    Variant {
        what: "worlds × 0.7 and × 3, moved; keyframes' units × 3 and × 0.3",
        scales: [0.7, 3.0],
        keyframe_scales: [3.0, 0.3],
    },
];

/// How much a merge changed.
pub struct Change {
    /// What was done to the maps.
    pub what: String,
    /// The largest distance of a pose of the merged trajectories from where it was, parts of their extent, after one
    /// alignment of all; or why there is none.
    pub largest: Result<f64, String>,
}

/// Merges the maps of a case of two in other units and worlds, and compares with the merge made before.
///
/// # Errors
/// When files cannot be read or written; a merge that is refused or fails is told in the result.
pub fn measure(case: &Case, program: &Program, work: &Path) -> Result<Vec<Change>> {
    let maps: Vec<PathBuf> = case.recordings.iter().map(|recording| recording.map(work)).collect();
    let merge = |maps: &[PathBuf], out: &Path| match program.merge(maps, out, None)? {
        Attempt::Merged(merged) => Ok(merged),
        Attempt::Refused(reasons) => bail!("refused: {}", reasons.join("; ")),
    };
    let folder = work.join("moved");
    let before = merge(&maps, &folder.join("before")).and_then(|merged| paths(&merged, maps.len()));
    let originals = maps.iter().map(|path| Ok(load_map(path)?.map)).collect::<Result<Vec<_>>>()?;
    let mut random = Random::new(3);
    let mut changes = Vec::new();
    for (number, variant) in VARIANTS.iter().enumerate() {
        let mut files = Vec::new();
        for (i, original) in originals.iter().enumerate() {
            let home = folder.join(format!("{number}-{i}"));
            std::fs::create_dir_all(&home).with_context(|| format!("{}: cannot be made", home.display()))?;
            let map = moved(original, &motion(&mut random, variant.scales[i]), variant.keyframe_scales[i]);
            files.push(home.join("map.mcap"));
            save_map(&files[i], &map)?;
        }
        let after = merge(&files, &folder.join("after")).and_then(|merged| paths(&merged, files.len()));
        let largest = match (&before, after) {
            (Ok(before), Ok(after)) => largest_change(before, &after),
            (Err(error), _) => Err(anyhow::anyhow!("the maps as they are: {error:#}")),
            (_, Err(error)) => Err(error),
        };
        let largest = largest.map_err(|error| format!("{error:#}"));
        changes.push(Change { what: format!("{}: {}", case.title(), variant.what), largest });
    }
    std::fs::remove_dir_all(&folder).with_context(|| format!("{}: cannot be removed", folder.display()))?;
    Ok(changes)
}

/// A similarity that moves anywhere and scales by `scale`.
fn motion(random: &mut Random, scale: f64) -> Sim3 {
    let mut number = |size: f64| size * (2.0 * random.unit() - 1.0);
    let tangent = SVector::<f64, 7>::from([0.0, 0.0, 0.0, number(3.0), number(3.0), number(3.0), 0.0]);
    let shift = Vector3::new(number(DISTANCE), number(DISTANCE), number(DISTANCE));
    Sim3::new(Sim3::exp(&tangent).rotation, shift, scale)
}

/// The merged trajectories of all inputs.
fn paths(merged: &Merged, count: usize) -> Result<Vec<Trajectory>> {
    if !merged.together(0, count - 1) {
        bail!("the maps were not merged");
    }
    (0..count).map(|input| merged.trajectory(input)).collect()
}

/// The largest distance between positions of the same time after one alignment of all trajectories, parts of the
/// diagonal of the box around them.
fn largest_change(before: &[Trajectory], after: &[Trajectory]) -> Result<f64> {
    let (mut here, mut there) = (Vec::new(), Vec::new());
    for (before, after) in before.iter().zip(after) {
        if before.len() != after.len() {
            bail!("{} poses became {}", before.len(), after.len());
        }
        let times = before.timestamps.as_deref().unwrap_or_default();
        for (time, pose) in times.iter().zip(&before.world_from_camera) {
            let moved = after.pose_at(*time, DEFAULT_MAX_DIFF).context("a pose is missing")?;
            here.push(pose.translation);
            there.push(moved.translation);
        }
    }
    let before_from_after = umeyama::sim3(&there, &here)?;
    let distance = |(here, there): (&Vector3<f64>, &Vector3<f64>)| (before_from_after * *there - here).norm();
    let largest = here.iter().zip(&there).map(distance).fold(0.0, f64::max);
    let corner = |fold: fn(f64, f64) -> f64| here.iter().copied().reduce(|a, b| a.zip_map(&b, fold));
    let extent = corner(f64::max).zip(corner(f64::min)).map(|(max, min)| (max - min).norm());
    Ok(largest / extent.context("there are no poses")?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use geometry::Se3;
    use nalgebra::UnitQuaternion;

    fn path(motion: &Sim3) -> Trajectory {
        let position = |i: u32| Vector3::new(f64::from(i), f64::from(i * i) / 10.0, f64::from(i % 3));
        let pose = |i: u32| Se3::new(UnitQuaternion::identity(), *motion * position(i)).into();
        Trajectory {
            timestamps: Some((0..20).map(f64::from).collect()),
            world_from_camera: (0..20).map(pose).collect(),
        }
    }

    #[test]
    fn only_what_an_alignment_leaves_is_a_change() {
        let motion = motion(&mut Random::new(1), 0.2);
        assert_eq!(motion.scale, 0.2);
        let before = [path(&Sim3::identity())];
        assert!(largest_change(&before, &[path(&motion)]).unwrap() < 1e-12);
        let mut other = path(&motion);
        // 0.02 of its units are 0.1 of the units before; the box measures 19 × 36.1 × 2.
        other.world_from_camera[10].translation.z += 0.02;
        let change = largest_change(&before, &[other.clone()]).unwrap();
        assert!((change * 40.8 - 0.1).abs() < 0.02, "{change}");
        other.world_from_camera.pop();
        assert!(largest_change(&before, &[other]).is_err());
    }
}
