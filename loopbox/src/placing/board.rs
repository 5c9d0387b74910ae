//! The unit of a map by a board of known size that its keyframes show.
//!
//! The board stands still in the map's world, so one similarity world_from_board explains all its corners in all keyframes;
//! what is large or near and what is small or far differ in parallax only, so the camera must have moved. The
//! similarity is found by least squares on the corners' pixels, the keyframes' poses being as they are in the map
//! (Hartley & Zisserman, Multiple View Geometry, §18.1, with one rigid object for points), begun from the board's pose in
//! single keyframes (Zhang 2000, §3.1).

use anyhow::{Result, bail, ensure};
use backend::Descent;
use calib::planar::{homography, pose};
use calib::{Board, Corner};
use geometry::{Pinhole, Se3};
use nalgebra::{DMatrix, DVector, SMatrix, SVector, UnitQuaternion, Vector2, Vector3};
use std::f64::consts::FRAC_PI_2;
use std::fmt;

/// Fewest keyframes that must show the board: with two nothing tells how far they agree.
const MIN_VIEWS: usize = 3;
/// Fewest corners of a view.
const MIN_CORNERS: usize = 4;
/// Views that the search is begun from.
const STARTS: usize = 12;
const DESCENT: Descent = Descent {
    iterations: 50,
    min_decrease: 1e-10,
    damping: 1e-4,
    eased: (0.2, 1e-12),
    raised: (10.0, 0.0),
    most: 1e9,
};
/// Residuals beyond this count linearly, pixels.
const HUBER: f64 = 1.0;
/// Groups of views that are left out in turn to see how well the scale is known.
const GROUPS: usize = 10;
/// A scale that is known worse than this is refused.
const MAX_DEVIATION: f64 = 0.03;
/// Corners may be off by this share of the distance between neighbours; beyond, it is another board, or the map is bent.
const MAX_MISFIT: f64 = 0.15;

/// The corners of the board that a keyframe shows.
#[derive(Clone, Debug)]
pub struct Sighting {
    /// Where its camera is, in the map's world and unit.
    pub world_from_camera: Se3,
    /// The camera of its undistorted image.
    pub camera: Pinhole,
    /// The corners, each number at most once.
    pub corners: Vec<Corner>,
}

/// A map's unit as a board tells it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BoardScale {
    /// Metres of a map unit.
    pub metres: f64,
    /// Standard deviation of that over itself: by the residuals, or by what is found without a part of the views, where that
    /// is more.
    pub deviation: f64,
    /// Keyframes that show the board.
    pub views: usize,
    /// Corners in all of them.
    pub corners: usize,
    /// Root mean square distance of corners from where they should be, pixels.
    pub residual: f64,
}

impl fmt::Display for BoardScale {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let Self { metres, deviation, views, corners, residual } = self;
        write!(
            f,
            "a unit of the map is {metres:.4} m ± {:.2} %, by {corners} corners in {views} keyframes, {residual:.2} px off",
            100.0 * deviation
        )
    }
}

