//! The report of a map alone: what was killed, merged elsewhere or imported has none of its own.

use crate::lidar::page::Page;
use anyhow::Result;
use map::{Map, Summary};
use std::path::Path;
use view::report::{self, ReportInput};

/// Writes `report.html` of a map to `path`: all that its run's has, but for the frames' times and qualities, which no map holds.
///
/// # Errors
/// When an image cannot be encoded or the file cannot be written.
pub fn write_report(path: &Path, map: &Map) -> Result<()> {
    let names: Vec<&str> = map.agents.values().map(|agent| &*agent.name).collect();
    let title = names.join(" + ");
    let numbers = numbers(&map.summary(None));
    if map.keyframes.values().any(|keyframe| keyframe.scan.is_some()) {
        return Page { tiles: numbers, ..Page::default() }.write(path, &title, map);
    }
    report::write(path, &ReportInput { title: &title, map, rows: &[], numbers: &numbers })
}

/// What there is to say of a map, the weightiest first.
fn numbers(map: &Summary) -> Vec<(String, String)> {
    let unit = if map.metric { "m" } else { "map units" };
    let depths = map.depth_pixels + map.scan_points;
    let numbers = [
        ("frames", map.frames.to_string()),
        ("keyframes", map.keyframes.to_string()),
        ("points", depths.to_string()),
        ("loops", map.loop_edges.to_string()),
        ("length of the path", format!("{:.1} {unit}", map.path_length)),
        ("duration", format!("{:.1} s", map.duration)),
        ("agents", map.agents.len().to_string()),
        ("links between agents", map.merge_edges.to_string()),
    ];
    let is_said = |(name, _): &(&str, String)| map.agents.len() > 1 || !name.contains("agents");
    let numbers = numbers.into_iter().filter(is_said);
    numbers.map(|(name, value)| (name.to_owned(), value)).collect()
}
