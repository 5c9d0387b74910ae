//! Merging through the program: its command line, and the files it writes.

use super::Recording;
use crate::measure::{finish, output};
use anyhow::{Context, Result, bail};
use eval::{Trajectory, read_trajectory};
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::Command;

/// What the program prints first when it refuses all pairs.
const NOTHING_MET: &str = "no two of the maps met";
/// What it prints before the reason for which it did not merge a pair.
const NOT_MERGED: [&str; 2] = ["refused: ", "undecided: "];

/// The program.
#[derive(Clone, Debug)]
pub struct Program {
    /// Its file.
    pub loopbox: PathBuf,
}

/// What came of a merge.
pub enum Attempt {
    /// Two maps at least were merged.
    Merged(Merged),
    /// None was, with the reason for each pair.
    Refused(Vec<String>),
}

/// A merge's results.
#[derive(Clone, Debug)]
pub struct Merged {
    record: Value,
    folder: PathBuf,
}

/// How far an agent is from where it belongs, the first one aligned.
#[derive(Clone, Copy, Debug)]
pub struct AgentError {
    /// ATE RMSE, metres.
    pub rmse: f64,
    /// Error of its scale beside the first, percent; nothing where its path does not show it.
    pub scale_percent: Option<f64>,
}

/// A pair of maps in a merge.
pub struct PairResult {
    /// Index of the target among the inputs.
    pub target: usize,
    /// Index of the source.
    pub source: usize,
    /// Time stamps of the closure's keyframes, target and source; nothing where the pair was refused.
    pub met: Option<[f64; 2]>,
    /// Why it was refused.
    pub refusal: Option<String>,
}

impl Program {
    /// Merges maps; the results go into the folder `out`.
    ///
    /// # Errors
    /// When the program fails other than by refusing all.
    pub fn merge(&self, maps: &[PathBuf], out: &Path, method: Option<&str>) -> Result<Attempt> {
        let mut command = self.merging(maps, out);
        command.args(method.iter().flat_map(|method| ["--method", *method]));
        let ran = output(&mut command)?;
        if !ran.status.success() {
            let text = String::from_utf8_lossy(&ran.stderr);
            if text.contains(NOTHING_MET) {
                return Ok(Attempt::Refused(refusals(&text)));
            }
            bail!("{command:?} ended with {}: {}", ran.status, text.trim());
        }
        let record = serde_json::from_slice(&ran.stdout);
        let record = record.context("what `loopbox merge --json` printed is not JSON")?;
        Ok(Attempt::Merged(Merged { record, folder: out.to_owned() }))
    }

    /// merge.json of maps that are merged with a parameter file; the results go into the folder `out`.
    ///
    /// # Errors
    /// When the program fails other than by refusing all.
    pub fn record(&self, maps: &[PathBuf], out: &Path, params: &Path) -> Result<Value> {
        let mut command = self.merging(maps, out);
        let ran = output(command.arg("--params").arg(params))?;
        let reason = || format!("{command:?}: {}", String::from_utf8_lossy(&ran.stderr).trim());
        serde_json::from_slice(&ran.stdout).with_context(reason)
    }

    fn merging(&self, maps: &[PathBuf], out: &Path) -> Command {
        let mut command = Command::new(&self.loopbox);
        command.arg("merge").args(maps).arg("--out").arg(out).args(["--json", "--quiet"]);
        command
    }

