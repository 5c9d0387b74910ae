//! Parameters of the depth filter.

use backend::params;

params! {
    /// Parameters of [`DepthFilter`](super::DepthFilter) and [`choose_references`](super::choose_references).
    pub struct DepthParams {
        /// Smallest intensity gradient of a candidate pixel, grey levels per pixel. Range 2–30: lower gives
        /// more points in weak texture, each less certain (Engel 2013 uses 5).
        pub min_gradient: f32 = 6.0,
        /// Largest share of the image's pixels that become candidates, 0–1; the strongest gradients win.
        /// Range 0.05–0.6: time and density grow with it.
        pub max_candidate_share: f32 = 0.23,
        /// Least standard deviation of image noise assumed, grey levels; the noise itself is learnt from
        /// residuals. Range 0.5–10 (Engel 2014 sets σ_I = 4).
        pub image_noise: f32 = 2.0,
        /// Smallest inverse depth searched where the backbone gives no range, 1/keyframe unit. Above 0, below
        /// `max_inverse_depth`. Range 1e-5–1.
        pub min_inverse_depth: f32 = 0.02,
        /// Largest inverse depth searched where the backbone gives no range, 1/keyframe unit. Above
        /// `min_inverse_depth`; the two limit how far depths may differ from a mean of 1. Range 0.1–1000.
        pub max_inverse_depth: f32 = 4.0,
        /// Factor by which the range of the backbone points around a pixel is widened on either side. Range
        /// 1.05–2: wider finds what no backbone point lies on, and costs time and ambiguity.
        pub range_margin: f32 = 1.15,
        /// How many standard deviations of a hypothesis are searched on either side. Range 1.5–4 (Engel
        /// 2013).
        pub search_sigmas: f32 = 2.0,
        /// Longest epipolar segment searched, pixels; longer ones wait for a nearer reference. Range
        /// 10–100.
        pub max_search: f32 = 100.0,
        /// A second minimum below this multiple of the best one makes a match ambiguous. Range 1.1–3.
        pub uniqueness: f32 = 1.4,
        /// Largest mean squared residual of a match, in units of its expected value from image noise and
        /// discretisation. Range 1.5–6.
        pub max_residual: f32 = 3.0,
        /// Least absolute cosine between gradient and epipolar line. Range 0.1–0.7.
        pub min_alignment: f32 = 0.3,
        /// An observation is made only when its expected variance is below this multiple of the hypothesis'
        /// variance. Range 0.1–10: lower is faster.
        pub worthwhile: f32 = 0.4,
        /// A hypothesis with a standard deviation below this share of its inverse depth is left as it is.
        /// Range 0–0.02: higher is faster.
        pub converged: f32 = 0.004,
        /// Disparity error that more observations do not average out (interpolation, slanted surfaces),
        /// pixels. Range 0–0.5.
        pub systematic_error: f32 = 0.05,
        /// Successful observations a pixel needs to be part of the map. Range 1–6.
        pub min_observations: u8 = 2,
        /// Largest standard deviation of a pixel of the map, as a share of its inverse depth. Range
        /// 0.005–0.2.
        pub max_relative_sigma: f32 = 0.03,
        /// Agreeing neighbours (of the 24 in a 5×5 window) a hypothesis needs to survive regularisation.
        /// Range 0–10.
        pub min_support: u8 = 3,
        /// Difference of inverse depths between neighbours, as a share, that counts as agreement beyond the
        /// variances. Range 0–0.1.
        pub neighbour_tolerance: f32 = 0.02,
        /// Parallax of a usable reference: baseline × mean inverse depth. Range 0.002–0.05.
        pub min_parallax: f32 = 0.01,
        /// Parallax beyond which views differ too much. Range 0.05–0.6.
        pub max_parallax: f32 = 0.35,
        /// Least share of the keyframe seen by a usable reference, 0–1. Range 0.3–0.9.
        pub min_overlap: f32 = 0.45,
        /// Most references per keyframe. Range 2–10: time grows with it.
        pub max_references: usize = 3,
    }
}
