//! Which times of points are those of a sweep: one that is stale, or of a point that is none, must not decide for all.

/// Longest and shortest sweep that a spinning LiDAR makes, seconds: 50 to 1.5 turns a second.
pub(crate) const SWEEP: (f64, f64) = (0.02, 0.7);
/// So many points are looked at.
const SAMPLE: usize = 2_000;
/// The times of a sweep are those of the shortest interval with so many of the points: a tenth may be anything.
const MOST: f64 = 0.9;
/// Times are the sweep's up to so much before and after that interval, in its lengths: where hardly any points return, more of a sweep
/// lies outside than a tenth.
const BEYOND: f64 = 0.5;

/// The times between which a sweep's lie, for times of any unit, and the length of the sweep; `None` of no times.
pub(crate) fn interval(times: impl ExactSizeIterator<Item = f64>) -> Option<([f64; 2], f64)> {
    let step = times.len().div_ceil(SAMPLE).max(1);
    let mut sample: Vec<f64> = times.step_by(step).filter(|time| time.is_finite()).collect();
    sample.sort_by(f64::total_cmp);
    let kept = ((sample.len() as f64 * MOST).ceil() as usize).max(1);
    let windows = sample.windows(kept).map(|window| [window[0], window[kept - 1]]);
    let [first, last] = windows.min_by(|a, b| (a[1] - a[0]).total_cmp(&(b[1] - b[0])))?;
    let beyond = BEYOND * (last - first);
    let bounds = [first - beyond, last + beyond];
    // Of what lies within, the first and the last are the sweep's ends.
    let within = || sample.iter().filter(|time| (bounds[0]..=bounds[1]).contains(*time));
    let length = within().next_back()? - within().next()?;
    Some((bounds, length))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Times of a sweep of a tenth of a second that begins at `start`.
    fn sweep(start: f64) -> Vec<f64> {
        (0..20_000).map(|i| start + 0.1 * f64::from(i) / 20_000.0).collect()
    }

    #[test]
    fn single_times_do_not_decide() {
        for stale in [-0.1, 0.0, 5.0, f64::NAN, f64::INFINITY, -1.7e9] {
            let mut times = sweep(10.0);
            // A packet of 384 points, as a VLP-16 sends them.
            times[300..684].fill(stale);
            let ([first, last], length) = interval(times.iter().copied()).unwrap();
            assert!((length - 0.1).abs() < 0.001, "{stale}: {length}");
            let is_whole = first > 9.9 && first <= 10.0 && (10.1..10.2).contains(&last);
            assert!(is_whole, "{stale}: {first} {last}");
        }
    }

    #[test]
    fn sweeps_that_see_little_on_one_side_are_whole() {
        // Nine in ten points in half of the turn.
        let times: Vec<f64> = (0..10_000)
            .map(|i| {
                if i < 9_000 {
                    0.05 * f64::from(i) / 9_000.0
                } else {
                    0.05 + 0.05 * f64::from(i - 9_000) / 1_000.0
                }
            })
            .collect();
        let ([_, last], _) = interval(times.iter().copied()).unwrap();
        assert!(times.iter().filter(|time| **time > last).count() < 600);
        assert!(interval([].into_iter()).is_none());
        assert_eq!(interval([3.0, 3.0].into_iter()).unwrap().1, 0.0);
    }
}
