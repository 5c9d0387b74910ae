//! Models as bytes: `cameras.bin`, `images.bin`, `points3D.bin`, little endian.

use super::{CAMERA_MODELS, Model, Picture, camera_of, pose_of};
use anyhow::{Context, Result, bail};
use geometry::Camera;
use nalgebra::{Vector2, Vector3};
use std::path::Path;

/// COLMAP's mark of a key point that is of no 3-D point.
const NO_POINT: u64 = u64::MAX;

/// Reads the model in a folder.
pub(super) fn read(folder: &Path) -> Result<Model> {
    let mut model = Model::default();
    each(&folder.join("cameras.bin"), |bytes| {
        let (id, camera) = camera(bytes)?;
        model.cameras.insert(id, camera);
        Ok(())
    })?;
    each(&folder.join("images.bin"), |bytes| {
        model.images.push(image(bytes)?);
        Ok(())
    })?;
    each(&folder.join("points3D.bin"), |bytes| {
        let (id, position) = (bytes.u64()?, Vector3::from(bytes.numbers::<3>()?));
        // Colour and error.
        bytes.take(3 + 8)?;
        let track = bytes.u64()?;
        bytes.take(usize::try_from(track).ok().and_then(|n| n.checked_mul(8)).unwrap_or(usize::MAX))?;
        model.points.insert(id, position);
        Ok(())
    })?;
    Ok(model)
}

/// Gives the bytes of a file to `take`, as often as the file's first number says.
fn each(path: &Path, mut take: impl FnMut(&mut Bytes) -> Result<()>) -> Result<()> {
    let content = std::fs::read(path).with_context(|| format!("{}: cannot be read", path.display()))?;
    let mut bytes = Bytes(&content);
    let mut all = || -> Result<()> {
        for _ in 0..bytes.u64()? {
            take(&mut bytes)?;
        }
        Ok(())
    };
    all().with_context(|| format!("{}: cannot be used", path.display()))
}

fn camera(bytes: &mut Bytes) -> Result<(u32, Camera)> {
    let (id, model) = (bytes.u32()?, bytes.u32()? as i32);
    let (width, height) = (bytes.u64()?, bytes.u64()?);
    let Some((_, model, count)) = CAMERA_MODELS.iter().find(|(number, ..)| *number == model) else {
        bail!(
            "the camera model number {model} is not known\nhint: `colmap image_undistorter` makes it a PINHOLE"
        );
    };
    let params: Vec<f64> = (0..*count).map(|_| bytes.f64()).collect::<Result<_>>()?;
    Ok((id, camera_of(model, width, height, &params)?))
}

fn image(bytes: &mut Bytes) -> Result<Picture> {
    let _id = bytes.u32()?;
    let camera_from_world = pose_of(bytes.numbers::<4>()?, bytes.numbers::<3>()?)?;
    let (camera, name) = (bytes.u32()?, bytes.name()?);
    let mut seen = Vec::new();
    for _ in 0..bytes.u64()? {
        let (pixel, point) = (Vector2::from(bytes.numbers::<2>()?), bytes.u64()?);
        if point != NO_POINT {
            seen.push((pixel, point));
        }
    }
    Ok(Picture { name, camera, camera_from_world, seen })
}

/// What is left of a file.
struct Bytes<'a>(&'a [u8]);

impl<'a> Bytes<'a> {
    fn take(&mut self, count: usize) -> Result<&'a [u8]> {
        let (taken, rest) = self.0.split_at_checked(count).context("it is cut short")?;
        self.0 = rest;
        Ok(taken)
    }

    fn u32(&mut self) -> Result<u32> {
        Ok(u32::from_le_bytes(self.take(4)?.try_into()?))
    }

    fn u64(&mut self) -> Result<u64> {
        Ok(u64::from_le_bytes(self.take(8)?.try_into()?))
    }

    fn f64(&mut self) -> Result<f64> {
        let number = f64::from_le_bytes(self.take(8)?.try_into()?);
        if !number.is_finite() {
            bail!("{number} is no number to use");
        }
        Ok(number)
    }

    fn numbers<const N: usize>(&mut self) -> Result<[f64; N]> {
        let mut found = [0.0; N];
        for number in &mut found {
            *number = self.f64()?;
        }
        Ok(found)
    }

    /// A text that ends with a zero.
    fn name(&mut self) -> Result<String> {
        let end = self.0.iter().position(|byte| *byte == 0).context("it is cut short")?;
        let name = String::from_utf8(self.take(end)?.to_vec()).context("an image's name is not UTF-8")?;
        self.take(1)?;
        Ok(name)
    }
}
