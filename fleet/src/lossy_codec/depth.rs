//! A keyframe's semi-dense depth, rounded and range coded.
//!
//! Pixel by pixel in memory order: whether it has a depth, given which of those before it around it have; where it has
//! one, the difference of its logarithm from that of those around it, in steps, and likewise of its variance, as a share
//! of the inverse depth's square, in powers of two. Symbols are as probable as they were so far.

use super::{is_usable, of_steps, steps};
use features::codec::range::{Adaptive, Decoder, Encoder};
use geometry::Pinhole;
use map::SemiDense;

/// The version written; others are refused.
const VERSION: u8 = 1;
/// Differences with a symbol of their own; larger ones are written by the number of their bits.
const DIRECT: usize = 24;
/// Most bits of a difference: logarithms of numbers lie within ±21,000 steps.
const MOST_BITS: usize = 17;
/// Logarithm (base 2) of the smallest variance that is told from 0, as a share of the square of the inverse depth: a
/// deviation of a millionth.
const LEAST_VARIANCE: i32 = -40;
/// The largest: a deviation of a thousandfold.
const MOST_VARIANCE: i32 = 20;

/// What is known of a pixel.
#[derive(Clone, Copy)]
struct Cell {
    steps: i32,
    /// 0 stands for a variance of 0.
    class: i32,
}

/// Depth as bytes; pixels outside of the camera's image, and those whose numbers are no inverse depth with a variance,
/// are left out.
pub fn encode(depth: &SemiDense, camera: &Pinhole) -> Vec<u8> {
    let mut encoder = Encoder::new(vec![VERSION]);
    let mut cells = Cells::new(camera);
    let mut model = Model::new();
    let mut samples = depth.iter().filter(is_usable).filter(is_usable_rounded).peekable();
    for y in 0..camera.height {
        for x in 0..camera.width {
            let pixel = y * camera.width + x;
            while samples.next_if(|&(p, ..)| (p as usize) < pixel).is_some() {}
            let cell = samples.next_if(|&(p, ..)| p as usize == pixel).map(|(_, inverse_depth, variance)| {
                Cell { steps: steps(inverse_depth), class: class(inverse_depth, variance) }
            });
            let around = cells.around(x, y);
            model.is_there[around.mask].put(usize::from(cell.is_some()), &mut encoder);
            if let Some(cell) = cell {
                model.steps[around.spread].put(cell.steps - around.steps, &mut encoder);
                model.class.put(cell.class - around.class, &mut encoder);
            }
            cells.set(x, y, cell);
        }
    }
    encoder.finish()
}

/// The inverse of [`encode`], up to what was rounded.
///
/// # Errors
/// When the bytes are too few or too many, or nothing that [`encode`] writes.
pub fn decode(bytes: &[u8], camera: &Pinhole) -> Result<SemiDense, String> {
    let Some((&VERSION, coded)) = bytes.split_first() else {
        return Err("a depth map is of another version".into());
    };
    let mut decoder = Decoder::new(coded);
    let mut cells = Cells::new(camera);
    let mut model = Model::new();
    let mut depth = SemiDense::default();
    for y in 0..camera.height {
        for x in 0..camera.width {
            let around = cells.around(x, y);
            let is_there = model.is_there[around.mask].take(&mut decoder) == 1;
            let mut cell = None;
            if is_there {
                let steps = around.steps + model.steps[around.spread].take(&mut decoder);
                let class = around.class + model.class.take(&mut decoder);
                let inverse_depth = of_steps(steps);
                let variance = variance(inverse_depth, class);
                let sample = ((y * camera.width + x) as u32, inverse_depth, variance);
                if !is_usable(&sample) || !(0..=MOST_VARIANCE - LEAST_VARIANCE + 1).contains(&class) {
                    return Err("a depth map is damaged".into());
                }
                depth.pixel.push(sample.0);
                depth.inverse_depth.push(inverse_depth);
                depth.variance.push(variance);
                cell = Some(Cell { steps, class });
            }
            cells.set(x, y, cell);
        }
        if decoder.missing() > 0 {
            return Err("a depth map is cut short".into());
        }
    }
    if decoder.left() > 0 {
        return Err("a depth map is too long".into());
    }
    Ok(depth)
}

/// Whether numbers of a pixel can be sent as they are when they are rounded.
fn is_usable_rounded(&(pixel, inverse_depth, variance): &(u32, f32, f32)) -> bool {
    let rounded = of_steps(steps(inverse_depth));
    is_usable(&(pixel, rounded, self::variance(rounded, class(inverse_depth, variance))))
}

/// The class of a variance.
fn class(inverse_depth: f32, variance: f32) -> i32 {
    let share = f64::from(variance) / f64::from(inverse_depth).powi(2);
    if share <= 0.0 {
        return 0;
    }
    (share.log2().round() as i32).clamp(LEAST_VARIANCE, MOST_VARIANCE) - LEAST_VARIANCE + 1
}

