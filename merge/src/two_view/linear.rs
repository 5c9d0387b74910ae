//! Essential matrix and homography from the fewest matches, and what poses they stand for.

use super::rays::Rays;
use nalgebra::{Matrix3, Rotation3, SymmetricEigen, UnitQuaternion, Vector3};

/// A candidate for `p_t = R p_s + t`, t known up to its length.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Pose {
    /// R.
    pub(super) rotation: Matrix3<f64>,
    /// t̂, unit.
    pub(super) direction: Vector3<f64>,
}

impl Pose {
    /// E = [t̂]× R, with `f_tᵀ E f_s = 0`.
    pub(super) fn essential(&self) -> Matrix3<f64> {
        self.direction.cross_matrix() * self.rotation
    }

    /// R as a unit quaternion.
    pub(super) fn quaternion(&self) -> UnitQuaternion<f64> {
        UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(self.rotation))
    }
}

/// A pose with the plane that a homography `R + m nᵀ` stands for.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct PlanePose {
    /// R.
    pub(super) rotation: Matrix3<f64>,
    /// m = t / d, d the plane's distance from the source camera.
    pub(super) shift: Vector3<f64>,
    /// n: unit normal in the source's frame, away from the camera.
    pub(super) normal: Vector3<f64>,
}

impl PlanePose {
    /// H = R + m nᵀ, with `f_t ~ H f_s`.
    pub(super) fn homography(&self) -> Matrix3<f64> {
        self.rotation + self.shift * self.normal.transpose()
    }

    /// The pose without the plane; nothing where there is no translation.
    pub(super) fn pose(&self) -> Option<Pose> {
        let direction = self.shift.try_normalize(1e-9)?;
        Some(Pose { rotation: self.rotation, direction })
    }
}

/// The vector that eight rows of nine are orthogonal to, by elimination with full pivoting; nothing where the
/// rows leave more than one.
fn null_vector(mut rows: [[f64; 9]; 8]) -> Option<[f64; 9]> {
    let mut columns: [usize; 9] = std::array::from_fn(|i| i);
    for step in 0..8 {
        let (mut row, mut column, mut largest) = (step, step, 0.0);
        for (r, candidates) in rows.iter().enumerate().skip(step) {
            for (c, value) in candidates.iter().enumerate().skip(step) {
                if value.abs() > largest {
                    (row, column, largest) = (r, c, value.abs());
                }
            }
        }
        // Whitened rays are of size one: below this the sample says nothing.
        let clear = largest > 1e-9;
        if !clear {
            return None;
        }
        rows.swap(step, row);
        columns.swap(step, column);
        rows.iter_mut().for_each(|row| row.swap(step, column));
        let pivot = rows[step];
        for row in rows.iter_mut().skip(step + 1) {
            let factor = row[step] / pivot[step];
            for (value, above) in row.iter_mut().zip(&pivot).skip(step + 1) {
                *value -= factor * above;
            }
        }
    }
    let mut ordered = [0.0; 9];
    ordered[8] = 1.0;
    for step in (0..8).rev() {
        let sum: f64 = (step + 1..9).map(|c| rows[step][c] * ordered[c]).sum();
        ordered[step] = -sum / rows[step][step];
    }
    let mut vector = [0.0; 9];
    for (value, column) in ordered.into_iter().zip(columns) {
        vector[column] = value;
    }
    Some(vector)
}

/// The normalised eight-point algorithm on rays (Longuet-Higgins 1981, Hartley 1997): E of eight matches, with
/// singular values 1, 1, 0.
pub(super) fn eight_point(rays: &Rays, sample: &[usize; 8]) -> Option<Matrix3<f64>> {
    let rows = sample.map(|i| {
        let (s, t) = (rays.source_whitening * rays.source[i], rays.target_whitening * rays.target[i]);
        [t.x * s.x, t.x * s.y, t.x * s.z, t.y * s.x, t.y * s.y, t.y * s.z, t.z * s.x, t.z * s.y, t.z * s.z]
    });
    let whitened = Matrix3::from_row_slice(&null_vector(rows)?);
    let svd = (rays.target_whitening.transpose() * whitened * rays.source_whitening).svd(true, true);
    let (u, v) = (svd.u?, svd.v_t?);
    let flat = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, 0.0));
    Some(u * flat * v)
}