/// The unit of a map of which keyframes show the board so.
///
/// # Errors
/// When too few keyframes show it, they do not agree with a board of this form, or the camera hardly moved while it saw it,
/// so that the scale is not determined.
pub fn scale_by_board(board: &Board, sightings: &[Sighting]) -> Result<BoardScale> {
    let problem = Problem::new(board, sightings);
    let views = problem.views.len();
    ensure!(
        views >= MIN_VIEWS,
        "{views} keyframes show the board {board}, {MIN_VIEWS} at least are needed\nhint: let the camera see it from several \
         places"
    );
    let undetermined = || {
        anyhow::anyhow!(
            "the board {board} is seen in {views} keyframes, which does not determine the scale\nhint: move the camera sideways \
             while it sees the board, by a good part of its distance"
        )
    };
    let all: Vec<usize> = (0..views).collect();
    let Some(state) = problem.search(&all) else { return Err(undetermined()) };
    let (corners, squares, worst) = problem.misfit(&state);
    if worst > MAX_MISFIT {
        bail!(
            "corners of the board {board} are {:.0} % of their distance off where they should be: it has another form, or the map \
             is bent\nhint: check the kind of board and its lengths; `loopbox calib` takes the same",
            100.0 * worst
        );
    }
    let formal = problem.deviation(&state, &all).ok_or_else(undetermined)?;
    let deviation = problem.jackknife(&state).ok_or_else(undetermined)?.max(formal);
    if deviation > MAX_DEVIATION {
        bail!(
            "the board {board} tells the scale to {:.0} % only, from {views} keyframes\nhint: move the camera sideways while it sees \
             the board, by a good part of its distance",
            100.0 * deviation
        );
    }
    let residual = (squares / corners as f64).sqrt();
    Ok(BoardScale { metres: 1.0 / state.scale, deviation, views, corners, residual })
}

/// A keyframe and what it shows of the board.
struct View {
    rotation: UnitQuaternion<f64>,
    centre: Vector3<f64>,
    camera: Pinhole,
    /// Points of the board around its middle, as they are numbered, metres; and where they are seen, pixels.
    corners: Vec<(Vector3<f64>, Vector2<f64>)>,
    /// camera_from_board, of a board numbered so, metres.
    pose: Option<Se3>,
}

/// The similarity world_from_board, the board's points being told from its middle; and by how many quarter turns each view
/// numbers the corners of a chessboard otherwise.
#[derive(Clone)]
struct State {
    rotation: UnitQuaternion<f64>,
    middle: Vector3<f64>,
    /// Map units of a metre.
    scale: f64,
    turns: Vec<u8>,
}

struct Problem {
    views: Vec<View>,
    /// The quarter turns after which the corners lie as before.
    symmetries: &'static [u8],
    /// Least distance between corners, metres.
    spacing: f64,
}

type Normal = (SMatrix<f64, 7, 7>, SVector<f64, 7>, f64);

impl Problem {
    fn new(board: &Board, sightings: &[Sighting]) -> Self {
        let points = board.points();
        let middle = points.iter().sum::<Vector3<f64>>() / points.len() as f64;
        let enough = sightings.iter().filter(|sighting| sighting.corners.len() >= MIN_CORNERS);
        let views = enough.map(|sighting| {
            let corner = |corner: &Corner| (points[corner.index] - middle, corner.pixel);
            let corners: Vec<_> = sighting.corners.iter().map(corner).collect();
            let camera = sighting.camera;
            let flat = |(point, pixel): &(Vector3<f64>, Vector2<f64>)| {
                (point.xy(), camera.unproject(pixel.x, pixel.y).xy())
            };
            let pairs: Vec<_> = corners.iter().map(flat).collect();
            View {
                rotation: sighting.world_from_camera.rotation,
                centre: sighting.world_from_camera.translation,
                camera,
                corners,
                pose: homography(&pairs).and_then(|homography| pose(&homography)),
            }
        });
        let symmetries: &[u8] = match board {
            Board::Chessboard { columns, rows, .. } if columns == rows => &[0, 1, 2, 3],
            Board::Chessboard { .. } => &[0, 2],
            _ => &[0],
        };
        let apart = points.iter().skip(1).map(|point| (point - points[0]).norm());
        Self { views: views.collect(), symmetries, spacing: apart.fold(f64::INFINITY, f64::min) }
    }

