//! Smoothing within surfaces, and removal of what no neighbour supports.

use super::{DepthFilter, NO_CANDIDATE};

/// Neighbours looked at on either side.
const REACH: usize = 2;
/// Standard deviations within which neighbours agree.
const AGREEMENT: f32 = 4.0;

/// The neighbourhood's verdict on a hypothesis.
struct Verdict {
    agreeing: u8,
    disagreeing: u8,
    inverse_depth: f32,
}

impl DepthFilter {
    /// Replaces each converged inverse depth by the weighted mean of its agreeing neighbours, and drops
    /// those with too few of them or with more that disagree.
    ///
    /// Neighbours agree when their difference lies within their variances and
    /// `params.neighbour_tolerance`, so edges between surfaces stay (Engel, Sturm, Cremers, ICCV 2013,
    /// §2.4). The variance stays as it is: neighbours share their errors.
    pub fn regularise(&mut self) {
        let converged: Vec<bool> = (0..self.len()).map(|i| self.is_converged(i)).collect();
        let verdicts: Vec<Option<Verdict>> =
            (0..self.len()).map(|i| converged[i].then(|| self.verdict(i, &converged))).collect();
        for (i, verdict) in verdicts.into_iter().enumerate() {
            let Some(verdict) = verdict else { continue };
            if verdict.agreeing < self.params.min_support || verdict.disagreeing > verdict.agreeing {
                self.successes[i] = 0;
            } else {
                self.inverse_depth[i] = verdict.inverse_depth;
            }
        }
    }

    /// Asks the 5×5 neighbourhood of candidate `i`.
    fn verdict(&self, i: usize, converged: &[bool]) -> Verdict {
        let width = self.camera.width;
        let pixel = self.candidates.pixel[i] as usize;
        let (d, v) = (self.inverse_depth[i], self.variance[i]);
        let tolerance = self.params.neighbour_tolerance * d;
        let mut weight = 1.0 / v.max(f32::MIN_POSITIVE);
        let mut sum = d * weight;
        let mut verdict = Verdict { agreeing: 0, disagreeing: 0, inverse_depth: d };
        // Candidates keep a distance from the border that is larger than the reach.
        let corner = pixel - REACH * width - REACH;
        for row in 0..=2 * REACH {
            let start = corner + row * width;
            for (column, &j) in self.index[start..=start + 2 * REACH].iter().enumerate() {
                let is_self = row == REACH && column == REACH;
                if j == NO_CANDIDATE || is_self || !converged[j as usize] {
                    continue;
                }
                let (dj, vj) = (self.inverse_depth[j as usize], self.variance[j as usize]);
                let difference2 = (dj - d) * (dj - d);
                if difference2 > AGREEMENT * (v + vj) + tolerance * tolerance {
                    verdict.disagreeing += 1;
                    continue;
                }
                verdict.agreeing += 1;
                let inner = row.abs_diff(REACH) <= 1 && column.abs_diff(REACH) <= 1;
                if inner {
                    let w = 1.0 / (vj + difference2);
                    weight += w;
                    sum += w * dj;
                }
            }
        }
        verdict.inverse_depth = sum / weight;
        verdict
    }
}
