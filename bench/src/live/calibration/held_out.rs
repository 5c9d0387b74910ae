//! How well a calibration fits images that it was not made from.

use super::KnownCamera;
use crate::measure::{Runner, finish};
use anyhow::{Context, Result, bail};
use geometry::Pinhole;
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Distances of corners from where a camera would see them, with the board placed in each image as fits best, pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Misfit {
    /// Root mean square.
    pub rms: f64,
    /// Median; of the two halves, the mean of both.
    pub median: f64,
}

/// Each half of the images by a calibration of the other half, and all by the known camera: the same corners.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HeldOut {
    /// By what was found from the other half.
    pub found: Misfit,
    /// By the known camera; `None` where not all of it is known.
    pub known: Option<Misfit>,
}

impl KnownCamera {
    /// Calibrates every other image, checks that on the rest, and the other way round.
    pub(super) fn held_out(&self, runner: &Runner, folder: &Path, size: [usize; 2]) -> Result<HeldOut> {
        let images = images(folder)?;
        let halves =
            [0, 1].map(|half| images.iter().skip(half).step_by(2).cloned().collect::<Vec<PathBuf>>());
        let place = |what: &str| runner.work.join(format!("{}-{what}.yaml", self.name));
        let known = self.known_text(size).map(|text| (place("known"), text));
        if let Some((path, text)) = &known {
            std::fs::write(path, text).with_context(|| path.display().to_string())?;
        }
        let (mut found, mut by_known) = (Vec::new(), Vec::new());
        for half in 0..2 {
            let own = place(&format!("half{half}"));
            let mut command = Command::new(&runner.loopbox);
            command.arg("calib").args(&halves[half]).args(["--board", self.board, "--model", self.model]);
            finish(command.arg("--out").arg(&own).arg("--quiet"))?;
            let others = &halves[1 - half];
            found.push(self.check(runner, others, &own)?);
            if let Some((path, _)) = &known {
                by_known.push(self.check(runner, others, path)?);
            }
        }
        Ok(HeldOut {
            found: together(&found).context("no corners were checked")?,
            known: together(&by_known),
        })
    }

    /// How well a calibration fits images, and over how many corners.
    fn check(&self, runner: &Runner, images: &[PathBuf], camera: &Path) -> Result<(Misfit, f64)> {
        let mut command = Command::new(&runner.loopbox);
        command.arg("calib").args(images).args(["--board", self.board, "--json", "--quiet"]);
        let printed = finish(command.arg("--check").arg(camera))?;
        let record: Value = serde_json::from_slice(&printed)?;
        let number =
            |key: &str| record[key].as_f64().with_context(|| format!("`calib --check` gave no {key}"));
        Ok((Misfit { rms: number("rms")?, median: number("median")? }, number("corners")?))
    }

    /// The known camera as a file that the program reads.
    fn known_text(&self, size: [usize; 2]) -> Option<String> {
        let camera = self.known_camera(size)?;
        let Pinhole { width, height, fx, fy, cx, cy } = *camera.intrinsics();
        let terms: Vec<String> = self.parameters[4..].iter().map(|(_, value)| value.to_string()).collect();
        let terms = terms.join(", ");
        Some(format!(
            "model: radtan\nwidth: {width}\nheight: {height}\nfx: {fx}\nfy: {fy}\ncx: {cx}\ncy: {cy}\ndistortion: \
             [{terms}]\n"
        ))
    }
}

/// Errors over several numbers of corners as one; `None` of none.
fn together(parts: &[(Misfit, f64)]) -> Option<Misfit> {
    let count: f64 = parts.iter().map(|(_, count)| count).sum();
    let mean = |of: &dyn Fn(&Misfit) -> f64| {
        parts.iter().map(|(error, corners)| of(error) * corners).sum::<f64>() / count
    };
    (count > 0.0).then(|| Misfit {
        rms: mean(&|error| error.rms * error.rms).sqrt(),
        median: mean(&|error| error.median),
    })
}

/// The images in a folder, by name.
fn images(folder: &Path) -> Result<Vec<PathBuf>> {
    let unreadable = || format!("{}: the folder cannot be read", folder.display());
    let entries = std::fs::read_dir(folder).with_context(unreadable)?;
    let paths = entries.collect::<Result<Vec<_>, _>>().with_context(unreadable)?;
    let is_image = |path: &PathBuf| path.extension().is_some_and(|e| e == "jpg" || e == "png");
    let mut images: Vec<PathBuf> = paths.into_iter().map(|entry| entry.path()).filter(is_image).collect();
    if images.is_empty() {
        bail!("{}: there are no images", folder.display());
    }
    images.sort();
    Ok(images)
}

#[cfg(test)]
mod tests {
    use super::super::KNOWN;
    use super::*;

    #[test]
    fn halves_count_by_their_corners() {
        let error = |rms, median| Misfit { rms, median };
        let both = together(&[(error(1.0, 0.5), 300.0), (error(2.0, 0.9), 100.0)]).unwrap();
        assert!((both.rms - 1.75f64.sqrt()).abs() < 1e-12 && (both.median - 0.6).abs() < 1e-12, "{both:?}");
        assert_eq!(together(&[]), None);
    }

    #[test]
    fn the_known_camera_is_written_in_full() {
        let text = KNOWN[1].known_text([752, 480]).unwrap();
        assert!(text.starts_with("model: radtan\nwidth: 752\nheight: 480\nfx: 458.654\n"), "{text}");
        assert!(text.ends_with("distortion: [-0.28340811, 0.07395907, 0.00019359, 0.0000176]\n"), "{text}");
    }
}
