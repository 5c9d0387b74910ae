//! Calibrations of images of which the result is known.

use crate::measure::{Runner, finish};
use anyhow::{Context, Result};
use geometry::{Camera, Distortion, Pinhole, RadTan};
use nalgebra::{Matrix3, Rotation3, Vector2};
use serde_json::Value;
use std::path::Path;
use std::process::Command;
use std::time::Instant;

/// Images of a board, and what others found for their camera.
pub struct Known {
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
pub const KNOWN: [Known; 2] = [
    Known {
        name: "calib_chessboard",
        board: "chessboard:9x6:0.025",
        model: "radtan5",
        parameters: &[("fx", 536.07), ("fy", 536.02), ("cx", 342.37), ("cy", 235.54)],
        percent: 0.5,
        reached: 2,
        rms: 0.41,
    },
    Known {
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
    pub known: &'static Known,
    /// Parameter by parameter.
    pub parameters: Vec<Parameter>,
    /// Root mean square distance, pixels.
    pub rms: f64,
    /// Images used, and given.
    pub images: [usize; 2],
    /// Seconds it took.
    pub seconds: f64,
    /// The farthest that a ray lands from where the known camera has it, at the border and, with the cameras turned to
    /// agree best, within the image, pixels; `None` where not all of the lens is known.
    pub apart: Option<[f64; 2]>,
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

impl Known {
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
        let record = serde_json::from_slice(&printed);
        self.read(&record.context("what `loopbox calib --json` printed is not JSON")?, seconds)
    }

    /// What the program printed, beside what is known.
    fn read(&'static self, record: &Value, seconds: f64) -> Result<Calibrated> {
        let size = [0, 1].map(|side| record["size"][side].as_u64().unwrap_or_default() as usize);
        let found = record["parameters"].as_array().context("there are no parameters")?;
        let mut parameters = Vec::new();
        for (i, parameter) in found.iter().enumerate() {
            let name = parameter["name"].as_str().context("a parameter has no name")?;
            let number = |key: &str| parameter[key].as_f64().with_context(|| format!("{name} has no {key}"));
            let (value, sigma) = (number("value")?, number("sigma")?);
            let known = self.parameters.iter().find(|(known, _)| *known == name).map(|&(_, value)| value);
            let changed = |&(other, known)| if other == name { value } else { known };
            let changed: Vec<f64> = self.parameters.iter().map(changed).collect();
            let moves = known.and_then(|_| self.apart(size, &changed));
            let wanted = (i < self.reached).then_some(self.percent);
            parameters.push(Parameter { name: name.to_owned(), value, sigma, known, moves, wanted });
        }
        let values: Vec<f64> = parameters.iter().map(|parameter| parameter.value).collect();
        let views = record["views"].as_array().context("there are no views")?;
        let used = views.iter().filter(|view| view["rejected"].is_null()).count();
        let given = record["images"].as_u64().context("the number of images is missing")? as usize;
        let rms = record["rms"].as_f64().context("rms is missing")?;
        let turned = self.cameras(size, &values);
        let turned = turned.and_then(|(known, other)| apart_turned(&known, &other, size));
        let apart = self.apart(size, &values).zip(turned).map(<[f64; 2]>::from);
        Ok(Calibrated { known: self, parameters, rms, images: [used, given], seconds, apart })
    }

    /// How far a camera with these parameters is from the known one at most, pixels at the image's border.
    fn apart(&self, size: [usize; 2], values: &[f64]) -> Option<f64> {
        let (known, other) = self.cameras(size, values)?;
        farthest(&known, &other, &Rotation3::identity(), &border(size))
    }

    /// The known camera and that with other parameters.
    fn cameras(&self, size: [usize; 2], values: &[f64]) -> Option<(Camera, Camera)> {
        let known: Vec<f64> = self.parameters.iter().map(|&(_, value)| value).collect();
        Some((camera(size, &known)?, camera(size, values)?))
    }
}

/// How far two cameras are apart at most within the image, pixels, once they are turned so that they agree best there: a
/// turned camera sees the same world, so that part of a difference harms nobody.
fn apart_turned(known: &Camera, other: &Camera, size: [usize; 2]) -> Option<f64> {
    let pixels = inner(size);
    let ray = |camera: &Camera, pixel| Some(camera.unproject(pixel)?.normalize());
    let mut products = Matrix3::zeros();
    for pixel in &pixels {
        products += ray(other, pixel)? * ray(known, pixel)?.transpose();
    }
    let other_from_known = Rotation3::from_matrix_eps(&products, 1e-12, 100, Rotation3::identity());
    farthest(known, other, &other_from_known, &pixels)
}

/// How far the rays through the known camera's pixels land from there in the other, turned camera at most, pixels.
fn farthest(
    known: &Camera,
    other: &Camera,
    other_from_known: &Rotation3<f64>,
    pixels: &[Vector2<f64>],
) -> Option<f64> {
    let apart = |pixel: &Vector2<f64>| {
        Some((other.project(&(other_from_known * known.unproject(pixel)?))? - pixel).norm())
    };
    pixels.iter().map(apart).collect::<Option<Vec<f64>>>()?.into_iter().reduce(f64::max)
}

/// Steps of the grid of pixels along a side.
const STEPS: usize = 16;

/// Pixels all over the image.
fn grid([width, height]: [usize; 2]) -> Vec<Vector2<f64>> {
    let at = |i: usize, side: usize| i as f64 / STEPS as f64 * (side as f64 - 1.0);
    let row = |y: usize| (0..=STEPS).map(move |x| Vector2::new(at(x, width), at(y, height)));
    (0..=STEPS).flat_map(row).collect()
}

/// Those that are a tenth of the side or more from the border. Farther out few corners of a board are ever seen, so
/// lens models are free to differ.
fn inner(size: [usize; 2]) -> Vec<Vector2<f64>> {
    let is_inner = |at: f64, side: usize| (0.1..=0.9).contains(&(at / (side as f64 - 1.0)));
    let inner = |pixel: &Vector2<f64>| is_inner(pixel.x, size[0]) && is_inner(pixel.y, size[1]);
    grid(size).into_iter().filter(inner).collect()
}

/// Those at its border.
fn border(size: [usize; 2]) -> Vec<Vector2<f64>> {
    let is_end = |i: usize| i == 0 || i == STEPS;
    let at_border = |i: usize| is_end(i / (STEPS + 1)) || is_end(i % (STEPS + 1));
    grid(size).into_iter().enumerate().filter(|(i, _)| at_border(*i)).map(|(_, pixel)| pixel).collect()
}

/// The camera with fx, fy, cx, cy and all terms of its lens; `None` when there are only the first four.
fn camera([width, height]: [usize; 2], values: &[f64]) -> Option<Camera> {
    let [fx, fy, cx, cy, terms @ ..] = values else { return None };
    if terms.is_empty() {
        return None;
    }
    let pinhole = Pinhole { width, height, fx: *fx, fy: *fy, cx: *cx, cy: *cy };
    Camera::new(pinhole, Distortion::RadTan(RadTan::new(terms).ok()?)).ok()
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

    #[test]
    fn the_known_camera_is_no_way_apart_from_itself() {
        let mut values: Vec<f64> = KNOWN[1].parameters.iter().map(|&(_, value)| value).collect();
        let same = KNOWN[1].read(&record(&values, &NAMES, [752, 480]), 1.0).unwrap();
        assert!(same.apart.unwrap().iter().all(|&apart| apart < 1e-6), "{:?}", same.apart);
        assert!(same.parameters.iter().all(|parameter| parameter.is_reached() == Some(true)));
        assert_eq!(same.images, [1, 2]);
        values[2] += 5.0;
        let shifted = KNOWN[1].read(&record(&values, &NAMES, [752, 480]), 1.0).unwrap();
        assert!((shifted.apart.unwrap()[0] - 5.0).abs() < 1e-6);
        assert!((shifted.parameters[2].moves.unwrap() - 5.0).abs() < 1e-6);
        assert_eq!(border([752, 480]).len(), 4 * STEPS);
        assert_eq!(shifted.parameters[2].is_reached(), Some(false));
        assert!((shifted.parameters[2].sigmas().unwrap() - 10.0).abs() < 1e-9);
    }

    #[test]
    fn a_turn_is_no_difference() {
        let values = [2000.0, 2000.0, 100.0, 50.0, 0.0, 0.0, 0.0, 0.0];
        let shifted = [2000.0, 2000.0, 105.0, 47.0, 0.0, 0.0, 0.0, 0.0];
        let [known, other] = [values, shifted].map(|values| camera([200, 100], &values));
        // Seen through so long a lens, a shift is a turn.
        let apart = apart_turned(&known.unwrap(), &other.unwrap(), [200, 100]).unwrap();
        assert!(apart < 0.05, "{apart}");
    }

    #[test]
    fn only_what_is_known_is_compared() {
        let values = [536.0, 536.0, 350.0, 235.0, 0.1, 0.0, 0.0, 0.0, 0.0];
        let names = [&NAMES[..], &["k3"]].concat();
        let found = KNOWN[0].read(&record(&values, &names, [640, 480]), 1.0).unwrap();
        let reached: Vec<_> = found.parameters.iter().map(Parameter::is_reached).collect();
        assert_eq!(reached[..3], [Some(true), Some(true), None]);
        assert!(found.parameters[2].percent().unwrap() > 2.0);
        assert!(found.parameters[4].percent().is_none() && found.apart.is_none());
    }
}
