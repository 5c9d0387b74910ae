//! Length and direction of an image's gradient.

use crate::numbers::direction;
use geometry::Image;

/// The gradient of a blurred image by central differences; zero at the border.
pub struct Gradient {
    /// Length, grey levels in two pixels.
    pub length: Image<f32>,
    /// Direction from x towards y, turns, 0 to 1.
    pub turns: Image<f32>,
}

impl Gradient {
    /// One without pixels, to be filled.
    pub fn empty() -> Self {
        Self { length: Image::filled(0, 0, 0.0), turns: Image::filled(0, 0, 0.0) }
    }

    /// Takes over the gradient of `image`.
    #[inline(always)]
    pub fn fill(&mut self, image: &Image<f32>) {
        let (width, height) = (image.width(), image.height());
        if (self.length.width(), self.length.height()) != (width, height) {
            self.length = Image::filled(width, height, 0.0);
            self.turns = Image::filled(width, height, 0.0);
        }
        let count = width - 2;
        for y in 1..height - 1 {
            let (up, row, down) = (image.row(y - 1), image.row(y), image.row(y + 1));
            let (up, down) = (&up[1..1 + count], &down[1..1 + count]);
            let (left, right) = (&row[..count], &row[2..2 + count]);
            let start = y * width + 1;
            let lengths = &mut self.length.data_mut()[start..start + count];
            let turns = &mut self.turns.data_mut()[start..start + count];
            for i in 0..count {
                let (dx, dy) = (right[i] - left[i], down[i] - up[i]);
                lengths[i] = (dx * dx + dy * dy).sqrt();
                turns[i] = direction(dx, dy);
            }
        }
    }
}
