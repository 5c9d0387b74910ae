//! The weighing of pieces.

use super::{Answer, Piece, PieceKind, Prior};
use serde::{Deserialize, Serialize};

/// Values of the share that is the same at which the likelihoods are summed: evenly spaced log odds.
const STEPS: i32 = 140;
/// How far apart they are.
const STEP: f64 = 0.1;
/// A piece that says more is as certain as can be.
const MOST: f64 = 50.0;

/// Pieces weighed together.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Weighed {
    /// What follows.
    pub answer: Answer,
    /// `ln p(all pieces | one place) − ln p(all | a double)`.
    pub ln_ratio: f64,
    /// Share of the things, 0–1, that differ.
    pub changed: f64,
    /// The pieces, in the order given, each with the part of `ln_ratio` that would be missing without it.
    pub pieces: Vec<(Piece, f64)>,
}

/// Weighs pieces, each measured once: a surface that several keyframes see is one piece. Their order changes nothing.
/// Without pieces the ratio is 0.
pub fn weigh(pieces: &[Piece], prior: &Prior) -> Weighed {
    let grid: Vec<Share> = (-STEPS..=STEPS).map(|step| Share::new(f64::from(step) * STEP)).collect();
    let same = Beta { agree: prior.changed().recip() - 1.0, differ: 1.0 };
    let double = Beta { agree: 1.0, differ: 1.0 };
    let same_prior: Vec<f64> = grid.iter().map(|share| same.ln_density(share)).collect();
    let double_prior: Vec<f64> = grid.iter().map(|share| double.ln_density(share)).collect();
    let wear = Share::new((prior.shared_wear / (1.0 - prior.shared_wear)).ln());
    // In one order, so that sums do not depend on the order of the pieces.
    let mut order: Vec<usize> = (0..pieces.len()).filter(|&i| is_measured(&pieces[i])).collect();
    order.sort_by(|&a, &b| compare(&pieces[a], &pieces[b]));
    let terms = |i: usize| -> [Vec<f64>; 2] {
        let piece = &pieces[i];
        let one: Vec<f64> = grid.iter().map(|share| share.ln_term(piece)).collect();
        let other = match piece.kind {
            PieceKind::Wear => vec![wear.ln_term(piece); grid.len()],
            _ => one.clone(),
        };
        [one, other]
    };
    let (mut of_same, mut of_double) = (same_prior.clone(), double_prior.clone());
    for &i in &order {
        let [one, other] = terms(i);
        of_same.iter_mut().zip(one).for_each(|(sum, term)| *sum += term);
        of_double.iter_mut().zip(other).for_each(|(sum, term)| *sum += term);
    }
    let norm = ln_sum(&same_prior) - ln_sum(&double_prior);
    let ratio = |same: &[f64], double: &[f64]| ln_sum(same) - ln_sum(double) - norm;
    let ln_ratio = if order.is_empty() { 0.0 } else { ratio(&of_same, &of_double) };
    let mut parts = vec![0.0; pieces.len()];
    for &i in &order {
        let [one, other] = terms(i);
        let without = |sums: &[f64], terms: &[f64]| -> Vec<f64> {
            sums.iter().zip(terms).map(|(sum, term)| sum - term).collect()
        };
        parts[i] = ln_ratio - ratio(&without(&of_same, &one), &without(&of_double, &other));
    }
    let things = |of: &dyn Fn(&Piece) -> bool| -> f64 {
        order.iter().map(|&i| &pieces[i]).filter(|piece| of(piece)).map(|piece| piece.things).sum()
    };
    let all = things(&|_| true);
    let changed = if all > 0.0 { things(&|piece| piece.ln_agreement < 0.0) / all } else { 0.0 };
    Weighed {
        answer: prior.answer(ln_ratio, changed),
        ln_ratio,
        changed,
        pieces: pieces.iter().copied().zip(parts).collect(),
    }
}

/// Whether a piece says anything: all numbers are numbers.
fn is_measured(piece: &Piece) -> bool {
    piece.ln_agreement.is_finite() && piece.things.is_finite() && piece.things > 0.0
}

fn compare(a: &Piece, b: &Piece) -> std::cmp::Ordering {
    let key = |piece: &Piece| [piece.ln_agreement, piece.things, piece.occurrences, piece.share];
    let values = key(a).into_iter().zip(key(b)).map(|(a, b)| a.total_cmp(&b));
    values.fold(a.kind.cmp(&b.kind), std::cmp::Ordering::then)
}

/// A share of the pieces that are the same in both maps.
struct Share {
    ln_same: f64,
    ln_other: f64,
}

impl Share {
    fn new(log_odds: f64) -> Self {
        let ln_other = -ln_1p_exp(log_odds);
        Self { ln_same: log_odds + ln_other, ln_other }
    }

    /// `w·ln(a·e^l + 1 − a)`: what a piece says, if it may be one that is not the same.
    fn ln_term(&self, piece: &Piece) -> f64 {
        let l = piece.ln_agreement.clamp(-MOST, MOST);
        // All of its kind agree together and say it once; what differs is there by itself.
        let weight = if l > 0.0 { piece.things / piece.occurrences.max(1.0) } else { piece.things };
        weight * ln_add(self.ln_same + l, self.ln_other)
    }
}

