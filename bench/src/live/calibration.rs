//! Calibrations of images of which the result is known.

mod apart;
mod held_out;

use crate::measure::{Runner, finish};
use anyhow::{Context, Result};
pub use apart::Apart;
use apart::{apart, at_border, camera};
pub use held_out::{HeldOut, Misfit};
use serde_json::Value;
use std::path::Path;
use std::process::Command;
use std::time::Instant;

/// Images of a board, and what others found for their camera.
pub struct KnownCamera {
    /// Folder of the images.
    pub name: &'static str,
    /// The board.
    board: &'static str,
    /// The model to fit.
    model: &'static str,
    /// The known parameters.
    parameters: &'static [(&'static str, f64)],
    /// Largest difference of those parameters that are to be reached, percent.
    percent: f64,
    /// How many of the parameters, from the first on, are to be reached.
    reached: usize,
    /// Largest root mean square distance, pixels.
    pub rms: f64,
}

/// The boards that are measured.
pub const KNOWN: [KnownCamera; 2] = [
    KnownCamera {
        name: "calib_chessboard",
        board: "chessboard:9x6:0.025",
        model: "radtan5",
        // As OpenCV's documentation prints the calibration of its sample.
        parameters: &[
            ("fx", 536.07343),
            ("fy", 536.01634),
            ("cx", 342.37),
            ("cy", 235.53686),
            ("k1", -0.26509),
            ("k2", -0.046743),
            ("p1", 0.0018330),
            ("p2", -0.00031471),
            ("k3", 0.25231),
        ],
        percent: 0.5,
        reached: 2,
        rms: 0.41,
    },
    KnownCamera {
        name: "calib_aprilgrid",
        board: "aprilgrid:6x6:0.088:0.3",
        model: "radtan",
        parameters: &[
            ("fx", 458.654),
            ("fy", 457.296),
            ("cx", 367.215),
            ("cy", 248.375),
            ("k1", -0.28340811),
            ("k2", 0.07395907),
            ("p1", 0.00019359),
            ("p2", 1.76e-5),
        ],
        percent: 1.0,
        reached: 8,
        rms: 0.3,
    },
];

/// A calibration beside the known result.
pub struct Calibrated {
    /// What is known.
    pub known: &'static KnownCamera,
    /// Parameter by parameter.
    pub parameters: Vec<Parameter>,
    /// Root mean square distance, pixels.
    pub rms: f64,
    /// Images used, and given.
    pub images: [usize; 2],
    /// Seconds it took.
    pub seconds: f64,
    /// How far the camera is from the known one; `None` where not all of the lens is known.
    pub apart: Option<Apart>,
    /// How well both fit images that the calibration was not made from.
    pub held_out: HeldOut,
}

/// A parameter beside the known one.
pub struct Parameter {
    /// Its name.
    pub name: String,
    /// As found.
    pub value: f64,
    /// Its standard deviation.
    pub sigma: f64,
    /// The known one.
    pub known: Option<f64>,
    /// How far the difference alone moves a ray at the image's border at most, pixels.
    pub moves: Option<f64>,
    /// The largest difference that is wanted, percent.
    pub wanted: Option<f64>,
}

impl Parameter {
    /// Difference from the known one, percent of that.
    pub fn percent(&self) -> Option<f64> {
        self.known.map(|known| 100.0 * (self.value - known) / known.abs())
    }

    /// The same in standard deviations of what was found.
    pub fn sigmas(&self) -> Option<f64> {
        self.known.map(|known| (self.value - known) / self.sigma)
    }

    /// Whether what is wanted is reached.
    pub fn is_reached(&self) -> Option<bool> {
        Some(self.percent()?.abs() <= self.wanted?)
    }
}

impl KnownCamera {
    /// Calibrates the images in `folder`.
    ///
    /// # Errors
    /// When it fails.
    pub fn measure(&'static self, runner: &Runner, folder: &Path) -> Result<Calibrated> {
        std::fs::create_dir_all(&runner.work)?;
        let mut command = Command::new(&runner.loopbox);
        command.arg("calib").arg(folder).args(["--board", self.board, "--model", self.model]);
        let out = runner.work.join(self.name).with_extension("yaml");
        let began = Instant::now();
        let printed = finish(command.arg("--out").arg(out).args(["--json", "--quiet"]))?;
        let seconds = began.elapsed().as_secs_f64();
        let record =
            serde_json::from_slice(&printed).context("what `loopbox calib --json` printed is not JSON")?;
        let held_out = self.held_out(runner, folder, size(&record))?;
        self.read(&record, seconds, held_out)
    }

