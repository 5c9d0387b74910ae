//! Whether a camera sees a surface that another camera saw, or something stands before it.
//!
//! A hidden surface does not contradict what the camera sees in its place. The camera's own depths show what hides it; so do the
//! depths of the other camera, which saw the same thing beside the surface. Semi-dense depths lie at edges, so a plain thing
//! has depths at its outline only, and often none: where the camera has no depth, nothing is known.

use super::surface::{Surface, surrounds};
use super::view::KeyframeView;
use geometry::Sim3;

/// Fewest nearer points within a footprint that hide it: fewer are errors.
const FEWEST: usize = 3;
/// And their least share of all points within it.
const LEAST_SHARE: f64 = 0.1;
/// Standard deviations by which a point is nearer.
const DEVIATIONS: f64 = 3.0;
/// How many cells around a footprint without points are looked at for something nearer.
const REACH: usize = 2;
/// Sides of a footprint without points, of four, on which something nearer must be seen: a plain wall between two cupboards has one to
/// its left and one to its right.
const SIDES: usize = 3;

/// Where a target sees a cell of another keyframe's surface: to first order, over a cell a homography is affine to a part of a pixel.
#[derive(Clone, Copy, Debug)]
pub(super) struct Footprint {
    /// The target's pixel of the cell's middle.
    pub middle: [f64; 2],
    /// Change of the target's pixel by one pixel of the cell to the right, and down.
    pub along: [[f64; 2]; 2],
    /// Inverse depth of the middle, 1/target unit.
    pub inverse_depth: f64,
    /// Its change by one pixel of the cell to the right, and down.
    pub slope: [f64; 2],
    /// Half the side of the cell, pixels of the cell.
    pub half: f64,
}

impl Footprint {
    /// Offset from the cell's middle, pixels of the cell, of a pixel of the target.
    fn offset(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let [[a, c], [b, d]] = self.along;
        let determinant = a * d - b * c;
        let (x, y) = (x - self.middle[0], y - self.middle[1]);
        [(d * x - b * y) / determinant, (a * y - c * x) / determinant]
    }

    fn inverse_depth_at(&self, [dx, dy]: [f64; 2]) -> f64 {
        self.inverse_depth + self.slope[0] * dx + self.slope[1] * dy
    }
}

/// Whether a target sees a surface.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Visibility {
    /// It has a surface there that is no nearer, or is a frame without any depths.
    Visible,
    /// Something nearer hides it.
    Hidden,
    /// The target knows no surface there: something plain may hide it.
    Unknown,
}

/// A depth point as the target sees it: its pixel, and its inverse depth less three standard deviations, 1/target unit.
#[derive(Clone, Copy, Debug)]
struct Seen {
    pixel: [f64; 2],
    inverse_depth: f64,
    /// Whether the target saw it, not the source.
    is_own: bool,
}

/// The depths of a target and of a source, where the target sees them, by the target's cells.
pub(super) struct Foreground<'a> {
    target: &'a Surface,
    cells: Vec<Vec<Seen>>,
    relative_gap: f64,
    /// Whether the target has no depths of its own.
    is_blind: bool,
}

