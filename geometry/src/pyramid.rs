//! Image pyramids: each level halves the one below it.

use crate::{GrayImage, Swap};
use std::sync::{Arc, OnceLock};

/// Least side of a level, pixels.
const MIN_SIDE: usize = 16;

/// An image and its successive halvings; level 0 is the image itself.
///
/// The halvings are made when the first of them is used. Copies share them.
#[derive(Clone, Debug)]
pub struct Pyramid {
    base: Arc<GrayImage>,
    levels: usize,
    halvings: Arc<OnceLock<Vec<GrayImage>>>,
}

impl Pyramid {
    /// Up to `levels` levels by 2×2 means; as many as have no side below 16 pixels.
    pub fn new(image: GrayImage, levels: usize) -> Self {
        Self::of(Arc::new(image), levels)
    }

    /// The same of an image that others hold as well.
    pub fn of(base: Arc<GrayImage>, levels: usize) -> Self {
        let (mut side, mut there) = (base.width().min(base.height()), 1);
        while there < levels && side >= 2 * MIN_SIDE {
            (side, there) = (side / 2, there + 1);
        }
        Self { base, levels: there, halvings: Arc::default() }
    }

    /// Gives back the memory of the halved levels, unless a copy needs them, and of an image that is swapped out.
    /// Both are made or read again when they are used.
    pub fn rest(&mut self) {
        self.halvings = Arc::default();
        self.base.rest();
    }

    /// Keeps the image, of which others have no copy yet, where `swap` has room for it.
    pub fn swap_out(&mut self, swap: &dyn Swap) {
        if let Some(base) = self.base.swapped_out(swap) {
            self.base = Arc::new(base);
        }
    }

    /// Whether there are no halvings in memory.
    pub fn is_resting(&self) -> bool {
        self.halvings.get().is_none()
    }

    /// The number of levels there are.
    pub fn len(&self) -> usize {
        self.levels
    }

    /// Never true: a pyramid has its level 0.
    pub fn is_empty(&self) -> bool {
        self.levels == 0
    }

    /// The image at `level`.
    #[inline]
    pub fn level(&self, level: usize) -> &GrayImage {
        match level.checked_sub(1) {
            None => &self.base,
            Some(halving) => &self.halvings.get_or_init(|| self.halved())[halving],
        }
    }

    fn halved(&self) -> Vec<GrayImage> {
        let mut all: Vec<GrayImage> = Vec::with_capacity(self.levels - 1);
        while all.len() + 1 < self.levels {
            all.push(halved(all.last().unwrap_or(&self.base)));
        }
        all
    }

    /// The image at level 0.
    pub fn base(&self) -> &GrayImage {
        &self.base
    }

    /// The image at level 0, to be kept beyond the pyramid without a copy.
    pub fn shared_base(&self) -> Arc<GrayImage> {
        Arc::clone(&self.base)
    }
}

/// Half the size by rounded 2×2 means; an odd last row or column is dropped.
pub fn halved(image: &GrayImage) -> GrayImage {
    let (width, height) = (image.width() / 2, image.height() / 2);
    let mut data = Vec::with_capacity(width * height);
    for y in 0..height {
        let (top, bottom) = (image.row(2 * y), image.row(2 * y + 1));
        data.extend(
            top.chunks_exact(2)
                .zip(bottom.chunks_exact(2))
                .map(|(t, b)| ((t[0] as u16 + t[1] as u16 + b[0] as u16 + b[1] as u16 + 2) / 4) as u8),
        );
    }
    GrayImage::from_vec(width, height, data).expect("one pixel is pushed per 2×2 block")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn halvings_come_back_after_a_rest() {
        let image = GrayImage::from_vec(70, 64, (0..70 * 64).map(|i| (i * 7 % 251) as u8).collect()).unwrap();
        let mut pyramid = Pyramid::new(image.clone(), 5);
        assert!(pyramid.is_resting());
        assert_eq!(pyramid.len(), 3, "a side of 8 pixels would be too small");
        let expected = [image.clone(), halved(&image), halved(&halved(&image))];
        let copy = pyramid.clone();
        for _ in 0..2 {
            assert!(expected.iter().enumerate().all(|(level, image)| pyramid.level(level) == image));
            assert!(!pyramid.is_resting());
            pyramid.rest();
            assert!(pyramid.is_resting());
        }
        assert!(!copy.is_resting(), "a copy keeps what it has");
        assert_eq!(Pyramid::new(GrayImage::filled(20, 31, 0), 5).len(), 1);
    }
}