    /// What the program printed, beside what is known.
    fn read(&'static self, record: &Value, seconds: f64, held_out: HeldOut) -> Result<Calibrated> {
        let size = size(record);
        let found = record["parameters"].as_array().context("there are no parameters")?;
        let mut parameters = Vec::new();
        for (i, parameter) in found.iter().enumerate() {
            let name = parameter["name"].as_str().context("a parameter has no name")?;
            let number = |key: &str| parameter[key].as_f64().with_context(|| format!("{name} has no {key}"));
            let (value, sigma) = (number("value")?, number("sigma")?);
            let known = self.parameters.iter().find(|(known, _)| *known == name).map(|&(_, value)| value);
            let changed = |&(other, known)| if other == name { value } else { known };
            let changed: Vec<f64> = self.parameters.iter().map(changed).collect();
            let moves = known.and_then(|_| self.moved(size, &changed));
            let wanted = (i < self.reached).then_some(self.percent);
            parameters.push(Parameter { name: name.to_owned(), value, sigma, known, moves, wanted });
        }
        let values: Vec<f64> = parameters.iter().map(|parameter| parameter.value).collect();
        let views = record["views"].as_array().context("there are no views")?;
        let used = views.iter().filter(|view| view["rejected"].is_null()).count();
        let given = record["images"].as_u64().context("the number of images is missing")? as usize;
        let rms = record["rms"].as_f64().context("rms is missing")?;
        let cameras = self.known_camera(size).zip(camera(size, &values));
        let apart = cameras.and_then(|(known, other)| apart(&known, &other, size));
        Ok(Calibrated { known: self, parameters, rms, images: [used, given], seconds, apart, held_out })
    }

    /// How far a camera with these parameters is from the known one at most, pixels at the image's border.
    fn moved(&self, size: [usize; 2], values: &[f64]) -> Option<f64> {
        at_border(&self.known_camera(size)?, &camera(size, values)?, size)
    }

    /// The known camera; `None` when not all of its lens is known.
    fn known_camera(&self, size: [usize; 2]) -> Option<geometry::Camera> {
        let known: Vec<f64> = self.parameters.iter().map(|&(_, value)| value).collect();
        camera(size, &known)
    }
}

/// Width and height of the images.
fn size(record: &Value) -> [usize; 2] {
    [0, 1].map(|side| record["size"][side].as_u64().unwrap_or_default() as usize)
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn record(values: &[f64], names: &[&str], size: [usize; 2]) -> Value {
        let parameters: Vec<Value> = names
            .iter()
            .zip(values)
            .map(|(name, value)| json!({ "name": name, "value": value, "sigma": 0.5 }))
            .collect();
        let views = json!([{ "rejected": null }, { "rejected": "blurred" }]);
        json!({ "size": size, "parameters": parameters, "rms": 0.2, "images": 2, "views": views })
    }

    const NAMES: [&str; 8] = ["fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2"];

    const HELD_OUT: HeldOut = HeldOut { found: Misfit { rms: 0.2, median: 0.1 }, known: None };

    #[test]
    fn the_known_camera_has_no_distance_to_itself() {
        let mut values: Vec<f64> = KNOWN[1].parameters.iter().map(|&(_, value)| value).collect();
        let read =
            |values: &[f64]| KNOWN[1].read(&record(values, &NAMES, [752, 480]), 1.0, HELD_OUT).unwrap();
        let same = read(&values);
        assert!(same.apart.unwrap().whole.most < 1e-6, "{:?}", same.apart);
        assert!(same.parameters.iter().all(|parameter| parameter.is_reached() == Some(true)));
        assert_eq!(same.images, [1, 2]);
        values[2] += 5.0;
        let shifted = read(&values);
        assert!(shifted.apart.unwrap().inner.most < 4.0, "{:?}", shifted.apart);
        assert!((shifted.parameters[2].moves.unwrap() - 5.0).abs() < 1e-6);
        assert_eq!(shifted.parameters[2].is_reached(), Some(false));
        assert!((shifted.parameters[2].sigmas().unwrap() - 10.0).abs() < 1e-9);
    }

    #[test]
    fn only_what_is_requested_is_evaluated() {
        let values = [536.0, 536.0, 350.0, 235.0, -0.27, -0.05, 0.0, 0.0, 0.25];
        let names = [&NAMES[..], &["k3"]].concat();
        let found = KNOWN[0].read(&record(&values, &names, [640, 480]), 1.0, HELD_OUT).unwrap();
        let reached: Vec<_> = found.parameters.iter().map(Parameter::is_reached).collect();
        assert_eq!(reached[..3], [Some(true), Some(true), None]);
        assert!(found.parameters[2].percent().unwrap() > 2.0 && found.apart.is_some());
    }
}
