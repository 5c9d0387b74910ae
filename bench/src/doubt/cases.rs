//! Recordings on which a tracker may be sure of itself and wrong.

use super::judge::Seen;
use geometry::{Pinhole, Se3};
use loopbox_tests::covered::{AFTER, BEFORE, COVERED, RATE, Uncovered, covered};
use loopbox_tests::doubles::{Kind as Place, Version};
use loopbox_tests::moving::{Mover, moving};
use loopbox_tests::robot::Drive;
use loopbox_tests::streets::{Return, round_the_block};
use loopbox_tests::{Recording, World, trajectory};

/// Shares of the image that what moves covers.
const COVERAGES: [f64; 2] = [0.3, 0.6];
/// Share of the things of a place that was moved while the camera was covered.
const MOVED: f64 = 0.3;
/// Share of its things in which another place of the kind differs.
const DIFFERING: f64 = 0.3;
/// Standard deviation of the grain that each surface has for itself in places where cameras are covered, and along streets, grey levels.
const GRAIN: f32 = 4.0;
/// Robots' drives of each seed.
const DRIVES: u64 = 4;
/// Frames in which a camera turns there and back before it moves, frames while it moves, and frames a second.
const PANNED: (usize, usize, f64) = (120, 150, 30.0);
/// The same of one that turns in a place before it passes it, and how far, radians.
const PANNED_THERE: (usize, usize, f64) = (60, 90, 0.4);
/// Standard deviation of the noise of a camera that turns first, grey levels.
const NOISE: f64 = 2.0;

/// What happens in a recording.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Kind {
    /// Something moves before the camera, and covers about such a share of the image.
    Moves(Mover, f64),
    /// A robot turns on the spot before a cupboard, with a focal length that is a little wrong.
    Robot(u64),
    /// The camera turns for four seconds before it moves.
    TurnsFirst,
    /// It turns for two seconds in a place before it passes it.
    Late(Place),
    /// It drives more than 200 m round a block and comes back to a street.
    Loop(Return),
    /// It is covered for 0.8 s in a place, and uncovered there or elsewhere.
    Covered(Place, Uncovered),
}

impl Kind {
    /// All of them.
    pub fn all() -> Vec<Self> {
        let moves = Mover::ALL.into_iter().flat_map(|m| COVERAGES.map(|share| Self::Moves(m, share)));
        let uncovered = [
            Uncovered::There(0.0),
            Uncovered::Passing(MOVED),
            Uncovered::Elsewhere(DIFFERING),
            Uncovered::PassingElsewhere(1.0),
        ];
        let places = || Place::TUNED.into_iter().chain(Place::HELD_OUT);
        let covered = places().flat_map(|place| uncovered.map(|how| Self::Covered(place, how)));
        let single =
            (0..DRIVES).map(Self::Robot).chain([Self::TurnsFirst]).chain(Return::ALL.map(Self::Loop));
        moves.chain(single).chain(places().map(Self::Late)).chain(covered).collect()
    }

    /// Its name on the command line, where several have one.
    pub fn name(self) -> String {
        match self {
            Self::Moves(mover, _) => format!("{mover:?}").to_lowercase(),
            Self::Robot(_) => "robot".into(),
            Self::TurnsFirst => "turns-first".into(),
            Self::Late(_) => "late".into(),
            Self::Loop(_) => "loop".into(),
            Self::Covered(..) => "covered".into(),
        }
    }

    /// The row of the table that it is counted in.
    pub fn row(self) -> String {
        let percent = |share: f64| format!("{:.0} %", 100.0 * share);
        match self {
            Self::Moves(Mover::Board, _) => "a board is carried past".into(),
            Self::Moves(Mover::Person, _) => "a person walks past".into(),
            Self::Moves(Mover::Lorry, _) => "a lorry drives past".into(),
            Self::Moves(Mover::Departing, _) => "a lorry drives off".into(),
            Self::Moves(Mover::Leaving, _) => "a person walks off".into(),
            Self::Robot(_) => "a robot turns on the spot, its focal length up to 5 % wrong".into(),
            Self::TurnsFirst => "a camera turns for 4 s before it moves".into(),
            Self::Late(_) => "a camera turns for 2 s before it passes a place".into(),
            Self::Loop(Return::SameLane) => "round a block, back in the same lane".into(),
            Self::Loop(Return::MetreAside) => "round a block, back a metre aside".into(),
            Self::Loop(Return::OtherDirection) => "round a block, back from the other direction".into(),
            Self::Covered(_, Uncovered::There(_)) => "covered, uncovered there".into(),
            Self::Covered(_, Uncovered::Passing(share)) => {
                format!("covered, uncovered there in passing, {} moved", percent(share))
            }
            Self::Covered(_, Uncovered::Elsewhere(share)) => {
                format!("covered, uncovered in another place, {} differ", percent(share))
            }
            Self::Covered(_, Uncovered::PassingElsewhere(share)) => {
                format!("covered, uncovered in passing another place, {} differ", percent(share))
            }
        }
    }

