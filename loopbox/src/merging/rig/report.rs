//! `report.html` of a rig: both agents in one map, and how well their ways are one.

use super::RigRecord;
use crate::lidar::page::{Page, Plot, Table};
use crate::placing::rig::Tied;
use anyhow::Result;
use map::{AgentId, Map, SensorKind};
use std::path::Path;

/// Writes the page of the common map.
pub(super) fn write(path: &Path, map: &Map, tied: &Tied, record: &RigRecord) -> Result<()> {
    let title = record.inputs.iter().map(|input| &*input.name).collect::<Vec<_>>().join(" + ");
    let apart = camera_offsets(map, tied);
    let page = Page {
        tiles: tiles(record),
        tables: vec![maps(record)],
        plots: vec![
            Plot::new(
                "metres between where the camera is in the common map and where the LiDAR has it, image by image",
                apart.iter().map(|(metres, _)| *metres),
            ),
            Plot::new("degrees between its directions by both", apart.iter().map(|(_, degrees)| *degrees)),
        ],
        ..Page::default()
    };
    page.write(path, &title, map)
}

/// Of each image that was taken while the LiDAR has poses: how far the camera is from where the LiDAR has it, metres and
/// degrees.
fn camera_offsets(map: &Map, tied: &Tied) -> Vec<(f64, f64)> {
    let cameras = map.agents.iter().filter(|(_, info)| info.sensor.kind() == SensorKind::Camera);
    let images = cameras.flat_map(|(agent, _): (&AgentId, _)| map.trajectory_of(*agent));
    let apart = |image: map::StampedPose| {
        let by_lidar = tied.lidar_world_from_camera(image.timestamp)?;
        let off = by_lidar.inverse() * image.world_from_camera;
        Some((off.translation.norm(), off.rotation.angle().to_degrees()))
    };
    images.filter_map(apart).collect()
}

fn tiles(record: &RigRecord) -> Vec<(String, String)> {
    let scale = format!("{:.4} m ± {:.2} %", record.metres_per_unit, 100.0 * record.scale_doubt);
    let numbers = [
        ("images while the LiDAR has poses", record.images.to_string()),
        ("a unit of the camera's map", scale),
        ("ways apart, median", format!("{:.3} m · {:.2}°", record.distance_m, record.angle_deg)),
        ("camera about its middle", format!("{:.2} m", record.reach_m)),
        ("keyframes tied", record.ties.to_string()),
        ("not believed", record.suppressed.to_string()),
    ];
    numbers.map(|(label, value)| (label.to_owned(), value)).into()
}

fn maps(record: &RigRecord) -> Table {
    let row = |input: &super::RigInput| {
        vec![input.name.clone(), input.sensor.to_string(), input.keyframes.to_string(), input.path.clone()]
    };
    let mut rows: Vec<Vec<String>> = record.inputs.iter().map(row).collect();
    let pose = record.lidar_from_camera.map(|number| format!("{number:.4}")).join(" ");
    rows.push(vec!["camera on the LiDAR".into(), "tx ty tz qx qy qz qw".into(), String::new(), pose]);
    Table {
        name: "The maps and how they lie".into(),
        head: vec!["agent", "sensor", "keyframes", "from"],
        rows,
    }
}
