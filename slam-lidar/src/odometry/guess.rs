//! What of a motion is guessed: along directions that the surroundings leave open the sensor keeps its velocity.

use super::{LOOKED_AT, Last, Odometry};
use crate::degeneracy::{WEAK_TRANSLATION, translation_information, translations};
use crate::motion::Sweep;
use crate::registration::{Asked, Registration};
use crate::velocity::Velocity;
use geometry::Se3;
use nalgebra::{Matrix3, Matrix6, UnitQuaternion, Vector3};

/// What of the motion since the sweep before is guessed, or told so badly that what it errs by has added up.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Guess {
    /// Directions of the translation, of three, that are doubtful; 0 where nothing is.
    pub directions: usize,
    /// Of these, as many as the points of the sweep leave open. Of the others each sweep tells something.
    pub open: usize,
    /// Metres of the translation along them.
    pub metres: f64,
    /// What all that was guessed since the last pose that was determined may err by, standard deviation, metres: a velocity that is wrong
    /// is wrong all along, so deviations of sweeps add up.
    pub deviation: f64,
    /// What is added to the variance of the pose since the sweep before, in the axes of the world, m²: these add up to the square of
    /// `deviation`.
    pub covariance: Matrix3<f64>,
}

/// Standard deviation above which a pose is reported as guessed, metres: the error up to which maps of buildings count as right.
pub(super) const DOUBTFUL: f64 = 0.15;
/// What is reported as guessed is so until all is known to this share of [`WEAK_TRANSLATION`], or to all of it for so many seconds: normals
/// that lean by more than is expected of them claim to know a tunnel's axis for single sweeps.
const DETERMINED: (f64, f64) = (0.5, 1.0);

/// What is guessed from sweep to sweep, since the last pose that was determined.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Guessing {
    /// What the pose may err by, standard deviation, metres.
    deviation: f64,
    /// Of that, what was reported.
    reported: f64,
    /// Metres that were not reported yet.
    metres: f64,
    /// Seconds for which no direction was known worse than [`WEAK_TRANSLATION`].
    known: f64,
    /// How far the velocity would have led beyond what was found while nothing was reported, metres, in the axes of the world.
    behind: Vector3<f64>,
    /// Whether all of the motion was determined once, so that there is a velocity to keep.
    has_velocity: bool,
    /// Whether voxels' ends are asked nothing: from where what is guessed was reported, until a sweep tells its place so well that they hardly
    /// count. Behind a tunnel they hold a sensor back that sees the end of it.
    is_wary: bool,
}

impl Guessing {
    /// Whether what is guessed is reported.
    fn is_reported(&self) -> bool {
        self.reported > 0.0
    }

    /// Which axes of voxels are asked.
    pub(super) fn asked(&self) -> Asked {
        if self.is_wary { Asked::Uncut } else { Asked::All }
    }

    /// Whether the sensor is taken to keep its velocity.
    fn is_carried(&self) -> bool {
        self.is_reported() && self.has_velocity
    }

    /// Directions of the translation, unit vectors in the axes of the world, that points with this information leave open.
    fn open(&self, information: &Matrix6<f64>) -> Vec<Vector3<f64>> {
        let (deviations, vectors) = translations(information);
        let is_strict = self.is_reported() && self.known < DETERMINED.1;
        let bound = WEAK_TRANSLATION * if is_strict { DETERMINED.0 } else { 1.0 };
        (0..3).filter(|&k| deviations[k] > bound).map(|k| vectors.column(k).into_owned()).collect()
    }

    /// After a sweep of which `metres` along `open` are guessed, where the velocity led `missed` beyond what was found and may err by
    /// `deviation`; what is to be reported of it. Nothing is while the sweep tells where in the map it is to less than what maps may err by.
    fn next(&mut self, open: &[Vector3<f64>], guessed: Guessed) -> Guess {
        if open.is_empty() {
            *self = Self { known: self.known, is_wary: self.is_wary, has_velocity: true, ..Self::default() };
            return Guess::default();
        }
        // A velocity that is wrong is wrong all along.
        self.deviation += guessed.deviation;
        self.metres += guessed.metres;
        self.behind += guessed.missed;
        if self.is_reported() {
            self.behind = Vector3::zeros();
        } else if guessed.found < self.deviation {
            (self.deviation, self.metres, self.behind) = (guessed.found, 0.0, Vector3::zeros());
        }
        if self.deviation <= DOUBTFUL {
            return Guess::default();
        }
        let added = self.deviation.powi(2) - self.reported.powi(2);
        self.reported = self.deviation;
        Guess {
            directions: open.len(),
            open: open.len(),
            metres: std::mem::take(&mut self.metres),
            deviation: self.deviation,
            covariance: open.iter().map(|e| e * e.transpose() * added).sum(),
        }
    }
}

