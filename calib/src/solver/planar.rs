//! Homographies of flat boards, and the poses they stand for.

use geometry::Se3;
use nalgebra::{Matrix3, Rotation3, SMatrix, UnitQuaternion, Vector2, Vector3};

/// Fewest corners that a homography is made from.
pub(crate) const MIN_CORNERS: usize = 6;

/// The homography that takes each first point to its second, in the least-squares sense (normalised direct linear
/// transform, Hartley & Zisserman, Algorithm 4.2); `None` for fewer than four pairs, or points along a line.
pub fn homography(pairs: &[(Vector2<f64>, Vector2<f64>)]) -> Option<Matrix3<f64>> {
    if pairs.len() < 4 {
        return None;
    }
    let from = normalisation(pairs.iter().map(|pair| pair.0))?;
    let to = normalisation(pairs.iter().map(|pair| pair.1))?;
    let mut normal = SMatrix::<f64, 9, 9>::zeros();
    for (a, b) in pairs {
        let (p, q) = (from * a.push(1.0), to * b.push(1.0));
        let mut rows = SMatrix::<f64, 2, 9>::zeros();
        for i in 0..3 {
            rows[(0, i)] = p[i];
            rows[(0, 6 + i)] = -q.x * p[i];
            rows[(1, 3 + i)] = p[i];
            rows[(1, 6 + i)] = -q.y * p[i];
        }
        normal += rows.transpose() * rows;
    }
    let eigen = normal.symmetric_eigen();
    let mut order: Vec<usize> = (0..9).collect();
    order.sort_by(|&i, &j| eigen.eigenvalues[i].total_cmp(&eigen.eigenvalues[j]));
    // A second vanishing eigenvalue: many homographies do.
    if eigen.eigenvalues[order[1]] < 1e-9 * eigen.eigenvalues[order[8]] {
        return None;
    }
    let h = eigen.eigenvectors.column(order[0]);
    let h = Matrix3::new(h[0], h[1], h[2], h[3], h[4], h[5], h[6], h[7], h[8]);
    let h = to.try_inverse()? * h * from;
    h.iter().all(|v| v.is_finite()).then_some(h)
}

/// Where a homography takes a point.
pub fn mapped(homography: &Matrix3<f64>, point: &Vector2<f64>) -> Vector2<f64> {
    let p = homography * point.push(1.0);
    p.xy() / p.z
}

/// Moves the centre to the origin and the mean distance to √2.
fn normalisation(points: impl Iterator<Item = Vector2<f64>> + Clone) -> Option<Matrix3<f64>> {
    let n = points.clone().count() as f64;
    let centre = points.clone().sum::<Vector2<f64>>() / n;
    let distance = points.map(|p| (p - centre).norm()).sum::<f64>() / n;
    let s = std::f64::consts::SQRT_2 / distance;
    s.is_finite().then(|| Matrix3::new(s, 0.0, -s * centre.x, 0.0, s, -s * centre.y, 0.0, 0.0, 1.0))
}

/// The pose camera_from_board of a homography from the board's plane to the plane z = 1 before the camera
/// (Zhang 2000, §3.1); `None` when there is none.
pub fn pose(homography: &Matrix3<f64>) -> Option<Se3> {
    let scale = 2.0 / (homography.column(0).norm() + homography.column(1).norm());
    let scale = if homography[(2, 2)] < 0.0 { -scale } else { scale };
    let h = homography * scale;
    let (x, y) = (h.column(0).into_owned(), h.column(1).into_owned());
    let rough = Matrix3::from_columns(&[x, y, x.cross(&y)]);
    let svd = rough.svd(true, true);
    let rotation = svd.u? * svd.v_t?;
    let translation: Vector3<f64> = h.column(2).into();
    let usable =
        rotation.iter().all(|v| v.is_finite()) && rotation.determinant() > 0.0 && translation.z > 0.0;
    usable.then(|| {
        let rotation = Rotation3::from_matrix_unchecked(rotation);
        Se3::new(UnitQuaternion::from_rotation_matrix(&rotation), translation)
    })
}

/// Focal lengths from homographies of the board's plane to pixels, the principal point being `centre`
/// (Zhang 2000, Eq. 3 and 4, with two unknowns); `None` when they do not determine positive ones.
pub(crate) fn focal_lengths(homographies: &[Matrix3<f64>], centre: Vector2<f64>) -> Option<(f64, f64)> {
    let shift = Matrix3::new(1.0, 0.0, -centre.x, 0.0, 1.0, -centre.y, 0.0, 0.0, 1.0);
    let (mut normal, mut right) = (nalgebra::Matrix2::zeros(), Vector2::zeros());
    for homography in homographies {
        let h = shift * homography;
        let (a, b): (Vector3<f64>, Vector3<f64>) = (h.column(0).into(), h.column(1).into());
        // The axes are at right angles; so are their sum and difference, as they are of one length.
        for (p, q) in [(a, b), (a + b, a - b)] {
            let (p, q) = (p.normalize(), q.normalize());
            let row = Vector2::new(p.x * q.x, p.y * q.y);
            normal += row * row.transpose();
            right -= row * (p.z * q.z);
        }
    }
    let inverse_squares = normal.try_inverse()? * right;
    let focal = inverse_squares.map(|v| 1.0 / v.sqrt());
    focal.iter().all(|f| f.is_finite()).then_some((focal.x, focal.y))
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector6;

    #[test]
    fn a_pose_is_found_again() {
        let pose_true = Se3::exp(&Vector6::new(-0.1, -0.2, 0.9, 0.3, -0.4, 0.1));
        let points = (0..12).map(|i| Vector2::new((i % 4) as f64 * 0.1, (i / 4) as f64 * 0.1));
        let pairs: Vec<_> = points
            .map(|p| {
                let q = pose_true * p.push(0.0);
                (p, q.xy() / q.z)
            })
            .collect();
        let found = pose(&homography(&pairs).unwrap()).unwrap();
        assert!((found.inverse() * pose_true).log().norm() < 1e-9);
        assert!(homography(&pairs[..4]).is_none(), "a row of corners has no homography");
    }

    #[test]
    fn focal_lengths_follow_from_views() {
        let k = Matrix3::new(500.0, 0.0, 320.0, 0.0, 480.0, 240.0, 0.0, 0.0, 1.0);
        let turns = [[0.4, 0.1, 0.0], [-0.3, 0.4, 0.2], [0.1, -0.5, 1.0]];
        let views: Vec<_> = turns
            .iter()
            .map(|&[a, b, c]| {
                let r = Se3::exp(&Vector6::new(0.0, 0.0, 0.0, a, b, c)).rotation_matrix();
                k * Matrix3::from_columns(&[r.column(0), r.column(1), Vector3::new(0.1, 0.0, 1.0).column(0)])
            })
            .collect();
        let (fx, fy) = focal_lengths(&views, Vector2::new(320.0, 240.0)).unwrap();
        assert!((fx - 500.0).abs() < 1e-6 && (fy - 480.0).abs() < 1e-6, "{fx} {fy}");
    }
}
