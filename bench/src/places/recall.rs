//! Precision and recall over all ordered pairs of sequences.

use crate::curve::{Curve, Verdict};
use crate::truth::Sequence;
use map::{KeyframeId, PlaceCandidate, PlaceIndex};
use measuring::views::{DIFFERENT, SAME};
use place_recog::{
    BowIndex, BowParams, FabMap, FabMapParams, SequenceParams, Vocabulary, WordBag, supported,
};
use std::fmt::Write;
use std::sync::Arc;

/// Candidates asked for in each query.
const CANDIDATES: usize = 10;

/// What is done with the candidates of the words.
#[derive(Clone, Copy, PartialEq)]
enum Then {
    Nothing,
    /// Neighbouring keyframes support each other's candidates.
    Neighbours,
    /// They are ranked by the features they share with the query.
    SharedFeatures,
}

struct Method {
    name: &'static str,
    index: fn(&Arc<Vocabulary>) -> Box<dyn PlaceIndex<WordBag>>,
    then: Then,
}

fn bow(vocabulary: &Arc<Vocabulary>) -> Box<dyn PlaceIndex<WordBag>> {
    Box::new(BowIndex::new(Arc::clone(vocabulary), BowParams::default()))
}

fn fab_map(vocabulary: &Arc<Vocabulary>) -> Box<dyn PlaceIndex<WordBag>> {
    Box::new(FabMap::new(Arc::clone(vocabulary), FabMapParams::default()))
}

const METHODS: [Method; 5] = [
    Method { name: "bag of words", index: bow, then: Then::Nothing },
    Method { name: "bag of words, neighbours", index: bow, then: Then::Neighbours },
    Method { name: "bag of words, shared features", index: bow, then: Then::SharedFeatures },
    Method { name: "FAB-MAP", index: fab_map, then: Then::Nothing },
    Method { name: "FAB-MAP, neighbours", index: fab_map, then: Then::Neighbours },
];

/// Tables of all methods.
pub fn report(sequences: &[Sequence], vocabulary: &Arc<Vocabulary>) -> String {
    let mut out = format!(
        "Each keyframe of one map is looked for in another map, for all ordered pairs of maps; its best candidate \
         counts. It is right when at least {:.0} % of the points of each keyframe lie in the other's image by \
         the true poses, wrong below {:.0} %. Maps of different worlds share nothing. Recall is the share of \
         keyframes that have a right candidate; *at full precision* is with the lowest threshold that lets no wrong \
         candidate pass. The vocabulary saw none of these images in training.\n\n",
        100.0 * SAME,
        100.0 * DIFFERENT
    );
    let curves: Vec<Vec<(String, bool, Curve)>> =
        METHODS.iter().map(|method| all_pairs(sequences, vocabulary, method)).collect();
    out.push_str(
        "| all pairs | keyframes with a right answer | best is right | recall at full precision | at 99 % | average \
         precision | threshold |\n|---|---|---|---|---|---|---|\n",
    );
    for (method, pairs) in METHODS.iter().zip(&curves) {
        let mut all = Curve::default();
        pairs.iter().for_each(|(_, _, curve)| all.join(curve));
        let _ = writeln!(out, "| {} | {} |", method.name, cells(&all));
    }
    out.push_str("\n| pair, recall at full precision within the pair |");
    METHODS.iter().for_each(|method| _ = write!(out, " {} |", method.name));
    out.push_str(&format!("\n|---{}|\n", "|---".repeat(METHODS.len())));
    for (i, (pair, related, _)) in curves[0].iter().enumerate() {
        if *related {
            let _ = write!(out, "| {pair} |");
            for of_method in &curves {
                let curve = &of_method[i].2;
                let _ =
                    write!(out, " {} of {} |", percent(curve.recall_at(1.0).map(|r| r.0)), curve.possible());
            }
            out.push('\n');
        }
    }
    out.push_str("\n| over all pairs |");
    METHODS.iter().for_each(|method| _ = write!(out, " {} |", method.name));
    out.push_str(&format!("\n|---{}|\n", "|---".repeat(METHODS.len())));
    let strangers = |pairs: &[(String, bool, Curve)]| {
        pairs.iter().filter(|pair| !pair.1).map(|pair| pair.2.highest()).fold(0.0, f32::max)
    };
    out.push_str("| highest score between worlds |");
    curves.iter().for_each(|pairs| _ = write!(out, " {:.3} |", strangers(pairs)));
    out.push_str("\n| recall above it |");
    for pairs in &curves {
        let mut all = Curve::default();
        pairs.iter().for_each(|(_, _, curve)| all.join(curve));
        let _ = write!(out, " {} |", percent(Some(all.recall_above(strangers(pairs)))));
    }
    out.push('\n');
    out
}

