//! Whether a closure may be believed: no merge that is wrong may pass.
//!
//! The paper takes every closure that place recognition proposes. A wrong one ruins both maps, so ours must pass
//! every line of this test; the verdict keeps all lines with their numbers. Each rests on evidence the others do not
//! see. A line that *contradicts* refuses; one that lacks evidence leaves the closure *undecided*: it is kept in the
//! record, the maps are not joined by it, and more of either map may decide it.
//!
//! | line | what it catches | failing it |
//! |---|---|---|
//! | what both saw of each piece of surface ([`place_verdict`](crate::place_verdict)) | places that share things | refused; undecided where it does not tell and much differs, what is nowhere else speaks against, or anything does without a known grain |
//! | at least two keyframe pairs, each well known, agree on the motion | one view that looks alike by chance | undecided |
//! | matches γ over the agreeing pairs, at need with the further ones that agree | images that share a thing or two | undecided |
//! | pixels that agree after direct alignment, both ways, all agreeing pairs | places of the same shape with other texture, and the reverse | refused |
//! | the same of keyframes matched together, with a higher limit | places that are alike in part, where no pair of keyframes speaks for them alone | undecided |
//! | that share of all pixels, seen by both or not | things that repeat, shifted by one | refused |
//! | standard deviations of rotation, translation and scale, by all pairs that agree along both maps | closures that are right and useless | undecided |
//! | further pairs that should overlap and can be aligned | a place that looks alike, in other surroundings | refused; undecided where the surface tells by its grain that they are one |
//! | further pairs that should overlap and agree | the same, where single pairs look alike too | likewise |
//! | points that the other keyframe looks through | structure that is not there | refused |
//! | points whose contrast the other keyframe lacks | the same, where there is no depth | refused |
//! | patches that are looked through as a whole and look otherwise | places alike but for things that stand there | undecided, unless the surface tells by its grain that they are one |
//! | patches that look otherwise where all others look alike | the same, where what differs is flat | likewise |
//! | both together, each over its limit | the same, where a little of each differs | likewise |
//! | views with something of either sort | the same, where it is small and in every view | likewise |
//! | closures that agree on another motion | things that repeat | undecided |
//! | places that match nearly as well and speak for another motion | a row of equal houses, shifted by one | undecided |
//!
//! The next five need the closure alone; the others need both whole maps ([`further`](crate::further)) and are asked of
//! every closure of which some pair's images could be aligned, so that one that is refused is refused by all that speaks
//! against it.

mod doubt;
mod evidence;
mod params;
#[cfg(test)]
mod tests;

pub use doubt::Doubt;
pub use evidence::{Beyond, Evidence, PlaceEvidence};
pub use params::AcceptanceParams;

use backend::verdict::Answer;
use serde::{Deserialize, Serialize};
use std::borrow::Cow;

/// What a line of the test says.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Says {
    /// Nothing speaks against the closure here.
    For,
    /// Too little is known.
    Open,
    /// It contradicts the closure.
    Against,
}

/// A line of the test with its numbers.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Line {
    /// What is asked.
    pub name: Cow<'static, str>,
    /// What was found.
    pub value: f64,
    /// The limit it was compared with.
    pub limit: f64,
    /// What that says.
    pub says: Says,
}

/// The line of [`place_verdict`](crate::place_verdict).
const PLACE_LINE: &str = "probability of one place";

/// What is thought of a closure.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Decision {
    /// It is believed.
    Accepted,
    /// Nothing contradicts it, and too little is known to believe it.
    Undecided(Doubt),
    /// It is contradicted.
    Refused(Doubt),
}

/// A decision with all that it rests on.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Verdict {
    /// The numbers.
    pub evidence: Evidence,
    /// Every line that was asked.
    pub lines: Vec<Line>,
    /// What follows.
    pub decision: Decision,
    /// Whether a person said that both maps show one place.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub is_confirmed: bool,
}

impl Verdict {
    /// The verdict once a person says that both maps show one place: what they see alike, otherwise or not at all decides nothing any more.
    /// That the closure is right must still be shown.
    pub fn confirmed(&self, params: &AcceptanceParams) -> Self {
        judge_as(self.evidence, params, true)
    }

    /// Whether the closure is believed.
    pub fn accepts(&self) -> bool {
        self.decision == Decision::Accepted
    }

    /// Whether the surface alone speaks against the closure: a pose that fits in all else joins two places. At a wrong pose other
    /// lines fail too.
    pub fn is_double(&self) -> bool {
        let mut doubted = self.lines.iter().filter(|line| line.says != Says::For);
        doubted.next().is_some_and(|line| line.name == PLACE_LINE && line.says == Says::Against)
            && doubted.next().is_none()
    }

    /// The first line that contradicts, else the first that leaves it open; nothing where it is believed.
    pub fn doubt(&self) -> Option<Doubt> {
        match self.decision {
            Decision::Accepted => None,
            Decision::Undecided(doubt) | Decision::Refused(doubt) => Some(doubt),
        }
    }
}

