//! `loopbox unmerge`: a merged map taken apart again.

use super::info_map::load_at;
use crate::console;
use anyhow::{Context, Result, anyhow, bail};
use clap::Args;
use loopbox::merging::{Names, keep_from, listed, write_maps};
use loopbox::results::{Owner, Results};
use map::{AgentId, Map};
use merge::common_map::{CommonMap, Fused, FusionParams};
use std::path::PathBuf;

/// Take a merged map apart: into every agent's own map, or by the merge of two agents
#[derive(Debug, Args)]
pub struct UnmergeArgs {
    /// The map: a map.mcap, or the folder that `loopbox merge` wrote
    #[arg(value_name = "MERGED")]
    map: PathBuf,
    /// Folder for the results; made if it is not there
    #[arg(short, long, value_name = "DIR")]
    out: PathBuf,
    /// Replace results of a run or a merge in that folder, once the new ones are complete
    #[arg(short, long)]
    force: bool,
    /// Undo only the merge of these two agents, by their names
    #[arg(long, num_args = 2, value_names = ["A", "B"])]
    between: Option<Vec<String>>,
}

/// Runs `loopbox unmerge`.
///
/// # Errors
/// When the map cannot be read or holds one agent only, an agent is unknown, there is no merge between the two, or
/// the results cannot be written. Then nothing is written.
pub fn run(args: &UnmergeArgs) -> Result<()> {
    let map = load_at(&args.map)?;
    if map.agents.len() < 2 {
        let name = map.agents.values().next().map_or("", |info| &info.name);
        bail!(
            "{}: holds one agent only (\"{name}\"): there is no merge to undo\nhint: give the map.mcap that \
             `loopbox merge` wrote",
            args.map.display()
        );
    }
    keep_from(&args.out, std::slice::from_ref(&args.map))?;
    let text = match args.between.as_deref() {
        Some([a, b]) => separate(args, map, [a, b])?,
        _ => apart(args, &map)?,
    };
    console::print(&text)
}

/// Writes every agent's own map; says which.
fn apart(args: &UnmergeArgs, map: &Map) -> Result<String> {
    let mut output = Results::create(&args.out, &Owner::Unmerge, args.force)?;
    let mut text = String::new();
    for (label, own) in map.agent_labels().values().zip(map.split()) {
        let name = PathBuf::from(label).join("map.mcap");
        map::save_map(output.file(&name)?, &own)?;
        text += &format!("{}: {label} as it was\n", args.out.join(&name).display());
    }
    write_list(&mut output)?;
    output.commit()?;
    Ok(text)
}

/// Undoes the merge of two agents and writes the maps that result; says which.
fn separate(args: &UnmergeArgs, map: Map, [a, b]: [&str; 2]) -> Result<String> {
    map.of_cameras().context("--between is for maps of cameras")?;
    let (mut common, addresses) = CommonMap::from_maps(&[&map])?;
    let agents: Vec<AgentId> = addresses.iter().flat_map(|map| map.agents()).collect();
    let known: Vec<&str> = map.agents.values().map(|info| &*info.name).collect();
    let find = |name: &str| {
        let position = known.iter().position(|known| *known == name);
        position.and_then(|position| agents.get(position)).copied().ok_or_else(|| {
            anyhow!(
                "{}: has no agent \"{name}\"\nhint: its agents are {}",
                args.map.display(),
                listed(&known)
            )
        })
    };
    let (first, second) = (find(a)?, find(b)?);
    if first == second {
        bail!("--between {a} {b}: an agent is not merged with itself\nhint: name two agents");
    }
    let name = |agent: AgentId| agents.iter().position(|found| *found == agent).map_or("", |i| known[i]);
    if common.separate(first, second) == 0 {
        let merged: Vec<String> =
            common.merged().iter().map(|(a, b)| format!("{} with {}", name(*a), name(*b))).collect();
        let merged: Vec<&str> = merged.iter().map(String::as_str).collect();
        bail!(
            "{}: no closure joins {a} and {b}: there is no merge between them to undo\nhint: merged are {}",
            args.map.display(),
            listed(&merged)
        );
    }
    let groups = common.fuse(&FusionParams::default()).context("what is left makes no common map")?;
    let names = Names::new(&common);
    let mut output = Results::create(&args.out, &Owner::Unmerge, args.force)?;
    write_maps(&mut output, &groups, &names, &provenance(args, &map, [a, b]))?;
    write_list(&mut output)?;
    output.commit()?;
    Ok(summary(args, &groups, &names, [first, second]))
}

/// Writes down which files belong to the results.
fn write_list(output: &mut Results) -> Result<()> {
    let path = output.file("unmerge.json")?;
    let record = serde_json::json!({ "version": env!("CARGO_PKG_VERSION"), "files": output.names() });
    std::fs::write(&path, format!("{record:#}\n"))
        .with_context(|| format!("{}: cannot be written", path.display()))
}

/// How the maps that are left came to be.
fn provenance(args: &UnmergeArgs, map: &Map, [a, b]: [&str; 2]) -> Vec<(String, String)> {
    let mut kept = map.merge_provenance.clone();
    // Who was merged with whom the edges say; this entry would be wrong by now.
    kept.remove(&format!("{a} + {b}"));
    kept.remove(&format!("{b} + {a}"));
    kept.insert("program".into(), concat!("loopbox ", env!("CARGO_PKG_VERSION")).into());
    kept.insert("maps".into(), args.map.display().to_string());
    kept.insert("undone".into(), format!("{a} + {b}"));
    kept.into_iter().collect()
}

fn summary(args: &UnmergeArgs, groups: &[Fused], names: &Names, [a, b]: [AgentId; 2]) -> String {
    let mut text = String::new();
    for (index, group) in groups.iter().enumerate() {
        let file = loopbox::merging::map_file(index, group, names);
        text += &format!("{}: {}\n", args.out.join(file).display(), names.list(&group.agents));
    }
    if groups.iter().any(|group| group.agents.contains(&a) && group.agents.contains(&b)) {
        text += &format!("{} and {} still hang together, by others who met both\n", names.of(a), names.of(b));
    }
    text
}
