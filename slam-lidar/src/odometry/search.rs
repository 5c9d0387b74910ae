//! Sweeps that are not where they should be, and where else they are sought.

use super::{Last, Odometry, STARTING_DOUBT};
use crate::motion::{Sweep, SweepMotion};
use crate::registration::{Prediction, Registration, agreement};
use geometry::{Se3, median};
use nalgebra::Vector6;

/// Sweeps whose median share says how much usually agrees.
const USUAL: usize = 5;
/// A sweep of which a smaller share of the points agrees than this, of what usually does, is not where it should be: the sensor was carried
/// away, or much is missing in between. Drives by robots and a car have 0.87 and more from sweep to sweep, a sensor that was carried 3 m off
/// and turned 0.22.
const SUDDEN: f64 = 0.6;
/// The same of the points that lie where something is mapped: what is not mapped yet contradicts nothing. Ray-cast drives have 0.86 and
/// more, one whose pitch ran away on stairs 0.66.
const CONTRADICTED: f64 = 0.75;
/// A sweep is sought elsewhere as well of which a smaller share than this agrees of those points: one that turned by degrees more than predicted
/// stays in the wrong place, agrees somewhat less, and leads the next one farther astray. Ray-cast drives through halls, streets, offices and
/// corridors have 0.96 and more.
const DOUBTFUL: f64 = 0.95;
/// Turns beyond the expected motion, to either side about each axis of the sensor, at which a sweep is sought, radians; the last one about the
/// upright axis only, about which carriers turn farthest.
const TURNS: [f64; 3] = [0.1, 0.2, 0.4];
/// Of the places where a sweep is sought so many are registered, those where most of its points agree.
const REGISTERED: usize = 4;
/// Another place is believed where so much more of the points agrees, share.
const MARGIN: f64 = 0.02;
/// There it must have this share of the points that agree where it was found first: where little is mapped, little contradicts.
const SEEN: f64 = 0.9;
/// What a place that is sought may err by, standard deviation in metres and radians: half of the step between two turns and more.
const REACH: (f64, f64) = (0.25, 0.1);

impl Odometry {
    /// Remembers how much agreed.
    pub(super) fn learn_shares(&mut self, found: &Registration) {
        self.shares.push_back((found.inlier_share, found.agreement()));
        if self.shares.len() > USUAL {
            self.shares.pop_front();
        }
    }

    /// How much of a sweep agrees, of all its points and of those that could, as shares of what usually does; none at the begin.
    fn of_usual(&self, found: &Registration) -> Option<(f64, f64)> {
        let usual = |of: fn(&(f64, f64)) -> f64| {
            let mut shares: Vec<f32> = self.shares.iter().map(|share| of(share) as f32).collect();
            median(&mut shares).filter(|_| self.shares.len() == USUAL).map(f64::from)
        };
        Some((found.inlier_share / usual(|share| share.0)?, found.agreement() / usual(|share| share.1)?))
    }

    /// Whether so much less agrees than did in the sweeps before that the sensor is somewhere else.
    pub(super) fn is_lost(&self, found: &Registration) -> bool {
        let contradicts = |known: f64| self.seeks && known < CONTRADICTED;
        self.of_usual(found).is_some_and(|(all, known)| all < SUDDEN || contradicts(known))
    }

    /// Whether the sensor may be somewhere else.
    pub(super) fn is_doubtful(&self, found: &Registration) -> bool {
        self.seeks && self.of_usual(found).is_some_and(|(all, known)| all < SUDDEN || known < DOUBTFUL)
    }

    /// Seeks a sweep elsewhere than it was found: turned about any axis, at rest, and turning no more; the best of what is found.
    pub(super) fn search(&self, sweep: &Sweep, last: &Last, before: Registration) -> Registration {
        let is_lost = self.is_lost(&before);
        // A sensor that is lost is where most is found again; otherwise what is not mapped yet speaks for no other place.
        let score = |found: &Registration| if is_lost { found.support } else { found.supported() };
        let predicted = self.predict(sweep, last, STARTING_DOUBT);
        let begin = (predicted.begin.0.hypot(REACH.0), predicted.begin.1.hypot(REACH.1));
        let mut best = before;
        let mut least = score(&before) + MARGIN;
        for motion in self.places(sweep, last, &predicted.motion) {
            let found = self.register(sweep, last, &Prediction { motion, begin, ..predicted });
            if score(&found) > least && found.inlier_share > SEEN * before.inlier_share {
                least = score(&found);
                best = found;
            }
        }
        best
    }

