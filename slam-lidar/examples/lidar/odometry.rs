//! Errors and time of odometries.

use crate::Failure;
use crate::truth::{Recording, ate, drift};
use geometry::Se3;
use scans::Scan;
use slam_lidar::floam::{FeatureMethod, FeatureOdometry};
use slam_lidar::odometry::{Odometry, OdometryParams};
use std::path::Path;

/// CPU time of this thread, milliseconds.
fn cpu() -> Result<f64, Failure> {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat")?;
    Ok(text.split_whitespace().next().ok_or("an empty schedstat")?.parse::<f64>()? * 1e-6)
}

/// Takes a scan; the instant and the pose come back.
type Tracker = Box<dyn FnMut(&Scan) -> Result<(f64, Se3), Failure>>;

fn tracker(method: &str) -> Tracker {
    let feature = |method| -> Tracker {
        let mut odometry = FeatureOdometry::new(method);
        Box::new(move |scan| Ok(odometry.track(scan)?))
    };
    match method {
        "floam" => feature(FeatureMethod::Floam),
        "a-loam" => feature(FeatureMethod::ALoam),
        _ => {
            let mut odometry = Odometry::new(OdometryParams::default());
            Box::new(move |scan| {
                let sweep = odometry.track(scan);
                Ok((sweep.instant, sweep.world_from_sensor))
            })
        }
    }
}

/// Tracks a recording and prints a line.
pub fn run(method: &str, path: &Path) -> Result<(), Failure> {
    let recording = Recording::open(path)?;
    let mut track = tracker(method);
    let (mut found, mut times) = (Vec::new(), Vec::new());
    for file in recording.folder.files() {
        let scan = recording.folder.read(file)?;
        let begin = cpu()?;
        found.push(track(&scan)?);
        times.push(cpu()? - begin);
    }
    times.sort_by(f64::total_cmp);
    let pairs = recording.pairs(&found);
    let ((rmse, most), (share, turn)) = (ate(&pairs)?, drift(&pairs));
    println!(
        "{} {method}: ATE {rmse:.4} m, most {most:.3} m, drift {:.3} %, {turn:.4} deg/m, CPU median {:.1} ms",
        path.display(),
        100.0 * share,
        times[times.len() / 2]
    );
    Ok(())
}
