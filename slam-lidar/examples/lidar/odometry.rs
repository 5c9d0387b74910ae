//! Errors and time of odometries.

use crate::Failure;
use crate::truth::{Recording, ate, beginning, drift};
use slam_lidar::odometry::OdometryParams;
use slam_lidar::tracking::{Method, Tracker};
use std::path::Path;

/// CPU time of this thread, milliseconds.
fn cpu() -> Result<f64, Failure> {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat")?;
    Ok(text.split_whitespace().next().ok_or("an empty schedstat")?.parse::<f64>()? * 1e-6)
}

/// Tracks a recording and prints a line.
pub fn run(method: &str, path: &Path) -> Result<(), Failure> {
    let recording = Recording::open(path)?;
    let method: Method = if method == "odometry" { Method::Planes } else { method.parse()? };
    let mut tracker = Tracker::new(method, OdometryParams::default());
    let (mut found, mut times) = (Vec::new(), Vec::new());
    for file in recording.folder.files() {
        let scan = recording.folder.read(file)?;
        let begin = cpu()?;
        let sweep = tracker.track(&scan)?;
        found.push((sweep.instant, sweep.world_from_sensor));
        times.push(cpu()? - begin);
    }
    times.sort_by(f64::total_cmp);
    let pairs = recording.pairs(&found);
    let ((rmse, most), (share, rotation)) = (ate(&pairs)?, drift(&pairs));
    println!(
        "{} {method}: ATE {rmse:.4} m, most {most:.3} m, drift {:.3} %, {rotation:.4} deg/m, CPU median {:.1} ms",
        path.display(),
        100.0 * share,
        times[times.len() / 2]
    );
    for metres in [2.0, 10.0] {
        if let Some((off, turned)) = beginning(&pairs, metres) {
            println!("    after the first {metres} m: {off:.4} m, {turned:.3} deg");
        }
    }
    Ok(())
}
