//! How alike two keyframes see each cell of one's surface at a given relative pose.

use super::band::Layer;
use super::foreground::{Footprint, Foreground, Visibility};
use super::surface::Surface;
use super::view::KeyframeView;
use crate::params;
use geometry::Sim3;
use nalgebra::Vector3;

/// Contrasts that differ by a smaller factor are alike.
const LIKE: f64 = 1.5;
/// Least share of a cell's pixels of which both keyframes show the grain.
const MIN_SHARE: f32 = 0.2;
/// Shifts that are correlated at a time.
const LANES: usize = 8;

params! {
    /// Parameters of the comparison of cells.
    pub struct CellParams {
        /// How far a cell is searched around where it should be, pixels of the level. Range 0–8: errors of alignment and of a
        /// cell's plane.
        pub radius: usize = 2,
        /// Relative difference of two inverse depths from which on the nearer one hides the other. Range 0.01–1: errors of pose and
        /// scale, and of a cell's plane.
        pub relative_gap: f64 = 0.05,
        /// Least standard deviation of a cell's band, grey levels of single pixels. Range 0.3–50: what is plainer is rounding.
        pub min_deviation: f64 = 1.0,
        /// Largest ratio of a cell's size in the target to that in the source, and the reverse. Range 1–4: beyond, one is a
        /// blur of the other.
        pub max_magnification: f64 = 1.6,
    }
}

/// What became of a cell in another keyframe.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CellMatch {
    /// The cell of the source, by rows.
    pub cell: usize,
    /// What of it was compared.
    pub layer: Layer,
    /// Its middle, in the source's camera frame and unit.
    pub centre: Vector3<f64>,
    /// Its width there, source unit.
    pub width: f64,
    /// Standard deviation of its band over its mean intensity.
    pub contrast: f64,
    /// 0 for an edge to 1 for grain: the ratio of the eigenvalues of the structure tensor.
    pub roundness: f64,
    /// The largest correlation of the bands of both within the search radius, −1 to 1.
    pub correlation: f64,
    /// Whether the target knows a surface where the cell should be. Where it does not, something may hide the cell.
    pub is_visible: bool,
}

impl KeyframeView {
    /// What becomes of the cells of this keyframe in another, where that one has them in view and nothing is known to hide them.
    pub fn match_cells(&self, target: &Self, target_from_self: &Sim3, params: &CellParams) -> Vec<CellMatch> {
        let (own, other) = (self.surface(), target.surface());
        let foreground = Foreground::new([self, target], target_from_self, params.relative_gap);
        let found = |cell: usize| -> Option<Vec<CellMatch>> {
            let has_band = |layer: &Layer| own.band(*layer).shows(cell, params.min_deviation);
            let plane = own.planes[cell].filter(|_| Layer::ALL.iter().any(has_band))?;
            let footprint = Warp { own, other, cell, target_from_self }.footprint(params)?;
            let visibility = foreground.visibility(&footprint);
            if visibility == Visibility::Hidden {
                return None;
            }
            let middle = own.middle(cell);
            let centre = own.camera.unproject(middle[0], middle[1]) / plane.at;
            let width = own.cell as f64 / own.camera.fx / plane.at;
            let of_layer = |layer: Layer| {
                let patch = footprint_patch(own, other, layer, &footprint, params)?;
                let band = own.band(layer);
                Some(CellMatch {
                    cell,
                    layer,
                    centre,
                    width,
                    contrast: band.contrasts[cell],
                    roundness: band.roundness[cell],
                    correlation: best_correlation(own, layer, cell, &patch, params.radius)?,
                    is_visible: visibility == Visibility::Visible,
                })
            };
            Some(Layer::ALL.into_iter().filter(has_band).filter_map(of_layer).collect())
        };
        (0..own.planes.len()).filter_map(found).flatten().collect()
    }

