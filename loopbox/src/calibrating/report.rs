//! `report.html` of a calibration: parameters, coverage, residuals, detections; one file, offline.

use super::collect::Collected;
use super::summary::{advice, digits, reason};
use anyhow::{Context, Result};
use calib::{Board, Calibration, FittedView};
use nalgebra::Vector3;
use serde::Serialize;
use view::report::gallery::encode;
use view::report::pack::Packed;
use view::report::page::Template;
use view::script;

/// Most images that are shown.
const MAX_SHOTS: usize = 12;
/// Most bytes of an image.
const MAX_BYTES: usize = 120_000;

const TEMPLATE: Template = Template {
    body: include_str!("assets/calib.html"),
    style: include_str!("assets/calib.css"),
    policy: "",
    scene: false,
    scripts: &[script!("assets/calib.js")],
};

/// What the page's script reads.
#[derive(Serialize)]
struct Data {
    size: [usize; 2],
    rms: f64,
    unit: &'static str,
    tiles: Vec<(&'static str, String)>,
    parameters: Vec<Parameter>,
    advice: Vec<String>,
    views: Vec<View>,
    shots: Vec<Picture>,
}

#[derive(Serialize)]
struct Parameter {
    name: &'static str,
    value: String,
    sigma: String,
}

#[derive(Serialize)]
struct View {
    name: String,
    used: bool,
    count: usize,
    rms: Option<f64>,
    edge_width: Option<f64>,
    /// Between the board's normal and the optical axis, degrees.
    tilt: Option<f64>,
    /// Of the board's middle along the optical axis, metres.
    distance: Option<f64>,
    reason: Option<String>,
    /// x, y, residual x, residual y, used (0 or 1) of each corner, f32.
    corners: Packed,
}

#[derive(Serialize)]
struct Picture {
    view: usize,
    jpeg: Packed,
}

/// The page.
///
/// # Errors
/// When an image cannot be encoded.
pub fn render(board: &Board, collected: &Collected, calibration: &Calibration) -> Result<String> {
    let used = calibration.views.iter().filter(|view| view.rejected.is_none()).count();
    let parameter = |e: &calib::Estimate| {
        let digits = digits(e.sigma);
        Parameter {
            name: e.name,
            value: format!("{:.digits$}", e.value),
            sigma: format!("{:.digits$}", e.sigma),
        }
    };
    let data = Data {
        size: [collected.size.0, collected.size.1],
        rms: calibration.rms,
        unit: "m",
        tiles: vec![
            ("rms", format!("{:.3} px", calibration.rms)),
            ("views used", format!("{used} of {}", collected.given)),
            ("corners", calibration.corner_count.to_string()),
            ("model", calibration.model.to_string()),
            ("image covered", format!("{:.0} %", 100.0 * collected.coverage.share())),
        ],
        parameters: calibration.estimates.iter().map(parameter).collect(),
        advice: advice(collected, calibration),
        views: calibration.views.iter().enumerate().map(|(i, v)| view(board, collected, v, i)).collect(),
        shots: pictures(collected, calibration)?,
    };
    TEMPLATE.filled(&format!("Calibration from {board}"), &data)
}

fn view(board: &Board, collected: &Collected, view: &FittedView, index: usize) -> View {
    let points = board.points();
    let middle = points.iter().sum::<Vector3<f64>>() / points.len().max(1) as f64;
    let corners = view.corners.iter().flat_map(|corner| {
        let (at, residual) = (corner.corner.pixel, corner.residual);
        [at.x, at.y, residual.x, residual.y, f64::from(u8::from(corner.used))].map(|v| v as f32)
    });
    let reason = reason(collected, view, index);
    View {
        name: view.name.clone(),
        used: reason.is_none(),
        count: view.corners.iter().filter(|corner| corner.used).count(),
        rms: view.pose.map(|_| view.rms),
        edge_width: collected.shots[index].edge_width,
        tilt: view
            .pose
            .map(|pose| (pose.rotation * Vector3::z()).z.abs().clamp(0.0, 1.0).acos().to_degrees()),
        distance: view.pose.map(|pose| (pose * middle).z),
        reason,
        corners: Packed::f32(corners),
    }
}

/// Some images, those that were not used among them.
fn pictures(collected: &Collected, calibration: &Calibration) -> Result<Vec<Picture>> {
    let rejected = |i: &usize| calibration.views[*i].rejected.is_some();
    let all: Vec<usize> = (0..collected.shots.len()).collect();
    let (bad, good): (Vec<usize>, Vec<usize>) = all.into_iter().partition(rejected);
    let mut chosen = spread(&bad, MAX_SHOTS / 3);
    chosen.extend(spread(&good, MAX_SHOTS - chosen.len()));
    let picture = |view: usize| {
        let shot = &collected.shots[view];
        let jpeg = encode(&shot.image, MAX_BYTES)
            .with_context(|| format!("{}: cannot be written as JPEG", shot.name))?;
        Ok(Picture { view, jpeg: Packed(jpeg) })
    };
    chosen.into_iter().map(picture).collect()
}

fn spread(items: &[usize], count: usize) -> Vec<usize> {
    let count = count.min(items.len());
    (0..count).map(|i| items[i * items.len() / count]).collect()
}
