//! What was found out as it goes over a link: who is meant and what is said once, and pairs by the numbers of these. Of a
//! hundred agents every two were looked at, most of them with the same words.

use super::{MergeResults, PairVerdict, PlacedAgent};
use crate::manifest::MAX_LIST;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Bytes of text that all pairs may have together once each has its own: sixteen times what a message holds. Without a
/// bound, a message of few words that many pairs share would take any memory.
const MAX_TEXT: usize = 16 * MAX_LIST as usize;

/// The numbers of two agents, of a verdict and of the reason if there is one, and whether more is being looked at.
type Pair = (usize, usize, usize, Option<usize>, bool);

/// Findings with every text once.
#[derive(Default, Serialize, Deserialize)]
#[serde(default)]
pub(super) struct Folded {
    agents: Vec<PlacedAgent>,
    /// Identities and names.
    who: Vec<(String, String)>,
    /// Verdicts and reasons.
    texts: Vec<String>,
    pairs: Vec<Pair>,
    /// As versions before told them.
    #[serde(rename = "meetings", skip_serializing)]
    pair_verdicts: Vec<PairVerdict>,
}

/// Numbers things in the order in which they come.
struct Numbers<T>(BTreeMap<T, usize>);

impl<T: Ord> Numbers<T> {
    fn of(&mut self, thing: T) -> usize {
        let next = self.0.len();
        *self.0.entry(thing).or_insert(next)
    }

    fn in_order(self) -> Vec<T> {
        let mut all: Vec<(T, usize)> = self.0.into_iter().collect();
        all.sort_by_key(|(_, number)| *number);
        all.into_iter().map(|(thing, _)| thing).collect()
    }
}

impl Folded {
    pub fn of(found: &MergeResults) -> Self {
        let (mut who, mut texts) = (Numbers(BTreeMap::new()), Numbers(BTreeMap::new()));
        let pair = |pair_verdict: &PairVerdict| {
            let mut agent =
                |k: usize| who.of((pair_verdict.agents[k].clone(), pair_verdict.names[k].clone()));
            let (a, b) = (agent(0), agent(1));
            let verdict = texts.of(pair_verdict.verdict.clone());
            (a, b, verdict, pair_verdict.why.clone().map(|why| texts.of(why)), pair_verdict.pending)
        };
        let pairs = found.pair_verdicts.iter().map(pair).collect();
        let (who, texts) = (who.in_order(), texts.in_order());
        Self { agents: found.agents.clone(), who, texts, pairs, pair_verdicts: Vec::new() }
    }

    /// # Errors
    /// When a pair has a number that nothing has, or all of them have more text than may be.
    pub fn unfolded(self) -> Result<MergeResults, String> {
        let Self { agents, who, texts, pairs, mut pair_verdicts } = self;
        let mut left = MAX_TEXT;
        for (a, b, verdict, why, pending) in pairs {
            let agent = |number: usize| {
                who.get(number).ok_or_else(|| format!("a pair has an agent {number} of {}", who.len()))
            };
            let text = |number: usize| {
                texts.get(number).ok_or_else(|| format!("a pair has a text {number} of {}", texts.len()))
            };
            let ((one, other), verdict, why) =
                ((agent(a)?, agent(b)?), text(verdict)?, why.map(text).transpose()?);
            let all = [&one.0, &one.1, &other.0, &other.1, verdict].into_iter().chain(why);
            let length = all.map(String::len).sum::<usize>();
            left = left.checked_sub(length).ok_or("its pairs have more text than may be told")?;
            pair_verdicts.push(PairVerdict {
                names: [one.1.clone(), other.1.clone()],
                agents: [one.0.clone(), other.0.clone()],
                verdict: verdict.clone(),
                why: why.cloned(),
                pending,
            });
        }
        Ok(MergeResults { agents, pair_verdicts })
    }
}
