//! What came of a merging, in words.

use super::{Input, Merging, Names, PairResult};
use map::AgentId;
use merge::acceptance::{AcceptanceParams, PlaceEvidence};
use merge::common_map::Addresses;
use merge::pairing::Travel;
use merge::verification::EvaluatedClosure;
use std::fmt::Write;

/// The verdict on every pair of maps, a few lines each.
pub fn verdicts<'a>(inputs: &'a [Input], merging: &'a Merging) -> impl Iterator<Item = String> + 'a {
    merging.pair_results.iter().map(|pair_result| of_pair(inputs, Some(merging), &pair_result))
}

/// The agents that hang together with nobody, where others do.
pub fn isolated_agents(merging: &Merging, names: &Names) -> Vec<String> {
    let lonely = merging.fused.iter().filter_map(|fused| match fused.agents[..] {
        [agent] => Some(names.of(agent).to_owned()),
        _ => None,
    });
    lonely.collect()
}

/// Why two inputs are not merged, be it that the merge was taken back; nothing where they are.
#[cfg(feature = "fleet")]
pub(crate) fn refusal_of(merging: &Merging, pair_result: &PairResult) -> Option<String> {
    let undone = || merging.undone([pair_result.target, pair_result.source]);
    pair_result.refusal().or_else(|| undone().map(|why| format!("taken back: {why}")))
}

/// The verdict on a pair of maps, a few lines, whatever others there are.
pub(crate) fn of_pair_alone(inputs: &[Input], pair_result: &PairResult) -> String {
    of_pair(inputs, None, pair_result)
}

/// The verdict on a pair of maps.
fn of_pair(inputs: &[Input], merging: Option<&Merging>, pair_result: &PairResult) -> String {
    let [first, second] = pair_result.as_given().map(|input| &inputs[input].name);
    let mut text = format!("{first} + {second}: ");
    match pair_result.accepted().filter(|_| pair_result.error.is_none()) {
        Some(evaluated) => accepted(&mut text, merging, pair_result, evaluated),
        None => refused(&mut text, pair_result),
    }
    if pair_result.can_be_confirmed(&AcceptanceParams::default()) {
        let _ = writeln!(text, "  if you know that both show one place: --confirm {first}+{second}");
    }
    text
}

// Writing to a String cannot fail.
fn accepted(
    text: &mut String,
    merging: Option<&Merging>,
    pair_result: &PairResult,
    evaluated: &EvaluatedClosure,
) {
    let EvaluatedClosure { closure, verdict, .. } = evaluated;
    let evidence = &verdict.evidence;
    let travel = match closure.travel {
        Travel::Same => "travelling the same way",
        Travel::Opposite => "travelling opposite ways",
        Travel::Unknown => "direction of travel unknown",
    };
    if let Some(reason) = merging.and_then(|merging| merging.undone([pair_result.target, pair_result.source]))
    {
        let _ = writeln!(text, "accepted, {travel}, and taken back: {reason}");
        return;
    }
    let _ = writeln!(text, "accepted, {travel}");
    let _ = writeln!(
        text,
        "  {} key points (γ) match over {} keyframe pairs; {:.0} % of the pixels agree",
        evidence.matches,
        evidence.pairs,
        100.0 * evidence.inlier_share
    );
    if let Some(place) = evidence.place {
        let phrase = match place.answer {
            _ if verdict.is_confirmed => of_place_as("  confirmed by a person; by the surface", &place),
            answer if answer.joins() => of_place(&place),
            _ => of_place_as("  the surface alone does not tell, and all other tests agree", &place),
        };
        let _ = writeln!(text, "{phrase}");
    }
    // σ* is the target's unit in terms of the source's.
    let upright = |scale: f64| if pair_result.source < pair_result.target { scale.recip() } else { scale };
    let star = upright(closure.scale.scale);
    let applied = merging.and_then(|merging| merging.scale(pair_result));
    let scale = applied.unwrap_or(upright(closure.motion.a_from_b.scale));
    let _ = writeln!(
        text,
        "  scale {scale:.4} (σ* of the key points {:.4} ± {:.4}); motion known to {:.2}°, {:.1} % of the scene's depth \
         and {:.2} % of the scale",
        star,
        star * closure.scale.variance.sqrt() / closure.scale.scale,
        evidence.rotation_deviation,
        100.0 * evidence.translation_deviation,
        100.0 * evidence.scale_deviation
    );
    if let Some(joined) = &pair_result.joined {
        let _ = writeln!(
            text,
            "  {} closures join them ({} more disagreed, {} could not be aligned)",
            joined.edges.len(),
            joined.rejected.len(),
            joined.failed
        );
    }
}

