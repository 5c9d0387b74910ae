//! Things that stand in one map and not in the other, which looks through them.
//!
//! Two places that look alike differ in a pallet here and a cabinet there: a fiftieth of the points, but all of them lie
//! together, and the other map's rays pass through them as a whole. Where maps of one place contradict each other, by
//! drift, at edges and between rings, the cells lie scattered (as patches of images do: `backend::sim3_align::patches`).
//! So what counts is the largest group of cells that lie side by side.

use super::robot_map::RobotMap;
use crate::keyframe::{Keyframe, Seen, Sight, Submap, transformed};
use crate::voxels::{VoxelTable, cell_at, first_of_each_voxel, key_of};
use geometry::Se3;
use nalgebra::Vector3;
use rayon::prelude::*;

/// Edge of the cells, metres: half of the smallest thing that tells places apart.
const CELL: f32 = 0.25;
/// Points of the other map count as near on a grid of so many metres: that of keyframes.
const NEAR: f32 = 0.15;
/// Views that say the same of a cell, at least: one may be of something that moves, or look past an edge.
const VIEWS: usize = 2;
/// So many times as many views as speak against it must speak for a cell.
const MAJORITY: usize = 2;
/// A level surface is looked through where it would have to lie so much farther along its normal, metres: along a ray that
/// grazes the floor a tilt of a degree moves by metres where it meets it, and rings lie too far apart there to see more.
const CLEAR: f64 = 0.2;
/// Cosine of the steepest slope of a level surface.
const LEVEL: f64 = 0.7;
/// Cells of a group lie no farther from each other, cells along each axis: rings of 16 lie half a metre apart at 14 m.
const BESIDE: i32 = 2;

/// A point on a surface, with its normal where the surface is flat.
#[derive(Clone, Copy, Debug)]
struct Surfel {
    point: [f32; 3],
    normal: Option<[f32; 3]>,
}

/// What a map holds for certain.
#[derive(Clone, Debug, Default)]
pub struct Settled {
    /// One point of each cell that several of the map's own views saw, and few saw through.
    surfels: Vec<Surfel>,
    /// All cells with points, on the grid of nearness.
    occupied: VoxelTable,
}

/// Views that see through a point of a surface with this normal, and that see a surface there.
fn views(sights: &[Sight], point: [f32; 3], normal: Option<Vector3<f64>>) -> (usize, usize) {
    let (mut free, mut surface) = (0, 0);
    for sight in sights {
        match sight.look_beyond(point) {
            (Seen::Free, beyond) if is_clear(sight, point, normal, beyond) => free += 1,
            (Seen::Surface, _) => surface += 1,
            _ => {}
        }
    }
    (free, surface)
}

/// Whether what a view saw beyond a point lies off the surface there, not only farther along it.
fn is_clear(sight: &Sight, point: [f32; 3], normal: Option<Vector3<f64>>, beyond: f32) -> bool {
    normal.is_none_or(|normal| {
        if normal.z.abs() < LEVEL {
            return true;
        }
        let ray = Vector3::from(point.map(f64::from)) - sight.position();
        ray.dot(&normal).abs() * f64::from(beyond) > CLEAR * ray.norm()
    })
}

impl Settled {
    /// Of keyframes, whose submap is `whole`.
    pub fn new(keyframes: &[Keyframe], whole: &Submap) -> Self {
        let in_map = |k: &Keyframe| -> Vec<[f32; 3]> {
            k.points.iter().map(|&p| transformed(&k.world_from_sensor, p)).collect()
        };
        let all: Vec<[f32; 3]> = keyframes.iter().flat_map(in_map).collect();
        let (mut occupied, mut kept) = (VoxelTable::default(), Vec::new());
        first_of_each_voxel(&all, NEAR, &mut occupied, &mut kept);
        kept.clear();
        first_of_each_voxel(&all, CELL, &mut VoxelTable::default(), &mut kept);
        let surfel = |&i: &u32| {
            let point = all[i as usize];
            let surface = whole.fine.surface_at(point);
            let surfel =
                Surfel { point, normal: surface.filter(|s| s.constraints() == 1).map(|s| s.axes[0]) };
            let (free, surface) = views(&whole.sights, point, None);
            (surface >= VIEWS && surface > MAJORITY * free).then_some(surfel)
        };
        Self { surfels: kept.par_iter().filter_map(surfel).collect(), occupied }
    }

    /// Whether there are points in a point's cell or in one beside it.
    fn is_near(&self, point: [f32; 3]) -> bool {
        let [x, y, z] = cell_at(point, 1.0 / NEAR);
        let beside = |k: i32| key_of([x + k % 3 - 1, y + k / 3 % 3 - 1, z + k / 9 - 1]);
        (0..27).any(|k| self.occupied.get(beside(k)).is_some())
    }
}

