//! Measuring one sequence.

use crate::targets::target;
use anyhow::{Context, Result, bail};
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

/// Runs the program.
pub struct Runner {
    /// The program.
    pub loopbox: PathBuf,
    /// Where its outputs go.
    pub work: PathBuf,
    /// How often each sequence is run with all cores.
    pub runs: usize,
}

/// What came out for one sequence.
pub struct Measurement {
    /// Name of the sequence.
    pub name: String,
    /// The runs with all cores.
    pub runs: Vec<Run>,
    /// The run on one core; `None` where it could not be made.
    pub one_core: Option<Run>,
    /// Whether trajectory, map and cloud of all runs, the one on one core included, are equal byte by byte.
    pub identical: bool,
    /// Why there are no figures.
    pub failure: Option<String>,
}

/// The numbers of one run; a number that the program did not give is missing, not zero.
pub struct Run {
    record: Value,
    evaluation: Value,
}

impl Run {
    /// A number of run.json by its JSON pointer.
    pub fn record(&self, pointer: &str) -> Option<f64> {
        self.record.pointer(pointer)?.as_f64()
    }

    /// A number of the evaluation by its JSON pointer.
    pub fn evaluation(&self, pointer: &str) -> Option<f64> {
        self.evaluation.pointer(pointer)?.as_f64()
    }

    /// What run.json says of each processed frame.
    pub fn rows(&self) -> &[Value] {
        self.record.get("rows").and_then(Value::as_array).map_or(&[], Vec::as_slice)
    }

    /// The numbers in the folder of a run's results, and what was found about its accuracy.
    ///
    /// # Errors
    /// When run.json cannot be read.
    pub fn read(out: &Path, evaluation: Value) -> Result<Self> {
        let path = out.join("run.json");
        let text = read(&path)?;
        let record = serde_json::from_slice(&text).with_context(|| format!("{}", path.display()))?;
        Ok(Self { record, evaluation })
    }
}

impl Measurement {
    /// Median over the runs of what `number` takes from each; `None` when a run lacks it.
    pub fn median(&self, number: impl Fn(&Run) -> Option<f64>) -> Option<f64> {
        measuring::median(self.runs.iter().map(number).collect::<Option<_>>()?)
    }
}

const NOT_JSON: &str = "what `loopbox eval --json` printed is not JSON";

/// The files of a run that must not depend on the run.
const RESULTS: [&str; 3] = ["trajectory.txt", "map.mcap", "cloud.ply"];

impl Runner {
    /// Runs a sequence as often as asked and once on one core.
    ///
    /// # Errors
    /// When outputs cannot be written or read; a run that fails is told in the measurement.
    pub fn measure(&self, sequence: &Path) -> Result<Measurement> {
        let name = sequence.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let mut measurement =
            Measurement { name, runs: Vec::new(), one_core: None, identical: true, failure: None };
        let mut first: Option<PathBuf> = None;
        for i in 0..=self.runs {
            let one_core = i == self.runs;
            let label = if one_core { "one-core".to_owned() } else { format!("run-{}", i + 1) };
            let out = self.work.join(&measurement.name).join(label);
            match self.run(sequence, &out, one_core) {
                Ok(run) if one_core => measurement.one_core = Some(run),
                Ok(run) => measurement.runs.push(run),
                Err(error) => {
                    measurement.failure = Some(format!("{error:#}"));
                    break;
                }
            }
            match &first {
                Some(first) => measurement.identical &= same_results(first, &out)?,
                None => first = Some(out),
            }
        }
        Ok(measurement)
    }

    fn run(&self, sequence: &Path, out: &Path, one_core: bool) -> Result<Run> {
        make_empty(out)?;
        let mut command = if one_core {
            let mut command = Command::new("taskset");
            command.args(["-c", "0"]).arg(&self.loopbox);
            command
        } else {
            Command::new(&self.loopbox)
        };
        command.arg("run").arg(sequence).arg("--calib").arg(sequence.join("camera.yaml"));
        finish(command.arg("--out").arg(out).arg("--quiet"))?;
        Run::read(out, self.evaluate(sequence, out)?)
    }

    /// A file with the ground truth of a sequence, as far as it holds.
    ///
    /// # Errors
    /// When it cannot be read, or a part of it cannot be written.
    pub fn truth(&self, sequence: &Path) -> Result<PathBuf> {
        let whole = sequence.join("groundtruth.txt");
        let name = sequence.file_name().unwrap_or_default().to_string_lossy();
        let Some(first) = target(&name).map(|target| target.truth_from).filter(|first| *first > 0) else {
            return Ok(whole);
        };
        let path = self.work.join(format!("{name}-from-{first}.txt"));
        if !path.is_file() {
            let text = String::from_utf8(read(&whole)?)?;
            let poses: Vec<&str> = text.lines().filter(|line| !line.starts_with('#')).skip(first).collect();
            // Runs side by side may write it at once: each a file of its own, and then all the same one.
            let own = path.with_extension(format!("{:?}.tmp", std::thread::current().id()));
            std::fs::write(&own, poses.join("\n") + "\n").with_context(|| format!("{}", own.display()))?;
            std::fs::rename(&own, &path).with_context(|| format!("{}", path.display()))?;
        }
        Ok(path)
    }

    /// What `loopbox eval` says, or nothing where it says nothing, which is told: of runs that are worth their other
    /// figures, too.
    pub fn evaluate_if_possible(&self, sequence: &Path, out: &Path) -> Value {
        self.evaluate(sequence, out).unwrap_or_else(|error| {
            eprintln!("  no accuracy: {error:#}");
            Value::Null
        })
    }

