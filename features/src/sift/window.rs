//! A round Gaussian window around a key point.

use crate::numbers::exp;
use std::ops::Range;

/// The weights of a window: as a Gaussian is the product of one along either axis, two tables hold it.
#[derive(Default)]
pub struct Window {
    /// The first row of the window.
    pub top: usize,
    /// The weight of each column of the window.
    pub across: Vec<f32>,
    /// The weight of each row of the window.
    pub down: Vec<f32>,
}

impl Window {
    /// Places the window on `pixel` of an image of `size`: `radius` and standard deviation in pixels. Returns the
    /// columns and rows it covers, inside the image's outermost pixels.
    pub fn place(
        &mut self,
        size: [usize; 2],
        pixel: [f32; 2],
        radius: f32,
        spread: f32,
    ) -> [Range<usize>; 2] {
        let range = |axis: usize| {
            let first = (pixel[axis] - radius).ceil().max(1.0) as usize;
            let last = ((pixel[axis] + radius).floor().max(0.0) as usize).min(size[axis] - 2);
            first..(last + 1).max(first)
        };
        let (columns, rows) = (range(0), range(1));
        fill(&mut self.across, columns.clone(), pixel[0], spread);
        fill(&mut self.down, rows.clone(), pixel[1], spread);
        self.top = rows.start;
        [columns, rows]
    }
}

/// The Gaussian around `centre` at each position. The ratio of neighbours is a geometric series itself, so that three
/// exponentials are enough.
fn fill(weights: &mut Vec<f32>, positions: Range<usize>, centre: f32, spread: f32) {
    let factor = -0.5 / (f64::from(spread) * f64::from(spread));
    let first = positions.start as f64 - f64::from(centre);
    let (mut weight, mut ratio) = (exp(factor * first * first), exp(factor * (2.0 * first + 1.0)));
    let change = exp(2.0 * factor);
    weights.clear();
    for _ in positions {
        weights.push(weight as f32);
        weight *= ratio;
        ratio *= change;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_weights_are_those_of_a_gaussian() {
        let mut window = Window::default();
        let [columns, rows] = window.place([100, 80], [40.3, 2.7], 20.0, 7.0);
        assert_eq!((columns.clone(), rows.clone()), (21..61, 1..23));
        for (x, weight) in columns.zip(&window.across) {
            assert!((f64::from(*weight) - (-0.5 * ((x as f64 - 40.3) / 7.0).powi(2)).exp()).abs() < 1e-6);
        }
        let [columns, rows] = window.place([100, 80], [-30.0, 200.0], 20.0, 7.0);
        assert!(columns.is_empty() && rows.is_empty());
    }
}