    /// Contrast and correlation of cells of this keyframe with such of another that do not show the same and have a contrast like
    /// theirs: what correlation comes to by chance, and by what all of it has in common, edges of one direction, one make.
    pub fn mismatch_cells(&self, target: &Self, layer: Layer, params: &CellParams) -> Vec<[f64; 2]> {
        let (own, other) = (self.surface(), target.surface());
        let (own_band, other_band) = (own.band(layer), other.band(layer));
        let all = other.columns * other.rows;
        let found = |cell: usize| {
            own.planes[cell].filter(|_| own_band.shows(cell, params.min_deviation))?;
            let is_like = |there: &usize| {
                let ratio = other_band.contrasts[*there] / own_band.contrasts[cell];
                other_band.shows(*there, params.min_deviation) && (LIKE.recip()..LIKE).contains(&ratio)
            };
            // From far away in the image on, another each.
            let from = cell + all / 2 + (cell * 7919) % (all / 3).max(1);
            let there = (0..all / 3).map(|step| (from + step) % all).find(is_like)?;
            let [x, y] = other.middle(there);
            let patch = patch(other, layer, own.cell + 2 * params.radius, |dx, dy| [x + dx, y + dy])?;
            Some([own_band.contrasts[cell], best_correlation(own, layer, cell, &patch, params.radius)?])
        };
        (0..own.planes.len()).filter_map(found).collect()
    }
}

/// From pixels of a cell to those of a target.
struct Warp<'a> {
    own: &'a Surface,
    other: &'a Surface,
    cell: usize,
    target_from_self: &'a Sim3,
}

impl Warp<'_> {
    /// The target's pixel and inverse depth of a pixel on the cell's plane; nothing behind the target.
    fn at(&self, pixel: [f64; 2]) -> Option<([f64; 2], f64)> {
        let inverse_depth = self.own.inverse_depth(self.cell, pixel).filter(|d| *d > 0.0)?;
        let point = *self.target_from_self * (self.own.camera.unproject(pixel[0], pixel[1]) / inverse_depth);
        let there = self.other.camera.project(&point);
        (point.z > 0.0).then(|| ([there.x, there.y], point.z.recip()))
    }

    /// Where the target sees the cell; nothing where it is not in view or much larger or smaller there.
    fn footprint(&self, params: &CellParams) -> Option<Footprint> {
        let half = 0.5 * self.own.cell as f64;
        let [x0, y0] = self.own.middle(self.cell);
        let step = half + params.radius as f64;
        let at = |dx: f64, dy: f64| self.at([x0 + dx * step, y0 + dy * step]);
        let ends = [[at(-1.0, 0.0)?, at(1.0, 0.0)?], [at(0.0, -1.0)?, at(0.0, 1.0)?]];
        let (middle, inverse_depth) = self.at([x0, y0])?;
        let along = ends.map(|[(a, _), (b, _)]| [0, 1].map(|axis| (b[axis] - a[axis]) / (2.0 * step)));
        let slope = ends.map(|[(_, a), (_, b)]| (b - a) / (2.0 * step));
        let growth = (along[0][0] * along[1][1] - along[0][1] * along[1][0]).abs().sqrt();
        let most = params.max_magnification;
        let is_alike = growth <= most && growth * most >= 1.0;
        is_alike.then_some(Footprint { middle, along, inverse_depth, slope, half })
    }
}

/// The target's band over the cell and a margin around it; nothing where it leaves the image.
fn footprint_patch(
    own: &Surface,
    other: &Surface,
    layer: Layer,
    footprint: &Footprint,
    params: &CellParams,
) -> Option<Vec<f32>> {
    let Footprint { middle, along: [along, down], .. } = footprint;
    patch(other, layer, own.cell + 2 * params.radius, |dx, dy| {
        [0, 1].map(|axis| middle[axis] + along[axis] * dx + down[axis] * dy)
    })
}

/// A square of so many pixels of a band between its pixels, with [`LANES`] values behind it; nothing where it leaves the image, and no number
/// where a pixel around has none. `at` is the pixel by the offset from the square's middle, an affine function of it.
fn patch(
    surface: &Surface,
    layer: Layer,
    side: usize,
    at: impl Fn(f64, f64) -> [f64; 2],
) -> Option<Vec<f32>> {
    let (width, height) = (surface.width(), surface.camera.height);
    let half = 0.5 * (side as f64 - 1.0);
    let is_inside =
        |[x, y]: [f64; 2]| x >= 0.0 && y >= 0.0 && x < (width - 1) as f64 && y < (height - 1) as f64;
    // An affine square is inside where its corners are.
    let corners = [(-half, -half), (half, -half), (-half, half), (half, half)];
    if !corners.iter().all(|&(dx, dy)| is_inside(at(dx, dy))) {
        return None;
    }
    let band = &surface.band(layer).values[..];
    let value = |i: usize| {
        let [x, y] = at((i % side) as f64 - half, (i / side) as f64 - half);
        let (left, top) = (x as usize, y as usize);
        let (dx, dy) = ((x - left as f64) as f32, (y - top as f64) as f32);
        let row = |y: usize| {
            let at = y * width + left;
            band[at] + dx * (band[at + 1] - band[at])
        };
        let above = row(top);
        above + dy * (row(top + 1) - above)
    };
    // So that shifts beyond the last can be read, which nobody uses.
    Some((0..side * side).map(value).chain(std::iter::repeat_n(0.0, LANES)).collect())
}

