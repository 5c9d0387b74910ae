//! LiDAR agents: every recording run, every two of one place merged, through the program.

use anyhow::{Context, Result, bail};
use serde_json::Value;
use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Scans farther apart than this are no odometry's business, seconds: such recordings are mapped on their true poses.
const SPARSE: f64 = 0.5;
/// The odometries that are measured.
const METHODS: [&str; 2] = ["planes", "floam"];

/// A recording of scans with its truth.
struct Recording {
    path: PathBuf,
    /// Its folder and its own name.
    name: String,
    /// Whether its map is built on the true poses.
    given: bool,
}

/// What a run came to.
struct Run {
    ate: f64,
    most: f64,
    record: Value,
}

/// Measures the recordings within `data` (folders with `groundtruth.txt` and scans, at any depth), and returns the tables.
///
/// # Errors
/// When there are none, or a run or merge fails where it should not.
pub fn measure(loopbox: &Path, data: &Path, work: &Path) -> Result<String> {
    let mut recordings = Vec::new();
    find(data, data, &mut recordings)?;
    if recordings.is_empty() {
        bail!("{}: holds no folder of scans with groundtruth.txt", data.display());
    }
    recordings.sort_by(|a, b| a.name.cmp(&b.name));
    let program = Program { loopbox, work };
    Ok(program.odometry(&recordings)? + "\n" + &program.merges(&recordings)?)
}

fn find(root: &Path, folder: &Path, found: &mut Vec<Recording>) -> Result<()> {
    let times = folder.join("times.txt");
    if folder.join("groundtruth.txt").is_file() && times.is_file() {
        let text = std::fs::read_to_string(&times).with_context(|| times.display().to_string())?;
        let stamps: Vec<f64> =
            text.lines().filter_map(|l| l.split_whitespace().next()?.parse().ok()).collect();
        let spacing = match (&stamps[..], stamps.len()) {
            ([first, .., last], count) => (last - first) / (count - 1) as f64,
            _ => 0.0,
        };
        let name = folder.strip_prefix(root).unwrap_or(folder).display().to_string();
        found.push(Recording { path: folder.to_owned(), name, given: spacing > SPARSE });
        return Ok(());
    }
    for entry in std::fs::read_dir(folder).with_context(|| folder.display().to_string())? {
        let path = entry?.path();
        if path.is_dir() {
            find(root, &path, found)?;
        }
    }
    Ok(())
}

/// The program under measurement.
struct Program<'a> {
    loopbox: &'a Path,
    work: &'a Path,
}

