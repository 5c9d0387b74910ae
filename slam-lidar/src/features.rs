//! Edges and planes of a scan by local smoothness (Eq. 1).
//!
//! `α = ‖Σ (p_j − p_i)‖ / (n ‖p_i‖)` over five neighbours a side on the same ring. Of each sixth of a ring the
//! roughest points are edges and the smoothest are planes. Points whose neighbourhood is torn (an occlusion, a gap) or
//! seen at a grazing angle are neither, as in LOAM (Zhang and Singh, RSS 2014).

use crate::motion::Sweep;

/// Neighbours a side.
const SIDE: usize = 5;
/// Parts of a ring that are asked for features of their own.
const SECTORS: usize = 6;
/// Most edges of a sector.
const EDGES: usize = 20;
/// Least smoothness of an edge and most of a plane. LOAM's public code separates at 0.1 m² of the squared sum over ten
/// neighbours; this is the same at 10 m, √0.1 / (10 · 10), and does not change with the range.
const EDGE: f32 = 0.0032;
/// Largest smoothness of a plane.
const PLANE: f32 = EDGE;
/// Neighbours farther apart than this share of the range are torn.
const TORN: f32 = 0.05;

/// A feature: a point of the sweep and its smoothness.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Feature {
    /// Index into the sweep.
    pub point: u32,
    /// Its smoothness α.
    pub smoothness: f32,
}

/// Edges and planes of a sweep.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Features {
    /// Points on edges.
    pub edges: Vec<Feature>,
    /// Points on planes.
    pub planes: Vec<Feature>,
}

/// The features of a sweep whose points know their rings; none without rings.
pub fn features(sweep: &Sweep) -> Features {
    let mut found = Features::default();
    let Some(most) = sweep.rings.iter().max() else { return found };
    let mut rings: Vec<Vec<u32>> = vec![Vec::new(); *most as usize + 1];
    for (i, &ring) in sweep.rings.iter().enumerate() {
        rings[ring as usize].push(i as u32);
    }
    for ring in &rings {
        if ring.len() <= 2 * SIDE + SECTORS {
            continue;
        }
        let smoothness: Vec<Option<f32>> = (0..ring.len()).map(|i| smoothness(sweep, ring, i)).collect();
        let inner = ring.len() - 2 * SIDE;
        for sector in 0..SECTORS {
            let bound = |k: usize| SIDE + inner * k / SECTORS;
            select(ring, &smoothness, bound(sector)..bound(sector + 1), &mut found);
        }
    }
    found
}

/// α of a ring's point, none at the ring's ends and where its surface cannot be trusted.
fn smoothness(sweep: &Sweep, ring: &[u32], i: usize) -> Option<f32> {
    if i < SIDE || i + SIDE >= ring.len() {
        return None;
    }
    let point = |k: usize| sweep.points[ring[k] as usize];
    let centre = point(i);
    let range = norm(centre);
    let mut sum = [0.0f32; 3];
    for k in (i - SIDE..=i + SIDE).filter(|&k| k != i) {
        let p = point(k);
        (0..3).for_each(|a| sum[a] += p[a] - centre[a]);
        let next = point(if k < i { k + 1 } else { k - 1 });
        if norm([p[0] - next[0], p[1] - next[1], p[2] - next[2]]) > TORN * range {
            return None;
        }
    }
    Some(norm(sum) / (2.0 * SIDE as f32 * range))
}

fn norm(v: [f32; 3]) -> f32 {
    (v[0] * v[0] + v[1] * v[1] + v[2] * v[2]).sqrt()
}

fn select(ring: &[u32], smoothness: &[Option<f32>], sector: std::ops::Range<usize>, found: &mut Features) {
    let mut order: Vec<(f32, usize)> = sector.filter_map(|i| smoothness[i].map(|s| (s, i))).collect();
    order.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    let mut taken: Vec<usize> = Vec::new();
    for &(smoothness, i) in order.iter().rev() {
        if smoothness < EDGE || taken.len() == EDGES {
            break;
        }
        // An edge's neighbours are as rough as itself.
        if taken.iter().all(|&t| t.abs_diff(i) > SIDE) {
            taken.push(i);
            found.edges.push(Feature { point: ring[i], smoothness });
        }
    }
    let flat = order.iter().take_while(|(smoothness, _)| *smoothness < PLANE);
    // Every other one: neighbours tell the same.
    found.planes.extend(flat.step_by(2).map(|&(smoothness, i)| Feature { point: ring[i], smoothness }));
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A ring in a square room: four walls, four corners.
    #[test]
    fn corners_are_edges_and_walls_are_planes() {
        let mut sweep = Sweep::default();
        for i in 0..1800 {
            let azimuth = -(i as f32 + 0.5) * std::f32::consts::TAU / 1800.0;
            let (x, y) = (azimuth.cos(), azimuth.sin());
            let range = 5.0 / x.abs().max(y.abs());
            sweep.points.push([x * range, y * range, 0.2]);
            sweep.shares.push(0.5);
            sweep.rings.push(0);
        }
        let found = features(&sweep);
        // Points lie 3.5 cm apart there: an edge is within two of the corner, and no plane is.
        let is_corner = |p: [f32; 3]| p[0].abs() > 4.93 && p[1].abs() > 4.93;
        assert!(found.edges.iter().all(|f| is_corner(sweep.points[f.point as usize])), "{:?}", found.edges);
        assert_eq!(found.edges.len(), 4, "{:?}", found.edges);
        assert!(found.planes.len() > 400);
        assert!(found.planes.iter().all(|f| !is_corner(sweep.points[f.point as usize])));
    }
}
