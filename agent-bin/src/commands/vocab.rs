//! `loopbox vocab`: vocabularies for place recognition.

use super::features;
use crate::console::{say, tell};
use anyhow::{Context, Result};
use clap::{Args, Subcommand};
use place_recog::features::Features;
use place_recog::{TrainParams, Vocabulary};
use std::path::PathBuf;

/// Train a vocabulary for recognising places
#[derive(Debug, Args)]
pub struct VocabArgs {
    #[command(subcommand)]
    command: VocabCommand,
}

#[derive(Debug, Subcommand)]
enum VocabCommand {
    /// Learn the words of images. loopbox comes with a vocabulary; nobody has to
    Train(TrainArgs),
}

#[derive(Debug, Args)]
struct TrainArgs {
    /// What to learn from: images, folders of images, maps, folders of runs. They should show many places once
    /// rather than few places often
    #[arg(value_name = "IMAGES|MAP", required = true)]
    inputs: Vec<PathBuf>,
    /// The vocabulary to write
    #[arg(short, long, value_name = "FILE")]
    out: PathBuf,
    /// Take every Nth image of each input
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..))]
    every: u32,
    /// Children of each node of the tree, 2 to 255
    #[arg(long, value_name = "N", default_value_t = TrainParams::default().branching as u8, value_parser = clap::value_parser!(u8).range(2..))]
    branching: u8,
    /// Levels of the tree, 1 to 8: at most BRANCHING to the power of LEVELS words
    #[arg(long, value_name = "N", default_value_t = TrainParams::default().levels as u8, value_parser = clap::value_parser!(u8).range(1..=8))]
    levels: u8,
    /// Seed of the random numbers; the same seed and images give the same vocabulary
    #[arg(long, value_name = "N", default_value_t = TrainParams::default().seed)]
    seed: u64,
}

/// Runs `loopbox vocab`.
///
/// # Errors
/// When images cannot be read, are too few, or the file cannot be written.
pub fn run(args: &VocabArgs) -> Result<()> {
    let VocabCommand::Train(args) = &args.command;
    let mut images: Vec<Features> = Vec::new();
    for input in &args.inputs {
        let found = features::of_images(input)?;
        tell!("{}: {} images", input.display(), found.len());
        images.extend(found.into_iter().step_by(args.every as usize));
    }
    let params = TrainParams {
        branching: usize::from(args.branching),
        levels: usize::from(args.levels),
        seed: args.seed,
        ..TrainParams::default()
    };
    tell!(
        "training on {} features of {} images",
        images.iter().map(Features::len).sum::<usize>(),
        images.len()
    );
    let vocabulary = Vocabulary::train(&images, &params)?;
    let bytes = vocabulary.to_bytes();
    std::fs::write(&args.out, &bytes)
        .with_context(|| format!("{}: cannot be written", args.out.display()))?;
    say!("{}: {} words, {} bytes", args.out.display(), vocabulary.len(), bytes.len());
    Ok(())
}
