//! A-LOAM's first step: a sweep's features against those of the sweep before, its motion inside the iterations (LOAM,
//! Zhang and Singh, RSS 2014, §V; correspondences as in its public code).
//!
//! LOAM holds the begin of a sweep at the end of the one before. What a sweep sees in its first quarter then says four times
//! as much of its end, and an error of the last displacement comes back up to three times as large and with the other sign:
//! a sensor with few rings, to which only that side tells its roll, swings itself off the ground. Here the twist is constant
//! from the *middle* of the last sweep on, the instant that it determines best, and what comes back is a third.

use crate::feature_step::{ROUNDS, STEPS, Target, place, step};
use crate::features::{Feature, Features};
use crate::motion::{MotionTable, Sweep, SweepMotion};
use crate::point_grid::PointGrid;
use crate::registration::moved;
use geometry::Se3;
use nalgebra::Vector3;

/// Rings on either side among which a feature's second line or plane point is looked for.
const RINGS: u16 = 2;

/// Features of a sweep in the world, for the next sweep.
#[derive(Clone, Debug)]
pub(crate) struct LastFeatures {
    motion: SweepMotion,
    edges: PointGrid,
    planes: PointGrid,
}

impl LastFeatures {
    /// The features of a sweep that moved so.
    pub fn of(sweep: &Sweep, found: &Features, motion: &SweepMotion) -> Self {
        let table = MotionTable::new(motion, &Se3::identity());
        let (mut edges, mut planes) = (PointGrid::new(0.0), PointGrid::new(0.0));
        let ring = |f: &Feature| sweep.rings[f.point as usize];
        found.edges.iter().for_each(|f| edges.insert(place(sweep, f, &table), ring(f)));
        found.planes.iter().for_each(|f| planes.insert(place(sweep, f, &table), ring(f)));
        Self { motion: *motion, edges, planes }
    }

    /// The motion of the next sweep: the twist is constant from the middle of the last one on.
    pub fn follow(&self, sweep: &Sweep, found: &Features) -> SweepMotion {
        // What is estimated is the motion since then, three halves of a sweep.
        let share = |s: &f32| (s + 0.5) / 1.5;
        let sweep = Sweep { shares: sweep.shares.iter().map(share).collect(), ..sweep.clone() };
        let twist = self.motion.displacement().log();
        let middle = self.motion.middle();
        let mut motion = SweepMotion { begin: middle, end: middle * Se3::exp(&(twist * 1.5)) };
        for _ in 0..ROUNDS {
            let table = MotionTable::new(&motion, &Se3::identity());
            let target = |f: &Feature, local: Option<Local>| {
                local.map(|(point, normals, count)| Target {
                    feature: f.point,
                    point,
                    normals,
                    count,
                    weight: 1.0,
                })
            };
            let edges = found
                .edges
                .iter()
                .filter_map(|f| target(f, across_rings(&self.edges, place(&sweep, f, &table), false)));
            let planes = found
                .planes
                .iter()
                .filter_map(|f| target(f, across_rings(&self.planes, place(&sweep, f, &table), true)));
            let targets: Vec<Target> = edges.chain(planes).collect();
            for _ in 0..STEPS {
                let Some((delta, _)) = step(&sweep, &targets, &motion, false) else { break };
                motion.end = moved(&motion.end, &motion.middle().translation, &delta);
            }
        }
        SweepMotion { begin: motion.at(1.0 / 3.0), end: motion.end }
    }
}

type Local = ([f32; 3], [[f32; 3]; 2], usize);

/// The line through the two nearest points of different rings, or the plane through a third of the first's ring.
fn across_rings(grid: &PointGrid, query: [f32; 3], plane: bool) -> Option<Local> {
    let mut nearest: Option<([f32; 3], u16, f32)> = None;
    grid.around(query, |p, ring, d| {
        if d < 1.0 && nearest.is_none_or(|(_, _, least)| d < least) {
            nearest = Some((p, ring, d));
        }
    });
    let (a, ring, _) = nearest?;
    let (mut other, mut same) = (None::<([f32; 3], f32)>, None::<([f32; 3], f32)>);
    grid.around(query, |p, r, d| {
        let slot = if r == ring { &mut same } else { &mut other };
        if p != a && d < 4.0 && r.abs_diff(ring) <= RINGS && slot.is_none_or(|(_, least)| d < least) {
            *slot = Some((p, d));
        }
    });
    let v = |p: [f32; 3]| Vector3::new(f64::from(p[0]), f64::from(p[1]), f64::from(p[2]));
    let f = |n: Vector3<f64>| [n.x as f32, n.y as f32, n.z as f32];
    let along = (v(other?.0) - v(a)).try_normalize(1e-3)?;
    if plane {
        let normal = along.cross(&(v(same?.0) - v(a))).try_normalize(1e-3)?;
        return Some((a, [f(normal); 2], 1));
    }
    let first = along
        .cross(&(v(query) - v(a)))
        .try_normalize(1e-9)
        .or_else(|| along.cross(&Vector3::x()).try_normalize(1e-3))?;
    Some((a, [f(first), f(along.cross(&first))], 2))
}
