//! Places of another map that may be the one of a piece, by Scan Context (Eq. 6–10) between robots.
//!
//! They are taken by rank: the distances of right and wrong places overlap between robots, so the geometry decides.

use super::robot_map::{Piece, RobotMap};
use geometry::Se3;
use nalgebra::{UnitQuaternion, Vector3};

/// Candidates of a piece. More find more and cost a registration each.
const CANDIDATES: usize = 3;
/// Candidates of a piece lie so far apart, metres: nearer ones are within reach of each other's registration.
const APART: f64 = 4.0;

/// Places that are compared under all turns, those whose ring keys are nearest: three times the paper's ten, since between robots distances of right
/// and wrong places overlap.
const NEAREST: usize = 30;

/// Guesses of `a_from_piece`, the most alike first.
pub fn candidates(a: &RobotMap, piece: &Piece, b: &RobotMap) -> Vec<Se3> {
    let context = &b.contexts[piece.keyframe];
    let keys = a.contexts.iter().map(|other| other.key_distance(context)).enumerate();
    let mut nearest: Vec<(usize, f32)> = keys.collect();
    nearest.sort_by(|(i, x), (j, y)| x.total_cmp(y).then(i.cmp(j)));
    nearest.truncate(NEAREST);
    let mut ranked: Vec<_> =
        nearest.into_iter().map(|(i, _)| (i, a.contexts[i].similarity(context))).collect();
    ranked.sort_by(|(i, x), (j, y)| x.distance.total_cmp(&y.distance).then(i.cmp(j)));
    let mut places: Vec<Se3> = Vec::new();
    for (i, like) in ranked {
        let place = a.poses[i];
        if places.iter().all(|p| (p.translation - place.translation).norm() > APART) {
            let turned = UnitQuaternion::from_scaled_axis(Vector3::z() * f64::from(like.yaw));
            places.push(place * Se3::new(turned, Vector3::zeros()));
        }
        if places.len() == CANDIDATES {
            break;
        }
    }
    places
}