/// The variance of a class.
fn variance(inverse_depth: f32, class: i32) -> f32 {
    match class {
        0 => 0.0,
        _ => {
            let variance =
                (f64::from(class - 1 + LEAST_VARIANCE).exp2() * f64::from(inverse_depth).powi(2)) as f32;
            // Numbers too small to be exact are none.
            if variance.is_subnormal() { 0.0 } else { variance }
        }
    }
}

/// How probable symbols are.
struct Model {
    /// By which pixels around have a depth.
    is_there: Vec<Adaptive>,
    /// By how much those around differ.
    steps: Vec<Difference>,
    class: Difference,
}

impl Model {
    fn new() -> Self {
        Self {
            is_there: (0..1 << NEIGHBOURS.len()).map(|_| Adaptive::new(2)).collect(),
            steps: (0..SPREADS).map(|_| Difference::new()).collect(),
            class: Difference::new(),
        }
    }
}

/// A difference, written as a symbol or as its bits.
struct Difference {
    symbols: Adaptive,
}

impl Difference {
    fn new() -> Self {
        Self { symbols: Adaptive::new(DIRECT + MOST_BITS + 1) }
    }

    fn put(&mut self, difference: i32, encoder: &mut Encoder) {
        // 0, −1, 1, −2, 2 … as 0, 1, 2, 3, 4 …
        let folded = ((difference << 1) ^ (difference >> 31)) as u32;
        if (folded as usize) < DIRECT {
            return self.symbols.put(folded as usize, encoder);
        }
        let bits = (u32::BITS - folded.leading_zeros()).min(MOST_BITS as u32);
        self.symbols.put(DIRECT + bits as usize, encoder);
        for bit in (0..bits.saturating_sub(1)).rev() {
            encoder.put(features::codec::range::Part::uniform(folded >> bit & 1, 2));
        }
    }

    fn take(&mut self, decoder: &mut Decoder) -> i32 {
        let symbol = self.symbols.take(decoder);
        let mut folded = symbol as u32;
        if symbol >= DIRECT {
            let bits = symbol - DIRECT;
            folded = u32::from(bits > 0);
            for _ in 1..bits {
                folded = folded << 1 | decoder.uniform(2);
            }
        }
        (folded >> 1) as i32 ^ -((folded & 1) as i32)
    }
}

/// Those before a pixel that say whether it has a depth: steps in x and rows up.
const NEIGHBOURS: [(isize, usize); 6] = [(-1, 0), (-2, 0), (-1, 1), (0, 1), (1, 1), (0, 2)];
/// How differences of the pixels around are told apart.
const SPREADS: usize = 6;

/// What those around a pixel tell of it.
struct Around {
    mask: usize,
    steps: i32,
    spread: usize,
    class: i32,
}

/// The rows read so far.
struct Cells {
    width: usize,
    cells: Vec<Option<Cell>>,
    last: Cell,
}

impl Cells {
    fn new(camera: &Pinhole) -> Self {
        let last = Cell { steps: 0, class: 1 - LEAST_VARIANCE };
        Self { width: camera.width, cells: vec![None; camera.width * camera.height], last }
    }

    fn at(&self, x: usize, y: usize, (dx, up): (isize, usize)) -> Option<Cell> {
        let (x, y) = (x.checked_add_signed(dx)?, y.checked_sub(up)?);
        if x < self.width { self.cells[y * self.width + x] } else { None }
    }

    fn set(&mut self, x: usize, y: usize, cell: Option<Cell>) {
        self.cells[y * self.width + x] = cell;
        self.last = cell.unwrap_or(self.last);
    }

    fn around(&self, x: usize, y: usize) -> Around {
        let (mut mask, mut known) = (0, [self.last; NEIGHBOURS.len()]);
        let mut count = 0;
        for (bit, offset) in NEIGHBOURS.into_iter().enumerate() {
            if let Some(cell) = self.at(x, y, offset) {
                mask |= 1 << bit;
                known[count] = cell;
                count += 1;
            }
        }
        let nearest = &known[..count.clamp(1, 2)];
        let mean =
            |of: fn(&Cell) -> i32| nearest.iter().map(of).sum::<i32>().div_euclid(nearest.len() as i32);
        let gap = nearest[0].steps.abs_diff(nearest[nearest.len() - 1].steps);
        let spread = match (count, gap) {
            (0, _) => 0,
            (1, _) => 1,
            (_, 0..=1) => 2,
            (_, 2..=4) => 3,
            (_, 5..=12) => 4,
            _ => SPREADS - 1,
        };
        Around { mask, steps: mean(|cell| cell.steps), spread, class: mean(|cell| cell.class) }
    }
}
