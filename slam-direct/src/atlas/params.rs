//! Parameters of what is done after a loss.

use backend::params;

params! {
    /// Parameters after a loss.
    pub struct AtlasParams {
        /// Seconds without a pose after which a new fragment begins beside the search in the old ones. Range 0.1–5;
        /// with less, the motion blur of one quick rotation makes fragments that relocalisation would have avoided.
        pub begin_after: f64 = 0.5,
        /// Seconds of frames that decide whether a camera that was found after so long a loss, or at the start of a
        /// resumed map, is at that place. Range 0.1–10; a moving camera shows more of the place with more, but makes
        /// keyframes only after the decision.
        pub trial: f64 = 0.5,
        /// Frames between searches in the earlier fragments while a new one is tracked but still young. Range 1–30; each
        /// search costs about as much as tracking five frames.
        #[key = "seek_interval"]
        pub search_interval: usize = 5,
        /// Frames after which the agent adopts the places that features propose for a frame; at least five times
        /// those of mapping. Range 1–30; with fewer the agent waits for the answer, with more it has more frames to
        /// catch up with.
        pub recognition_lag: usize = 5,
        /// Frames after which the agent adopts a map that was made of two fragments; at least ten times those of
        /// mapping. Range 1–60; no keyframes are made meanwhile.
        pub joining_lag: usize = 10,
    }
}