/// The largest correlation of a cell's band with a patch around it, between whole pixels by a parabola; nothing where too few pixels
/// of both have a value.
fn best_correlation(own: &Surface, layer: Layer, cell: usize, patch: &[f32], radius: usize) -> Option<f64> {
    let (size, side) = (own.cell, own.cell + 2 * radius);
    let first = cell / own.columns * size * own.width() + cell % own.columns * size;
    let band = &own.band(layer).values[first..];
    let add_up = match layer {
        Layer::Pattern => sums_of_all,
        Layer::Grain => sums_of_numbers,
    };
    let shifts = 2 * radius + 1;
    // Some shifts to the side at a time.
    let correlations = |at: usize| -> Option<Vec<f64>> {
        let (sy, sx) = (at / shifts, at % shifts);
        let sums = add_up(band, own.width(), size, &patch[sy * side + sx..], side);
        let of_shift = |lane: usize| {
            (sums.count[lane] >= MIN_SHARE * (size * size) as f32).then(|| sums.correlation(lane))
        };
        (0..LANES.min(shifts - sx)).map(of_shift).collect()
    };
    let starts = (0..shifts).flat_map(|sy| (0..shifts).step_by(LANES).map(move |sx| sy * shifts + sx));
    let all: Vec<f64> = starts.map(correlations).collect::<Option<Vec<_>>>()?.concat();
    (0..all.len()).max_by(|&a, &b| all[a].total_cmp(&all[b])).map(|best| peak(&all, shifts, best))
}

geometry::multiversion! {
    /// Sums over a cell of `size` rows and columns of a band that is `width` wide and begins with it, and a patch whose rows are `side` long.
    /// Values without a number count nothing.
    fn sums_of_numbers(band: &[f32], width: usize, size: usize, patch: &[f32], side: usize) -> Sums {
        let mut sums = Sums::default();
        for y in 0..size {
            let there = patch[y * side..][..size + LANES].windows(LANES);
            for (a, there) in band[y * width..][..size].iter().zip(there) {
                sums.add(*a, there.first_chunk().expect("as wide"));
            }
        }
        sums
    }
}

geometry::multiversion! {
    /// [`sums_of_numbers`] where all values are numbers: the sums over the band are the same at all shifts.
    fn sums_of_all(band: &[f32], width: usize, size: usize, patch: &[f32], side: usize) -> Sums {
        let mut sums = Sums::default();
        let (mut sum, mut square) = (0.0, 0.0);
        for y in 0..size {
            let there = patch[y * side..][..size + LANES].windows(LANES);
            for (&a, there) in band[y * width..][..size].iter().zip(there) {
                let there: &[f32; LANES] = there.first_chunk().expect("as wide");
                sum += a;
                square += a * a;
                for (lane, &b) in there.iter().enumerate() {
                    sums.sum[1][lane] += b;
                    sums.square[1][lane] += b * b;
                    sums.product[lane] += a * b;
                }
            }
        }
        sums.count = [(size * size) as f32; LANES];
        (sums.sum[0], sums.square[0]) = ([sum; LANES], [square; LANES]);
        sums
    }
}

/// Sums over pairs of values for each of some shifts; those without a number count nothing. Lane by lane, so that processors add several
/// in one step.
#[derive(Default)]
struct Sums {
    count: [f32; LANES],
    sum: [[f32; LANES]; 2],
    square: [[f32; LANES]; 2],
    product: [f32; LANES],
}

impl Sums {
    #[inline(always)]
    fn add(&mut self, a: f32, there: &[f32; LANES]) {
        for (lane, &b) in there.iter().enumerate() {
            let product = a * b;
            let (weight, a, b, product) =
                if product.is_nan() { (0.0, 0.0, 0.0, 0.0) } else { (1.0, a, b, product) };
            self.count[lane] += weight;
            self.sum[0][lane] += a;
            self.sum[1][lane] += b;
            self.square[0][lane] += a * a;
            self.square[1][lane] += b * b;
            self.product[lane] += product;
        }
    }

