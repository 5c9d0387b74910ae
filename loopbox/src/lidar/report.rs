//! `report.html` of a LiDAR run and of a merge of LiDAR maps: one file that shows it without a network.

use super::merging::LidarMergeRecord;
use super::merging::LidarMerging;
use super::record::LidarRecord;
use anyhow::Result;
use map::{AgentId, EdgeKind, Map, agent_color};
use nalgebra::Vector3;
use serde::Serialize;
use slam_lidar::mapping::Agent;
use slam_lidar::scan_context::ScanContext;
use std::path::Path;
use view::report::pack::Packed;
use view::report::page::{Template, save};
use view::script;

const TEMPLATE: Template = Template {
    body: include_str!("assets/report.html"),
    style: include_str!("assets/report.css"),
    policy: "",
    scene: false,
    scripts: &[script!("assets/report.js")],
};

/// Points of a page's cloud: a megabyte of text.
const POINTS: usize = 120_000;
/// Rows and columns of a matrix: more keyframes are thinned.
const ROWS: usize = 160;
/// Colours of paths.
const SMOOTHED: &str = "#58a6ff";
const ODOMETRY: &str = "#f0974a";

/// What the page's script reads.
#[derive(Serialize)]
struct Data {
    tiles: Vec<(String, String)>,
    agents: Vec<AgentData>,
    cloud: Cloud,
    paths: Vec<Way>,
    /// Places of loops and merges.
    marks: Vec<[f32; 3]>,
    matrices: Vec<Matrix>,
    tables: Vec<Table>,
    plots: Vec<Plot>,
}

#[derive(Serialize)]
struct AgentData {
    name: String,
    color: [u8; 3],
}

/// Points as multiples of `step` from `corner`.
#[derive(Serialize)]
struct Cloud {
    corner: [f32; 3],
    step: f32,
    points: Packed,
    agents: Packed,
}

#[derive(Serialize)]
struct Way {
    name: String,
    color: String,
    points: Packed,
}

/// Scan Context distances as bytes, 255 for 1.
#[derive(Serialize)]
struct Matrix {
    name: String,
    rows: usize,
    columns: usize,
    values: Packed,
}

#[derive(Serialize)]
struct Table {
    name: String,
    head: Vec<&'static str>,
    rows: Vec<Vec<String>>,
}

#[derive(Serialize)]
struct Plot {
    name: &'static str,
    values: Packed,
}

/// Writes the page of a run.
pub(super) fn of_run(path: &Path, map: &Map, agent: &Agent, record: &LidarRecord) -> Result<()> {
    let name = map.agents.values().next().map_or("LiDAR", |info| &info.name).to_owned();
    let contexts: Vec<&ScanContext> = agent.keyframes().iter().map(|keyframe| &keyframe.context).collect();
    let way = |name: &str, color: &str, poses: &[(f64, geometry::Se3)]| Way {
        name: name.into(),
        color: color.into(),
        points: packed(poses.iter().map(|(_, pose)| pose.translation)),
    };
    let mut paths = vec![way("path", SMOOTHED, &agent.trajectory())];
    if !record.loops.is_empty() {
        paths.insert(0, way("odometry alone", ODOMETRY, &agent.odometry()));
    }
    let mark =
        |row: &super::record::LoopRow| Some(agent.keyframes().get(row.to)?.world_from_sensor.translation);
    let plot = |name, value: fn(&super::record::ScanRow) -> f64| Plot {
        name,
        values: Packed::f32(record.rows.iter().map(|row| value(row) as f32)),
    };
    let data = Data {
        tiles: run_tiles(record),
        agents: agents(map),
        cloud: cloud(&[map]),
        paths,
        marks: record.loops.iter().filter_map(mark).map(|p| [p.x as f32, p.y as f32, p.z as f32]).collect(),
        matrices: vec![matrix(&name, &contexts, &contexts)],
        tables: vec![loops("Loops closed", &record.loops), loops("Places refused", &record.refused_loops)],
        plots: vec![
            plot("milliseconds a scan", |row| row.ms),
            plot("share of points that agree with the map", |row| row.inlier_share),
            plot("distance of those from their surfaces, metres", |row| row.rmse_m),
        ],
    };
    save(path, &TEMPLATE.filled(&name, &data)?)
}

