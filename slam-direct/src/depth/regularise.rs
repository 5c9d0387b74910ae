//! Smoothing within surfaces, and removal of what no neighbour supports.

use super::DepthFilter;

/// Neighbours looked at on either side.
const REACH: usize = 2;
/// Squared difference within which neighbours agree, in their summed variances.
const AGREEMENT: f32 = 4.0;

/// The converged hypotheses as images, zero for none.
struct Dense {
    width: usize,
    inverse_depth: Vec<f32>,
    information: Vec<f32>,
}

impl DepthFilter {
    /// Replaces each converged inverse depth by the weighted mean of its agreeing neighbours, and drops
    /// those with too few of them or with more that disagree.
    ///
    /// Neighbours agree when their difference lies within their variances and
    /// `params.neighbour_tolerance`, so edges between surfaces stay (Engel, Sturm, Cremers, ICCV 2013,
    /// §2.4). The variance stays as it is: neighbours share their errors.
    pub fn regularise(&mut self) {
        let pixels = self.camera.width * self.camera.height;
        let mut dense = Dense {
            width: self.camera.width,
            inverse_depth: vec![0.0; pixels],
            information: vec![0.0; pixels],
        };
        let converged: Vec<usize> = (0..self.len()).filter(|&i| self.is_converged(i)).collect();
        for &i in &converged {
            let pixel = self.candidates.pixel[i] as usize;
            dense.inverse_depth[pixel] = self.inverse_depth[i];
            dense.information[pixel] = 1.0 / self.variance[i].max(f32::MIN_POSITIVE);
        }
        for &i in &converged {
            let pixel = self.candidates.pixel[i] as usize;
            let tolerance = self.params.neighbour_tolerance * self.inverse_depth[i];
            // Neighbours are about as certain as the pixel itself.
            let limit = (2.0 * AGREEMENT * self.variance[i] + tolerance * tolerance).sqrt();
            if dense.is_supported(pixel, limit, self.params.min_support) {
                self.inverse_depth[i] = dense.smoothed(pixel, limit);
            } else {
                self.successes[i] = 0;
            }
        }
    }
}

impl Dense {
    /// Whether at least `least` of the 5×5 neighbours agree with `pixel` to `limit`, and more than disagree.
    ///
    /// Candidates keep a distance from the border that is larger than the reach.
    #[inline]
    fn is_supported(&self, pixel: usize, limit: f32, least: u8) -> bool {
        let d = self.inverse_depth[pixel];
        let (mut consistent, mut present) = (0u32, 0u32);
        for row in 0..=2 * REACH {
            let start = pixel + row * self.width - REACH * (self.width + 1);
            for &neighbour in &self.inverse_depth[start..start + 2 * REACH + 1] {
                consistent += ((neighbour - d).abs() <= limit) as u32;
                present += (neighbour > 0.0) as u32;
            }
        }
        // Both counts hold the pixel itself.
        consistent > least as u32 && 2 * (consistent - 1) >= present - 1
    }

    /// The mean of the agreeing 3×3 neighbours, weighted by information.
    #[inline]
    fn smoothed(&self, pixel: usize, limit: f32) -> f32 {
        let d = self.inverse_depth[pixel];
        let (mut sum, mut weight) = (0.0, 0.0);
        for row in 0..3 {
            let start = pixel + row * self.width - self.width - 1;
            let depths = &self.inverse_depth[start..start + 3];
            for (&neighbour, &information) in depths.iter().zip(&self.information[start..start + 3]) {
                let w = if (neighbour - d).abs() <= limit { information } else { 0.0 };
                sum += w * (neighbour - d);
                weight += w;
            }
        }
        d + sum / weight
    }
}