fn cells(curve: &Curve) -> String {
    let full = curve.recall_at(1.0);
    let cells = [
        curve.possible().to_string(),
        percent(Some(curve.recall())),
        percent(full.map(|f| f.0)),
        percent(curve.recall_at(0.99).map(|f| f.0)),
        format!("{:.3}", curve.average_precision()),
        full.map_or("–".to_owned(), |f| format!("{:.3}", f.1)),
    ];
    cells.join(" | ")
}

fn percent(share: Option<f64>) -> String {
    format!("{:.0} %", 100.0 * share.unwrap_or(0.0))
}

/// Of each ordered pair its name, whether both share a world, and its curve.
fn all_pairs(
    sequences: &[Sequence],
    vocabulary: &Arc<Vocabulary>,
    method: &Method,
) -> Vec<(String, bool, Curve)> {
    let mut curves = Vec::new();
    for target in sequences {
        let mut index = (method.index)(vocabulary);
        target.keyframes.iter().for_each(|keyframe| index.add(keyframe.id, &keyframe.words));
        let ids: Vec<KeyframeId> = target.keyframes.iter().map(|keyframe| keyframe.id).collect();
        for query in sequences.iter().filter(|query| query.name != target.name) {
            let mut answers: Vec<Vec<PlaceCandidate>> =
                query.keyframes.iter().map(|k| index.query(&k.words, CANDIDATES)).collect();
            match method.then {
                Then::Nothing => {}
                Then::Neighbours => answers = supported(&answers, &ids, &SequenceParams::default()),
                Then::SharedFeatures => rank(&mut answers, query, target),
            }
            let name = format!("`{}` in `{}`", query.name, target.name);
            curves.push((name, query.shares_world(target), judge(query, target, &answers)));
        }
    }
    curves
}

/// Scores candidates anew by the features they share with the query, and puts the best first.
fn rank(answers: &mut [Vec<PlaceCandidate>], query: &Sequence, target: &Sequence) {
    for (candidates, asked) in answers.iter_mut().zip(&query.keyframes) {
        for candidate in candidates.iter_mut() {
            let found = target.keyframes.iter().find(|keyframe| keyframe.id == candidate.keyframe);
            candidate.score = found.map_or(0.0, |keyframe| asked.shared(keyframe));
        }
        candidates.sort_by(|a, b| b.score.total_cmp(&a.score));
    }
}

fn judge(query: &Sequence, target: &Sequence, answers: &[Vec<PlaceCandidate>]) -> Curve {
    let mut curve = Curve::default();
    for (i, candidates) in answers.iter().enumerate() {
        let overlap = |j: usize| query.overlap(i, target, j);
        if (0..target.keyframes.len()).any(|j| overlap(j) >= SAME) {
            curve.expect();
        }
        let Some(best) = candidates.first() else { continue };
        let Ok(j) = target.keyframes.binary_search_by_key(&best.keyframe, |k| k.id) else { continue };
        let verdict = match overlap(j) {
            share if share >= SAME => Verdict::Right,
            share if share < DIFFERENT => Verdict::Wrong,
            _ => Verdict::Unclear,
        };
        curve.answer(best.score, verdict);
    }
    curve
}