impl<'a> Foreground<'a> {
    /// The depths of both keyframes at the levels of their surfaces. What is nearer by less than a share `relative_gap` is the same
    /// surface.
    pub(super) fn new(
        [source, target]: [&'a KeyframeView; 2],
        target_from_source: &Sim3,
        relative_gap: f64,
    ) -> Self {
        let [source, target] =
            [source, target].map(|view| (view.surface(), view.depth(view.surface().level)));
        let mut cells = vec![Vec::new(); target.0.planes.len()];
        let mut add = |pixel: [f64; 2], inverse_depth: f64, is_own: bool| {
            if let Some(cell) = target.0.cell_at(pixel) {
                cells[cell].push(Seen { pixel, inverse_depth, is_own });
            }
        };
        for point in &target.1.points {
            let deviation = f64::from(point.variance).sqrt();
            add(
                [point.x, point.y].map(f64::from),
                f64::from(point.inverse_depth) - DEVIATIONS * deviation,
                true,
            );
        }
        for point in &source.1.points {
            let (inverse_depth, deviation) =
                (f64::from(point.inverse_depth), f64::from(point.variance).sqrt());
            let ray = source.0.camera.unproject(f64::from(point.x), f64::from(point.y));
            let moved = *target_from_source * (ray / inverse_depth);
            if moved.z > 0.0 {
                let pixel = target.0.camera.project(&moved);
                // The relative deviation stays with the point.
                add([pixel.x, pixel.y], (1.0 - DEVIATIONS * deviation / inverse_depth) / moved.z, false);
            }
        }
        let is_blind = target.1.points.is_empty();
        Self { target: target.0, cells, relative_gap, is_blind }
    }

    /// Whether the target sees a surface.
    pub(super) fn visibility(&self, footprint: &Footprint) -> Visibility {
        let within = |seen: &&Seen| footprint.offset(seen.pixel).iter().all(|v| v.abs() <= footprint.half);
        let inside: Vec<&Seen> = self.near(footprint, 0).filter(within).collect();
        let nearer = inside.iter().filter(|seen| self.is_before(seen, footprint)).count();
        let is_hidden = if inside.len() < FEWEST {
            self.encloses(footprint)
        } else {
            nearer >= FEWEST && nearer as f64 >= LEAST_SHARE * inside.len() as f64
        };
        if is_hidden {
            return Visibility::Hidden;
        }
        let own = inside.iter().filter(|seen| seen.is_own && !self.is_before(seen, footprint));
        let is_seen = || surrounds(own.map(|seen| footprint.offset(seen.pixel)), [0.0; 2]);
        if self.is_blind || is_seen() || self.is_plane(footprint) {
            Visibility::Visible
        } else {
            Visibility::Unknown
        }
    }

    /// Whether the target has a plane there, and nothing nearer as far around as its depths may be.
    fn is_plane(&self, footprint: &Footprint) -> bool {
        let Some(cell) = self.target.cell_at(footprint.middle) else { return false };
        let nearer = || self.near(footprint, REACH).filter(|seen| self.is_before(seen, footprint)).count();
        self.target.planes[cell].is_some() && nearer() < FEWEST
    }

    /// Whether something nearer is seen around a footprint: in most of the first cells with depths to its left and right, above and
    /// below it.
    fn encloses(&self, footprint: &Footprint) -> bool {
        let Some(cell) = self.target.cell_at(footprint.middle) else { return false };
        let (columns, rows) = (self.target.columns, self.target.rows);
        let (column, row) = (cell % columns, cell / columns);
        let is_nearer = |column: usize, row: usize| {
            let seen = &self.cells[row * columns + column];
            let nearer = seen.iter().filter(|seen| self.is_nearer(seen, footprint.inverse_depth)).count();
            (seen.len() >= FEWEST).then_some(4 * nearer >= seen.len())
        };
        let sides: [Option<bool>; 4] = [
            (0..column).rev().find_map(|x| is_nearer(x, row)),
            (column + 1..columns).find_map(|x| is_nearer(x, row)),
            (0..row).rev().find_map(|y| is_nearer(column, y)),
            (row + 1..rows).find_map(|y| is_nearer(column, y)),
        ];
        sides.iter().filter(|side| **side == Some(true)).count() >= SIDES
    }

    /// Whether a point is nearer than the plane of a footprint at the point's pixel.
    fn is_before(&self, seen: &Seen, footprint: &Footprint) -> bool {
        self.is_nearer(seen, footprint.inverse_depth_at(footprint.offset(seen.pixel)))
    }

    fn is_nearer(&self, seen: &Seen, inverse_depth: f64) -> bool {
        seen.inverse_depth > inverse_depth * (1.0 + self.relative_gap)
    }

    /// The points in the cells that a footprint may touch, and so many around them.
    fn near(&self, footprint: &Footprint, around: usize) -> impl Iterator<Item = &Seen> {
        let reach =
            |axis: usize| footprint.half * (footprint.along[0][axis].abs() + footprint.along[1][axis].abs());
        let range = |axis: usize, count: usize| {
            let cell =
                |v: f64| ((v + 0.5) / self.target.cell as f64).floor().clamp(0.0, count as f64) as usize;
            let (middle, reach) = (footprint.middle[axis], reach(axis));
            cell(middle - reach).saturating_sub(around)..(cell(middle + reach) + 1 + around).min(count)
        };
        let (columns, rows) = (range(0, self.target.columns), range(1, self.target.rows));
        rows.flat_map(move |row| columns.clone().map(move |column| row * self.target.columns + column))
            .flat_map(|cell| &self.cells[cell])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use geometry::{GrayImage, Pinhole, Pyramid};
    use map::SemiDense;

    const CAMERA: Pinhole = Pinhole { width: 320, height: 240, fx: 210.0, fy: 210.0, cx: 159.5, cy: 119.5 };

    /// A wall of inverse depth 0.5, and what stands before it at those pixels for which `inverse_depth` says so; depths at every
    /// fourth pixel of every second row.
    fn view(inverse_depth: impl Fn(usize, usize) -> Option<f32>) -> KeyframeView {
        let image = GrayImage::from_vec(320, 240, (0..320 * 240).map(|i| (i * 37 % 101) as u8).collect());
        let mut depth = SemiDense::default();
        for i in (0..320 * 240).filter(|i| i % 4 == 0 && i / 320 % 2 == 0) {
            if let Some(inverse_depth) = inverse_depth(i % 320, i / 320) {
                depth.pixel.push(i as u32);
                depth.inverse_depth.push(inverse_depth);
                depth.variance.push(1e-6);
            }
        }
        KeyframeView::new(&Pyramid::new(image.unwrap(), 3), &depth, &CAMERA)
    }

    /// Visibility in `target` of the wall at a pixel that both cameras share.
    fn visibility(source: &KeyframeView, target: &KeyframeView, pixel: [f64; 2]) -> Visibility {
        let along = [[1.0, 0.0], [0.0, 1.0]];
        let footprint = Footprint { middle: pixel, along, inverse_depth: 0.5, slope: [0.0; 2], half: 7.0 };
        Foreground::new([source, target], &Sim3::identity(), 0.05).visibility(&footprint)
    }

    /// A box of 60 by 60 pixels around the middle of the image.
    fn in_box(x: usize, y: usize) -> bool {
        (130..190).contains(&x) && (90..150).contains(&y)
    }

    fn at_border(x: usize, y: usize) -> bool {
        in_box(x, y) && !((134..186).contains(&x) && (94..146).contains(&y))
    }

    #[test]
    fn what_stands_before_a_surface_hides_it() {
        let wall = view(|_, _| Some(0.5));
        let with_box = |depth: f32| view(move |x, y| Some(if in_box(x, y) { depth } else { 0.5 }));
        let (middle, aside) = ([160.0, 120.0], [60.0, 120.0]);
        assert_eq!(visibility(&wall, &wall, middle), Visibility::Visible);
        assert_eq!(visibility(&wall, &with_box(0.7), middle), Visibility::Hidden);
        assert_eq!(visibility(&wall, &with_box(0.7), aside), Visibility::Visible);
        // The source saw the box too.
        assert_eq!(visibility(&with_box(0.7), &wall, middle), Visibility::Hidden);
        // What is behind, or nearer by less than errors, hides nothing.
        assert_eq!(visibility(&wall, &with_box(0.3), middle), Visibility::Visible);
        assert_eq!(visibility(&wall, &with_box(0.51), middle), Visibility::Visible);
    }

    /// A plain box has depths along its outline, or none at all.
    #[test]
    fn a_plain_thing_hides_by_its_outline_and_one_without_depths_may() {
        let wall = view(|x, y| (!in_box(x, y)).then_some(0.5));
        let outline = view(|x, y| if at_border(x, y) { Some(0.7) } else { (!in_box(x, y)).then_some(0.5) });
        assert_eq!(visibility(&wall, &outline, [160.0, 120.0]), Visibility::Hidden);
        let nothing = view(|x, y| (!(100..220).contains(&x) || !(60..180).contains(&y)).then_some(0.5));
        assert_eq!(visibility(&nothing, &nothing, [160.0, 120.0]), Visibility::Unknown);
        assert_eq!(visibility(&wall, &view(|_, _| None), [60.0, 120.0]), Visibility::Visible);
    }
}