    /// Motions at which most of a sweep's points agree, of those that are tried.
    fn places(&self, sweep: &Sweep, last: &Last, predicted: &SweepMotion) -> Vec<SweepMotion> {
        let middle = last.motion.middle();
        let mut straight = last.twist * (sweep.instants.1 - sweep.instants.0);
        straight.fixed_rows_mut::<3>(3).fill(0.0);
        let expected = [
            *predicted,
            SweepMotion::resting(predicted.begin),
            SweepMotion::resting(middle),
            SweepMotion { begin: middle, end: middle * Se3::exp(&straight) },
        ];
        let kernel = 2.0 * self.params.registration.kernel;
        let mut tried: Vec<(f64, SweepMotion)> = Vec::new();
        for turn in turns() {
            for motion in expected {
                let motion = SweepMotion { begin: motion.begin * turn, end: motion.end * turn };
                tried.push((agreement(sweep, &self.kept, &self.map, &motion, kernel), motion));
            }
        }
        tried.sort_by(|a, b| b.0.total_cmp(&a.0));
        tried.into_iter().take(REGISTERED).map(|(_, motion)| motion).collect()
    }
}

/// No turn, and all of [`TURNS`].
fn turns() -> Vec<Se3> {
    let mut turns = vec![Se3::identity()];
    for axis in 0..3 {
        for angle in TURNS.iter().take(if axis == 2 { 3 } else { 2 }) {
            turns.extend([1.0, -1.0].map(|sign| {
                let mut turn = Vector6::zeros();
                turn[3 + axis] = sign * angle;
                Se3::exp(&turn)
            }));
        }
    }
    turns
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::odometry::OdometryParams;

    /// A sweep of which so many points agree, of so many that lie where something is mapped.
    fn found(inlier_share: f64, known_share: f64) -> Registration {
        let motion = SweepMotion::resting(Se3::identity());
        Registration { inlier_share, known_share, ..Registration::unknown(motion) }
    }

    #[test]
    fn what_is_not_mapped_yet_contradicts_nothing() {
        let mut odometry = Odometry::new(OdometryParams::default());
        let judged = |odometry: &Odometry, inliers: f64, known: f64| {
            (odometry.is_doubtful(&found(inliers, known)), odometry.is_lost(&found(inliers, known)))
        };
        for _ in 0..USUAL {
            assert_eq!(judged(&odometry, 0.1, 0.9), (false, false), "nothing is usual yet");
            odometry.learn_shares(&found(0.85, 0.9));
        }
        assert_eq!(judged(&odometry, 0.84, 0.9), (false, false));
        // Around a corner a third of the points lies where nothing is mapped.
        assert_eq!(judged(&odometry, 0.56, 0.6), (false, false));
        // As many agree, and the others lie beside what is mapped.
        assert_eq!(judged(&odometry, 0.56, 0.9), (true, true));
        assert_eq!(judged(&odometry, 0.75, 0.9), (true, false));
        // Hardly anything of the map is there.
        assert_eq!(judged(&odometry, 0.3, 0.3), (true, true));
    }

    #[test]
    fn a_sweep_is_searched_for_about_every_axis_to_either_side() {
        let turned: Vec<[f64; 3]> = turns().iter().map(|turn| turn.rotation.scaled_axis().into()).collect();
        assert!(
            turned
                .iter()
                .all(|turn| turned.iter().any(|other| (0..3).all(|i| (turn[i] + other[i]).abs() < 1e-12)))
        );
        let most = |axis: usize| turned.iter().map(|turn| turn[axis]).fold(0.0, f64::max);
        assert!(
            (0..3).all(|axis| (most(axis) - TURNS[if axis == 2 { 2 } else { 1 }]).abs() < 1e-12),
            "{turned:?}"
        );
    }
}
