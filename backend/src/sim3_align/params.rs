//! Parameters of the direct Sim(3) alignment.

use crate::params;

params! {
    /// Parameters of the direct Sim(3) alignment of keyframes.
    pub struct Sim3AlignParams {
        /// Pyramid level to start at, or the coarsest there is. Range 0–8;
        /// coarser widens the basin of convergence (Engel 2014, §3.5).
        pub coarsest_level: usize = 4,
        /// Pyramid level to end at, none coarser than the first. Range 0–8; 0 is finer and four times as costly.
        pub finest_level: usize = 1,
        /// Most source points used at a level, evenly spread over those with depth. Range 500–1000000;
        /// neighbouring pixels share their errors (`pixel_correlation`), so a third of them says nearly
        /// as much in a third of the time.
        pub max_points: usize = 1_000_000,
        /// Most iterations per level. Range 1–200.
        pub max_iterations: usize = 30,
        /// A level ends when the relative decrease of the mean energy falls below this.
        /// Range 1e-6–1e-1; smaller is more exact and slower.
        pub min_relative_decrease: f64 = 1e-4,
        /// Standard deviation of the image noise, grey levels. Range 0.5–20 (Engel 2014: 4).
        pub image_noise: f64 = 4.0,
        /// Huber width of the joint normalised residual, standard deviations. Range 1–10
        /// (Engel 2014, §3.2).
        pub huber_width: f64 = 3.0,
        /// Floor of the relative standard deviation of an inverse depth. Range 0–0.2: below
        /// it, the slope of a surface within a pixel matters more than the filter's variance.
        pub min_depth_sigma: f64 = 0.01,
        /// How many neighbouring pixels share one independent error; divides the information.
        /// Range 1–1000; measured so that the error against ground truth fits the covariance.
        pub pixel_correlation: f64 = 30.0,
        /// Fewest source points with depth at a level. Range 20–10000.
        pub min_points: usize = 60,
        /// Least share of the source's points that must project into the target. Range 0–1.
        pub min_overlap: f32 = 0.15,
        /// Least share of the projected points that must meet a depth in the target.
        /// Range 0–1; without depth the scale is not observed.
        pub min_depth_overlap: f32 = 0.1,
        /// Least share of inliers at the finest level. Range 0–1.
        pub min_inlier_share: f32 = 0.5,
        /// Largest Mahalanobis distance between the alignments both ways, standard deviations.
        /// Range 1–50: the 99.9 % point of χ² with 7 degrees of freedom is 4.9².
        pub max_reciprocal_error: f64 = 5.0,
    }
}
