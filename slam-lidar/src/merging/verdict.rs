//! What speaks for a merge and against it, and what is said of two maps.

use super::bounds;
use super::comparison::{Comparison, compare};
use super::hypotheses::{Cluster, confirming};
use super::lines::{Line, Test};
use super::patches::area;
use super::robot_map::RobotMap;
use super::shifts::{Counted, ln_rate_ratio, shifts};
use crate::closure::Found;
use crate::degeneracy::{Conditioning, conditioning};
use crate::keyframe::{Seen, Submap, transformed};
use backend::verdict::{Answer, Prior, Weighed, explained, weigh};
use geometry::Se3;
use nalgebra::{Matrix6, Vector3};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// What speaks for a pose between two maps.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct MergeEvidence {
    /// The pose.
    pub a_from_b: Se3,
    /// Its information, tangent (υ, ω) at the origin of `b` in the axes of `a`.
    pub information: Matrix6<f64>,
    /// Pieces of one map that were brought here by Scan Context, without a guess.
    pub finding: usize,
    /// Pieces of one of the maps that come back to this pose when they are displaced, of that which has more of them; 0 where the
    /// pose joins nothing without them.
    pub pieces: usize,
    /// Pieces that this map has.
    pub of_pieces: usize,
    /// Things that agree, each by how seldom the like of it occurs: how far the merge is trusted against others.
    pub support: f64,
    /// Share of the one map's points that lie on a surface the other saw, the lesser of both ways.
    pub overlap: f64,
    /// Surface that both saw, square metres, the lesser of both ways.
    pub surface: f64,
    /// What the maps say of each other's surfaces, piece by piece.
    pub things: Comparison,
    /// The same weighed: one place or two that share things. Its answer is that of the likelihood alone; what is said of the maps is
    /// [`Verdict::answer`].
    pub weighed: Weighed,
    /// Places where small things are shifted, between the maps and within them; none counted where another test fails.
    pub shifts: [Counted; 2],
    /// Root mean square distance of points from the surfaces that they agree with, metres.
    pub rmse: f64,
    /// How well the pose is determined.
    pub conditioning: Conditioning,
}

/// Whether maps belong together.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Decision {
    /// They do.
    Accepted,
    /// They may, but too little speaks for it, or for another pose too.
    Undecided,
    /// What was found contradicts the maps.
    Refused,
}

impl From<Answer> for Decision {
    fn from(answer: Answer) -> Self {
        match answer {
            Answer::Same | Answer::SameChanged => Self::Accepted,
            Answer::CannotTell => Self::Undecided,
            Answer::Different => Self::Refused,
        }
    }
}

/// What became of a merge.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Verdict {
    /// What is said of the maps.
    pub answer: Answer,
    /// Whether they are joined.
    pub decision: Decision,
    /// The line that decided; of an accepted merge the last test.
    pub line: Line,
    /// The best pose with its evidence; none where no piece was registered.
    pub best: Option<MergeEvidence>,
    /// Other poses that were followed.
    pub rivals: Vec<MergeEvidence>,
    /// Whether a person said that both maps show one place.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub is_confirmed: bool,
}

/// Every so many points are asked: some thousands tell shares to a hundredth.
const EVERY: usize = 4;

/// Judges a pose between whole maps, at which they were glimpsed.
pub(super) fn evidence(
    a: &RobotMap,
    b: &RobotMap,
    cluster: &Cluster,
    found: &Found,
    prior: &Prior,
    glimpse: Comparison,
) -> MergeEvidence {
    let back = found.pose.inverse();
    let of = |map: &RobotMap| -> Vec<[f32; 3]> { map.whole.points.iter().copied().step_by(EVERY).collect() };
    let overlap = seen(&a.whole, &of(b), &found.pose).0.min(seen(&b.whole, &of(a), &back).0);
    // Most poses are seen to be wrong at a glimpse.
    let is_open = overlap >= bounds::OVERLAP && glimpse.inlier_ratio >= bounds::GLIMPSED;
    let things = if is_open { compare(a, b, &found.pose) } else { glimpse };
    let both = |target: &RobotMap, source: &RobotMap, pose: &Se3| {
        seen(&target.whole, &source.settled, pose).0 * area(source.settled.len())
    };
    let mut evidence = MergeEvidence {
        a_from_b: found.pose,
        information: found.information,
        finding: cluster.pieces.len(),
        pieces: 0,
        of_pieces: b.pieces.len(),
        support: things.support(),
        overlap,
        surface: if is_open { both(a, b, &found.pose).min(both(b, a, &back)) } else { 0.0 },
        weighed: weigh(&things.pieces, prior),
        shifts: Default::default(),
        things,
        rmse: found.rmse,
        conditioning: conditioning(&found.information),
    };
    if failed(&evidence, prior, false).is_none() {
        evidence.shifts = shifts(a, b, &found.pose, evidence.things.deviation as f32);
    }
    evidence
}

