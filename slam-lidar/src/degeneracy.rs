//! Which directions of a pose the points leave open (Zhang 2016, per direction as X-ICP does).
//!
//! The information of the points, already divided by how many of them err together, says how well each direction is
//! known. A direction is weak when its standard deviation is worse than a bound in metres or radians, whatever the
//! number of points or the size of the room. Along a weak direction the registration mostly keeps the prediction, which is part
//! of the same system; what stays weak the odometry guesses and says (`odometry::Guess`).

use nalgebra::{Matrix3, Matrix6};

use crate::surfaces::sorted_eigen;
use serde::{Deserialize, Serialize};

/// How well a pose is determined.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Conditioning {
    /// Standard deviation of the translation along its least certain direction, metres.
    pub translation: f64,
    /// That direction, a unit vector in the axes of the world.
    pub weakest: [f64; 3],
    /// Standard deviation of the rotation about its least certain axis, radians.
    pub rotation: f64,
    /// Directions, of six, that are weak.
    pub weak: usize,
}

/// Standard deviation above which a translation is weak, metres: a twentieth of the step of a walking robot between
/// sweeps at 10 Hz would be lost in it.
pub const WEAK_TRANSLATION: f64 = 0.05;
/// Standard deviation above which a rotation is weak, radians: 5 cm at 10 m.
pub const WEAK_ROTATION: f64 = 0.005;

/// Judges the information of points on a pose, tangent (υ, ω).
pub fn conditioning(information: &Matrix6<f64>) -> Conditioning {
    let block = |row: usize, column: usize| information.fixed_view::<3, 3>(row, column).into_owned();
    let (t, coupling, r) = (block(0, 0), block(0, 3), block(3, 3));
    let translation = translations(information);
    let rotation = deviations(&marginal(&r, &coupling.transpose(), &t));
    let weakest = translation.1.column(0);
    let weak = translation.0.iter().filter(|s| **s > WEAK_TRANSLATION).count()
        + rotation.0.iter().filter(|s| **s > WEAK_ROTATION).count();
    Conditioning {
        translation: translation.0[0],
        weakest: [weakest[0], weakest[1], weakest[2]],
        rotation: rotation.0[0],
        weak,
    }
}

/// Standard deviations of the translation once the rotation is free, largest first, metres, and their directions as columns.
pub(crate) fn translations(information: &Matrix6<f64>) -> ([f64; 3], Matrix3<f64>) {
    deviations(&translation_information(information))
}

/// Information on the translation once the rotation is free.
pub(crate) fn translation_information(information: &Matrix6<f64>) -> Matrix3<f64> {
    let block = |row: usize, column: usize| information.fixed_view::<3, 3>(row, column).into_owned();
    marginal(&block(0, 0), &block(0, 3), &block(3, 3))
}

/// Information on one block once the other is free: the Schur complement. What the other block does not know at all
/// carries nothing over.
fn marginal(own: &Matrix3<f64>, coupling: &Matrix3<f64>, other: &Matrix3<f64>) -> Matrix3<f64> {
    let inverse = other.pseudo_inverse(1e-9 * other.amax().max(1e-300)).unwrap_or_else(|_| Matrix3::zeros());
    own - coupling * inverse * coupling.transpose()
}

/// Standard deviations, largest first, and their directions as columns.
fn deviations(information: &Matrix3<f64>) -> ([f64; 3], Matrix3<f64>) {
    let (values, vectors) = sorted_eigen((information + information.transpose()) * 0.5);
    (values.map(|v| v.max(1e-12).powf(-0.5)), vectors)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::registration::plane_row;
    use nalgebra::Vector6;

    /// Information of points on the walls, floor and ceiling of a room that is `open` along x or not.
    fn room(open: bool) -> Matrix6<f64> {
        let mut information = Matrix6::zeros();
        let mut add = |point: [f64; 3], normal: [f64; 3]| {
            let row = Vector6::from(plane_row(point, [0.0; 3], normal));
            information += row * row.transpose() / (0.02f64.powi(2) * 10.0);
        };
        for i in -20..=20 {
            for j in -3..=3 {
                let (a, b) = (f64::from(i) * 0.5, f64::from(j) * 0.4);
                add([a, 2.0, b], [0.0, 1.0, 0.0]);
                add([a, -2.0, b], [0.0, 1.0, 0.0]);
                add([a, b, -1.0], [0.0, 0.0, 1.0]);
                if !open {
                    add([10.0, b, 0.3 * b], [1.0, 0.0, 0.0]);
                }
            }
        }
        information
    }

    #[test]
    fn a_corridor_is_weak_along_its_axis_only() {
        let found = conditioning(&room(true));
        assert_eq!(found.weak, 1, "{found:?}");
        assert!(found.weakest[0].abs() > 0.999 && found.translation > 1.0, "{found:?}");
        assert_eq!(conditioning(&room(false)).weak, 0);
    }
}