/// Judges by the closure alone, and by the rest of both maps where the evidence has it.
pub fn judge(evidence: Evidence, params: &AcceptanceParams) -> Verdict {
    judge_as(evidence, params, false)
}

fn judge_as(evidence: Evidence, params: &AcceptanceParams, is_confirmed: bool) -> Verdict {
    let is_same_by_grain = evidence.place.as_ref().is_some_and(|place| is_same_by_grain(place, params));
    let mut test = Test { lines: Vec::new(), against: None, open: None, is_confirmed, is_same_by_grain };
    if let Some(place) = &evidence.place {
        test.place(place, params);
    }
    test.closure(&evidence, params);
    if let Some(beyond) = &evidence.beyond {
        test.beyond(beyond, params);
    }
    if let Some(share) = evidence.rival_place {
        let limit = params.max_rival_place;
        test.most("rival place", [share, limit], Says::Open, Doubt::OtherPlace { share, limit });
    }
    if let Some(place) = &evidence.place {
        test.leave_open(place, params);
    }
    let decision = match (test.against, test.open) {
        (Some(doubt), _) => Decision::Refused(doubt),
        (None, Some(doubt)) => Decision::Undecided(doubt),
        (None, None) => Decision::Accepted,
    };
    Verdict { evidence, lines: test.lines, decision, is_confirmed }
}

/// The lines so far, and the first doubts.
struct Test {
    lines: Vec<Line>,
    against: Option<Doubt>,
    open: Option<Doubt>,
    /// Whether it is known that the maps show one place.
    is_confirmed: bool,
    /// Whether the surface tells that they do, by its own grain.
    is_same_by_grain: bool,
}

impl Test {
    /// What both maps saw of the surface. Where that does not tell, [`Self::leave_open`] says so after all else.
    fn place(&mut self, place: &PlaceEvidence, params: &AcceptanceParams) {
        let (says, limit) = match place.answer {
            _ if self.is_confirmed => (Says::For, 1.0 - place.needed),
            _ if is_undecided(place, params) => (Says::Open, place.needed),
            Answer::Different => (Says::Against, 1.0 - place.needed),
            Answer::CannotTell => (Says::For, 1.0 - place.needed),
            Answer::Same | Answer::SameChanged => (Says::For, place.needed),
        };
        self.lines.push(Line { name: PLACE_LINE.into(), value: place.probability, limit, says });
        if says == Says::Against {
            let doubt = Doubt::Double { percent: 100.0 * place.changed, against: -place.ln_ratio };
            self.against.get_or_insert(doubt);
        }
    }

    /// Where that does not tell and much differs, said after all else: what another line lacks, more of either map may bring.
    fn leave_open(&mut self, place: &PlaceEvidence, params: &AcceptanceParams) {
        if is_undecided(place, params) && !self.is_confirmed {
            let doubt = Doubt::CannotTell { percent: 100.0 * place.changed, ln_ratio: place.ln_ratio };
            self.open.get_or_insert(doubt);
        }
    }

    /// The lines that need no more than the closure.
    fn closure(&mut self, evidence: &Evidence, params: &AcceptanceParams) {
        let Evidence { matches, pairs, .. } = *evidence;
        let (rotation, translation) = (evidence.rotation_deviation, evidence.translation_deviation);
        let scale = evidence.scale_deviation;
        let vague = Doubt::Vague { rotation, translation, scale };
        self.least(
            "keyframe pairs that agree",
            [pairs as f64, params.min_pairs as f64],
            Says::Open,
            Doubt::Unconfirmed { pairs, needed: params.min_pairs },
        );
        self.least(
            "matches",
            [matches as f64, params.min_matches as f64],
            Says::Open,
            Doubt::FewMatches { matches, needed: params.min_matches },
        );
        let (share, needed) = (evidence.inlier_share, params.min_inlier_share);
        self.least("pixels that agree", pair(share, needed), Says::Against, Doubt::Unlike { share, needed });
        if evidence.pooled {
            let needed = params.min_pooled_inlier_share;
            let doubt = Doubt::Unlike { share, needed };
            self.least("pixels that agree, keyframes together", pair(share, needed), Says::Open, doubt);
        }
        let (share, needed) = (evidence.total_inlier_share, params.min_total_inlier_share);
        let doubt = Doubt::LittleAgrees { share, needed };
        self.least("of all pixels", pair(share, needed), Says::Against, doubt);
        self.most("rotation deviation", [rotation, params.max_rotation_deviation], Says::Open, vague);
        self.most(
            "translation deviation",
            [translation, params.max_translation_deviation],
            Says::Open,
            vague,
        );
        self.most("scale deviation", [scale, params.max_scale_deviation], Says::Open, vague);
    }

