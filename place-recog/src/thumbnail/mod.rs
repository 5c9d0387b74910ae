//! A simple index by appearance: small blurred images compared by correlation, as in PTAM's
//! relocaliser (Klein & Murray, ECCV 2008, §3).
//!
//! A query is compared with every keyframe that its coarse values let be among the best; what survives is compared again under small
//! shifts and turns of the image. It finds views taken from near the old ones, not old places seen from afar.

mod descriptor;
#[cfg(test)]
mod real_data;
#[cfg(test)]
mod tests;

use descriptor::{Coarse, LENGTH, Thumbnail};
use geometry::GrayImage;
use map::{KeyframeId, PlaceCandidate, PlaceIndex};
use serde::{Deserialize, Serialize};

/// Parameters of the thumbnail index.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ThumbnailParams {
    /// How many candidates of the first pass, per one asked for, are compared under shifts and
    /// turns. Default 6, range 1–100; more finds more turned views and costs a few µs each.
    pub refined_per_result: usize,
    /// Shift tried to each side, thumbnail pixels of 1/40 image width. Default 3, range 0–10.
    pub shift: f32,
    /// In-plane turn tried to each side, degrees. Default 10, range 0–45.
    #[serde(rename = "turn")]
    pub rotation: f32,
    /// Least correlation of a candidate, −1…1. Default 0.3; lower returns more false candidates.
    pub min_score: f32,
}

impl Default for ThumbnailParams {
    fn default() -> Self {
        Self { refined_per_result: 6, shift: 3.0, rotation: 10.0, min_score: 0.3 }
    }
}

/// Index of keyframes by 40×30 blurred thumbnails: 2,600 bytes a keyframe.
///
/// The score is the zero-mean normalised correlation, best over small shifts and turns: 1 for the
/// same image, whatever its brightness and contrast. Results are the same on any machine; equal
/// scores are ordered by keyframe.
#[derive(Clone, Debug, Default)]
pub struct ThumbnailIndex {
    params: ThumbnailParams,
    keyframes: Vec<KeyframeId>,
    /// One after the other, `LENGTH` numbers each.
    thumbnails: Vec<i16>,
    coarse: Vec<Coarse>,
}

impl ThumbnailIndex {
    /// An empty index.
    pub fn new(params: ThumbnailParams) -> Self {
        Self { params, ..Default::default() }
    }

    /// The number of keyframes in it.
    pub fn len(&self) -> usize {
        self.keyframes.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.keyframes.is_empty()
    }

    fn thumbnail(&self, index: usize) -> &[i16] {
        &self.thumbnails[index * LENGTH..(index + 1) * LENGTH]
    }

    /// `(score, index)` of all keyframes under the best of the variants, best first.
    fn ranked(&self, variants: &[Thumbnail], among: impl Iterator<Item = usize>) -> Vec<(f32, usize)> {
        let score = |index: usize| {
            let stored = self.thumbnail(index);
            variants.iter().map(|v| v.correlation(stored)).fold(-1.0, f32::max)
        };
        let mut ranked: Vec<(f32, usize)> = among.map(|index| (score(index), index)).collect();
        self.rank(&mut ranked);
        ranked
    }

    /// Best first, of equals the keyframe of smallest id.
    fn rank(&self, scored: &mut [(f32, usize)]) {
        scored
            .sort_unstable_by(|a, b| b.0.total_cmp(&a.0).then(self.keyframes[a.1].cmp(&self.keyframes[b.1])));
    }

    /// The `count` best of these keyframes by [`ranked`](Self::ranked), the others not looked at where their coarse values suffice.
    fn best(&self, query: &Thumbnail, among: impl Iterator<Item = usize>, count: usize) -> Vec<(f32, usize)> {
        let coarse = query.coarse();
        let mut bounds: Vec<(f32, usize)> =
            among.map(|index| (coarse.bound(&self.coarse[index]), index)).collect();
        let wanted = count.min(bounds.len());
        if (1..bounds.len()).contains(&wanted) {
            bounds.select_nth_unstable_by(wanted - 1, |a, b| b.0.total_cmp(&a.0));
        }
        // As many as are wanted say what the others must reach.
        let (likeliest, others) = bounds.split_at(wanted);
        let variants = std::slice::from_ref(query);
        let mut best = self.ranked(variants, likeliest.iter().map(|(_, index)| *index));
        let Some(&(least, _)) = best.last() else { return best };
        let others = others.iter().filter(|(bound, _)| *bound >= least);
        best.extend(self.ranked(variants, others.map(|(_, index)| *index)));
        self.rank(&mut best);
        best.truncate(count);
        best
    }
}

impl PlaceIndex for ThumbnailIndex {
    fn clear(&mut self) {
        self.keyframes.clear();
        self.thumbnails.clear();
        self.coarse.clear();
    }

    /// Adds a keyframe, or replaces its image. An image without contrast is never found.
    fn add(&mut self, keyframe: KeyframeId, image: &GrayImage) {
        let thumbnail = Thumbnail::new(image);
        match self.keyframes.iter().position(|&id| id == keyframe) {
            Some(i) => {
                self.thumbnails[i * LENGTH..(i + 1) * LENGTH].copy_from_slice(thumbnail.values());
                self.coarse[i] = thumbnail.coarse();
            }
            None => {
                self.keyframes.push(keyframe);
                self.thumbnails.extend_from_slice(thumbnail.values());
                self.coarse.push(thumbnail.coarse());
            }
        }
    }

    fn query_among(
        &self,
        image: &GrayImage,
        count: usize,
        admissible: &dyn Fn(KeyframeId) -> bool,
    ) -> Vec<PlaceCandidate> {
        let Some(straight) = Thumbnail::new(image).with_contrast() else { return Vec::new() };
        let among = (0..self.len()).filter(|&index| admissible(self.keyframes[index]));
        let survivors = count.saturating_mul(self.params.refined_per_result.max(1));
        let first_pass = self.best(&straight, among, survivors);
        let variants = straight.variants(self.params.shift, self.params.rotation.to_radians());
        let refined = self.ranked(&variants, first_pass.into_iter().map(|(_, index)| index));
        refined
            .into_iter()
            .take_while(|&(score, _)| score >= self.params.min_score)
            .take(count)
            .map(|(score, index)| PlaceCandidate { keyframe: self.keyframes[index], score })
            .collect()
    }
}
