//! What became of every two of the maps: verdicts, the three keyframe pairs of a closure, the places tried.

use super::matches::{Matches, Pictures};
use super::place::Places;
use crate::merging::{Input, PairResult, Seconds};
use map::KeyframeId;
use merge::acceptance::{Decision, Evidence};
use merge::closure::PairOutcome;
use merge::optimal_scale::{Basis, OptimalScale};
use merge::pairing::Travel;
use merge::verification::{EvaluatedClosure, Outcome, TestedPlace};
use serde::Serialize;

/// Two of the maps.
#[derive(Serialize)]
pub struct PairReport {
    /// Index of the map that was looked in.
    target: usize,
    /// Index of the map whose keyframes were looked for, which joins the other.
    source: usize,
    /// Places that place recognition proposed.
    proposed: usize,
    places: Vec<Attempt>,
    /// The closure that was accepted, or else the best that was doubted.
    closure: Option<ClosureView>,
    /// In a word.
    verdict: &'static str,
    /// Why the maps were not merged; nothing where they were.
    refusal: Option<String>,
    /// Closures along both maps.
    closures: Option<Closures>,
    seconds: Seconds,
}

/// A place that was tried.
#[derive(Serialize)]
struct Attempt {
    keyframes: Keyframes,
    /// γ.
    match_count: usize,
    accepted: bool,
    /// What became of it, in words.
    outcome: String,
}

/// Keyframes of a pair.
#[derive(Serialize)]
struct Keyframes {
    source: u32,
    target: u32,
    /// Indices in the scene, where they are shown.
    in_scene: [Option<usize>; 2],
}

#[derive(Serialize)]
struct Closures {
    used: usize,
    rejected: usize,
    failed: usize,
}

/// A closure with its evidence.
#[derive(Serialize)]
struct ClosureView {
    accepted: bool,
    travel: &'static str,
    evidence: Evidence,
    /// z = −1, 0, 1.
    pairs: [Option<PairView>; 3],
    /// Which of them gave the initial guess.
    chosen: usize,
    /// σ* by inverse variance.
    scale: ScaleView,
    /// σ* by Algorithm 1, or why it gives none.
    algorithm_1: Result<ScaleView, String>,
    /// Registration of the clouds, or why there is none.
    registration: Result<RegistrationView, String>,
}

/// σ*.
#[derive(Serialize)]
struct ScaleView {
    scale: f64,
    deviation: f64,
    /// Δ.
    scale_gap: f64,
    /// Which of z = −1, 0, 1 went into it.
    used: [bool; 3],
    basis: &'static str,
}

#[derive(Serialize)]
struct RegistrationView {
    rmse: f64,
    inlier_share: f64,
    overlap: f64,
    iterations: usize,
    converged: bool,
}

/// One of the three pairs.
#[derive(Serialize)]
struct PairView {
    keyframes: Keyframes,
    /// Indices of the pictures, source and target.
    pictures: [Option<usize>; 2],
    matches: Option<Matches>,
    /// σ_z of the worlds with its standard deviation.
    scale: Option<[f64; 2]>,
    direct: Option<DirectView>,
    agrees: bool,
    /// What it came to, in words.
    verdict: String,
}

/// Alignment of the two images.
#[derive(Serialize)]
struct DirectView {
    rmse: f32,
    inlier_share: f32,
    overlap: f32,
}

impl PairReport {
    /// What a pair of maps came to.
    ///
    /// # Errors
    /// When a key image cannot be encoded.
    pub fn new(
        inputs: &[Input],
        pair_result: &PairResult,
        places: &Places,
        pictures: &mut Pictures,
    ) -> anyhow::Result<Self> {
        let pair = Inputs { inputs, places, indices: [pair_result.source, pair_result.target] };
        let closure = best(pair_result);
        Ok(Self {
            target: pair_result.target,
            source: pair_result.source,
            proposed: pair_result.proposed,
            places: pair_result.tested.iter().map(|tested| pair.attempt(tested)).collect(),
            closure: closure.map(|evaluated| pair.closure(evaluated, pair_result, pictures)).transpose()?,
            verdict: pair_result.verdict(),
            refusal: pair_result.refusal().map(|reason| sentence(&reason)),
            closures: pair_result.joined.as_ref().map(|joined| Closures {
                used: joined.edges.len(),
                rejected: joined.rejected.len(),
                failed: joined.failed,
            }),
            seconds: pair_result.seconds,
        })
    }
}

/// A reason as a sentence.
fn sentence(reason: &str) -> String {
    let mut letters = reason.chars();
    let first = letters.next().map(|letter| letter.to_uppercase().to_string()).unwrap_or_default();
    format!("{first}{}.", letters.as_str())
}

/// The accepted closure, or else the best that was judged.
fn best(pair_result: &PairResult) -> Option<&EvaluatedClosure> {
    let doubted = pair_result.tested.iter().filter(|tested| tested.outcome.evaluated().is_some());
    let closest = || doubted.max_by_key(|tested| (tested.outcome.is_undecided(), tested.match_count));
    pair_result.accepted().or_else(|| closest()?.outcome.evaluated())
}

