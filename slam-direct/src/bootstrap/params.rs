//! Parameters of the first map.

use backend::params;

params! {
    /// Parameters of the start.
    pub struct BootstrapParams {
        /// Side of the blocks that get one followed point each, pixels. Range 4–200.
        pub block: usize = 16,
        /// Median displacement of the points, without the rotation, that is worth an attempt; share of the image
        /// width. Range 0.001–0.2.
        pub min_parallax: f32 = 0.008,
        /// Share of the points that must still be followed; with less the start begins anew. Range 0.05–1.
        pub min_followed: f32 = 0.3,
        /// Seconds after which the start begins anew. Range 1–10; with less, slow cameras never move enough.
        pub max_seconds: f64 = 2.0,
        /// Least frames before the start begins anew, for cameras with a low rate. Range 10–100.
        pub least_frames: usize = 60,
        /// Median standard deviation of the inverse depths, relative to them, that a good start has. Range 0.01–0.5.
        pub max_relative_sigma: f64 = 0.08,
        /// Share of the points that must agree with the solution. Range 0.1–1.
        pub min_inliers: f64 = 0.55,
        /// The first map is checked again each time the parallax has grown by this factor. Range 1.05–2.
        pub look_again: f32 = 1.25,
        /// The solution of such a check contradicts the map if the map's poses cost this many times as much. Range
        /// 1.1–2; right maps cost up to 1.17 times as much (hand-held, rolling shutter), wrong ones soon more than
        /// that.
        pub contradiction: f64 = 1.15,
        /// A contradiction also needs another direction of travel, by this angle, degrees. Range 5–45; right maps
        /// differ by up to 5, wrong ones, which take a rotation for a translation, by more than 25.
        pub other_direction: f64 = 20.0,
    }
}