    /// The lines that need both whole maps.
    fn beyond(&mut self, beyond: &Beyond, params: &AcceptanceParams) {
        let Beyond { tested, confirmed, closures, rival, .. } = *beyond;
        let needed = 100.0 * params.min_aligned_share;
        // Where much was moved, views of it cannot be aligned: against the grain of what stayed that is no contradiction.
        let against = if self.is_same_by_grain { Says::Open } else { Says::Against };
        self.least(
            "overlaps aligned",
            [beyond.aligned_share(), params.min_aligned_share],
            against,
            Doubt::Alone { confirmed: tested - beyond.failed, tested, needed },
        );
        let needed = 100.0 * params.min_confirmed_share;
        self.least(
            "overlaps confirmed",
            [beyond.confirmed_share(), params.min_confirmed_share],
            against,
            Doubt::Alone { confirmed, tested, needed },
        );
        let (share, limit) = (beyond.through_share, params.max_through_share);
        self.most("seen through", [share, limit], Says::Against, Doubt::SeenThrough { share, limit });
        let (share, limit) = (beyond.missing_share, params.max_missing_share);
        self.most("missing", [share, limit], Says::Against, Doubt::Missing { share, limit });
        // What differs is among the pieces that the surface was judged by.
        let otherwise = if self.is_confirmed || self.is_same_by_grain { Says::For } else { Says::Open };
        let enough = |views: usize, share: f64| if views < params.min_views { 0.0 } else { share };
        let (views, limit) = (beyond.absent_views, params.max_absent_share);
        let share = enough(views, beyond.absent_share);
        let doubt = Doubt::Absent { views, share, limit };
        self.most("patches seen through", [share, limit], otherwise, doubt);
        let (views, limit) = (beyond.unlike_views, params.max_unlike_share);
        let share = enough(views, beyond.unlike_share);
        let doubt = Doubt::OtherLook { views, share, limit };
        self.most("patches that look otherwise", [share, limit], otherwise, doubt);
        let (absent, unlike) = (beyond.absent_share, beyond.unlike_share);
        let sum = absent / params.max_absent_share + unlike / params.max_unlike_share;
        let sum = enough(beyond.absent_views + beyond.unlike_views, sum);
        let doubt = Doubt::AbsentAndOtherLook { absent, unlike, sum };
        self.most("patches of both sorts", [sum, 1.0], otherwise, doubt);
        let (absent, unlike, limit) = (beyond.absent_views, beyond.unlike_views, params.max_differing_share);
        let share = enough(absent + unlike, beyond.differing_share());
        let doubt = Doubt::InManyViews { views: beyond.views, absent, unlike, share, limit };
        self.most("views that differ", [share, limit], otherwise, doubt);
        let doubt = Doubt::Rival { closures, rival };
        self.most("rival", [beyond.rival_share(), params.max_rival_share], Says::Open, doubt);
    }

    /// A line that asks for so much at least. What is no number fails it.
    fn least(&mut self, name: &'static str, [value, limit]: [f64; 2], otherwise: Says, doubt: Doubt) {
        self.line(name, [value, limit], value >= limit, otherwise, doubt);
    }

    /// A line that allows so much at most. What is no number fails it.
    fn most(&mut self, name: &'static str, [value, limit]: [f64; 2], otherwise: Says, doubt: Doubt) {
        self.line(name, [value, limit], value <= limit, otherwise, doubt);
    }

    fn line(
        &mut self,
        name: &'static str,
        [value, limit]: [f64; 2],
        holds: bool,
        otherwise: Says,
        doubt: Doubt,
    ) {
        self.say(name, [value, limit], if holds { Says::For } else { otherwise }, doubt);
    }

    fn say(&mut self, name: &'static str, [value, limit]: [f64; 2], says: Says, doubt: Doubt) {
        self.lines.push(Line { name: name.into(), value, limit, says });
        let first = match says {
            Says::For => return,
            Says::Open => &mut self.open,
            Says::Against => &mut self.against,
        };
        first.get_or_insert(doubt);
    }
}

/// Whether the surface tells that the place is one, and has a grain of its own for certain and in all of it, which would be another in a double.
/// What differs is weighed in that.
fn is_same_by_grain(place: &PlaceEvidence, params: &AcceptanceParams) -> bool {
    matches!(place.answer, Answer::Same | Answer::SameChanged)
        && place.grain >= place.needed
        && place.inlier_wear >= params.min_inlier_wear
}

/// Whether the surface leaves it open whether the place is one, so that other lines may not tell either. It does where more differs than is
/// expected and no grain is known, which would be another in a double. Where it does not tell one place from two, it does too if so much
/// differs, two places are so much likelier, or what is nowhere else speaks for two though all else is alike.
fn is_undecided(place: &PlaceEvidence, params: &AcceptanceParams) -> bool {
    let is_unlikely = place.probability.is_nan() || place.probability < params.min_undecided_probability;
    let is_worn_otherwise = place.own.is_nan() || place.own < 0.0;
    let is_known_grain = place.grain >= place.needed;
    let is_unexplained = place.changed > place.expected_change && !is_known_grain;
    match place.answer {
        Answer::Different => false,
        Answer::Same | Answer::SameChanged => is_unexplained,
        Answer::CannotTell => {
            is_unexplained || is_unlikely || is_worn_otherwise || place.changed >= params.min_undecided_change
        }
    }
}

/// A value and its limit as they are compared.
fn pair(value: f32, limit: f32) -> [f64; 2] {
    [f64::from(value), f64::from(limit)]
}
