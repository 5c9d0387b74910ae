//! What came of a calibration, for people and as JSON.

use super::collect::Collected;
use calib::{Board, Calibration, FittedView};
use serde::Serialize;
use std::fmt::Write;

/// A model whose residuals are so many times those of a more flexible one does not fit the lens.
const MISFIT: f64 = 1.3;

/// The numbers of a calibration.
#[derive(Serialize)]
pub struct Numbers {
    board: String,
    model: String,
    size: [usize; 2],
    parameters: Vec<Parameter>,
    /// Root mean square length of the residuals of the corners used, pixels.
    rms: f64,
    /// The same with those set aside.
    rms_of_all: f64,
    corners: usize,
    condition: f64,
    images: usize,
    views: Vec<ViewNumbers>,
    coverage: CoverageNumbers,
}

#[derive(Serialize)]
struct Parameter {
    name: &'static str,
    value: f64,
    sigma: f64,
}

#[derive(Serialize)]
struct ViewNumbers {
    name: String,
    corners: usize,
    used: usize,
    /// Pixels; null where the board has no pose.
    rms: Option<f64>,
    edge_width: Option<f64>,
    rejected: Option<String>,
}

#[derive(Serialize)]
struct CoverageNumbers {
    cells: Vec<usize>,
    share: f64,
    tilts: [usize; 4],
    near_far: [usize; 2],
    advice: Vec<String>,
}

impl Numbers {
    /// The numbers of a calibration.
    pub fn new(board: &Board, collected: &Collected, calibration: &Calibration) -> Self {
        let view = |(i, view): (usize, &FittedView)| ViewNumbers {
            name: view.name.clone(),
            corners: collected.shots[i].corners.len(),
            used: view.corners.iter().filter(|corner| corner.used).count(),
            rms: view.pose.map(|_| view.rms),
            edge_width: collected.shots[i].edge_width,
            rejected: reason(collected, view, i),
        };
        let seen = &collected.coverage;
        let parameter = |e: &calib::Estimate| Parameter { name: e.name, value: e.value, sigma: e.sigma };
        Self {
            board: board.to_string(),
            model: calibration.model.to_string(),
            size: [collected.size.0, collected.size.1],
            parameters: calibration.estimates.iter().map(parameter).collect(),
            rms: calibration.rms,
            rms_of_all: calibration.rms_of_all,
            corners: calibration.corner_count,
            condition: calibration.condition,
            images: collected.given,
            views: calibration.views.iter().enumerate().map(view).collect(),
            coverage: CoverageNumbers {
                cells: seen.cells.clone(),
                share: seen.share(),
                tilts: seen.tilts,
                near_far: seen.near_far,
                advice: advice(collected, calibration),
            },
        }
    }
}

/// Why a view was not used.
pub fn reason(collected: &Collected, view: &FittedView, index: usize) -> Option<String> {
    collected.shots[index].problem.clone().or_else(|| view.rejected.clone())
}

/// The summary for the terminal.
pub fn table(collected: &Collected, calibration: &Calibration) -> String {
    let mut out = String::new();
    let used = calibration.views.iter().filter(|view| view.rejected.is_none()).count();
    for estimate in &calibration.estimates {
        let digits = digits(estimate.sigma);
        let _ =
            writeln!(out, "{:<6}{:>14.digits$} ± {:.digits$}", estimate.name, estimate.value, estimate.sigma);
    }
    let _ = writeln!(
        out,
        "rms   {:>14.3} px over {} corners ({:.3} px with those set aside); root mean square of distances, as OpenCV counts",
        calibration.rms, calibration.corner_count, calibration.rms_of_all
    );
    let _ = writeln!(out, "views {used:>14} of {} images", collected.given);
    for (index, view) in calibration.views.iter().enumerate() {
        if let Some(reason) = reason(collected, view, index) {
            let _ = writeln!(out, "  not used: {}: {reason}", view.name);
        }
    }
    for line in advice(collected, calibration) {
        let _ = writeln!(out, "  would help: {line}");
    }
    out
}

/// What would make the calibration better; for people.
pub fn advice(collected: &Collected, calibration: &Calibration) -> Vec<String> {
    better_model(calibration).into_iter().chain(collected.coverage.advice()).collect()
}

/// What to say when the model does not fit the lens: a more flexible one leaves far smaller residuals.
fn better_model(calibration: &Calibration) -> Option<String> {
    let (model, rms) = calibration.most_flexible;
    (calibration.rms > MISFIT * rms).then(|| {
        format!(
            "another --model: {} does not quite fit this lens, {model} leaves {rms:.3} px; kb4 and fov fit many wide lenses",
            calibration.model
        )
    })
}

/// Decimals that show two figures of a standard deviation.
pub fn digits(sigma: f64) -> usize {
    if !(sigma.is_finite() && sigma > 0.0) {
        return 6;
    }
    (1.0 - sigma.log10().floor()).clamp(0.0, 8.0) as usize
}