/// What both saw of the surface, in a line.
fn of_place(place: &PlaceEvidence) -> String {
    of_place_as(&format!("  {}", place.answer), place)
}

/// The same after other words than the answer's.
fn of_place_as(phrase: &str, place: &PlaceEvidence) -> String {
    format!(
        "{phrase}: one place with a probability of {:.4}, {:.1} % of the things that both see differ",
        place.probability,
        // The share of nothing is −0.
        100.0 * place.changed.abs()
    )
}

fn refused(text: &mut String, pair_result: &PairResult) {
    let decision = if pair_result.is_undecided() { "undecided" } else { "refused" };
    let _ = writeln!(text, "{decision}: {}", pair_result.refusal().unwrap_or_default());
    if let Some(place) = pair_result.decisive().and_then(|evaluated| evaluated.verdict.evidence.place) {
        let _ = writeln!(text, "{}", of_place(&place));
    }
    let tested = pair_result.tested.len();
    if let Some(closest) = pair_result.closest().filter(|closest| closest.match_count > 0) {
        // The keyframe of the map that was given first comes first.
        let (place, count) = (closest.place, closest.match_count);
        let mut keyframes = [place.target.0, place.source.0];
        if pair_result.source < pair_result.target {
            keyframes.reverse();
        }
        let [first, second] = keyframes;
        let _ = writeln!(
            text,
            "  best of {tested} places tried: keyframes {first} and {second}, {count} key points match"
        );
    } else if tested > 0 {
        let _ = writeln!(text, "  {tested} places tried, and in none do the images fit");
    }
}

impl Merging {
    /// How the common maps came to be, to be kept in their files: nothing in it differs between two runs of the
    /// same command.
    pub fn provenance(&self, inputs: &[Input], params: &super::MergingParams) -> Vec<(String, String)> {
        let parameters = if *params == super::MergingParams::default() {
            "defaults".to_owned()
        } else {
            serde_json::to_string(params).unwrap_or_default()
        };
        let maps: Vec<String> = inputs.iter().map(|input| input.path.display().to_string()).collect();
        let mut pairs = vec![
            ("program".to_owned(), concat!("loopbox ", env!("CARGO_PKG_VERSION")).to_owned()),
            ("maps".to_owned(), maps.join("\n")),
            ("parameters".to_owned(), parameters),
        ];
        for ([target, source], joined) in self.pair_results.joined() {
            let names = [target.min(source), target.max(source)].map(|index| &*inputs[index].name);
            let closures = format!("{} closures", joined.edges.len());
            pairs.push((format!("{} + {}", names[0], names[1]), closures));
        }
        pairs
    }

    /// Whether any two of the inputs were merged, and the merge stands.
    pub fn any_joined(&self) -> bool {
        self.pair_results.joined().any(|(pair, _)| self.undone(pair).is_none())
    }

    /// Why the common map took back the merge of two inputs; nothing where it stands, or there was none.
    pub(crate) fn undone(&self, pair: [usize; 2]) -> Option<&str> {
        let [a, b] = pair.map(|input| &self.addresses[input]);
        let between = |(one, other): (AgentId, AgentId)| {
            let of = |agent: AgentId, addresses: &Addresses| addresses.agents().any(|own| own == agent);
            of(one, a) && of(other, b) || of(one, b) && of(other, a)
        };
        // Few merges are taken back, and links are many.
        let taken = self.taken_back.iter().find(|taken| between(taken.agents))?;
        let stands = self.common.links().iter().any(|link| between(link.agents()));
        (!stands).then_some(&*taken.why)
    }

    /// By how much the unit of the input given second differs from that of the first in the common map: the scale that
    /// was applied. Of inputs of several agents that of the first agents of both.
    fn scale(&self, pair_result: &PairResult) -> Option<f64> {
        let agents = pair_result.as_given().map(|input| self.addresses[input].agents().next());
        let [first, second] = agents;
        let (first, second) = (first?, second?);
        let component = self.fused.iter().map(|fused| &fused.component);
        component.into_iter().find_map(|component| {
            let (first, second) = (component.agents.get(&first)?, component.agents.get(&second)?);
            Some(second.root_from_agent.scale / first.root_from_agent.scale)
        })
    }

    /// The agents of each common map.
    pub fn groups(&self) -> impl Iterator<Item = &[AgentId]> {
        self.fused.iter().map(|fused| &fused.agents[..])
    }
}