/// A Beta distribution, not normalised, over log odds.
struct Beta {
    agree: f64,
    differ: f64,
}

impl Beta {
    fn ln_density(&self, share: &Share) -> f64 {
        self.agree * share.ln_same + self.differ * share.ln_other
    }
}

/// `ln(1 + e^x)`.
fn ln_1p_exp(x: f64) -> f64 {
    x.max(0.0) + (-x.abs()).exp().ln_1p()
}

/// `ln(e^a + e^b)`.
fn ln_add(a: f64, b: f64) -> f64 {
    a.max(b) + (-(a - b).abs()).exp().ln_1p()
}

/// `ln Σ e^v`.
fn ln_sum(values: &[f64]) -> f64 {
    let most = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    most + values.iter().map(|value| (value - most).exp()).sum::<f64>().ln()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn piece(kind: PieceKind, ln_agreement: f64) -> Piece {
        Piece { kind, share: 0.01, things: 1.0, occurrences: 1.0, ln_agreement }
    }

    /// So many things that look the same and so many that do not.
    fn looks(alike: usize, other: usize) -> Vec<Piece> {
        let all = [vec![4.0; alike], vec![-4.0; other]].concat();
        all.into_iter().map(|l| piece(PieceKind::Look, l)).collect()
    }

    fn ln_ratio(pieces: &[Piece], days_apart: f64) -> f64 {
        weigh(pieces, &Prior { days_apart, ..Prior::default() }).ln_ratio
    }

    #[test]
    fn nothing_seen_says_nothing() {
        let found = weigh(&[], &Prior::default());
        assert_eq!((found.ln_ratio, found.answer), (0.0, Answer::CannotTell));
        let no_number = piece(PieceKind::Look, f64::NAN);
        assert_eq!(weigh(&[no_number], &Prior::default()).ln_ratio, 0.0);
        assert_eq!(ln_ratio(&[piece(PieceKind::Look, 0.0); 9], 0.0), 0.0);
    }

    /// Certain pieces alone: `B(b + n − k, k + 1) b / B(n − k + 1, k + 1)` in closed form.
    #[test]
    fn the_ratio_is_that_of_the_integrals() {
        let pieces: Vec<Piece> = (0..30).map(|_| piece(PieceKind::Look, 40.0)).collect();
        let agree = Prior::default().changed().recip() - 1.0;
        let expected = (agree / (agree + 30.0) * 31.0).ln();
        assert!((ln_ratio(&pieces, 0.0) - expected).abs() < 0.01);
    }

    /// More that differs is never judged more leniently, at any distance in time and by any share.
    #[test]
    fn the_ratio_falls_with_every_thing_that_differs() {
        for days in [0.0, 1.0, 30.0] {
            for n in [5usize, 40] {
                let ratios: Vec<f64> = (0..=n).map(|k| ln_ratio(&looks(n - k, k), days)).collect();
                assert!(ratios.windows(2).all(|pair| pair[1] <= pair[0] + 1e-9), "{n} {days}: {ratios:?}");
            }
        }
        let answer = |other: usize| weigh(&looks(100 - other, other), &Prior::default()).answer;
        assert_eq!([0, 10, 30].map(answer), [Answer::Same, Answer::CannotTell, Answer::Different]);
    }

    #[test]
    fn wear_that_agrees_outweighs_change_and_wear_that_differs_makes_a_double() {
        let mut pieces = looks(60, 40);
        let prior = Prior { days_apart: 30.0, ..Prior::default() };
        assert_eq!(weigh(&pieces, &prior).answer, Answer::CannotTell);
        pieces.extend([piece(PieceKind::Wear, 6.0); 6]);
        assert_eq!(weigh(&pieces, &prior).answer, Answer::SameChanged);
        let mut pieces = looks(100, 0);
        assert_eq!(weigh(&pieces, &prior.clone()).answer, Answer::CannotTell);
        pieces.extend([piece(PieceKind::Wear, -6.0); 6]);
        assert_eq!(weigh(&pieces, &Prior::default()).answer, Answer::Different);
    }

    /// Twenty equal windows that agree are one fact.
    #[test]
    fn what_occurs_often_says_little() {
        let one = ln_ratio(&[piece(PieceKind::Look, 4.0)], 0.0);
        let equal = Piece { occurrences: 20.0, ..piece(PieceKind::Look, 4.0) };
        assert!((ln_ratio(&[equal; 20], 0.0) - one).abs() < 1e-9);
    }

    #[test]
    fn the_order_of_pieces_changes_no_bit() {
        let mut pieces: Vec<Piece> = (0..40)
            .map(|i| Piece { share: f64::from(i), ..piece(PieceKind::Wear, f64::from(i) * 0.37 - 4.0) })
            .collect();
        let before = ln_ratio(&pieces, 1.0);
        pieces.rotate_left(13);
        pieces.reverse();
        assert_eq!(ln_ratio(&pieces, 1.0).to_bits(), before.to_bits());
    }
}
