//! Measures place recognition: precision and recall over all pairs of sequences, and the cost of a query in large
//! maps. Prints Markdown and writes it into documents.

mod cost;
mod curve;
mod recall;
mod truth;

use anyhow::{Context, Result, bail};
use clap::Parser;
use measuring::{document, map_of};
use place_recog::Vocabulary;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use truth::Sequence;

/// Measure place recognition on the maps of sequences with ground truth, and its cost in large maps
#[derive(Debug, Parser)]
struct Args {
    /// Folder of sequences with groundtruth.txt
    #[arg(long)]
    data: PathBuf,
    /// Folder of runs: for each sequence NAME there is NAME/run-1/map.mcap, as `bench` leaves them
    #[arg(long)]
    runs: PathBuf,
    /// Another vocabulary than the one that comes with loopbox
    #[arg(long, value_name = "FILE")]
    vocabulary: Option<PathBuf>,
    /// Most keyframes of the synthetic map; 0 leaves the measurement of time out
    #[arg(long, value_name = "N", default_value_t = 1_000_000)]
    keyframes: usize,
    /// Documents to write the results into, between their markers
    documents: Vec<PathBuf>,
}

fn main() -> Result<()> {
    let args = Args::parse();
    let vocabulary = match &args.vocabulary {
        Some(path) => read(path)?,
        None => Vocabulary::shipped(),
    };
    let mut sequences = Vec::new();
    for name in names(&args.data, &args.runs)? {
        let map = map_of(&args.runs, &name);
        sequences.push(Sequence::read(&name, &args.data.join(&name), &map, &vocabulary)?);
    }
    let mut text =
        if std::env::var("SWEEP").is_ok() { String::new() } else { recall::report(&sequences, &vocabulary) };
    if args.keyframes > 0 {
        text.push('\n');
        let words = sequences.iter().flat_map(|sequence| &sequence.keyframes).map(|seen| &seen.words);
        text.push_str(&cost::report(&vocabulary, &words.collect::<Vec<_>>(), args.keyframes));
    }
    println!("{text}");
    for path in &args.documents {
        document::update(path, &[("places", text.clone())])?;
    }
    Ok(())
}

fn read(path: &Path) -> Result<Arc<Vocabulary>> {
    let about = || path.display().to_string();
    let bytes = std::fs::read(path).with_context(about)?;
    Ok(Arc::new(Vocabulary::from_bytes(&bytes).with_context(about)?))
}

/// The sequences with true poses that have a map, by name.
fn names(data: &Path, runs: &Path) -> Result<Vec<String>> {
    let mut names = Vec::new();
    for entry in std::fs::read_dir(runs).with_context(|| format!("{}: cannot be read", runs.display()))? {
        let name = entry?.file_name().to_string_lossy().into_owned();
        if data.join(&name).join("groundtruth.txt").is_file() && map_of(runs, &name).is_file() {
            names.push(name);
        }
    }
    if names.len() < 2 {
        bail!("{}: holds no two maps of sequences in {}", runs.display(), data.display());
    }
    names.sort();
    Ok(names)
}
