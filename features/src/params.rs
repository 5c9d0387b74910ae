//! How features are found.

use serde::{Deserialize, Serialize};

/// How features are found.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SiftParams {
    /// Most features of an image, the strongest first. Default 1500; above 0. More find more matches between far
    /// apart views, and cost matching time, which grows with the square.
    pub max_features: usize,
    /// How often the image is halved first. Default 1; 0 to 3. On 640×480 images the whole one gives 1.6 times the
    /// matches and takes four times the 25–40 ms of the halved one; the poses are refined on the whole images later
    /// anyway. (SIFT doubles what it is given: halved once, our own looks at the image as it is.)
    pub halvings: usize,
    /// Least contrast of a key point, as OpenCV counts it. Default 0.02 (OpenCV: 0.04); above 0. Lower finds
    /// weaker features.
    pub contrast: f64,
    /// Where fewer key points have that contrast, the strongest of the others are taken until there are so many. Default
    /// 500; 0 for none. So dark and hazy images have features, and the others stay as they are (ORB-SLAM lowers the
    /// threshold of FAST where a cell has no corner; Mur-Artal et al. 2015). OpenCV's SIFT does not know this.
    pub least_features: usize,
    /// Least contrast of these, in standard deviations of the image's noise. Default 5: an image of nothing but noise has
    /// fewer than one; above 0. Lower takes extrema of noise.
    pub least_deviations: f64,
}

impl Default for SiftParams {
    fn default() -> Self {
        Self { max_features: 1500, halvings: 1, contrast: 0.02, least_features: 500, least_deviations: 5.0 }
    }
}
