//! `report.html`: one file that shows a run, without a network.
//!
//! The page holds everything it needs: styles, scripts, the cloud as quantised typed arrays, key images
//! as JPEG. Nothing in it points outside, and a content policy forbids the browser to try. The same
//! input gives the same bytes.

mod cloud;
mod gallery;
mod pack;
mod scene;
#[cfg(test)]
mod tests;

use anyhow::Context;
use map::Map;
use pack::Packed;
use serde::Serialize;
use slam_direct::TrackingState;
use std::path::Path;

/// What became of one frame, a row of the per-frame plots.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FrameRow {
    /// Index of the frame in the recording, from 0.
    pub frame_index: u64,
    /// Time stamp, seconds.
    pub timestamp: f64,
    /// Time spent on the frame, milliseconds.
    pub ms: f32,
    /// Points matched in the frame.
    pub matched_points: usize,
    /// Share of the predicted points that were matched, 0–1.
    pub inlier_share: f32,
    /// Root mean square photometric residual of the matched points, grey levels.
    pub rmse: f32,
    /// State after the frame.
    pub state: TrackingState,
}

/// All that goes into a report.
#[derive(Clone, Copy, Debug)]
pub struct ReportInput<'a> {
    /// Heading of the page: what was run.
    pub title: &'a str,
    /// The map to show, of one agent.
    pub map: &'a Map,
    /// One row per processed frame, in order of the recording; frames never processed have none.
    pub rows: &'a [FrameRow],
    /// The run's numbers as `(label, value)`, the weightiest first: the first six also stand large at the top.
    pub numbers: &'a [(String, String)],
}

/// Writes the report to `path`, replacing what was there.
///
/// # Errors
/// When a key image cannot be encoded or the file cannot be written.
pub fn write(path: &Path, input: &ReportInput) -> anyhow::Result<()> {
    let html = render(input)?;
    std::fs::write(path, html).with_context(|| {
        format!(
            "cannot write the report to {}: check that the folder exists and the disk has room",
            path.display()
        )
    })
}

/// The whole page as text.
fn render(input: &ReportInput) -> anyhow::Result<String> {
    let data = Data::new(input)?;
    let json =
        script_safe(&serde_json::to_string(&data).context("the report's data cannot be written as JSON")?);
    let scripts = [
        include_str!("assets/page.js"),
        include_str!("assets/gl.js"),
        include_str!("assets/cloud.js"),
        include_str!("assets/camera.js"),
        include_str!("assets/viewer.js"),
        include_str!("assets/controls.js"),
        include_str!("assets/plots.js"),
        include_str!("assets/gallery.js"),
        include_str!("assets/start.js"),
    ]
    .concat();
    Ok(fill(
        include_str!("assets/page.html"),
        &[
            ("title", &html_escaped(input.title)),
            ("style", include_str!("assets/page.css")),
            ("data", &json),
            ("script", &scripts),
        ],
    ))
}

/// Puts values into the `{{name}}` marks of a template; values are not searched for marks again.
fn fill(template: &str, values: &[(&str, &str)]) -> String {
    let mut out = String::with_capacity(template.len() + values.iter().map(|(_, v)| v.len()).sum::<usize>());
    let mut rest = template;
    while let Some((before, after)) = rest.split_once("{{") {
        let (name, after) = after.split_once("}}").unwrap_or((after, ""));
        out.push_str(before);
        out.push_str(values.iter().find(|(n, _)| *n == name).map_or("", |(_, value)| value));
        rest = after;
    }
    out.push_str(rest);
    out
}

/// Text made harmless inside an HTML element or attribute.
fn html_escaped(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            '\'' => out.push_str("&#39;"),
            _ => out.push(c),
        }
    }
    out
}

/// JSON made harmless inside a `<script>` element: these characters occur only within its strings,
/// where `\u` escapes mean the same.
fn script_safe(json: &str) -> String {
    let mut out = String::with_capacity(json.len());
    for c in json.chars() {
        match c {
            '<' | '>' | '&' => out.push_str(&format!("\\u{:04x}", c as u32)),
            _ => out.push(c),
        }
    }
    out
}

/// The page's data, as its scripts read it.
#[derive(Serialize)]
struct Data<'a> {
    numbers: &'a [(String, String)],
    provenance: Vec<(&'a str, &'a str)>,
    scene: scene::Scene,
    cloud: cloud::Cloud,
    gallery: Vec<gallery::Picture>,
    rows: Rows,
}

impl<'a> Data<'a> {
    fn new(input: &ReportInput<'a>) -> anyhow::Result<Self> {
        let map = input.map;
        let keyframes = scene::placed_keyframes(map);
        let cloud = cloud::Cloud::new(map, &keyframes);
        Ok(Self {
            numbers: input.numbers,
            provenance: map
                .agents
                .values()
                .flat_map(|agent| &agent.provenance)
                .map(|(key, value)| (key.as_str(), value.as_str()))
                .collect(),
            scene: scene::Scene::new(map, &keyframes),
            gallery: gallery::pictures(&keyframes, cloud.inverse_depth)?,
            cloud,
            rows: Rows::new(input.rows),
        })
    }
}

/// The rows, one array per column.
#[derive(Serialize)]
struct Rows {
    count: usize,
    frame: Packed,
    timestamp: Packed,
    ms: Packed,
    matched_points: Packed,
    inlier_share: Packed,
    rmse: Packed,
    state: Packed,
}

impl Rows {
    fn new(rows: &[FrameRow]) -> Self {
        let state = |row: &FrameRow| match row.state {
            TrackingState::Starting => 0,
            TrackingState::Tracking => 1,
            TrackingState::Lost => 2,
        };
        Self {
            count: rows.len(),
            frame: Packed::f64(rows.iter().map(|r| r.frame_index as f64)),
            timestamp: Packed::f64(rows.iter().map(|r| r.timestamp)),
            ms: Packed::f32(rows.iter().map(|r| r.ms)),
            matched_points: Packed::f32(rows.iter().map(|r| r.matched_points as f32)),
            inlier_share: Packed::f32(rows.iter().map(|r| r.inlier_share)),
            rmse: Packed::f32(rows.iter().map(|r| r.rmse)),
            state: Packed(rows.iter().map(state).collect()),
        }
    }
}
