//! What speaks for a merge and against it, and the line that decides.

use super::absent::{Comparison, compare};
use super::hypotheses::{Cluster, confirming};
use super::robot_map::RobotMap;
use crate::closure::{Found, held};
use crate::degeneracy::{Conditioning, conditioning};
use crate::keyframe::{Seen, Submap, transformed};
use geometry::Se3;
use nalgebra::Matrix6;
use rayon::prelude::*;
use std::fmt;

/// What speaks for a pose between two maps.
#[derive(Clone, Copy, Debug)]
pub struct MergeEvidence {
    /// The pose.
    pub a_from_b: Se3,
    /// Its information, tangent (υ, ω) at the origin of `b` in the axes of `a`.
    pub information: Matrix6<f64>,
    /// Pieces of the second map that were brought here by Scan Context, without a guess.
    pub finding: usize,
    /// Pieces of one of the maps that come back to this pose when they are displaced, of that which has more of them; 0 where the
    /// pose is refused without them.
    pub pieces: usize,
    /// Pieces that this map has.
    pub of_pieces: usize,
    /// Sum of the pieces' scores: how far the merge is trusted against others.
    pub support: f64,
    /// Share of the one map's points that lie on a surface the other saw, the lesser of both ways.
    pub overlap: f64,
    /// Of the points that the other map can judge, the share that it saw as free, the larger of both ways.
    pub violated: f64,
    /// Share of the points which surfaces of the other hold that agree with them, the lesser of both ways.
    pub agreeing: f64,
    /// What the maps say of each other's surfaces; nothing where the pose is refused without it.
    pub things: Comparison,
    /// Root mean square distance of points from the surfaces that they agree with, metres.
    pub rmse: f64,
    /// How well the pose is determined.
    pub conditioning: Conditioning,
}

/// A test of a merge.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Test {
    /// Pieces that agree.
    Pieces,
    /// Surfaces that both maps saw.
    Overlap,
    /// Points that agree with the other's surfaces.
    Agreeing,
    /// Points where the other saw free space.
    FreeSpace,
    /// Things that stand in one map and not in the other.
    Absent,
    /// Surface that both maps saw, where it is not most of what they saw.
    Shared,
    /// Weak directions of the pose.
    Conditioning,
    /// Other poses that stand as well.
    Rivals,
}

/// A test's figure beside its bound.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Line {
    /// The test.
    pub test: Test,
    /// What was measured.
    pub value: f64,
    /// What it is held against.
    pub bound: f64,
}

impl fmt::Display for Line {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (value, bound) = (self.value, self.bound);
        match self.test {
            Test::Pieces => write!(f, "{value} independent pieces agree, {bound} are needed"),
            Test::Overlap => write!(f, "the maps overlap by {value:.2}, {bound} is needed"),
            Test::Agreeing => write!(f, "{value:.2} of the shared points agree, {bound} is needed"),
            Test::FreeSpace => write!(f, "{value:.3} lie in space seen free, {bound} is allowed"),
            Test::Absent => write!(
                f,
                "{value:.2} m² of surface in one piece are not there in the other map, which looks through them; {bound:.2} at \
                 most may be: another place that looks alike, or something moved"
            ),
            Test::Shared => write!(
                f,
                "both maps saw {value:.0} m² of surface, {bound} are needed where this is less than {} of what each saw: too \
                 little to tell places that repeat apart",
                bounds::MOST
            ),
            Test::Conditioning => write!(f, "{value} directions are weak, {bound} are allowed"),
            Test::Rivals => write!(f, "{value} other poses stand as well, {bound} are allowed"),
        }
    }
}

/// Whether maps belong together.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Decision {
    /// They do.
    Accepted,
    /// They may, but too little speaks for it, or for another pose too.
    Undecided,
    /// What was found contradicts the maps.
    Refused,
}

/// What became of a merge.
#[derive(Clone, Debug)]
pub struct Verdict {
    /// Whether it is believed.
    pub decision: Decision,
    /// The line that decided; of an accepted merge the last test.
    pub line: Line,
    /// The best pose with its evidence; none where no piece was registered.
    pub best: Option<MergeEvidence>,
    /// Other poses that were followed.
    pub rivals: Vec<MergeEvidence>,
}

/// What a merge must show. On whole maps, whose free space is judged by the majority of views, right poses agree by 0.85
/// and more and violate up to 0.001 of the space seen free, or 0.009 where the maps themselves err by a decimetre; a
/// mirrored hall agrees by up to 0.79 and violates 0.025 and more.
pub mod bounds {
    /// Pieces that must agree: one can be deceived. What two are deceived by is told apart by what stands there.
    pub const PIECES: usize = 2;
    /// Least overlap: what is asked of pairs of maps.
    pub const OVERLAP: f64 = 0.3;
    /// Least agreement.
    pub const AGREEING: f64 = 0.82;
    /// Most violated free space.
    pub const VIOLATED: f64 = 0.02;
    /// Largest thing that is not there in the other map, square metres: two cells. Since maps begin level three of 382 right poses
    /// of rendered sites leave more; floors of one plan and sites shifted by a repetition that share as much as is asked leave
    /// 0.19 and more where this was set.
    pub const ABSENT: f64 = 0.125;
    /// And so large a share of what both saw beyond [`MUCH`]: one cart that was moved is 0.0006 of what two drives through a hall
    /// saw, and of what repeats none was accepted by this.
    pub const ABSENT_SHARE: f64 = 0.00075;
    /// What stretches of some metres share on the median, square metres.
    pub const MUCH: f64 = 400.0;
    /// Least surface that both saw, square metres, where it is less than [`MOST`] of what each saw: a few doors of a corridor
    /// look like those of the next. Sites that repeat themselves agreed without a contradiction on up to 176 m².
    pub const SHARED: f64 = 200.0;
    /// From this overlap on the maps are of one place or of its double, however small it is: what agreed without a contradiction
    /// overlapped by up to 0.56.
    pub const MOST: f64 = 0.7;
}

