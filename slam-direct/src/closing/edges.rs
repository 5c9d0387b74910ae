//! The edges that the points of the map make between its keyframes.

use crate::local_map::{LocalMap, PointState, SeenAt};
use crate::track::with_depth_variance;
use crate::window::{mahalanobis, predict, robust_weight};
use geometry::{Se3, Sim3};
use map::{Edge, EdgeKind, KeyframeId};
use nalgebra::{Matrix3, SMatrix, SVector};
use std::collections::{BTreeMap, BTreeSet};

type Matrix7 = SMatrix<f64, 7, 7>;
type Vector7 = SVector<f64, 7>;

/// Relative standard deviation below which no single point fixes the scale between two keyframes.
const MIN_DEPTH_SIGMA: f64 = 0.01;
/// Observations below which a pair of keyframes gets no edge.
const MIN_OBSERVATIONS: usize = 8;
/// Standard deviations of an edge that only keeps the graph in one piece: translation in lengths of the step,
/// turn in radians, logarithm of scale.
const LOOSE: [f64; 3] = [1.0, 0.1, 0.3];

/// What one keyframe's observations of another's points say about their relative pose.
struct Directed {
    observer_from_host: Se3,
    rotation: Matrix3<f64>,
    /// Of the left perturbation of `observer_from_host`, tangent (υ, ω, λ).
    information: Matrix7,
    observations: usize,
}

/// All edges of the map as it stands: successive keyframes, those that share points, closed loops.
pub(crate) fn all(map: &LocalMap, closed: &[Edge]) -> Vec<Edge> {
    since(map, 0, closed)
}

/// The edges that have an end among the keyframes from `first` on.
pub(super) fn since(map: &LocalMap, first: usize, closed: &[Edge]) -> Vec<Edge> {
    let mut edges = covisibility(map, first);
    edges.extend(closed_since(map, first, closed));
    edges
}

/// The same without those that only keep the graph in one piece.
pub(crate) fn measured(map: &LocalMap, first: usize, closed: &[Edge]) -> Vec<Edge> {
    let mut edges = of_shared_points(map, first);
    edges.extend(closed_since(map, first, closed));
    edges
}

fn closed_since(map: &LocalMap, first: usize, closed: &[Edge]) -> impl Iterator<Item = Edge> {
    let closed = closed.iter().filter(move |edge| edge.from.max(edge.to) >= LocalMap::id(first));
    at_their_poses(closed, |id| Some(map.world_from_keyframe(id.0 as usize)))
}

/// Edges at the relative poses that their keyframes have now; without those of no keyframe.
pub(super) fn at_their_poses<'a>(
    edges: impl Iterator<Item = &'a Edge>,
    world_from: impl Fn(KeyframeId) -> Option<Sim3>,
) -> impl Iterator<Item = Edge> {
    edges.filter_map(move |edge| {
        let from_from_to = world_from(edge.from)?.inverse() * world_from(edge.to)?;
        Some(Edge { from_from_to, ..edge.clone() })
    })
}

/// Edges between successive keyframes and between those that see each other's points, from the newer to the
/// older, at the relative pose of the map.
///
/// Each observation counts in the one edge between its host and its observer, so no evidence counts twice: the
/// reprojection Hessian for the six entries of the pose, with the point's depth as uncertain as it is, and the
/// point's relative depth variance, once for either side, for the scale. Of those that have an end among the keyframes from
/// `first` on.
pub(super) fn covisibility(map: &LocalMap, first: usize) -> Vec<Edge> {
    let mut edges = of_shared_points(map, first);
    edges.extend(loose(map, first, &edges));
    edges
}

/// The same without weak ones for keyframes that share no points with an older one.
fn of_shared_points(map: &LocalMap, first: usize) -> Vec<Edge> {
    let seen_later = map.keyframes[first..].iter().flat_map(|state| &state.seen).map(|at| at.host);
    let hosts: BTreeSet<usize> = seen_later.chain(first..map.keyframes.len()).collect();
    let mut directed: BTreeMap<(usize, usize), Directed> = BTreeMap::new();
    for host in hosts {
        for point in map.keyframes[host].points.iter().filter(|p| p.alive) {
            for seen in point.observations.iter().filter(|seen| host.max(seen.keyframe) >= first) {
                let pair = directed
                    .entry((host, seen.keyframe))
                    .or_insert_with(|| Directed::new(map, host, seen.keyframe));
                pair.add(map, point, seen);
            }
        }
    }
    let mut joined: BTreeMap<(usize, usize), (Matrix7, usize)> = BTreeMap::new();
    for (&(host, observer), pair) in &directed {
        let entry = joined.entry((host.max(observer), host.min(observer))).or_insert((Matrix7::zeros(), 0));
        entry.0 += if observer > host { pair.information } else { pair.as_seen_by_host() };
        entry.1 += pair.observations;
    }
    joined
        .into_iter()
        .filter(|(_, (_, observations))| *observations >= MIN_OBSERVATIONS)
        .map(|((newer, older), (information, _))| edge(map, newer, older, information))
        .collect()
}

