//! The semi-dense depth of a keyframe at one pyramid level.

use map::SemiDense;

/// A pixel with inverse depth.
#[derive(Clone, Copy, Debug)]
pub(super) struct DepthPoint {
    /// Column.
    pub x: u16,
    /// Row.
    pub y: u16,
    /// Inverse depth, 1/keyframe unit.
    pub inverse_depth: f32,
    /// Its variance.
    pub variance: f32,
}

/// Points of one level in memory order, with a grid to find them by pixel.
pub(super) struct LevelDepth {
    /// The points.
    pub points: Vec<DepthPoint>,
    width: usize,
    /// Index into `points` plus one, 0 for none.
    slots: Vec<u32>,
}

impl LevelDepth {
    /// The point at a pixel inside the image.
    #[inline]
    pub(super) fn at(&self, x: usize, y: usize) -> Option<&DepthPoint> {
        let slot = self.slots[y * self.width + x];
        (slot != 0).then(|| &self.points[slot as usize - 1])
    }

    fn from_points(width: usize, height: usize, points: Vec<DepthPoint>) -> Self {
        let mut slots = vec![0; width * height];
        for (i, point) in points.iter().enumerate() {
            slots[point.y as usize * width + point.x as usize] = i as u32 + 1;
        }
        Self { points, width, slots }
    }

    /// The points of the full image; pixels outside of it and depths or variances that are not positive and finite are left out.
    pub(super) fn base(width: usize, height: usize, semi_dense: &SemiDense) -> Self {
        let positive = |v: f32| v.is_finite() && v > 0.0;
        let points = semi_dense
            .iter()
            .filter(|&(pixel, d, v)| (pixel as usize) < width * height && positive(d) && positive(v))
            .map(|(pixel, inverse_depth, variance)| DepthPoint {
                x: (pixel as usize % width) as u16,
                y: (pixel as usize / width) as u16,
                inverse_depth,
                variance,
            })
            .collect();
        Self::from_points(width, height, points)
    }

    /// The next level: variance-weighted means over 2×2 blocks. Neighbours share their errors, so
    /// the variance does not fall with their number; it grows with their disagreement.
    pub(super) fn halved(&self, width: usize, height: usize) -> Self {
        let mut points = Vec::with_capacity(self.points.len() / 2);
        for y in 0..height {
            for x in 0..width {
                let (mut n, mut weights, mut mean, mut square) = (0.0f64, 0.0f64, 0.0f64, 0.0f64);
                for (dx, dy) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
                    if let Some(p) = self.at(2 * x + dx, 2 * y + dy) {
                        let (d, weight) = (p.inverse_depth as f64, 1.0 / p.variance as f64);
                        n += 1.0;
                        weights += weight;
                        mean += weight * d;
                        square += weight * d * d;
                    }
                }
                if n > 0.0 {
                    mean /= weights;
                    let spread = (square / weights - mean * mean).max(0.0);
                    points.push(DepthPoint {
                        x: x as u16,
                        y: y as u16,
                        inverse_depth: mean as f32,
                        variance: (n / weights + spread) as f32,
                    });
                }
            }
        }
        Self::from_points(width, height, points)
    }
}
