//! Models as text: `cameras.txt`, `images.txt`, `points3D.txt`.

use super::{CAMERA_MODELS, Model, Picture, camera_of, pose_of};
use anyhow::{Context, Result, bail, ensure};
use geometry::Camera;
use nalgebra::{Vector2, Vector3};
use std::path::Path;

/// Reads the model in a folder.
pub(super) fn read(folder: &Path) -> Result<Model> {
    let mut model = Model::default();
    each_line(&folder.join("cameras.txt"), |words| {
        let (id, camera) = camera(words)?;
        model.cameras.insert(id, camera);
        Ok(())
    })?;
    model.images = images(&folder.join("images.txt"))?;
    each_line(&folder.join("points3D.txt"), |words| {
        ensure!(words.len() >= 4, "a point is POINT3D_ID X Y Z …");
        let position = numbers::<3>(&words[1..])?;
        model.points.insert(words[0].parse()?, Vector3::from(position));
        Ok(())
    })?;
    Ok(model)
}

/// The text of a file.
fn text_of(path: &Path) -> Result<String> {
    std::fs::read_to_string(path).with_context(|| format!("{}: cannot be read", path.display()))
}

/// Gives the words of each line that is neither empty nor a comment; what is wrong with one names file and line.
fn each_line(path: &Path, mut take: impl FnMut(&[&str]) -> Result<()>) -> Result<()> {
    for (number, line) in text_of(path)?.lines().enumerate() {
        let words: Vec<&str> = line.split_whitespace().collect();
        if words.first().is_some_and(|word| !word.starts_with('#')) {
            take(&words).with_context(|| format!("{}: line {}", path.display(), number + 1))?;
        }
    }
    Ok(())
}

fn camera(words: &[&str]) -> Result<(u32, Camera)> {
    ensure!(words.len() >= 4, "a camera is CAMERA_ID MODEL WIDTH HEIGHT and its parameters");
    let Some((_, model, count)) = CAMERA_MODELS.iter().find(|(_, name, _)| *name == words[1]) else {
        bail!(
            "the camera model {} is not known\nhint: `colmap image_undistorter` makes it a PINHOLE",
            words[1]
        );
    };
    let params: Vec<f64> = words[4..].iter().map(|word| word.parse()).collect::<Result<_, _>>()?;
    ensure!(params.len() == *count, "{model} has {count} parameters, not {}", params.len());
    Ok((words[0].parse()?, camera_of(model, words[2].parse()?, words[3].parse()?, &params)?))
}

/// Two lines an image: its pose and name, and its key points, of which there may be none.
fn images(path: &Path) -> Result<Vec<Picture>> {
    let text = text_of(path)?;
    let mut lines = text.lines().enumerate().filter(|(_, line)| !line.starts_with('#'));
    let mut images = Vec::new();
    while let Some((number, head)) = lines.next() {
        if head.trim().is_empty() {
            continue;
        }
        let Some((_, points)) = lines.next() else {
            bail!(
                "{}: line {}: the file ends where the image's points should be",
                path.display(),
                number + 1
            );
        };
        let read = image(head, points).with_context(|| format!("{}: line {}", path.display(), number + 1));
        images.push(read?);
    }
    Ok(images)
}

fn image(head: &str, points: &str) -> Result<Picture> {
    let words: Vec<&str> = head.split_whitespace().collect();
    ensure!(
        words.len() >= 10,
        "an image is IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME: the pose is missing or cut short"
    );
    let camera_from_world = pose_of(numbers::<4>(&words[1..])?, numbers::<3>(&words[5..])?)?;
    let points: Vec<&str> = points.split_whitespace().collect();
    ensure!(points.len().is_multiple_of(3), "the key points, X Y POINT3D_ID each, are cut short");
    let mut seen = Vec::new();
    for point in points.chunks_exact(3) {
        // -1: of no point.
        if let Ok(id) = point[2].parse::<u64>() {
            seen.push((Vector2::from(numbers::<2>(point)?), id));
        }
    }
    // A name may have spaces in it.
    Ok(Picture { name: words[9..].join(" "), camera: words[8].parse()?, camera_from_world, seen })
}

/// The first `N` words as finite numbers.
fn numbers<const N: usize>(words: &[&str]) -> Result<[f64; N]> {
    let mut found = [0.0; N];
    for (number, word) in found.iter_mut().zip(words) {
        *number = word
            .parse::<f64>()
            .ok()
            .filter(|v| v.is_finite())
            .with_context(|| format!("{word} is no number"))?;
    }
    Ok(found)
}
