//! Extrema of the differences of Gaussians, to a fraction of a pixel (Lowe 2004, §3.1, §4).

use super::scale_space::LAYERS;
use geometry::Image;

/// Pixels at an octave's border where none is looked for.
const BORDER: usize = 5;

/// Largest ratio of the principal curvatures: beyond it lies an edge, along which a point slides (Lowe 2004, §4.1).
const LARGEST_RATIO: f32 = 10.0;

/// Most steps from sample to sample in search of the extremum.
const STEPS: usize = 5;

/// An extremum, in an octave's pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Extremum {
    /// Which octave.
    pub octave: usize,
    /// The image of the octave that is nearest in scale, 1 to [`LAYERS`].
    pub layer: usize,
    /// Position, pixels of the octave.
    pub pixel: [f32; 2],
    /// Scale in steps: the blur is σ·2^(scale / [`LAYERS`]).
    pub scale: f32,
    /// Absolute value of the interpolated difference, grey levels.
    pub contrast: f32,
}

/// Appends the extrema of an octave's [`LAYERS`] + 2 differences whose contrast is at least `contrast` grey levels, in
/// order of layer, row and column.
#[inline(always)]
pub fn extrema(octave: usize, differences: &[Image<f32>], contrast: f32, found: &mut Vec<Extremum>) {
    let (width, height) = (differences[0].width(), differences[0].height());
    if width <= 2 * BORDER || height <= 2 * BORDER {
        return;
    }
    let mut flags = vec![0u8; width.next_multiple_of(8)];
    let first = found.len();
    for layer in 1..=LAYERS {
        for y in BORDER..height - BORDER {
            let stack = Stack { differences, layer };
            // Interpolation adds to the contrast of a sample; a half is on the safe side.
            stack.flag(y, 0.5 * contrast, &mut flags);
            for (block, eight) in flags.as_chunks::<8>().0.iter().enumerate() {
                if u64::from_ne_bytes(*eight) == 0 {
                    continue;
                }
                for (x, flag) in (8 * block..).zip(eight) {
                    let inside = (BORDER..width - BORDER).contains(&x);
                    if inside && *flag != 0 && stack.is_extremum(x, y) {
                        found.extend(refined(octave, differences, [x, y, layer], contrast));
                    }
                }
            }
        }
    }
    // Two samples may lead to one extremum.
    let key = |e: &Extremum| (e.layer, e.pixel[1].to_bits(), e.pixel[0].to_bits());
    found[first..].sort_by_key(key);
    let mut kept = first;
    for i in first..found.len() {
        if kept == first || key(&found[kept - 1]) != key(&found[i]) {
            found[kept] = found[i];
            kept += 1;
        }
    }
    found.truncate(kept);
}

/// A difference and its neighbours in scale.
struct Stack<'a> {
    differences: &'a [Image<f32>],
    layer: usize,
}

impl Stack<'_> {
    /// Marks the pixels of row `y` that are beyond `threshold` and extreme among their six nearest neighbours.
    #[inline(always)]
    fn flag(&self, y: usize, threshold: f32, flags: &mut [u8]) {
        let here = &self.differences[self.layer];
        let width = here.width();
        let (row, up, down) = (here.row(y), here.row(y - 1), here.row(y + 1));
        let (below, above) =
            (self.differences[self.layer - 1].row(y), self.differences[self.layer + 1].row(y));
        let count = width - 2;
        let (left, centre, right) = (&row[..count], &row[1..1 + count], &row[2..2 + count]);
        let (up, down) = (&up[1..1 + count], &down[1..1 + count]);
        let (below, above) = (&below[1..1 + count], &above[1..1 + count]);
        let flags = &mut flags[1..1 + count];
        let max = |a: f32, b: f32| if a > b { a } else { b };
        let min = |a: f32, b: f32| if a < b { a } else { b };
        for i in 0..count {
            let v = centre[i];
            let most = max(max(max(left[i], right[i]), max(up[i], down[i])), max(below[i], above[i]));
            let least = min(min(min(left[i], right[i]), min(up[i], down[i])), min(below[i], above[i]));
            flags[i] = u8::from((v > threshold) & (v >= most) | (v < -threshold) & (v <= least));
        }
    }

    /// Whether no one of the 26 neighbours is more extreme.
    fn is_extremum(&self, x: usize, y: usize) -> bool {
        let value = self.differences[self.layer].get(x, y);
        let sign = value.signum();
        self.differences[self.layer - 1..=self.layer + 1].iter().all(|image| {
            (y - 1..=y + 1).all(|y| image.row(y)[x - 1..=x + 1].iter().all(|v| sign * v <= sign * value))
        })
    }
}

