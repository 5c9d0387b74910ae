//! `report.html`: one file that shows a run, without a network.
//!
//! The page holds everything it needs: styles, scripts, the cloud as quantised typed arrays, key images
//! as JPEG. Nothing in it points outside, and a content policy forbids the browser to try. The same
//! input gives the same bytes.
//!
//! What the page of a merging needs too is public: the page around, the 3-D view, pictures, packed numbers.

pub mod cloud;
pub mod gallery;
pub mod pack;
pub mod page;
pub mod scene;
pub mod script;
#[cfg(test)]
mod tests;

use crate::script;
use map::Map;
use pack::Packed;
use page::Template;
use serde::Serialize;
use slam_direct::TrackingState;
use std::path::Path;

/// The page of a run.
const TEMPLATE: Template = Template {
    body: include_str!("assets/run.html"),
    style: "",
    policy: "",
    scene: true,
    scripts: &[script!("assets/plots.js"), script!("assets/gallery.js"), script!("assets/start.js")],
};

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
    /// The map to show.
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
    page::save(path, &render(input)?)
}

/// The whole page as text.
fn render(input: &ReportInput) -> anyhow::Result<String> {
    TEMPLATE.filled(input.title, &Data::new(input)?)
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
        let cloud = cloud::Cloud::new(map, &keyframes, cloud::MAX_POINTS);
        Ok(Self {
            numbers: input.numbers,
            provenance: map
                .agents
                .values()
                .flat_map(|agent| &agent.provenance)
                .map(|(key, value)| (key.as_str(), value.as_str()))
                .collect(),
            scene: scene::Scene::new(map, &keyframes, &scene::placed_frames(map)),
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