    /// The best similarity for these views, found from several of them.
    fn search(&self, chosen: &[usize]) -> Option<State> {
        let starts = chosen.iter().step_by(chosen.len().div_ceil(STARTS));
        let found = starts.filter_map(|&start| {
            let state = self.solve(self.begin(start, chosen)?, chosen)?;
            Some((self.normal(&state, chosen).2, state))
        });
        found.min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, state)| state)
    }

    /// The board turned as one view sees it; middle and scale are linear then: `middle - scale · ray_v = centre_v`.
    fn begin(&self, start: usize, chosen: &[usize]) -> Option<State> {
        let rotation = self.views[start].rotation * self.views[start].pose?.rotation;
        let turns: Vec<u8> = self.views.iter().map(|view| self.quarter_rotations(view, &rotation)).collect();
        let (mut rows, mut right) = (Vec::new(), Vec::new());
        for view in chosen.iter().map(|&i| &self.views[i]) {
            let Some(pose) = view.pose else { continue };
            let ray = view.rotation * pose.translation;
            for axis in 0..3 {
                rows.extend((0..3).map(|i| f64::from(u8::from(i == axis))).chain([-ray[axis]]));
                right.push(view.centre[axis]);
            }
        }
        let matrix = DMatrix::from_row_slice(right.len(), 4, &rows);
        let solution = matrix.svd(true, true).solve(&DVector::from_vec(right), 1e-9).ok()?;
        let scale = solution[3];
        let middle = Vector3::new(solution[0], solution[1], solution[2]);
        (scale.is_finite() && scale > 0.0).then_some(State { rotation, middle, scale, turns })
    }

    /// By how many quarter turns a view numbers the corners otherwise.
    fn quarter_rotations(&self, view: &View, rotation: &UnitQuaternion<f64>) -> u8 {
        let Some(pose) = view.pose else { return 0 };
        let seen = |turns: u8| (view.rotation * pose.rotation * quarters(turns).inverse()).angle_to(rotation);
        let best = self.symmetries.iter().min_by(|a, b| seen(**a).total_cmp(&seen(**b)));
        best.copied().unwrap_or(0)
    }

    fn solve(&self, state: State, chosen: &[usize]) -> Option<State> {
        let step = |state: &State, (normal, right, _): &Normal, damping: f64| {
            let damped = normal + SMatrix::from_diagonal(&(normal.diagonal() * damping));
            Some(state.moved(&damped.cholesky()?.solve(&-right)))
        };
        let normal = self.normal(&state, chosen);
        let linearise = |state: &State| Some(self.normal(state, chosen));
        let (state, (_, _, cost)) = DESCENT.minimise((state, normal), step, linearise, |normal| normal.2);
        (cost.is_finite() && state.scale > 0.0).then_some(state)
    }

    /// The normal equations in the step of [`State::moved`], and the cost; infinite where a corner is behind a camera.
    fn normal(&self, state: &State, chosen: &[usize]) -> Normal {
        let (mut normal, mut right, mut cost) = (SMatrix::zeros(), SVector::zeros(), 0.0);
        for &i in chosen {
            let view = &self.views[i];
            for (numbered, pixel) in &view.corners {
                let arm = state.arm(numbered, state.turns[i]);
                let Some((residual, by_world)) = view.residual(&(state.middle + arm), pixel) else {
                    return (normal, right, f64::INFINITY);
                };
                let mut jacobian = SMatrix::<f64, 2, 7>::zeros();
                jacobian.fixed_columns_mut::<3>(0).copy_from(&(-by_world * geometry::hat(&arm)));
                jacobian.fixed_columns_mut::<3>(3).copy_from(&by_world);
                jacobian.fixed_columns_mut::<1>(6).copy_from(&(by_world * arm));
                let size = residual.norm();
                let weight = if size > HUBER { HUBER / size } else { 1.0 };
                cost += if size > HUBER { HUBER * (2.0 * size - HUBER) } else { size * size };
                normal += jacobian.transpose() * jacobian * weight;
                right += jacobian.transpose() * residual * weight;
            }
        }
        (normal, right, cost)
    }

    /// How many corners there are, the sum of their squared residuals, and the median residual as a share of how far
    /// neighbours are apart in the image.
    fn misfit(&self, state: &State) -> (usize, f64, f64) {
        let mut all = Vec::new();
        let mut shares = Vec::new();
        for (view, turns) in self.views.iter().zip(&state.turns) {
            for (numbered, pixel) in &view.corners {
                let point = state.middle + state.arm(numbered, *turns);
                let depth = (view.rotation.inverse() * (point - view.centre)).z;
                let residual = view.residual(&point, pixel).map_or(f64::INFINITY, |(r, _)| r.norm());
                all.push(residual * residual);
                shares.push(residual * depth / (view.camera.fx * state.scale * self.spacing));
            }
        }
        shares.sort_by(f64::total_cmp);
        (all.len(), all.iter().sum(), shares[shares.len() / 2])
    }

    /// Standard deviation of the scale's logarithm by the residuals; `None` where it is not determined.
    fn deviation(&self, state: &State, chosen: &[usize]) -> Option<f64> {
        let (normal, _, cost) = self.normal(state, chosen);
        let corners: usize = chosen.iter().map(|&i| self.views[i].corners.len()).sum();
        let freedom = (2 * corners).checked_sub(7).filter(|freedom| *freedom > 0)?;
        let variance = normal.cholesky()?.inverse()[(6, 6)] * cost / freedom as f64;
        (variance.is_finite() && variance >= 0.0).then(|| variance.sqrt())
    }

    /// The same by what is found when parts of the views are left out in turn, in the order of time, which errors that all
    /// corners of a view share do not escape (delete-a-group jackknife, Kott 2001).
    fn jackknife(&self, state: &State) -> Option<f64> {
        let views = self.views.len();
        let groups = views.min(GROUPS);
        let without = |group: usize| {
            let kept: Vec<usize> = (0..views).filter(|i| i * groups / views != group).collect();
            Some(self.solve(state.clone(), &kept)?.scale.ln())
        };
        let found = (0..groups).map(without).collect::<Option<Vec<f64>>>()?;
        let n = groups as f64;
        let mean = found.iter().sum::<f64>() / n;
        Some(((n - 1.0) / n * found.iter().map(|x| (x - mean).powi(2)).sum::<f64>()).sqrt())
    }
}