/// The four poses an essential matrix stands for (Hartley & Zisserman, Result 9.19).
pub(super) fn essential_poses(essential: &Matrix3<f64>) -> Option<[Pose; 4]> {
    let svd = essential.svd(true, true);
    let (mut u, mut v) = (svd.u?, svd.v_t?);
    if u.determinant() < 0.0 {
        u.neg_mut();
    }
    if v.determinant() < 0.0 {
        v.neg_mut();
    }
    let rotation_step = Matrix3::new(0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0);
    let rotations = [u * rotation_step * v, u * rotation_step.transpose() * v];
    let direction = u.column(2).into_owned();
    let pose = |r: usize, sign: f64| Pose { rotation: rotations[r], direction: direction * sign };
    Some([pose(0, 1.0), pose(0, -1.0), pose(1, 1.0), pose(1, -1.0)])
}

/// The homography of four matches, `f_t ~ H f_s`, with middle singular value 1 and all four matches in front.
pub(super) fn four_point(rays: &Rays, sample: &[usize; 4]) -> Option<Matrix3<f64>> {
    let mut rows = [[0.0; 9]; 8];
    for (pair, &i) in rows.chunks_exact_mut(2).zip(sample) {
        let s = rays.source_whitening * rays.source[i];
        for (row, across) in pair.iter_mut().zip(rays.target_basis[i].column_iter()) {
            for (k, value) in row.iter_mut().enumerate() {
                *value = across[k / 3] * s[k % 3];
            }
        }
    }
    let homography = Matrix3::from_row_slice(&null_vector(rows)?) * rays.source_whitening;
    let homography = of_unit_scale(homography)?;
    let in_front = |i: &usize| rays.target[*i].dot(&(homography * rays.source[*i])) > 0.0;
    match sample.iter().filter(|i| in_front(i)).count() {
        4 => Some(homography),
        0 => Some(-homography),
        // The plane would pass between the points and a camera.
        _ => None,
    }
}

/// Scales a homography so that its middle singular value is 1.
fn of_unit_scale(homography: Matrix3<f64>) -> Option<Matrix3<f64>> {
    let mut squares = homography.tr_mul(&homography).symmetric_eigenvalues();
    squares.as_mut_slice().sort_by(f64::total_cmp);
    let scale = squares[1].max(0.0).sqrt();
    scale.is_normal().then(|| homography / scale)
}

/// The two poses with plane in front of the source camera that a homography of unit scale stands for (Ma, Soatto,
/// Košecká & Sastry, "An Invitation to 3-D Vision", §5.3.3). `ahead` is any ray that sees the plane.
///
/// Without translation there is none.
pub(super) fn decompose(homography: &Matrix3<f64>, ahead: &Vector3<f64>) -> Option<[PlanePose; 2]> {
    let eigen = SymmetricEigen::new(homography.tr_mul(homography));
    let mut order = [0, 1, 2];
    order.sort_by(|&a, &b| eigen.eigenvalues[b].total_cmp(&eigen.eigenvalues[a]));
    let [large, middle, small] = order.map(|i| eigen.eigenvalues[i]);
    let [v1, v2, v3] = order.map(|i| eigen.eigenvectors.column(i).into_owned());
    let (above, below) = ((large / middle - 1.0).max(0.0), (1.0 - small / middle).max(0.0));
    let spread = (above + below).sqrt();
    let clear = spread > 1e-9;
    if !clear {
        return None;
    }
    let homography = homography / middle.sqrt();
    Some([1.0, -1.0].map(|sign| {
        // Two directions that the homography does not stretch span the plane through the camera that is
        // parallel to the seen one.
        let in_plane = (v1 * below.sqrt() + v3 * (sign * above.sqrt())) / spread;
        let normal = v2.cross(&in_plane);
        let from = Matrix3::from_columns(&[v2, in_plane, normal]);
        let (first, second) = (homography * v2, homography * in_plane);
        let rotation = Matrix3::from_columns(&[first, second, first.cross(&second)]) * from.transpose();
        let sign = if normal.dot(ahead) < 0.0 { -1.0 } else { 1.0 };
        let normal = normal * sign;
        PlanePose { rotation, shift: (homography - rotation) * normal, normal }
    }))
}

/// The rotation nearest to a matrix.
pub(super) fn nearest_rotation(matrix: &Matrix3<f64>) -> Option<Matrix3<f64>> {
    let svd = matrix.svd(true, true);
    let (u, v) = (svd.u?, svd.v_t?);
    let handed = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, (u * v).determinant().signum()));
    Some(u * handed * v)
}