/// Of a sweep's motion along open directions.
#[derive(Clone, Copy, Debug, Default)]
struct Guessed {
    /// Metres.
    metres: f64,
    /// What the velocity leads astray, standard deviation, metres.
    deviation: f64,
    /// How far the velocity leads beyond what was found, metres, in the axes of the world.
    missed: Vector3<f64>,
    /// Standard deviation to which the sweep tells where in the map it is, metres.
    found: f64,
}

impl Odometry {
    /// A motion that was found, where it is guessed as the sensor's velocity has it along directions that the points leave open (the
    /// remapping of Zhang, Kaess and Singh, "On degeneracy of optimization-based state estimation problems", 2016).
    pub(super) fn carried(&self, sweep: &Sweep, last: &Last, found: Registration) -> Registration {
        let Some(velocity) = self.velocity.filter(|_| self.guessing.is_carried()) else { return found };
        let open = self.guessing.open(&found.information);
        let velocity = turned(&velocity, &last.motion.middle(), &found.motion.middle(), &open);
        let begin =
            last.motion.end.translation + velocity.mean * self.gap(sweep, last) + self.guessing.behind;
        let end = begin + velocity.mean * (sweep.instants.1 - sweep.instants.0);
        let mut motion = found.motion;
        for e in &open {
            motion.begin.translation += e * e.dot(&(begin - motion.begin.translation));
            motion.end.translation += e * e.dot(&(end - motion.end.translation));
        }
        Registration { motion, ..found }
    }

    /// What is guessed of a sweep's motion, and what it tells of the velocity.
    pub(super) fn guess(&mut self, sweep: &Sweep, found: &Registration) -> Guess {
        let Some(last) = self.last else { return Guess::default() };
        let seconds = (sweep.middle() - last.middle).max(1e-3);
        let (middle, before) = (found.motion.middle(), last.motion.middle());
        let step = middle.translation - before.translation;
        let open = self.guessing.open(&found.information);
        let velocity = self.velocity.unwrap_or_default();
        let velocity = turned(&velocity, &before, &middle, &open).after(seconds);
        let along = |e: &Vector3<f64>| (e.dot(&step).powi(2), e.dot(&(velocity.covariance * e)).max(0.0));
        let (metres, variance) = open
            .iter()
            .map(along)
            .fold((0.0, 0.0f64), |(m, v), (metres, variance)| (m + metres, v.max(variance)));
        let deviation = translations(&found.information).0[0];
        self.guessing.known = if deviation <= WEAK_TRANSLATION { self.guessing.known + seconds } else { 0.0 };
        let guess = self.guessing.next(
            &open,
            Guessed {
                metres: metres.sqrt(),
                deviation: variance.sqrt() * seconds,
                missed: projector(&open) * (velocity.mean * seconds - step),
                found: deviation,
            },
        );
        self.guessing.is_wary |= self.guessing.is_carried();
        self.guessing.is_wary &= deviation > LOOKED_AT;
        let known = translation_information(&found.information);
        self.velocity = Some(velocity.updated(&step, &known, &projector(&open), seconds));
        guess
    }
}

/// Onto directions.
fn projector(directions: &[Vector3<f64>]) -> Matrix3<f64> {
    directions.iter().map(|e| e * e.transpose()).sum()
}

