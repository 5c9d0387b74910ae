//! Pieces registered where they may belong, and the poses on which several of them agree.

use super::candidates::candidates;
use super::robot_map::RobotMap;
use crate::closure::{coarse_search, counted};
use geometry::Se3;
use nalgebra::Vector6;
use rayon::prelude::*;

/// What a piece says of the maps.
#[derive(Clone, Copy, Debug)]
pub struct Hypothesis {
    /// The piece of `b`, by index.
    pub piece: usize,
    /// The pose.
    pub a_from_b: Se3,
    /// Share of the piece's points that agree with `a`.
    pub score: f64,
}

/// Pieces that say the same.
#[derive(Clone, Debug)]
pub struct Cluster {
    /// The pose that the best of them says.
    pub a_from_b: Se3,
    /// The pieces, ascending.
    pub pieces: Vec<usize>,
    /// Sum of their scores.
    pub support: f64,
}

/// Two pieces agree when the one's pose moves the other's place by no more than this, metres and radians: pieces are
/// registered to a few centimetres, odometry drifts by a few more, and rivals lie metres apart.
const AGREED: (f64, f64) = (0.3, 0.02);

/// A piece that is asked to confirm a pose begins so far from it, metres along each axis and radians about the vertical.
const DISPLACED: (f64, f64) = (0.5, 0.02);
/// Least share of a piece's points that lie where the other map has surfaces, in a piece that confirms: some hundreds. What
/// comes back to where it was, from a displacement much larger than how near it comes, is of one surface; seen from the other
/// end of a hall two tenths are.
const HELD: f64 = 0.1;
/// Of these, the least share that agrees with them. Of 1428 pieces at their true place, on the sites that limits are set on, the
/// least had 0.69.
const CONFIRMING: f64 = 0.6;

/// Pieces of `b` that come back to a pose by themselves when they begin beside it.
pub fn confirming(a: &RobotMap, b: &RobotMap, a_from_b: &Se3) -> usize {
    let displacement = Se3::exp(&Vector6::new(DISPLACED.0, DISPLACED.0, 0.0, 0.0, 0.0, DISPLACED.1));
    let confirms = |piece: usize| {
        let of = &b.pieces[piece];
        let found =
            coarse_search(&a.whole, &of.points, &(*a_from_b * of.map_from_piece * displacement), false);
        let proposed = found.pose * of.map_from_piece.inverse();
        let (asked, within) = counted(&a.whole, &of.points, &found.pose);
        asked as f64 >= HELD * of.points.len() as f64
            && within as f64 >= CONFIRMING * asked as f64
            && agree(a_from_b, &Hypothesis { piece, a_from_b: proposed, score: found.score }, b)
    };
    (0..b.pieces.len()).into_par_iter().filter(|&piece| confirms(piece)).count()
}

/// Every piece of `b` registered at its candidates.
pub fn hypotheses(a: &RobotMap, b: &RobotMap) -> Vec<Hypothesis> {
    let tested: Vec<(usize, Se3)> = b
        .pieces
        .iter()
        .enumerate()
        .flat_map(|(i, piece)| candidates(a, piece, b).into_iter().map(move |guess| (i, guess)))
        .collect();
    let register = |&(piece, guess): &(usize, Se3)| {
        let Some(of) = b.pieces.get(piece) else { unreachable!("pieces are enumerated") };
        let found = coarse_search(&a.whole, &of.points, &guess, true);
        Hypothesis { piece, a_from_b: found.pose * of.map_from_piece.inverse(), score: found.score }
    };
    tested.par_iter().map(register).collect()
}

/// Groups of hypotheses that agree, the best supported first. A hypothesis is in one of them only, a piece counts
/// once.
pub fn clusters(hypotheses: &[Hypothesis], b: &RobotMap) -> Vec<Cluster> {
    let mut left: Vec<Hypothesis> = hypotheses.to_vec();
    let mut found = Vec::new();
    while let Some(best) = left
        .iter()
        .map(|seed| around(seed, &left, b))
        .reduce(|x, y| if y.support > x.support { y } else { x })
    {
        left.retain(|h| !agree(&best.a_from_b, h, b));
        found.push(best);
    }
    found
}

fn around(seed: &Hypothesis, all: &[Hypothesis], b: &RobotMap) -> Cluster {
    let mut scores = vec![0.0f64; b.pieces.len()];
    for h in all.iter().filter(|h| agree(&seed.a_from_b, h, b)) {
        scores[h.piece] = scores[h.piece].max(h.score);
    }
    let pieces = (0..scores.len()).filter(|&i| scores[i] > 0.0).collect();
    Cluster { a_from_b: seed.a_from_b, pieces, support: scores.iter().sum() }
}

fn agree(pose: &Se3, hypothesis: &Hypothesis, b: &RobotMap) -> bool {
    let place = b.pieces[hypothesis.piece].map_from_piece.translation;
    let apart = *pose * place - hypothesis.a_from_b * place;
    apart.norm() < AGREED.0 && (pose.rotation.angle_to(&hypothesis.a_from_b.rotation)) < AGREED.1
}

/// Whether two poses put all of `b` at the same place, within what pieces may differ by.
pub(super) fn same_place(one: &Se3, other: &Se3, b: &RobotMap) -> bool {
    (0..b.pieces.len()).all(|piece| agree(one, &Hypothesis { piece, a_from_b: *other, score: 0.0 }, b))
}