    /// −1 to 1; 0 where either side is plain.
    fn correlation(&self, lane: usize) -> f64 {
        let count = f64::from(self.count[lane]);
        let means = self.sum.map(|sum| f64::from(sum[lane]) / count);
        let variance = |side: usize| f64::from(self.square[side][lane]) / count - means[side] * means[side];
        let scale = (variance(0) * variance(1)).sqrt();
        if scale > 1e-6 { (f64::from(self.product[lane]) / count - means[0] * means[1]) / scale } else { 0.0 }
    }
}

/// The top of the parabolas through a largest value and its neighbours in rows and columns.
fn peak(all: &[f64], shifts: usize, best: usize) -> f64 {
    let value = all[best];
    let rise = |inside: bool, step: usize| {
        if !inside {
            return 0.0;
        }
        let (before, after) = (all[best - step], all[best + step]);
        let bend = 2.0 * value - before - after;
        if bend > 1e-9 { (after - before).powi(2) / (8.0 * bend) } else { 0.0 }
    };
    let (x, y) = (best % shifts, best / shifts);
    let inside = |v: usize| v > 0 && v + 1 < shifts;
    (value + rise(inside(x), 1) + rise(inside(y), shifts)).min(1.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use geometry::{GrayImage, Pinhole, Pyramid, Random, Se3};
    use map::SemiDense;
    use nalgebra::UnitQuaternion;

    const CAMERA: Pinhole = Pinhole { width: 320, height: 240, fx: 210.0, fy: 210.0, cx: 159.5, cy: 119.5 };

    /// A wall of plaster with a grain, 2 m away, and depths on a grid of lines only; seen from `x` metres aside.
    fn wall(seed: u64, x: f64) -> KeyframeView {
        let side = 600usize;
        let mut random = Random::new(seed);
        let coarse: Vec<f64> = (0..side * side).map(|_| random.normal()).collect();
        let at = |u: f64, v: f64| {
            // A grain of two pixels.
            let (left, top) = (u.floor(), v.floor());
            let value = |dx: f64, dy: f64| coarse[(top + dy) as usize * side + (left + dx) as usize];
            let along = |dy: f64| value(0.0, dy) + (u - left) * (value(1.0, dy) - value(0.0, dy));
            along(0.0) + (v - top) * (along(1.0) - along(0.0))
        };
        let mut noise = Random::new(seed ^ (1000.0 * x) as u64 ^ 77);
        let pixel = |i: usize| {
            let (u, v) = ((i % 320) as f64 + 105.0 * x + 100.0, (i / 320) as f64 + 100.0);
            (150.0 + 5.0 * at(0.5 * u, 0.5 * v) + noise.normal()).round().clamp(0.0, 255.0) as u8
        };
        let image = GrayImage::from_vec(320, 240, (0..320 * 240).map(pixel).collect()).unwrap();
        let mut depth = SemiDense::default();
        for i in (0..320 * 240).filter(|i| i % 320 % 40 == 0 && i / 320 % 2 == 0) {
            depth.pixel.push(i as u32);
            depth.inverse_depth.push(0.5);
            depth.variance.push(1e-5);
        }
        KeyframeView::new(&Pyramid::new(image, 3), &depth, &CAMERA)
    }

    fn mean(values: impl Iterator<Item = f64>) -> f64 {
        let values: Vec<f64> = values.collect();
        assert!(values.len() > 100, "{} cells", values.len());
        values.iter().sum::<f64>() / values.len() as f64
    }

    /// The grain of a bare wall between depths tells it from another of the same stuff.
    #[test]
    fn grain_agrees_on_one_wall_and_not_on_two() {
        let params = CellParams::default();
        let (here, there, other) = (wall(1, 0.0), wall(1, 0.1), wall(2, 0.1));
        let moved = Sim3::from(Se3::new(UnitQuaternion::identity(), Vector3::new(-0.1, 0.0, 0.0)));
        for layer in Layer::ALL {
            let agreement = |target: &KeyframeView| {
                let found = here.match_cells(target, &moved, &params);
                let found = found.iter().filter(|found| found.layer == layer);
                mean(found.map(|cell| cell.correlation))
            };
            let by_chance = here.mismatch_cells(&there, layer, &params);
            let by_chance = mean(by_chance.iter().map(|[_, correlation]| *correlation));
            let (one, two) = (agreement(&there), agreement(&other));
            let is_told = one > 0.8 && two < 0.4 && (two - by_chance).abs() < 0.05;
            assert!(is_told, "{layer:?} {one} {two} {by_chance}");
        }
    }
}
