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
/// Without pieces the ratio is 0. Where one place follows though [much](Prior::rearranged_up_to) differs, they are weighed again as of a place
/// that is hardly ever rearranged.
pub fn weigh(pieces: &[Piece], prior: &Prior) -> Weighed {
    let weighed = weighed(pieces, prior);
    if weighed.answer.joins() && weighed.changed >= prior.rearranged_up_to {
        return self::weighed(pieces, &prior.of_much());
    }
    weighed
}

fn weighed(pieces: &[Piece], prior: &Prior) -> Weighed {
    let model = Model::new(prior);
    let order = ordered(pieces);
    let sums = Sums::of(order.iter().map(|&i| &pieces[i]), &model);
    let ln_ratio = if order.is_empty() { 0.0 } else { model.ln_ratio(&sums) };
    let mut parts = vec![0.0; pieces.len()];
    for &i in &order {
        let mut without = sums.clone();
        without.add(&pieces[i], &model, -1.0);
        parts[i] = ln_ratio - model.ln_ratio(&without);
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

/// The `ln_ratio` of pieces weighed together, alone.
pub fn ln_ratio(pieces: &[Piece], prior: &Prior) -> f64 {
    let (model, order) = (Model::new(prior), ordered(pieces));
    if order.is_empty() { 0.0 } else { model.ln_ratio(&Sums::of(order.iter().map(|&i| &pieces[i]), &model)) }
}

/// The pieces that are measured, in one order, so that sums do not depend on the order in which they are given.
fn ordered(pieces: &[Piece]) -> Vec<usize> {
    let mut order: Vec<usize> = (0..pieces.len()).filter(|&i| is_measured(&pieces[i])).collect();
    order.sort_by(|&a, &b| compare(&pieces[a], &pieces[b]));
    order
}

/// `ln p(all pieces | one place) − ln p(all | unrelated surfaces)`: of poses between the same two maps, the one at which this is more
/// explains more of what both saw. Without pieces it is 0.
pub fn explained(pieces: &[Piece], prior: &Prior) -> f64 {
    let model = Model::new(prior);
    model.ln_same(&Sums::of(ordered(pieces).into_iter().map(|i| &pieces[i]), &model))
}

/// Terms of pieces, summed at each share of those that are the same in both maps.
#[derive(Clone)]
struct Sums {
    shapes: Vec<f64>,
    looks: Vec<f64>,
    wear: Vec<f64>,
    /// How many looks there are.
    count: f64,
    /// Of wear of which a double shares what it does by its prior.
    shared_wear: f64,
}

impl Sums {
    fn of<'a>(pieces: impl Iterator<Item = &'a Piece>, model: &Model) -> Self {
        let zeros = vec![0.0; model.grid.len()];
        let none =
            Self { shapes: zeros.clone(), looks: zeros.clone(), wear: zeros, count: 0.0, shared_wear: 0.0 };
        pieces.fold(none, |mut sums, piece| {
            sums.add(piece, model, 1.0);
            sums
        })
    }

    /// Adds a piece, or takes it off by the sign −1.
    fn add(&mut self, piece: &Piece, model: &Model, sign: f64) {
        let terms = model.terms(piece);
        let add = |sums: &mut [f64]| sums.iter_mut().zip(&terms).for_each(|(sum, term)| *sum += sign * term);
        match piece.kind {
            PieceKind::Wear => {
                add(&mut self.wear);
                self.shared_wear += sign * model.shared_wear.ln_term(piece);
            }
            PieceKind::Shape => add(&mut self.shapes),
            PieceKind::Look => {
                add(&mut self.looks);
                self.count += sign;
            }
        }
    }
}

/// Both hypotheses at shares of the pieces that are the same in both maps.
struct Model {
    grid: Vec<Share>,
    /// ln of the normalised prior densities of a share: of the shapes and looks of one place, of its wear, and of anything.
    same: Vec<f64>,
    same_wear: Vec<f64>,
    anything: Vec<f64>,
    /// Whether things have changed more than walls, so that both have shares of their own.
    is_later: bool,
    /// ln of the probability that one place was rearranged, that wear is printed, that a double's looks are copies, and of the contrary of
    /// each.
    ln_rearranged: [f64; 2],
    ln_printed: [f64; 2],
    ln_copied: [f64; 2],
    /// What a double shares of its wear.
    shared_wear: Share,
}

impl Model {
    fn new(prior: &Prior) -> Self {
        let grid: Vec<Share> = (-STEPS..=STEPS).map(|step| Share::new(f64::from(step) * STEP)).collect();
        let density = |beta: Beta| {
            let density: Vec<f64> = grid.iter().map(|share| beta.ln_density(share)).collect();
            let norm = ln_sum(&density);
            density.into_iter().map(|value| value - norm).collect::<Vec<f64>>()
        };
        let but_for = |changed: f64| density(Beta { agree: changed.recip() - 1.0, differ: 1.0 });
        let (same, same_wear) = (but_for(prior.changed()), but_for(prior.changed_wear));
        let anything = density(Beta { agree: 1.0, differ: 1.0 });
        let ln = |probability: f64| [probability.ln(), (1.0 - probability).ln()];
        let shared_wear = Share::new((prior.shared_wear / (1.0 - prior.shared_wear)).ln());
        let [ln_rearranged, ln_printed, ln_copied] = [prior.rearranged, prior.printed, prior.copied].map(ln);
        let is_later = prior.changed() > prior.changed_wear;
        Self { grid, same, same_wear, anything, is_later, ln_rearranged, ln_printed, ln_copied, shared_wear }
    }

    fn terms(&self, piece: &Piece) -> Vec<f64> {
        self.grid.iter().map(|share| share.ln_term(piece)).collect()
    }

    /// How likely all pieces are of one place, by their summed terms.
    fn ln_same(&self, sums: &Sums) -> f64 {
        let [rearranged, kept] = self.ln_rearranged;
        let but_for_changes = |terms: &[f64]| {
            ln_add(kept + integral(&self.same, terms), rearranged + integral(&self.anything, terms))
        };
        let things = sum(&sums.shapes, &sums.looks);
        if self.is_later {
            but_for_changes(&things) + integral(&self.same_wear, &sums.wear)
        } else {
            but_for_changes(&sum(&things, &sums.wear))
        }
    }

    /// How likely wear is of a double where it is made in numbers: shared as in one place or to any share, whichever explains it better.
    fn ln_print(&self, wear: &[f64]) -> f64 {
        integral(&self.same_wear, wear).max(integral(&self.anything, wear))
    }

    /// How likely shapes and looks are of a double, by their summed terms.
    fn ln_double(&self, shapes: &[f64], looks: &[f64]) -> f64 {
        let [copied, own] = self.ln_copied;
        let copies = integral(&self.anything, shapes) + integral(&self.same, looks);
        ln_add(own + integral(&self.anything, &sum(shapes, looks)), copied + copies)
    }

    fn ln_ratio(&self, sums: &Sums) -> f64 {
        let [printed, worn] = self.ln_printed;
        // Shapes alone are no copies.
        let double = |looks: &[f64]| match sums.count > 0.0 {
            true => self.ln_double(&sums.shapes, looks),
            false => integral(&self.anything, &sum(&sums.shapes, looks)),
        };
        let things = double(&sums.looks);
        let alike = match self.is_later {
            true => things + self.ln_print(&sums.wear),
            false => double(&sum(&sums.looks, &sums.wear)),
        };
        self.ln_same(sums) - ln_add(worn + things + sums.shared_wear, printed + alike)
    }
}

fn sum(a: &[f64], b: &[f64]) -> Vec<f64> {
    a.iter().zip(b).map(|(a, b)| a + b).collect()
}

/// ln of a likelihood over shares, by their prior and the summed terms of pieces.
fn integral(prior: &[f64], terms: &[f64]) -> f64 {
    ln_sum(&prior.iter().zip(terms).map(|(prior, term)| prior + term).collect::<Vec<f64>>())
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
mod tests;
