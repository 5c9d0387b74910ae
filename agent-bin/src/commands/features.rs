//! Maps and images as commands are given them, and the features of many images.

use super::info_map::load_at;
use anyhow::{Context, Result, bail};
use loopbox::merging::features_of_keyframes;
use place_recog::Vocabulary;
use place_recog::features::{Features, SiftParams, sift};
use rayon::prelude::*;
use sources::images_in;
use sources::pictures::Picture;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// The features of all images at `path`: an image, a folder of images (or with a folder `images` in it), a map, or
/// the folder of a run.
pub(super) fn of_images(path: &Path) -> Result<Vec<Features>> {
    if loopbox::open::is_map(path) {
        let map = load_at(path)?;
        map.of_cameras()?;
        return features_of_keyframes(&map);
    }
    let files = image_files(path)?;
    let params = SiftParams::default();
    let features = |file: PathBuf| {
        let image = Picture::File(file.clone()).into_grey().map_err(anyhow::Error::msg)?;
        sift(&image, &params).with_context(|| file.display().to_string())
    };
    files.into_par_iter().map(features).collect()
}

fn image_files(path: &Path) -> Result<Vec<PathBuf>> {
    if path.is_file() {
        return Ok(vec![path.to_owned()]);
    }
    if !path.is_dir() {
        bail!("{}: there is no such file or folder", path.display());
    }
    let inner = path.join("images");
    let folder = if inner.is_dir() { inner } else { path.to_owned() };
    let files = images_in(&folder)?;
    if files.is_empty() {
        bail!("{}: holds no images\nhint: PNG, JPEG, PGM, TIFF and BMP files are read", folder.display());
    }
    Ok(files)
}

/// The vocabulary in a file.
pub(super) fn vocabulary(path: &Path) -> Result<Arc<Vocabulary>> {
    let about = || path.display().to_string();
    let bytes = std::fs::read(path).with_context(about)?;
    Ok(Arc::new(Vocabulary::from_bytes(&bytes).with_context(about)?))
}
