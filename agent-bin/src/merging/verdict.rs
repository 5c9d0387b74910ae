//! What came of a merging, in words.

use super::{Encounter, Input, Merging, Names};
use map::AgentId;
use merge::acceptance::Evidence;
use merge::closure::Closure;
use merge::meeting::Outcome;
use merge::pairing::Travel;
use std::fmt::Write;

/// The verdict on every pair of maps, a few lines each.
pub fn verdict(inputs: &[Input], merging: &Merging) -> String {
    merging.encounters.iter().fold(String::new(), |text, encounter| text + &of_pair(inputs, encounter))
}

/// The agents that hang together with nobody, where others do.
pub fn without_company(merging: &Merging, names: &Names) -> Vec<String> {
    let lonely = merging.fused.iter().filter_map(|fused| match fused.agents[..] {
        [agent] => Some(names.of(agent).to_owned()),
        _ => None,
    });
    lonely.collect()
}

/// The verdict on a pair of maps.
fn of_pair(inputs: &[Input], encounter: &Encounter) -> String {
    let mut text = format!("{} + {}: ", inputs[encounter.target].name, inputs[encounter.source].name);
    match encounter.accepted().map(|tried| &tried.outcome) {
        Some(Outcome::Accepted(closure, evidence)) => accepted(&mut text, encounter, closure, evidence),
        _ => refused(&mut text, encounter),
    }
    text
}

// Writing to a String cannot fail.
fn accepted(text: &mut String, encounter: &Encounter, closure: &Closure, evidence: &Evidence) {
    let travel = match closure.travel {
        Travel::Same => "travelling the same way",
        Travel::Opposite => "travelling opposite ways",
        Travel::Unknown => "direction of travel unknown",
    };
    let _ = writeln!(text, "accepted, {travel}");
    let _ = writeln!(
        text,
        "  {} key points (γ) match over {} keyframe pairs; {:.0} % of the pixels agree",
        evidence.matches,
        evidence.pairs,
        100.0 * evidence.inlier_share
    );
    let _ = writeln!(
        text,
        "  scale σ* {:.4} ± {:.4}; motion known to {:.2}° and {:.2} % of the scale",
        closure.scale.scale,
        closure.scale.variance.sqrt(),
        evidence.rotation_deviation,
        100.0 * evidence.scale_deviation
    );
    if let Some(joined) = &encounter.joined {
        let _ = writeln!(
            text,
            "  {} closures join them ({} more disagreed, {} could not be aligned)",
            joined.edges.len(),
            joined.rejected.len(),
            joined.failed
        );
    }
}

fn refused(text: &mut String, encounter: &Encounter) {
    let _ = writeln!(text, "refused: {}", encounter.refusal().unwrap_or_default());
    let tried = encounter.tried.len();
    if let Some(closest) = encounter.closest().filter(|closest| closest.match_count > 0) {
        let (place, count) = (closest.place, closest.match_count);
        let _ = writeln!(
            text,
            "  best of {tried} places tried: keyframes {} and {}, {count} key points match",
            place.target.0, place.source.0
        );
    } else if tried > 0 {
        let _ = writeln!(text, "  {tried} places tried, and in none do the images fit");
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
        for encounter in &self.encounters {
            let names = [encounter.target, encounter.source].map(|index| &*inputs[index].name);
            if let Some(joined) = &encounter.joined {
                let closures = format!("{} closures", joined.edges.len());
                pairs.push((format!("{} + {}", names[0], names[1]), closures));
            }
        }
        pairs
    }

    /// Whether any two of the inputs were merged.
    pub fn anything_met(&self) -> bool {
        self.encounters.iter().any(|encounter| encounter.accepted().is_some())
    }

    /// The agents of each common map.
    pub fn groups(&self) -> impl Iterator<Item = &[AgentId]> {
        self.fused.iter().map(|fused| &fused.agents[..])
    }
}
