//! The principal axes of descriptors, and how often their coordinates occur.
//!
//! Made from rendered images by the example `train_basis`; its file is little-endian:
//!
//! | bytes | what |
//! |---|---|
//! | 1 | number of axes K |
//! | 4 | step Δ of the coordinates, `f32` |
//! | 2 · 128 | mean descriptor, 1/256 |
//! | 2 · 128 · K | the axes, of length 1, 1/32767, signed |
//! | 2 · [`SYMBOLS`] · K | of each axis how often each coordinate occurs, −[`MOST`]Δ to [`MOST`]Δ; the sum is [`TOTAL`] |
//!
//! One step serves all axes: that loses least for the bytes, and axes along which descriptors vary less than a step
//! can be left out (reverse water-filling, Cover & Thomas, §10.3.3).

use super::range::Part;
use crate::Descriptor;
use std::sync::OnceLock;

/// The largest coordinate, steps; what is beyond is cut.
pub const MOST: i32 = 20;

/// Different coordinates along an axis.
pub const SYMBOLS: usize = 2 * MOST as usize + 1;

/// Sum of the frequencies of an axis.
pub const TOTAL: u32 = 1 << 14;

/// Parts of [`TOTAL`] of which it is known where to begin to look for a coordinate.
const HINTS: u32 = 256;

/// A coordinate frame for descriptors.
pub struct Basis {
    step: f32,
    mean: [f32; 128],
    /// Of each axis its 128 components.
    axes: Vec<[f32; 128]>,
    /// The same, of each component along all axes.
    components: Vec<f32>,
    /// Of each axis where each coordinate's part of [`TOTAL`] begins, and the end.
    starts: Vec<[u32; SYMBOLS + 1]>,
    /// Of each axis the coordinate whose part holds the begin of each of [`HINTS`] parts.
    hints: Vec<[u8; HINTS as usize]>,
    /// Of each axis what each coordinate stands for.
    values: Vec<[f32; SYMBOLS]>,
}

impl Basis {
    /// The one that comes with loopbox.
    pub fn shipped() -> &'static Self {
        static SHIPPED: OnceLock<Basis> = OnceLock::new();
        let read = || Self::from_bytes(include_bytes!("shipped.basis"));
        SHIPPED.get_or_init(|| read().expect("the basis was built in; a test reads it"))
    }

    fn from_bytes(bytes: &[u8]) -> Option<Self> {
        let (head, rest) = bytes.split_at_checked(5)?;
        let (count, step) = (usize::from(head[0]), f32::from_le_bytes(head[1..].try_into().ok()?));
        let numbers: Vec<[u8; 2]> = rest.as_chunks().0.to_vec();
        if step.is_nan() || step <= 0.0 || rest.len() != 2 * (128 + count * (128 + SYMBOLS)) {
            return None;
        }
        let (mean, numbers) = numbers.split_at(128);
        let (axes, frequencies) = numbers.split_at(128 * count);
        let signed = |bytes: &[u8; 2]| f32::from(i16::from_le_bytes(*bytes)) / 32767.0;
        let axes: Vec<[f32; 128]> =
            axes.as_chunks::<128>().0.iter().map(|axis| axis.each_ref().map(signed)).collect();
        let components = (0..128).flat_map(|i| axes.iter().map(move |axis| axis[i])).collect();
        let mut starts = Vec::with_capacity(count);
        for frequencies in frequencies.as_chunks::<SYMBOLS>().0 {
            let mut of_axis = [0; SYMBOLS + 1];
            for (i, bytes) in frequencies.iter().enumerate() {
                let frequency = u32::from(u16::from_le_bytes(*bytes));
                of_axis[i + 1] = of_axis[i] + frequency;
                if frequency == 0 {
                    return None;
                }
            }
            if of_axis[SYMBOLS] != TOTAL {
                return None;
            }
            starts.push(of_axis);
        }
        let mean = std::array::from_fn(|i| f32::from(u16::from_le_bytes(mean[i])) / 256.0);
        let hints = starts.iter().map(hints).collect();
        let values = starts.iter().map(|starts| values(starts, step)).collect();
        Some(Self { step, mean, axes, components, starts, hints, values })
    }

    /// Number of axes.
    pub fn len(&self) -> usize {
        self.axes.len()
    }

    /// The coordinates of a descriptor along the axes, steps from −[`MOST`] to [`MOST`].
    pub fn coordinates(&self, descriptor: &Descriptor, coordinates: &mut Vec<i32>) {
        coordinates.clear();
        coordinates.resize(self.len(), 0);
        along(self, descriptor, coordinates);
    }

    /// The descriptor at coordinates.
    pub fn descriptor(&self, coordinates: &[i32]) -> Descriptor {
        sum_along(self, coordinates)
    }

    /// The part of a coordinate along an axis.
    pub fn part(&self, axis: usize, coordinate: i32) -> Part {
        let symbol = (coordinate + MOST) as usize;
        let (start, end) = (self.starts[axis][symbol], self.starts[axis][symbol + 1]);
        Part { start, size: end - start, total: TOTAL }
    }

    /// The coordinate along an axis whose part holds a place below [`TOTAL`].
    pub fn coordinate(&self, axis: usize, place: u32) -> (Part, i32) {
        let starts = &self.starts[axis];
        let mut symbol = usize::from(self.hints[axis][(place / (TOTAL / HINTS)) as usize]);
        while starts[symbol + 1] <= place {
            symbol += 1;
        }
        let coordinate = symbol as i32 - MOST;
        (self.part(axis, coordinate), coordinate)
    }
}

