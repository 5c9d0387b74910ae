//! More than two maps in one frame: the merges of a maximum spanning tree for the start, all of them for the result.
//!
//! The graph of merges of camera maps carries similarities, whose scale would have to be told here to be known; maps
//! of LiDARs have none, so theirs is a plain one of rigid motions.

use geometry::Se3;
use nalgebra::{DMatrix, DVector, Vector6};

/// An accepted merge.
#[derive(Clone, Copy, Debug)]
pub struct Merge {
    /// The one map, by index.
    pub from: usize,
    /// The other map.
    pub to: usize,
    /// `from_from_to`.
    pub from_from_to: Se3,
    /// How far it is trusted against other merges.
    pub trust: f64,
}

/// Where maps lie.
#[derive(Clone, Debug)]
pub struct Joined {
    /// The map whose frame each is in: the first of those that hang together.
    pub root: Vec<usize>,
    /// `root_from_map` of each.
    pub root_from_map: Vec<Se3>,
    /// Merges of the spanning tree, by index, in the order in which they were taken.
    pub tree: Vec<usize>,
    /// Each merge's weight in the result, 0–1: one that the others contradict ends near 0.
    pub weights: Vec<f64>,
}

/// What a merge errs by, standard deviation in metres and radians: odometry's drift over the maps.
const DEVIATION: (f64, f64) = (0.02, 0.002);
/// Rounds of linearisation and of weights.
const ROUNDS: usize = 8;
/// Width of the robust kernel (Geman–McClure) on a merge's residual, standard deviations; wider at first.
const KERNEL: f64 = 5.0;

/// Joins `count` maps by merges between them; merges of maps out of range or of one map with itself do not count.
pub fn joined(count: usize, merges: &[Merge]) -> Joined {
    let (root, mut poses, tree) = spanning_tree(count, merges);
    let mut weights = vec![1.0; merges.len()];
    let usable: Vec<usize> = (0..merges.len()).filter(|&i| usable(count, &merges[i])).collect();
    for round in 0..ROUNDS {
        let Some(step) = solve(&root, &poses, merges, &usable, &weights) else { break };
        for (map, pose) in poses.iter_mut().enumerate() {
            let delta: Vector6<f64> = step.fixed_rows::<6>(6 * map).into_owned();
            *pose = (Se3::exp(&delta) * *pose).renormalized();
        }
        let width = KERNEL * f64::max(1.0, 64.0 * 0.25f64.powi(round as i32));
        for &i in &usable {
            let squared = residual(&poses, &merges[i]).component_mul(&precision()).norm_squared();
            weights[i] = (width * width / (width * width + squared)).powi(2);
        }
    }
    Joined { root, root_from_map: poses, tree, weights }
}

fn usable(count: usize, merge: &Merge) -> bool {
    merge.from < count && merge.to < count && merge.from != merge.to && merge.from_from_to.is_finite()
}

/// Kruskal's tree of most trust; of equals the merge that comes first.
fn spanning_tree(count: usize, merges: &[Merge]) -> (Vec<usize>, Vec<Se3>, Vec<usize>) {
    let mut order: Vec<usize> = (0..merges.len()).filter(|&i| usable(count, &merges[i])).collect();
    order.sort_by(|&i, &j| merges[j].trust.total_cmp(&merges[i].trust).then(i.cmp(&j)));
    let mut root: Vec<usize> = (0..count).collect();
    let mut poses = vec![Se3::identity(); count];
    let mut tree = Vec::new();
    for i in order {
        let merge = &merges[i];
        let (mut near, mut far, mut near_from_far) = (merge.from, merge.to, merge.from_from_to);
        if root[near] == root[far] {
            continue;
        }
        if root[far] < root[near] {
            (near, far, near_from_far) = (far, near, near_from_far.inverse());
        }
        let carried = poses[near] * near_from_far * poses[far].inverse();
        let (kept, given_up) = (root[near], root[far]);
        for map in (0..count).filter(|&map| root[map] == given_up).collect::<Vec<_>>() {
            poses[map] = carried * poses[map];
            root[map] = kept;
        }
        tree.push(i);
    }
    (root, poses, tree)
}

/// One over the standard deviations.
fn precision() -> Vector6<f64> {
    let (t, r) = (1.0 / DEVIATION.0, 1.0 / DEVIATION.1);
    Vector6::new(t, t, t, r, r, r)
}

fn residual(poses: &[Se3], merge: &Merge) -> Vector6<f64> {
    (merge.from_from_to.inverse() * poses[merge.from].inverse() * poses[merge.to]).log()
}

/// A Gauss–Newton step of all poses but the roots', left increments.
fn solve(
    root: &[usize],
    poses: &[Se3],
    merges: &[Merge],
    used: &[usize],
    weights: &[f64],
) -> Option<DVector<f64>> {
    let n = poses.len();
    let (mut h, mut g) = (DMatrix::<f64>::identity(6 * n, 6 * n) * 1e-9, DVector::zeros(6 * n));
    for (map, _) in root.iter().enumerate().filter(|(map, root)| map == *root) {
        (6 * map..6 * map + 6).for_each(|i| h[(i, i)] += 1e12);
    }
    let information = precision().component_mul(&precision());
    for &i in used {
        let merge = &merges[i];
        // r(exp(δ) T) = r + Ad(T_to⁻¹) (δ_to − δ_from), to first order.
        let jacobian = poses[merge.to].inverse().adjoint();
        let weighted = jacobian.transpose() * nalgebra::Matrix6::from_diagonal(&(information * weights[i]));
        let (block, slope) = (weighted * jacobian, weighted * residual(poses, merge));
        for (row, sign) in [(merge.from, -1.0), (merge.to, 1.0)] {
            let mut part = g.fixed_rows_mut::<6>(6 * row);
            part += slope * sign;
            for (column, other) in [(merge.from, -1.0), (merge.to, 1.0)] {
                let mut part = h.fixed_view_mut::<6, 6>(6 * row, 6 * column);
                part += block * (sign * other);
            }
        }
    }
    Some(-h.cholesky()?.solve(&g))
}