/// Writes the page of a merge.
pub(super) fn of_merge(path: &Path, merging: &LidarMerging, record: &LidarMergeRecord) -> Result<()> {
    let Some(first) = merging.groups.first() else { return Ok(()) };
    let title = record.inputs.iter().map(|input| &*input.name).collect::<Vec<_>>().join(" + ");
    let way = |(agent, label): (&AgentId, &String)| {
        let [r, g, b] = agent_color(*agent);
        let poses = first.map.trajectory_of(*agent);
        let points = packed(poses.iter().map(|pose| pose.world_from_camera.translation));
        Way { name: label.clone(), color: format!("rgb({r} {g} {b})"), points }
    };
    let merges = first.map.edges.iter().filter(|edge| edge.kind == EdgeKind::Merge);
    let mark = |edge: &map::Edge| Some(first.map.keyframes.get(&edge.from)?.world_from_keyframe.translation);
    let contexts = |agent: AgentId| -> Vec<ScanContext> {
        let own = first.map.keyframes.values().filter(|keyframe| keyframe.agent == agent);
        let thinned = every(own.filter_map(|keyframe| keyframe.scan.as_ref()).collect());
        thinned.into_iter().map(|scan| context(&scan.points().collect::<Vec<_>>())).collect()
    };
    let all: Vec<(String, Vec<ScanContext>)> =
        first.map.agent_labels().into_iter().map(|(agent, label)| (label, contexts(agent))).collect();
    let mut matrices = Vec::new();
    for (j, (later, columns)) in all.iter().enumerate() {
        for (earlier, rows) in &all[..j] {
            let (rows, columns): (Vec<_>, Vec<_>) = (rows.iter().collect(), columns.iter().collect());
            matrices.push(matrix(&format!("{earlier} (rows) and {later}"), &rows, &columns));
        }
    }
    let data = Data {
        tiles: vec![
            ("maps".into(), record.inputs.len().to_string()),
            ("groups".into(), record.groups.len().to_string()),
            ("seconds".into(), format!("{:.1}", record.cost.merge_s)),
        ],
        agents: agents(&first.map),
        cloud: cloud(&[&first.map]),
        paths: first.map.agent_labels().iter().map(way).collect(),
        marks: merges.filter_map(mark).map(|p| [p.x as f32, p.y as f32, p.z as f32]).collect(),
        matrices,
        tables: vec![encounters(record)],
        plots: Vec::new(),
    };
    save(path, &TEMPLATE.filled(&title, &data)?)
}

fn run_tiles(record: &LidarRecord) -> Vec<(String, String)> {
    let (scans, map, cost) = (&record.scans, &record.map, &record.cost);
    let memory = cost.peak_memory_bytes.map_or("unknown".into(), |bytes| format!("{} MiB", bytes >> 20));
    let numbers = [
        ("scans with a pose", format!("{} of {}", scans.tracked, scans.offered)),
        ("keyframes", map.keyframes.to_string()),
        ("points", map.points.to_string()),
        ("way", format!("{:.1} m", map.path_m)),
        ("loops closed", record.loops.len().to_string()),
        ("moved by loops", format!("{:.3} m", map.corrected_m)),
        ("open directions", format!("{} scans", scans.degenerate)),
        ("ms a scan, median · 99 %", format!("{:.1} · {:.1}", cost.median_ms, cost.p99_ms)),
        ("peak memory", memory),
    ];
    numbers.into_iter().map(|(label, value)| (label.to_owned(), value)).collect()
}

fn agents(map: &Map) -> Vec<AgentData> {
    map.agents
        .iter()
        .map(|(id, info)| AgentData { name: info.name.clone(), color: agent_color(*id) })
        .collect()
}