impl Directed {
    fn new(map: &LocalMap, host: usize, observer: usize) -> Self {
        let observer_from_host = relative(map, observer, host);
        Self {
            observer_from_host,
            rotation: observer_from_host.rotation_matrix(),
            information: Matrix7::zeros(),
            observations: 0,
        }
    }

    fn add(&mut self, map: &LocalMap, point: &PointState, seen: &SeenAt) {
        let translation = &self.observer_from_host.translation;
        let rho = point.inverse_depth;
        let depth = (self.rotation * point.ray + translation * rho).z;
        let pixel = map.undistorted_pixel(seen.keyframe, seen.pixel, rho / depth);
        let Some(p) = predict(&map.camera, &self.rotation, translation, &point.ray, rho, &pixel) else {
            return;
        };
        let measured = seen.information.map(f64::from);
        let weight = robust_weight(mahalanobis(&p.residual, &measured));
        let [a, b, c] =
            with_depth_variance(&measured, &p.by_inverse_depth, point.variance).map(|v| v * weight);
        // A change of scale moves points along their rays: no pixel tells of it.
        let row = |by: [f64; 6]| Vector7::from_fn(|k, _| if k < 6 { by[k] } else { 0.0 });
        let (ju, jv) = (row(p.by_twist[0]), row(p.by_twist[1]));
        self.information.ger(1.0, &(ju * a + jv * b), &ju, 1.0);
        self.information.ger(1.0, &(ju * b + jv * c), &jv, 1.0);
        let x = (self.rotation * point.ray + translation * rho) / rho;
        let inverse_z = 1.0 / x.z;
        // Relative change of the inverse depth by (υ, ω, λ).
        let by = Vector7::from([0.0, 0.0, -inverse_z, -inverse_z * x.y, inverse_z * x.x, 0.0, -1.0]);
        let relative_variance = (point.variance / (rho * rho)).max(MIN_DEPTH_SIGMA * MIN_DEPTH_SIGMA);
        self.information.ger(0.5 * weight / relative_variance, &by, &by, 1.0);
        self.observations += 1;
    }

    /// The same information of the left perturbation of `host_from_observer`: an ε there is −Ad ε here.
    fn as_seen_by_host(&self) -> Matrix7 {
        let adjoint = Sim3::from(self.observer_from_host).adjoint();
        adjoint.transpose() * self.information * adjoint
    }
}

fn relative(map: &LocalMap, from: usize, to: usize) -> Se3 {
    map.keyframes[from].camera_from_world * map.keyframes[to].camera_from_world.inverse()
}

/// An edge with `information` about lengths in world units, brought to the keyframes' units.
fn edge(map: &LocalMap, newer: usize, older: usize, mut information: Matrix7) -> Edge {
    let scale = map.keyframes[newer].scale;
    information.fixed_rows_mut::<3>(0).scale_mut(scale);
    information.fixed_columns_mut::<3>(0).scale_mut(scale);
    Edge {
        from: LocalMap::id(newer),
        to: LocalMap::id(older),
        from_from_to: map.world_from_keyframe(newer).inverse() * map.world_from_keyframe(older),
        information: (information + information.transpose()) * 0.5,
        kind: if newer == older + 1 { EdgeKind::Odometry } else { EdgeKind::Covisibility },
    }
}

/// Weak edges to the keyframe before for those from `first` on that nothing joins with an older one.
pub(crate) fn loose(map: &LocalMap, first: usize, edges: &[Edge]) -> Vec<Edge> {
    let mut joined = vec![false; map.keyframes.len()];
    for edge in edges {
        joined[edge.from.0 as usize] = true;
    }
    let loose = |newer: usize| {
        let step = relative(map, newer, newer - 1).translation.norm().max(1e-3);
        let [translation, rotation_sigma, scale] = LOOSE;
        let sigma = |k| {
            if k < 3 {
                translation * step
            } else if k < 6 {
                rotation_sigma
            } else {
                scale
            }
        };
        let information = Matrix7::from_diagonal(&Vector7::from_fn(|k, _| 1.0 / (sigma(k) * sigma(k))));
        edge(map, newer, newer - 1, information)
    };
    (first.max(1)..map.keyframes.len()).filter(|&k| !joined[k]).map(loose).collect()
}