/// What became of a place.
fn words(outcome: &Outcome) -> String {
    match outcome {
        Outcome::NotMatched(refusal) => format!("The images do not fit: {refusal}."),
        Outcome::NotFollowed => "Matched, not followed: better places came first.".to_owned(),
        Outcome::NotClosed(refusal) => format!("No closure: {refusal}."),
        Outcome::Broken(error) => format!("Closure not usable: {error}."),
        Outcome::Evaluated(evaluated) => match evaluated.verdict.decision {
            Decision::Accepted => "Accepted.".to_owned(),
            Decision::Undecided(doubt) => format!("Closure undecided: {doubt}."),
            Decision::Refused(doubt) => format!("Closure refused: {doubt}."),
        },
    }
}

/// The two inputs of a pair of maps.
struct Inputs<'a> {
    inputs: &'a [Input],
    places: &'a Places<'a>,
    /// Source and target.
    indices: [usize; 2],
}

impl Inputs<'_> {
    fn attempt(&self, tested: &TestedPlace) -> Attempt {
        Attempt {
            keyframes: self.keyframes(tested.place.source, tested.place.target),
            match_count: tested.match_count,
            accepted: tested.outcome.accepted().is_some(),
            outcome: words(&tested.outcome),
        }
    }

    fn keyframes(&self, source: KeyframeId, target: KeyframeId) -> Keyframes {
        let in_scene = |side: usize, id: KeyframeId| {
            let keyframe = self.inputs[self.indices[side]].map.keyframes.get(&id)?;
            self.places.of(self.indices[side], keyframe)
        };
        Keyframes { source: source.0, target: target.0, in_scene: [in_scene(0, source), in_scene(1, target)] }
    }

    fn closure(
        &self,
        evaluated: &EvaluatedClosure,
        pair_result: &PairResult,
        pictures: &mut Pictures,
    ) -> anyhow::Result<ClosureView> {
        let closure = &evaluated.closure;
        let mut pairs = [None, None, None];
        for (z, view) in pairs.iter_mut().enumerate() {
            if let Some(outcome) = &closure.pairs[z] {
                let scale = closure.scales[z].map(|scale| [scale.scale, scale.variance.sqrt()]);
                *view = Some(self.pair(outcome, scale, pictures)?);
            }
        }
        let travel = match closure.travel {
            Travel::Same => "the same way",
            Travel::Opposite => "opposite ways",
            Travel::Unknown => "a way that the matches do not tell",
        };
        let registration = closure.registration.as_ref().map(|found| RegistrationView {
            rmse: found.rmse,
            inlier_share: found.inlier_share,
            overlap: found.overlap,
            iterations: found.iterations,
            converged: found.converged,
        });
        Ok(ClosureView {
            accepted: pair_result.accepted().is_some(),
            travel,
            evidence: evaluated.verdict.evidence,
            pairs,
            chosen: closure.chosen,
            scale: ScaleView::new(&closure.scale),
            algorithm_1: closure.algorithm_1.as_ref().map(ScaleView::new).map_err(ToString::to_string),
            registration: registration.map_err(ToString::to_string),
        })
    }

    fn pair(
        &self,
        outcome: &PairOutcome,
        scale: Option<[f64; 2]>,
        pictures: &mut Pictures,
    ) -> anyhow::Result<PairView> {
        let keyframes = self.keyframes(outcome.source, outcome.target);
        let mut displayed = [None, None];
        for (side, id) in [outcome.source, outcome.target].into_iter().enumerate() {
            let input = self.indices[side];
            if let Some(keyframe) = self.inputs[input].map.keyframes.get(&id) {
                displayed[side] = pictures.of(input, keyframe, keyframes.in_scene[side])?;
            }
        }
        let [source, target] = self.indices.map(|index| &self.inputs[index]);
        let direct = outcome.direct.as_ref().and_then(|direct| direct.as_ref().ok());
        Ok(PairView {
            keyframes,
            pictures: displayed,
            matches: Matches::new(source, target, outcome),
            scale,
            direct: direct.map(|direct| DirectView {
                rmse: direct.rmse,
                inlier_share: direct.inlier_share,
                overlap: direct.overlap,
            }),
            agrees: outcome.agrees,
            verdict: pair_words(outcome),
        })
    }
}

impl ScaleView {
    fn new(found: &OptimalScale) -> Self {
        Self {
            scale: found.scale,
            deviation: found.variance.sqrt(),
            scale_gap: found.scale_gap,
            used: found.used,
            basis: match found.basis {
                Basis::Agreement => "pairs that agree",
                Basis::Single => "the only pair that has a scale",
                Basis::Centre => "the centre pair alone",
                Basis::Neighbourhood => "the keyframes around the place together",
            },
        }
    }
}

/// What one of the three pairs came to.
fn pair_words(outcome: &PairOutcome) -> String {
    match (&outcome.measured, &outcome.direct) {
        (Err(_), Some(Ok(_))) if outcome.agrees => "Used, aligned on the images alone.".to_owned(),
        (Err(refusal), _) => format!("Not measured: {refusal}."),
        (Ok(_), Some(Err(refusal))) => {
            format!("By key points only; the images could not be aligned: {refusal}.")
        }
        (Ok(_), _) if outcome.agrees => "Used.".to_owned(),
        (Ok(_), _) => "Left out: it contradicts the others.".to_owned(),
    }
}
