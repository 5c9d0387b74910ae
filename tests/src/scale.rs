//! Whether a trajectory keeps its scale.

use nalgebra::Vector3;

/// Seconds over which a scale is measured, and seconds from one stretch to the next.
const STRETCH: f64 = 3.0;
const STEP: f64 = 0.5;
/// Metres that a camera spreads in a stretch, at least, for its scale to be known: of a turn on the spot alone nothing is.
const LEAST_SPREAD: f64 = 0.05;

/// Where a frame was found, in any unit, and where it was, metres.
#[derive(Clone, Copy, Debug)]
pub struct FoundAt {
    /// Seconds.
    pub time: f64,
    /// In the unit of the map.
    pub found: Vector3<f64>,
    /// In metres.
    pub truth: Vector3<f64>,
}

/// Largest ratio of the scales of two stretches of three seconds, each over the truth, of frames in order of time, `rate` a second; nothing where
/// no stretch has a scale.
pub fn scale_ratio(frames: &[FoundAt], rate: f64) -> Option<f64> {
    let (first, last) = (frames.first()?.time, frames.last()?.time);
    let scale = |begin: f64| {
        let own = frames.iter().filter(|frame| (begin..begin + STRETCH).contains(&frame.time));
        let (found, truth): (Vec<_>, Vec<_>) = own.map(|frame| (frame.found, frame.truth)).unzip();
        let is_enough = found.len() as f64 > 0.5 * STRETCH * rate && spread(&truth) > LEAST_SPREAD;
        is_enough.then(|| spread(&found) / spread(&truth))
    };
    let begins =
        (0..).map(|i| first + STEP * f64::from(i)).take_while(|begin| begin + STRETCH <= last + STEP);
    let found: Vec<f64> = begins.filter_map(scale).collect();
    let most = found.iter().copied().reduce(f64::max)?;
    let least = found.iter().copied().reduce(f64::min)?;
    Some(most / least)
}

/// Root mean square distance from the mean.
pub fn spread(points: &[Vector3<f64>]) -> f64 {
    let count = points.len() as f64;
    let mean = points.iter().sum::<Vector3<f64>>() / count;
    (points.iter().map(|p| (p - mean).norm_squared()).sum::<f64>() / count).sqrt()
}