/// Asks pieces of both maps to come back to a pose; either map may have seen little of the other's.
pub(super) fn confirm(a: &RobotMap, b: &RobotMap, evidence: &mut MergeEvidence) {
    let (own, others) =
        (confirming(a, b, &evidence.a_from_b), confirming(b, a, &evidence.a_from_b.inverse()));
    (evidence.pieces, evidence.of_pieces) =
        if others > own { (others, a.pieces.len()) } else { (own, b.pieces.len()) };
}

/// Share of points on surfaces that the target saw, and of those it can judge the share in free space.
/// Over a whole map poses drift and some view looks past every edge: the majority of views decides.
pub(super) fn seen(target: &Submap, points: &[[f32; 3]], target_from_source: &Se3) -> (f64, f64) {
    let look = |p: &[f32; 3]| {
        let q = transformed(target_from_source, *p);
        let (mut free, mut surface) = (0usize, 0usize);
        for sight in &target.sights {
            match sight.look(q) {
                Seen::Free => free += 1,
                Seen::Surface => surface += 1,
                Seen::Hidden => {}
            }
        }
        (usize::from(surface > 0 && surface >= free), usize::from(free > surface))
    };
    // Counts are whole numbers: their sum does not depend on its order.
    let add = |x: (usize, usize), y: (usize, usize)| (x.0 + y.0, x.1 + y.1);
    let (surface, free) = points.par_iter().map(look).reduce(|| (0, 0), add);
    let share = |part: usize, of: usize| part as f64 / of.max(1) as f64;
    (share(surface, points.len()), share(free, surface + free))
}

/// The largest thing that may be absent where so much is shared, square metres.
pub(crate) fn most_absent(shared: f64) -> f64 {
    bounds::ABSENT + bounds::ABSENT_SHARE * (shared - bounds::MUCH).max(0.0)
}

/// The tests of a pose in their order, each with whether it holds and what is said where it does not. Where the likelihood does not
/// tell, nothing may outweigh what agrees, no thing may be absent and much must be shared. Pieces are asked for where `is_confirmed`.
fn tests(e: &MergeEvidence, prior: &Prior, is_confirmed: bool) -> [(Line, bool, Answer); 8] {
    let line = |test, value, bound| Line { test, value, bound };
    let (overlap, inlier_ratio, weak) = (e.overlap, e.things.inlier_ratio, e.conditioning.weak);
    let (surface_answer, shared, absent) = (e.weighed.answer, e.surface, e.things.absent());
    let certain = prior.ln_certainty();
    let needed = certain - prior.ln_odds;
    let [between, within] = e.shifts;
    let shifted = ln_rate_ratio(between, within);
    let is_decided = surface_answer.joins();
    let outweighs = e.weighed.ln_ratio >= 0.0 && surface_answer != Answer::Different;
    let moved = most_absent(shared);
    let is_much = shared >= bounds::SHARED || overlap >= bounds::MOST;
    [
        (line(Test::Overlap, overlap, bounds::OVERLAP), overlap >= bounds::OVERLAP, Answer::Different),
        (
            line(Test::InlierRatio, inlier_ratio, bounds::INLIER_RATIO),
            inlier_ratio >= bounds::INLIER_RATIO,
            Answer::Different,
        ),
        (
            line(Test::Likelihood, e.weighed.ln_ratio, needed.min(0.0)),
            is_decided || outweighs,
            surface_answer,
        ),
        (line(Test::Absent, absent, moved), is_decided || absent <= moved, Answer::CannotTell),
        (line(Test::Shared, shared, bounds::SHARED), is_decided || is_much, Answer::CannotTell),
        (line(Test::Shifts, shifted, certain), shifted < certain, Answer::CannotTell),
        (line(Test::Conditioning, weak as f64, 0.0), weak == 0, Answer::CannotTell),
        (
            line(Test::Pieces, e.pieces as f64, bounds::PIECES as f64),
            !is_confirmed || e.pieces >= bounds::PIECES,
            Answer::CannotTell,
        ),
    ]
}