/// Judges a pose between whole maps. What things stand where, and whether pieces come back, is asked only where the shares of
/// all points do not refuse it already.
pub(super) fn evidence(a: &RobotMap, b: &RobotMap, cluster: &Cluster, found: &Found) -> MergeEvidence {
    let back = found.pose.inverse();
    let of = |map: &RobotMap| -> Vec<[f32; 3]> { map.whole.points.iter().copied().step_by(EVERY).collect() };
    let (one, other) = (seen(&a.whole, &of(b), &found.pose), seen(&b.whole, &of(a), &back));
    let mut evidence = MergeEvidence {
        a_from_b: found.pose,
        information: found.information,
        finding: cluster.pieces.len(),
        pieces: 0,
        of_pieces: b.pieces.len(),
        support: cluster.support,
        overlap: one.0.min(other.0),
        violated: one.1.max(other.1),
        agreeing: held(&a.whole, &b.whole, &found.pose).min(held(&b.whole, &a.whole, &back)),
        things: Comparison::default(),
        rmse: found.rmse,
        conditioning: conditioning(&found.information),
    };
    if failed(&evidence).is_some_and(|(_, decision)| decision == Decision::Refused) {
        return evidence;
    }
    evidence.things = compare(a, b, &found.pose);
    // Either map may have seen little of the other's pieces.
    evidence.pieces = confirming(a, b, &found.pose);
    let others = confirming(b, a, &back);
    if others > evidence.pieces {
        (evidence.pieces, evidence.of_pieces) = (others, a.pieces.len());
    }
    // A pose that no descriptor proposed is supported by the pieces that it holds.
    evidence.support = evidence.support.max(evidence.agreeing * evidence.pieces as f64);
    evidence
}

/// Every so many points are asked: some thousands tell shares to a hundredth.
const EVERY: usize = 4;

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

/// The tests in their order, each with whether it holds and what its failure means.
fn tests(e: &MergeEvidence) -> [(Line, bool, Decision); 7] {
    use Decision::{Refused, Undecided};
    let line = |test, value, bound| Line { test, value, bound };
    let Comparison { shared, absent } = e.things;
    let moved = bounds::ABSENT + bounds::ABSENT_SHARE * (shared - bounds::MUCH).max(0.0);
    let pieces = line(Test::Pieces, e.pieces as f64, bounds::PIECES as f64);
    [
        (line(Test::Overlap, e.overlap, bounds::OVERLAP), e.overlap >= bounds::OVERLAP, Refused),
        (line(Test::Agreeing, e.agreeing, bounds::AGREEING), e.agreeing >= bounds::AGREEING, Refused),
        (line(Test::FreeSpace, e.violated, bounds::VIOLATED), e.violated <= bounds::VIOLATED, Refused),
        (line(Test::Absent, absent, moved), absent <= moved, Undecided),
        (
            line(Test::Shared, shared, bounds::SHARED),
            shared >= bounds::SHARED || e.overlap >= bounds::MOST,
            Undecided,
        ),
        (pieces, e.pieces >= bounds::PIECES, Undecided),
        (line(Test::Conditioning, e.conditioning.weak as f64, 0.0), e.conditioning.weak == 0, Undecided),
    ]
}

/// The first test that fails.
fn failed(e: &MergeEvidence) -> Option<(Line, Decision)> {
    tests(e).into_iter().find(|(_, holds, _)| !holds).map(|(line, _, decision)| (line, decision))
}

/// Two poses that differ by less, metres and radians, are one: refined on whole maps, those that began apart may come to
/// the same place, to millimetres, while rivals lie metres apart.
const ONE_POSE: (f64, f64) = (0.1, 0.01);

/// The first of each group whose poses are one.
pub(super) fn distinct<T>(found: Vec<T>, pose: impl Fn(&T) -> Se3) -> Vec<T> {
    let mut kept: Vec<T> = Vec::new();
    for next in found {
        let is_one = |other: &T| {
            let apart = pose(other).inverse() * pose(&next);
            apart.translation.norm() < ONE_POSE.0 && apart.rotation.angle() < ONE_POSE.1
        };
        if !kept.iter().any(is_one) {
            kept.push(next);
        }
    }
    kept
}

/// Decides between [`distinct`] poses, the best supported first. One that is believed comes before one that may be, and that
/// before those which are contradicted.
pub(super) fn judged(mut found: Vec<MergeEvidence>) -> Verdict {
    let standing: Vec<usize> = (0..found.len()).filter(|&i| failed(&found[i]).is_none()).collect();
    let rivals = Line { test: Test::Rivals, value: standing.len().saturating_sub(1) as f64, bound: 0.0 };
    let is_open = |e: &MergeEvidence| failed(e).is_some_and(|(_, decision)| decision == Decision::Undecided);
    let open = || found.iter().position(is_open);
    let chosen = standing.first().copied().or_else(open).unwrap_or(0);
    let best = (chosen < found.len()).then(|| found.remove(chosen));
    let (line, decision) = match (standing.len(), best.as_ref().and_then(failed)) {
        (0, Some(why)) => why,
        (0, None) => {
            let none = Line { test: Test::Pieces, value: 0.0, bound: bounds::PIECES as f64 };
            (none, Decision::Refused)
        }
        (1, _) => (rivals, Decision::Accepted),
        _ => (rivals, Decision::Undecided),
    };
    Verdict { decision, line, best, rivals: found }
}
