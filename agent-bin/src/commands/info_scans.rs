//! `loopbox info` of a LiDAR's recording.

use crate::console;
use anyhow::Result;
use scans::{ScanError, ScanSource};
use serde::Serialize;
use std::collections::BTreeSet;
use std::fmt;

/// So many scans are looked at.
const LOOKED_AT: usize = 5;

/// Describes it.
///
/// # Errors
/// When it cannot be read.
pub fn run(mut source: Box<dyn ScanSource>, json: bool) -> Result<()> {
    let info = source.info().clone();
    let mut recording = Recording {
        path: info.path.display().to_string(),
        kind: info.kind,
        scans: info.count,
        duration_s: info.duration,
        points: None,
        rings: None,
        point_times: None,
        problems: Vec::new(),
    };
    for next in std::iter::from_fn(|| source.next_scan()).take(LOOKED_AT) {
        match next.scan {
            Ok(scan) => {
                let rings: BTreeSet<u16> = scan.rings.iter().copied().collect();
                recording.points.get_or_insert(scan.points.len());
                recording.rings.get_or_insert(rings.len());
                recording.point_times.get_or_insert(!scan.times.is_empty());
            }
            Err(ScanError::Io { name, source }) => recording.problems.push(format!("{name}: {source}")),
            Err(error) => recording.problems.push(error.to_string()),
        }
    }
    recording.problems.extend(source.remarks());
    if json { console::print_json(&recording) } else { console::print(&recording.to_string()) }
}

/// What can be said of scans without reading them all.
#[derive(Debug, Serialize)]
struct Recording {
    path: String,
    kind: String,
    scans: Option<u64>,
    duration_s: Option<f64>,
    /// Points of the first scan that can be used.
    points: Option<usize>,
    /// Its rings; 0 where they are not known.
    rings: Option<usize>,
    /// Whether its points have times, from the recording or told from their directions.
    point_times: Option<bool>,
    /// What is wrong with the first scans.
    problems: Vec<String>,
}

impl fmt::Display for Recording {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let unknown = || "unknown".to_owned();
        writeln!(f, "recording    {}", self.path)?;
        writeln!(f, "kind         {}", self.kind)?;
        writeln!(f, "scans        {}", self.scans.map_or_else(unknown, |n| n.to_string()))?;
        writeln!(f, "duration     {}", self.duration_s.map_or_else(unknown, |s| format!("{s:.2} s")))?;
        writeln!(
            f,
            "points       {} in the first scan",
            self.points.map_or_else(unknown, |n| n.to_string())
        )?;
        let rings = match self.rings {
            Some(0) | None => "unknown".into(),
            Some(rings) => rings.to_string(),
        };
        writeln!(f, "rings        {rings}")?;
        let times =
            if self.point_times == Some(true) { "known" } else { "unknown: scans are taken as undistorted" };
        writeln!(f, "point times  {times}")?;
        self.problems.iter().try_for_each(|problem| writeln!(f, "problem      {problem}"))
    }
}
