//! When a frame becomes a keyframe, and when tracking is lost.

use backend::params;

params! {
    /// Parameters of keyframe selection and loss.
    pub struct KeyframeParams {
        /// Median displacement of the points since the reference keyframe that alone makes a keyframe; share of the
        /// image width. Range 0.01–1.
        pub flow: f32 = 0.18,
        /// The same for the part that the rotation does not explain. Range 0.005–1.
        pub parallax: f32 = 0.06,
        /// Share of the points expected near the reference below which a keyframe is made. Range 0–1.
        pub overlap: f32 = 0.6,
        /// Points found, over the most found against the same reference, below which a keyframe is made at once: the
        /// view changes faster than the map. Range 0–1.
        pub fading: f32 = 0.5,
        /// Share of the searched points found below which a keyframe is made at once: the map has little of the view,
        /// and a frame that is lost next would not be found again (`found_again`). Range 0–1.
        pub known: f32 = 0.3,
        /// Parts of the image that show points, over the most since the reference changed, below which a keyframe is
        /// made at once: a camera that backs away sees new things all around the mapped ones. Range 0–1; 0 switches
        /// this off.
        pub coverage: f32 = 0.75,
        /// Departure from a keyframe with the same view, below which a frame does not become one too. Range 0–1: a
        /// keyframe is made at 1; with 0 the camera makes new ones whenever it returns.
        pub known_view: f32 = 0.5,
        /// A map of at most this many keyframes is given up when it proves useless. Range 2–20.
        pub young_map: usize = 3,
        /// Seconds without a pose after which it is given up; `give_up` is the least number of lost frames in a row.
        /// Range 0.1–3.
        pub give_up_after: f64 = 0.65,
        /// Lost frames in a row after which a young map is given up, at least. Range 3–100.
        pub give_up: usize = 5,
        /// Matched points of known depth below which tracking is lost. Range 6–1000.
        pub min_matched: usize = 30,
        /// Share of searched points that agree with a wrong pose if patches are placed exactly; twice as many do if
        /// they are placed to a pixel only (`track.position_sigma`). Tracking is lost if not significantly more
        /// agree: a fifth of few points, an eighth of many. Range 0.02–0.3.
        pub chance: f32 = 0.07,
        /// Share of searched points that must be matched where a lost frame is found again. Range 0.1–0.9.
        pub found_again: f32 = 0.3,
    }
}

/// What decides about a new keyframe.
pub(crate) struct Departure {
    /// Median flow since the reference, share of the image width.
    pub flow: f32,
    /// Its part without the turn.
    pub parallax: f32,
    /// Points expected now over those expected near the reference.
    pub overlap: f32,
}

impl Departure {
    /// Weighted sum of distance and lost overlap (Engel 2014, §3.3; Engel 2018, §3.2): a keyframe at 1.
    pub fn score(&self, params: &KeyframeParams) -> f32 {
        let lost = (1.0 - self.overlap).max(0.0) / (1.0 - params.overlap);
        self.flow / params.flow + self.parallax / params.parallax + lost
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_cause_alone_makes_a_keyframe() {
        let params = KeyframeParams::default();
        let score = |flow, parallax, overlap| Departure { flow, parallax, overlap }.score(&params);
        assert_eq!(score(0.0, 0.0, 1.0), 0.0);
        assert!((score(params.flow, 0.0, 1.0) - 1.0).abs() < 1e-6);
        assert!((score(0.0, params.parallax, 1.0) - 1.0).abs() < 1e-6);
        assert!((score(0.0, 0.0, params.overlap) - 1.0).abs() < 1e-6);
        assert_eq!(score(0.0, 0.0, 1.7), 0.0, "seeing more than the reference is no loss");
        let half = score(0.5 * params.flow, 0.5 * params.parallax, 1.0);
        assert!((half - 1.0).abs() < 1e-6, "causes add up: {half}");
    }
}
