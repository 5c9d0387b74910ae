//! Parameters of the direct Sim(3) alignment.

use serde::{Deserialize, Serialize};

/// Parameters of the direct Sim(3) alignment of keyframes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Sim3AlignParams {
    /// Pyramid level to start at, or the coarsest there is. Default 4 (40×30 of 640×480), range 0–8;
    /// coarser widens the basin of convergence (Engel 2014, §3.5).
    pub coarsest_level: usize,
    /// Pyramid level to end at. Default 1, range 0–coarsest; 0 is finer and four times as costly.
    pub finest_level: usize,
    /// Most iterations per level. Default 30, range 1–200.
    pub max_iterations: usize,
    /// A level ends when the relative decrease of the mean energy falls below this. Default 1e-4,
    /// range 1e-6–1e-1; smaller is more exact and slower.
    pub min_relative_decrease: f64,
    /// Standard deviation of the image noise, grey levels. Default 4, range 0.5–20 (Engel 2014: 4).
    pub image_noise: f64,
    /// Huber width of the joint normalised residual, standard deviations. Default 3, range 1–10
    /// (Engel 2014, §3.2).
    pub huber_width: f64,
    /// Floor of the relative standard deviation of an inverse depth. Default 0.01, range 0–0.2: below
    /// it, the slope of a surface within a pixel matters more than the filter's variance.
    pub min_depth_sigma: f64,
    /// How many neighbouring pixels share one independent error; divides the information. Default 30,
    /// range 1–1000; measured so that the error against ground truth fits the covariance.
    pub pixel_correlation: f64,
    /// Fewest source points with depth at a level. Default 60, range 20–10000.
    pub min_points: usize,
    /// Least share of the source's points that must project into the target. Default 0.15, range 0–1.
    pub min_overlap: f32,
    /// Least share of the projected points that must meet a depth in the target. Default 0.1,
    /// range 0–1; without depth the scale is not observed.
    pub min_depth_overlap: f32,
    /// Least share of inliers at the finest level. Default 0.5, range 0–1.
    pub min_inlier_share: f32,
    /// Largest Mahalanobis distance between the alignments both ways, standard deviations.
    /// Default 5, range 1–50: the 99.9 % point of χ² with 7 degrees of freedom is 4.9².
    pub max_reciprocal_error: f64,
}

impl Default for Sim3AlignParams {
    fn default() -> Self {
        Self {
            coarsest_level: 4,
            finest_level: 1,
            max_iterations: 30,
            min_relative_decrease: 1e-4,
            image_noise: 4.0,
            huber_width: 3.0,
            min_depth_sigma: 0.01,
            pixel_correlation: 30.0,
            min_points: 60,
            min_overlap: 0.15,
            min_depth_overlap: 0.1,
            min_inlier_share: 0.5,
            max_reciprocal_error: 5.0,
        }
    }
}
