//! `loopbox calib --response` and `--vignette`.

use crate::console::say;
use anyhow::{Context, Result, bail};
use calib::{estimate_response, estimate_vignette, format_response, read_photometric};
use clap::Args;
use geometry::GrayImage;
use image::{DynamicImage, ImageBuffer, ImageFormat, Luma};
use loopbox::calibrating::Output;
use sources::images_in;
use sources::pictures::Picture;
use std::io::Cursor;
use std::path::{Path, PathBuf};

/// What is calibrated photometrically.
#[derive(Debug, Args)]
pub struct PhotometricArgs {
    /// Calibrate the response from this folder: images of a still scene at many exposures, and exposures.txt with a line
    /// 'image exposure' for each (or TUM-mono's times.txt: 'number time exposure' with images/)
    #[arg(long, value_name = "FOLDER", conflicts_with = "vignette")]
    response: Option<PathBuf>,
    /// Calibrate the vignette from this folder of images of an evenly lit white surface that fills them
    #[arg(long, value_name = "FOLDER")]
    vignette: Option<PathBuf>,
    /// With --vignette: the response of the camera (pcalib.txt); without it the sensor counts as linear
    #[arg(long, value_name = "FILE", requires = "vignette")]
    with_response: Option<PathBuf>,
}

impl PhotometricArgs {
    /// Whether anything is.
    pub fn asked_for(&self) -> bool {
        self.response.is_some() || self.vignette.is_some()
    }
}

/// Calibrates and writes `out`.
///
/// # Errors
/// When the images cannot be read or do not determine what is asked for. Then nothing is written.
pub fn run(args: &PhotometricArgs, images: &[PathBuf], out: &Path) -> Result<()> {
    if let Some(path) = images.first() {
        bail!("{}: --response and --vignette take a folder and no other images", path.display());
    }
    if let Some(folder) = &args.response {
        return response(folder, out);
    }
    let Some(folder) = &args.vignette else { return Ok(()) };
    vignette(folder, args.with_response.as_deref(), out)
}

fn response(folder: &Path, out: &Path) -> Result<()> {
    let out = Output::prepare(out)?;
    let images = exposures(folder)?
        .into_iter()
        .map(|(path, exposure)| Ok((read(path)?, exposure)))
        .collect::<Result<Vec<(GrayImage, f64)>>>()?;
    let response = estimate_response(&images).with_context(|| folder.display().to_string())?;
    out.write(format_response(&response).as_bytes())?;
    out.commit()?;
    say!(
        "response from {} images: {} of 254 grey levels seen, rms {:.2} of 255",
        images.len(),
        response.levels_seen,
        response.rms
    );
    Ok(())
}

fn vignette(folder: &Path, response: Option<&Path>, out: &Path) -> Result<()> {
    let response = read_photometric(response, None)?;
    let out = Output::prepare(out)?;
    let images = images_in(folder)?.into_iter().map(read).collect::<Result<Vec<GrayImage>>>()?;
    let vignette = estimate_vignette(&images, &response).with_context(|| folder.display().to_string())?;
    let (width, height) = (vignette.width() as u32, vignette.height() as u32);
    let deep: Vec<u16> = vignette.data().iter().map(|value| (value * 65535.0).round() as u16).collect();
    let pixels: ImageBuffer<Luma<u16>, _> =
        ImageBuffer::from_raw(width, height, deep).context("the vignette has no pixels")?;
    let mut png = Cursor::new(Vec::new());
    DynamicImage::ImageLuma16(pixels).write_to(&mut png, ImageFormat::Png)?;
    out.write(png.get_ref())?;
    out.commit()?;
    let darkest = vignette.data().iter().copied().fold(1.0, f32::min);
    say!("vignette from {} images: down to {:.0} % of the light", images.len(), 100.0 * darkest);
    Ok(())
}

fn read(path: PathBuf) -> Result<GrayImage> {
    let hint = "hint: remove the file or give it anew; PNG, JPEG, PGM, TIFF and BMP are read";
    Picture::File(path).into_grey().map_err(|reason| anyhow::anyhow!("{reason}\n{hint}"))
}

/// The images of a sweep with their exposures.
fn exposures(folder: &Path) -> Result<Vec<(PathBuf, f64)>> {
    let own = folder.join("exposures.txt");
    let (table, images, column) = if own.is_file() {
        (own, folder.to_owned(), 1)
    } else {
        (folder.join("times.txt"), folder.join("images"), 2)
    };
    let text = std::fs::read_to_string(&table).with_context(|| {
        format!(
            "{}: cannot be read\nhint: give a folder with images and exposures.txt, a line 'image exposure' for each",
            folder.join("exposures.txt").display()
        )
    })?;
    let lines = text
        .lines()
        .enumerate()
        .filter(|(_, line)| !line.trim().is_empty() && !line.trim_start().starts_with('#'));
    lines
        .map(|(index, line)| {
            let fields: Vec<&str> = line.split_whitespace().collect();
            let exposure = fields.get(column).and_then(|field| field.parse::<f64>().ok());
            let Some(exposure) = exposure else {
                bail!("{}: line {} names no exposure: {line}", table.display(), index + 1);
            };
            // TUM's tables leave the ending out.
            let path = [fields[0].to_owned(), format!("{}.jpg", fields[0]), format!("{}.png", fields[0])]
                .map(|name| images.join(name))
                .into_iter()
                .find(|path| path.is_file());
            let path = path.with_context(|| {
                format!(
                    "{}: line {}: there is no image {}",
                    table.display(),
                    index + 1,
                    images.join(fields[0]).display()
                )
            })?;
            Ok((path, exposure))
        })
        .collect()
}
