//! Image pyramids: each level halves the one below it.

use crate::GrayImage;
use std::sync::Arc;

/// An image and its successive halvings; level 0 is the image itself.
#[derive(Clone, Debug)]
pub struct Pyramid {
    levels: Vec<Arc<GrayImage>>,
}

impl Pyramid {
    /// Builds up to `levels` levels by 2×2 means; stops before a side would fall below 16 pixels.
    pub fn new(image: GrayImage, levels: usize) -> Self {
        Self::of(Arc::new(image), levels)
    }

    /// The same of an image that others hold as well.
    pub fn of(image: Arc<GrayImage>, levels: usize) -> Self {
        let mut all = vec![image];
        while all.len() < levels {
            let last = &all[all.len() - 1];
            if last.width() < 32 || last.height() < 32 {
                break;
            }
            let next = halved(last);
            all.push(Arc::new(next));
        }
        Self { levels: all }
    }

    /// The number of levels there are.
    pub fn len(&self) -> usize {
        self.levels.len()
    }

    /// Never true: a pyramid has its level 0.
    pub fn is_empty(&self) -> bool {
        self.levels.is_empty()
    }

    /// The image at `level`.
    #[inline]
    pub fn level(&self, level: usize) -> &GrayImage {
        &self.levels[level]
    }

    /// The image at level 0.
    pub fn base(&self) -> &GrayImage {
        &self.levels[0]
    }

    /// The image at level 0, to be kept beyond the pyramid without a copy.
    pub fn shared_base(&self) -> Arc<GrayImage> {
        Arc::clone(&self.levels[0])
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