/// The first test that fails.
fn failed(e: &MergeEvidence, prior: &Prior, is_confirmed: bool) -> Option<(Line, Answer)> {
    let first = tests(e, prior, is_confirmed).into_iter().find(|(_, holds, _)| !holds);
    first.map(|(line, _, answer)| (line, answer))
}

/// Two poses that differ by less, metres and radians, are one: refined on whole maps, those that began apart may come to
/// the same place, to millimetres, while rivals lie metres apart.
const ONE_POSE: (f64, f64) = (0.1, 0.01);

/// Whether two poses are one.
pub(super) fn is_one(one: &Se3, other: &Se3) -> bool {
    let apart = one.inverse() * *other;
    apart.translation.norm() < ONE_POSE.0 && apart.rotation.angle() < ONE_POSE.1
}

/// The first of each group whose poses are one.
pub(super) fn distinct<T>(found: Vec<T>, pose: impl Fn(&T) -> Se3) -> Vec<T> {
    let mut kept: Vec<T> = Vec::new();
    for next in found {
        if !kept.iter().any(|other| is_one(&pose(other), &pose(&next))) {
            kept.push(next);
        }
    }
    kept
}

/// Decides between [`distinct`] poses, those that fit best first. The pose at which most is alike is what the maps say; where it is not
/// believed, none that fits less is, though it passes by itself. `confirm` asks pieces to come back to the pose that would be believed.
pub(super) fn decide(
    mut found: Vec<MergeEvidence>,
    prior: &Prior,
    confirm: impl Fn(&mut MergeEvidence),
) -> Verdict {
    let passes: Vec<usize> =
        (0..found.len()).filter(|&i| failed(&found[i], prior, false).is_none()).collect();
    let by_support = |&i: &usize, &j: &usize| found[i].support.total_cmp(&found[j].support).then(j.cmp(&i));
    let is_open = |e: &MergeEvidence| failed(e, prior, false).is_some_and(|(_, a)| a == Answer::CannotTell);
    // Of what passes that at which most is alike; else that which is likeliest of what may be.
    let by_ratio = |&i: &usize, &j: &usize| {
        found[i].weighed.ln_ratio.total_cmp(&found[j].weighed.ln_ratio).then(j.cmp(&i))
    };
    let open = || (0..found.len()).filter(|&i| is_open(&found[i])).max_by(by_ratio);
    let chosen = passes.iter().copied().max_by(by_support).or_else(open).unwrap_or(0);
    if chosen >= found.len() {
        let none = Line { test: Test::Pieces, value: 0.0, bound: bounds::PIECES as f64 };
        return Verdict {
            answer: Answer::Different,
            decision: Decision::Refused,
            line: none,
            best: None,
            rivals: found,
            is_confirmed: false,
        };
    }
    let mut best = found.remove(chosen);
    if passes.is_empty() {
        let why = failed(&best, prior, false);
        let none = Line { test: Test::Pieces, value: 0.0, bound: bounds::PIECES as f64 };
        let (line, answer) = why.unwrap_or((none, Answer::CannotTell));
        let decision = answer.into();
        return Verdict { answer, decision, line, best: Some(best), rivals: found, is_confirmed: false };
    }
    // Of two poses the right one explains what both maps saw: one that is refused stands beside the best unless that is likelier by
    // as much as an answer takes.
    let explains = |e: &MergeEvidence| explained(&e.things.pieces, prior);
    let least = explains(&best) - prior.ln_certainty();
    let fits = |e: &MergeEvidence| {
        e.support >= best.support && e.things.inlier_ratio >= bounds::AS_WELL && explains(e) >= least
    };
    let is_rival = |e: &&MergeEvidence| failed(e, prior, false).is_none() || fits(e);
    let rivals = Line { test: Test::Rivals, value: found.iter().filter(is_rival).count() as f64, bound: 0.0 };
    let why = if rivals.value > 0.0 {
        Some((rivals, Answer::CannotTell))
    } else {
        confirm(&mut best);
        failed(&best, prior, true)
    };
    let (line, answer) = why.unwrap_or_else(|| (rivals, best.weighed.answer.of_joined(best.weighed.changed)));
    let decision = answer.into();
    Verdict { answer, decision, line, best: Some(best), rivals: found, is_confirmed: false }
}

