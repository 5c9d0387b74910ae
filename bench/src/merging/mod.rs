//! Measuring merges: their errors, their refusals, the methods beside each other, and that units do not matter.

mod cases;
mod cut;
mod judge;
mod maps;
mod program;
pub mod report;
mod rescaled;
mod strangers;
pub mod truth;

use crate::measure::Runner;
use anyhow::{Result, bail};
use cases::{CASES, Case, Measured, Numbers};
pub use cut::moved;
use judge::{ScoredPair, Verdict};
use maps::{MapWithTruth, Recording};
pub use program::Program;
use rescaled::Change;
use std::path::Path;

/// The methods of the paper's Table I by their names on the command line; the last is that without a name.
const METHODS: [&str; 6] = ["pcr-pro", "pgo-straight", "pgo-full", "pgo-top", "loop-box", "direct"];
/// What is used when no method is named.
const OWN: &str = "direct";

/// The cases of which the maps are moved and rescaled.
const MOVED: usize = 2;

/// What to measure.
pub struct Plan<'a> {
    /// Runs the program.
    pub runner: &'a Runner,
    /// Folder of sequences.
    pub data: &'a Path,
    /// Names of the sequences to use.
    pub sequences: &'a [String],
    /// Whether the maps of whole sequences are in the work folder, made by this program.
    pub mapped: bool,
    /// Whether maps are used that lie in the work folder from earlier.
    pub reuse: bool,
    /// Random pairs of parts of maps.
    pub cuts: usize,
}

/// What came of all merges.
pub struct Merging {
    /// Errors and times.
    pub cases: Vec<Measured>,
    /// The methods that the program has, and of each case that they are compared on what each gave.
    pub methods: Vec<&'static str>,
    /// Cases and results in the methods' order.
    pub compared: Vec<(Case, Vec<Result<Numbers, String>>)>,
    /// Other units and worlds.
    pub changes: Vec<Change>,
    /// Every two sequences.
    pub pairs: Vec<ScoredPair>,
    /// Both ends of one sequence.
    pub ends: Vec<ScoredPair>,
    /// Random parts.
    pub cuts: Vec<ScoredPair>,
}

impl Merging {
    /// Every pair that was merged though it must not be so.
    pub fn wrong(&self) -> impl Iterator<Item = &ScoredPair> {
        let all = self.pairs.iter().chain(&self.ends).chain(&self.cuts);
        all.filter(|scored| matches!(scored.verdict, Verdict::Wrong(_)))
    }
}

/// Makes the maps that are missing, and measures all merges of them.
///
/// # Errors
/// When a map cannot be made, or files cannot be written or read.
pub fn measure(plan: &Plan) -> Result<Merging> {
    let work = &plan.runner.work;
    let possible: Vec<&Case> = CASES.iter().filter(|case| case.is_possible(plan.sequences)).collect();
    let program = Program { loopbox: plan.runner.loopbox.clone() };
    let whole = make_maps(plan, &possible)?;
    let mut cases = Vec::new();
    for (i, case) in possible.iter().enumerate() {
        let repeats = if i < MOVED { plan.runner.runs } else { 1 };
        let measured = case.measure(&program, plan.data, work, repeats)?;
        eprintln!("{}", report::line(&measured));
        cases.push(measured);
    }
    let methods = program.methods(&METHODS)?;
    let compared = compare(&methods, &cases, &program, plan.data, work);
    let mut changes = Vec::new();
    for case in possible.iter().take(MOVED) {
        changes.extend(rescaled::measure(case, &program, work)?);
    }
    let (names, files): (Vec<&String>, Vec<_>) = whole.into_iter().unzip();
    let known = names.iter().zip(&files).map(|(name, file)| MapWithTruth::read(name, file, plan.data));
    let known = known.collect::<Result<Vec<_>>>()?;
    if known.len() < 2 {
        bail!("merging needs two sequences");
    }
    let pairs = strangers::all_pairs(&known, &files, &program, work)?;
    let ends = strangers::ends(&known, &program, work)?;
    let cuts = strangers::random_cuts(&known, plan.cuts, &program, work)?;
    Ok(Merging { cases, methods, compared, changes, pairs, ends, cuts })
}

/// Makes the maps of all sequences and of the parts that the cases need; returns the files of the former.
fn make_maps<'a>(plan: &Plan<'a>, cases: &[&Case]) -> Result<Vec<(&'a String, std::path::PathBuf)>> {
    let (loopbox, work) = (&plan.runner.loopbox, &plan.runner.work);
    let whole = plan.sequences.iter().map(|name| Recording::whole(name));
    let parts = cases.iter().flat_map(|case| case.recordings).filter(|recording| !recording.is_whole());
    let mut made: Vec<Recording> = Vec::new();
    for recording in whole.chain(parts.copied()) {
        let there = recording.map(work).is_file();
        let current = made.contains(&recording) || plan.mapped && recording.is_whole();
        if !(there && (plan.reuse || current)) {
            recording.run(loopbox, plan.data, work)?;
            eprintln!("mapped {recording}");
        }
        made.push(recording);
    }
    Ok(plan.sequences.iter().map(|name| (name, Recording::whole(name).map(work))).collect())
}

/// What each method gives in the cases that they are compared on.
fn compare(
    methods: &[&'static str],
    cases: &[Measured],
    program: &Program,
    data: &Path,
    work: &Path,
) -> Vec<(Case, Vec<Result<Numbers, String>>)> {
    let compared = cases.iter().filter(|measured| measured.case.compared && !methods.is_empty());
    let result = |measured: &Measured, method: &str| {
        if method == OWN {
            return measured.result.clone();
        }
        let found = measured.case.merge(program, data, work, Some(method));
        found.map_err(|error| format!("{error:#}"))
    };
    compared.map(|of| (of.case, methods.iter().map(|method| result(of, method)).collect())).collect()
}
