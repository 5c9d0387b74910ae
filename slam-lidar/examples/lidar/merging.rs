//! Merges of all pairs of maps, with their errors.

use crate::Failure;
use crate::truth::Recording;
use backend::verdict::Prior;
use geometry::Se3;
use merge::merge_graph::rigid::{RigidMerge, joined};
use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use slam_lidar::keyframe::Keyframe;
use slam_lidar::mapping::{Agent, MappingParams};
use slam_lidar::merging::robot_map::RobotMap;
use slam_lidar::merging::verdict::{Decision, MergeEvidence, Verdict};
use slam_lidar::merging::{MergeMethod, merge_by};
use slam_lidar::voxels::{VoxelTable, first_of_each_voxel};
use std::path::Path;
use std::time::Instant;

/// Keyframes of a recording, and where they truly were in which world.
struct Mapped {
    name: String,
    world: String,
    keyframes: Vec<Keyframe>,
    truth: Vec<Se3>,
}

/// Length of a stretch, metres.
const STRETCH: f64 = 12.0;
/// A merge is wrong when it misplaces keyframes by more, metres.
const WRONG: f64 = 0.3;

impl Mapped {
    fn new(path: &Path, given: bool) -> Result<Self, Failure> {
        let recording = Recording::open(path)?;
        let params = MappingParams::default();
        let mut agent = Agent::new(params);
        let mut keyframes = Vec::new();
        for file in recording.folder.files() {
            let scan = recording.folder.read(file)?;
            if given {
                let pose = recording.at(scan.stamp).ok_or("no pose at a scan")?;
                let mut kept = Vec::new();
                first_of_each_voxel(&scan.points, params.grid, &mut VoxelTable::default(), &mut kept);
                let points = kept.iter().map(|&i| scan.points[i as usize]).collect();
                keyframes.push(Keyframe::new(scan.stamp, pose, points));
            } else {
                agent.take(&scan)?;
            }
        }
        if !given {
            keyframes = agent.keyframes().to_vec();
        }
        let truth = keyframes.iter().map(|k| recording.at(k.instant).ok_or("no truth at a keyframe"));
        let world = path.parent().unwrap_or(path).display().to_string();
        let truth = truth.collect::<Result<_, _>>()?;
        Ok(Self { name: path.display().to_string(), world, keyframes, truth })
    }

    fn mirrored(&self) -> Self {
        let flip = |pose: &Se3| {
            let q = pose.rotation.quaternion();
            let rotation = UnitQuaternion::from_quaternion(Quaternion::new(q.w, -q.i, q.j, -q.k));
            let t = pose.translation;
            Se3::new(rotation, Vector3::new(t.x, -t.y, t.z))
        };
        let keyframe = |k: &Keyframe| {
            let points = k.points.iter().map(|p| [p[0], -p[1], p[2]]).collect();
            Keyframe::new(k.instant, flip(&k.world_from_sensor), points)
        };
        Self {
            name: format!("{} mirrored", self.name),
            world: format!("{} mirrored", self.world),
            keyframes: self.keyframes.iter().map(keyframe).collect(),
            truth: self.truth.iter().map(flip).collect(),
        }
    }

    /// Stretches of the way, each half over the one before.
    fn cut(&self) -> Vec<Self> {
        let mut travelled = vec![0.0];
        for step in self.keyframes.windows(2) {
            let moved = step[1].world_from_sensor.translation - step[0].world_from_sensor.translation;
            travelled.push(travelled[travelled.len() - 1] + moved.norm());
        }
        let count = (travelled[travelled.len() - 1] / (0.5 * STRETCH)) as usize;
        let stretch = |i: usize| {
            let begin = travelled.partition_point(|d| *d < 0.5 * STRETCH * i as f64);
            let end = travelled.partition_point(|d| *d < 0.5 * STRETCH * i as f64 + STRETCH);
            Self {
                name: format!("{}/{begin}-{end}", self.name),
                world: self.world.clone(),
                keyframes: self.keyframes[begin..end].to_vec(),
                truth: self.truth[begin..end].to_vec(),
            }
        };
        (0..count.saturating_sub(1)).map(stretch).collect()
    }
}

