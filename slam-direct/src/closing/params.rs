//! Parameters of loop closing.

use crate::loops::LoopParams;
use backend::params;
use backend::posegraph::PoseGraphParams;
use backend::sim3_align::Sim3AlignParams;

params! {
    /// Parameters of loop closing.
    pub struct ClosingParams {
        /// Whether loops are searched at all.
        pub enabled: bool = true,
        /// Least similarity by which appearance proposes a keyframe, in the index's own measure; for thumbnails a
        /// correlation, −1–1. Lower finds more changed views and costs futile attempts. Range 0–1.
        pub min_appearance: f32 = 0.6,
        /// Points two keyframes must share to count as seeing one place already. Range 6–200.
        pub min_shared: usize = 15,
        /// Keyframes for which a place that proved no loop is not tried again. Range 0–100; fewer find a loop sooner
        /// and cost futile attempts.
        pub patience: usize = 5,
        /// Least number of the old side's points that must be found in the keyframe. Range 15–300.
        pub min_matched: usize = 40,
        /// Least share of the searched old points that must be found and agree with one pose, 0–1. Another place of
        /// the same structure shows less. Range 0–1.
        pub min_share: f32 = 0.35,
        /// Largest drift that a loop may reveal, share of the path since the old keyframe. Range 0.01–1: with more
        /// drift it is a place that only looks the same.
        pub max_drift: f64 = 0.15,
        /// Largest drift in scale, as a factor. Range 1.05–10.
        pub max_scale: f64 = 2.0,
        /// Largest drift in orientation, degrees. Range 2–180.
        #[key = "max_turn"]
        pub max_rotation: f64 = 30.0,
        /// Least share of the observations across a closed loop that must remain after the joint optimisation, 0–1. A
        /// loop whose two ends it pulls apart again is rejected. Range 0–1.
        pub min_kept: f32 = 0.8,
        /// Keyframes on each side of the loop that are tested and joined. Range 2–20.
        pub side: usize = 6,
        /// Iterations of the joint optimisation of the whole map after a loop. Range 1–50.
        pub iterations: usize = 8,
        /// Maps of more keyframes than this are optimised around the two ends of the loop only, and the pose graph
        /// moves no keyframe that is older than the loop. The time of a whole optimisation grows with the map. Range
        /// 10–2000.
        pub whole_map: usize = 250,
        /// Candidates and their reciprocal alignment. It starts where patches were found, so a single start,
        /// half the coarseness and little common depth do.
        pub search: LoopParams = LoopParams {
            start_angle: 0.0,
            max_rmse: 60.0,
            align: Sim3AlignParams {
                coarsest_level: 2,
                min_depth_overlap: 0.03,
                ..Sim3AlignParams::default()
            },
            ..LoopParams::default()
        },
        /// The correction of the keyframes.
        pub graph: PoseGraphParams = PoseGraphParams::default(),
    }
}