    /// The methods of merging that the program has, of those asked for.
    ///
    /// # Errors
    /// When its help cannot be read.
    pub fn methods(&self, wanted: &[&'static str]) -> Result<Vec<&'static str>> {
        let help = finish(Command::new(&self.loopbox).args(["merge", "--help"]))?;
        let help = String::from_utf8_lossy(&help);
        let has = |method: &&&str| help.contains("--method") && lists(&help, method);
        Ok(wanted.iter().filter(has).copied().collect())
    }

    /// The errors of all agents but the first in a merge of `recordings`, the first one aligned.
    ///
    /// # Errors
    /// When an agent is not in the world of the first one, or `loopbox eval` fails.
    pub fn errors(&self, merged: &Merged, recordings: &[Recording], data: &Path) -> Result<Vec<AgentError>> {
        if let Some(alone) = (1..recordings.len()).find(|&input| !merged.together(0, input)) {
            bail!("{} was not merged", recordings[alone]);
        }
        let mut command = Command::new(&self.loopbox);
        command.args(["eval", "--json"]);
        for input in 0..recordings.len() {
            command.arg(merged.trajectory_file(input)?);
        }
        // It takes every file that follows.
        command.arg("--gt");
        command
            .args(recordings.iter().map(|recording| data.join(recording.sequence).join("groundtruth.txt")));
        let record: Value = serde_json::from_slice(&finish(&mut command)?)
            .context("what `loopbox eval --json` printed is not JSON")?;
        let others = record["agents"].as_array().into_iter().flatten().skip(1);
        let error = |agent: &Value| {
            let rmse =
                agent.pointer("/ate/rmse").and_then(Value::as_f64).context("an agent has no /ate/rmse")?;
            let scale_percent = agent.pointer("/merge/scale_percent").and_then(Value::as_f64);
            Ok(AgentError { rmse, scale_percent })
        };
        others.map(error).collect()
    }
}

impl Merged {
    /// A number of merge.json by its JSON pointer.
    pub fn number(&self, pointer: &str) -> Option<f64> {
        self.record.pointer(pointer)?.as_f64()
    }

    /// The trajectory of an input in the common frame.
    ///
    /// # Errors
    /// When it cannot be read.
    pub fn trajectory(&self, input: usize) -> Result<Trajectory> {
        Ok(read_trajectory(&self.trajectory_file(input)?)?)
    }

    fn trajectory_file(&self, input: usize) -> Result<PathBuf> {
        Ok(self.folder.join(format!("trajectory-{}.txt", self.agent(input)?)))
    }

    /// The name of the only agent of an input.
    fn agent(&self, input: usize) -> Result<&str> {
        let name = self.record.pointer(&format!("/inputs/{input}/agents/0")).and_then(Value::as_str);
        name.with_context(|| format!("merge.json names no agent of input {input}"))
    }

    /// Whether two inputs are in one common map.
    pub fn together(&self, a: usize, b: usize) -> bool {
        let (Ok(a), Ok(b)) = (self.agent(a), self.agent(b)) else { return false };
        let has = |group: &Value, name: &str| {
            group["agents"].as_array().is_some_and(|agents| agents.iter().any(|agent| agent == name))
        };
        let mut groups = self.record["groups"].as_array().into_iter().flatten();
        groups.any(|group| has(group, a) && has(group, b))
    }

    /// Every pair of inputs, in the program's order: (0, 1), (0, 2), (1, 2), (0, 3), … Which of the two is the target
    /// is for the program to say.
    pub fn pair_results(&self) -> Vec<PairResult> {
        let all = self.record["encounters"].as_array().into_iter().flatten();
        let pairs = (1..).flat_map(|source| (0..source).map(move |target| (target, source)));
        let pair = |((earlier, later), record): ((usize, usize), &Value)| {
            let name = |input: usize| self.record.pointer(&format!("/inputs/{input}/name"));
            let turned = name(later).is_some_and(|name| *name == record["target"]);
            let (target, source) = if turned { (later, earlier) } else { (earlier, later) };
            let mut tested = record["tried"].as_array().into_iter().flatten();
            let accepted = tested.find(|place| place["outcome"] == "accepted");
            let time = |place: &Value, of: &str| place[of].as_f64();
            let met =
                accepted.and_then(|place| Some([time(place, "target_time")?, time(place, "source_time")?]));
            let refusal = record["refusal"].as_str().map(str::to_owned);
            PairResult { target, source, met, refusal }
        };
        pairs.zip(all).map(pair).collect()
    }

    /// Removes the large files, which nobody will look at.
    ///
    /// # Errors
    /// When the folder cannot be removed.
    pub fn remove(self) -> Result<()> {
        std::fs::remove_dir_all(&self.folder)
            .with_context(|| format!("{}: cannot be removed", self.folder.display()))
    }
}

/// Whether a help text names a value as a word of its own.
fn lists(help: &str, value: &str) -> bool {
    help.split(|c: char| !(c.is_alphanumeric() || c == '-')).any(|word| word == value)
}

/// The reasons in what the program prints when it refuses.
fn refusals(text: &str) -> Vec<String> {
    let reason =
        |line: &str| NOT_MERGED.iter().find_map(|word| Some(line.split_once(word)?.1.trim().to_owned()));
    text.lines().filter_map(reason).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn reasons_are_read_from_what_is_printed() {
        let text = "error: no two of the maps met, so there is no common map\n\
                    a + b: refused: 2 matches are too few: at least 16 are needed\n  best of 48 places\n\
                    a + c: refused: no place of one looks like a place of the other\n\
                    b + c: undecided: only 59 key points match\n";
        let reasons = refusals(text);
        assert_eq!(reasons.len(), 3);
        assert_eq!(reasons[2], "only 59 key points match");
        assert_eq!(reasons[0], "2 matches are too few: at least 16 are needed");
    }

    #[test]
    fn methods_are_words_of_the_help() {
        let help = "--method <METHOD>\n  Possible values:\n  - direct: as it is\n  - pgo-full: all";
        assert!(lists(help, "direct") && lists(help, "pgo-full"));
        assert!(!lists(help, "loop-box") && !lists(help, "pgo"));
    }

    #[test]
    fn pairs_and_groups_are_those_of_the_record() {
        let record = json!({
            "inputs": [
                { "name": "a", "agents": ["a"] }, { "name": "b", "agents": ["b"] }, { "name": "c", "agents": ["c"] }
            ],
            "groups": [{ "agents": ["a", "c"] }, { "agents": ["b"] }],
            "encounters": [
                { "target": "a", "source": "b", "refusal": "too few", "tried": [] },
                { "target": "c", "source": "a", "refusal": null, "tried": [
                    { "outcome": "not closed", "target_time": 1.0, "source_time": 2.0 },
                    { "outcome": "accepted", "target_time": 3.0, "source_time": 4.0 }
                ] },
                { "refusal": "too few", "tried": [] }
            ]
        });
        let merged = Merged { record, folder: PathBuf::from("out") };
        assert!(merged.together(0, 2) && !merged.together(0, 1) && !merged.together(0, 7));
        let pair_results = merged.pair_results();
        let pairs: Vec<_> = pair_results.iter().map(|e| (e.target, e.source, e.met)).collect();
        assert_eq!(pairs, [(0, 1, None), (2, 0, Some([3.0, 4.0])), (1, 2, None)]);
        assert_eq!(pair_results[0].refusal.as_deref(), Some("too few"));
    }
}