/// A velocity after the sensor has turned. On open ground, where two directions are open, it turns as the sensor does about the third. In a
/// tunnel it does not: what is carried swings, and its way does not.
fn turned(velocity: &Velocity, before: &Se3, now: &Se3, open: &[Vector3<f64>]) -> Velocity {
    let [one, other] = open else { return *velocity };
    let axis = one.cross(other);
    let angle = axis.dot(&(now.rotation * before.rotation.inverse()).scaled_axis());
    let rotation = UnitQuaternion::from_scaled_axis(axis * angle);
    Velocity { mean: rotation * velocity.mean, ..*velocity }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A sweep that nothing tells where it is: 0.1 m of it are guessed, by a velocity that leads 0.02 m beyond.
    fn blind(found: f64) -> Guessed {
        Guessed { metres: 0.1, deviation: 0.06, missed: Vector3::x() * 0.02, found }
    }

    #[test]
    fn guesses_are_reported_once_they_may_err_by_more_than_maps_may() {
        let (x, mut guessing) = ([Vector3::x()], Guessing::default());
        // Single ones, as where a map has just begun, are no guess.
        for open in [&x[..], &x[..], &[], &x[..], &x[..]] {
            assert_eq!(guessing.next(open, blind(1e6)), Guess::default());
        }
        let third = guessing.next(&x, blind(1e6));
        assert!((third.metres - 0.3).abs() < 1e-9 && (third.deviation - 0.18).abs() < 1e-9, "{third:?}");
        assert!((guessing.behind.x - 0.06).abs() < 1e-9, "it was held back meanwhile: {guessing:?}");
        let fourth = guessing.next(&x, blind(1e6));
        assert!((fourth.metres - 0.1).abs() < 1e-9, "{fourth:?}");
        assert_eq!(guessing.behind, Vector3::zeros(), "that is made up for once");
        let variance = (third.covariance + fourth.covariance)[(0, 0)];
        assert!((variance.sqrt() - 0.24).abs() < 1e-9, "{variance}");
        assert_eq!(guessing.next(&[], blind(0.0)), Guess::default());
        assert_eq!(guessing.next(&x, blind(1e6)), Guess::default());
    }

    /// As in a low corridor before 16 rings, which hardly see floor and ceiling: each sweep says to 0.1 m how high it is.
    #[test]
    fn where_sweeps_tell_their_place_badly_again_and_again_nothing_is_guessed() {
        let (x, mut guessing) = ([Vector3::x()], Guessing::default());
        for _ in 0..50 {
            assert_eq!(guessing.next(&x, blind(0.1)), Guess::default());
        }
        assert!(guessing.behind.norm() < 0.05, "where they are is what they say: {guessing:?}");
        // Of what comes then the last sweep that told its place is no part, and single ones do not end it.
        let said = [1e6, 1e6, 0.1, 0.1].map(|found| guessing.next(&x, blind(found)));
        assert!(said.iter().all(|guess| guess.directions == 1), "{said:?}");
        assert!((said.iter().map(|guess| guess.metres).sum::<f64>() - 0.4).abs() < 1e-9, "{said:?}");
    }

    #[test]
    fn what_is_reported_as_guessed_is_so_until_it_is_known_well() {
        let known_to = |deviation: f64| {
            let mut information = Matrix6::identity() * 1e6;
            information[(0, 0)] = deviation.powi(-2);
            information
        };
        let mut guessing = Guessing::default();
        assert_eq!(guessing.open(&known_to(0.04)).len(), 0);
        let open = guessing.open(&known_to(0.06));
        assert!(open.len() == 1 && open[0].x.abs() > 0.999, "{open:?}");
        guessing.next(&open, Guessed { deviation: 0.2, ..blind(1e6) });
        assert_eq!(guessing.open(&known_to(0.04)).len(), 1);
        assert_eq!(guessing.open(&known_to(0.02)).len(), 0);
        guessing.known = 1.0;
        assert_eq!(guessing.open(&known_to(0.04)).len(), 0);
    }

    #[test]
    fn on_open_ground_a_velocity_turns_with_the_sensor() {
        let velocity = Velocity { mean: Vector3::new(2.0, 0.0, 0.0), ..Velocity::default() };
        let quarter = UnitQuaternion::from_scaled_axis(Vector3::z() * std::f64::consts::FRAC_PI_2);
        let [before, now] = [UnitQuaternion::identity(), quarter].map(|r| Se3::new(r, Vector3::zeros()));
        let plane = turned(&velocity, &before, &now, &[Vector3::x(), Vector3::y()]);
        assert!((plane.mean - Vector3::new(0.0, 2.0, 0.0)).norm() < 1e-9, "{}", plane.mean);
        assert_eq!(turned(&velocity, &before, &now, &[Vector3::x()]).mean, velocity.mean);
    }
}