impl Verdict {
    /// The verdict once a person says that both maps show one place: what is there in one of them only, or as often as things are built
    /// alike, decides nothing any more. That the pose is the right one must still be shown.
    pub fn confirmed(&self, a: &RobotMap, b: &RobotMap, prior: &Prior) -> Self {
        self.confirmed_where(prior, |best| confirm(a, b, best))
    }

    /// The same where `confirm` asks pieces to come back to the pose.
    pub(super) fn confirmed_where(&self, prior: &Prior, confirm: impl Fn(&mut MergeEvidence)) -> Self {
        if self.decision == Decision::Accepted {
            return self.clone();
        }
        let is_of_the_place =
            |test: Test| matches!(test, Test::Likelihood | Test::Absent | Test::Shared | Test::Shifts);
        let failed = |e: &MergeEvidence, is_confirmed: bool| {
            let mut tests = tests(e, prior, is_confirmed).into_iter();
            let (line, _, answer) = tests.find(|(line, holds, _)| !holds && !is_of_the_place(line.test))?;
            Some((line, answer))
        };
        // What both saw no longer tells places apart, and still poses.
        let explains = |e: &MergeEvidence| explained(&e.things.pieces, prior);
        let mut poses: Vec<MergeEvidence> = self.best.iter().chain(&self.rivals).cloned().collect();
        let passes = (0..poses.len()).filter(|&i| failed(&poses[i], false).is_none());
        let likelier =
            |&i: &usize, &j: &usize| explains(&poses[i]).total_cmp(&explains(&poses[j])).then(j.cmp(&i));
        let chosen = passes.max_by(likelier).unwrap_or(0);
        if chosen >= poses.len() {
            return self.clone();
        }
        let mut best = poses.remove(chosen);
        confirm(&mut best);
        let least = explains(&best) - prior.ln_certainty();
        let is_rival = |e: &&MergeEvidence| failed(e, false).is_none() && explains(e) >= least;
        let count = poses.iter().filter(is_rival).count() as f64;
        let rivals = Line { test: Test::Rivals, value: count, bound: 0.0 };
        let is_open = (count > 0.0).then_some((rivals, Answer::CannotTell));
        let joined = Answer::CannotTell.of_joined(best.weighed.changed);
        let (line, answer) = failed(&best, true).or(is_open).unwrap_or((rivals, joined));
        let decision = answer.into();
        Self { answer, decision, line, best: Some(best), rivals: poses, is_confirmed: true }
    }

    /// The same of the maps in the other order.
    pub fn swapped(self) -> Self {
        let swapped = |e: MergeEvidence| e.swapped();
        Self { best: self.best.map(swapped), rivals: self.rivals.into_iter().map(swapped).collect(), ..self }
    }
}

impl MergeEvidence {
    fn swapped(self) -> Self {
        let back = self.a_from_b.rotation.inverse().to_rotation_matrix().into_inner();
        // υ' = −Rᵀ υ − Rᵀ [t]× ω and ω' = −Rᵀ ω, and their inverse: the motion of one map is the other's, backwards.
        let forth = self.a_from_b.rotation.to_rotation_matrix().into_inner();
        let moved = (self.a_from_b.inverse()).translation.cross_matrix();
        let mut jacobian = Matrix6::zeros();
        jacobian.fixed_view_mut::<3, 3>(0, 0).copy_from(&-forth);
        jacobian.fixed_view_mut::<3, 3>(3, 3).copy_from(&-forth);
        jacobian.fixed_view_mut::<3, 3>(0, 3).copy_from(&(-forth * moved));
        let weakest = back * Vector3::from(self.conditioning.weakest);
        Self {
            a_from_b: self.a_from_b.inverse(),
            information: jacobian.transpose() * self.information * jacobian,
            things: self.things.swapped(),
            conditioning: Conditioning { weakest: weakest.into(), ..self.conditioning },
            ..self
        }
    }
}