/// What two maps say of each other's surfaces.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Comparison {
    /// Surface that both saw, square metres; the lesser of both ways.
    pub shared: f64,
    /// The largest thing that one of the maps holds and the other looks through, square metres of surface.
    pub absent: f64,
}

/// Compares maps at a pose.
pub fn compare(a: &RobotMap, b: &RobotMap, a_from_b: &Se3) -> Comparison {
    let (there, back) = (one_way(a, b, a_from_b), one_way(b, a, &a_from_b.inverse()));
    let area = |cells: usize| cells as f64 * f64::from(CELL * CELL);
    Comparison {
        shared: area(there.0.min(back.0)),
        absent: area(largest_group(&there.1).max(largest_group(&back.1))),
    }
}

/// How many cells `target` sees as `source` does, and those that `source` holds and `target` looks through.
fn one_way(target: &RobotMap, source: &RobotMap, target_from_source: &Se3) -> (usize, Vec<[i32; 3]>) {
    let look = |own: &Surfel| {
        let point = transformed(target_from_source, own.point);
        let normal = own.normal.map(|n| target_from_source.rotation * Vector3::from(n.map(f64::from)));
        let (free, surface) = views(&target.whole.sights, point, normal);
        let is_absent = free >= VIEWS && free > MAJORITY * surface && !target.settled.is_near(point);
        (surface > free, is_absent.then(|| cell_at(own.point, 1.0 / CELL)))
    };
    let seen: Vec<(bool, Option<[i32; 3]>)> = source.settled.surfels.par_iter().map(look).collect();
    let shared = seen.iter().filter(|(is_shared, _)| *is_shared).count();
    (shared, seen.into_iter().filter_map(|(_, absent)| absent).collect())
}

/// The size of the largest group of cells that hang together.
fn largest_group(cells: &[[i32; 3]]) -> usize {
    let mut table = VoxelTable::default();
    cells.iter().for_each(|&cell| _ = table.get_or_insert(key_of(cell)));
    let width = 2 * BESIDE + 1;
    let mut reached = vec![false; cells.len()];
    let mut largest = 0;
    for start in 0..cells.len() {
        let (mut open, mut size) = (vec![start], 0);
        while let Some(at) = open.pop() {
            if std::mem::replace(&mut reached[at], true) {
                continue;
            }
            size += 1;
            let [x, y, z] = cells[at];
            open.extend((0..width.pow(3)).filter_map(|k| {
                let [dx, dy, dz] = [k % width, k / width % width, k / width.pow(2)].map(|d| d - BESIDE);
                table.get(key_of([x + dx, y + dy, z + dz])).map(|index| index as usize)
            }));
        }
        largest = largest.max(size);
    }
    largest
}

#[cfg(test)]
mod tests {
    use super::super::tests::seen_along;
    use super::super::verdict::bounds;
    use super::*;
    use loopbox_tests::lidar::HALL;
    use nalgebra::Vector6;

    #[test]
    fn what_stands_in_one_map_only_is_absent_and_errors_of_poses_are_not() {
        let (west, east) = (seen_along(&HALL, -9.0, 3.0), seen_along(&HALL, -3.0, 9.0));
        let truth = Se3::new(Default::default(), Vector3::new(6.0, 0.0, 0.0));
        assert!(
            compare(&west, &east, &truth).absent <= bounds::ABSENT,
            "{}",
            compare(&west, &east, &truth).absent
        );
        let tilted = truth * Se3::exp(&Vector6::new(0.03, -0.03, 0.03, 0.0, 0.02, 0.0));
        assert!(
            compare(&west, &east, &tilted).absent <= bounds::ABSENT,
            "{}",
            compare(&west, &east, &tilted).absent
        );
        let without: Vec<_> = HALL.iter().copied().filter(|corners| corners != &HALL[8]).collect();
        let other = compare(&west, &seen_along(&without, -3.0, 9.0), &truth).absent;
        assert!(other > 4.0 * bounds::ABSENT, "{other}");
    }

    #[test]
    fn cells_that_lie_scattered_are_no_thing() {
        let row = |step: i32| -> Vec<[i32; 3]> { (0..20).map(|k| [step * k, -k, 0]).collect() };
        assert_eq!(largest_group(&row(BESIDE)), 20);
        assert_eq!(largest_group(&row(BESIDE + 1)), 1);
        assert_eq!(largest_group(&[]), 0);
    }
}