impl Program<'_> {
    fn call(&self, args: &[&str]) -> Result<(i32, String)> {
        let output = Command::new(self.loopbox).args(args).output().context("the program does not start")?;
        let code = output.status.code().unwrap_or(-1);
        if code != 0 && code != 3 {
            bail!("loopbox {}: {}", args.join(" "), String::from_utf8_lossy(&output.stderr));
        }
        Ok((code, String::from_utf8_lossy(&output.stdout).into_owned()))
    }

    fn at(&self, name: &str) -> String {
        self.work.join("lidar").join(name.replace('/', "-")).display().to_string()
    }

    /// One thread, so that a scan's time is the thread's.
    fn run(&self, recording: &Recording, method: &str) -> Result<Run> {
        let (source, truth) = (
            recording.path.display().to_string(),
            recording.path.join("groundtruth.txt").display().to_string(),
        );
        let out = self.at(&format!("{}-{method}", recording.name));
        let mut args = vec!["run", &source, "--out", &out, "--force", "--quiet", "--threads", "1"];
        args.extend(if recording.given { ["--poses", &truth] } else { ["--odometry", method] });
        self.call(&args)?;
        let (_, said) = self.call(&["eval", &out, "--gt", &truth, "--json"])?;
        let found: Value = serde_json::from_str(&said).context("eval prints no JSON")?;
        let number = |key: &str| found["ate"][key].as_f64().unwrap_or(f64::NAN);
        let record = std::fs::read(Path::new(&out).join("run.json")).context("there is no run.json")?;
        Ok(Run { ate: number("rmse"), most: number("max"), record: serde_json::from_slice(&record)? })
    }

    fn odometry(&self, recordings: &[Recording]) -> Result<String> {
        let mut text = String::from(
            "| recording | method | ATE m | max m | loops | ms a scan | bytes a point | memory MiB |\n|---|---|---|---|---|---|---|---|\n",
        );
        for recording in recordings {
            for method in METHODS.into_iter().take(if recording.given { 1 } else { METHODS.len() }) {
                let run = self.run(recording, method)?;
                let shown = if recording.given { "given poses" } else { method };
                let scan_bytes = self.scan_bytes(&format!("{}-{method}", recording.name), &run.record);
                let memory = run.record["cost"]["peak_memory_bytes"].as_u64().unwrap_or(0) >> 20;
                writeln!(
                    text,
                    "| {} | {shown} | {:.4} | {:.3} | {} | {:.1} | {scan_bytes:.1} | {memory} |",
                    recording.name,
                    run.ate,
                    run.most,
                    run.record["loops"].as_array().map_or(0, Vec::len),
                    run.record["cost"]["median_ms"].as_f64().unwrap_or(f64::NAN),
                )?;
                eprintln!("{} {shown}: ATE {:.4} m", recording.name, run.ate);
            }
        }
        Ok(text)
    }

    /// Bytes of the map's file a point of its scans, all that viewers show included.
    fn scan_bytes(&self, name: &str, record: &Value) -> f64 {
        let file = Path::new(&self.at(name)).join("map.mcap");
        let bytes = std::fs::metadata(file).map_or(0, |about| about.len());
        bytes as f64 / record["map"]["points"].as_f64().unwrap_or(1.0).max(1.0)
    }

    /// Every two recordings of one place, which lie in one folder.
    fn merges(&self, recordings: &[Recording]) -> Result<String> {
        let mut text = String::from(
            "| pair | verdict | ATE of the second m | offset m | turned ° | pieces | overlap | agreeing | in free space | s |\n\
             |---|---|---|---|---|---|---|---|---|---|\n",
        );
        for (i, first) in recordings.iter().enumerate() {
            for second in recordings.iter().skip(i + 1).filter(|r| r.path.parent() == first.path.parent()) {
                if first.name.contains('/') {
                    text += &self.merge(first, second)?;
                }
            }
        }
        Ok(text)
    }

    fn merge(&self, first: &Recording, second: &Recording) -> Result<String> {
        let maps = [first, second].map(|r| self.at(&format!("{}-planes", r.name)));
        let out = self.at(&format!("{}+{}", first.name, second.name));
        let (code, said) =
            self.call(&["merge", &maps[0], &maps[1], "--out", &out, "--force", "--json", "--quiet"])?;
        let record: Value = serde_json::from_str(&said).context("merge prints no JSON")?;
        let encounter = &record["encounters"][0];
        let pair = format!("{} + {}", first.name, second.name);
        let best = &encounter["best"];
        let number = |key: &str| best[key].as_f64().unwrap_or(f64::NAN);
        let mut error = ["–".to_owned(), "–".to_owned(), "–".to_owned()];
        if code == 0 {
            error = self.merge_error(&out, &record, [first, second])?;
        }
        eprintln!("{pair}: {} {}", encounter["decision"], error[0]);
        Ok(format!(
            "| {pair} | {}: {} | {} | {} | {} | {} of {} | {:.2} | {:.3} | {:.3} | {:.1} |\n",
            encounter["decision"].as_str().unwrap_or("–"),
            encounter["reason"].as_str().unwrap_or("–"),
            error[0],
            error[1],
            error[2],
            best["pieces"],
            best["of_pieces"],
            number("overlap"),
            number("agreeing"),
            number("violated"),
            encounter["seconds"].as_f64().unwrap_or(f64::NAN)
        ))
    }

    /// How far the second agent is from where it belongs when the first alone is aligned with the truth.
    fn merge_error(&self, out: &str, record: &Value, pair: [&Recording; 2]) -> Result<[String; 3]> {
        let files = record["files"].as_array().into_iter().flatten().filter_map(Value::as_str);
        let trajectories: Vec<String> =
            files.filter(|f| f.starts_with("trajectory")).map(|f| format!("{out}/{f}")).collect();
        let truths = pair.map(|r| r.path.join("groundtruth.txt").display().to_string());
        let mut args = vec!["eval"];
        args.extend(trajectories.iter().map(String::as_str));
        truths.iter().for_each(|truth| args.extend(["--gt", truth]));
        args.push("--json");
        let (_, said) = self.call(&args)?;
        let found: Value = serde_json::from_str(&said).context("eval prints no JSON")?;
        let second = &found["agents"][1];
        let number = |value: &Value, digits: usize| {
            value.as_f64().map_or("–".to_owned(), |value| format!("{value:.digits$}"))
        };
        let merge = &second["merge"];
        Ok([
            number(&second["ate"]["rmse"], 4),
            number(&merge["offset"], 4),
            number(&merge["rotation_deg"], 2),
        ])
    }
}