/// The extremum near a sample `[x, y, layer]` by a quadratic through its neighbours (Brown & Lowe 2002), unless it is
/// unstable, on an edge, or of less than `contrast` grey levels.
fn refined(octave: usize, differences: &[Image<f32>], start: [usize; 3], contrast: f32) -> Option<Extremum> {
    let (width, height) = (differences[0].width(), differences[0].height());
    let mut at = start;
    for _ in 0..STEPS {
        let local = Quadratic::at(differences, at);
        let step = local.extremum()?;
        if step.iter().all(|s| s.abs() < 0.5) {
            let value = (local.value + 0.5 * dot(local.gradient, step)).abs();
            if value < contrast || local.is_on_edge() {
                return None;
            }
            let pixel = [at[0] as f32 + step[0], at[1] as f32 + step[1]];
            let scale = at[2] as f32 + step[2];
            return Some(Extremum { octave, layer: at[2], pixel, scale, contrast: value });
        }
        for (at, step) in at.iter_mut().zip(step) {
            // Saturates, and then lies outside.
            *at = at.wrapping_add_signed(step.round() as isize);
        }
        let inside = (BORDER..width - BORDER).contains(&at[0])
            && (BORDER..height - BORDER).contains(&at[1])
            && (1..=LAYERS).contains(&at[2]);
        if !inside {
            return None;
        }
    }
    None
}

/// Value, gradient and second derivatives of the differences at a sample, in x, y and scale.
struct Quadratic {
    value: f32,
    gradient: [f32; 3],
    xx: f32,
    yy: f32,
    ss: f32,
    xy: f32,
    xs: f32,
    ys: f32,
}

impl Quadratic {
    fn at(differences: &[Image<f32>], [x, y, layer]: [usize; 3]) -> Self {
        let (below, here, above) = (&differences[layer - 1], &differences[layer], &differences[layer + 1]);
        let value = here.get(x, y);
        let second = |a: f32, b: f32| a + b - 2.0 * value;
        let cross = |a: f32, b: f32, c: f32, d: f32| 0.25 * (a - b - c + d);
        Self {
            value,
            gradient: [
                0.5 * (here.get(x + 1, y) - here.get(x - 1, y)),
                0.5 * (here.get(x, y + 1) - here.get(x, y - 1)),
                0.5 * (above.get(x, y) - below.get(x, y)),
            ],
            xx: second(here.get(x + 1, y), here.get(x - 1, y)),
            yy: second(here.get(x, y + 1), here.get(x, y - 1)),
            ss: second(above.get(x, y), below.get(x, y)),
            xy: cross(
                here.get(x + 1, y + 1),
                here.get(x - 1, y + 1),
                here.get(x + 1, y - 1),
                here.get(x - 1, y - 1),
            ),
            xs: cross(above.get(x + 1, y), above.get(x - 1, y), below.get(x + 1, y), below.get(x - 1, y)),
            ys: cross(above.get(x, y + 1), above.get(x, y - 1), below.get(x, y + 1), below.get(x, y - 1)),
        }
    }

    /// Where the gradient vanishes, from the sample (Lowe 2004, Eq. 3); `None` where it does not.
    fn extremum(&self) -> Option<[f32; 3]> {
        let rows = [[self.xx, self.xy, self.xs], [self.xy, self.yy, self.ys], [self.xs, self.ys, self.ss]];
        let by = |i: usize, j: usize| cross_product(rows[i], rows[j]);
        let (first, second, third) = (by(1, 2), by(2, 0), by(0, 1));
        let determinant = dot(rows[0], first);
        let g = self.gradient;
        // The inverse's columns are the cross products, by the determinant.
        let step: [f32; 3] =
            std::array::from_fn(|i| -(first[i] * g[0] + second[i] * g[1] + third[i] * g[2]) / determinant);
        step.iter().all(|s| s.is_finite()).then_some(step)
    }

    /// Whether one principal curvature is more than [`LARGEST_RATIO`] times the other, or of the other sign (Lowe
    /// 2004, §4.1).
    fn is_on_edge(&self) -> bool {
        let (trace, determinant) = (self.xx + self.yy, self.xx * self.yy - self.xy * self.xy);
        determinant <= 0.0
            || trace * trace * LARGEST_RATIO >= (LARGEST_RATIO + 1.0) * (LARGEST_RATIO + 1.0) * determinant
    }
}

fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn cross_product(a: [f32; 3], b: [f32; 3]) -> [f32; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}