/// Median over the second map's keyframes of how far each is misplaced, metres and degrees, beside the nearest of the first.
fn error(a: &Mapped, b: &Mapped, a_from_b: &Se3) -> Option<(f64, f64)> {
    if a.world != b.world {
        return None;
    }
    let of = |j: usize| {
        let place = b.truth[j].translation;
        let apart = |i: usize| (a.truth[i].translation - place).norm();
        let i = (0..a.truth.len()).min_by(|&x, &y| apart(x).total_cmp(&apart(y)))?;
        let found = a.keyframes[i].world_from_sensor.inverse() * *a_from_b * b.keyframes[j].world_from_sensor;
        let off = (a.truth[i].inverse() * b.truth[j]).inverse() * found;
        Some((off.translation.norm(), off.rotation.angle().to_degrees()))
    };
    let (mut far, mut turned): (Vec<f64>, Vec<f64>) = (0..b.truth.len()).filter_map(of).unzip();
    far.sort_by(f64::total_cmp);
    turned.sort_by(f64::total_cmp);
    Some((*far.get(far.len() / 2)?, *turned.get(turned.len() / 2)?))
}

fn figures(e: &MergeEvidence, off: Option<(f64, f64)>) -> String {
    let off = off.map_or("other world".to_owned(), |(m, deg)| format!("{m:.3} m {deg:.2} deg"));
    format!(
        "{off} | pieces {}/{} ({}) overlap {:.2} agreeing {:.3} ln ratio {:.1} changed {:.3} weak {} rmse {:.3} support {:.2}",
        e.pieces,
        e.of_pieces,
        e.finding,
        e.overlap,
        e.things.inlier_ratio,
        e.weighed.ln_ratio,
        e.weighed.changed,
        e.conditioning.weak,
        e.rmse,
        e.support
    )
}

fn print(a: &Mapped, b: &Mapped, verdict: &Verdict, seconds: f64) {
    println!("{} {}: {:?}, {} ({seconds:.2} s)", a.name, b.name, verdict.decision, verdict.line);
    for e in verdict.best.iter().chain(&verdict.rivals) {
        println!("    {}", figures(e, error(a, b, &e.a_from_b)));
    }
}

/// Counts of right and wrong merges.
#[derive(Default)]
struct Tally {
    right: usize,
    wrong: usize,
    undecided: usize,
    refused: usize,
}

/// Merges every pair and then all.
pub fn run(command: &str, folders: &[String]) -> Result<(), Failure> {
    let mapped = folders.iter().map(|f| Mapped::new(f.as_ref(), command == "merge-given"));
    let mut maps = mapped.collect::<Result<Vec<_>, _>>()?;
    if command == "merge-cut" {
        maps = maps.iter().flat_map(Mapped::cut).collect();
    }
    let begin = Instant::now();
    let ready: Vec<RobotMap> = maps.iter().map(|m| RobotMap::new(&m.keyframes)).collect();
    println!("{} maps prepared in {:.2} s", maps.len(), begin.elapsed().as_secs_f64());
    let (mut merges, mut tally) = (Vec::new(), Tally::default());
    for i in 0..maps.len() {
        for j in i + 1..maps.len() {
            let other = (command == "merge-mirrored").then(|| maps[j].mirrored());
            let (b, prepared) =
                (other.as_ref().unwrap_or(&maps[j]), other.as_ref().map(|m| RobotMap::new(&m.keyframes)));
            let begin = Instant::now();
            let method = if command == "merge-emr" { MergeMethod::Emr } else { MergeMethod::Pieces };
            let verdict =
                merge_by(method, &ready[i], prepared.as_ref().unwrap_or(&ready[j]), &Prior::default());
            print(&maps[i], b, &verdict, begin.elapsed().as_secs_f64());
            let Some(best) = verdict.best else { continue };
            let right = error(&maps[i], b, &best.a_from_b).is_some_and(|(m, _)| m < WRONG);
            match verdict.decision {
                Decision::Accepted if right => tally.right += 1,
                Decision::Accepted => tally.wrong += 1,
                Decision::Undecided => tally.undecided += 1,
                Decision::Refused => tally.refused += 1,
            }
            if verdict.decision == Decision::Accepted {
                merges.push(RigidMerge { from: i, to: j, from_from_to: best.a_from_b, trust: best.support });
            }
        }
    }
    let Tally { right, wrong, undecided, refused } = tally;
    println!("accepted: {right} right, {wrong} wrong; {undecided} undecided, {refused} refused");
    if command != "merge-mirrored" && command != "merge-cut" {
        let all = joined(maps.len(), &merges);
        for (m, (root, pose)) in all.root.iter().zip(&all.root_from_map).enumerate() {
            println!(
                "{} in the frame of {}: {:?}, error {:?}",
                maps[m].name,
                maps[*root].name,
                pose.to_tum(),
                error(&maps[*root], &maps[m], pose)
            );
        }
    }
    Ok(())
}
