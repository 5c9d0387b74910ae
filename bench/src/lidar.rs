//! LiDAR agents through the program: every recording run, beside other odometries; every two of one place merged; and
//! many maps that have nothing in common.

mod doubles;
mod hour;
mod parts;
mod peers;
mod program;
mod strangers;
mod truth;

use anyhow::{Context, Result, bail};
pub use hour::measure as hour;
use peers::Peers;
use program::{Program, record};
use serde_json::Value;
use std::fmt::Write;
use std::path::{Path, PathBuf};
use truth::Truth;

/// Scans farther apart than this are no odometry's business, seconds: such recordings are mapped on their true poses.
const SPARSE: f64 = 0.5;
/// The odometries that are measured, the default first.
const METHODS: [&str; 3] = ["planes", "floam", "a-loam"];

/// What to measure.
pub struct Plan<'a> {
    /// The program.
    pub loopbox: &'a Path,
    /// Folder with recordings: folders with `groundtruth.txt`, `times.txt` and scans, at any depth.
    pub data: &'a Path,
    /// Folder for results.
    pub work: &'a Path,
    /// Whether maps that lie there are taken in place of new ones.
    pub reuse: bool,
    /// Which sites are rendered: bounds are set on those of 1.
    pub seed: u64,
    /// Of doubles: parts of the names of kinds; all where there are none.
    pub only: &'a [String],
}

/// Maps of which every two are merged.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Lot {
    /// Stretches of the recordings, as they are and mirrored.
    Recorded,
    /// Stretches of drives through rendered sites.
    Rendered,
}

/// A recording of scans with its truth.
struct Recording {
    path: PathBuf,
    /// Its folder and its own name.
    name: String,
    /// Whether its map is built on the true poses.
    given: bool,
}

/// Measures, and hands on the sections of the document by their names as they come: the last takes longest.
///
/// # Errors
/// When there are no recordings, a run or merge fails where it should not, `section` fails, or a merge was wrong.
pub fn measure(plan: &Plan, mut section: impl FnMut(&str, String) -> Result<()>) -> Result<()> {
    let (recordings, program) = (recordings(plan.data)?, plan.program());
    section("lidar", odometry(&program, &recordings)? + "\n" + &merges(&program, &recordings)?)?;
    let (recorded, wrong) = strangers::of_recordings(&program, &recordings)?;
    section("lidar-recorded", recorded)?;
    let (rendered, also) = strangers::of_sites(&program, plan.seed)?;
    section("lidar-rendered", rendered)?;
    match wrong + also {
        0 => Ok(()),
        wrong => bail!("{wrong} pairs of stretches were merged wrongly"),
    }
}

/// Merges every two of a lot of maps; returns the table, and how many were merged wrongly.
///
/// # Errors
/// As [`measure`], but for wrong merges.
pub fn strangers(plan: &Plan, lot: Lot) -> Result<(String, usize)> {
    match lot {
        Lot::Recorded => strangers::of_recordings(&plan.program(), &recordings(plan.data)?),
        Lot::Rendered => strangers::of_sites(&plan.program(), plan.seed),
    }
}

/// Merges stretches of places that are built alike, and of one place with some things moved; hands on the section after each kind.
///
/// # Errors
/// As [`measure`].
pub fn doubles(plan: &Plan, mut section: impl FnMut(&str, String) -> Result<()>) -> Result<()> {
    match doubles::measure(&plan.program(), plan.seed, plan.only, &mut |text| section("lidar-doubles", text))?
    {
        0 => Ok(()),
        wrong => bail!("{wrong} pairs of stretches were merged wrongly"),
    }
}

impl Plan<'_> {
    fn program(&self) -> Program<'_> {
        Program { loopbox: self.loopbox, work: self.work, reuse: self.reuse }
    }
}