    /// `loopbox eval` of a trajectory over `sequence`.
    fn evaluation(&self, sequence: &Path, trajectory: &Path) -> Result<Command> {
        let mut command = Command::new(&self.loopbox);
        command.arg("eval").arg(trajectory).arg("--json");
        command.arg("--gt").arg(self.truth(sequence)?);
        command.arg("--frames").arg(sequence.join("times.txt"));
        Ok(command)
    }

    /// The ATE, metres, of the poses as a run over `sequence` with results in `out` handed them out frame by frame.
    ///
    /// # Errors
    /// When `loopbox eval` fails.
    pub fn ate_handed_out(&self, sequence: &Path, out: &Path) -> Result<Option<f64>> {
        let text = finish(&mut self.evaluation(sequence, &out.join("trajectory-live.txt"))?)?;
        let reply: Value = serde_json::from_slice(&text).context(NOT_JSON)?;
        Ok(reply.pointer("/ate/rmse").and_then(Value::as_f64))
    }

    /// What `loopbox eval` says of the results in `out` of a run over `sequence`.
    ///
    /// # Errors
    /// When it fails.
    pub fn evaluate(&self, sequence: &Path, out: &Path) -> Result<Value> {
        let command = || self.evaluation(sequence, &out.join("trajectory.txt"));
        let (map, depth) = (out.join("map.mcap"), sequence.join("depth"));
        let with_depth = (map.is_file() && depth.is_dir())
            .then(|| finish(command()?.arg("--map").arg(map).arg("--depth").arg(depth)));
        let text = match with_depth {
            Some(Ok(text)) => text,
            // The trajectory is measured even when the map's depth cannot be.
            Some(Err(error)) => {
                eprintln!("no depth figures for {}: {error:#}", out.display());
                finish(&mut command()?)?
            }
            None => finish(&mut command()?)?,
        };
        serde_json::from_slice(&text).context(NOT_JSON)
    }
}

/// Makes a folder, without what may lie there from before.
///
/// # Errors
/// When it cannot be made or emptied.
pub fn make_empty(folder: &Path) -> Result<()> {
    if folder.exists() {
        std::fs::remove_dir_all(folder)
            .with_context(|| format!("{}: cannot be emptied", folder.display()))?;
    }
    std::fs::create_dir_all(folder).with_context(|| format!("{}: cannot be made", folder.display()))
}

/// Runs a command to its end, whatever that is.
///
/// # Errors
/// When it cannot be started.
pub fn output(command: &mut Command) -> Result<Output> {
    let program = command.get_program().to_string_lossy().into_owned();
    let output = command.stdin(Stdio::null()).output();
    output.with_context(|| format!("{program} cannot be started; is it there?"))
}

/// Runs a command to its end and returns what it printed.
///
/// # Errors
/// When it cannot be started, or fails.
pub fn finish(command: &mut Command) -> Result<Vec<u8>> {
    let output = output(command)?;
    if !output.status.success() {
        bail!("{command:?} ended with {}: {}", output.status, String::from_utf8_lossy(&output.stderr).trim());
    }
    Ok(output.stdout)
}

fn same_results(a: &Path, b: &Path) -> Result<bool> {
    for name in RESULTS {
        let (a, b) = (a.join(name), b.join(name));
        if a.is_file() != b.is_file() {
            return Ok(false);
        }
        if a.is_file() && read(&a)? != read(&b)? {
            return Ok(false);
        }
    }
    Ok(true)
}

/// The bytes of a file.
///
/// # Errors
/// Names the file that cannot be read.
pub fn read(path: &Path) -> Result<Vec<u8>> {
    std::fs::read(path).with_context(|| format!("{}: cannot be read", path.display()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn medians_need_every_run() {
        let run = |record| Run { record, evaluation: Value::Null };
        let mut measurement = Measurement {
            name: "a".to_owned(),
            runs: [3.0, 1.0, 2.0].map(|ms| run(json!({ "cost": { "mean_ms": ms } }))).into(),
            one_core: None,
            identical: true,
            failure: None,
        };
        let mean = |run: &Run| run.record("/cost/mean_ms");
        assert_eq!(measurement.median(mean), Some(2.0));
        measurement.runs.push(run(json!({})));
        assert_eq!(measurement.median(mean), None);
    }

    #[test]
    fn a_failing_program_is_reported() {
        let folder = tempfile::tempdir().unwrap();
        let runner = Runner { loopbox: "false".into(), work: folder.path().join("work"), runs: 2 };
        let measurement = runner.measure(&folder.path().join("sequence")).unwrap();
        assert!(measurement.failure.unwrap().contains("ended with exit status: 1"));
        assert!(measurement.runs.is_empty());
    }

    #[test]
    fn results_are_compared_byte_by_byte() {
        let folder = tempfile::tempdir().unwrap();
        let (a, b) = (folder.path().join("a"), folder.path().join("b"));
        for path in [&a, &b] {
            std::fs::create_dir(path).unwrap();
            std::fs::write(path.join("trajectory.txt"), "1").unwrap();
        }
        assert!(same_results(&a, &b).unwrap());
        std::fs::write(b.join("cloud.ply"), "").unwrap();
        assert!(!same_results(&a, &b).unwrap());
        std::fs::write(a.join("cloud.ply"), "x").unwrap();
        assert!(!same_results(&a, &b).unwrap());
    }
}
