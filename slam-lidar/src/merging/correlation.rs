//! Poses at which walls lie on walls, wherever the maps were seen from.
//!
//! Descriptors of places find what was seen from nearby; a hall is seen from both of its ends. Every two pieces of wall, one of
//! each map, vote for the turn about the vertical that makes them parallel and for the translation that brings them together
//! (the generalised Hough transform, Ballard 1981); peaks are poses at which much coincides. A site that repeats itself has a
//! peak for each repetition, so that rivals of a pose are among them.

use super::robot_map::RobotMap;
use super::walls::TURNS;
use geometry::Se3;
use nalgebra::{UnitQuaternion, Vector2, Vector3};
use std::f64::consts::TAU;

/// Bins of translations, metres, and how far they reach from where the middles meet.
const BIN: f64 = 1.0;
const REACH: f64 = 60.0;
/// Poses that are handed on.
const PEAKS: usize = 40;
/// Peaks lie farther apart than this along an axis, bins, or are turned farther, turns.
const APART: (i32, i32) = (1, 3);

/// Poses `a_from_b` at which most walls coincide, the best first.
pub fn peaks(a: &RobotMap, b: &RobotMap) -> Vec<Se3> {
    let ((middle_a, of_a), (middle_b, of_b)) = (a.walls(), b.walls());
    let side = (2.0 * REACH / BIN) as i32;
    let step = TAU / TURNS as f64;
    let turns: Vec<(f64, f64)> = (0..TURNS).map(|k| (step * k as f64).sin_cos()).collect();
    let mut votes = vec![0.0f32; TURNS * (side * side) as usize];
    for wall in of_b {
        let turned: Vec<Vector2<f64>> = turns
            .iter()
            .map(|(sin, cos)| {
                let p = wall.place;
                Vector2::new(cos * p.x - sin * p.y, sin * p.x + cos * p.y)
            })
            .collect();
        for other in of_a {
            let parallel = ((other.heading - wall.heading) / step).round() as i32;
            for yaw in [-1, 0, 1].into_iter().flat_map(|d| [parallel + d, parallel + d + TURNS as i32 / 2]) {
                let yaw = yaw.rem_euclid(TURNS as i32) as usize;
                let bin = (other.place - turned[yaw]).map(|v| ((v + REACH) / BIN).floor() as i32);
                if bin.x >= 0 && bin.x < side && bin.y >= 0 && bin.y < side {
                    votes[yaw * (side * side) as usize + (bin.y * side + bin.x) as usize] +=
                        wall.weight * other.weight;
                }
            }
        }
    }
    let mut order: Vec<usize> = (0..votes.len()).filter(|&i| votes[i] > 0.0).collect();
    let by_votes = |i: &usize, j: &usize| votes[*j].total_cmp(&votes[*i]).then(i.cmp(j));
    let best = order.len().min(PEAKS * 200);
    if best > 0 && best < order.len() {
        order.select_nth_unstable_by(best - 1, by_votes);
    }
    order.truncate(best);
    order.sort_by(by_votes);
    let mut found: Vec<[i32; 3]> = Vec::new();
    for index in order {
        let (yaw, bin) = (index as i32 / (side * side), index as i32 % (side * side));
        let at = [bin % side, bin / side, yaw];
        let is_same = |other: &[i32; 3]| {
            let turned = (at[2] - other[2]).rem_euclid(TURNS as i32);
            (at[0] - other[0]).abs() <= APART.0
                && (at[1] - other[1]).abs() <= APART.0
                && turned.min(TURNS as i32 - turned) <= APART.1
        };
        if found.len() < PEAKS && !found.iter().any(is_same) {
            found.push(at);
        }
    }
    let pose = |[x, y, yaw]: [i32; 3]| {
        let rotation = UnitQuaternion::from_scaled_axis(Vector3::z() * step * f64::from(yaw));
        let bin = Vector2::new(x, y).map(|v| (f64::from(v) + 0.5) * BIN - REACH) + middle_a;
        let moved = rotation * Vector3::new(middle_b.x, middle_b.y, 0.0);
        Se3::new(rotation, Vector3::new(bin.x, bin.y, 0.0) - moved)
    };
    found.into_iter().map(pose).collect()
}

#[cfg(test)]
mod tests {
    use super::super::tests::seen_along;
    use super::*;
    use loopbox_tests::lidar::HALL;

    #[test]
    fn a_hall_is_recognised_from_its_other_end() {
        let (west, east) = (seen_along(&HALL, -13.0, -7.0), seen_along(&HALL, 7.0, 13.0));
        let found = peaks(&west, &east);
        let right = |pose: &&Se3| {
            (pose.translation - Vector3::new(20.0, 0.0, 0.0)).norm() < 1.5 && pose.rotation.angle() < 0.1
        };
        assert!(found.iter().any(|pose| right(&pose)), "{found:?}");
        assert_eq!(found.len(), PEAKS);
    }

    #[test]
    fn without_walls_nothing_is_proposed() {
        let empty = RobotMap::new(&[]);
        assert!(peaks(&empty, &empty).is_empty());
    }
}
