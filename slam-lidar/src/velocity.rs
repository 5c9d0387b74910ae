//! The velocity at which a sensor travels, for where its surroundings do not tell it.
//!
//! What a single sweep says of the velocity errs by metres a second where the sweep says little, and what it said last would be kept all
//! along a tunnel. So the velocity is filtered (constant velocity with white noise of acceleration; Bar-Shalom, Li and Kirubarajan,
//! "Estimation with Applications to Tracking and Navigation", 2001, 6.2): by what each sweep determines of it, against how much carriers
//! change theirs. Where nothing determines it, it stays, and its variance grows with time.

use nalgebra::{Matrix3, Vector3};

/// How much a carrier changes its velocity in a second when nothing happens, standard deviation, m/s: standing passengers accept
/// 0.11–0.15 g of a vehicle (Hoberock, "A survey of longitudinal acceleration comfort studies", 1977), which carriers use a tenth of
/// the time; changes of different seconds are independent.
const CHANGE: f64 = 0.3;
/// What is known of a velocity at first, standard deviation, m/s: the pace of a person on foot.
const FIRST: f64 = 1.5;

/// A velocity in the axes of the world, m/s, and its covariance.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Velocity {
    /// The velocity.
    pub mean: Vector3<f64>,
    /// Its covariance.
    pub covariance: Matrix3<f64>,
}

impl Default for Velocity {
    /// What is known before anything is: what nothing determines later is taken to be at rest.
    fn default() -> Self {
        Self { mean: Vector3::zeros(), covariance: Matrix3::identity() * (FIRST * FIRST) }
    }
}

impl Velocity {
    /// After `seconds` in which nothing was determined.
    pub fn after(&self, seconds: f64) -> Self {
        let covariance = self.covariance + Matrix3::identity() * (CHANGE * CHANGE * seconds.max(0.0));
        Self { covariance, ..*self }
    }

    /// With a displacement over `seconds` between two poses that are known with `information` each (m⁻²) but for what lies
    /// within `open`, the projector on directions that the surroundings leave open.
    ///
    /// Along these neither velocity nor covariance changes: which direction is open is known to a degree, and what is certain beside it would
    /// change the velocity along it by tens of times its own noise.
    pub fn updated(
        &self,
        displacement: &Vector3<f64>,
        information: &Matrix3<f64>,
        open: &Matrix3<f64>,
        seconds: f64,
    ) -> Self {
        let determined = Matrix3::identity() - open;
        let precision = determined * information * determined * (0.5 * seconds * seconds);
        let posterior = self.covariance.try_inverse().and_then(|prior| (prior + precision).try_inverse());
        let Some(posterior) = posterior else { return *self };
        let innovation = displacement / seconds - self.mean;
        let covariance = determined * posterior * determined + open * self.covariance * open;
        Self {
            mean: self.mean + determined * posterior * precision * innovation,
            covariance: (covariance + covariance.transpose()) * 0.5,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_velocity_stays_where_nothing_determines_it_and_its_variance_grows() {
        let true_velocity = Vector3::new(1.5, 0.0, 0.0);
        let mut velocity = Velocity::default();
        for _ in 0..10 {
            let all = Matrix3::identity() * 1e6;
            velocity = velocity.after(0.1).updated(&(true_velocity * 0.1), &all, &Matrix3::zeros(), 0.1);
        }
        assert!((velocity.mean - true_velocity).norm() < 1e-3);
        // From here on the direction ahead is open, known to a degree, and what sweeps claim of it is wrong.
        let mut before = velocity.covariance[(0, 0)];
        for k in 0..100 {
            let along = Vector3::new(1.0, if k % 3 == 0 { 0.02 } else { -0.01 }, 0.0).normalize();
            let claimed = velocity.mean + Vector3::new(-0.5, 0.03 * f64::from(k % 5 - 2), 0.0);
            let (all, open) = (Matrix3::identity() * 1e6, along * along.transpose());
            velocity = velocity.after(0.1).updated(&(claimed * 0.1), &all, &open, 0.1);
            assert!(velocity.covariance[(0, 0)] > before);
            before = velocity.covariance[(0, 0)];
        }
        assert!((velocity.mean.x - 1.5).abs() < 0.05, "{}", velocity.mean);
        assert!((before.sqrt() - CHANGE * 10f64.sqrt()).abs() < 0.05, "{before}: over 10 s");
    }
}
