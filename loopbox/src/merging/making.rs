//! The common map of what pairs of maps made of each other.

use super::contradictions::contradicted;
use super::{Input, Merging, MergingParams, PairResults};
use anyhow::{Context, Result};
use map::{AgentId, KeyframeId};
use merge::common_map::{CommonMap, FusionParams, Link, TakenBack};
use merge::estimate::Estimate;
use std::sync::Arc;
use std::time::Instant;

/// Makes the common map of what pairs of inputs made of each other. Where not all keyframes are `optimise`d it is made
/// in a fraction of the time, and says as well where the agents are. Merges `undone` before, by the inputs and the reason,
/// are taken back from the first.
///
/// # Errors
/// When the inputs cannot be in one map (two are of one run, say), or the closures make no common map.
pub(crate) fn common_map(
    inputs: &[Input],
    pair_results: Arc<PairResults>,
    params: &MergingParams,
    optimise: bool,
    undone: &[([usize; 2], String)],
) -> Result<Merging> {
    let maps: Vec<&map::Map> = inputs.iter().map(|input| &*input.map).collect();
    let (mut common, addresses) = CommonMap::from_maps(&maps).context("the maps cannot be merged")?;
    let names: Vec<&str> = inputs.iter().map(|input| &*input.name).collect();
    let undone = [undone.to_vec(), contradicted(&pair_results, params, &names)].concat();
    let mut before = Vec::new();
    for ([target, source], joined) in pair_results.links() {
        let as_given = [target.min(source), target.max(source)];
        if let Some((_, why)) = undone.iter().find(|(pair, _)| *pair == as_given) {
            let agents = addresses[target].agents().next().zip(addresses[source].agents().next());
            before.extend(agents.map(|agents| TakenBack { agents, why: why.clone() }));
            continue;
        }
        for edge in joined.iter().flat_map(|joined| &joined.edges) {
            let address = |input: usize, id: KeyframeId| {
                let agent: AgentId = inputs[input].map.keyframes.get(&id)?.agent;
                addresses[input].of(agent, id)
            };
            if let (Some(from), Some(to)) = (address(target, edge.from), address(source, edge.to)) {
                let from_from_to = Estimate { a_from_b: edge.from_from_to, information: edge.information };
                common.link(Link { from, to, from_from_to });
            }
        }
    }
    let start = Instant::now();
    // A baseline says how whole maps lie to each other, and no more.
    let optimise = optimise && params.method.baseline().is_none();
    let fusion = FusionParams { optimise, ..params.fusion.clone() };
    let (fused, mut taken_back) =
        common.fuse_consistently(&fusion).context("the common map cannot be made")?;
    taken_back.extend(before);
    let fusion_seconds = start.elapsed().as_secs_f64();
    let graph = common.graph(&fusion).context("the graph of merges cannot be made")?;
    Ok(Merging { pair_results, addresses, common, graph, fused, taken_back, fusion_seconds })
}