/// The recordings in a folder, by name.
fn recordings(data: &Path) -> Result<Vec<Recording>> {
    let mut found = Vec::new();
    find(data, data, &mut found)?;
    if found.is_empty() {
        bail!("{}: holds no folder of scans with groundtruth.txt", data.display());
    }
    found.sort_by(|a, b| a.name.cmp(&b.name));
    Ok(found)
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

/// Maps a recording by a method, or on its true poses; returns the folder of the results.
fn mapped(program: &Program, recording: &Recording, method: &str) -> Result<PathBuf> {
    let given = recording.path.join("groundtruth.txt").display().to_string();
    let how = if recording.given { ["--poses", &given] } else { ["--odometry", method] };
    program.run(&recording.path, &format!("{}-{method}", recording.name), &how)
}

/// Every recording by every method, and by the peers right after.
fn odometry(program: &Program, recordings: &[Recording]) -> Result<String> {
    let peers = Peers::installed();
    let mut text = String::from(
        "| recording | method | ATE m | max m | drift % / 10 m | °/m | loops | CPU ms a scan | of the default's | bytes a point | \
         memory MiB |\n|---|---|---|---|---|---|---|---|---|---|---|\n",
    );
    for recording in recordings {
        let truth = Truth::of(&recording.path)?;
        let mut own = f64::NAN;
        for method in METHODS.into_iter().take(if recording.given { 1 } else { METHODS.len() }) {
            let out = mapped(program, recording, method)?;
            let (errors, run) = (truth.errors(&out.join("trajectory.txt"))?, record(&out.join("run.json"))?);
            let label = if recording.given { "given poses" } else { method };
            let cpu = run["cost"]["median_cpu_ms"].as_f64().unwrap_or(f64::NAN);
            own = if method == METHODS[0] { cpu } else { own };
            writeln!(
                text,
                "| {} | {label} | {:.4} | {:.3} | {:.2} | {:.4} | {} | {cpu:.1} | {:.1} | {:.1} | {} |",
                recording.name,
                errors.ate,
                errors.most,
                errors.drift,
                errors.rotation_drift,
                run["loops"].as_array().map_or(0, Vec::len),
                cpu / own,
                scan_bytes(&out, &run),
                run["cost"]["peak_memory_bytes"].as_u64().unwrap_or(0) >> 20,
            )?;
            eprintln!("{} {label}: ATE {:.4} m, {cpu:.1} ms", recording.name, errors.ate);
        }
        let (Ok(peers), false) = (&peers, recording.given) else { continue };
        let peers_out = program.at(&format!("{}-peers", recording.name));
        for peer in peers.measure(&recording.path, &truth, &peers_out, program.reuse)? {
            let (e, cpu) = (peer.errors, peer.cpu_ms);
            writeln!(
                text,
                "| {} | *{}* | {:.4} | {:.3} | {:.2} | {:.4} | – | {cpu:.1} | {:.1} | – | – |",
                recording.name,
                peer.name,
                e.ate,
                e.most,
                e.drift,
                e.rotation_drift,
                cpu / own
            )?;
            eprintln!("{} {}: ATE {:.4} m, {cpu:.1} ms", recording.name, peer.name, e.ate);
        }
    }
    if let Err(why) = peers {
        writeln!(text, "\nPeers were not measured: {why}.")?;
    }
    Ok(text)
}

/// Bytes of the map's file a point of its scans, all that viewers show included.
fn scan_bytes(out: &Path, run: &Value) -> f64 {
    let bytes = std::fs::metadata(out.join("map.mcap")).map_or(0, |about| about.len());
    bytes as f64 / run["map"]["points"].as_f64().unwrap_or(1.0).max(1.0)
}

/// Every two recordings of one place, which lie in one folder.
fn merges(program: &Program, recordings: &[Recording]) -> Result<String> {
    let mut text = String::from(
        "| pair | verdict | ATE of the second m | offset m | turned ° | pieces | overlap | agreeing | in free space | s |\n\
         |---|---|---|---|---|---|---|---|---|---|\n",
    );
    for (i, first) in recordings.iter().enumerate() {
        for second in recordings.iter().skip(i + 1).filter(|r| r.path.parent() == first.path.parent()) {
            if first.name.contains('/') {
                text += &merge(program, first, second)?;
            }
        }
    }
    Ok(text)
}

fn merge(program: &Program, first: &Recording, second: &Recording) -> Result<String> {
    let maps = [first, second].map(|r| program.at(&format!("{}-planes", r.name)).display().to_string());
    let out = program.at(&format!("{}+{}", first.name, second.name)).display().to_string();
    let (met, record) =
        program.json(&["merge", &maps[0], &maps[1], "--out", &out, "--force", "--json", "--quiet"])?;
    let pair_record = &record["encounters"][0];
    let pair = format!("{} + {}", first.name, second.name);
    let best = &pair_record["best"];
    let number = |key: &str| best[key].as_f64().unwrap_or(f64::NAN);
    let mut error = ["–".to_owned(), "–".to_owned(), "–".to_owned()];
    if met {
        error = merge_error(program, &out, &record, [first, second])?;
    }
    eprintln!("{pair}: {} {}", pair_record["decision"], error[0]);
    Ok(format!(
        "| {pair} | {}: {} | {} | {} | {} | {} of {} | {:.2} | {:.3} | {:.3} | {:.1} |\n",
        pair_record["decision"].as_str().unwrap_or("–"),
        pair_record["reason"].as_str().unwrap_or("–"),
        error[0],
        error[1],
        error[2],
        best["pieces"],
        best["of_pieces"],
        number("overlap"),
        number("agreeing"),
        number("violated"),
        pair_record["seconds"].as_f64().unwrap_or(f64::NAN)
    ))
}

/// How far the second agent is from where it belongs when the first alone is aligned with the truth.
fn merge_error(program: &Program, out: &str, record: &Value, pair: [&Recording; 2]) -> Result<[String; 3]> {
    let files = record["files"].as_array().into_iter().flatten().filter_map(Value::as_str);
    let trajectories: Vec<String> =
        files.filter(|f| f.starts_with("trajectory")).map(|f| format!("{out}/{f}")).collect();
    let truths = pair.map(|r| r.path.join("groundtruth.txt").display().to_string());
    let mut args = vec!["eval"];
    args.extend(trajectories.iter().map(String::as_str));
    truths.iter().for_each(|truth| args.extend(["--gt", truth]));
    args.push("--json");
    let (_, found) = program.json(&args)?;
    let second = &found["agents"][1];
    let number =
        |value: &Value, digits: usize| value.as_f64().map_or("–".to_owned(), |v| format!("{v:.digits$}"));
    let merge = &second["merge"];
    Ok([number(&second["ate"]["rmse"], 4), number(&merge["offset"], 4), number(&merge["rotation_deg"], 2)])
}
