//! An hour of a LiDAR that drives the same way again and again: what it costs in the end, and what it costs in memory.

use super::Plan;
use super::program::record;
use super::truth::Truth;
use crate::measure::make_empty;
use anyhow::{Context, Result, ensure};
use loopbox_tests::lidar::{HALL, PERIOD, walk, write_recording};
use serde_json::Value;
use std::fmt::Write;
use std::fs;
use std::os::unix::fs::symlink;
use std::path::Path;

/// Seconds of the recording.
const HOUR: f64 = 3600.0;
/// Around the hall, from the middle of one leg to there again, so that each lap goes on where the one before ends.
const LAP: [[f64; 2]; 6] = [[0.0, 5.0], [13.0, 5.0], [13.0, -5.0], [-14.0, -5.0], [-14.0, 5.0], [0.0, 5.0]];
/// Parts of the recording whose costs are compared.
const PARTS: usize = 6;

/// Runs the program over an hour of scans, lap after lap; returns a table.
///
/// # Errors
/// When the run fails.
pub fn measure(plan: &Plan) -> Result<String> {
    let room = plan.work.join("hour");
    make_empty(&room)?;
    let whole = room.join("hour");
    let (laps, scans) = write_laps(&room.join("lap"), &whole)?;
    let out = plan.program().run(&whole, "hour-run", &[])?;
    let record = record(&out.join("run.json"))?;
    let rows = record["rows"].as_array().context("run.json has no rows")?;
    ensure!(rows.len() >= PARTS, "{} scans were tracked", rows.len());
    let median = |rows: &[Value]| {
        let mut ms: Vec<f64> = rows.iter().filter_map(|row| row["cpu_ms"].as_f64()).collect();
        ms.sort_by(f64::total_cmp);
        (ms[ms.len() / 2], ms[ms.len() * 99 / 100], ms[ms.len() - 1])
    };
    let errors = Truth::of(&whole)?.errors(&out.join("trajectory.txt"))?;
    let number = |pointer: &str| record.pointer(pointer).and_then(Value::as_f64).unwrap_or(f64::NAN);
    let mut table = format!(
        "{laps} laps of {:.0} m in {:.0} minutes at 10 Hz: {:.0} scans, {:.0} with a pose, ATE {:.4} m, {:.0} keyframes, {} loops, peak memory {:.0} MB, \
         `map.mcap` {:.0} MB, {:.0} s in all.\n\n| scans | CPU ms a scan, median | 99 % | most |\n|---|---|---|---|\n",
        number("/map/path_m") / laps as f64,
        (laps * scans) as f64 * PERIOD / 60.0,
        number("/scans/offered"),
        number("/scans/tracked"),
        errors.ate,
        number("/map/keyframes"),
        record["loops"].as_array().map_or(0, Vec::len),
        number("/cost/peak_memory_bytes") / 1e6,
        fs::metadata(out.join("map.mcap"))?.len() as f64 / 1e6,
        number("/cost/wall_s"),
    );
    for (part, rows) in rows.chunks(rows.len().div_ceil(PARTS)).enumerate() {
        let (middle, p99, most) = median(rows);
        let _ = writeln!(table, "| sixth {} | {middle:.1} | {p99:.1} | {most:.0} |", part + 1);
    }
    Ok(table)
}

/// Writes a lap into one folder, and into another the recording of an hour of such laps; how many there are, and the scans of
/// each.
fn write_laps(lap: &Path, whole: &Path) -> Result<(usize, usize)> {
    let (pose, duration) = walk(&LAP);
    fs::create_dir_all(lap)?;
    // The sensor rests at both ends of the lap, so that a fraction of a scan's time does not show.
    let scans = write_recording(lap, &HALL, &pose, duration)?;
    let laps = (HOUR / (scans as f64 * PERIOD)).round() as usize;
    for part in ["velodyne", "times", "rings"] {
        fs::create_dir_all(whole.join(part))?;
    }
    let (mut times, mut truth) = (String::new(), String::new());
    for number in 0..laps * scans {
        for (part, extension) in [("velodyne", "bin"), ("times", "f32"), ("rings", "u8")] {
            let name = |number: usize| format!("{part}/{number:06}.{extension}");
            symlink(lap.join(name(number % scans)), whole.join(name(number)))?;
        }
        let stamp = number as f64 * PERIOD;
        // Writing to a String cannot fail.
        let _ = writeln!(times, "{stamp:.6} {number:06}");
        for step in 0..10 {
            let within = (number % scans) as f64 * PERIOD + 0.01 * f64::from(step);
            let numbers = pose(within).to_tum().map(|v| format!("{v:.9}")).join(" ");
            let _ = writeln!(truth, "{:.6} {numbers}", stamp + 0.01 * f64::from(step));
        }
    }
    fs::write(whole.join("times.txt"), times)?;
    fs::write(whole.join("groundtruth.txt"), truth)?;
    Ok((laps, scans))
}