/// The points of maps, evenly thinned.
fn cloud(maps: &[&Map]) -> Cloud {
    let all = || maps.iter().flat_map(|map| map.cloud(f32::INFINITY));
    let every = all().count().div_ceil(POINTS).max(1);
    let (mut least, mut most) = (Vector3::repeat(f64::INFINITY), Vector3::repeat(f64::NEG_INFINITY));
    for point in all().step_by(every) {
        (least, most) = (least.inf(&point.position), most.sup(&point.position));
    }
    if least.x > most.x {
        (least, most) = (Vector3::zeros(), Vector3::zeros());
    }
    let step = ((most - least).max() / f64::from(u16::MAX)).max(1e-6);
    let (mut points, mut agents) = (Vec::new(), Vec::new());
    for point in all().step_by(every) {
        let at = (point.position - least) / step;
        points.extend(at.iter().flat_map(|value| (value.round() as u16).to_le_bytes()));
        agents.push(u8::try_from(point.agent.0).unwrap_or(u8::MAX));
    }
    let corner = [least.x as f32, least.y as f32, least.z as f32];
    Cloud { corner, step: step as f32, points: Packed(points), agents: Packed(agents) }
}

fn packed(points: impl Iterator<Item = Vector3<f64>>) -> Packed {
    Packed::f32(points.flat_map(|p| [p.x as f32, p.y as f32, p.z as f32]))
}

fn context(points: &[[f32; 3]]) -> ScanContext {
    slam_lidar::keyframe::context_of(points)
}

/// At most [`ROWS`] of them, evenly.
fn every<T>(items: Vec<T>) -> Vec<T> {
    let step = items.len().div_ceil(ROWS).max(1);
    items.into_iter().step_by(step).collect()
}

fn matrix(name: &str, rows: &[&ScanContext], columns: &[&ScanContext]) -> Matrix {
    let (rows, columns) = (every(rows.to_vec()), every(columns.to_vec()));
    let values = rows.iter().flat_map(|row| {
        columns.iter().map(|column| (255.0 * row.likeness(column).distance.clamp(0.0, 1.0)).round() as u8)
    });
    Matrix { name: name.into(), rows: rows.len(), columns: columns.len(), values: Packed(values.collect()) }
}

fn loops(name: &str, rows: &[super::record::LoopRow]) -> Table {
    let row = |l: &super::record::LoopRow| {
        vec![
            format!("{} – {}", l.from, l.to),
            format!("{:.2}", l.overlap),
            format!("{:.3}", l.agreeing),
            format!("{:.3}", l.violated),
            format!("{:.3}", l.rmse_m),
            format!("{:.2}", l.distance_m),
        ]
    };
    let head = vec!["keyframes", "overlap", "agreeing", "in free space", "residual m", "apart m"];
    Table { name: name.into(), head, rows: rows.iter().map(row).collect() }
}

fn encounters(record: &LidarMergeRecord) -> Table {
    let row = |e: &super::merging::EncounterRecord| {
        let number = |value: Option<f64>| value.map_or("–".into(), |v| format!("{v:.3}"));
        let best = e.best.as_ref();
        vec![
            format!("{} + {}", e.maps[0], e.maps[1]),
            e.decision.into(),
            e.reason.clone(),
            best.map_or("–".into(), |b| format!("{} of {}", b.pieces, b.of_pieces)),
            number(best.map(|b| b.overlap)),
            number(best.map(|b| b.agreeing)),
            number(best.map(|b| b.violated)),
            number(best.map(|b| b.shared_m2)),
            number(best.map(|b| b.absent_m2)),
        ]
    };
    let head = vec![
        "maps",
        "decision",
        "by",
        "pieces",
        "overlap",
        "agreeing",
        "in free space",
        "shared m²",
        "absent m²",
    ];
    Table { name: "Every two maps".into(), head, rows: record.encounters.iter().map(row).collect() }
}
