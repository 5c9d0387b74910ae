//! Maps on true poses, each in a frame of its own, merged.

use crate::packed::Recording;
use geometry::Se3;
use slam_lidar::keyframe::Keyframe;
use slam_lidar::merging::merge;
use slam_lidar::merging::robot_map::RobotMap;
use slam_lidar::merging::verdict::{Decision, Verdict};
use slam_lidar::motion::{MotionTable, Sweep, SweepMotion};
use slam_lidar::voxels::{VoxelTable, first_of_each_voxel};

/// Grid of keyframes, metres: that of agents.
const GRID: f32 = 0.15;

/// The map of every tenth sweep in the frame of the first; mirrored it is of a world that there is not.
fn map(recording: &Recording, sweeps: usize, mirrored: bool) -> RobotMap {
    let first = recording.truth_at(recording.scan(0).stamp).inverse();
    let keyframe = |index: usize| {
        let sweep = Sweep::of(&recording.scan(index), (0.5, 100.0));
        let [begin, end] = [sweep.instants.0, sweep.instants.1].map(|t| first * recording.truth_at(t));
        let middle = first * recording.truth_at(sweep.middle());
        let table = MotionTable::new(&SweepMotion { begin, end }, &middle.inverse());
        let points = sweep.undistorted(&table);
        let mut kept = Vec::new();
        first_of_each_voxel(&points, GRID, &mut VoxelTable::default(), &mut kept);
        let points: Vec<[f32; 3]> = kept.iter().map(|&i| points[i as usize]).collect();
        match mirrored {
            false => Keyframe::new(sweep.middle(), middle, points),
            true => {
                let [x, y, z, qx, qy, qz, qw] = middle.to_tum();
                let flipped = points.iter().map(|p| [p[0], -p[1], p[2]]).collect();
                Keyframe::new(sweep.middle(), Se3::from_tum([x, -y, z, -qx, qy, -qz, qw]), flipped)
            }
        }
    };
    let keyframes: Vec<Keyframe> = (0..sweeps).step_by(10).map(keyframe).collect();
    RobotMap::new(&keyframes)
}

fn on_cores(cores: usize, a: &RobotMap, b: &RobotMap) -> Verdict {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(cores).build().expect("threads");
    pool.install(|| merge(a, b))
}

/// In the opposite direction of travel, five metres beside each other over half of the way.
#[test]
fn maps_merge_to_a_few_millimetres_with_the_same_bits_on_any_number_of_cores() {
    let (Some(a), Some(c)) = (Recording::open("a"), Recording::open("c")) else { return };
    let (ma, mc) = (map(&a, 420, false), map(&c, 295, false));
    let found = on_cores(1, &ma, &mc);
    assert_eq!(found.decision, Decision::Accepted, "{}", found.line);
    let pose = found.best.expect("an accepted merge has a pose").a_from_b;
    let truth = a.truth_at(a.scan(0).stamp).inverse() * c.truth_at(c.scan(0).stamp);
    let error = truth.inverse() * pose;
    assert!(error.translation.norm() < 0.05, "{:.3} m", error.translation.norm());
    assert!(error.rotation.angle().to_degrees() < 0.2, "{:?}", error.rotation);
    let again = on_cores(2, &ma, &mc).best.expect("a pose").a_from_b;
    assert_eq!(pose.to_tum().map(f64::to_bits), again.to_tum().map(f64::to_bits));
}

/// A mirrored hall has the same walls and racks; what stands in the aisles gives it away.
#[test]
fn a_mirrored_map_is_not_accepted() {
    let (Some(a), Some(b)) = (Recording::open("a"), Recording::open("b")) else { return };
    let verdict = merge(&map(&a, 420, false), &map(&b, 295, true));
    assert_ne!(verdict.decision, Decision::Accepted, "{:?}", verdict.best);
}
