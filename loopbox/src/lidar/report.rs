//! `report.html` of a LiDAR run and of a merge of LiDAR maps.

use super::guessed::GuessedRow;
use super::merging::{LidarMergeRecord, LidarMerging, PairRecord};
use super::page::{Matrix, Page, Plot, Table, packed_path, thinned};
use super::record::{LidarRecord, LoopRow};
use super::scan_row::ScanRow;
use anyhow::Result;
use map::{AgentId, Map};
use slam_lidar::keyframe::context_of;
use slam_lidar::mapping::Agent;
use slam_lidar::scan_context::ScanContext;
use std::path::Path;

/// Writes the page of a run.
pub(super) fn of_run(path: &Path, map: &Map, agent: &Agent, record: &LidarRecord) -> Result<()> {
    let name = map.agents.values().next().map_or("LiDAR", |info| &info.name);
    let contexts: Vec<&ScanContext> = agent.keyframes().iter().map(|keyframe| &keyframe.context).collect();
    let plot = |name, value: fn(&ScanRow) -> f64| Plot::new(name, record.rows.iter().map(value));
    let page = Page {
        tiles: run_tiles(record),
        odometry: (!record.loops.is_empty()).then(|| packed_path(&agent.odometry())),
        matrices: vec![Matrix::new(name, &contexts, &contexts)],
        tables: vec![
            guessed(&record.guessed),
            loops("Loops closed", &record.loops),
            loops("Places refused", &record.refused_loops),
        ],
        plots: vec![
            plot("milliseconds a scan", |row| row.ms),
            plot("share of points that agree with the map", |row| row.inlier_share),
            plot("distance of those from their surfaces, metres", |row| row.rmse_m),
            plot("what the pose may err by where it is guessed, metres", |row| row.guessed_deviation_m),
        ],
    };
    page.write(path, name, map)
}

/// Writes the page of a merge.
pub(super) fn of_merge(path: &Path, merging: &LidarMerging, record: &LidarMergeRecord) -> Result<()> {
    let Some(first) = merging.groups.first() else { return Ok(()) };
    let title = record.inputs.iter().map(|input| &*input.name).collect::<Vec<_>>().join(" + ");
    let contexts = |agent: AgentId| -> Vec<ScanContext> {
        let own = first.map.keyframes.values().filter(|keyframe| keyframe.agent == agent);
        let scans = thinned(own.filter_map(|keyframe| keyframe.scan.as_ref()).collect());
        scans.into_iter().map(|scan| context_of(&scan.points().collect::<Vec<_>>())).collect()
    };
    let all: Vec<(String, Vec<ScanContext>)> =
        first.map.agent_labels().into_iter().map(|(agent, label)| (label, contexts(agent))).collect();
    let mut matrices = Vec::new();
    for (j, (later, columns)) in all.iter().enumerate() {
        for (earlier, rows) in &all[..j] {
            let (rows, columns): (Vec<_>, Vec<_>) = (rows.iter().collect(), columns.iter().collect());
            matrices.push(Matrix::new(&format!("{earlier} (rows) and {later}"), &rows, &columns));
        }
    }
    let page = Page {
        tiles: vec![
            ("maps".into(), record.inputs.len().to_string()),
            ("groups".into(), record.groups.len().to_string()),
            ("seconds".into(), format!("{:.1}", record.cost.merge_s)),
        ],
        matrices,
        tables: vec![pair_results(record)],
        ..Page::default()
    };
    page.write(path, &title, &first.map)
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
        ("guessed, doubtful", format!("{:.1} m, {} scans", map.guessed_m, scans.guessed)),
        ("ms a scan, median · 99 %", format!("{:.1} · {:.1}", cost.median_ms, cost.p99_ms)),
        ("peak memory", memory),
    ];
    numbers.into_iter().map(|(label, value)| (label.to_owned(), value)).collect()
}

fn guessed(rows: &[GuessedRow]) -> Table {
    let row = |row: &GuessedRow| {
        vec![
            format!("{:.1} – {:.1}", row.from_s, row.to_s),
            row.scans.to_string(),
            row.directions.to_string(),
            format!("{:.1}", row.metres),
            format!("{:.1}", row.deviation_m),
        ]
    };
    Table {
        name: "Guessed: scans that do not determine the motion".into(),
        head: vec!["seconds", "scans", "open directions", "metres guessed", "may err by m"],
        rows: rows.iter().map(row).collect(),
    }
}

fn loops(name: &str, rows: &[LoopRow]) -> Table {
    let row = |l: &LoopRow| {
        let mut cells = vec![
            format!("{} – {}", l.from, l.to),
            format!("{:.2}", l.overlap),
            format!("{:.3}", l.inlier_ratio),
            format!("{:.3}", l.violated),
            format!("{:.3}", l.rmse_m),
            format!("{:.2}", l.distance_m),
        ];
        cells.extend(l.reason.clone());
        cells
    };
    let mut head = vec!["keyframes", "overlap", "agreeing", "in free space", "residual m", "apart m"];
    if rows.iter().any(|row| row.reason.is_some()) {
        head.push("refused because");
    }
    Table { name: name.into(), head, rows: rows.iter().map(row).collect() }
}

fn pair_results(record: &LidarMergeRecord) -> Table {
    let row = |e: &PairRecord| {
        let number = |value: Option<f64>| value.map_or("–".into(), |v| format!("{v:.3}"));
        let best = e.best.as_ref();
        vec![
            format!("{} + {}", e.maps[0], e.maps[1]),
            format!("{}: {}", e.decision, e.answer),
            e.reason.clone(),
            best.map_or("–".into(), |b| format!("{} of {}", b.pieces, b.of_pieces)),
            number(best.map(|b| b.overlap)),
            number(best.map(|b| b.inlier_ratio)),
            number(best.map(|b| b.ln_ratio)),
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
        "ln ratio",
        "in both m²",
        "in one only m²",
    ];
    Table { name: "Every two maps".into(), head, rows: record.pair_results.iter().map(row).collect() }
}