impl State {
    /// A point of the board from its middle, in the world's axes and unit.
    fn arm(&self, numbered: &Vector3<f64>, turns: u8) -> Vector3<f64> {
        self.rotation * (quarters(turns) * numbered) * self.scale
    }

    /// Turned in the world by the first three, moved by the next, and larger by the exponential of the last.
    fn moved(&self, step: &SVector<f64, 7>) -> Self {
        let rotation_step = UnitQuaternion::from_scaled_axis(step.fixed_rows::<3>(0).into_owned());
        Self {
            rotation: rotation_step * self.rotation,
            middle: self.middle + step.fixed_rows::<3>(3),
            scale: self.scale * step[6].exp(),
            turns: self.turns.clone(),
        }
    }
}

impl View {
    /// How far a point is from where it is seen, pixels, and the derivative by the point; `None` behind the camera.
    fn residual(
        &self,
        point: &Vector3<f64>,
        pixel: &Vector2<f64>,
    ) -> Option<(Vector2<f64>, SMatrix<f64, 2, 3>)> {
        let inverse = self.rotation.inverse();
        let p = inverse * (point - self.centre);
        if p.z <= 0.0 {
            return None;
        }
        let Pinhole { fx, fy, .. } = self.camera;
        let by_camera = SMatrix::<f64, 2, 3>::new(fx, 0.0, -fx * p.x / p.z, 0.0, fy, -fy * p.y / p.z) / p.z;
        Some((self.camera.project(&p) - pixel, by_camera * inverse.to_rotation_matrix().matrix()))
    }
}

/// So many quarter turns about the board's normal.
fn quarters(turns: u8) -> UnitQuaternion<f64> {
    UnitQuaternion::from_axis_angle(&Vector3::z_axis(), f64::from(turns) * FRAC_PI_2)
}

#[cfg(test)]
mod tests;
