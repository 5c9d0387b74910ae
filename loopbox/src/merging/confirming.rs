//! Pairs of maps of which a person says that both show one place.

use super::verdicts::CameraVerdicts;
use super::{Input, MergingParams, PairResult, PairResults};
use crate::common_map::names::named_pair;
use anyhow::{Context, Result, bail};
use merge::acceptance::{AcceptanceParams, Verdict};
use merge::verification::Outcome;
use std::sync::Arc;

/// Confirms the pairs that `confirm` names as `A+B`, and those that were confirmed before where `verdicts` keep that.
///
/// # Errors
/// When one names no two inputs, there is no closure to join a pair at, or a confirmation cannot be read or kept.
pub(super) fn confirm_pairs(
    pair_results: &mut PairResults,
    inputs: &[Input],
    confirm: &[String],
    params: &MergingParams,
    verdicts: Option<&CameraVerdicts>,
) -> Result<()> {
    let names: Vec<&str> = inputs.iter().map(|input| &*input.name).collect();
    let asked = confirm.iter().map(|text| named_pair(text, &names)).collect::<Result<Vec<_>>>()?;
    if !asked.is_empty() && params.method.baseline().is_some() {
        bail!("--confirm joins maps by --method direct, the default");
    }
    if asked.is_empty() && verdicts.is_none() {
        return Ok(());
    }
    let params = &params.verification.acceptance;
    let mut confirmed = Vec::new();
    for pair_result in pair_results.iter().filter(|pair_result| pair_result.accepted().is_none()) {
        let pair @ [a, b] = pair_result.as_given();
        if asked.contains(&pair) {
            let joined = pair_result
                .confirmed(params)
                .with_context(|| format!("--confirm {}+{}: they cannot be joined", names[a], names[b]))?;
            verdicts.map_or(Ok(()), |verdicts| verdicts.confirm(pair))?;
            confirmed.push(joined);
        } else if let Some(verdicts) = verdicts
            && pair_result.can_be_confirmed(params)
            && verdicts.is_confirmed(pair)?
        {
            confirmed.push(pair_result.confirmed(params)?);
        }
    }
    confirmed.into_iter().for_each(|pair_result| pair_results.insert(pair_result));
    Ok(())
}

impl PairResult {
    /// What is said of the two once a person says that both show one place: they are joined at the closure that came closest, if that
    /// passes every test of its pose. A pair that was accepted stays as it is.
    ///
    /// # Errors
    /// When there is no such closure.
    pub(crate) fn confirmed(&self, params: &AcceptanceParams) -> Result<Self> {
        if self.accepted().is_some() {
            return Ok(self.clone());
        }
        let Some((index, verdict)) = self.confirmable(params) else {
            let why = self.refusal().unwrap_or_default();
            bail!("no pose between the maps passes the tests that are no matter of the place: {why}")
        };
        let mut tested = self.tested.to_vec();
        let mut joined = None;
        if let Outcome::Evaluated(evaluated) = &mut tested[index].outcome {
            evaluated.verdict = verdict;
            joined = evaluated.joined.clone();
        }
        Ok(Self { tested: tested.into(), joined: joined.map(Arc::new), ..self.clone() })
    }

    /// Whether they are not joined, and would be if a person said that both show one place.
    pub(crate) fn can_be_confirmed(&self, params: &AcceptanceParams) -> bool {
        self.accepted().is_none() && self.confirmable(params).is_some()
    }

    /// Which of the tested places they are joined at then, and the verdict there.
    fn confirmable(&self, params: &AcceptanceParams) -> Option<(usize, Verdict)> {
        let found = self.tested.iter().enumerate().filter_map(|(index, tested)| {
            let evaluated = tested.outcome.evaluated().filter(|evaluated| evaluated.joined.is_some())?;
            let verdict = evaluated.verdict.confirmed(params);
            verdict.accepts().then_some((index, verdict))
        });
        let count = |(index, _): &(usize, Verdict)| self.tested[*index].match_count;
        // Of equals the first.
        found.reduce(|best, next| if count(&next) > count(&best) { next } else { best })
    }

    /// Whether they are joined because a person said that both show one place.
    pub fn is_confirmed(&self) -> bool {
        self.accepted().is_some_and(|evaluated| evaluated.verdict.is_confirmed)
    }
}