geometry::multiversion! {
    /// The mean and what the coordinates add along the axes; saturates at 0 and 255.
    fn sum_along(basis: &Basis, coordinates: &[i32]) -> Descriptor {
        let mut sums = basis.mean;
        for ((axis, values), &coordinate) in basis.axes.iter().zip(&basis.values).zip(coordinates) {
            let length = values[(coordinate + MOST) as usize];
            for (sum, component) in sums.iter_mut().zip(axis) {
                *sum += length * component;
            }
        }
        sums.map(|sum| sum.round() as u8)
    }
}

geometry::multiversion! {
    /// The coordinates along each axis, whole steps.
    fn along(basis: &Basis, descriptor: &Descriptor, coordinates: &mut [i32]) {
        let mut sums = vec![0.0f32; basis.len()];
        let rows = basis.components.chunks_exact(basis.len());
        for ((&value, mean), components) in descriptor.iter().zip(&basis.mean).zip(rows) {
            let value = f32::from(value) - mean;
            for (sum, component) in sums.iter_mut().zip(components) {
                *sum += value * component;
            }
        }
        for (coordinate, sum) in coordinates.iter_mut().zip(&sums) {
            *coordinate = ((sum / basis.step).round() as i32).clamp(-MOST, MOST);
        }
    }
}

/// Where to begin to look for the coordinates of an axis.
fn hints(starts: &[u32; SYMBOLS + 1]) -> [u8; HINTS as usize] {
    std::array::from_fn(|hint| {
        let place = hint as u32 * (TOTAL / HINTS);
        (starts.partition_point(|&start| start <= place) - 1) as u8
    })
}

/// What coordinates stand for: not the middle of their step but its centroid, where the probability along the step is
/// taken as linear between those of its neighbours.
fn values(starts: &[u32; SYMBOLS + 1], step: f32) -> [f32; SYMBOLS] {
    let frequency = |i: usize| if i < SYMBOLS { (starts[i + 1] - starts[i]) as f32 } else { 0.0 };
    std::array::from_fn(|i| {
        let slope = (frequency(i + 1) - frequency(i.wrapping_sub(1))) / (2.0 * frequency(i));
        // Below zero a line would be nothing probable.
        (i as f32 - MOST as f32 + slope.clamp(-2.0, 2.0) / 12.0) * step
    })
}
