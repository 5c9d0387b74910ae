//! `report.html` of a merge of maps with both kinds of sensors.

use super::{MixedPairResult, MixedRecord};
use crate::lidar::page::{Page, Table};
use anyhow::Result;
use map::Map;
use std::path::Path;

/// Writes the page of the first group's map.
pub(super) fn write(path: &Path, map: &Map, record: &MixedRecord) -> Result<()> {
    let title = record.groups.first().map_or_else(String::new, |names| names.join(" + "));
    let row = |met: &MixedPairResult| {
        vec![met.agents.join(" + "), met.sensor.to_string(), met.decision.into(), met.reason.clone()]
    };
    let agents = record.agents.iter();
    let page = Page {
        tiles: vec![
            ("maps".into(), record.inputs.len().to_string()),
            ("agents".into(), record.agents.len().to_string()),
            ("groups".into(), record.groups.len().to_string()),
        ],
        tables: vec![
            Table {
                name: "Every two agents of one kind".into(),
                head: vec!["agents", "sensor", "decision", "by"],
                rows: record.pair_results.iter().map(row).collect(),
            },
            Table {
                name: "Agents".into(),
                head: vec!["agent", "sensor", "keyframes"],
                rows: agents
                    .map(|of| vec![of.name.clone(), of.sensor.to_string(), of.keyframes.to_string()])
                    .collect(),
            },
            Table {
                name: "Taken back".into(),
                head: vec!["merge and why"],
                rows: record.taken_back.iter().map(|taken| vec![taken.clone()]).collect(),
            },
        ],
        ..Page::default()
    };
    page.write(path, &title, map)
}