    /// A recording of this kind.
    pub fn recording(self, seed: u64) -> Case {
        match self {
            Self::Moves(mover, coverage) => Case::of_one_place(moving(mover, coverage, seed).recording),
            Self::Robot(number) => {
                let drive = Drive::of(seed.wrapping_mul(DRIVES).wrapping_add(number));
                Case { assumed: drive.assumed(), ..Case::of_one_place(drive.recording()) }
            }
            Self::TurnsFirst => Case::of_one_place(turns_first(seed)),
            Self::Late(place) => Case::of_one_place(late(place, seed)),
            Self::Loop(how) => {
                let drive = round_the_block(how, seed, GRAIN);
                Case { returning: drive.returning, ..Case::of_one_place(drive.recording) }
            }
            Self::Covered(place, uncovered) => {
                let recording = covered(place, seed, uncovered, GRAIN);
                let after = if uncovered.is_there() { Seen::Place(0) } else { Seen::Place(1) };
                let seen = [(Seen::Place(0), BEFORE), (Seen::Nothing, COVERED), (after, AFTER)];
                let seen = seen.into_iter().flat_map(|(seen, count)| std::iter::repeat_n(seen, count));
                Case { seen: seen.collect(), ..Case::of_one_place(recording) }
            }
        }
    }
}

/// A recording, what its camera is taken for, and what there is to see in each frame.
pub struct Case {
    pub recording: Recording,
    pub assumed: Pinhole,
    pub seen: Vec<Seen>,
    /// Frames at the end that show what frames at the begin do.
    pub returning: usize,
}

impl Case {
    fn of_one_place(recording: Recording) -> Self {
        let seen = vec![Seen::Place(0); recording.shots.len()];
        Self { assumed: recording.camera, recording, seen, returning: 0 }
    }

    /// Frames a second.
    pub fn rate(&self) -> f64 {
        let shots = &self.recording.shots;
        (shots.len() - 1) as f64 / (shots[shots.len() - 1].timestamp - shots[0].timestamp)
    }
}

/// A camera that turns to one side and back, and moves only then.
fn turns_first(seed: u64) -> Recording {
    let (turning, moving, rate) = PANNED;
    let path = after_turning(trajectory::walk(moving, rate, seed), turning, 0.9, seed);
    Recording::render(&World::yard(seed), Recording::SMALL_CAMERA, &path, rate).with_noise(NOISE, seed)
}

/// A camera that turns in a place to one side and back, and passes it only then.
fn late(place: Place, seed: u64) -> Recording {
    let (turning, moving, angle) = PANNED_THERE;
    let path = after_turning(place.path(seed, moving), turning, angle, seed);
    let world = place.world(&Version::first(seed, GRAIN));
    Recording::render(&world, Recording::SMALL_CAMERA, &path, RATE).with_noise(NOISE, seed)
}

/// A path behind `count` frames of a turn at its begin by `angle` radians there and back, to the side that the seed says.
fn after_turning(path: Vec<Se3>, count: usize, angle: f64, seed: u64) -> Vec<Se3> {
    let angle = if seed.is_multiple_of(2) { angle } else { -angle };
    let there = trajectory::turning(path[0], count / 2, angle);
    there.iter().chain(there.iter().rev()).chain(&path).copied().collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_frame_of_a_recording_shows_something_or_nothing() {
        let kinds = [
            Kind::TurnsFirst,
            Kind::Late(Place::Hall),
            Kind::Robot(1),
            Kind::Covered(Place::Empty, Uncovered::Elsewhere(1.0)),
        ];
        for kind in kinds {
            let case = kind.recording(3);
            assert_eq!(case.seen.len(), case.recording.shots.len(), "{kind:?}");
        }
        assert_ne!(Kind::Robot(1).recording(3).assumed, Recording::SMALL_CAMERA);
    }
}
