//! The page of a map with a LiDAR's scans in it: the 3-D view that all reports share, and beside it tables, plots and what places
//! look like to each other. One file that shows it without a network.

use anyhow::Result;
use geometry::Se3;
use map::Map;
use serde::Serialize;
use slam_lidar::scan_context::ScanContext;
use std::path::Path;
use view::report::cloud::{Cloud, MAX_POINTS, evenly};
use view::report::pack::Packed;
use view::report::page::{Template, save};
use view::report::scene::{PlacedFrame, Scene, placed_frames, placed_keyframes};
use view::script;

const TEMPLATE: Template = Template {
    body: include_str!("assets/report.html"),
    style: include_str!("assets/report.css"),
    policy: "",
    scene: true,
    scripts: &[script!("assets/report.js")],
};

/// Most frames of all trajectories together; some fifty bytes each, before base64.
const MAX_FRAMES: usize = 30_000;
/// Rows and columns of a matrix: more keyframes are thinned.
const ROWS: usize = 160;

/// What a page shows beside the map.
#[derive(Default, Serialize)]
pub(crate) struct Page {
    /// Numbers for the head, by what they are.
    pub tiles: Vec<(String, String)>,
    /// The way by odometry alone, f32 × 3, where loops moved it.
    pub odometry: Option<Packed>,
    /// Scan Context distances.
    pub matrices: Vec<Matrix>,
    pub tables: Vec<Table>,
    pub plots: Vec<Plot>,
}

/// Scan Context distances as bytes, 255 for 1.
#[derive(Serialize)]
pub(crate) struct Matrix {
    name: String,
    rows: usize,
    columns: usize,
    values: Packed,
}

#[derive(Serialize)]
pub(crate) struct Table {
    pub name: String,
    pub head: Vec<&'static str>,
    pub rows: Vec<Vec<String>>,
}

#[derive(Serialize)]
pub(crate) struct Plot {
    pub name: &'static str,
    pub values: Packed,
}

impl Plot {
    /// A row of values.
    pub fn new(name: &'static str, values: impl Iterator<Item = f64>) -> Self {
        Self { name, values: Packed::f32(values.map(|value| value as f32)) }
    }
}

impl Matrix {
    /// The distances of every two, evenly thinned.
    pub fn new(name: &str, rows: &[&ScanContext], columns: &[&ScanContext]) -> Self {
        let [rows, columns] = [rows, columns].map(|all| thinned(all.to_vec()));
        let code = |row: &ScanContext, column| {
            (255.0 * row.similarity(column).distance.clamp(0.0, 1.0)).round() as u8
        };
        let values = rows.iter().flat_map(|row| columns.iter().map(move |column| code(row, column)));
        Self { name: name.into(), rows: rows.len(), columns: columns.len(), values: Packed(values.collect()) }
    }
}

/// At most as many as a matrix has rows, evenly.
pub(crate) fn thinned<T>(mut items: Vec<T>) -> Vec<T> {
    evenly(&mut items, ROWS);
    items
}

/// Places of poses for the page.
pub(crate) fn packed_path(poses: &[(f64, Se3)]) -> Packed {
    Packed::f32(poses.iter().flat_map(|(_, pose)| <[f32; 3]>::from(pose.translation.cast::<f32>())))
}

/// What the page's script reads.
#[derive(Serialize)]
struct Data<'a> {
    scene: Scene,
    cloud: Cloud,
    #[serde(flatten)]
    page: &'a Page,
}

impl Page {
    /// Writes the page of `map` to `path`, replacing what was there.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn write(&self, path: &Path, title: &str, map: &Map) -> Result<()> {
        let keyframes = placed_keyframes(map);
        let mut frames: Vec<PlacedFrame> = placed_frames(map);
        evenly(&mut frames, MAX_FRAMES);
        let data = Data {
            scene: Scene::new(map, &keyframes, &frames),
            cloud: Cloud::new(map, &keyframes, MAX_POINTS),
            page: self,
        };
        save(path, &TEMPLATE.filled(title, &data)?)
    }
}
