//! What adds up, metre after metre, where sweeps tell their place badly: each one looks as if it knew it, and the map that it is held against
//! is of sweeps that knew it no better.

use super::guess::{DOUBTFUL, Guess};
use crate::degeneracy::translations;
use nalgebra::{Matrix3, Matrix6, Vector3};

/// Metres of path whose sweeps err as one: they see the same surfaces, as many as a keyframe stands for.
const CORRELATED: f64 = 1.0;
/// Metres of path over which errors add up: those that drift is stated over. With [`DOUBTFUL`], a path is doubtful whose sweeps tell their
/// place to 0.05 m on average, as single ones are weak.
const WINDOW: f64 = 10.0;
/// A path goes on by so many metres at least, the edge of the smallest voxels: what is at rest trembles, and maps nothing new.
const PIECE: f64 = 0.25;

/// What a path may have drifted along directions that its sweeps tell badly.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Wandering {
    /// Covariance of the drift over [`WINDOW`], m², in the axes of the world.
    covariance: Matrix3<f64>,
    /// The place from which the path goes on.
    from: Option<Vector3<f64>>,
    /// Sum of the covariances of the sweeps since then, and their number.
    since: (Matrix3<f64>, f64),
    /// The mean of those before.
    mean: Matrix3<f64>,
    /// What was added since something was said, m².
    reported: Matrix3<f64>,
    /// Metres that were said, of which those that are guessed may be a part.
    metres: f64,
}

impl Wandering {
    /// After a sweep at a place, with its information on the pose; what is to be said of it besides what is guessed.
    pub(super) fn next(
        &mut self,
        place: &Vector3<f64>,
        information: &Matrix6<f64>,
        mut guess: Guess,
    ) -> Guess {
        if guess.directions == 0 {
            self.since = (self.since.0 + covariance(information, &self.mean), self.since.1 + 1.0);
        } else {
            // Where the velocity carries the pose it is said what that may err by.
            let most = guess.covariance.symmetric_eigenvalues().max().max(f64::MIN_POSITIVE);
            let others = Matrix3::identity() - guess.covariance / most;
            self.covariance = others * self.covariance * others;
            self.since = Default::default();
            // A guess that is reported late tells of metres that were said already.
            guess.metres = (guess.metres - std::mem::take(&mut self.metres)).max(0.0);
        }
        let from = *self.from.get_or_insert(*place);
        let step = place - from;
        let mut added = Matrix3::zeros();
        if step.norm() >= PIECE {
            self.from = Some(*place);
            let (sum, count) = std::mem::take(&mut self.since);
            if count > 0.0 {
                self.mean = sum / count;
                added = self.mean * (step.norm() * CORRELATED);
            }
            self.covariance = self.covariance * (-step.norm() / WINDOW).exp() + added;
        }
        let eigen = self.covariance.symmetric_eigen();
        let doubtful: Vec<Vector3<f64>> = (0..3)
            .filter(|&k| eigen.eigenvalues[k] > DOUBTFUL * DOUBTFUL)
            .map(|k| eigen.eigenvectors.column(k).into_owned())
            .collect();
        if doubtful.is_empty() {
            (self.reported, self.metres) = (Matrix3::zeros(), 0.0);
            return guess;
        }
        // What led here belongs to it.
        self.reported =
            if self.reported == Matrix3::zeros() { self.covariance } else { self.reported + added };
        if guess.directions > 0 {
            return guess;
        }
        let moved = if added == Matrix3::zeros() { Vector3::zeros() } else { step };
        let metres = doubtful.iter().map(|e| e.dot(&moved).powi(2)).sum::<f64>().sqrt();
        self.metres += metres;
        Guess {
            directions: doubtful.len(),
            metres,
            deviation: self.reported.symmetric_eigenvalues().max().sqrt(),
            // Storeys look alike: the larger an error is admitted, the more of them are taken for each other.
            covariance: Matrix3::zeros(),
            open: 0,
        }
    }
}

/// Covariance of a sweep's translation. Along what it does not tell at all it errs as the sweeps before did: in a tunnel these knew it well,
/// and what comes then is guessed.
fn covariance(information: &Matrix6<f64>, before: &Matrix3<f64>) -> Matrix3<f64> {
    let (deviations, axes) = translations(information);
    let told = deviations.map(|deviation| if deviation > DOUBTFUL { 0.0 } else { deviation.powi(2) });
    let open = deviations.map(|deviation| f64::from(u8::from(deviation > DOUBTFUL)));
    let of = |diagonal: [f64; 3]| axes * Matrix3::from_diagonal(&Vector3::from(diagonal)) * axes.transpose();
    of(told) + of(open) * before * of(open)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Information of sweeps that tell the height to so many metres and the rest to 5 mm.
    fn known(height: f64) -> Matrix6<f64> {
        let mut information = Matrix6::identity() * 0.005f64.powi(-2);
        information[(2, 2)] = height.powi(-2);
        information
    }

    /// 20 m of path, half up and half ahead; metres and deviation that are said.
    fn walked(height: f64) -> (f64, f64) {
        let mut wandering = Wandering::default();
        (0..=200).map(|k| Vector3::new(1.0, 0.0, 1.0) * (0.1 * f64::from(k) * 0.5f64.sqrt())).fold(
            (0.0, 0.0),
            |(metres, deviation), place| {
                let said = wandering.next(&place, &known(height), Guess::default());
                (metres + said.metres, f64::max(deviation, said.deviation))
            },
        )
    }

    #[test]
    fn what_each_sweep_tells_badly_adds_up_and_is_reported() {
        let (metres, deviation) = walked(0.07);
        // After 6 m 0.07 m a metre have come to 0.15 m; what is up of the rest is doubtful.
        assert!((metres - 0.7 * 14.0).abs() < 1.0, "{metres}");
        assert!((0.2..0.32).contains(&deviation), "{deviation}");
        assert_eq!(walked(0.04), (0.0, 0.0));
    }

    #[test]
    fn what_is_at_rest_does_not_wander() {
        let mut wandering = Wandering::default();
        for k in 0..2000 {
            let place = Vector3::z() * (0.1 * f64::from(k % 2));
            assert_eq!(wandering.next(&place, &known(0.1), Guess::default()), Guess::default());
        }
    }

    #[test]
    fn what_is_guessed_is_reported_once() {
        let mut wandering = Wandering::default();
        let guess = Guess { directions: 1, metres: 0.1, open: 1, ..Guess::default() };
        for k in 0..200 {
            let place = Vector3::x() * (0.1 * f64::from(k));
            assert_eq!(wandering.next(&place, &Matrix6::zeros(), guess), guess);
        }
    }
}
