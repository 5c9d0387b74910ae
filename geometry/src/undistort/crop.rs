//! The part of the scene that the undistorted picture shows.

use crate::{Camera, Pinhole};
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

/// The choice of the output camera of an [`Undistorter`](crate::Undistorter).
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Crop {
    /// As much of the scene as fits such that every output pixel shows something that the camera saw.
    /// Size and pixel aspect (fx : fy) are the camera's; the focal length becomes no shorter than half.
    #[default]
    Valid,
    /// Size, focal lengths and principal point as they are; output pixels that the camera did not see
    /// repeat its nearest edge and are marked as not valid.
    KeepFocal,
    /// This camera.
    Explicit(Pinhole),
}

impl Crop {
    /// The output camera for an input camera. A camera without distortion keeps its own unless another
    /// is given.
    pub fn pinhole_of(&self, camera: &Camera) -> Pinhole {
        match *self {
            Crop::Explicit(pinhole) => pinhole,
            Crop::Valid if !camera.distortion().is_identity() => largest_valid(camera),
            Crop::Valid | Crop::KeepFocal => *camera.intrinsics(),
        }
    }
}

/// A rectangle on the plane z = 1 around the axis: left, top, right, bottom (left, top < 0).
type Sides = [f64; 4];

/// How much more of the scene than without distortion a side may take in: the picture's centre is not
/// shrunk below half, so that wide fisheyes do not spend all pixels on their rim.
const MAX_WIDENING: f64 = 2.0;

/// The pinhole of the largest rectangle that the camera sees entirely.
fn largest_valid(camera: &Camera) -> Pinhole {
    let Pinhole { width, height, fx, fy, cx, cy } = *camera.intrinsics();
    let (right, bottom) = (width as f64 - 1.0, height as f64 - 1.0);
    let widest = [-cx / fx, -cy / fy, (right - cx) / fx, (bottom - cy) / fy].map(|side| side * MAX_WIDENING);
    let sides = grown(camera, shrunk(camera, widest), &widest);
    let sides = with_aspect(camera, sides);
    let [left, top, right_side, bottom_side] = sides.map(|side| side * widening(camera, &sides, &widest));
    let (fx, fy) = (right / (right_side - left), bottom / (bottom_side - top));
    Pinhole { width, height, fx, fy, cx: -left * fx, cy: -top * fy }
}

/// Kept from the source's edge, pixels: between two tested pixels a side may bulge by less than this.
const EDGE_MARGIN: f64 = 0.01;

/// Moves the side of which the largest share is unseen towards the axis until all is seen. Counted in pixels, the long
/// sides of a wide image would be moved to the axis before the short ones are seen.
fn shrunk(camera: &Camera, mut sides: Sides) -> Sides {
    let Pinhole { width, height, .. } = *camera.intrinsics();
    // 0.99^2000 ≈ 0: by then the rectangle is a point on the axis, which any camera sees.
    for _ in 0..2000 {
        let unseen = unseen_pixels(camera, &sides);
        let share =
            |side: usize| unseen[side] as f64 / if side.is_multiple_of(2) { height } else { width } as f64;
        let most = (0..4).rev().max_by(|a, b| share(*a).total_cmp(&share(*b))).unwrap_or(0);
        if unseen[most] == 0 {
            break;
        }
        sides[most] *= 0.99;
    }
    sides
}

/// Moves each side outwards as far as it stays seen (and within `widest`).
fn grown(camera: &Camera, mut sides: Sides, widest: &Sides) -> Sides {
    for side in 0..4 {
        let (mut low, mut high) = (sides[side], widest[side].abs().min(1.02 * sides[side].abs()));
        high = high.copysign(low);
        for _ in 0..12 {
            sides[side] = 0.5 * (low + high);
            if unseen_pixels(camera, &sides) == [0; 4] { low = sides[side] } else { high = sides[side] }
        }
        sides[side] = low;
    }
    sides
}

/// How many pixels along each side of the rectangle the camera does not see.
///
/// The sides suffice: where projection is one-to-one, a closed curve that is seen has a seen inside.
fn unseen_pixels(camera: &Camera, sides: &Sides) -> [usize; 4] {
    let [left, top, right, bottom] = *sides;
    let Pinhole { width, height, .. } = *camera.intrinsics();
    let (columns, rows) = (width as f64 - 1.0, height as f64 - 1.0);
    let inside = |value: f64, limit: f64| (EDGE_MARGIN..=limit - EDGE_MARGIN).contains(&value);
    let unseen = |x: f64, y: f64| {
        let pixel = camera.project(&Vector3::new(x, y, 1.0));
        !pixel.is_some_and(|pixel| inside(pixel.x, columns) && inside(pixel.y, rows))
    };
    let along = |low: f64, high: f64, count: usize, unseen: &dyn Fn(f64) -> bool| {
        (0..count).filter(|&i| unseen(low + (high - low) * i as f64 / (count as f64 - 1.0))).count()
    };
    [
        along(top, bottom, height, &|y| unseen(left, y)),
        along(left, right, width, &|x| unseen(x, top)),
        along(top, bottom, height, &|y| unseen(right, y)),
        along(left, right, width, &|x| unseen(x, bottom)),
    ]
}

/// The rectangle cut along one axis such that it has the camera's pixel aspect.
fn with_aspect(camera: &Camera, [left, top, right, bottom]: Sides) -> Sides {
    let Pinhole { width, height, fx, fy, .. } = *camera.intrinsics();
    let (columns, rows) = (width as f64 - 1.0, height as f64 - 1.0);
    let scale = (columns / (right - left) / fx).max(rows / (bottom - top) / fy);
    let (left, right) = cut(left, right, columns / (fx * scale));
    let (top, bottom) = cut(top, bottom, rows / (fy * scale));
    [left, top, right, bottom]
}

/// By how much the whole rectangle can still widen: where corners were the limit, the cut frees some.
fn widening(camera: &Camera, sides: &Sides, widest: &Sides) -> f64 {
    let limit = (0..4).map(|side| widest[side] / sides[side]).fold(f64::INFINITY, f64::min);
    let (mut low, mut high) = (1.0, limit.max(1.0));
    for _ in 0..16 {
        let middle = 0.5 * (low + high);
        if unseen_pixels(camera, &sides.map(|side| side * middle)) == [0; 4] {
            low = middle
        } else {
            high = middle
        }
    }
    low
}

/// Shortens an interval around zero to `length`, in proportion on both sides.
fn cut(low: f64, high: f64, length: f64) -> (f64, f64) {
    let share = length / (high - low);
    (low * share, high * share)
}
